//! Grasps found for a mesh, and tried in simulation.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use drex_trial::{
    Assumed, ConditionSpread, Engine, FindOptions, GripForce, Stoppable, TrialEvaluator, TrialOptions, Truth, rollouts,
};
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::arrays::{Numbers, out1, pose_row};
use crate::failure::{Failure, NoCommand, Result};
use crate::grasp::Grasp;
use crate::mesh::ObjectInput;
use crate::robot::HandInput;
use crate::watch::watched;

/// A hand and an object, ready for trials in simulation: the hand comes near, closes, grips, lifts by 20 cm in 2 s, holds for 3 s, and is
/// shaken six times.
///
/// `object` is an `Asset`, a mesh file or a tuple (vertices (V, 3), faces (F, 3)) in `unit` ("m", "cm", "mm", "in" or "auto"), and weighs
/// `mass_kg`; an `Asset` has its own mass and `friction` (0.5 for meshes) where they are left out. It stands in its rest pose on the
/// table z = 0. `hand` is a `Robot`, "leap_right", "leap_left", "allegro_right", "allegro_left", or a URDF or MJCF file.
/// `shake_m_s2` is the acceleration of the shakes (half of gravity if left out).
#[pyclass(module = "drex", frozen)]
pub(crate) struct Trial {
    evaluator: Arc<TrialEvaluator>,
}

/// What is carried out.
#[derive(FromPyObject)]
enum GraspOrCommand<'py> {
    Command(PyRef<'py, Command>),
    Grasp(PyRef<'py, Grasp>),
}

#[pymethods]
impl Trial {
    #[new]
    #[pyo3(signature = (object, hand=HandInput::default(), *, mass_kg=None, friction=None, unit="auto", shake_m_s2=None))]
    fn new(
        py: Python<'_>,
        object: &Bound<'_, PyAny>,
        hand: HandInput<'_>,
        mass_kg: Option<f64>,
        friction: Option<f64>,
        unit: &str,
        shake_m_s2: Option<f64>,
    ) -> Result<Self> {
        let (object, hand) = (ObjectInput::of(object, mass_kg, friction, unit)?, hand.model()?);
        let mut options = TrialOptions::default();
        options.shake_m_s2 = shake_m_s2.unwrap_or(options.shake_m_s2);
        watched(py, None, move |_| {
            let evaluator = TrialEvaluator::new(&object.object()?, &hand, &options, Engine::Diffsim)?;
            Ok(Self { evaluator: Arc::new(evaluator) })
        })
    }

    /// Mass of the object, kg.
    #[getter]
    fn mass_kg(&self) -> f64 {
        self.evaluator.trial().object().mass_kg()
    }

    /// Coefficient of friction between hand and object.
    #[getter]
    fn friction(&self) -> f64 {
        self.evaluator.trial().object().friction
    }

    /// Name of the hand's model.
    #[getter]
    fn hand(&self) -> &str {
        &self.evaluator.trial().hand().name
    }

    /// Pose of the object's mesh frame in the world, shape (7,): x, y, z, qw, qx, qy, qz.
    #[getter]
    fn world_from_object<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, pose_row(&self.evaluator.trial().object().world_from_object))
    }

    /// What the hand is commanded for a grasp, if it assumes this `mass_kg` and `friction` (those of the trial if left out).
    ///
    /// The fingers' closing is simulated, and the grip force found on the contacts that this gives: as much as is needed, or
    /// `grip_force_n`, or as many newtons as the motors can give. Raises `NoCommand` where there is none.
    #[pyo3(signature = (grasp, *, mass_kg=None, friction=None, grip_force_n=None))]
    fn command(
        &self,
        py: Python<'_>,
        grasp: PyRef<'_, Grasp>,
        mass_kg: Option<f64>,
        friction: Option<f64>,
        grip_force_n: Option<f64>,
    ) -> Result<Command> {
        let assumed =
            Assumed { mass_kg: mass_kg.unwrap_or(self.mass_kg()), friction: friction.unwrap_or(self.friction()) };
        let force = grip_force_n.map_or(GripForce::Required, GripForce::Total);
        let (grasp, evaluator) = (grasp.inner.clone(), Arc::clone(&self.evaluator));
        let command = watched(py, None, move |_| Ok(evaluator.trial().command(&grasp, &assumed, force)?))?;
        match command {
            Ok(inner) => Ok(Command { inner }),
            Err(reason) => {
                let error = NoCommand::new_err(reason.to_string());
                error.value(py).setattr("verdict", reason.verdict().to_string())?;
                Err(Failure::Python(error))
            }
        }
    }

    /// Carries a `Command` out, or that of a `Grasp` for the trial's mass and friction, and says how it ended.
    ///
    /// What is true may differ from what the hand assumes: `mass_kg` and `friction` (those of the trial if left out), and where the object
    /// stands, `shift_m` (2,) in the plane of the table and `turn_rad` about the vertical. `seed` draws the directions of the shakes.
    #[pyo3(signature = (grasp, *, mass_kg=None, friction=None, shift_m=None, turn_rad=0.0, seed=0))]
    fn run(
        &self,
        py: Python<'_>,
        grasp: GraspOrCommand<'_>,
        mass_kg: Option<f64>,
        friction: Option<f64>,
        shift_m: Option<&Bound<'_, PyAny>>,
        turn_rad: f64,
        seed: u64,
    ) -> Result<Outcome> {
        let command = match grasp {
            GraspOrCommand::Command(command) => command.inner.clone(),
            GraspOrCommand::Grasp(grasp) => self.command(py, grasp, None, None, None)?.inner,
        };
        let shift_m = shift_m.map(|s| Numbers::of("shift_m", s)?.finite()?.fixed::<2>("two numbers, shape (2,)"));
        let truth = Truth {
            mass_kg: mass_kg.unwrap_or(self.mass_kg()),
            friction: friction.unwrap_or(self.friction()),
            shift_m: shift_m.transpose()?.unwrap_or_default(),
            turn_rad,
            seed,
        };
        let evaluator = Arc::clone(&self.evaluator);
        let outcome = watched(py, None, move |_| Ok(evaluator.trial().run(&command, &truth, Engine::Diffsim)?))?;
        Ok(Outcome::of(&outcome))
    }

    /// How `count` trials of the grasp end, under frictions, errors of the assumed friction, places and shakes that `seed` draws: a list of
    /// verdicts, see `Outcome.verdict`. Each has a command of its own; where there is none, the verdict says why.
    ///
    /// `progress` is called now and then with the part that is done, from 0 to 1.
    #[pyo3(signature = (grasp, count=24, *, seed=0, progress=None))]
    fn rollouts(
        &self,
        py: Python<'_>,
        grasp: PyRef<'_, Grasp>,
        count: usize,
        seed: u64,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> Result<Vec<String>> {
        let (grasp, evaluator) = (grasp.inner.clone(), Arc::clone(&self.evaluator));
        let (mass_kg, spread) = (self.mass_kg(), ConditionSpread::around(Some(self.friction())));
        let tried = watched(py, progress, move |part| {
            let conditions = spread.conditions(count, seed);
            // A closing and a trial for each.
            let (done, all) = (AtomicUsize::new(0), 2.0 * count as f64);
            let go_on = || {
                part.set(done.fetch_add(1, Ordering::Relaxed) as f64 / all);
                part.flow()
            };
            Ok(rollouts(&Stoppable::new(&*evaluator, &go_on), &grasp, mass_kg, &conditions)?)
        })?;
        Ok(tried.iter().map(|t| t.verdict.to_string()).collect())
    }

    fn __repr__(&self) -> String {
        format!("Trial({:.3} kg at friction {}, \"{}\")", self.mass_kg(), self.friction(), self.hand())
    }
}

