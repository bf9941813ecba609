//! What is measured in a trial, and the first rule that it breaks.

use drex_core::Pose;
use drex_grasp::HandSurface;
use nalgebra::Vector3;

use crate::engine::{Met, Simulation, Touch};
use crate::outcome::{Outcome, SLIP_M, TABLE_N, TURN_RAD, Verdict};
use crate::timeline::{CLOSED_S, GRIPPED_S, HELD_S, LIFTED_S};

/// The rules.
const HEIGHT_M: f64 = 0.02;
const PENETRATION_M: f64 = 0.002;
const FINGERS: usize = 2;
/// A finger counts as touching from this smoothed force on, N: a contact that is gone for one step of a simulator is none that a hand lost.
const TOUCH_N: f64 = 0.01;
/// Time constant with which forces of fingers are smoothed, s: shorter peaks are the simulator's.
const SMOOTH_S: f64 = 0.01;
/// An object that nothing has held for this long is lost, s.
const LOST_S: f64 = 0.1;

/// Measures of a trial so far.
pub(crate) struct Watch<'a> {
    surface: &'a HandSurface,
    max_finger_n: Option<f64>,
    dt_s: f64,
    finger_n: Vec<f64>,
    slide: Vec<Vector3<f64>>,
    touches: Vec<Touch>,
    in_palm: Option<Pose>,
    lost_s: f64,
    held_ticks: usize,
    lift_ticks: usize,
    used: (f64, f64),
    /// Sum of the normal forces in the hold, summed over ticks, and the ticks.
    hold: (f64, usize),
    outcome: Outcome,
}

impl<'a> Watch<'a> {
    /// `dt_s` is the time between two looks.
    pub fn new(surface: &'a HandSurface, max_finger_n: Option<f64>, grip_force_n: f64, dt_s: f64) -> Self {
        let fingers = surface.fingers.len();
        Self {
            surface,
            max_finger_n,
            dt_s,
            finger_n: vec![0.0; fingers],
            slide: vec![Vector3::zeros(); fingers],
            touches: Vec::new(),
            in_palm: None,
            lost_s: 0.0,
            held_ticks: 0,
            lift_ticks: 0,
            used: (0.0, 0.0),
            hold: (0.0, 0),
            outcome: Outcome {
                verdict: Verdict::Success,
                failed_at_s: None,
                grip_force_n,
                held_n: None,
                peak_finger_n: 0.0,
                slip_m: 0.0,
                turn_rad: 0.0,
                penetration_m: 0.0,
                fingers_in_contact: vec![false; fingers],
                retained: 0.0,
                friction_used: None,
            },
        }
    }

    /// Normal force of each finger, smoothed, N.
    pub fn finger_n(&self) -> &[f64] {
        &self.finger_n
    }

    /// Whether no rule is broken so far.
    pub fn holds(&self) -> bool {
        self.outcome.failed_at_s.is_none()
    }

    /// Looks at the state after a step; false once nothing more can be learned.
    pub fn look(&mut self, t: f64, friction: f64, simulation: &Simulation) -> bool {
        let on_table = simulation.touches(&mut self.touches);
        self.forces(t);
        let count = self.finger_n.iter().filter(|f| **f > TOUCH_N).count();
        if (CLOSED_S..=GRIPPED_S).contains(&t) {
            self.outcome.fingers_in_contact = self.finger_n.iter().map(|f| *f > TOUCH_N).collect();
        }
        if t < GRIPPED_S {
            return true;
        }
        let in_palm = simulation.world_from_base().inverse() * simulation.world_from_object();
        let start = *self.in_palm.get_or_insert(in_palm);
        if self.lift_ticks == 0 && count < FINGERS {
            self.fail(Verdict::NoContact, t);
        }
        self.lift_ticks += 1;
        self.held_ticks += usize::from(count >= FINGERS);
        let sunk = (simulation.world_from_base().rotation * (in_palm.translation.vector - start.translation.vector)).z;
        self.outcome.turn_rad = self.outcome.turn_rad.max(start.rotation.angle_to(&in_palm.rotation));
        self.slides(friction, t);
        if (LIFTED_S..HELD_S).contains(&t) {
            self.hold.0 += self.touches.iter().filter(|c| c.with == Met::Object).map(|c| c.normal_n).sum::<f64>();
            self.hold.1 += 1;
        }
        self.lost_s = if count == 0 { self.lost_s + self.dt_s } else { 0.0 };
        if self.lost_s > LOST_S {
            self.fail(Verdict::Drop, t);
            return false;
        }
        if t >= LIFTED_S {
            if on_table || sunk.abs() > HEIGHT_M || self.outcome.slip_m > SLIP_M || self.outcome.turn_rad > TURN_RAD {
                self.fail(if on_table { Verdict::Drop } else { Verdict::Slip }, t);
            }
            if count < FINGERS {
                self.fail(Verdict::Slip, t);
            }
        }
        // Once it has slipped by centimetres only the rest of the fall would be seen.
        self.holds() || sunk.abs() < 2.0 * HEIGHT_M
    }

