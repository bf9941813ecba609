//! Sections of an MJCF text that are written side by side.

use drex_core::Pose;
use drex_diffsim::Scalar;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::geoms::Geoms;
use crate::text::{Attribute, Text, list, placed, vector};

/// Square of the radius of gyration of a prescribed thing, m².
pub(crate) const PRESCRIBED_GYRATION_M2: f64 = 0.01;

/// Coordinates in MuJoCo's order: that of the text.
#[derive(Debug, Default)]
pub(crate) struct Start {
    pub qpos: Vec<f64>,
    pub qvel: Vec<f64>,
    pub ctrl: Vec<f64>,
}

/// What is written at the same time into different sections.
#[derive(Debug, Default)]
pub(crate) struct Sections {
    pub world: Text,
    pub contact: Text,
    pub actuator: Text,
    pub geoms: Geoms,
    pub start: Start,
    pub prescribed_kg: f64,
}

impl Sections {
    /// A free joint called `name`; what it moves is at `pose` and moves as said, in the world.
    pub fn free_joint(&mut self, name: &str, pose: &Pose, velocity: &Vector3<f64>, angular_velocity: &Vector3<f64>) {
        self.world.leaf("freejoint", &[("name", name.to_owned())]);
        let (x, q) = (&pose.translation.vector, &pose.rotation);
        self.start.qpos.extend([x.x, x.y, x.z, q.w, q.i, q.j, q.k]);
        // MuJoCo keeps angular velocities in the body's axes.
        let local = q.inverse_transform_vector(angular_velocity);
        self.start.qvel.extend(velocity.iter().chain(local.iter()));
    }

    /// The inertia of something that forces must not move.
    pub fn prescribed_inertia(&mut self) {
        let j = Matrix3::identity() * (self.prescribed_kg * PRESCRIBED_GYRATION_M2);
        self.inertial(self.prescribed_kg, &Vector3::zeros(), &j);
    }

    /// Mass, centre of mass and inertia about it.
    pub fn inertial(&mut self, mass_kg: f64, center: &Vector3<f64>, j: &Matrix3<f64>) {
        let full = [j[(0, 0)], j[(1, 1)], j[(2, 2)], j[(0, 1)], j[(0, 2)], j[(1, 2)]];
        let attributes = [("pos", vector(center)), ("mass", list(&[mass_kg])), ("fullinertia", list(&full))];
        self.world.leaf("inertial", &attributes);
    }
}

/// Name, position and orientation of a body.
pub(crate) fn named(name: &str, pose: &Pose) -> Vec<Attribute> {
    [("name", name.to_owned())].into_iter().chain(placed(pose)).collect()
}

/// A pose without derivatives.
pub(crate) fn value_of<T: Scalar>(pose: &Pose<T>) -> Pose {
    let q = pose.rotation.coords.map(|x| x.value());
    Pose::from_parts(pose.translation.vector.map(|x| x.value()).into(), UnitQuaternion::new_unchecked(q.into()))
}