/// What a hand is commanded for a grasp.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Command {
    inner: drex_trial::Command,
}

#[pymethods]
impl Command {
    /// Joint angles of the grasp, shape (J,), rad, in the order of the hand's model.
    #[getter]
    fn joints_rad<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.joints.iter().copied())
    }

    /// Pose of the hand's base in the world, shape (7,): x, y, z, qw, qx, qy, qz.
    #[getter]
    fn world_from_base<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, pose_row(&self.inner.world_from_base))
    }

    /// Joint torques of the grip force, shape (J,), N m, without what holds the hand's own weight.
    #[getter]
    fn torques_nm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.torques_nm.iter().copied())
    }

    /// Largest torque that each joint brings to bear on the object, at rest and shaken, shape (J,), N m.
    #[getter]
    fn limits_nm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.limits_nm.iter().copied())
    }

    /// Grip force: sum of the normal forces, N.
    #[getter]
    fn grip_force_n(&self) -> f64 {
        self.inner.grip_force_n
    }

    /// Sum of the normal forces of each finger, shape (F,), N; the palm is not among them.
    #[getter]
    fn per_finger_n<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.per_finger_n.iter().copied())
    }

    fn __repr__(&self) -> String {
        format!("Command({:.2} N)", self.inner.grip_force_n)
    }
}

