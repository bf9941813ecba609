//! A grasp: open, make ready, close until the fingers touch, press with the force, hold, release.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

use super::{Controller, GraspContact, GraspOutcome, GraspPhase, GraspPlan, Joints};
use crate::{Error, HandCommand, HandState, JointStatus, Result};

/// Longest step of time that goals and limits follow, s: after a gap they do not jump.
const LONGEST_STEP_S: f64 = 0.05;
/// A goal this close has arrived, rad.
const ARRIVED_RAD: f64 = 1e-6;
/// A joint this close to its goal is there, rad.
const THERE_RAD: f64 = 0.03;

/// A grasp as a controller of the loop. Once a joint touches, its goal leads the contact far enough for the effort limit, not the
/// stiffness of the position loop, to set the force.
#[derive(Debug)]
pub struct GraspController {
    plan: GraspPlan,
    handle: GraspHandle,
    phase: GraspPhase,
    began_s: f64,
    last_s: f64,
    names: Vec<String>,
    limits: Vec<(f64, f64)>,
    goal: Vec<f64>,
    effort: Vec<f64>,
    closing: Vec<Closing>,
    /// Since when all goals of this phase have arrived.
    arrived_s: Option<f64>,
    held: u64,
    outcome: GraspOutcome,
}

/// How far a joint is with closing.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Closing {
    /// Not touching yet; since when it looks as if it did, s.
    Moving(Option<f64>),
    /// At its closed angle: there was nothing.
    Through,
    /// Touching at an angle, rad; since when it looks as if it slipped, s.
    Touching(f64, Option<f64>),
}

/// Watches a grasp and ends its hold, from any thread. Clones are the same handle.
#[derive(Debug, Clone, Default)]
pub struct GraspHandle(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    phase: AtomicU8,
    release: AtomicBool,
}

impl GraspHandle {
    /// Ends the hold as soon as it is reached.
    pub fn release(&self) {
        self.0.release.store(true, Ordering::Release);
    }

    /// What the grasp is doing.
    pub fn phase(&self) -> GraspPhase {
        let k = usize::from(self.0.phase.load(Ordering::Acquire));
        GraspPhase::ALL.get(k).copied().unwrap_or(GraspPhase::Done)
    }

    fn set(&self, phase: GraspPhase) {
        self.0.phase.store(phase as u8, Ordering::Release);
    }
}

impl GraspController {
    /// A grasp that was not begun; the plan is checked against the hand when the loop starts.
    pub fn new(plan: GraspPlan) -> Self {
        Self {
            plan,
            handle: GraspHandle::default(),
            phase: GraspPhase::Open,
            began_s: 0.0,
            last_s: 0.0,
            names: Vec::new(),
            limits: Vec::new(),
            goal: Vec::new(),
            effort: Vec::new(),
            closing: Vec::new(),
            arrived_s: None,
            held: 0,
            outcome: GraspOutcome::default(),
        }
    }

    /// To watch it and to end its hold.
    pub fn handle(&self) -> GraspHandle {
        self.handle.clone()
    }

    /// What became of it, so far.
    pub fn outcome(&self) -> &GraspOutcome {
        &self.outcome
    }

    fn enter(&mut self, phase: GraspPhase, time_s: f64) {
        (self.phase, self.began_s, self.arrived_s) = (phase, time_s, None);
        self.outcome.began_s[phase as usize] = Some(time_s);
        self.handle.set(phase);
    }

    /// Where a joint goes in this phase, rad.
    fn target(&self, j: usize) -> f64 {
        let (low, high) = self.limits[j];
        let way = self.plan.way(j);
        match self.phase {
            GraspPhase::Open | GraspPhase::Done => self.plan.open[j],
            GraspPhase::PreGrasp => self.plan.pre_grasp[j],
            GraspPhase::Release => match self.effort[j] > self.plan.closing_effort[j] {
                // Still pressing: the limit goes down first.
                true => self.goal[j],
                false => self.plan.open[j],
            },
            GraspPhase::Close | GraspPhase::Ramp | GraspPhase::Hold => match self.closing[j] {
                Closing::Touching(at, _) => at + way * self.plan.lead_rad(j),
                Closing::Moving(_) => self.plan.closed[j] + way * self.plan.lead_rad(j),
                Closing::Through => self.plan.closed[j],
            },
        }
        .max(low)
        .min(high)
    }

