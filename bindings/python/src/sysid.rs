//! Masses from recorded pushes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use drex_core::Trajectory;
use drex_core::trajectory::PoseNoise;
use drex_mesh::{AssetOptions, build_asset};
use drex_recording::{Drive, ForceProfile, PushRecording};
use drex_sysid::calibrate::HandCalibration;
use drex_sysid::{IdentifyOptions, Knowledge, Method, identify_watched};
use nalgebra::{Point3, Vector3};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::{column, out1, out2, plain, pose, pose_row, poses, vector, vectors};
use crate::failure::{Result, refused};
use crate::mesh::Asset;
use crate::watch::watched;

/// A recorded push of an object, from arrays or from files (`Push.load`).
///
/// From arrays: the object's pose over time in a world with z up (`times_s` (N,), `poses` (N, 7) or (N, 4, 4): poses of the mesh's
/// frame), and a known force on it (`force_times_s` (K,), `forces_n` (K, 3) in the world), held from each sample to the next, zero
/// before the first and from the last on, at `point_in_object_m` of the mesh's frame. `friction` is that of object and table, free if
/// left out. Standard deviations of the poses are found in the track if left out. `at_rest` says that the object rests at
/// `start_time_s` (the first pose), at `start_pose` if that is known better than the track. Logged hands and fingertips come from files.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Push {
    recording: PushRecording,
}

#[pymethods]
impl Push {
    #[new]
    #[pyo3(signature = (times_s, poses, *, force_times_s, forces_n, point_in_object_m, torques_nm=None, mesh=None, name="push",
        friction=None, table_height_m=0.0, gravity_m_s2=None, at_rest=true, start_time_s=None, start_pose=None,
        position_sd_m=None, rotation_sd_rad=None))]
    fn new(
        times_s: &Bound<'_, PyAny>,
        poses: &Bound<'_, PyAny>,
        force_times_s: &Bound<'_, PyAny>,
        forces_n: &Bound<'_, PyAny>,
        point_in_object_m: &Bound<'_, PyAny>,
        torques_nm: Option<&Bound<'_, PyAny>>,
        mesh: Option<PathBuf>,
        name: &str,
        friction: Option<f64>,
        table_height_m: f64,
        gravity_m_s2: Option<&Bound<'_, PyAny>>,
        at_rest: bool,
        start_time_s: Option<f64>,
        start_pose: Option<&Bound<'_, PyAny>>,
        position_sd_m: Option<f64>,
        rotation_sd_rad: Option<f64>,
    ) -> Result<Self> {
        let times_s = column("times_s", times_s)?;
        increasing("times_s", &times_s)?;
        let track = Trajectory::from_samples(&times_s, &self::poses("poses", poses)?)?;
        // The start of a recording is at time zero.
        let zero = start_time_s.or(times_s.first().copied()).unwrap_or(0.0);
        let mut force = force_profile(force_times_s, forces_n, point_in_object_m, torques_nm)?;
        force.times_s.iter_mut().for_each(|t| *t -= zero);
        let mut recording =
            PushRecording::new(name, mesh.unwrap_or_default(), track.shifted(-zero), Drive::Force(force));
        let positive = |what: &str, x: Option<f64>, least: f64| match x {
            Some(x) if !(x >= least && x.is_finite()) => {
                refused(format!("{what} is {x}; give a number from {least} up"))
            }
            _ => Ok(x),
        };
        recording.support.friction = positive("friction", friction, 0.0)?;
        let sd = (positive("position_sd_m", position_sd_m, 1e-9)?, positive("rotation_sd_rad", rotation_sd_rad, 1e-9)?);
        recording.noise = match sd {
            (None, None) => None,
            (Some(position_m), Some(rotation_rad)) => Some(PoseNoise { position_m, rotation_rad }),
            _ => return refused("one of position_sd_m and rotation_sd_rad is missing; give both or neither"),
        };
        if !(zero.is_finite() && table_height_m.is_finite()) {
            return refused("start_time_s or table_height_m is not finite; give seconds and metres");
        }
        recording.support.table_height_m = table_height_m;
        if let Some(gravity) = gravity_m_s2 {
            recording.gravity = vector("gravity_m_s2", gravity)?;
        }
        recording.starts_at_rest = at_rest;
        recording.initial_pose = start_pose.map(|p| pose("start_pose", p)).transpose()?;
        Ok(Self { recording })
    }

    /// Reads a push.toml, or a folder with one; formats are in docs/formats.md.
    ///
    /// `encoder` says whether the record of a fingertip's encoder is used.
    #[staticmethod]
    #[pyo3(signature = (path, *, encoder=true))]
    fn load(path: PathBuf, encoder: bool) -> Result<Self> {
        let recording = PushRecording::load(&path)?;
        Ok(Self { recording: if encoder { recording } else { recording.without_encoder() } })
    }

    /// Its name in reports.
    #[getter]
    fn name(&self) -> &str {
        &self.recording.name
    }

    /// The object's mesh file; None for a push from arrays without one.
    #[getter]
    fn mesh(&self) -> Option<&Path> {
        Some(self.recording.mesh.as_path()).filter(|p| !p.as_os_str().is_empty())
    }

    /// Times of the poses, shape (N,), seconds from the start of the push.
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.recording.track.times_s().iter().copied())
    }

    /// Tracked poses, shape (N, 7): x, y, z, qw, qx, qy, qz.
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        out2(py, self.recording.track.poses().iter().map(pose_row))
    }

    /// What the reader remarked, one sentence each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.recording.notes.clone()
    }

    fn __repr__(&self) -> String {
        let span = self.recording.track.span_s().map_or(0.0, |(a, b)| b - a);
        format!("Push(\"{}\", {} poses over {span:.3} s)", self.recording.name, self.recording.track.len())
    }
}

