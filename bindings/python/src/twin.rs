//! Twin folders: the pipeline, and what it made.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use drex_twin::records::MassFile;
use drex_twin::{PredictOptions, Predictor, Progress, RunOptions, Stage};
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::arrays::{out1, plain, pose, pose_row};
use crate::failure::Result;
use crate::grasp::Grasp;
use crate::policy::Policy;
use crate::sysid::Identification;
use crate::watch::{Part, watched, watched_with_notes};

/// Friction between hand and object: a number, or the ends of an interval.
#[derive(FromPyObject)]
pub(crate) enum FrictionInput {
    Known(f64),
    Between(f64, f64),
}

/// A twin: a folder with a twin.toml, and what the stages of the pipeline have made of it (`Twin.open`).
///
/// Stages are "scan", "identify", "asset", "grasps", "train", "evaluate", "trial", "execute", "appearance" and "report". The manifest and
/// the records are read anew by every call, as the command line does.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Twin {
    /// What it was opened with: its manifest, or the folder.
    opened: PathBuf,
    path: PathBuf,
    name: String,
    seed: Option<u64>,
}

impl Twin {
    /// How to open it, where it is needed.
    fn opener(&self) -> impl FnOnce() -> Result<drex_twin::Twin> + Send + 'static {
        let (path, seed) = (self.opened.clone(), self.seed);
        move || Ok(drex_twin::Twin::open(&path)?.with_seed(seed))
    }
}

#[pymethods]
impl Twin {
    /// Opens the twin at `path`, a twin.toml or the folder that holds it. `seed` is used in place of the manifest's.
    #[staticmethod]
    #[pyo3(signature = (path, *, seed=None))]
    fn open(path: PathBuf, seed: Option<u64>) -> Result<Self> {
        let twin = drex_twin::Twin::open(&path)?;
        Ok(Self { opened: path, path: twin.root, name: twin.manifest.name, seed })
    }

    /// The folder.
    #[getter]
    fn path(&self) -> &Path {
        &self.path
    }

    /// The name that the manifest gives the object.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Does every stage whose inputs changed, as `drex run` does, and says in a dict which were made and which were up to date.
    ///
    /// `stages` are the names of those that are asked for (all if left out); what they need is done too. `progress` is called now and then
    /// with the part of the stages that is done, from 0 to 1, `note` with each line that the command line would print. Ctrl-C, or an
    /// exception of these two, ends the call at once; the stage at work stops as soon as it can, and another run goes on from there.
    /// Raises `Busy` if another process works on the twin.
    #[pyo3(signature = (stages=None, progress=None, *, note=None))]
    fn run<'py>(
        &self,
        py: Python<'py>,
        stages: Option<Vec<String>>,
        progress: Option<&Bound<'py, PyAny>>,
        note: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyAny>> {
        let mut options =
            RunOptions::default().with_picture(drex_report::write_picture).with_report(drex_report::write);
        if let Some(names) = stages {
            let stages: Vec<Stage> = names.iter().map(|name| name.parse()).collect::<drex_twin::Result<_>>()?;
            options = options.with_stages(&stages);
        }
        let open = self.opener();
        let summary = watched_with_notes(py, progress, note, move |part| Ok(open()?.run(&options, &Run(part))?))?;
        plain(py, &summary)
    }

    /// The mass that the stage identify found. Raises `Error` as long as that has not been done.
    #[getter]
    fn mass(&self, py: Python<'_>) -> Result<Mass> {
        let open = self.opener();
        watched(py, None, move |_| Ok(Mass { inner: open()?.mass()? }))
    }

    /// The network that the stage train made. Raises `Error` as long as that has not been done.
    #[getter]
    fn policy(&self, py: Python<'_>) -> Result<Policy> {
        let open = self.opener();
        watched(py, None, move |_| Ok(Policy { inner: Arc::new(open()?.policy()?) }))
    }

    /// The grasp that `drex grasp` gives for the object, if its mesh frame is at `pose` in the world (a row x, y, z, qw, qx, qy, qz or a 4 x 4
    /// matrix; at rest on the table if left out) and weighs `mass_kg` (what grasps are made for if left out, see `Mass.grip_kg`).
    ///
    /// `friction` between hand and object is a number or a pair, the ends of an interval that it is in; if left out the manifest's, or 0.3 to 0.8 if it
    /// states none. Raises `Error` as long as the stage train has not been done.
    #[pyo3(signature = (pose=None, mass_kg=None, *, friction=None))]
    fn predict(
        &self,
        py: Python<'_>,
        pose: Option<&Bound<'_, PyAny>>,
        mass_kg: Option<f64>,
        friction: Option<FrictionInput>,
    ) -> Result<Prediction> {
        let world_from_object = pose.map(|p| self::pose("pose", p)).transpose()?;
        let friction = friction.map(|f| match f {
            FrictionInput::Known(mu) => (mu, mu),
            FrictionInput::Between(low, high) => (low, high),
        });
        let options = PredictOptions { world_from_object, mass_kg, friction, ..PredictOptions::default() };
        let open = self.opener();
        let inner = watched(py, None, move |_| Ok(Predictor::of_twin(&open()?, &options)?.predict()?))?;
        let grasp = Py::new(py, Grasp { inner: inner.grasp.clone() })?;
        Ok(Prediction { inner, grasp })
    }

