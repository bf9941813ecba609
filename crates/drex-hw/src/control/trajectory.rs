//! Waypoints in joint space.

use std::ops::ControlFlow;

use drex_recording::JointLog;

use super::{Controller, Joints};
use crate::{Error, HandCommand, HandState, Result};

/// Where the joints shall be at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct Waypoint {
    /// Time since the first cycle, s, above zero.
    pub time_s: f64,
    /// Angles, rad, in the order of the hand's joints.
    pub position: Vec<f64>,
}

/// A joint this close to its goal is there, rad.
const THERE_RAD: f64 = 0.03;
/// A joint that moved less than this, rad, for [`STILL_S`] has stopped: encoders wander by less.
const STILL_RAD: f64 = 0.005;
/// s.
const STILL_S: f64 = 0.1;

/// From where the hand is through waypoints, in straight lines, with the same effort limits all the way. It stays at the last one until all
/// joints are within 0.03 rad of it or have stopped, for half a second at most unless [`Self::with_settle_s`] says otherwise.
#[derive(Debug, Clone)]
pub struct Trajectory {
    waypoints: Vec<Waypoint>,
    effort_limit: Vec<f64>,
    speed_rad_per_s: f64,
    start: Vec<f64>,
    /// Index of the next waypoint.
    next: usize,
    settle_s: f64,
    /// Where the joints were, and when, since they last moved while settling.
    still: Vec<f64>,
    still_since_s: Option<f64>,
}

impl Trajectory {
    /// Fastest that a joint is sent by default, rad/s.
    pub const SPEED_RAD_PER_S: f64 = 4.0;
    /// Longest time by default that is left to the joints to arrive after the last waypoint, s.
    pub const SETTLE_S: f64 = 0.5;

    /// Through these waypoints with these limits, in the hand's unit.
    ///
    /// # Errors
    /// [`Error::Value`] if there are no waypoints, times do not rise from above zero, or a number is not finite.
    pub fn new(waypoints: Vec<Waypoint>, effort_limit: Vec<f64>) -> Result<Self> {
        let mut before = 0.0;
        for (k, w) in waypoints.iter().enumerate() {
            if !(w.time_s > before && w.time_s.is_finite()) {
                return Err(Error::value(
                    format!("waypoint {k} at {} s, the one before at {before} s", w.time_s),
                    "give times that rise, the first above zero: the way there starts where the hand is",
                ));
            }
            if let Some(q) = w.position.iter().find(|q| !q.is_finite()) {
                return Err(Error::value(format!("waypoint {k} with an angle of {q} rad"), "give finite angles"));
            }
            before = w.time_s;
        }
        if waypoints.is_empty() {
            return Err(Error::value("a trajectory without waypoints", "give one or more"));
        }
        let speed_rad_per_s = Self::SPEED_RAD_PER_S;
        Ok(Self {
            waypoints,
            effort_limit,
            speed_rad_per_s,
            start: Vec::new(),
            next: 0,
            settle_s: Self::SETTLE_S,
            still: Vec::new(),
            still_since_s: None,
        })
    }

    /// What was logged, played again after `approach_s` seconds for the way to its first pose, and more slowly where the log is faster than
    /// [`Self::SPEED_RAD_PER_S`]: times of a log jitter, and hands are moved faster by hand than they are sent. Joints are found by name.
    ///
    /// # Errors
    /// As [`Self::new`], and if the log lacks a joint.
    pub fn from_log(log: &JointLog, names: &[String], effort_limit: Vec<f64>, approach_s: f64) -> Result<Self> {
        let column = |name: &String| {
            log.names
                .iter()
                .position(|n| n == name)
                .ok_or_else(|| Error::value(format!("a log without joint {name}"), "give one of this hand"))
        };
        let columns = names.iter().map(column).collect::<Result<Vec<_>>>()?;
        let first = log.times_s.first().copied().unwrap_or(0.0);
        let mut waypoints: Vec<Waypoint> = Vec::with_capacity(log.times_s.len());
        // Time that the slower parts have added.
        let mut behind_s = 0.0;
        for (time_s, row) in log.times_s.iter().zip(&log.positions) {
            let position: Vec<f64> = columns.iter().map(|c| row.get(*c).copied().unwrap_or(f64::NAN)).collect();
            let mut time_s = time_s - first + approach_s + behind_s;
            if let Some(last) = waypoints.last() {
                let way = position.iter().zip(&last.position).map(|(q, p)| (q - p).abs()).fold(0.0, f64::max);
                // A hair more, so that rounding does not make it too fast again.
                let earliest_s = last.time_s + way * (1.0 + 1e-6) / Self::SPEED_RAD_PER_S;
                // Only where time rises at all: `new` refuses the rest.
                if time_s > last.time_s && time_s < earliest_s {
                    behind_s += earliest_s - time_s;
                    time_s = earliest_s;
                }
            }
            waypoints.push(Waypoint { time_s, position });
        }
        Self::new(waypoints, effort_limit)
    }

