//! Robot models: kinematics and dynamics of hands and arms.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use drex_core::Pose;
use nalgebra::{Point3, Vector3};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Numbers, column, out1, out2, pose, pose_grid, pose_row, table, vector};
use crate::failure::{Failure, Result, refused};

/// A robot model from URDF or MJCF, or a bundled hand.
///
/// `model` is a file, or one of "leap_right", "leap_left", "allegro_right", "allegro_left". Joint vectors have the order of
/// `joint_names`, rad (m for joints that slide). Poses are rows x, y, z, qw, qx, qy, qz in metres; `base` is the pose of the
/// robot's base in the world, the identity if left out.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Robot {
    pub(crate) model: Arc<drex_robot::Robot>,
}

impl Robot {
    /// A joint vector of this robot.
    pub(crate) fn joints(&self, what: &'static str, q: &Bound<'_, PyAny>) -> Result<Vec<f64>> {
        let q = column(what, q)?;
        if q.len() != self.model.dof() {
            return refused(format!(
                "{what} has {} numbers, but robot \"{}\" has {} joints: {}",
                q.len(),
                self.model.name,
                self.model.dof(),
                self.model.joint_names().join(", ")
            ));
        }
        Ok(q)
    }
}

/// A hand as Python gives it: a `Robot`, or what `Robot` takes.
#[derive(FromPyObject)]
pub(crate) enum HandInput<'py> {
    /// A model.
    Model(PyRef<'py, Robot>),
    /// Its file or name.
    Named(PathBuf),
}

impl Default for HandInput<'_> {
    fn default() -> Self {
        Self::Named("leap_right".into())
    }
}

impl HandInput<'_> {
    /// The model.
    pub(crate) fn model(self) -> Result<Arc<drex_robot::Robot>> {
        match self {
            Self::Model(robot) => Ok(Arc::clone(&robot.model)),
            Self::Named(name) => Ok(Robot::new(name)?.model),
        }
    }
}

fn base_of(base: Option<&Bound<'_, PyAny>>) -> Result<Pose> {
    base.map_or(Ok(Pose::identity()), |b| pose("base", b))
}

fn gravity_of(gravity: Option<&Bound<'_, PyAny>>) -> Result<Vector3<f64>> {
    gravity.map_or(Ok(Vector3::new(0.0, 0.0, -9.81)), |g| vector("gravity_m_s2", g))
}

#[pymethods]
impl Robot {
    #[new]
    fn new(model: PathBuf) -> Result<Self> {
        Ok(Self { model: Arc::new(drex_robot::Robot::resolve(text_of(&model)?, Path::new(""))?) })
    }

    /// The mirror image: a left hand of a right one. Mirrored motions have the same joint values.
    fn mirrored(&self) -> Self {
        Self { model: Arc::new(self.model.mirrored()) }
    }

    /// Name that the file gives the model.
    #[getter]
    fn name(&self) -> &str {
        &self.model.name
    }

    /// Number of joints.
    #[getter]
    fn dof(&self) -> usize {
        self.model.dof()
    }

    /// Names of the joints, in the order of every joint vector.
    #[getter]
    fn joint_names(&self) -> Vec<&str> {
        self.model.joint_names()
    }

    /// Names of the links, the base first.
    #[getter]
    fn link_names(&self) -> Vec<&str> {
        self.model.links.iter().map(|l| l.name.as_str()).collect()
    }

    /// Names of the drives, in the order of control vectors; that of its joint for a drive without one.
    #[getter]
    fn actuator_names(&self) -> Vec<String> {
        let joint = |j: usize| self.model.joints.get(j).map_or("", |j| j.name.as_str());
        let name =
            |a: &'_ drex_robot::Actuator| if a.name.is_empty() { joint(a.joint).to_owned() } else { a.name.clone() };
        self.model.actuators.iter().map(name).collect()
    }