    fn __repr__(&self) -> String {
        format!("Twin(\"{}\" in {})", self.name, self.path.display())
    }
}

/// Hands on what a run tells.
pub(crate) struct Run<'a>(pub(crate) &'a Part);

impl Progress for Run<'_> {
    fn note(&self, text: &str) {
        self.0.note(text);
    }

    fn stages(&self, done: usize, total: usize) {
        self.0.set(done as f64 / total.max(1) as f64);
    }

    fn is_stopped(&self) -> bool {
        self.0.is_stopped()
    }
}

/// The mass of a twin: all that is known about it, pushes and prior together.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Mass {
    inner: MassFile,
}

#[pymethods]
impl Mass {
    /// Median of the posterior, kg: the mass of the simulation asset.
    #[getter]
    fn mass_kg(&self) -> f64 {
        self.inner.mass_kg
    }

    /// Its 95 % interval, kg.
    #[getter]
    fn ci95_kg(&self) -> (f64, f64) {
        self.inner.ci95_kg.into()
    }

    /// Its standard deviation, kg.
    #[getter]
    fn sd_kg(&self) -> f64 {
        self.inner.sd_kg
    }

    /// Mass that grasps are made for, kg: enough for an object that may be heavier than the median.
    #[getter]
    fn grip_kg(&self) -> f64 {
        self.inner.grip_kg
    }

    /// Where it comes from: "weighed", "identified", "bounded" (the pushes leave a range, a prior weighs it) or "prior".
    #[getter]
    fn source<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner.source)
    }

    /// What the pushes said; None where there were none.
    #[getter]
    fn identification(&self) -> Option<Identification> {
        self.inner.identification.clone().map(|inner| Identification { inner })
    }

    /// The verdict of the pushes, see `Identification.verdict`; None where there were none.
    #[getter]
    fn verdict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner.identification.as_ref().map(|i| i.verdict))
    }

    /// The verdict in words; None where there were no pushes.
    #[getter]
    fn reason(&self) -> Option<&str> {
        self.inner.identification.as_ref().map(|i| i.reason.as_str())
    }

    /// Everything, as mass.json has it.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner)
    }

    fn __repr__(&self) -> String {
        let [mass, lo, hi] = [self.inner.mass_kg, self.inner.ci95_kg[0], self.inner.ci95_kg[1]].map(|kg| 1e3 * kg);
        format!("Mass({mass:.1} g, 95 % interval {lo:.1} to {hi:.1} g)")
    }
}

/// The grasp that a twin's network gives for an object, with its grip force: what `drex grasp` answers.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Prediction {
    inner: drex_twin::Prediction,
    grasp: Py<Grasp>,
}

#[pymethods]
impl Prediction {
    /// The grasp.
    #[getter]
    fn grasp(&self, py: Python<'_>) -> Py<Grasp> {
        self.grasp.clone_ref(py)
    }

    /// Pose of the hand's base in the world, shape (7,): x, y, z, qw, qx, qy, qz.
    #[getter]
    fn world_from_base<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray1<f64>>> {
        Ok(out1(py, pose_row(&self.inner.world_from_base.to_pose()?)))
    }

    /// Grip force by the network, sum of the normal forces, N.
    #[getter]
    fn grip_force_n(&self) -> f64 {
        self.inner.grip_force_n
    }

    /// Grip force by the grip-force policy at the contacts of the closed hand, N; None where they cannot carry the object.
    #[getter]
    fn needed_grip_force_n(&self) -> Option<f64> {
        self.inner.needed_grip_force_n
    }

    /// Joint torques of that force with the hand's own weight, shape (J,), N m; empty where there is none.
    #[getter]
    fn joint_torques_nm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.joint_torques_nm.iter().copied())
    }

    /// Contacts of the closed hand: a dict with "finger", "contacts" and "normal_n" per finger, the palm last.
    #[getter]
    fn contacts<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner.contacts)
    }

    /// Why there is no grip force that holds; None where there is one.
    #[getter]
    fn cannot_hold(&self) -> Option<&str> {
        self.inner.cannot_hold.as_deref()
    }

    /// Mass that was assumed, kg.
    #[getter]
    fn mass_kg(&self) -> f64 {
        self.inner.mass_kg
    }

    /// Coefficient of friction that was assumed; of an interval the one that the grip force is for.
    #[getter]
    fn friction(&self) -> f64 {
        self.inner.friction
    }

    /// Probability that the object asks for more than it is gripped for, where friction is an interval; else None.
    #[getter]
    fn risk(&self) -> Option<f64> {
        self.inner.risk
    }

    /// Probability of the grasp by the network.
    #[getter]
    fn weight(&self) -> f64 {
        self.inner.weight
    }

    /// Place among the network's proposals in the order in which they are tried, from 1.
    #[getter]
    fn place(&self) -> usize {
        self.inner.place
    }

    /// Everything, as `drex grasp --json` prints it.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner)
    }

    fn __repr__(&self) -> String {
        let p = &self.inner;
        match p.needed_grip_force_n {
            Some(force) => format!("Prediction(\"{}\", {force:.2} N for {:.0} g)", p.grasp.hand, 1e3 * p.mass_kg),
            None => format!("Prediction(\"{}\", cannot hold {:.0} g)", p.grasp.hand, 1e3 * p.mass_kg),
        }
    }
}
