//! An evaluator whose caller may stop it.

use std::ops::ControlFlow;

use drex_grasp::Grasp;

use crate::{Assumed, Error, Evaluation, Evaluator, GripForce, NoCommand, Result, Truth};

/// An evaluator that asks before each closing and each trial whether to go on, and answers with [`Error::Stopped`] once it is not to.
pub struct Stoppable<'a, E> {
    evaluator: &'a E,
    go_on: &'a (dyn Fn() -> ControlFlow<()> + Sync),
}

impl<'a, E: Evaluator> Stoppable<'a, E> {
    /// Lets `go_on` stop the evaluator. It is called from several threads.
    pub fn new(evaluator: &'a E, go_on: &'a (dyn Fn() -> ControlFlow<()> + Sync)) -> Self {
        Self { evaluator, go_on }
    }

    fn unless_stopped(&self) -> Result<&E> {
        match (self.go_on)() {
            ControlFlow::Continue(()) => Ok(self.evaluator),
            ControlFlow::Break(()) => Err(Error::Stopped),
        }
    }
}

impl<E: Evaluator> Evaluator for Stoppable<'_, E> {
    type Closed = E::Closed;
    type Command = E::Command;

    fn close(&self, grasp: &Grasp, assumed: &Assumed) -> Result<E::Closed> {
        self.unless_stopped()?.close(grasp, assumed)
    }

    fn as_proposed(&self, grasp: &Grasp, assumed: &Assumed) -> Result<E::Closed> {
        self.evaluator.as_proposed(grasp, assumed)
    }

    fn command(
        &self,
        closed: &E::Closed,
        assumed: &Assumed,
        force: GripForce,
    ) -> Result<Result<E::Command, NoCommand>> {
        self.evaluator.command(closed, assumed, force)
    }

    fn grip_force_n(&self, closed: &E::Closed, assumed: &Assumed, force: GripForce) -> Result<Result<f64, NoCommand>> {
        self.evaluator.grip_force_n(closed, assumed, force)
    }

    fn fingers(&self, closed: &E::Closed) -> Vec<bool> {
        self.evaluator.fingers(closed)
    }

    fn validate(&self, command: &E::Command, truth: &Truth) -> Result<Evaluation> {
        self.unless_stopped()?.validate(command, truth)
    }

    fn validate_until_failure(&self, command: &E::Command, truth: &Truth) -> Result<Evaluation> {
        self.unless_stopped()?.validate_until_failure(command, truth)
    }

    fn evaluate(&self, command: &E::Command, truth: &Truth) -> Result<Evaluation> {
        self.unless_stopped()?.evaluate(command, truth)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::atomic::{AtomicUsize, Ordering};

    use drex_core::Pose;
    use drex_robot::Robot;

    use super::*;
    use crate::{Condition, ConditionSpread, formula::PinchByFirstJoint, rollouts};

    #[test]
    fn what_is_stopped_ends_with_an_error_and_asks_no_more_of_the_evaluator() {
        let hand = Robot::bundled("leap_right").unwrap();
        let grasp = Grasp { joints_rad: vec![50.0], ..Grasp::new(&hand, Vec::new(), Pose::identity()) };
        let conditions: Vec<Condition> = ConditionSpread::default().conditions(8, 1);
        let run = |most: usize| {
            let asked = AtomicUsize::new(0);
            let go_on = || match asked.fetch_add(1, Ordering::Relaxed) < most {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            };
            rollouts(&Stoppable::new(&PinchByFirstJoint, &go_on), &grasp, 0.1, &conditions)
        };
        // A closing and a trial for each of them.
        assert_eq!(run(16).unwrap(), rollouts(&PinchByFirstJoint, &grasp, 0.1, &conditions).unwrap());
        assert!(matches!(run(15), Err(Error::Stopped)));
        assert!(matches!(run(0), Err(Error::Stopped)));
    }
}