    /// What the trial came to.
    pub fn finish(mut self) -> Outcome {
        self.outcome.retained = self.held_ticks as f64 / self.lift_ticks.max(1) as f64;
        self.outcome.held_n = (self.hold.1 > 0).then(|| self.hold.0 / self.hold.1 as f64);
        self.outcome.friction_used = (self.used.1 > 0.0).then(|| self.used.0 / self.used.1);
        self.outcome
    }

    /// The trial breaks off.
    pub fn broke(mut self, t: f64) -> Outcome {
        self.fail(Verdict::Diverged, t);
        self.finish()
    }

    /// Smooths the normal force of each finger; evaluates forces and depths on the way.
    fn forces(&mut self, t: f64) {
        let mut fingers = vec![0.0; self.finger_n.len()];
        let (mut table_n, mut depth) = (0.0, 0.0_f64);
        for touch in &self.touches {
            match touch.with {
                Met::Table => table_n += touch.normal_n,
                Met::Object => {
                    depth = depth.max(touch.depth_m);
                    if let Some(f) = self.surface.finger_of_link[touch.link] {
                        fingers[f] += touch.normal_n;
                    }
                }
            }
        }
        let keep = (-self.dt_s / SMOOTH_S).exp();
        for (smoothed, now) in self.finger_n.iter_mut().zip(&fingers) {
            *smoothed = keep * *smoothed + (1.0 - keep) * now;
        }
        let peak = self.finger_n.iter().copied().fold(0.0, f64::max);
        self.outcome.peak_finger_n = self.outcome.peak_finger_n.max(peak);
        self.outcome.penetration_m = self.outcome.penetration_m.max(depth);
        if self.max_finger_n.is_some_and(|most| peak > most) {
            self.fail(Verdict::Crushed, t);
        }
        if table_n > TABLE_N {
            self.fail(Verdict::Table, t);
        }
        if depth > PENETRATION_M {
            self.fail(Verdict::Penetration, t);
        }
    }

    /// How far the object has slid over each finger, and how much of the friction is used.
    fn slides(&mut self, friction: f64, t: f64) {
        let mut load = vec![0.0; self.finger_n.len()];
        let mut slide = vec![Vector3::zeros(); self.finger_n.len()];
        for touch in self.touches.iter().filter(|c| c.with == Met::Object) {
            if let Some(f) = self.surface.finger_of_link[touch.link] {
                load[f] += touch.normal_n;
                slide[f] += touch.slide * touch.normal_n;
            }
            if t >= LIFTED_S && friction > 0.0 {
                self.used.0 += touch.tangential_n / friction;
                self.used.1 += touch.normal_n;
            }
        }
        for f in 0..load.len() {
            // Ways add up as vectors over all touches of a finger: one that slides forth and back has not lost the object.
            if load[f] > TOUCH_N {
                self.slide[f] += slide[f] * (self.dt_s / load[f]);
                self.outcome.slip_m = self.outcome.slip_m.max(self.slide[f].norm());
            }
        }
    }

    /// The first failure counts.
    fn fail(&mut self, verdict: Verdict, t: f64) {
        if self.outcome.failed_at_s.is_none() {
            self.outcome.verdict = verdict;
            self.outcome.failed_at_s = Some(t);
        }
    }
}
