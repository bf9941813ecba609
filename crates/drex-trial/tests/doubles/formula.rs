//! Evaluators by a formula, which tests of selection and learning use in place of a simulator.
#![allow(dead_code, missing_docs)] // no test uses all of it

use drex_grasp::Grasp;

use drex_trial::{Assumed, Evaluation, Evaluator, GripForce, NoCommand, Result, Truth, Verdict};

/// An evaluator to which every grasp is a pinch that carries friction times grip force against 1.5 times the weight.
pub struct PinchFormula {
    /// Largest grip force of the motors, N.
    pub strongest_n: f64,
}

impl Evaluator for PinchFormula {
    type Closed = ();
    type Command = f64;

    fn close(&self, _: &Grasp, _: &Assumed) -> Result<()> {
        Ok(())
    }

    fn as_proposed(&self, _: &Grasp, _: &Assumed) -> Result<()> {
        Ok(())
    }

    fn command(&self, (): &(), assumed: &Assumed, force: GripForce) -> Result<Result<f64, NoCommand>> {
        let needed = 1.5 * 1.1 * assumed.mass_kg * 9.81 / (0.9 * assumed.friction);
        let wanted = match force {
            GripForce::Required => needed,
            GripForce::Total(n) => n,
        };
        if wanted > self.strongest_n {
            return Ok(Err(NoCommand::TorqueLimit(format!("{wanted:.1} N"))));
        }
        Ok(Ok(wanted))
    }

    fn grip_force_n(
        &self,
        closed: &Self::Closed,
        assumed: &Assumed,
        force: GripForce,
    ) -> Result<Result<f64, NoCommand>> {
        self.command(closed, assumed, force)
    }

    fn fingers(&self, (): &()) -> Vec<bool> {
        vec![true; 4]
    }

    fn validate(&self, command: &f64, truth: &Truth) -> Result<Evaluation> {
        self.evaluate(command, truth)
    }

    fn evaluate(&self, command: &f64, truth: &Truth) -> Result<Evaluation> {
        let load = 1.5 * truth.mass_kg * 9.81;
        let carries = truth.friction * command;
        let holds = carries >= load;
        Ok(Evaluation {
            verdict: if holds { Verdict::Success } else { Verdict::Slip },
            grip_force_n: *command,
            held_n: holds.then_some(*command),
            // Two opposed fingers share the force.
            peak_finger_n: 0.5 * command,
            fingers: vec![true; 4],
            retained: if holds { 1.0 } else { 0.3 },
            friction_used: holds.then(|| load / carries),
            safety_margin: if holds { 1.0 - load / carries } else { 0.0 },
        })
    }
}

/// The same with pinches as strong, N, as the angle of the first joint says in rad.
pub struct PinchByFirstJoint;

impl Evaluator for PinchByFirstJoint {
    type Closed = f64;
    type Command = f64;

    fn close(&self, grasp: &Grasp, _: &Assumed) -> Result<f64> {
        Ok(grasp.joints_rad[0])
    }

    fn as_proposed(&self, grasp: &Grasp, assumed: &Assumed) -> Result<f64> {
        self.close(grasp, assumed)
    }

    fn command(&self, closed: &f64, assumed: &Assumed, force: GripForce) -> Result<Result<f64, NoCommand>> {
        PinchFormula { strongest_n: *closed }.command(&(), assumed, force)
    }

    fn grip_force_n(
        &self,
        closed: &Self::Closed,
        assumed: &Assumed,
        force: GripForce,
    ) -> Result<Result<f64, NoCommand>> {
        self.command(closed, assumed, force)
    }

    fn fingers(&self, _: &f64) -> Vec<bool> {
        vec![true; 4]
    }

    fn validate(&self, command: &f64, truth: &Truth) -> Result<Evaluation> {
        self.evaluate(command, truth)
    }

    fn evaluate(&self, command: &f64, truth: &Truth) -> Result<Evaluation> {
        PinchFormula { strongest_n: f64::INFINITY }.evaluate(command, truth)
    }
}
