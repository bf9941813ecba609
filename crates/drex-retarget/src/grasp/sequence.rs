//! The order in which the frames of a sequence are solved.
//!
//! Joint speeds bound how far apart two frames can be: every frame is solved within what the frames solved before it allow, on both
//! sides (an interval per joint that is never empty), from its best frame outwards.

use drex_core::{Object, Pose, SignedDistance};
use drex_demo::{Demonstration, HumanFinger};
use nalgebra::{Point3, Translation3, Vector3};

use super::GraspOptions;
use super::goals::{self, Goals};
use super::hand::GraspHand;
use super::phases::GraspPhase;
use super::terms::{Problem, View};
use crate::levenberg_marquardt::{HandState, minimise};

/// Effort: wrist alone, first solution, later solution.
const STEPS: (usize, usize, usize) = (8, 15, 8);
/// Nearly all of the allowed speed.
const SPEED_SHARE: f64 = 0.98;
/// One unit of distance of a pad from its goal, m: wrist alone, then all.
const GOAL_UNITS_M: (f64, f64, f64) = (0.003, 0.006, 0.003);
/// A finger with a larger gap than this after the first solution lets go, m.
const LETS_GO_M: f64 = 0.006;
/// Gap that is good enough not to try another start, m.
const GOOD_M: f64 = 0.003;

/// A frame without contact is out of every collision when it is no deeper than this, m.
const CLEAN_M: f64 = 0.0005;

/// Contacts this upright (see [`View::upright`]) do not slip, and what others cost.
const UPRIGHT: f64 = 0.93;
const SLIP_COST: f64 = 1200.0;

/// A solved frame.
#[derive(Debug, Clone)]
pub(crate) struct SolvedFrame {
    pub(crate) state: HandState,
    pub(crate) held: bool,
    /// Fingers that were drawn to the surface.
    pub(crate) target_weights: Vec<f64>,
    goals: Vec<Point3<f64>>,
}

struct Sequence<'a> {
    hand: &'a GraspHand<'a>,
    object: &'a dyn SignedDistance,
    bounds: (Point3<f64>, Point3<f64>),
    poses: &'a [Pose],
    references: &'a [HandState],
    /// Middle between the human thumb and fingers, object frame.
    centers: Vec<Point3<f64>>,
    times: Vec<f64>,
    limits: Vec<(f64, f64)>,
    options: &'a GraspOptions,
    solved: Vec<Option<SolvedFrame>>,
}

pub(crate) fn solve(
    hand: &GraspHand<'_>,
    object: &Object,
    demo: &Demonstration,
    poses: &[Pose],
    references: &[HandState],
    phases: &[GraspPhase],
    options: &GraspOptions,
) -> Vec<SolvedFrame> {
    let limits = joint_limits(hand);
    let times = demo.frames.iter().map(|f| f.t_s).collect();
    let mut sequence = Sequence {
        hand,
        object: &*object.geometry,
        bounds: object.geometry.bounding_box(),
        poses,
        references,
        centers: centers(demo, poses, hand),
        times,
        limits,
        options,
        solved: vec![None; references.len()],
    };
    for phase in phases {
        sequence.solve_held(phase, phase.best, None);
        for t in phase.best + 1..phase.frames.end {
            sequence.solve_held(phase, t, Some(t - 1));
        }
        for t in (phase.frames.start..phase.best).rev() {
            sequence.solve_held(phase, t, Some(t + 1));
        }
    }
    for t in (0..references.len()).rev() {
        sequence.solve_free(t);
    }
    for t in 0..references.len() {
        sequence.refine(t);
    }
    // Both ways, so that a good grasp spreads over the frames on both sides of it.
    for t in (1..references.len()).rev() {
        sequence.adopt_neighbour(t - 1, t);
    }
    for t in 1..references.len() {
        sequence.adopt_neighbour(t, t - 1);
    }
    sequence.solved.into_iter().flatten().collect()
}

/// Solves a grasp on its own that begins at `start` and stays close to it.
pub(crate) fn single(
    hand: &GraspHand<'_>,
    object: &Object,
    start: &HandState,
    mut target_weights: Vec<f64>,
    options: &GraspOptions,
) -> SolvedFrame {
    let limits = joint_limits(hand);
    let posed = hand.posed(&start.q, &start.object_from_base);
    let tips: Vec<Point3<f64>> = hand.fingers.iter().map(|p| p.tip(&posed)).collect();
    let middle = middle(&tips, hand.thumb);
    let Goals { points: goals, reached, .. } = goals::goals(&*object.geometry, middle, &tips, hand.thumb);
    drop_unreachable(hand, options, &reached, &mut target_weights);
    let mut state = start.clone();
    let problem = Problem {
        hand,
        object: &*object.geometry,
        bounds: &object.geometry.bounding_box(),
        reference: start,
        target_weights: &target_weights,
        goals: &goals,
        goal_unit_m: GOAL_UNITS_M.1,
        fades: false,
        beside: &[],
        intervals: &limits,
        joints_move: true,
    };
    minimise(&problem, &mut state, STEPS.1);
    SolvedFrame { state, held: true, target_weights, goals }
}