    /// The effort limit that a joint goes to in this phase.
    fn target_effort(&self, j: usize) -> f64 {
        let (closing, force) = (self.plan.closing_effort[j], self.plan.force_effort[j]);
        match self.phase {
            GraspPhase::Ramp | GraspPhase::Hold => match self.closing[j] {
                Closing::Touching(..) => force,
                // What did not touch only has to stay where it is under the load of what did.
                _ => closing.max(force),
            },
            _ => closing,
        }
    }

    /// Moves goals and limits on by `dt_s`; true if all have arrived.
    fn advance(&mut self, dt_s: f64) -> bool {
        let speed = match self.phase {
            GraspPhase::Close => self.plan.closing_rad_per_s,
            _ => self.plan.speed_rad_per_s,
        };
        let mut arrived = true;
        for j in 0..self.goal.len() {
            let (target, effort) = (self.target(j), self.target_effort(j));
            let (step, slew) = (speed * dt_s, self.plan.effort_rate * dt_s);
            self.goal[j] = target.max(self.goal[j] - step).min(self.goal[j] + step);
            self.effort[j] = effort.max(self.effort[j] - slew).min(self.effort[j] + slew);
            arrived &= (self.goal[j] - self.target(j)).abs() < ARRIVED_RAD && self.effort[j] == effort;
        }
        arrived
    }

    /// Sorts the closing joints into those that touch, those that went through, and those that still move.
    fn feel(&mut self, time_s: f64, state: &HandState) {
        for j in 0..self.closing.len() {
            let Closing::Moving(since) = self.closing[j] else { continue };
            let (way, q) = (self.plan.way(j), state.position[j]);
            if matches!(state.status[j], JointStatus::Silent | JointStatus::Faulted(_)) {
                self.closing[j] = Closing::Moving(None);
                continue;
            }
            if state.age[j] != 0 {
                // A hand that reports more slowly than the loop runs has nothing new to say.
                continue;
            }
            let presses = state.effort[j] * way >= self.plan.contact_share * self.plan.closing_effort[j];
            let stands = state.velocity[j].abs() <= self.plan.contact_rad_per_s;
            self.closing[j] = match since {
                _ if way * (q - self.plan.closed[j]) >= 0.0 => Closing::Through,
                Some(since) if presses && stands && time_s - since >= self.plan.contact_s => {
                    let (low, high) = self.limits[j];
                    let room = if way > 0.0 { high - q } else { q - low };
                    let reachable_effort = self.plan.stiffness * room.max(0.0);
                    self.outcome.contacts[j] = Some(GraspContact { time_s, position: q, reachable_effort });
                    Closing::Touching(q, None)
                }
                _ if presses && stands => Closing::Moving(since.or(Some(time_s))),
                _ => Closing::Moving(None),
            };
        }
    }

    /// Number of joints that still touch while they hold.
    fn holding(&mut self, time_s: f64, state: &HandState) -> usize {
        let mut n = 0;
        for j in 0..self.closing.len() {
            let Closing::Touching(at, since) = &mut self.closing[j] else { continue };
            let (goal, (low, high)) = (self.goal[j], self.limits[j]);
            let at_goal = (goal - state.position[j]).abs() < THERE_RAD && goal > low && goal < high;
            let slipped = self.plan.way(j) * (state.position[j] - *at) > self.plan.slip_rad;
            *since = (slipped || at_goal).then(|| since.unwrap_or(time_s));
            n += usize::from(since.is_none_or(|s| time_s - s < self.plan.contact_s));
        }
        n
    }

