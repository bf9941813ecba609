//! What a grasp is to be, and what became of it.

use super::Joints;
use crate::{EffortUnit, Error, HandState, Result};

/// A goal leads a contact by this much more than the limit needs.
const LEAD_MARGIN: f64 = 1.3;
/// A goal leads a contact by at least this, rad, so that a joint that is free again can be told from one that presses.
const LEAST_LEAD_RAD: f64 = 0.06;
/// Motors in current-based position mode give P e / 256 mA for an error of e ticks; with the side joints' gain of 450, mA per rad.
const LEAP_STIFFNESS: f64 = 450.0 / 256.0 * 4096.0 / std::f64::consts::TAU;
/// The softest of the vendor's gains, N m per rad.
const ALLEGRO_STIFFNESS: f64 = 600.0 / 1200.0;

/// Where the joints go and how hard they press. Lists in the order of the hand's joints, efforts in its unit.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GraspPlan {
    /// Angles with the hand open, rad.
    pub open: Vec<f64>,
    /// Angles just before the fingers close, rad.
    pub pre_grasp: Vec<f64>,
    /// Angles that the fingers would reach if there were no object, rad; joints that stay where they are before do not close.
    pub closed: Vec<f64>,
    /// Effort limits while the hand moves.
    pub closing_effort: Vec<f64>,
    /// Effort limits that make the force, from [`crate::torque_current::LimitOptions::limits_ma`] or from joint torques.
    pub force_effort: Vec<f64>,
    /// Least effort per rad of position error of the hand's joints: it says how far a goal has to lead a contact.
    pub stiffness: f64,
    /// Speed of the goals while the hand opens, rad/s.
    pub speed_rad_per_s: f64,
    /// Speed of the goals while the fingers close, rad/s.
    pub closing_rad_per_s: f64,
    /// How fast limits change, unit of the effort per s.
    pub effort_rate: f64,
    /// A joint touches if it presses with at least this share of its closing effort…
    pub contact_share: f64,
    /// … at no more than this speed, rad/s …
    pub contact_rad_per_s: f64,
    /// … for this long, s.
    pub contact_s: f64,
    /// Fewest joints that have to touch.
    pub least_contacts: usize,
    /// A joint that closes this much further while it holds has lost its contact, rad.
    pub slip_rad: f64,
    /// How long to hold, s; `None` is until [`GraspHandle::release`](super::GraspHandle::release).
    pub hold_s: Option<f64>,
    /// How long goals that have arrived wait for joints that have not, s.
    pub settle_s: f64,
}

impl GraspPlan {
    fn new(poses: [Vec<f64>; 3], closing_effort: Vec<f64>, force_effort: Vec<f64>) -> Self {
        let [open, pre_grasp, closed] = poses;
        Self {
            open,
            pre_grasp,
            closed,
            closing_effort,
            force_effort,
            stiffness: LEAP_STIFFNESS,
            speed_rad_per_s: 2.0,
            closing_rad_per_s: 1.0,
            effort_rate: 1000.0,
            contact_share: 0.8,
            contact_rad_per_s: 0.1,
            contact_s: 0.03,
            least_contacts: 2,
            slip_rad: 0.15,
            hold_s: None,
            settle_s: 0.5,
        }
    }

    /// For a LEAP hand, efforts in mA: poses `[open, pre_grasp, closed]`, and limits that change by 1 A/s.
    pub fn leap(poses: [Vec<f64>; 3], closing_ma: Vec<f64>, force_ma: Vec<f64>) -> Self {
        Self::new(poses, closing_ma, force_ma)
    }

    /// For an Allegro hand with the vendor's gains, efforts in N m: poses `[open, pre_grasp, closed]`, and limits that change by 0.5 N m/s.
    pub fn allegro(poses: [Vec<f64>; 3], closing_nm: Vec<f64>, force_nm: Vec<f64>) -> Self {
        let new = Self::new(poses, closing_nm, force_nm);
        Self { stiffness: ALLEGRO_STIFFNESS, effort_rate: 0.5, ..new }
    }

    /// The same, held for this long, s.
    pub fn with_hold_s(mut self, hold_s: f64) -> Self {
        self.hold_s = Some(hold_s);
        self
    }

    /// The same with this number of joints that have to touch.
    pub fn with_least_contacts(mut self, joints: usize) -> Self {
        self.least_contacts = joints;
        self
    }

    /// How far a joint's goal leads its contact, rad.
    pub(super) fn lead_rad(&self, joint: usize) -> f64 {
        let lead = LEAD_MARGIN * self.force_effort[joint].max(self.closing_effort[joint]) / self.stiffness;
        lead.max(LEAST_LEAD_RAD)
    }

    /// Which way a joint closes: 1, −1, or 0 for one that keeps its place.
    pub(super) fn way(&self, joint: usize) -> f64 {
        let travel = self.closed[joint] - self.pre_grasp[joint];
        if travel.abs() < 1e-3 { 0.0 } else { travel.signum() }
    }

