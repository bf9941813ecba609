//! A stream of frames.

use drex_core::Pose;
use drex_demo::{FrameFlag, HandFrame, HumanFinger, KeyPoints, canonical, transformed};
use nalgebra::Point3;

use super::{RetargetOptions, Scale};
use crate::frame_checks::{FrameMonitor, valid_points};
use crate::kinematics::Chains;
use crate::measurements::HandMeasurements;
use crate::objective::{
    FrameProblem, Projection, dexpilot, dexpilot_terms, position, position_target, position_terms, tip_target, vector,
    vector_terms,
};
use crate::scale::{NOMINAL_LENGTH_M, hand_reach_m};
use crate::solve::{EXACT, Newton, Problem, State, Unknowns};
use crate::{Error, FingerResidual, Objective, Result, RetargetedFrame, ScaleReport, TargetHand};

/// Retargets frame by frame.
///
/// ```
/// use drex_demo::{HandFrame, KEYPOINTS};
/// use drex_retarget::{Objective, RetargetOptions, Retargeter, TargetHand};
/// use nalgebra::Point3;
///
/// let hand = TargetHand::bundled("leap_right")?;
/// let mut retargeter = Retargeter::new(&hand, RetargetOptions::new(Objective::DexPilot))?;
/// // A flat right hand: wrist at the origin, five fingers along z, the thumb's side along y, the palm towards x.
/// let points = std::array::from_fn::<_, KEYPOINTS, _>(|i| {
///     let (finger, joint) = ((i + 3) / 4, (i + 3) % 4);
///     let along = if i == 0 { 0.0 } else { 0.09 + 0.03 * joint as f64 };
///     Some(Point3::new(0.0, if i == 0 { 0.0 } else { 0.06 - 0.02 * finger as f64 }, along))
/// });
/// let frame = retargeter.frame(&HandFrame::new(0.0, points));
/// assert!(frame.flags.is_empty());
/// for (joint, angle) in hand.robot.joints.iter().zip(&frame.q_filtered) {
///     println!("{} {angle:.3} rad", joint.name);
/// }
/// # Ok::<(), drex_retarget::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Retargeter {
    options: RetargetOptions,
    hand: TargetHand,
    fingers: Vec<HumanFinger>,
    pub(crate) problem: FrameProblem,
    solver: Newton,
    /// Joints in the middle of their ranges.
    start: State,
    /// Unknowns that move the thumb.
    thumb: Vec<usize>,
    hand_reach_m: f64,
    /// Automatic scale over what the reaches alone give; found on a sequence.
    pub(crate) refinement: f64,
    measurements: HandMeasurements,
    /// Whether more frames would change the hand's length.
    measured: bool,
    memory: Memory,
}

/// Another minimum is taken where its value is below this part of the warm start's: the thumb must not flicker.
const CLEARLY_BETTER: f64 = 0.999;
/// Last step (rad, m) of a solution that is only compared.
const ROUGH: f64 = 1e-2;

/// What a frame leaves to the next.
#[derive(Debug, Clone, Default)]
struct Memory {
    /// Frames so far.
    solved: usize,
    state: Option<State>,
    base: Option<Pose>,
    filtered: Option<Vec<f64>>,
    projection: Projection,
    monitor: FrameMonitor,
}

/// A stream measures the human hand in this many frames.
const MEASURED_FRAMES: usize = 30;