/// Refuses times that do not increase.
pub(crate) fn increasing(what: &str, times_s: &[f64]) -> Result<()> {
    match times_s.windows(2).position(|w| !(w[1] > w[0])) {
        Some(i) => refused(format!(
            "{what}[{}] = {} s is not after {} s; sort the samples by time and drop repeated ones",
            i + 1,
            times_s[i + 1],
            times_s[i]
        )),
        None => Ok(()),
    }
}

fn force_profile(
    times_s: &Bound<'_, PyAny>,
    forces_n: &Bound<'_, PyAny>,
    point: &Bound<'_, PyAny>,
    torques_nm: Option<&Bound<'_, PyAny>>,
) -> Result<ForceProfile> {
    let times_s = column("force_times_s", times_s)?;
    increasing("force_times_s", &times_s)?;
    let forces_n = vectors("forces_n", forces_n)?;
    let torques_nm = torques_nm.map_or(Ok(Vec::new()), |t| vectors("torques_nm", t))?;
    if times_s.is_empty() || forces_n.len() != times_s.len() || ![0, times_s.len()].contains(&torques_nm.len()) {
        return refused(format!(
            "there are {} force_times_s, {} forces_n and {} torques_nm; give one force (and torque, if any) per time, at least one",
            times_s.len(),
            forces_n.len(),
            torques_nm.len()
        ));
    }
    let point: Vector3<f64> = vector("point_in_object_m", point)?;
    Ok(ForceProfile { times_s, forces_n, torques_nm, point_in_object: Point3::from(point) })
}

/// The answer of `identify`: a mass with an interval, or why there is none. Values that there are not are None.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Identification {
    pub(crate) inner: drex_sysid::Identification,
}

#[pymethods]
impl Identification {
    /// The mass, kg; only with the verdict "identified".
    #[getter]
    fn mass_kg(&self) -> Option<f64> {
        self.inner.mass_kg
    }

    /// Its 95 % interval, kg.
    #[getter]
    fn ci95_kg(&self) -> Option<(f64, f64)> {
        self.inner.ci95_kg.map(|[lo, hi]| (lo, hi))
    }

