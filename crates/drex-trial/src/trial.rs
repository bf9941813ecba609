//! A hand and an object, and what becomes of a command.

use std::collections::VecDeque;
use std::sync::Arc;

use drex_core::{Object, Pose};
use drex_diffsim::Error as SimulationError;
use drex_grasp::Grasp;
use drex_robot::Robot;

use crate::control::Controller;
use crate::engine::Simulation;
use crate::hand_and_object::{HandAndObject, STEPS_PER_TICK};
use crate::watch::Watch;
use crate::{
    Assumed, ClosingPlan, Command, Engine, Error, GripForce, Mismatch, NoCommand, Outcome, Result, TrialOptions, Truth,
    closing, command, timeline,
};

/// What can be seen of a trial at one time.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Frame {
    /// From the start of the trial, s.
    pub time_s: f64,
    /// The hand's base.
    pub world_from_base: Pose,
    /// Joint angles, model order, rad.
    pub joints: Vec<f64>,
    /// The object.
    pub world_from_object: Pose,
    /// Normal force of each finger, smoothed over 10 ms, N.
    pub finger_n: Vec<f64>,
}

/// A hand and an object, ready for trials: as the hand knows them, and as they are where that differs.
#[derive(Clone)]
pub struct Trial(Arc<HandAndObject>, Option<HandAndObject>);

impl Trial {
    /// Prepares trials of `hand` with `object`.
    ///
    /// # Errors
    /// If the hand has no collision shapes, its model does not say what its motors give ([`Robot::effort_limits`]), or an option is
    /// out of range.
    pub fn new(hand: Arc<Robot>, object: Object, options: TrialOptions) -> Result<Self> {
        Ok(Self(Arc::new(HandAndObject::new(hand, object, options)?), None))
    }

    /// Trials of the same plans with another hand and another object than those that are known, drawn with a seed. The controller goes on to reckon with
    /// the friction and the gains of the hand that is known.
    ///
    /// # Errors
    /// If a number of the mismatch is out of range.
    pub fn mismatched(&self, mismatch: &Mismatch, seed: u64) -> Result<Self> {
        Ok(Self(self.0.clone(), Some(self.0.mismatched(mismatch, seed)?)))
    }

    /// The hand.
    pub fn hand(&self) -> &Arc<Robot> {
        &self.0.hand
    }

    /// The object.
    pub fn object(&self) -> &Object {
        &self.0.object
    }

    /// The command for a grasp, given what the hand assumes. The inner result says why there is none.
    ///
    /// The fingers' closing is dry-run in drex-diffsim with the object where it is assumed to be; the grip force is planned on
    /// the contacts that this gives; where they have none, also on those that pressing fingers bring to bear.
    ///
    /// # Errors
    /// If the grasp is none of this hand or a solver gives up.
    pub fn command(
        &self,
        grasp: &Grasp,
        assumed: &Assumed,
        grip_force: GripForce,
    ) -> Result<Result<Command, NoCommand>> {
        let closing = self.plan_closing(grasp, assumed)?;
        self.command_closed(&closing, assumed, grip_force)
    }