impl Retargeter {
    /// Prepares `hand`.
    ///
    /// # Errors
    /// If an option makes no sense, the objective needs a whole sequence, or the hand has no fingers that joints move, a finger
    /// twice, or (`dexpilot`) no thumb first.
    pub fn new(hand: &TargetHand, options: RetargetOptions) -> Result<Self> {
        options.check()?;
        let loss = match options.objective {
            Objective::Vector => vector::LOSS,
            Objective::DexPilot => dexpilot::LOSS,
            Objective::Position => position::LOSS,
            Objective::Grasp => {
                return Err(Error::value(
                    "the objective \"grasp\" is no objective of single frames",
                    "retarget the whole sequence with it, or use vector, dexpilot or position",
                ));
            }
        };
        let fingers: Vec<_> = hand.fingers.iter().map(|f| f.human).collect();
        check_fingers(&fingers, options.objective)?;
        let floating = options.objective == Objective::Position;
        let mut points: Vec<_> = hand.fingers.iter().map(|f| (f.tip.link, f.tip.point)).collect();
        if floating {
            points.extend(hand.fingers.iter().map(|f| (f.middle.link, f.middle.point)));
        }
        let unknowns = Unknowns::new(&hand.robot, &finger_joints(hand), floating);
        if unknowns.joints.is_empty() {
            return Err(Error::value(
                format!("no joint of robot \"{}\" moves a mapped fingertip", hand.robot.name),
                "map the links at the ends of the fingers",
            ));
        }
        let start = start(hand, &unknowns);
        let chains = Chains::new(&hand.robot, &points);
        let hand_reach_m = hand_reach_m(hand, &chains, &Unknowns { floating: false, ..unknowns.clone() }, &start);
        let thumb = hand.fingers.iter().filter(|f| f.human == HumanFinger::Thumb).flat_map(|f| &f.joints);
        let thumb = thumb.filter_map(|j| unknowns.joints.iter().position(|u| u == j)).collect();
        let problem = FrameProblem::new(chains, unknowns, loss, options.norm_delta, start.clone());
        Ok(Self {
            options,
            hand: hand.clone(),
            fingers,
            problem,
            solver: Newton::default(),
            start,
            thumb,
            hand_reach_m,
            refinement: 1.0,
            measurements: HandMeasurements::new(hand.side),
            measured: false,
            memory: Memory::default(),
        })
    }

    /// Forgets the frames so far: the next one starts in the middle of the joints' ranges, without filter and pinches. The
    /// person's size stays.
    pub fn reset(&mut self) {
        self.memory = Memory::default();
    }

    /// The scale that the next frame would use; `None` before the hand was measured.
    pub fn scale(&self) -> Option<ScaleReport> {
        let human_reach_m = self.measurements.hand_length_m();
        let (scale, automatic) = match self.options.scale {
            Scale::Fixed(s) => (s, false),
            Scale::Auto => (self.refinement * self.hand_reach_m / human_reach_m?, true),
        };
        Some(ScaleReport {
            scale,
            automatic,
            human_reach_m: human_reach_m.unwrap_or(0.0),
            hand_reach_m: self.hand_reach_m,
        })
    }

    /// Retargets the next frame, the points of a hand of [`TargetHand::side`].
    ///
    /// A frame that is no hand repeats the joint vector before (flag [`FrameFlag::NoHand`], objective NaN).
    pub fn frame(&mut self, frame: &HandFrame) -> RetargetedFrame {
        let (points, missing) = valid_points(&frame.points);
        if !self.measured {
            self.measurements.add(&points);
            self.measured = self.measurements.frames() >= MEASURED_FRAMES;
        }
        match self.solve(&points, missing) {
            Ok(solved) => self.finish(frame.t_s, solved),
            Err(reason) => self.repeat(frame.t_s, missing, reason),
        }
    }

    /// The same for `vector` and the automatic scale, with the human measures.
    pub(crate) fn probe(&self) -> Result<Self> {
        let mut options = RetargetOptions::new(Objective::Vector);
        options.thumb_guesses = 0;
        let mut probe = Self::new(&self.hand, options)?;
        probe.measure(self.measurements.clone());
        Ok(probe)
    }

    /// Takes the human measures instead of measuring the first frames.
    pub(crate) fn measure(&mut self, measurements: HandMeasurements) {
        self.measurements = measurements;
        self.measured = true;
    }