    /// "identified", "only_mu_m" (only the product of friction and mass), "fitted" (by the method "adam": no interval, and nobody asked
    /// whether the pushes tell a mass) or "not_identifiable".
    #[getter]
    fn verdict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner.verdict)
    }

    /// The verdict in words.
    #[getter]
    fn reason(&self) -> &str {
        &self.inner.reason
    }

    /// Friction times mass, kg, with the verdict "only_mu_m".
    #[getter]
    fn mu_m_kg(&self) -> Option<f64> {
        self.inner.mu_m_kg
    }

    /// Friction against the support, if it was estimated along with the mass.
    #[getter]
    fn friction(&self) -> Option<f64> {
        self.inner.friction
    }

    /// Standard deviation of the logarithm of the mass, all sources of error together.
    #[getter]
    fn sd_log_mass(&self) -> Option<f64> {
        self.inner.sd_log_mass
    }

    /// Its parts by source.
    #[getter]
    fn error_budget<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner.error_budget)
    }

    /// Masses of the likelihood profile, shape (P,), kg, increasing.
    #[getter]
    fn profile_mass_kg<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.profile.iter().map(|p| p.0))
    }

    /// Cost at each of them, shape (P,): half the robust sum of squares, everything else solved for.
    #[getter]
    fn profile_cost<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.profile.iter().map(|p| p.1))
    }

    /// What was taken for granted, one sentence each.
    #[getter]
    fn assumptions(&self) -> Vec<String> {
        self.inner.assumptions.clone()
    }

    /// How each push was reproduced.
    #[getter]
    fn pushes(&self) -> Vec<PushReport> {
        self.inner.pushes.iter().map(|p| PushReport { inner: p.clone() }).collect()
    }

    /// Wall time, seconds.
    #[getter]
    fn seconds(&self) -> f64 {
        self.inner.seconds
    }

    /// Pushes that were simulated.
    #[getter]
    fn simulations(&self) -> usize {
        self.inner.simulations
    }

    /// Everything, as `drex identify --out` writes it.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner)
    }

    fn __repr__(&self) -> String {
        match (self.inner.mass_kg, self.inner.ci95_kg) {
            (Some(kg), Some([lo, hi])) => {
                format!("Identification({:.1} g, 95 % interval {:.1} to {:.1} g)", 1e3 * kg, 1e3 * lo, 1e3 * hi)
            }
            (Some(kg), None) => format!("Identification({:.1} g, no interval)", 1e3 * kg),
            _ => format!("Identification(no mass: {})", self.inner.reason),
        }
    }
}

/// How one push was reproduced.
#[pyclass(module = "drex", frozen)]
pub(crate) struct PushReport {
    inner: drex_sysid::PushReport,
}

#[pymethods]
impl PushReport {
    /// Name of the push.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Times of the poses, shape (N,), seconds.
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.times_s.iter().copied())
    }

    /// Tracked poses, shape (N, 7): x, y, z, qw, qx, qy, qz.
    #[getter]
    fn observed<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        out2(py, self.inner.observed.iter().copied())
    }

    /// Simulated poses at the estimate, same layout; shape (0, 7) if nothing was simulated.
    #[getter]
    fn simulated<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        out2(py, self.inner.simulated.iter().copied())
    }

    /// Root mean square of the position residual, m.
    #[getter]
    fn rms_position_m(&self) -> Option<f64> {
        self.inner.rms_position_m
    }

    /// Root mean square of the rotation residual, rad.
    #[getter]
    fn rms_rotation_rad(&self) -> Option<f64> {
        self.inner.rms_rotation_rad
    }

    /// Poses that count less than half.
    #[getter]
    fn outliers(&self) -> usize {
        self.inner.outliers
    }

    /// What each pose tells about the mass, as a share of what all tell, shape (N,); empty if nothing was estimated.
    #[getter]
    fn information<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.information.iter().copied())
    }

    /// What was found in the recording, one sentence each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.inner.notes.clone()
    }

    /// Everything.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner)
    }

    fn __repr__(&self) -> String {
        format!("PushReport(\"{}\", {} poses)", self.inner.name, self.inner.times_s.len())
    }
}