    pub(super) fn check(&self, joints: &Joints<'_>) -> Result<()> {
        let n = joints.names.len();
        let lists = [&self.open, &self.pre_grasp, &self.closed, &self.closing_effort, &self.force_effort];
        if let Some(list) = lists.iter().find(|l| l.len() != n) {
            return Err(Error::value(
                format!("a grasp with {} values for {n} joints", list.len()),
                "give one per joint",
            ));
        }
        for (j, name) in joints.names.iter().enumerate() {
            let (low, high) = joints.limits[j];
            let (closing, force, cap) = (self.closing_effort[j], self.force_effort[j], joints.effort_caps[j]);
            for q in [self.open[j], self.pre_grasp[j], self.closed[j]] {
                if !(q >= low && q <= high) {
                    return Err(Error::value(
                        format!("joint {name} at {q} rad in a grasp"),
                        format!("stay from {low:.3} to {high:.3} rad"),
                    ));
                }
            }
            if !(closing > 0.0 && closing <= cap && force >= 0.0 && force <= cap) {
                let unit = match joints.effort_unit {
                    EffortUnit::Milliampere => "mA",
                    EffortUnit::NewtonMetre => "N m",
                };
                return Err(Error::value(
                    format!("joint {name} closing with {closing} {unit} and pressing with {force} {unit}"),
                    format!("give more than 0 for closing, at least 0 for pressing, and at most {cap} {unit}"),
                ));
            }
        }
        if !(0..n).any(|j| self.way(j) != 0.0) {
            return Err(Error::value("a grasp in which no joint closes", "give closed angles beyond the pre-grasp"));
        }
        let above_zero = [
            ("stiffness", self.stiffness),
            ("speed_rad_per_s", self.speed_rad_per_s),
            ("closing_rad_per_s", self.closing_rad_per_s),
            ("effort_rate", self.effort_rate),
            ("contact_share", self.contact_share),
            ("contact_rad_per_s", self.contact_rad_per_s),
            ("contact_s", self.contact_s),
            ("slip_rad", self.slip_rad),
            ("settle_s", self.settle_s),
        ];
        if let Some((name, value)) = above_zero.into_iter().find(|(_, v)| !(*v > 0.0 && v.is_finite())) {
            return Err(Error::value(format!("a grasp with {name} {value}"), "give a finite number above zero"));
        }
        if let Some(hold) = self.hold_s.filter(|s| !(*s >= 0.0)) {
            return Err(Error::value(format!("a grasp held for {hold} s"), "give zero or more"));
        }
        Ok(())
    }
}

/// What a grasp is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum GraspPhase {
    /// To the open pose.
    Open,
    /// To the pose before the fingers close.
    PreGrasp,
    /// Until the fingers touch.
    Close,
    /// From the closing effort to the force.
    Ramp,
    /// With the force.
    Hold,
    /// Back to the closing effort, and to the open pose.
    Release,
    /// Open again.
    Done,
}

impl GraspPhase {
    /// All of them, in their order.
    pub const ALL: [Self; 7] =
        [Self::Open, Self::PreGrasp, Self::Close, Self::Ramp, Self::Hold, Self::Release, Self::Done];

    /// Name in the telemetry.
    pub fn name(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::PreGrasp => "pre_grasp",
            Self::Close => "close",
            Self::Ramp => "ramp",
            Self::Hold => "hold",
            Self::Release => "release",
            Self::Done => "done",
        }
    }
}

/// Where a joint met the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspContact {
    /// Time since the first cycle, s.
    pub time_s: f64,
    /// Angle, rad.
    pub position: f64,
    /// Largest effort that the position loop asks for before the joint's range ends; below the force's limit the grasp is weaker than
    /// wanted.
    pub reachable_effort: f64,
}

/// What became of a grasp; lists in the order of the joints.
#[derive(Debug, Clone, PartialEq, Default)]
#[non_exhaustive]
pub struct GraspOutcome {
    /// Joints that touched.
    pub contacts: Vec<Option<GraspContact>>,
    /// Whether too few joints touched: then the hand did not press, and opened again.
    pub missed: bool,
    /// Whether too few joints kept their contact while they held: then the hand opened.
    pub lost: bool,
    /// Mean effort while holding, positive where joints close; zero for joints that did not touch.
    pub held_effort: Vec<f64>,
    /// When each of [`GraspPhase::ALL`] began, s since the first cycle.
    pub began_s: [Option<f64>; 7],
}

impl GraspOutcome {
    pub(super) fn new(joints: usize) -> Self {
        Self { contacts: vec![None; joints], held_effort: vec![0.0; joints], ..Self::default() }
    }

    /// Takes the efforts of a cycle, the `n`th of the hold, into their mean.
    pub(super) fn hold(&mut self, plan: &GraspPlan, state: &HandState, n: u64) {
        for (j, mean) in self.held_effort.iter_mut().enumerate() {
            if self.contacts[j].is_some() {
                *mean += (state.effort[j] * plan.way(j) - *mean) / n as f64;
            }
        }
    }
}