    /// The same with this long, s, for the joints to arrive after the last waypoint; zero ends there.
    pub fn with_settle_s(mut self, settle_s: f64) -> Self {
        self.settle_s = settle_s;
        self
    }

    /// Whether every joint is at its goal, or has stopped on its way, or it has taken too long.
    fn is_settled(&mut self, time_s: f64, state: &HandState) -> bool {
        let Some(last) = self.waypoints.last().filter(|w| time_s < w.time_s + self.settle_s) else { return true };
        let there = |(q, goal): (&f64, &f64)| (q - goal).abs() <= THERE_RAD;
        if state.position.iter().zip(&last.position).all(there) {
            return true;
        }
        let moved = state.position.iter().zip(&self.still).any(|(q, then)| (q - then).abs() > STILL_RAD);
        match self.still_since_s.filter(|_| !moved) {
            Some(since) => time_s - since >= STILL_S,
            None => {
                self.still.copy_from_slice(&state.position);
                self.still_since_s = Some(time_s);
                false
            }
        }
    }
}

impl Controller for Trajectory {
    fn begin(&mut self, joints: &Joints<'_>, state: &HandState) -> Result<()> {
        let n = joints.names.len();
        let wrong = self.waypoints.iter().map(|w| w.position.len()).find(|len| *len != n);
        if let Some(len) = wrong.or((self.effort_limit.len() != n).then_some(self.effort_limit.len())) {
            return Err(Error::value(format!("a trajectory with {len} values for {n} joints"), "give one per joint"));
        }
        if !(self.settle_s >= 0.0 && self.settle_s.is_finite()) {
            return Err(Error::value(format!("{} s to settle", self.settle_s), "give zero or more"));
        }
        self.next = 0;
        self.still.clone_from(&state.position);
        self.still_since_s = None;
        self.start.clone_from(&state.position);
        let (mut from, mut since) = (&self.start, 0.0);
        for w in &self.waypoints {
            for (j, name) in joints.names.iter().enumerate() {
                let speed = (w.position[j] - from[j]).abs() / (w.time_s - since);
                if !(speed <= self.speed_rad_per_s) {
                    return Err(Error::value(
                        format!("joint {name} sent at {speed:.2} rad/s until {} s", w.time_s),
                        format!("allow more time, or more than {} rad/s", self.speed_rad_per_s),
                    ));
                }
            }
            (from, since) = (&w.position, w.time_s);
        }
        Ok(())
    }

    fn command(&mut self, time_s: f64, state: &HandState, command: &mut HandCommand) -> Result<ControlFlow<()>> {
        while self.waypoints.get(self.next).is_some_and(|w| w.time_s <= time_s) {
            self.next += 1;
        }
        let before = self.next.checked_sub(1).map(|k| &self.waypoints[k]);
        let (from, since) = before.map_or((&self.start, 0.0), |w| (&w.position, w.time_s));
        command.effort_limit.copy_from_slice(&self.effort_limit);
        let Some(to) = self.waypoints.get(self.next) else {
            command.position.copy_from_slice(from);
            return Ok(if self.is_settled(time_s, state) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) });
        };
        let share = ((time_s - since) / (to.time_s - since)).clamp(0.0, 1.0);
        for ((goal, a), b) in command.position.iter_mut().zip(from).zip(&to.position) {
            *goal = a + share * (b - a);
        }
        Ok(ControlFlow::Continue(()))
    }

    fn phase(&self) -> &'static str {
        "trajectory"
    }
}
