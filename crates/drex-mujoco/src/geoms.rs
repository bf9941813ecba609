//! Shapes as geoms.

use drex_core::Pose;
use drex_diffsim::{Collider, ConvexPolyhedron, Geom, Material, Part, Scalar, Shape};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::text::{Attribute, Text, list, placed, vector};
use crate::{Error, Result};

/// Which geoms touch which: two do if a bit of one's `contype` is in the other's `conaffinity`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Masks {
    contype: u32,
    conaffinity: u32,
}

impl Masks {
    /// Static and kinematic bodies touch bodies and links, not each other.
    pub const SURROUNDINGS: Self = Self { contype: 1, conaffinity: 0 };
    /// Bodies touch everything.
    pub const BODY: Self = Self { contype: 2, conaffinity: 3 };
    /// How many articulations there are bits for.
    pub const ARTICULATIONS: usize = 28;

    /// Links touch everything but, unless they should, their own robot.
    pub fn articulation(index: usize, self_collision: bool) -> Self {
        let own = 4 << index;
        Self { contype: own, conaffinity: if self_collision { i32::MAX as u32 } else { i32::MAX as u32 & !own } }
    }
}

/// Writer of geoms, and what it wrote.
#[derive(Debug, Default)]
pub(crate) struct Geoms {
    /// Meshes of the convex polyhedra.
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
            attributes.extend(self.shape(geom, &name, offset)?);
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

    fn shape(&mut self, geom: &Geom, name: &str, offset: &Vector3<f64>) -> Result<Vec<Attribute>> {
        let (pose, of) = (&geom.body_from_shape, |kind: &str| ("type", kind.to_owned()));
        let (origin, z) = (pose.translation.vector, pose.rotation * Vector3::z());
        let along = |half_length: f64| {
            let (a, b) = (origin - z * half_length + offset, origin + z * half_length + offset);
            ("fromto", list(&[a.x, a.y, a.z, b.x, b.y, b.z]))
        };
        let cuboid = |body_from_box: &Pose, half: &Vector3<f64>| {
            let placed = placed(&(Translation3::from(*offset) * body_from_box));
            [of("box"), ("size", vector(half))].into_iter().chain(placed).collect()
        };
        Ok(match &geom.shape {
            Shape::Plane => {
                let pos = vector(&(z * z.dot(&origin) + offset));
                vec![of("plane"), ("size", "0 0 1".into()), ("pos", pos), ("zaxis", vector(&z))]
            }
            Shape::Sphere { radius_m } => {
                vec![of("sphere"), ("size", list(&[*radius_m])), ("pos", vector(&(origin + offset)))]
            }
            Shape::Capsule { radius_m, half_length_m } => {
                vec![of("capsule"), ("size", list(&[*radius_m])), along(*half_length_m)]
            }
            Shape::Cylinder { radius_m, half_length_m } => {
                vec![of("cylinder"), ("size", list(&[*radius_m])), along(*half_length_m)]
            }
            Shape::Box { half_m } => cuboid(pose, half_m),
            Shape::Convex(piece) => match as_box(piece) {
                Some((shape_from_box, half)) => cuboid(&(pose * shape_from_box), &half),
                None => {
                    let vertices: Vec<f64> =
                        piece.vertices().iter().map(|v| pose * v).flat_map(|v| [v.x, v.y, v.z]).collect();
                    let mesh = [("name", name.to_owned()), ("vertex", list(&vertices)), ("inertia", "convex".into())];
                    self.assets.leaf("mesh", &mesh);
                    vec![of("mesh"), ("mesh", name.to_owned()), ("pos", vector(offset))]
                }
            },
            _ => {
                return Err(Error::Unsupported {
                    what: format!("{name}: MuJoCo has no counterpart of a signed distance or of surface points"),
                    remedy: "give convex polyhedra or primitive shapes".into(),
                });
            }
        })
    }
}

/// Frame and half extents of a polyhedron that is a box. MuJoCo is better at boxes than at hulls with eight corners.
fn as_box(piece: &ConvexPolyhedron) -> Option<(Pose, Vector3<f64>)> {
    const EPS: f64 = 1e-6;
    let normals = || piece.planes().iter().map(|p| p.0);
    if piece.vertices().len() != 8 || piece.planes().len() != 6 {
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
    let local = |v: &Point3<f64>| turn.inverse_transform_vector(&v.coords);
    let first = local(&piece.vertices()[0]);
    let (lo, hi) = piece.vertices().iter().map(local).fold((first, first), |(lo, hi), v| (lo.inf(&v), hi.sup(&v)));
    Some((Pose::from_parts(Translation3::from(turn * ((lo + hi) * 0.5)), turn), (hi - lo) * 0.5))
}