impl Sequence<'_> {
    /// Frame `t` with everything moving.
    fn problem<'s>(
        &'s self,
        t: usize,
        target_weights: &'s [f64],
        goals: &'s [Point3<f64>],
        beside: &'s [HandState],
        intervals: &'s [(f64, f64)],
    ) -> Problem<'s> {
        Problem {
            hand: self.hand,
            object: self.object,
            bounds: &self.bounds,
            reference: &self.references[t],
            target_weights,
            fades: false,
            goals,
            goal_unit_m: GOAL_UNITS_M.1,
            beside,
            intervals,
            joints_move: true,
        }
    }

    /// What the solved frames nearest on both sides leave for each joint of frame `t`.
    fn intervals(&self, t: usize) -> Vec<(f64, f64)> {
        let before = (0..t).rev().find(|&s| self.solved[s].is_some());
        let after = (t + 1..self.solved.len()).find(|&s| self.solved[s].is_some());
        let mut intervals = self.limits.clone();
        for s in [before, after].into_iter().flatten() {
            let Some(planned) = &self.solved[s] else { continue };
            let most = (self.times[t] - self.times[s]).abs() * self.options.max_joint_speed * SPEED_SHARE;
            for (interval, q) in intervals.iter_mut().zip(&planned.state.q) {
                interval.0 = interval.0.max(q - most);
                interval.1 = interval.1.min(q + most);
            }
        }
        intervals
    }

    /// Solves a held frame for the first time, beside frame `from` if that is solved.
    fn solve_held(&mut self, phase: &GraspPhase, t: usize, from: Option<usize>) {
        let intervals = self.intervals(t);
        let mut target_weights: Vec<f64> = phase.fingers.iter().map(|w| f64::from(u8::from(*w))).collect();
        let beside: Vec<HandState> = from.and_then(|s| self.carried(s, t)).into_iter().collect();
        let (enclosing, Goals { points: goals, reached, .. }) = self.enclosing(t);
        drop_unreachable(self.hand, self.options, &reached, &mut target_weights);
        let mut best: Option<(f64, HandState, View)> = None;
        let mut starts: Vec<Option<HandState>> = Vec::new();
        if let Some(s) = beside.first() {
            starts.push(Some(s.clone()));
        }
        starts.push(None);
        for start in starts {
            let fresh = start.is_none();
            let mut state = start.unwrap_or_else(|| enclosing.clone());
            clamp(&mut state.q, &intervals);
            let mut problem = self.problem(t, &target_weights, &goals, &[], &intervals);
            if fresh {
                (problem.goal_unit_m, problem.joints_move) = (GOAL_UNITS_M.0, false);
                minimise(&problem, &mut state, STEPS.0);
                (problem.goal_unit_m, problem.joints_move) = (GOAL_UNITS_M.1, true);
            }
            problem.fades = true;
            let view = minimise(&problem, &mut state, STEPS.1).1;
            let good = self.good(&view) && self.close(t, &state);
            let score = score(&view);
            if best.as_ref().is_none_or(|b| score < b.0) {
                best = Some((score, state, view));
            }
            if good {
                break;
            }
        }
        let Some((_, mut state, view)) = best else { return };
        self.release(&view, &mut target_weights);
        let problem = self.problem(t, &target_weights, &goals, &beside, &intervals);
        minimise(&problem, &mut state, STEPS.2);
        self.solved[t] = Some(SolvedFrame { state, held: true, target_weights, goals });
    }

    /// A frame without contact follows the human hand, kept out of the object.
    fn solve_free(&mut self, t: usize) {
        if self.solved[t].is_some() {
            return;
        }
        let intervals = self.intervals(t);
        let target_weights = vec![0.0; self.hand.fingers.len()];
        let problem = self.problem(t, &target_weights, &[], &[], &intervals);
        // Where the human pose does not lead out of a collision, those of the frames beside it may.
        let beside = self.beside(t).rev().filter_map(|s| self.carried(s, t));
        let mut best: Option<(View, HandState)> = None;
        for start in std::iter::once(self.references[t].clone()).chain(beside) {
            let mut state = start;
            clamp(&mut state.q, &intervals);
            let view = minimise(&problem, &mut state, STEPS.1).1;
            let clean = view.deepest_m <= CLEAN_M;
            if best.as_ref().is_none_or(|b| view.cost < b.0.cost) {
                best = Some((view, state));
            }
            if clean {
                break;
            }
        }
        let Some((_, state)) = best else { return };
        self.solved[t] = Some(SolvedFrame { state, held: false, target_weights, goals: Vec::new() });
    }

    /// Solves a held frame again between its neighbours.
    fn refine(&mut self, t: usize) {
        let Some(mut planned) = self.solved[t].take() else { return };
        if planned.held {
            let intervals = self.intervals(t);
            let beside = self.held_beside(t);
            let mut problem = self.problem(t, &planned.target_weights, &planned.goals, &beside, &intervals);
            let view = minimise(&problem, &mut planned.state, STEPS.2).1;
            if view.upright < UPRIGHT {
                problem.goal_unit_m = GOAL_UNITS_M.2;
                let mut firm = planned.state.clone();
                if minimise(&problem, &mut firm, STEPS.2).1.upright > view.upright {
                    planned.state = firm;
                }
            }
        }
        self.solved[t] = Some(planned);
    }

    /// A held frame whose contacts would slip takes over the grasp of frame `from` beside it, on the object or with respect to the
    /// person, if that is better here.
    fn adopt_neighbour(&mut self, t: usize, from: usize) {
        let Some(planned) = self.solved[t].take() else { return };
        let mut best = planned.clone();
        if planned.held {
            let intervals = self.intervals(t);
            let beside = self.held_beside(t);
            let solve = |state: &mut HandState, target_weights: &[f64], goals: &[Point3<f64>], steps: usize| {
                let problem = self.problem(t, target_weights, goals, &beside, &intervals);
                minimise(&problem, state, steps).1
            };
            let view = solve(&mut best.state.clone(), &planned.target_weights, &planned.goals, 0);
            if view.upright < UPRIGHT
                && let Some(other) = self.solved[from].as_ref().filter(|p| p.held)
            {
                let mut least = score(&view);
                for start in [Some(other.state.clone()), self.carried(from, t)].into_iter().flatten() {
                    let mut state = start;
                    clamp(&mut state.q, &intervals);
                    let view = solve(&mut state, &other.target_weights, &other.goals, STEPS.2);
                    if score(&view) < least {
                        least = score(&view);
                        best = SolvedFrame { state, ..other.clone() };
                    }
                }
            }
        }
        self.solved[t] = Some(best);
    }

    /// The frames next to frame `t`: one at the ends of the sequence, none in a sequence of one frame.
    fn beside(&self, t: usize) -> impl DoubleEndedIterator<Item = usize> {
        [t.checked_sub(1), (t + 1 < self.solved.len()).then_some(t + 1)].into_iter().flatten()
    }

    /// The held ones of the frames next to frame `t`, as frame `t` would have them.
    fn held_beside(&self, t: usize) -> Vec<HandState> {
        let held = |s: &usize| self.solved[*s].as_ref().is_some_and(|p| p.held);
        self.beside(t).filter(held).filter_map(|s| self.carried(s, t)).collect()
    }

    /// The solution of frame `s` as frame `t` would have it: the same joints, and the wrist as far from the human hand's.
    fn carried(&self, s: usize, t: usize) -> Option<HandState> {
        let planned = self.solved[s].as_ref()?;
        let (from, to) =
            (self.poses[s] * self.references[s].object_from_base, self.poses[t] * self.references[t].object_from_base);
        let there = self.poses[s] * planned.state.object_from_base;
        let shift = there.translation.vector - from.translation.vector;
        let turn = there.rotation * from.rotation.inverse();
        let source_from_base = Pose::from_parts(Translation3::from(to.translation.vector + shift), turn * to.rotation);
        Some(HandState { object_from_base: self.poses[t].inverse() * source_from_base, q: planned.state.q.clone() })
    }

    /// The human pose, shifted so that the middle between thumb and fingers is inside the object, and where the fingers belong.
    fn enclosing(&self, t: usize) -> (HandState, Goals) {
        let mut state = self.references[t].clone();
        let posed = self.hand.posed(&state.q, &state.object_from_base);
        let tips: Vec<Point3<f64>> = self.hand.fingers.iter().map(|p| p.tip(&posed)).collect();
        let middle = middle(&tips, self.hand.thumb);
        let goals = goals::goals(self.object, self.centers[t], &tips, self.hand.thumb);
        state.object_from_base.translation.vector += goals.middle - middle;
        (state, goals)
    }

    /// Whether enough fingers are on the surface and do not slip.
    fn good(&self, view: &View) -> bool {
        let on = |f: usize| view.gaps[f] < GOOD_M && view.tip_gaps[f] < self.options.limits.touch_gap_m;
        let others = (0..view.gaps.len()).filter(|&f| f != self.hand.thumb && on(f)).count();
        view.upright > UPRIGHT && on(self.hand.thumb) && others >= self.options.limits.min_fingers
    }

    /// Whether the state is well within what an accepted frame may be away from the human hand.
    fn close(&self, t: usize, state: &HandState) -> bool {
        let reference = &self.references[t];
        let apart: f64 = state.q.iter().zip(&reference.q).map(|(a, b)| (a - b).abs()).sum();
        let shift = (state.object_from_base.translation.vector - reference.object_from_base.translation.vector).norm();
        apart < 0.8 * self.options.max_joint_distance_rad * state.q.len() as f64
            && shift < 0.9 * self.options.max_wrist_shift_m
    }

    /// Fingers that stay off the surface are no longer drawn to it, but for the thumb and the nearest others.
    fn release(&self, view: &View, target_weights: &mut [f64]) {
        let miss = |f: usize| view.gaps[f].max(view.tip_gaps[f] - 0.003);
        let mut others: Vec<usize> =
            (0..target_weights.len()).filter(|&f| f != self.hand.thumb && target_weights[f] > 0.0).collect();
        others.sort_by(|&a, &b| miss(a).total_cmp(&miss(b)));
        for (rank, f) in others.into_iter().enumerate() {
            if rank >= self.options.limits.min_fingers && miss(f) > LETS_GO_M {
                target_weights[f] = 0.0;
            }
        }
    }
}

