//! What decides, cycle by cycle, what the joints are told.

use std::ops::ControlFlow;

use crate::{EffortUnit, Error, Hand, HandCommand, HandState, Result};

/// What a controller may know of the hand's joints.
#[derive(Debug, Clone, Copy)]
pub struct Joints<'a> {
    /// Names, in the order of all lists.
    pub names: &'a [String],
    /// Lowest and highest angles, rad.
    pub limits: &'a [(f64, f64)],
    /// Largest efforts.
    pub effort_caps: &'a [f64],
    /// What efforts are counted in.
    pub effort_unit: EffortUnit,
}

impl<'a> Joints<'a> {
    /// Those of a hand.
    pub fn of(hand: &'a (impl Hand + ?Sized)) -> Self {
        Self {
            names: hand.joints(),
            limits: hand.limits(),
            effort_caps: hand.effort_caps(),
            effort_unit: hand.effort_unit(),
        }
    }
}

/// Decides what the joints are told. Runs in the loop: it must neither wait nor, after [`Controller::begin`], allocate.
pub trait Controller: Send {
    /// Checks what is to be done against the hand, and makes ready; `state` is where the hand is.
    ///
    /// # Errors
    /// If it cannot be done with this hand: the loop ends.
    fn begin(&mut self, joints: &Joints<'_>, state: &HandState) -> Result<()>;

    /// Writes the command for this cycle over that of the last one; `time_s` counts from the first cycle. `Break` makes this cycle
    /// the last.
    ///
    /// # Errors
    /// If it cannot go on: the loop ends.
    fn command(&mut self, time_s: f64, state: &HandState, command: &mut HandCommand) -> Result<ControlFlow<()>>;

    /// What it is doing, for the telemetry.
    fn phase(&self) -> &'static str {
        ""
    }
}

impl<B: Controller + ?Sized> Controller for Box<B> {
    fn begin(&mut self, joints: &Joints<'_>, state: &HandState) -> Result<()> {
        (**self).begin(joints, state)
    }

    fn command(&mut self, time_s: f64, state: &HandState, command: &mut HandCommand) -> Result<ControlFlow<()>> {
        (**self).command(time_s, state, command)
    }

    fn phase(&self) -> &'static str {
        (**self).phase()
    }
}

/// Keeps the joints where they are at first; with the torque off ([`ControlOptions::torque_off`](super::ControlOptions::torque_off)) it watches.
#[derive(Debug, Clone)]
pub struct HoldPosition {
    seconds: f64,
    position: Vec<f64>,
    effort_limit: Vec<f64>,
}

impl HoldPosition {
    /// For this long, s, with these limits, in the hand's unit.
    pub fn new(seconds: f64, effort_limit: Vec<f64>) -> Self {
        Self { seconds, position: Vec::new(), effort_limit }
    }
}

impl Controller for HoldPosition {
    fn begin(&mut self, joints: &Joints<'_>, state: &HandState) -> Result<()> {
        if !(self.seconds >= 0.0) || self.effort_limit.len() != joints.names.len() {
            return Err(Error::value(
                format!("to stay for {} s with {} limits", self.seconds, self.effort_limit.len()),
                format!("give zero or more, and {}", joints.names.len()),
            ));
        }
        self.position.clone_from(&state.position);
        Ok(())
    }

    fn command(&mut self, time_s: f64, _: &HandState, command: &mut HandCommand) -> Result<ControlFlow<()>> {
        command.position.copy_from_slice(&self.position);
        command.effort_limit.copy_from_slice(&self.effort_limit);
        Ok(if time_s >= self.seconds { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    }
}