    /// What comes after this phase, if it is over.
    fn next(&mut self, time_s: f64, state: &HandState, arrived: bool) -> Option<GraspPhase> {
        self.arrived_s = if arrived { self.arrived_s.or(Some(time_s)) } else { None };
        let settled = self.arrived_s.is_some_and(|t| {
            let there = self.goal.iter().zip(&state.position).all(|(a, b)| (a - b).abs() < THERE_RAD);
            there || time_s - t >= self.plan.settle_s
        });
        match self.phase {
            GraspPhase::Open => settled.then_some(GraspPhase::PreGrasp),
            GraspPhase::PreGrasp => settled.then_some(GraspPhase::Close),
            GraspPhase::Close => {
                self.feel(time_s, state);
                // A joint that stands still but does not press is held by something else: it counts as through.
                let waited = self.arrived_s.is_some_and(|t| time_s - t >= self.plan.settle_s);
                if !waited && self.closing.iter().any(|c| matches!(c, Closing::Moving(_))) {
                    return None;
                }
                self.closing.iter_mut().filter(|c| matches!(c, Closing::Moving(_))).for_each(|c| *c = Closing::Through);
                let touching = self.outcome.contacts.iter().flatten().count();
                self.outcome.missed = touching < self.plan.least_contacts.max(1);
                Some(if self.outcome.missed { GraspPhase::Release } else { GraspPhase::Ramp })
            }
            GraspPhase::Ramp => arrived.then(|| {
                // Soft things give way under the force: what counts from now on is where the joints are now.
                for (c, q) in self.closing.iter_mut().zip(&state.position) {
                    if let Closing::Touching(at, _) = c {
                        *at = *q;
                    }
                }
                GraspPhase::Hold
            }),
            GraspPhase::Hold => {
                self.held += 1;
                self.outcome.hold(&self.plan, state, self.held);
                self.outcome.lost = self.holding(time_s, state) < self.plan.least_contacts.max(1);
                let over = self.plan.hold_s.is_some_and(|s| time_s - self.began_s >= s);
                let released = self.handle.0.release.load(Ordering::Acquire);
                (self.outcome.lost || over || released).then_some(GraspPhase::Release)
            }
            GraspPhase::Release => settled.then_some(GraspPhase::Done),
            GraspPhase::Done => None,
        }
    }
}

impl Controller for GraspController {
    fn begin(&mut self, joints: &Joints<'_>, state: &HandState) -> Result<()> {
        self.plan.check(joints)?;
        let n = joints.names.len();
        state.check(joints.names)?;
        self.names = joints.names.to_vec();
        self.limits = joints.limits.to_vec();
        self.goal = state.position.iter().zip(joints.limits).map(|(q, (low, high))| q.max(*low).min(*high)).collect();
        // Torque comes with the slew of the limits.
        self.effort = vec![0.0; n];
        self.closing =
            (0..n).map(|j| if self.plan.way(j) == 0.0 { Closing::Through } else { Closing::Moving(None) }).collect();
        (self.held, self.last_s, self.outcome) = (0, 0.0, GraspOutcome::new(n));
        self.enter(GraspPhase::Open, 0.0);
        Ok(())
    }

    fn command(&mut self, time_s: f64, state: &HandState, command: &mut HandCommand) -> Result<ControlFlow<()>> {
        if !time_s.is_finite() {
            return Err(Error::value(format!("a cycle at {time_s} s"), "give the time since the first cycle"));
        }
        state.check(&self.names)?;
        let dt_s = (time_s - self.last_s).clamp(0.0, LONGEST_STEP_S);
        self.last_s = time_s;
        let arrived = self.advance(dt_s);
        if let Some(phase) = self.next(time_s, state, arrived) {
            self.enter(phase, time_s);
        }
        command.position.copy_from_slice(&self.goal);
        command.effort_limit.copy_from_slice(&self.effort);
        Ok(if self.phase == GraspPhase::Done { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    }

    fn phase(&self) -> &'static str {
        self.phase.name()
    }
}