/// How a trial ended.
#[pyclass(module = "drex", frozen, get_all)]
pub(crate) struct Outcome {
    /// "success", or the first thing that went wrong: "no_contact", "table", "slip", "drop", "crushed", "penetration", "torque_limit",
    /// "cannot_carry" or "diverged".
    verdict: String,
    /// Time at which it went wrong, s; None for a success.
    failed_at_s: Option<f64>,
    /// Grip force that was commanded, N.
    grip_force_n: f64,
    /// Grip force that was delivered, mean over the hold, N; None if the trial ended before.
    held_n: Option<f64>,
    /// Largest normal force of one finger, N.
    peak_finger_n: f64,
    /// Longest way that the object slid over one finger after the lift began, m.
    slip_m: f64,
    /// Largest turn of the object in the palm after the lift began, rad.
    turn_rad: f64,
    /// Deepest penetration of hand and object, m.
    penetration_m: f64,
    /// For each finger whether it touched when the lift began.
    fingers_in_contact: Vec<bool>,
    /// Share of the time from the lift on in which at least two fingers held the object.
    retained: f64,
    /// Share of the friction that was used in the hold; 1 slips. None if the trial ended before.
    friction_used: Option<f64>,
    /// Distance from slipping or turning too far, from 1 (nothing moved) to 0 (at a limit, or failed).
    safety_margin: f64,
}

impl Outcome {
    fn of(outcome: &drex_trial::Outcome) -> Self {
        Self {
            verdict: outcome.verdict.to_string(),
            failed_at_s: outcome.failed_at_s,
            grip_force_n: outcome.grip_force_n,
            held_n: outcome.held_n,
            peak_finger_n: outcome.peak_finger_n,
            slip_m: outcome.slip_m,
            turn_rad: outcome.turn_rad,
            penetration_m: outcome.penetration_m,
            fingers_in_contact: outcome.fingers_in_contact.clone(),
            retained: outcome.retained,
            friction_used: outcome.friction_used,
            safety_margin: outcome.safety_margin(),
        }
    }
}

#[pymethods]
impl Outcome {
    fn __repr__(&self) -> String {
        format!("Outcome(\"{}\")", self.verdict)
    }
}

/// A grasp that was chosen by trials, and how further trials of it went.
#[pyclass(module = "drex", frozen, get_all)]
pub(crate) struct TriedGrasp {
    /// The grasp, a `Grasp`.
    grasp: Py<Grasp>,
    /// Grip force for the object's mass and friction, sum of the normal forces, N.
    grip_force_n: f64,
    /// Number of trials in which the object stayed in the hand.
    held: usize,
    /// How each trial ended, see `Outcome.verdict`.
    verdicts: Vec<String>,
    /// 95 % interval of the share of trials that hold (Wilson).
    interval: (f64, f64),
}

#[pymethods]
impl TriedGrasp {
    fn __repr__(&self) -> String {
        format!("TriedGrasp({:.1} N, held in {} of {} trials)", self.grip_force_n, self.held, self.verdicts.len())
    }
}

/// Finds a grasp of a mesh by a hand that holds in simulation; None if none does. It takes some seconds.
///
/// The object is what `Trial` takes, and so is `hand`. If a network for this hand comes with the package, its proposals are tried first. If there is
/// none, or they hold under fewer than nine tenths of the conditions of the selection, `candidates` pinches are looked at, and a fiftieth as many power grasps. `simulated` of
/// what is found are simulated before one is chosen, which then goes through `trials` further trials. `progress` is called now and
/// then with about the part that is done, from 0 to 1.
#[pyfunction]
#[pyo3(signature = (mesh, mass_kg=None, hand=HandInput::default(), seed=0, progress=None, *, friction=None, unit="auto",
    candidates=20000, simulated=20, trials=24))]
pub(crate) fn find_grasp(
    py: Python<'_>,
    mesh: &Bound<'_, PyAny>,
    mass_kg: Option<f64>,
    hand: HandInput<'_>,
    seed: u64,
    progress: Option<&Bound<'_, PyAny>>,
    friction: Option<f64>,
    unit: &str,
    candidates: usize,
    simulated: usize,
    trials: usize,
) -> Result<Option<TriedGrasp>> {
    let (object, hand) = (ObjectInput::of(mesh, mass_kg, friction, unit)?, hand.model()?);
    let mut options = FindOptions::default();
    (options.candidates, options.simulated, options.trials, options.seed) = (candidates, simulated, trials, seed);
    let found = watched(py, progress, move |part| {
        let watch = |done| {
            part.set(done);
            part.flow()
        };
        Ok(drex_twin::propose::find_grasp(&object.object()?, &hand, &options, &watch)?)
    })?;
    let tried = |found: drex_trial::TriedGrasp| {
        Ok(TriedGrasp {
            grasp: Py::new(py, Grasp { inner: found.grasp })?,
            grip_force_n: found.grip_force_n,
            held: found.held,
            verdicts: found.verdicts.iter().map(ToString::to_string).collect(),
            interval: (found.interval.low, found.interval.high),
        })
    };
    found.map(tried).transpose()
}
