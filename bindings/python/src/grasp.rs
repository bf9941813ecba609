//! Grasps.

use drex_grasp::{GraspContact, GraspOrigin};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::{column, out1, out2, plain, pose, pose_row};
use crate::failure::{Result, refused};

/// A grasp of an object: where the hand is in the object's frame, and the angles of its joints.
///
/// `hand` is the name of the hand's model (`Robot.name`), `joints_rad` (J,) has the order of `joint_names`, and `object_from_base` is the
/// pose of the hand's base link in the frame of the object's mesh: a row x, y, z, qw, qx, qy, qz or a 4 x 4 matrix. What the hand
/// touches, and how hard, is known of grasps that drex has evaluated.
#[pyclass(module = "drex", frozen, eq, from_py_object)]
#[derive(Clone, PartialEq)]
pub(crate) struct Grasp {
    pub(crate) inner: drex_grasp::Grasp,
}

#[pymethods]
impl Grasp {
    #[new]
    fn new(
        hand: String,
        joint_names: Vec<String>,
        joints_rad: &Bound<'_, PyAny>,
        object_from_base: &Bound<'_, PyAny>,
    ) -> Result<Self> {
        let joints_rad = column("joints_rad", joints_rad)?;
        if joints_rad.len() != joint_names.len() {
            return refused(format!(
                "there are {} joint_names and {} joints_rad; give one angle per joint",
                joint_names.len(),
                joints_rad.len()
            ));
        }
        let object_from_base = pose("object_from_base", object_from_base)?;
        let (contacts, origin) = (Vec::new(), GraspOrigin::Retargeted);
        let inner = drex_grasp::Grasp {
            hand,
            joint_names,
            joints_rad,
            object_from_base,
            contacts,
            grip_force_n: None,
            origin,
            source: 0,
        };
        Ok(Self { inner })
    }

    /// Name of the hand's model.
    #[getter]
    fn hand(&self) -> &str {
        &self.inner.hand
    }

    /// Names of the joints of `joints_rad`.
    #[getter]
    fn joint_names(&self) -> Vec<String> {
        self.inner.joint_names.clone()
    }

    /// Joint angles, shape (J,), rad.
    #[getter]
    fn joints_rad<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.joints_rad.iter().copied())
    }

    /// Pose of the hand's base link in the object's frame, shape (7,): x, y, z, qw, qx, qy, qz.
    #[getter]
    fn object_from_base<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, pose_row(&self.inner.object_from_base))
    }

    /// Points where the hand touches the object, shape (C, 3), m, in the object's frame; empty as long as nobody has looked.
    #[getter]
    fn contact_points_m<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        self.contacts(py, |c| c.point_m)
    }

    /// Unit normals into the object at these points, shape (C, 3), in the object's frame.
    #[getter]
    fn contact_normals<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        self.contacts(py, |c| c.normal)
    }

    /// Names of the links that touch there.
    #[getter]
    fn contact_links(&self) -> Vec<String> {
        self.inner.contacts.iter().map(|c| c.link.clone()).collect()
    }

    /// Smallest sum of normal forces that carries the object at rest, N; None as long as nobody has looked.
    #[getter]
    fn grip_force_n(&self) -> Option<f64> {
        self.inner.grip_force_n
    }

    /// Where it comes from: "retargeted" (demonstrated, or given by you), "refined", "power", "pinch" or "predicted".
    #[getter]
    fn origin<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner.origin)
    }

    /// Everything.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner)
    }

    fn __repr__(&self) -> String {
        let touched = self.inner.contacts.len();
        format!("Grasp(\"{}\", {} joints, {touched} contacts)", self.inner.hand, self.inner.joints_rad.len())
    }
}

impl Grasp {
    fn contacts<'py>(
        &self,
        py: Python<'py>,
        of: impl Fn(&GraspContact) -> [f64; 3],
    ) -> Result<Bound<'py, PyArray2<f64>>> {
        out2(py, self.inner.contacts.iter().map(of))
    }
}

/// A grasp that a policy proposes.
#[pyclass(module = "drex", frozen, get_all)]
pub(crate) struct PredictedGrasp {
    /// The grasp, a `Grasp`.
    pub(crate) grasp: Py<Grasp>,
    /// Probability of each finger to touch, shape (F,), in the order of `Policy.fingers`.
    pub(crate) contacts: Py<PyArray1<f64>>,
    /// Grip force, sum of the normal forces, N.
    pub(crate) grip_force_n: f64,
    /// Probability of this grasp among those proposed.
    pub(crate) weight: f64,
}

#[pymethods]
impl PredictedGrasp {
    fn __repr__(&self) -> String {
        format!("PredictedGrasp({:.2} N, weight {:.3})", self.grip_force_n, self.weight)
    }
}