/// Cost of a held frame, with what contacts that slip cost.
fn score(view: &View) -> f64 {
    view.cost + SLIP_COST * (UPRIGHT - view.upright).max(0.0)
}

/// Fingers beyond the object do not take part, unless too few would be left.
fn drop_unreachable(hand: &GraspHand<'_>, options: &GraspOptions, reached: &[bool], target_weights: &mut [f64]) {
    let takes_part = |f: usize| f != hand.thumb && target_weights[f] > 0.0;
    let left = (0..target_weights.len()).filter(|&f| takes_part(f) && reached[f]).count();
    if left >= options.limits.min_fingers {
        for f in (0..target_weights.len()).filter(|&f| f != hand.thumb && !reached[f]) {
            target_weights[f] = 0.0;
        }
    }
}

fn joint_limits(hand: &GraspHand<'_>) -> Vec<(f64, f64)> {
    let joints = hand.target.robot.joints.iter();
    joints.map(|j| j.limits.unwrap_or((f64::NEG_INFINITY, f64::INFINITY))).collect()
}

/// Middle between the thumb's tip and the others' mean.
fn middle(tips: &[Point3<f64>], thumb: usize) -> Point3<f64> {
    let others: Vector3<f64> = tips.iter().enumerate().filter(|(f, _)| *f != thumb).map(|(_, p)| p.coords).sum();
    nalgebra::center(&tips[thumb], &Point3::from(others / (tips.len() - 1).max(1) as f64))
}

