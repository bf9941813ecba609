//! Forward kinematics and geometric Jacobians, generic over the scalar.

use drex_core::Real;
use nalgebra::{Isometry3, Matrix3xX, Point3, Translation3, Unit, UnitQuaternion, Vector3, convert};

use crate::model::{JointKind, Robot};

impl Robot {
    /// `world_from_link` of every link at joint vector `q`.
    ///
    /// A coordinate that `q` does not have counts as the joint's reference position; more than [`Robot::dof`] are
    /// ignored. Use [`Robot::joint_vector`] where the numbers come from a file.
    pub fn forward_kinematics<T: Real>(&self, q: &[T], world_from_base: &Isometry3<T>) -> Vec<Isometry3<T>> {
        let mut poses: Vec<Isometry3<T>> = Vec::with_capacity(self.links.len());
        for link in &self.links {
            let mut pose = match link.parent {
                None => *world_from_base,
                Some(parent) => poses[parent] * lift_pose::<T>(&link.parent_from_link),
            };
            for &j in &link.joints {
                if let Some(&value) = q.get(j) {
                    pose *= self.joint_motion(j, value);
                }
            }
            poses.push(pose);
        }
        poses
    }

    /// The motion of joint `j` at coordinate `value`, in the frame of its link.
    fn joint_motion<T: Real>(&self, j: usize, value: T) -> Isometry3<T> {
        let joint = &self.joints[j];
        let travel = value - convert::<f64, T>(joint.reference);
        let axis: Vector3<T> = joint.axis.map(convert);
        match joint.kind {
            JointKind::Prismatic => {
                Isometry3::from_parts(Translation3::from(axis * travel), UnitQuaternion::identity())
            }
            JointKind::Revolute => {
                let rotation = UnitQuaternion::from_axis_angle(&Unit::new_unchecked(axis), travel);
                let anchor: Vector3<T> = joint.anchor.coords.map(convert);
                Isometry3::from_parts(Translation3::from(anchor - rotation * anchor), rotation)
            }
        }
    }

    /// Axis and a point on it, in the world, of joint `j` at the poses that [`Robot::forward_kinematics`] gave.
    ///
    /// # Panics
    /// As indexing does, if `j` is not a joint of this robot or `link_poses` has fewer poses than it has links.
    pub fn joint_axis<T: Real>(&self, link_poses: &[Isometry3<T>], j: usize) -> (Vector3<T>, Point3<T>) {
        let joint = &self.joints[j];
        let pose = &link_poses[joint.link];
        (
            pose.rotation * joint.axis.map(convert::<f64, T>),
            pose * Point3::from(joint.anchor.coords.map(convert::<f64, T>)),
        )
    }

    /// Jacobian of the point of `link` that is at `point_world`, both parts 3 × [`Robot::dof`] in the world frame:
    /// velocity of the point = linear · q̇, angular velocity of the link = angular · q̇ (base at rest).
    ///
    /// `link_poses` are those of [`Robot::forward_kinematics`].
    ///
    /// # Panics
    /// As indexing does, if `link` is not a link of this robot or `link_poses` has fewer poses than it has links.
    pub fn jacobian<T: Real>(
        &self,
        link_poses: &[Isometry3<T>],
        link: usize,
        point_world: &Point3<T>,
    ) -> (Matrix3xX<T>, Matrix3xX<T>) {
        let mut linear = Matrix3xX::zeros(self.dof());
        let mut angular = Matrix3xX::zeros(self.dof());
        let mut at = Some(link);
        while let Some(l) = at {
            for &j in &self.links[l].joints {
                let (axis, anchor) = self.joint_axis(link_poses, j);
                match self.joints[j].kind {
                    JointKind::Prismatic => linear.set_column(j, &axis),
                    JointKind::Revolute => {
                        linear.set_column(j, &axis.cross(&(point_world - anchor)));
                        angular.set_column(j, &axis);
                    }
                }
            }
            at = self.links[l].parent;
        }
        (linear, angular)
    }
}

/// A constant pose as a pose of the scalar `T`.
pub(crate) fn lift_pose<T: Real>(pose: &Isometry3<f64>) -> Isometry3<T> {
    let q = pose.rotation.quaternion().coords.map(convert::<f64, T>);
    Isometry3::from_parts(
        Translation3::from(pose.translation.vector.map(convert::<f64, T>)),
        UnitQuaternion::new_unchecked(q.into()),
    )
}