    /// How the fingers close on the object where it is assumed to be, in drex-diffsim: the first half of [`Trial::command`], which
    /// depends on mass and friction so little that it may be done once for many of them. A grasp with which the simulation diverges
    /// touches nothing.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    pub fn plan_closing(&self, grasp: &Grasp, assumed: &Assumed) -> Result<ClosingPlan> {
        closing::plan_closing(&self.0, grasp, assumed)
    }

    /// What [`Trial::plan_closing`] takes the place of: the contacts of the grasp at rest, without a dry run of the closing.
    ///
    /// # Errors
    /// If the grasp is none of this hand.
    pub fn closing_as_proposed(&self, grasp: &Grasp) -> Result<ClosingPlan> {
        closing::as_proposed(&self.0, grasp)
    }

    /// The grip force on the contacts of a closing: the second half of [`Trial::command`].
    ///
    /// # Errors
    /// If a solver gives up.
    pub fn command_closed(
        &self,
        closing: &ClosingPlan,
        assumed: &Assumed,
        grip_force: GripForce,
    ) -> Result<Result<Command, NoCommand>> {
        command::grip_force(&self.0, closing, assumed, grip_force)
    }

    /// Sum of the normal forces, N, of the command that [`Trial::command_closed`] gives: what it costs less to know than the command.
    ///
    /// # Errors
    /// If a solver gives up.
    pub fn grip_force_n(
        &self,
        closing: &ClosingPlan,
        assumed: &Assumed,
        grip_force: GripForce,
    ) -> Result<Result<f64, NoCommand>> {
        command::grip_force_n(&self.0, closing, assumed, grip_force)
    }

    /// Carries a command out under what is true.
    ///
    /// # Errors
    /// If the model cannot be simulated; [`Error::NoMujoco`] for an engine that this build lacks. A grasp that fails is no error.
    pub fn run(&self, command: &Command, truth: &Truth, engine: Engine) -> Result<Outcome> {
        self.carry_out(command, truth, engine, &mut |_, _, _| true)
    }

    /// [`Trial::run`] until the first rule is broken: of a failure only the verdict and its time say what they say there.
    ///
    /// # Errors
    /// As [`Trial::run`].
    pub fn run_until_failure(&self, command: &Command, truth: &Truth, engine: Engine) -> Result<Outcome> {
        self.carry_out(command, truth, engine, &mut |_, _, watch| watch.holds())
    }

    /// [`Trial::run`], and what could be seen meanwhile: a frame every `every_s` seconds from the start on, until the trial ends.
    ///
    /// # Errors
    /// As [`Trial::run`]; if `every_s` is not positive.
    pub fn record(
        &self,
        command: &Command,
        truth: &Truth,
        engine: Engine,
        every_s: f64,
    ) -> Result<(Outcome, Vec<Frame>)> {
        if !(every_s > 0.0) {
            return Err(Error::value(format!("a frame every {every_s} s"), "give a positive time, such as 0.04"));
        }
        let mut frames: Vec<Frame> = Vec::new();
        let outcome = self.carry_out(command, truth, engine, &mut |time_s, simulation, watch| {
            if time_s >= frames.len() as f64 * every_s {
                frames.push(Frame {
                    time_s,
                    world_from_base: simulation.world_from_base(),
                    joints: simulation.joints().to_vec(),
                    world_from_object: simulation.world_from_object(),
                    finger_n: watch.finger_n().to_vec(),
                });
            }
            true
        })?;
        Ok((outcome, frames))
    }

    /// `seen` gets time, engine and what was measured after every command, and says whether to go on.
    fn carry_out(
        &self,
        command: &Command,
        truth: &Truth,
        engine: Engine,
        seen: &mut dyn FnMut(f64, &Simulation, &Watch<'_>) -> bool,
    ) -> Result<Outcome> {
        truth.check()?;
        // What the hand knows of itself, and what is there.
        let own = &self.0;
        let plant = self.1.as_ref().unwrap_or(own);
        let mut simulation =
            plant.simulation(&command.world_from_base, &command.reach, truth, timeline::SHAKEN_S, engine)?;
        let Command { reach, contact_forces, limits_nm, .. } = command;
        let mut controller = Controller::new(&own.hand, &own.drives, reach, contact_forces, limits_nm, &own.effort_nm);
        let tick_s = plant.options.dt_s * STEPS_PER_TICK as f64;
        let mut watch = Watch::new(&plant.surface, plant.object.max_finger_n, command.grip_force_n, tick_s);
        let ticks = (timeline::SHAKEN_S / tick_s).round() as usize;
        let late = (plant.latency_s / tick_s).round() as usize;
        let mut under_way: VecDeque<Vec<f64>> = VecDeque::with_capacity(late + 1);
        for i in 0..ticks {
            let newest = controller.command(i as f64 * tick_s, &simulation);
            if i == 0 {
                // At rest before the start, the first command has been there for long.
                under_way.extend(std::iter::repeat_n(newest.clone(), late));
            }
            under_way.push_back(newest);
            let commands = under_way.pop_front().unwrap_or_default();
            for _ in 0..STEPS_PER_TICK {
                match simulation.step(&commands) {
                    Ok(()) => {}
                    Err(Error::Simulation(SimulationError::Diverged { time_s, .. })) => {
                        return Ok(watch.broke(time_s));
                    }
                    Err(other) => return Err(other),
                }
            }
            let time_s = (i + 1) as f64 * tick_s;
            let goes_on = watch.look(time_s, truth.friction, &simulation);
            if !seen(time_s, &simulation, &watch) || !goes_on {
                break;
            }
        }
        Ok(watch.finish())
    }
}
