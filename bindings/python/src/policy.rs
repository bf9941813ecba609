//! Grasp policies.

use std::path::PathBuf;
use std::sync::Arc;

use drex_core::ASSUMED_FRICTION;
use drex_policy::{GraspPolicy, Query};
use drex_twin::learn::grasp_of;
use nalgebra::{Point3, Vector3};
use numpy::PyArray2;
use pyo3::prelude::*;

use crate::arrays::{column, out1, out2, points, pose, vector};
use crate::failure::Result;
use crate::grasp::{Grasp, PredictedGrasp};
use crate::mesh::Asset;
use crate::watch::watched;

/// A trained grasp network: from an object's points, its mass and its friction to grasps with their grip force (`Policy.open`).
///
/// What is grasped is `points` (N, 3) of its surface in metres, at least as many as `Policy.points`, in any frame in which `up` (z if left
/// out) points away from the table, with the lowest point on the table or the table `table_below_m` below the centre of the points' box.
/// Or it is an `Asset` that stands in its rest pose: then `seed` draws the points. Poses of grasps are in the frame of the points.
/// It does not check what it proposes; a `Trial` does.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Policy {
    pub(crate) inner: Arc<GraspPolicy>,
}

#[pymethods]
impl Policy {
    /// Reads the folder of a policy, such as policy/network of a twin.
    #[staticmethod]
    fn open(py: Python<'_>, path: PathBuf) -> Result<Self> {
        watched(py, None, move |_| Ok(Self { inner: Arc::new(GraspPolicy::load(&path)?) }))
    }

    /// Name of the hand's model.
    #[getter]
    fn hand(&self) -> &str {
        self.inner.hand()
    }

    /// Names of the joints, in the order of its grasps.
    #[getter]
    fn joint_names(&self) -> Vec<String> {
        self.inner.joint_names().to_vec()
    }

    /// Limits of the joints, shape (J, 2), rad.
    #[getter]
    fn joint_limits_rad<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        out2(py, self.inner.joint_limits().iter().map(|(lo, hi)| [*lo, *hi]))
    }

    /// Names of the fingers.
    #[getter]
    fn fingers(&self) -> Vec<String> {
        self.inner.fingers().to_vec()
    }

    /// Number of points of the object that enter the network.
    #[getter]
    fn points(&self) -> usize {
        self.inner.points()
    }

    /// Number of grasps that `predict` proposes.
    #[getter]
    fn modes(&self) -> usize {
        self.inner.modes()
    }

    /// Least and largest mass that it was trained on, kg.
    #[getter]
    fn mass_range_kg(&self) -> (f64, f64) {
        self.inner.mass_range_kg()
    }

    /// Least and largest coefficient of friction that it was trained on.
    #[getter]
    fn friction_range(&self) -> (f64, f64) {
        self.inner.friction_range()
    }

    /// The grasps that it proposes, the most probable first.
    #[pyo3(signature = (points, mass_kg, *, friction=None, up=None, table_below_m=None, seed=0))]
    fn predict(
        &self,
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        mass_kg: f64,
        friction: Option<f64>,
        up: Option<&Bound<'_, PyAny>>,
        table_below_m: Option<f64>,
        seed: u64,
    ) -> Result<Vec<PredictedGrasp>> {
        let asked = Asked::of(points, mass_kg, friction, up, table_below_m, seed)?;
        let policy = Arc::clone(&self.inner);
        let grasps = watched(py, None, move |_| asked.answer(&policy, |query| policy.predict(query)))?;
        self.predicted(py, &grasps)
    }

    /// `count` grasps drawn from the density that it has learned; the same seed draws the same.
    #[pyo3(signature = (points, mass_kg, count, *, friction=None, up=None, table_below_m=None, seed=0))]
    fn sample(
        &self,
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        mass_kg: f64,
        count: usize,
        friction: Option<f64>,
        up: Option<&Bound<'_, PyAny>>,
        table_below_m: Option<f64>,
        seed: u64,
    ) -> Result<Vec<PredictedGrasp>> {
        let asked = Asked::of(points, mass_kg, friction, up, table_below_m, seed)?;
        let policy = Arc::clone(&self.inner);
        let grasps = watched(py, None, move |_| asked.answer(&policy, |query| policy.sample(query, count, seed)))?;
        self.predicted(py, &grasps)
    }

    /// Logarithm of the density of a grasp with these joints (J,), nats, with the pose of the hand's base if that is given.
    #[pyo3(signature = (points, mass_kg, joints_rad, object_from_base=None, *, friction=None, up=None, table_below_m=None, seed=0))]
    fn log_density(
        &self,
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        mass_kg: f64,
        joints_rad: &Bound<'_, PyAny>,
        object_from_base: Option<&Bound<'_, PyAny>>,
        friction: Option<f64>,
        up: Option<&Bound<'_, PyAny>>,
        table_below_m: Option<f64>,
        seed: u64,
    ) -> Result<f64> {
        let asked = Asked::of(points, mass_kg, friction, up, table_below_m, seed)?;
        let joints = column("joints_rad", joints_rad)?;
        let base = object_from_base.map(|base| pose("object_from_base", base)).transpose()?;
        let policy = Arc::clone(&self.inner);
        watched(py, None, move |_| asked.answer(&policy, |query| policy.log_density(query, &joints, base.as_ref())))
    }

    fn __repr__(&self) -> String {
        let (lo, hi) = self.inner.mass_range_kg();
        format!("Policy(\"{}\", {} modes, {lo:.3} to {hi:.3} kg)", self.inner.hand(), self.inner.modes())
    }
}

