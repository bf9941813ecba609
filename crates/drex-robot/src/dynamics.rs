//! Joint-space mass matrix and bias force, generic over the scalar.
//!
//! Spatial vectors (angular on top, linear below) are written in world axes about the origin of the base, so that
//! adding up a subtree is plain addition. Composite rigid bodies and recursive Newton-Euler as in Featherstone,
//! *Rigid Body Dynamics Algorithms* (2008), tables 6.2 and 5.1.

use drex_core::Real;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Point3, Vector3, convert};

use crate::model::{JointKind, Robot};

impl Robot {
    /// Joint-space mass matrix at `q`, dof × dof, drive inertia (armature) included; kg m² between revolute joints.
    pub fn mass_matrix<T: Real>(&self, q: &[T]) -> DMatrix<T> {
        let poses = self.forward_kinematics(q, &Isometry3::identity());
        let mut composite = self.link_inertias(&poses);
        for i in (1..self.links.len()).rev() {
            if let Some(parent) = self.links[i].parent {
                let child = composite[i];
                composite[parent] = composite[parent] + child;
            }
        }
        let axes = self.motion_axes(&poses);
        let mut m = DMatrix::zeros(self.dof(), self.dof());
        for (j, joint) in self.joints.iter().enumerate() {
            let force = composite[joint.link] * axes[j];
            m[(j, j)] = axes[j].dot(&force) + convert(joint.armature);
            let mut at = self.links[joint.link].parent;
            while let Some(l) = at {
                for &i in &self.links[l].joints {
                    m[(i, j)] = axes[i].dot(&force);
                    m[(j, i)] = m[(i, j)];
                }
                at = self.links[l].parent;
            }
        }
        m
    }

    /// Joint efforts that hold the robot against gravity, Coriolis and centrifugal forces: mass_matrix · q̈ +
    /// bias_force = effort. `gravity` is the acceleration of free fall in the frame of the base, m/s². Damping and
    /// dry friction are not part of it.
    pub fn bias_force<T: Real>(&self, q: &[T], qd: &[T], gravity: &Vector3<T>) -> DVector<T> {
        let poses = self.forward_kinematics(q, &Isometry3::identity());
        let axes = self.motion_axes(&poses);
        let inertias = self.link_inertias(&poses);
        let n = self.links.len();
        let mut velocity = vec![Spatial::zero(); n];
        let mut acceleration = vec![Spatial::zero(); n];
        let mut force = vec![Spatial::zero(); n];
        for (i, link) in self.links.iter().enumerate() {
            // Gravity enters as an upward acceleration of the base.
            let (mut v, mut a) =
                link.parent.map_or((Spatial::zero(), Spatial { angular: Vector3::zeros(), linear: -*gravity }), |p| {
                    (velocity[p], acceleration[p])
                });
            for &j in &link.joints {
                let rate = axes[j].scaled(qd.get(j).copied().unwrap_or_else(T::zero));
                a = a + v.cross_motion(&rate);
                v = v + rate;
            }
            force[i] = inertias[i] * a + v.cross_force(&(inertias[i] * v));
            velocity[i] = v;
            acceleration[i] = a;
        }
        let mut tau = DVector::zeros(self.dof());
        for i in (0..n).rev() {
            for &j in &self.links[i].joints {
                tau[j] = axes[j].dot(&force[i]);
            }
            if let Some(p) = self.links[i].parent {
                let child = force[i];
                force[p] = force[p] + child;
            }
        }
        tau
    }

    /// Joint efforts that hold the robot at rest against gravity: [`Robot::bias_force`] at zero velocity.
    pub fn gravity_torque<T: Real>(&self, q: &[T], gravity: &Vector3<T>) -> DVector<T> {
        self.bias_force(q, &[], gravity)
    }

    fn motion_axes<T: Real>(&self, poses: &[Isometry3<T>]) -> Vec<Spatial<T>> {
        (0..self.dof())
            .map(|j| {
                let (axis, anchor) = self.joint_axis(poses, j);
                match self.joints[j].kind {
                    JointKind::Revolute => Spatial { angular: axis, linear: anchor.coords.cross(&axis) },
                    JointKind::Prismatic => Spatial { angular: Vector3::zeros(), linear: axis },
                }
            })
            .collect()
    }

    fn link_inertias<T: Real>(&self, poses: &[Isometry3<T>]) -> Vec<SpatialInertia<T>> {
        self.links
            .iter()
            .zip(poses)
            .map(|(link, pose)| {
                let Some(body) = &link.inertial else { return SpatialInertia::zero() };
                let mass: T = convert(body.mass_kg);
                let c = (pose * Point3::from(body.center_of_mass.coords.map(convert::<f64, T>))).coords;
                let r = pose.rotation.to_rotation_matrix();
                let about_com = r.matrix() * body.inertia.map(convert::<f64, T>) * r.matrix().transpose();
                let shift = (Matrix3::identity() * c.norm_squared() - c * c.transpose()) * mass;
                SpatialInertia { mass, first: c * mass, second: about_com + shift }
            })
            .collect()
    }
}

/// A motion or a force about the common origin.
#[derive(Clone, Copy)]
struct Spatial<T: Real> {
    angular: Vector3<T>,
    linear: Vector3<T>,
}

impl<T: Real> Spatial<T> {
    fn zero() -> Self {
        Self { angular: Vector3::zeros(), linear: Vector3::zeros() }
    }

    fn scaled(&self, s: T) -> Self {
        Self { angular: self.angular * s, linear: self.linear * s }
    }

    fn dot(&self, force: &Self) -> T {
        self.angular.dot(&force.angular) + self.linear.dot(&force.linear)
    }

    /// v × m, the rate of change of the motion m that moves with velocity v.
    fn cross_motion(&self, m: &Self) -> Self {
        Self {
            angular: self.angular.cross(&m.angular),
            linear: self.angular.cross(&m.linear) + self.linear.cross(&m.angular),
        }
    }

    /// v ×* f, the rate of change of the momentum f that moves with velocity v.
    fn cross_force(&self, f: &Self) -> Self {
        Self {
            angular: self.angular.cross(&f.angular) + self.linear.cross(&f.linear),
            linear: self.angular.cross(&f.linear),
        }
    }
}

impl<T: Real> std::ops::Add for Spatial<T> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { angular: self.angular + other.angular, linear: self.linear + other.linear }
    }
}

/// Mass, mass times centre of mass, and second moment about the common origin.
#[derive(Clone, Copy)]
struct SpatialInertia<T: Real> {
    mass: T,
    first: Vector3<T>,
    second: Matrix3<T>,
}

impl<T: Real> SpatialInertia<T> {
    fn zero() -> Self {
        Self { mass: T::zero(), first: Vector3::zeros(), second: Matrix3::zeros() }
    }
}

impl<T: Real> std::ops::Add for SpatialInertia<T> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { mass: self.mass + other.mass, first: self.first + other.first, second: self.second + other.second }
    }
}

impl<T: Real> std::ops::Mul<Spatial<T>> for SpatialInertia<T> {
    type Output = Spatial<T>;
    fn mul(self, v: Spatial<T>) -> Spatial<T> {
        Spatial {
            angular: self.second * v.angular + self.first.cross(&v.linear),
            linear: v.linear * self.mass - self.first.cross(&v.angular),
        }
    }
}
