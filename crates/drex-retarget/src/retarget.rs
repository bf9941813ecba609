//! Retargeting a stream of frames or a whole clip.

use drex_core::Pose;
use nalgebra::Point3;

use crate::flags::{Watch, canonical, clean};
use crate::kinematics::Chains;
use crate::objective::{
    FrameProblem, Projection, dexpilot, dexpilot_terms, position, position_terms, tip_target, vector,
    vector_terms,
};
use crate::scale::{BoneLengths, NOMINAL_LENGTH_M, hand_reach_m, refined};
use crate::solve::{Newton, Problem, State, Unknowns};
use crate::{
    Demonstration, FingerResidual, Flag, HandFrame, HumanFinger, KeyPoints, Objective, Result, RetargetError,
    RetargetedFrame, Retargeting, ScaleReport, TargetHand, operator_frame,
};

/// The factor on the person's vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// From the lengths of the person's bones and the robot's reach; over a clip ([`retarget`]) refined so that the fingertips'
    /// mean error in units of the scale is smallest. The person is brought to a nominal size first, so that the size and the
    /// unit of the key points do not matter.
    Auto,
    /// This one, on key points as they are.
    Fixed(f64),
}

/// How to retarget.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RetargetOptions {
    /// What is made small.
    pub objective: Objective,
    /// Factor on the person's vectors.
    pub scale: Scale,
    /// Part of the new joint vector in the filtered one, 0 to 1; 1 does not filter.
    pub low_pass_alpha: f64,
    /// Weight of the squared distance to the frame before (rad², m²).
    pub norm_delta: f64,
    /// Most steps of the solver per frame and start.
    pub iterations: usize,
}

impl RetargetOptions {
    /// What dex-retargeting uses with an objective, but for the scale: automatic, or 1 for `position`, whose output is not
    /// filtered either.
    pub fn new(objective: Objective) -> Self {
        let (scale, low_pass_alpha) = match objective {
            Objective::Position => (Scale::Fixed(1.0), 1.0),
            _ => (Scale::Auto, 0.2),
        };
        Self { objective, scale, low_pass_alpha, norm_delta: 4e-3, iterations: 100 }
    }

    fn check(&self) -> Result<()> {
        let wrong = |what: String, remedy| Err(RetargetError::value(what, remedy));
        if let Scale::Fixed(s) = self.scale
            && !(s > 0.0 && s.is_finite())
        {
            return wrong(format!("the scale {s} is not positive"), "give a positive factor or let it be found");
        }
        if !(self.low_pass_alpha > 0.0 && self.low_pass_alpha <= 1.0) {
            return wrong(
                format!("low_pass_alpha is {}", self.low_pass_alpha),
                "give a number above 0 (which would freeze the hand) and at most 1 (no filter)",
            );
        }
        if !(self.norm_delta >= 0.0 && self.norm_delta.is_finite()) {
            return wrong(format!("norm_delta is {}", self.norm_delta), "give 0 or a small positive number");
        }
        Ok(())
    }
}

impl Default for RetargetOptions {
    /// `vector` with automatic scale.
    fn default() -> Self {
        Self::new(Objective::Vector)
    }
}

/// Retargets frame by frame.
#[derive(Debug, Clone)]
pub struct Retargeter {
    options: RetargetOptions,
    hand: TargetHand,
    fingers: Vec<HumanFinger>,
    problem: FrameProblem,
    solver: Newton,
    /// Joints in the middle of their ranges.
    start: State,
    hand_reach_m: f64,
    /// Automatic scale over what the reaches alone give; found on a clip.
    pub(crate) refinement: f64,
    lengths: BoneLengths,
    /// Whether more frames would change the person's length.
    measured: bool,
    memory: Memory,
}

/// What a frame leaves to the next.
#[derive(Debug, Clone, Default)]
struct Memory {
    state: Option<State>,
    base: Option<Pose>,
    filtered: Option<Vec<f64>>,
    projection: Projection,
    watch: Watch,
}

/// A stream measures the person in this many frames.
const MEASURED_FRAMES: usize = 30;