impl Policy {
    fn predicted(&self, py: Python<'_>, grasps: &[drex_policy::PredictedGrasp]) -> Result<Vec<PredictedGrasp>> {
        let predicted = |g: &drex_policy::PredictedGrasp| {
            let inner = grasp_of(self.inner.hand(), self.inner.joint_names(), g);
            Ok(PredictedGrasp {
                grasp: Py::new(py, Grasp { inner })?,
                contacts: out1(py, g.contacts.iter().copied()).unbind(),
                grip_force_n: g.grip_force_n,
                weight: g.weight,
            })
        };
        grasps.iter().map(predicted).collect()
    }
}

/// What a policy is asked about.
struct Asked {
    object: Points,
    up: Option<Vector3<f64>>,
    table_below_m: Option<f64>,
    mass_kg: f64,
    friction: f64,
}

enum Points {
    Given(Vec<Point3<f64>>),
    Drawn(Arc<drex_mesh::Asset>, u64),
}

impl Asked {
    fn of(
        object: &Bound<'_, PyAny>,
        mass_kg: f64,
        friction: Option<f64>,
        up: Option<&Bound<'_, PyAny>>,
        table_below_m: Option<f64>,
        seed: u64,
    ) -> Result<Self> {
        let mut up = up.map(|up| vector("up", up)).transpose()?;
        let (object, own) = match object.extract::<PyRef<'_, Asset>>() {
            Ok(asset) => {
                up = up.or(Some(asset.inner.world_from_mesh_at_rest.rotation.inverse() * Vector3::z()));
                (Points::Drawn(Arc::clone(&asset.inner), seed), asset.inner.friction)
            }
            Err(_) => (Points::Given(points("points", object)?), ASSUMED_FRICTION),
        };
        Ok(Self { object, up, table_below_m, mass_kg, friction: friction.unwrap_or(own) })
    }

    fn answer<T>(&self, policy: &GraspPolicy, ask: impl FnOnce(&Query<'_>) -> drex_policy::Result<T>) -> Result<T> {
        let drawn;
        let points = match &self.object {
            Points::Given(points) => points,
            Points::Drawn(asset, seed) => {
                drawn = asset.to_exact_object("object")?.point_cloud(policy.points(), *seed);
                &drawn
            }
        };
        let mut query = Query::new(points, self.mass_kg, self.friction);
        query.up = self.up.unwrap_or(query.up);
        query.table_below_m = self.table_below_m;
        Ok(ask(&query)?)
    }
}