/// Weighs an object from recorded pushes, or says why they cannot.
///
/// `pushes` is one push or a sequence of pushes of one object: each a `Push`, a push.toml, or the folder of one. The object is `asset`,
/// or made of the pushes' mesh (metres). `free` names parameters to be estimated too, `fix` gives values of others, `prior` gives
/// (mean, standard deviation), the latter of the logarithm for numbers that are positive by nature. `hand` is a file of `drex
/// calibrate-hand`. `method` is "lm" (scan, Levenberg-Marquardt, interval and verdict) or "adam" (for comparison, no interval).
/// `progress` is called now and then with the part that is done, from 0 to 1. A recording that tells nothing about the mass is no
/// error but a verdict.
#[pyfunction]
#[pyo3(signature = (pushes, *, asset=None, free=Vec::new(), fix=BTreeMap::new(), prior=BTreeMap::new(), hand=None, method="lm",
    seed=0, progress=None))]
pub(crate) fn identify(
    py: Python<'_>,
    pushes: &Bound<'_, PyAny>,
    asset: Option<PyRef<'_, Asset>>,
    free: Vec<String>,
    fix: BTreeMap<String, f64>,
    prior: BTreeMap<String, (f64, f64)>,
    hand: Option<PathBuf>,
    method: &str,
    seed: u64,
    progress: Option<&Bound<'_, PyAny>>,
) -> Result<Identification> {
    let recordings = recordings(pushes)?;
    let Some(first) = recordings.first() else { return refused("there is no push; give at least one") };
    let mut options = IdentifyOptions::default();
    let free = free.into_iter().map(|name| (name, Knowledge::Free));
    let fix = fix.into_iter().map(|(name, value)| (name, Knowledge::Fixed(value)));
    let prior = prior.into_iter().map(|(name, (mean, sd))| (name, Knowledge::Prior { mean, sd }));
    for (name, knowledge) in free.chain(fix).chain(prior) {
        let parameter = name.parse()?;
        if options.parameters.get(parameter).is_some() {
            return refused(format!("{name} is stated twice; say once what is known about it"));
        }
        options.parameters.set(parameter, knowledge)?;
    }
    options.method = match method {
        "lm" => Method::Lm,
        "adam" => Method::Adam,
        other => return refused(format!("method is {other:?}; give \"lm\" or \"adam\"")),
    };
    options.hand = hand.map(|path| HandCalibration::load(&path)).transpose()?;
    options.seed = seed;
    let mesh = first.mesh.clone();
    let asset = asset.map(|a| std::sync::Arc::clone(&a.inner));
    if asset.is_none() {
        if let Some(missing) = recordings.iter().find(|r| r.mesh.as_os_str().is_empty()) {
            return refused(format!("push \"{}\" names no mesh; give the object as asset=", missing.name));
        }
        if let Some(other) = recordings.iter().find(|r| !same_file(&r.mesh, &mesh)) {
            return refused(format!(
                "{} pushes {} and {} pushes {}; several pushes at once must be of one object",
                first.name,
                mesh.display(),
                other.name,
                other.mesh.display()
            ));
        }
    }
    let inner = watched(py, progress, move |part| {
        let asset = match asset {
            Some(asset) => asset,
            None => build_asset(&mesh, &AssetOptions::in_metres())?.into(),
        };
        let object = asset.to_exact_object("")?;
        Ok(identify_watched(&recordings, &object, &options, &|done| part.set(done))?)
    })?;
    Ok(Identification { inner })
}

/// One push, or several.
fn recordings(pushes: &Bound<'_, PyAny>) -> Result<Vec<PushRecording>> {
    let one = |item: &Bound<'_, PyAny>| -> Result<Option<PushRecording>> {
        if let Ok(push) = item.extract::<PyRef<'_, Push>>() {
            return Ok(Some(push.recording.clone()));
        }
        match item.extract::<PathBuf>() {
            Ok(path) => Ok(Some(PushRecording::load(&path)?)),
            Err(_) => Ok(None),
        }
    };
    if let Some(push) = one(pushes)? {
        return Ok(vec![push]);
    }
    let mut out = Vec::new();
    for item in pushes.try_iter()? {
        match one(&item?)? {
            Some(push) => out.push(push),
            None => return refused(format!("push {} is neither a Push nor a path; give one of these", out.len())),
        }
    }
    Ok(out)
}

fn same_file(a: &Path, b: &Path) -> bool {
    matches!((std::fs::canonicalize(a), std::fs::canonicalize(b)), (Ok(a), Ok(b)) if a == b)
}
