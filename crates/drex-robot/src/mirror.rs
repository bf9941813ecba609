//! The mirror image of a robot: a left hand from a right one.

use std::sync::Arc;

use drex_core::{MassProperties, Pose, TriMesh};
use nalgebra::{Isometry3, Matrix3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::model::{Geom, Joint, JointKind, Link, Robot, Shape};

/// A coordinate plane of the base, named by its normal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MirrorPlane {
    /// x = 0.
    X,
    /// y = 0.
    Y,
    /// z = 0.
    Z,
}

impl Robot {
    /// The mirror image through the plane y = 0 of the base; y is the side of thumb and fingers in both bundled hands.
    /// See [`Robot::mirrored_through`].
    pub fn mirrored(&self) -> Self {
        self.mirrored_through(MirrorPlane::Y)
    }

    /// The mirror image through a plane of the base, such that the same joint values give the mirrored pose.
    ///
    /// With M the reflection (diagonal, one entry −1), every frame of the image is the mirrored frame with the same
    /// axis turned around: poses become M T M, points M p, inertia M I M, axes of sliding joints M a and axes of
    /// turning joints −M a, because a turn is a pseudo-vector. Primitives keep their shape; meshes are mirrored and
    /// their faces turned around. Joint and link names, limits, couplings and actuators stay; in the model's name
    /// `right` and `left` change places (without either, `_mirrored` is added or taken away). Mirrored twice, the
    /// robot is the one it was, exactly.
    pub fn mirrored_through(&self, plane: MirrorPlane) -> Self {
        Self {
            name: mirrored_name(&self.name),
            links: self.links.iter().map(|l| plane.link(l)).collect(),
            joints: self.joints.iter().map(|j| plane.joint(j)).collect(),
            ..self.clone()
        }
    }
}

impl MirrorPlane {
    /// The diagonal of the reflection M.
    fn signs(self) -> Vector3<f64> {
        let mut signs = Vector3::repeat(1.0);
        signs[self as usize] = -1.0;
        signs
    }

    /// M p.
    pub fn point(self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.vector(&p.coords))
    }

    /// M v, for directions and velocities.
    pub fn vector(self, v: &Vector3<f64>) -> Vector3<f64> {
        v.component_mul(&self.signs())
    }

    /// −M v, for axes of turns and angular velocities.
    pub fn pseudo_vector(self, v: &Vector3<f64>) -> Vector3<f64> {
        -self.vector(v)
    }

    /// M T M: the pose of a mirrored frame, its own axis turned around, in a mirrored frame.
    pub fn pose(self, pose: &Pose) -> Pose {
        let q = pose.rotation.quaternion();
        let turned = Quaternion::from_parts(q.w, self.pseudo_vector(&q.imag()));
        Isometry3::from_parts(
            Translation3::from(self.vector(&pose.translation.vector)),
            UnitQuaternion::new_unchecked(turned),
        )
    }

    fn link(self, link: &Link) -> Link {
        Link {
            parent_from_link: self.pose(&link.parent_from_link),
            inertial: link.inertial.as_ref().map(|body| self.mass(body)),
            geoms: link.geoms.iter().map(|g| self.geom(g)).collect(),
            ..link.clone()
        }
    }

    fn joint(self, joint: &Joint) -> Joint {
        let axis = match joint.kind {
            JointKind::Revolute => self.pseudo_vector(&joint.axis),
            JointKind::Prismatic => self.vector(&joint.axis),
        };
        Joint { axis, anchor: self.point(&joint.anchor), ..joint.clone() }
    }

    fn mass(self, body: &MassProperties) -> MassProperties {
        let m = Matrix3::from_diagonal(&self.signs());
        MassProperties {
            mass_kg: body.mass_kg,
            center_of_mass: self.point(&body.center_of_mass),
            inertia: m * body.inertia * m,
        }
    }

    fn geom(self, geom: &Geom) -> Geom {
        let mut link_from_geom = self.pose(&geom.link_from_geom);
        let shape = match &geom.shape {
            Shape::Mesh(mesh) => Shape::Mesh(Arc::new(self.mesh(mesh))),
            Shape::Plane => {
                // The outside of a plane is at z > 0 of its frame: half a turn brings it back there.
                if self == Self::Z {
                    link_from_geom.rotation *= UnitQuaternion::new_unchecked(Quaternion::new(0.0, 1.0, 0.0, 0.0));
                }
                Shape::Plane
            }
            symmetric => symmetric.clone(),
        };
        Geom { link_from_geom, shape, ..geom.clone() }
    }

    fn mesh(self, mesh: &TriMesh) -> TriMesh {
        TriMesh {
            vertices: mesh.vertices.iter().map(|v| self.point(v)).collect(),
            faces: mesh.faces.iter().map(|&[a, b, c]| [a, c, b]).collect(),
        }
    }
}

fn mirrored_name(name: &str) -> String {
    for (one, other) in [("right", "left"), ("Right", "Left"), ("RIGHT", "LEFT")] {
        for (from, to) in [(one, other), (other, one)] {
            if name.contains(from) {
                return name.replace(from, to);
            }
        }
    }
    match name.strip_suffix("_mirrored") {
        Some(original) => original.to_owned(),
        None => format!("{name}_mirrored"),
    }
}
