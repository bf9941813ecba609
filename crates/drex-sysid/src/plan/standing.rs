//! The object as it stands: where a ray meets it, how far its base reaches, where its ends are.

use drex_core::{Object, Pose};
use drex_diffsim::ConvexPolyhedron;
use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::{Result, SysidError};

/// Vertices this much above the lowest belong to the base, metres.
const BASE_M: f64 = 5e-4;
/// Gap between object and support at the start, metres: the simulator lets it settle.
const GAP_M: f64 = 5e-5;

/// The convex pieces turned so that the object stands, the centre of mass above the origin and the base at z = 0.
#[derive(Debug, Clone)]
pub(super) struct Standing {
    /// This frame from the mesh frame.
    pub from_mesh: Pose,
    /// Centre of mass.
    pub center: Point3<f64>,
    vertices: Vec<Point3<f64>>,
    /// Outward normal and offset of the faces, per piece.
    planes: Vec<Vec<(Vector3<f64>, f64)>>,
}

impl Standing {
    pub(super) fn new(object: &Object, up_in_mesh: &Vector3<f64>) -> Result<Self> {
        let turn = UnitQuaternion::rotation_between(up_in_mesh, &Vector3::z())
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let center = turn * object.mass_properties.center_of_mass;
        let low = object.bounds_at(&Pose::from_parts(Vector3::zeros().into(), turn)).map_or(0.0, |(lo, _)| lo.z);
        let from_mesh = Pose::from_parts(Vector3::new(-center.x, -center.y, -low).into(), turn);
        let moved = |(n, d): &(Vector3<f64>, f64)| {
            let normal = turn * n;
            (normal, d + normal.dot(&from_mesh.translation.vector))
        };
        // A part without volume was refused when the collider was made.
        let pieces = object.convex_parts.iter().filter_map(|p| ConvexPolyhedron::from_points(p.corners()).ok());
        let planes = pieces.map(|p| p.planes().iter().map(moved).collect()).collect();
        let vertices = object.corners().map(|v| from_mesh * v).collect();
        let out = Self { from_mesh, center: from_mesh * object.mass_properties.center_of_mass, vertices, planes };
        let directions = (0..16).map(|k| {
            let (y, x) = (std::f64::consts::TAU * f64::from(k) / 16.0).sin_cos();
            Vector3::new(x, y, 0.0)
        });
        if directions.map(|d| out.base_reach(&d)).any(|c| c <= 0.0) {
            return Err(SysidError::Object {
                what: "does not stand: its centre of mass is not above its base".into(),
                remedy: "state which way is up while it stands".into(),
            });
        }
        Ok(out)
    }

    /// How far the base reaches beyond the centre of mass along a horizontal direction, metres.
    pub(super) fn base_reach(&self, direction: &Vector3<f64>) -> f64 {
        let base = self.vertices.iter().filter(|p| p.z < BASE_M);
        base.map(|p| (p - self.center).dot(direction)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// How far the object reaches beyond the centre of mass along a direction, metres.
    pub(super) fn reach(&self, direction: &Vector3<f64>) -> f64 {
        self.vertices.iter().map(|p| (p - self.center).dot(direction)).fold(f64::NEG_INFINITY, f64::max)
    }

    pub(super) fn height(&self) -> f64 {
        self.vertices.iter().map(|p| p.z).fold(0.0, f64::max)
    }

    /// The point that a horizontal push along `direction` at height `z` meets, as near beside the centre of mass as there is
    /// surface.
    pub(super) fn side(&self, direction: &Vector3<f64>, z: f64) -> Option<Point3<f64>> {
        let across = Vector3::z().cross(direction);
        let (left, right) = (self.reach(&-across), self.reach(&across));
        let offsets = (0..=20).flat_map(|k| {
            let share = f64::from(k) / 20.0;
            [share * right, -share * left]
        });
        let mut offsets: Vec<f64> = offsets.map(|x| 0.95 * x).collect();
        offsets.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
        offsets.into_iter().find_map(|offset| {
            let origin = Point3::new(self.center.x, self.center.y, z) + across * offset - direction * 10.0;
            self.hit(&origin, direction)
        })
    }

    /// The point of the top surface above `p`.
    pub(super) fn top(&self, p: &Point3<f64>) -> Option<Point3<f64>> {
        self.hit(&Point3::new(p.x, p.y, 10.0), &-Vector3::z())
    }

    /// Where a ray first meets a piece.
    fn hit(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<Point3<f64>> {
        let entry = |planes: &Vec<(Vector3<f64>, f64)>| {
            let (mut near, mut far) = (0.0_f64, f64::INFINITY);
            for (n, d) in planes {
                let (speed, depth) = (n.dot(direction), d - n.dot(&origin.coords));
                if speed.abs() < 1e-12 {
                    if depth < 0.0 {
                        return None;
                    }
                } else if speed < 0.0 {
                    near = near.max(depth / speed);
                } else {
                    far = far.min(depth / speed);
                }
            }
            (near < far).then_some(near)
        };
        self.planes.iter().filter_map(entry).reduce(f64::min).map(|s| origin + direction * s)
    }

    /// Pose of the mesh in the world with the centre of mass above `place`, the base just above its height.
    pub(super) fn start(&self, place: &Point3<f64>) -> Pose {
        let mut start = self.from_mesh;
        start.translation.vector += place.coords + Vector3::z() * GAP_M;
        start
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::mesh::convex_hull;
    use drex_core::{ConvexPart, MassProperties};
    use nalgebra::Matrix3;

    #[test]
    fn a_lying_block_has_the_sides_of_a_lying_block() {
        let points: Vec<Point3<f64>> = (0..8)
            .map(|i: i32| Point3::new(0.1 * f64::from(i & 1), 0.02 * f64::from(i & 2), 0.01 * f64::from(i & 4)))
            .collect();
        let unit = MassProperties {
            mass_kg: 1.0,
            center_of_mass: Point3::new(0.05, 0.02, 0.02),
            inertia: Matrix3::identity() * 1e-3,
        };
        let part = ConvexPart::of_hull(convex_hull(&points).unwrap());
        let object = Object::of_parts(vec![part], unit);
        // The mesh's x points up: 10 cm high, 4 x 4 cm wide.
        let s = Standing::new(&object, &Vector3::x()).unwrap();
        assert!((s.height() - 0.1).abs() < 1e-12 && (s.center - Point3::new(0.0, 0.0, 0.05)).norm() < 1e-12);
        assert!((s.base_reach(&Vector3::x()) - 0.02).abs() < 1e-12);
        let side = s.side(&Vector3::y(), 0.07).unwrap();
        assert!((side - Point3::new(0.0, -0.02, 0.07)).norm() < 1e-9, "{side}");
        assert!((s.top(&Point3::new(0.01, 0.01, 0.0)).unwrap().z - 0.1).abs() < 1e-9);
        assert!(s.side(&Vector3::y(), 0.12).is_none());
        let start = s.start(&Point3::new(1.0, 2.0, 0.5));
        assert!(((start * unit.center_of_mass) - Point3::new(1.0, 2.0, 0.55)).norm() < 1e-4);
    }
}