    /// Sets the terms of a frame.
    pub(crate) fn set_targets(&mut self, points: &KeyPoints) -> Result<FrameTargets, String> {
        let source_from_operator = self.measurements.operator_frame(points).map_err(|e| e.to_string())?;
        let scale = self.scale().ok_or("the length of no finger from wrist to tip is known yet")?.scale;
        let in_operator =
            canonical(points, self.hand.side).unwrap_or_else(|_| transformed(points, &source_from_operator.inverse()));
        // Automatic: a human hand of nominal size, and the rest of the scale.
        let to_nominal = match (self.options.scale, self.measurements.hand_length_m()) {
            (Scale::Auto, Some(length)) => NOMINAL_LENGTH_M / length,
            _ => 1.0,
        };
        let nominal = in_operator.map(|p| p.map(|p| p * to_nominal));
        let rest = scale / to_nominal;
        let base_from_operator = &self.hand.base_from_operator;
        let terms = &mut self.problem.terms;
        match self.options.objective {
            Objective::DexPilot => {
                let projection = &mut self.memory.projection;
                dexpilot_terms(terms, projection, &self.fingers, &nominal, base_from_operator, rest);
            }
            Objective::Position => {
                position_terms(terms, &self.fingers, points, &source_from_operator.translation.vector, scale)
            }
            _ => vector_terms(terms, &self.fingers, &nominal, base_from_operator, rest),
        }
        if terms.is_empty() {
            return Err("no fingertip was seen".into());
        }
        let target = |finger: &HumanFinger| match self.problem.unknowns.floating {
            true => Some(position_target(&points[finger.tip()]?, &source_from_operator.translation.vector, scale)),
            false => Some(Point3::from(tip_target(&nominal[finger.tip()]?.coords, base_from_operator, rest))),
        };
        Ok(FrameTargets {
            tips: self.fingers.iter().map(target).collect(),
            source_from_base: source_from_operator * base_from_operator.inverse(),
            in_operator,
        })
    }

    fn solve(&mut self, points: &KeyPoints, missing: usize) -> Result<Solved, String> {
        let targets = self.set_targets(points)?;
        let mut flags = Vec::new();
        self.memory.monitor.check(&targets.in_operator, missing, self.measurements.hand_length_m(), &mut flags);
        let floating = self.problem.unknowns.floating;
        let mut state = self.memory.state.take().unwrap_or_else(|| {
            let base = if floating { targets.source_from_base } else { Pose::identity() };
            State { base, q: self.start.q.clone() }
        });
        self.problem.previous.clone_from(&state);
        let iterations = self.options.iterations;
        let best = self.solver.minimise(&mut self.problem, &mut state, EXACT, iterations);
        if let Some(mut other) = self.other_minimum(&state, best) {
            self.solver.minimise(&mut self.problem, &mut other, EXACT, iterations);
            state = other;
        }
        self.memory.solved += 1;
        self.problem.value(&state);
        let residual = |(i, (&finger, target)): (usize, (_, &Option<Point3<f64>>))| FingerResidual {
            finger,
            residual_mm: target.map(|t| 1e3 * (self.problem.point(i) - t).norm()),
        };
        Ok(Solved {
            base: if floating { state.base } else { targets.source_from_base },
            objective: self.problem.objective(),
            residuals: self.fingers.iter().zip(&targets.tips).enumerate().map(residual).collect(),
            state,
            flags,
        })
    }

    /// A minimum of the frame, found from another place of the thumb, that is clearly better than `best`, roughly.
    fn other_minimum(&mut self, state: &State, mut best: f64) -> Option<State> {
        let (starts, solved) = (self.options.thumb_guesses, self.memory.solved);
        // A first frame tries every other start, later ones one after the other.
        let tried = if solved == 0 { 0..starts } else { solved..solved + starts.min(1) };
        let mut found = None;
        let thumb = &self.thumb;
        let others = (0..self.problem.unknowns.len()).map(|k| !thumb.contains(&k)).collect();
        let none = std::mem::replace(&mut self.problem.unknowns.held, others);
        for start in tried {
            let mut other = state.clone();
            self.move_thumb(start % starts, &mut other.q);
            let value = self.solver.minimise(&mut self.problem, &mut other, ROUGH, self.options.iterations);
            if value < CLEARLY_BETTER * best {
                best = value;
                found = Some(other);
            }
        }
        self.problem.unknowns.held = none;
        found
    }

    /// Puts the thumb at start number `start`: first the middle of its joints' ranges, then places spread over them evenly
    /// (Halton's sequence).
    fn move_thumb(&self, start: usize, q: &mut [f64]) {
        for (&k, base) in self.thumb.iter().zip([2, 3, 5, 7].into_iter().cycle()) {
            let (lo, hi) = self.problem.unknowns.bounds[k];
            if (hi - lo).is_finite() {
                let part = if start == 0 { 0.5 } else { radical_inverse(start + 1, base) };
                self.problem.unknowns.set(k, lo + part * (hi - lo), q);
            }
        }
    }