    /// Lowest and highest value of each joint, shape (dof, 2); infinite where there is no limit.
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        out2(py, self.model.joints.iter().map(|j| j.limits.map_or([f64::NEG_INFINITY, f64::INFINITY], |(a, b)| [a, b])))
    }

    /// Largest effort of each joint's drive, N m (N), shape (dof,); infinite where the file gives none.
    #[getter]
    fn effort_limits<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.model.joints.iter().map(|j| j.effort_limit.unwrap_or(f64::INFINITY)))
    }

    /// Every joint in the middle of its range, shape (dof,); joints without limits at their reference position.
    #[getter]
    fn mid_range<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.model.mid_range())
    }

    /// Every joint at its reference position (zero unless the file says otherwise), shape (dof,).
    #[getter]
    fn reference_position<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.model.reference_position())
    }

    /// Mass of all links, kg.
    #[getter]
    fn mass_kg(&self) -> f64 {
        self.model.total_mass_kg()
    }

    /// What the file has and is not used, one sentence each.
    #[getter]
    fn unsupported(&self) -> Vec<String> {
        self.model.unsupported.clone()
    }

    /// The fingers that were found in the model: dicts with name, is_thumb, joints, links, tip_link (names) and tip_point_m, the
    /// fingertip in the frame of its link.
    #[getter]
    fn fingers<'py>(&self, py: Python<'py>) -> Result<Vec<Bound<'py, PyDict>>> {
        let joint = |&j: &usize| self.model.joints.get(j).map_or("", |j| j.name.as_str());
        let link = |&l: &usize| self.model.links.get(l).map_or("", |l| l.name.as_str());
        let mut out = Vec::new();
        for finger in self.model.fingers() {
            let dict = PyDict::new(py);
            dict.set_item("name", &finger.name)?;
            dict.set_item("is_thumb", finger.is_thumb)?;
            dict.set_item("joints", finger.joints.iter().map(joint).collect::<Vec<_>>())?;
            dict.set_item("links", finger.links.iter().map(link).collect::<Vec<_>>())?;
            dict.set_item("tip_link", link(&finger.tip_link))?;
            dict.set_item("tip_point_m", out1(py, finger.tip_point.iter().copied()))?;
            out.push(dict);
        }
        Ok(out)
    }

    /// The joint vector of values by name, shape (dof,); joints that are not named stay at their reference position.
    fn joint_vector<'py>(&self, py: Python<'py>, named: &Bound<'py, PyDict>) -> Result<Bound<'py, PyArray1<f64>>> {
        let mut values = Vec::new();
        for (name, value) in named.iter() {
            values.push((name.extract::<String>()?, value.extract::<f64>()?));
        }
        Ok(out1(py, self.model.joint_vector(values)?))
    }

    /// `q` with every joint moved into its limits, shape (dof,).
    fn clamp<'py>(&self, py: Python<'py>, q: &Bound<'py, PyAny>) -> Result<Bound<'py, PyArray1<f64>>> {
        let mut q = self.joints("q", q)?;
        self.model.clamp_to_limits(&mut q);
        Ok(out1(py, q))
    }

    /// Poses of all links in the world, in the order of `link_names`: shape (links, 7) for one joint vector (dof,), and
    /// (T, links, 7) for several (T, dof).
    #[pyo3(signature = (q, *, base=None))]
    fn fk<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        base: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyAny>> {
        let base = base_of(base)?;
        let numbers = Numbers::of("q", q)?.finite()?;
        let (dof, links) = (self.model.dof(), self.model.links.len());
        match *numbers.shape() {
            [n] if n == dof => {
                let poses = self.model.forward_kinematics(&numbers.flat(), &base);
                Ok(out2(py, poses.iter().map(pose_row))?.into_any())
            }
            [rows, n] if n == dof => {
                let poses = if dof == 0 {
                    (0..rows).flat_map(|_| self.model.forward_kinematics::<f64>(&[], &base)).collect::<Vec<_>>()
                } else {
                    let q = numbers.flat();
                    q.chunks_exact(dof).flat_map(|q| self.model.forward_kinematics(q, &base)).collect()
                };
                Ok(pose_grid(py, &poses, links)?.into_any())
            }
            _ => numbers.wrong_shape(&format!("one joint vector, shape ({dof},), or one per row, shape (T, {dof})")),
        }
    }

    /// Jacobian of a point of `link`, shape (6, dof), in the world: the first three rows times the joint velocities are the velocity
    /// of the point, the last three the angular velocity of the link. `point_m` is in the frame of the link, its origin if left out.
    #[pyo3(signature = (q, link, *, point_m=None, base=None))]
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        link: &str,
        point_m: Option<&Bound<'py, PyAny>>,
        base: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyArray2<f64>>> {
        let q = self.joints("q", q)?;
        let link = self.model.require_link(link)?;
        let point = point_m.map_or(Ok(Vector3::zeros()), |p| vector("point_m", p))?;
        let poses = self.model.forward_kinematics(&q, &base_of(base)?);
        // There is one pose per link.
        let world = poses.get(link).map_or_else(Point3::origin, |pose| pose * Point3::from(point));
        let (linear, angular) = self.model.jacobian(&poses, link, &world);
        let row = |m: &nalgebra::Matrix3xX<f64>, i: usize| m.row(i).iter().copied().collect::<Vec<_>>();
        let data = (0..3).flat_map(|i| row(&linear, i)).chain((0..3).flat_map(|i| row(&angular, i)));
        let data: Vec<f64> = data.collect();
        if data.is_empty() {
            return refused(format!("robot \"{}\" has no joints and so no Jacobian", self.model.name));
        }
        table(py, data, self.model.dof())
    }

    /// Joint-space mass matrix, shape (dof, dof), the inertia of the drives included.
    fn mass_matrix<'py>(&self, py: Python<'py>, q: &Bound<'py, PyAny>) -> Result<Bound<'py, PyArray2<f64>>> {
        let m = self.model.mass_matrix(&self.joints("q", q)?);
        // Symmetric: columns are rows.
        table(py, m.iter().copied().collect(), self.model.dof())
    }

    /// Efforts that gravity, Coriolis and centrifugal forces take, shape (dof,): mass_matrix · acceleration + bias_force =
    /// effort. `gravity_m_s2` is in the frame of the base, (0, 0, -9.81) if left out.
    #[pyo3(signature = (q, qd, *, gravity_m_s2=None))]
    fn bias_force<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        qd: &Bound<'py, PyAny>,
        gravity_m_s2: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyArray1<f64>>> {
        let (q, qd) = (self.joints("q", q)?, self.joints("qd", qd)?);
        Ok(out1(py, self.model.bias_force(&q, &qd, &gravity_of(gravity_m_s2)?).iter().copied()))
    }

    /// Efforts that hold the robot at rest against gravity, shape (dof,).
    #[pyo3(signature = (q, *, gravity_m_s2=None))]
    fn gravity_torque<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        gravity_m_s2: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyArray1<f64>>> {
        let q = self.joints("q", q)?;
        Ok(out1(py, self.model.gravity_torque(&q, &gravity_of(gravity_m_s2)?).iter().copied()))
    }

    fn __repr__(&self) -> String {
        format!("Robot(\"{}\", {} joints, {} links)", self.model.name, self.model.dof(), self.model.links.len())
    }
}

/// A path as text: the libraries take names of bundled models and paths in one argument.
pub(crate) fn text_of(path: &Path) -> Result<&str> {
    path.to_str().ok_or_else(|| Failure::Refused(format!("{} is no name in Unicode; rename the file", path.display())))
}
