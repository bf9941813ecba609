//! What acts on the bodies: gravity, fixed and moving surroundings, applied forces, controls of actuators.

mod control;
mod force;

use std::sync::Arc;

use drex_core::Pose;
use nalgebra::{Point3, Translation3, Vector3};

pub use control::Control;
pub use force::{AppliedForce, ForcePoint};

use crate::collider::Collider;
use crate::material::{Material, check_friction};
use crate::path::Path;
use crate::{Error, Geom, Result, Scalar, Shape};

/// The surroundings of the bodies.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Scene<T: Scalar> {
    /// Gravity in the world, m/s².
    pub gravity: Vector3<T>,
    /// What does not move: the table, boxes, anything solid.
    pub static_bodies: Vec<StaticBody<T>>,
    /// What moves along a prescribed path, whatever it meets.
    pub kinematic_bodies: Vec<KinematicBody<T>>,
    /// Forces and torques over time.
    pub forces: Vec<AppliedForce<T>>,
    /// Controls of the actuators, one per articulation that has any.
    pub controls: Vec<Control>,
}

/// Something solid that does not move.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct StaticBody<T> {
    /// Pose of its frame in the world.
    pub world_from_body: Pose,
    /// Shapes in its frame.
    pub collider: Arc<Collider>,
    /// Its surface.
    pub material: Material<T>,
}

impl<T: Scalar> StaticBody<T> {
    /// Shapes at a pose.
    pub fn new(world_from_body: Pose, collider: Arc<Collider>, friction: T) -> Self {
        Self { world_from_body, collider, material: Material::new(friction) }
    }

    /// The plane z = `height_m`; everything below it is solid.
    pub fn table(height_m: f64, friction: T) -> Self {
        Self::new(Pose::translation(0.0, 0.0, height_m), Arc::new(Collider::plane()), friction)
    }

    /// A box along the world's axes: centre and half extents, metres.
    ///
    /// # Errors
    /// If a half extent is not a positive number.
    pub fn cuboid(center: Point3<f64>, half_m: Vector3<f64>, friction: T) -> Result<Self> {
        let collider = Collider::new(&[Geom::new(Shape::Box { half_m })])?;
        Ok(Self::new(Pose::translation(center.x, center.y, center.z), Arc::new(collider), friction))
    }
}

/// Something solid on a prescribed path.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct KinematicBody<T> {
    /// Where it is, when.
    pub path: Path,
    /// Shapes in its frame.
    pub collider: Arc<Collider>,
    /// Its surface.
    pub material: Material<T>,
}

impl<T: Scalar> KinematicBody<T> {
    /// Shapes along a path.
    pub fn new(path: Path, collider: Arc<Collider>, friction: T) -> Self {
        Self { path, collider, material: Material::new(friction) }
    }

    /// A sphere whose centre passes `centers` at `times_s`, linearly in between, at rest before and after.
    ///
    /// # Errors
    /// If the numbers of samples differ, times do not increase or a number is not finite.
    pub fn sphere(radius_m: f64, friction: T, times_s: &[f64], centers: &[Point3<f64>]) -> Result<Self> {
        let poses: Vec<Pose> = centers.iter().map(|c| Translation3::from(c.coords).into()).collect();
        let collider = Collider::new(&[Geom::new(Shape::Sphere { radius_m })])?;
        Ok(Self::new(Path::linear(times_s, &poses)?, Arc::new(collider), friction))
    }
}

impl<T: Scalar> Scene<T> {
    /// Nothing but gravity of 9.81 m/s².
    pub fn empty() -> Self {
        Self {
            gravity: Vector3::new(T::zero(), T::zero(), T::lift(-9.81)),
            static_bodies: Vec::new(),
            kinematic_bodies: Vec::new(),
            forces: Vec::new(),
            controls: Vec::new(),
        }
    }

    /// A table at height zero under gravity of 9.81 m/s².
    pub fn on_table(friction: T) -> Self {
        Self { static_bodies: vec![StaticBody::table(0.0, friction)], ..Self::empty() }
    }

    /// Checks gravity, poses and surfaces.
    pub(crate) fn check(&self) -> Result<()> {
        if self.gravity.iter().any(|x| !x.value().is_finite()) {
            return Err(Error::NotFinite { what: "gravity".into() });
        }
        for (i, f) in self.static_bodies.iter().enumerate() {
            let pose = &f.world_from_body;
            if pose.translation.vector.iter().chain(pose.rotation.coords.iter()).any(|x| !x.is_finite()) {
                return Err(Error::NotFinite { what: format!("the pose of static body {i}") });
            }
            check_friction(&f.material, || format!("static body {i}"))?;
        }
        self.kinematic_bodies
            .iter()
            .enumerate()
            .try_for_each(|(i, m)| check_friction(&m.material, || format!("kinematic body {i}")))
    }
}