    fn finish(&mut self, t_s: f64, solved: Solved) -> RetargetedFrame {
        let mut q = solved.state.q.clone();
        // Coupled joints reach their limits but for rounding.
        self.hand.robot.clamp_to_limits(&mut q);
        let alpha = self.options.low_pass_alpha;
        let mut filtered = self.memory.filtered.take().unwrap_or_else(|| q.clone());
        for (y, x) in filtered.iter_mut().zip(&q) {
            *y += alpha * (x - *y);
        }
        self.hand.robot.clamp_to_limits(&mut filtered);
        self.memory.filtered = Some(filtered.clone());
        self.memory.state = Some(solved.state);
        self.memory.base = Some(solved.base);
        RetargetedFrame {
            t_s,
            q,
            q_filtered: filtered,
            source_from_base: Some(solved.base),
            objective: solved.objective,
            fingers: solved.residuals,
            flags: solved.flags,
        }
    }

    /// A frame that is no hand.
    fn repeat(&mut self, t_s: f64, missing: usize, reason: String) -> RetargetedFrame {
        let q = self.memory.state.as_ref().map_or_else(|| self.start.q.clone(), |s| s.q.clone());
        let mut flags = vec![FrameFlag::NoHand { reason }];
        if missing > 0 {
            flags.push(FrameFlag::MissingPoints { count: missing });
        }
        RetargetedFrame {
            t_s,
            q_filtered: self.memory.filtered.clone().unwrap_or_else(|| q.clone()),
            q,
            source_from_base: self.memory.base,
            objective: f64::NAN,
            fingers: self.fingers.iter().map(|&finger| FingerResidual { finger, residual_mm: None }).collect(),
            flags,
        }
    }
}

/// Where a frame wants the hand.
pub(crate) struct FrameTargets {
    /// The fingertips, in the frame of the robot's base, or in the source frame if the base floats.
    tips: Vec<Option<Point3<f64>>>,
    /// From the human wrist.
    pub(crate) source_from_base: Pose,
    in_operator: KeyPoints,
}

/// A solved frame.
struct Solved {
    state: State,
    base: Pose,
    objective: f64,
    residuals: Vec<FingerResidual>,
    flags: Vec<FrameFlag>,
}

fn check_fingers(fingers: &[HumanFinger], objective: Objective) -> Result<()> {
    let twice = fingers.iter().enumerate().find(|(i, f)| fingers[..*i].contains(f));
    if let Some((_, finger)) = twice {
        return Err(Error::value(
            format!("two fingers of the robot follow the human {} finger", finger.name()),
            "map each of the human fingers once",
        ));
    }
    if objective == Objective::DexPilot && (fingers.len() < 2 || fingers[0] != HumanFinger::Thumb) {
        return Err(Error::value(
            "the objective \"dexpilot\" needs a thumb, mapped first, and another finger",
            "map a thumb, or use the objective \"vector\"",
        ));
    }
    Ok(())
}

/// Joints between palm and fingertips.
fn finger_joints(hand: &TargetHand) -> Vec<bool> {
    (0..hand.robot.dof()).map(|j| hand.fingers.iter().any(|f| f.joints.contains(&j))).collect()
}

/// Joints that are solved for in the middle of their bounds, the others at their reference positions.
fn start(hand: &TargetHand, unknowns: &Unknowns) -> State {
    let mut q = hand.robot.reference_position();
    hand.robot.clamp_to_limits(&mut q);
    for (k, &(lo, hi)) in unknowns.bounds.iter().enumerate() {
        let middle = 0.5 * (lo + hi);
        unknowns.set(k, if middle.is_finite() { middle } else { q[unknowns.joints[k]] }, &mut q);
    }
    State { base: Pose::identity(), q }
}

/// The digits of `n` in `base`, mirrored at the point.
fn radical_inverse(mut n: usize, base: usize) -> f64 {
    let (mut digit, mut value) = (1.0, 0.0);
    while n > 0 {
        digit /= base as f64;
        value += digit * (n % base) as f64;
        n /= base;
    }
    value
}