fn clamp(q: &mut [f64], intervals: &[(f64, f64)]) {
    for (q, (lo, hi)) in q.iter_mut().zip(intervals) {
        *q = q.max(*lo).min(*hi);
    }
}

/// Middle between the human thumb and the other fingers that the robot has, object frame; the object where none is seen.
fn centers(demo: &Demonstration, poses: &[Pose], hand: &GraspHand<'_>) -> Vec<Point3<f64>> {
    let frames = demo.frames.iter().zip(poses);
    frames
        .map(|(frame, pose)| {
            let seen = |i: usize| frame.points[i].filter(|p| p.iter().all(|v| v.is_finite()));
            let tips = hand.target.fingers.iter().map(|f| (f.human, seen(f.human.tip())));
            let (mut thumb, mut fingers) = (None, Vec::new());
            for (human, tip) in tips {
                match (human, tip) {
                    (HumanFinger::Thumb, tip) => thumb = tip,
                    (_, Some(tip)) => fingers.push(tip.coords),
                    _ => {}
                }
            }
            let mean = Point3::from(fingers.iter().sum::<Vector3<f64>>() / fingers.len().max(1) as f64);
            let middle = match (thumb, fingers.is_empty()) {
                (Some(thumb), false) => nalgebra::center(&thumb, &mean),
                (Some(thumb), true) => thumb,
                (None, false) => mean,
                (None, true) => return Point3::origin(),
            };
            pose.inverse_transform_point(&middle)
        })
        .collect()
}
