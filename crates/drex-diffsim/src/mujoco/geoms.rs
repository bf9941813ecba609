//! Shapes as geoms.

use drex_core::Pose;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::text::{Attribute, Text, list, placed, vector};
use crate::collide::{Kind, Poly};
use crate::collider::Collider;
use crate::model::Material;
use crate::{Part, Result, Scalar, SimError};

/// Which geoms touch which: two do if a bit of one's `contype` is in the other's `conaffinity`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Masks {
    contype: u32,
    conaffinity: u32,
}

impl Masks {
    /// Fixed things and movers touch bodies and links, not each other.
    pub const SURROUNDINGS: Self = Self { contype: 1, conaffinity: 0 };
    /// Bodies touch everything.
    pub const BODY: Self = Self { contype: 2, conaffinity: 3 };
    /// How many articulations there are bits for.
    pub const ARMS: usize = 28;

    /// Links touch everything but, unless they should, their own robot.
    pub fn arm(index: usize, self_collision: bool) -> Self {
        let own = 4 << index;
        Self { contype: own, conaffinity: if self_collision { i32::MAX as u32 } else { i32::MAX as u32 & !own } }
    }
}

/// Writer of geoms, and what it wrote.
#[derive(Debug, Default)]
pub(super) struct Geoms {
    /// Meshes of the convex pieces.
    pub assets: Text,
    /// Name, part and index in its collider.
    pub owners: Vec<(String, Part, u16)>,
    /// The largest coefficient of friction in the scene.
    pub friction: f64,
}

impl Geoms {
    /// The shapes of a part called `prefix`, moved by `offset` in the frame of the part.
    pub fn write<T: Scalar>(
        &mut self,
        text: &mut Text,
        (part, prefix): (Part, &str),
        collider: &Collider,
        offset: &Vector3<f64>,
        material: &Material<T>,
        masks: Masks,
    ) -> Result<()> {
        for (k, geom) in collider.geoms().iter().enumerate() {
            let name = format!("{prefix}/{k}");
            let mut attributes = vec![("name", name.clone())];
            attributes.extend(self.shape(&geom.kind, &name, offset)?);
            // Between two geoms the larger coefficients count, as in ours; that of turning is a length in both.
            let sliding = material.friction.value();
            let turning = material.torsion_radius_m * if sliding > 0.0 { sliding } else { self.friction };
            attributes.push(("friction", list(&[sliding, turning, 0.0])));
            attributes.push(("contype", masks.contype.to_string()));
            attributes.push(("conaffinity", masks.conaffinity.to_string()));
            text.leaf("geom", &attributes);
            self.owners.push((name, part, k as u16));
        }
        Ok(())
    }

    fn shape(&mut self, kind: &Kind, name: &str, offset: &Vector3<f64>) -> Result<Vec<Attribute>> {
        let along = |a: Vector3<f64>, b: Vector3<f64>| {
            let (a, b) = (a + offset, b + offset);
            ("fromto", list(&[a.x, a.y, a.z, b.x, b.y, b.z]))
        };
        let of = |kind: &str| ("type", kind.to_owned());
        Ok(match kind {
            Kind::Plane((normal, distance)) => {
                let pos = vector(&(normal * *distance + offset));
                vec![of("plane"), ("size", "0 0 1".into()), ("pos", pos), ("zaxis", vector(normal))]
            }
            Kind::Sphere { center, radius } => {
                vec![of("sphere"), ("size", list(&[*radius])), ("pos", vector(&(center + offset)))]
            }
            Kind::Capsule { ends: [a, b], radius } => vec![of("capsule"), ("size", list(&[*radius])), along(*a, *b)],
            Kind::Cylinder(c) => {
                let half = c.axis * c.half_length;
                vec![of("cylinder"), ("size", list(&[c.radius])), along(c.center - half, c.center + half)]
            }
            Kind::Poly(poly) => match as_box(poly) {
                Some((pose, half)) => {
                    let pose = Translation3::from(*offset) * pose;
                    [of("box"), ("size", vector(&half))].into_iter().chain(placed(&pose)).collect()
                }
                None => {
                    let vertices: Vec<f64> = poly.vertices.iter().flat_map(|v| [v.x, v.y, v.z]).collect();
                    let mesh = [("name", name.to_owned()), ("vertex", list(&vertices)), ("inertia", "convex".into())];
                    self.assets.leaf("mesh", &mesh);
                    vec![of("mesh"), ("mesh", name.to_owned()), ("pos", vector(offset))]
                }
            },
            Kind::Sdf { .. } | Kind::Points { .. } => {
                return Err(SimError::Engine {
                    what: format!("{name}: MuJoCo has no counterpart of a signed distance or of surface points"),
                    remedy: "give convex pieces or primitive shapes".into(),
                });
            }
        })
    }
}

/// Frame and half extents of a polyhedron that is a box. MuJoCo is better at boxes than at hulls with eight corners.
fn as_box(poly: &Poly) -> Option<(Pose, Vector3<f64>)> {
    const EPS: f64 = 1e-6;
    let normals = || poly.planes.iter().map(|p| p.0);
    if poly.vertices.len() != 8 || poly.planes.len() != 6 {
        return None;
    }
    // For each axis of the body the normal nearest to it, so that an aligned box is not turned.
    let mut axes = [Vector3::zeros(); 3];
    for k in 0..3 {
        let free = normals().filter(|n| axes[..k].iter().all(|a: &Vector3<f64>| a.dot(n).abs() < EPS));
        axes[k] = free.max_by(|a, b| a[k].total_cmp(&b[k]))?;
    }
    if normals().any(|n| !axes.iter().any(|a| (a.dot(&n).abs() - 1.0).abs() < EPS)) {
        return None;
    }
    if axes[0].cross(&axes[1]).dot(&axes[2]) < 0.0 {
        axes[2] = -axes[2];
    }
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(&axes)));
    let local = |v: &Vector3<f64>| turn.inverse_transform_vector(v);
    let first = local(&poly.vertices[0]);
    let (lo, hi) = poly.vertices.iter().map(local).fold((first, first), |(lo, hi), v| (lo.inf(&v), hi.sup(&v)));
    Some((Pose::from_parts(Translation3::from(turn * ((lo + hi) * 0.5)), turn), (hi - lo) * 0.5))
}