impl Retargeter {
    /// Prepares `hand`.
    ///
    /// # Errors
    /// If an option makes no sense, the objective needs a whole clip, or the hand has no fingers that joints move, a finger
    /// twice, or (`dexpilot`) no thumb first.
    pub fn new(hand: &TargetHand, options: RetargetOptions) -> Result<Self> {
        options.check()?;
        let loss = match options.objective {
            Objective::Vector => vector::LOSS,
            Objective::DexPilot => dexpilot::LOSS,
            Objective::Position => position::LOSS,
            Objective::Grasp => {
                return Err(RetargetError::value(
                    "the objective \"grasp\" is no objective of single frames",
                    "retarget the whole clip with it, or use vector, dexpilot or position",
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
            return Err(RetargetError::value(
                format!("no joint of robot \"{}\" moves a mapped fingertip", hand.robot.name),
                "map the links at the ends of the fingers",
            ));
        }
        let start = start(hand, &unknowns);
        let chains = Chains::new(&hand.robot, &points);
        let hand_reach_m = hand_reach_m(hand, &chains, &Unknowns { floating: false, ..unknowns.clone() }, &start);
        let problem = FrameProblem::new(chains, unknowns, loss, options.norm_delta, start.clone());
        Ok(Self {
            options,
            hand: hand.clone(),
            fingers,
            problem,
            solver: Newton::default(),
            start,
            hand_reach_m,
            refinement: 1.0,
            lengths: BoneLengths::default(),
            measured: false,
            memory: Memory::default(),
        })
    }

    /// Forgets the frames so far: the next one starts in the middle of the joints' ranges, without filter and pinches. The
    /// person's size stays.
    pub fn reset(&mut self) {
        self.memory = Memory::default();
    }

    /// The scale that the next frame would use; `None` before the person was measured.
    pub fn scale(&self) -> Option<ScaleReport> {
        let person_reach_m = self.lengths.hand_length_m();
        let (scale, automatic) = match self.options.scale {
            Scale::Fixed(s) => (s, false),
            Scale::Auto => (self.refinement * self.hand_reach_m / person_reach_m?, true),
        };
        Some(ScaleReport {
            scale,
            automatic,
            person_reach_m: person_reach_m.unwrap_or(0.0),
            hand_reach_m: self.hand_reach_m,
        })
    }

    /// Retargets the next frame, the points of a hand of [`TargetHand::side`].
    ///
    /// A frame that is no hand repeats the joint vector before (flag [`Flag::NoHand`], objective NaN).
    pub fn frame(&mut self, frame: &HandFrame) -> RetargetedFrame {
        let (points, missing) = clean(&frame.points);
        if !self.measured {
            self.lengths.add(&points);
            self.measured = self.lengths.count() >= MEASURED_FRAMES;
        }
        match self.solve(&points, missing) {
            Ok(solved) => self.finish(frame.t_s, solved),
            Err(reason) => self.repeat(frame.t_s, missing, reason),
        }
    }

    /// The same for `vector` and the automatic scale, with the person's measures.
    pub(crate) fn probe(&self) -> Result<Self> {
        let mut probe = Self::new(&self.hand, RetargetOptions::new(Objective::Vector))?;
        probe.lengths = self.lengths.clone();
        probe.measured = true;
        Ok(probe)
    }

    fn solve(&mut self, points: &KeyPoints, missing: usize) -> Result<Solved, String> {
        let source_from_operator = operator_frame(points, self.hand.side).map_err(|e| e.to_string())?;
        let scale = self.scale().ok_or("the length of no finger from wrist to tip is known yet")?.scale;
        let in_operator = canonical(points, &source_from_operator);
        let length = self.lengths.hand_length_m();
        // Automatic: a person of nominal size, and the rest of the scale.
        let to_nominal = match (self.options.scale, length) {
            (Scale::Auto, Some(length)) => NOMINAL_LENGTH_M / length,
            _ => 1.0,
        };
        let person = in_operator.map(|p| p.map(|p| p * to_nominal));
        let rest = scale / to_nominal;
        let base_from_operator = &self.hand.base_from_operator;
        let terms = &mut self.problem.terms;
        match self.options.objective {
            Objective::DexPilot => {
                let projection = &mut self.memory.projection;
                dexpilot_terms(terms, projection, &self.fingers, &person, base_from_operator, rest);
            }
            Objective::Position => position_terms(terms, &self.fingers, points, scale),
            _ => vector_terms(terms, &self.fingers, &person, base_from_operator, rest),
        }
        if terms.is_empty() {
            return Err("no fingertip was seen".into());
        }
        let mut flags = Vec::new();
        self.memory.watch.look(&in_operator, missing, length, &mut flags);

        let source_from_base = source_from_operator * base_from_operator.inverse();
        let mut state = self.memory.state.take().unwrap_or_else(|| {
            let base = if self.problem.unknowns.floating { source_from_base } else { Pose::identity() };
            State { base, q: self.start.q.clone() }
        });
        self.problem.previous.clone_from(&state);
        self.solver.minimise(&mut self.problem, &mut state, self.options.iterations);
        self.problem.value(&state);
        let objective = self.problem.objective();
        let residuals = self.residuals(points, &person, rest, scale);
        let base = if self.problem.unknowns.floating { state.base } else { source_from_base };
        Ok(Solved { state, base, objective, residuals, flags })
    }

    /// Distances of the fingertips from where the person's are, scaled.
    fn residuals(&self, points: &KeyPoints, person: &KeyPoints, rest: f64, scale: f64) -> Vec<FingerResidual> {
        let residual = |(i, &finger): (usize, &HumanFinger)| {
            let target = match (self.problem.unknowns.floating, person[finger.tip()], points[finger.tip()]) {
                (true, _, Some(tip)) => points[0].map(|wrist| wrist + (tip - wrist) * scale),
                (false, Some(tip), _) => {
                    Some(Point3::from(tip_target(&tip.coords, &self.hand.base_from_operator, rest)))
                }
                _ => None,
            };
            let residual_mm = target.map(|t| 1e3 * (self.problem.point(i) - t).norm());
            FingerResidual { finger, residual_mm }
        };
        self.fingers.iter().enumerate().map(residual).collect()
    }

    fn finish(&mut self, t_s: f64, solved: Solved) -> RetargetedFrame {
        let q = solved.state.q.clone();
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
        let mut flags = vec![Flag::NoHand { reason }];
        if missing > 0 {
            flags.push(Flag::MissingPoints { count: missing });
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

/// A solved frame.
struct Solved {
    state: State,
    base: Pose,
    objective: f64,
    residuals: Vec<FingerResidual>,
    flags: Vec<Flag>,
}

/// Retargets a clip frame by frame; the same as a [`Retargeter`] but for the automatic scale, which is that of the whole clip.
///
/// # Errors
/// As [`Retargeter::new`]; if the demonstration is of the other hand; if the automatic scale finds no frame to measure.
pub fn retarget(demonstration: &Demonstration, hand: &TargetHand, options: &RetargetOptions) -> Result<Retargeting> {
    if demonstration.side != hand.side {
        return Err(RetargetError::value(
            format!(
                "{}: a {} hand cannot be retargeted to \"{}\", a {} hand",
                demonstration.source,
                demonstration.side.name(),
                hand.robot.name,
                hand.side.name()
            ),
            "use the mirrored model of the robot, or mirror the key points",
        ));
    }
    let mut retargeter = Retargeter::new(hand, options.clone())?;
    retargeter.lengths = BoneLengths::of(&demonstration.frames);
    retargeter.measured = true;
    if options.scale == Scale::Auto {
        retargeter.refinement = refined(&retargeter, &demonstration.frames)?;
    }
    let Some(scale) = retargeter.scale() else {
        return Err(RetargetError::value(
            format!("{}: no frame shows a finger from wrist to tip", demonstration.source),
            "give the scale as a number, or repair the key points",
        ));
    };
    let frames = demonstration.frames.iter().map(|f| retargeter.frame(f)).collect();
    Ok(Retargeting {
        joint_names: hand.robot.joints.iter().map(|j| j.name.clone()).collect(),
        objective: options.objective,
        scale,
        frames,
    })
}

fn check_fingers(fingers: &[HumanFinger], objective: Objective) -> Result<()> {
    let twice = fingers.iter().enumerate().find(|(i, f)| fingers[..*i].contains(f));
    if let Some((_, finger)) = twice {
        return Err(RetargetError::value(
            format!("two fingers of the robot follow the person's {} finger", finger.name()),
            "map each of the person's fingers once",
        ));
    }
    if objective == Objective::DexPilot && (fingers.len() < 2 || fingers[0] != HumanFinger::Thumb) {
        return Err(RetargetError::value(
            "the objective \"dexpilot\" needs a thumb, mapped first, and another finger",
            "map a thumb, or use the objective \"vector\"",
        ));
    }
    Ok(())
}

/// Joints that move some of the fingertips. Those that move all of several (an arm, a wrist) stay where they are: the operator
/// frame is that of the hand behind them.
fn finger_joints(hand: &TargetHand) -> Vec<bool> {
    let robot = &hand.robot;
    let mut movers = vec![0; robot.dof()];
    for finger in &hand.fingers {
        for link in robot.path_to(finger.tip.link) {
            for &j in &robot.links[link].joints {
                movers[j] += 1;
            }
        }
    }
    let fingers = hand.fingers.len();
    movers.iter().map(|&n| n > 0 && (n < fingers || fingers == 1)).collect()
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
