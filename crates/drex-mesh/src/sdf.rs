//! Exact signed distance to the solid a mesh encloses.

use nalgebra::{Point3, Vector3};

use drex_core::{SdfSample, SignedDistance, SolidGeometry, Surface, SurfacePoint, TriMesh};

use crate::Result;
use crate::boundary::boundary;
use crate::bvh::{Bvh, Nearest};
use crate::solid::close;

/// Signed distance, nearest point and rays for the solid that a mesh encloses.
///
/// The surface is the boundary of the solid {winding number > 1/2}: openings are closed by fans, walls inside the
/// solid (touching or overlapping parts) are taken out, so that the distance is continuous and its sign is right.
/// The sign is that of the winding number; the nearest point comes from a tree over the triangles.
#[derive(Debug, Clone)]
pub struct MeshSdf {
    boundary: TriMesh,
    boundary_tree: Bvh,
    /// Over all faces with lids: the winding number needs them all.
    tree: Bvh,
    /// Whether outside is where the normal of every face of the boundary points: then a face that is hit in its middle says the sign as well.
    outwards: bool,
    bounds: (Point3<f64>, Point3<f64>),
}

/// How far inside a face a nearest point has to be, in barycentric coordinates, and how far off the face the point itself,
/// in diagonals of the mesh, for the face's normal to say the sign.
const MIDDLE: f64 = 1e-6;

impl MeshSdf {
    /// Prepares a mesh that is welded and wound outwards (see [`crate::repair()`]).
    ///
    /// # Errors
    /// If the mesh has no triangles or no face of it bounds a solid.
    pub fn new(mesh: &TriMesh) -> Result<Self> {
        let (capped, tree) = close(mesh)?;
        let boundary = boundary(&capped.mesh, &tree, capped.openings > 0);
        let outwards = boundary.whole && boundary.simple;
        let boundary = if boundary.whole { capped.mesh } else { boundary.mesh() };
        let bounds =
            boundary.bounds().filter(|_| !boundary.faces.is_empty()).ok_or_else(|| crate::Error::NoVolume {
                subject: "the mesh".into(),
                reason: "none of its faces has an inside and an outside".into(),
            })?;
        Ok(Self { boundary_tree: Bvh::cut(&boundary), boundary, tree, outwards, bounds })
    }

    /// The same for a closed mesh of which every face is known to bound the solid.
    pub(crate) fn of_whole(boundary: TriMesh) -> Result<Self> {
        let tree = Bvh::cut(&boundary);
        let bounds = boundary.bounds().ok_or_else(|| crate::Error::Empty { subject: "the mesh".into() })?;
        Ok(Self { boundary_tree: tree.clone(), boundary, tree, outwards: false, bounds })
    }

    /// Whether the point is inside the solid.
    pub fn contains(&self, point: &Point3<f64>) -> bool {
        self.tree.winding(point) > 0.5
    }

    /// The boundary of the solid: the mesh with lids over its openings and without inner walls.
    pub fn boundary(&self) -> &TriMesh {
        &self.boundary
    }

    fn normal(&self, face: u32) -> Vector3<f64> {
        let [a, b, c] = self.boundary.triangle(face as usize);
        (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::z)
    }

    /// `inside` where that is known.
    fn distance(&self, point: &Point3<f64>, inside: Option<bool>) -> SdfSample {
        let Some(n) = self.boundary_tree.nearest(point, f64::INFINITY) else {
            return SdfSample { distance_m: f64::INFINITY, gradient: Vector3::z() };
        };
        let inside = inside.or_else(|| self.behind(point, &n)).unwrap_or_else(|| self.contains(point));
        let sign = if inside { -1.0 } else { 1.0 };
        let away = point - n.point;
        let distance = n.distance_squared.sqrt();
        // Closer than rounding lets the difference have a direction, the face's normal is the better answer.
        let scale = 1e-12 * (self.bounds.1 - self.bounds.0).norm();
        let gradient = if distance > scale { away * (sign / distance) } else { self.normal(n.face) };
        SdfSample { distance_m: sign * distance, gradient }
    }

    /// Whether the point is behind the face on which its nearest point lies; nothing near the rim of the face, where its normal does not say, and
    /// on the face. Far cheaper than the winding number.
    fn behind(&self, point: &Point3<f64>, n: &Nearest) -> Option<bool> {
        if !self.outwards {
            return None;
        }
        let [a, b, c] = self.boundary.triangle(n.face as usize);
        let normal = (b - a).cross(&(c - a));
        let in_middle = [(a, b), (b, c), (c, a)]
            .iter()
            .all(|(from, to)| (to - from).cross(&(n.point - from)).dot(&normal) > MIDDLE * normal.norm_squared());
        let off = (point - n.point).dot(&normal);
        let clear = off.abs() > MIDDLE * normal.norm() * (self.bounds.1 - self.bounds.0).norm();
        (in_middle && clear).then_some(off < 0.0)
    }

    /// Signed distance at a point that is known to be inside.
    pub(crate) fn distance_inside(&self, point: &Point3<f64>) -> SdfSample {
        self.distance(point, Some(true))
    }

    /// Signed distance at a point that is known to be outside.
    pub(crate) fn distance_outside(&self, point: &Point3<f64>) -> SdfSample {
        self.distance(point, Some(false))
    }

    /// Distance without sign and the nearest point, looking no farther than `within`.
    pub(crate) fn distance_within(&self, point: &Point3<f64>, within: f64) -> Option<f64> {
        self.boundary_tree.nearest(point, within).map(|n| n.distance_squared.sqrt())
    }
}

impl SolidGeometry for MeshSdf {
    fn exact(&self) -> &dyn SignedDistance {
        self
    }

    fn bounding_box(&self) -> (Point3<f64>, Point3<f64>) {
        self.bounds()
    }
}

impl Surface for MeshSdf {
    fn nearest(&self, point: &Point3<f64>) -> SurfacePoint {
        match self.boundary_tree.nearest(point, f64::INFINITY) {
            Some(n) => SurfacePoint { point: n.point, normal: self.normal(n.face) },
            // Only for a point that is not finite.
            None => SurfacePoint { point: self.bounds.0, normal: Vector3::z() },
        }
    }

    fn ray_cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>, max_distance_m: f64) -> Option<SurfacePoint> {
        let (face, t) = self.boundary_tree.ray(origin, direction, max_distance_m)?;
        Some(SurfacePoint { point: origin + direction * t, normal: self.normal(face) })
    }

    fn bounds(&self) -> (Point3<f64>, Point3<f64>) {
        self.bounds
    }
}

impl SignedDistance for MeshSdf {
    /// The gradient at the surface itself is the normal of the face.
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        self.distance(point, None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, joined, sphere};

    #[test]
    fn faces_say_the_same_sign_as_the_winding_number() {
        let ball = sphere(1.0, 3);
        let pair = joined(&[cuboid([-1.0; 3], [0.0, 1.0, 1.0]), cuboid([0.5, -1.0, -1.0], [1.0; 3])]);
        let mut by_face = 0;
        for mesh in [ball, pair] {
            let sdf = MeshSdf::new(&mesh).unwrap();
            for i in 0..2000 {
                let p = Point3::from(crate::sequence::unit_cube_point(i).map(|c| 3.0 * (c - 0.5)));
                let n = sdf.boundary_tree.nearest(&p, f64::INFINITY).unwrap();
                if let Some(behind) = sdf.behind(&p, &n) {
                    by_face += 1;
                    assert_eq!(behind, sdf.contains(&p), "{p}");
                }
            }
        }
        assert!(by_face > 2000, "{by_face} of 4000");
        // Where parts overlap, a face may be a wall inside the solid.
        let overlapping = joined(&[cuboid([-1.0; 3], [0.2, 1.0, 1.0]), cuboid([-0.2, -1.0, -1.0], [1.0; 3])]);
        assert!(!MeshSdf::new(&overlapping).unwrap().outwards);
    }

    #[test]
    fn distance_to_a_box_is_exact() {
        let sdf = MeshSdf::new(&cuboid([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0])).unwrap();
        for i in 0..500 {
            let p = Point3::from(crate::sequence::unit_cube_point(i).map(|c| 8.0 * (c - 0.5)));
            let q = p.coords.abs() - Vector3::new(1.0, 2.0, 3.0);
            let truth = q.sup(&Vector3::zeros()).norm() + q.max().min(0.0);
            let s = sdf.signed_distance(&p);
            assert!((s.distance_m - truth).abs() < 1e-12);
            assert!((s.gradient.norm() - 1.0).abs() < 1e-9);
            let step = 1e-6;
            let ahead = sdf.signed_distance(&(p + s.gradient * step)).distance_m;
            assert!((ahead - s.distance_m - step).abs() < 1e-7, "{p}");
        }
    }

    #[test]
    fn inner_walls_of_a_letter_are_not_surface() {
        let t = joined(&[cuboid([-3.0, 0.0, 0.0], [3.0, 2.0, 4.0]), cuboid([-1.0, -4.0, 0.0], [1.0, 0.0, 4.0])]);
        let sdf = MeshSdf::new(&t).unwrap();
        let at_the_seam = sdf.signed_distance(&Point3::new(0.0, 0.0, 2.0)).distance_m;
        assert!((at_the_seam + 1.0).abs() < 0.02, "{at_the_seam}");
        let beside = sdf.signed_distance(&Point3::new(2.0, -0.5, 2.0)).distance_m;
        assert!((beside - 0.5).abs() < 1e-9, "{beside}");
    }

    #[test]
    fn an_opening_is_closed_and_rays_hit_from_outside() {
        let mut m = sphere(0.05, 4);
        m.faces.retain(|f| f.iter().all(|&v| m.vertices[v as usize].z < 0.03));
        let sdf = MeshSdf::new(&m).unwrap();
        let hit = sdf.ray_cast(&Point3::new(0.0, 0.0, 0.2), &-Vector3::z(), 1.0).unwrap();
        // All triangles of the lid meet where the ray hits, and the rim zigzags: any of their normals is right.
        assert!(hit.point.z < 0.03 && hit.point.z > 0.02 && hit.normal.z > 0.5, "{hit:?}");
        assert!(sdf.contains(&Point3::origin()) && !sdf.contains(&Point3::new(0.0, 0.0, 0.04)));
        assert!(sdf.ray_cast(&Point3::new(0.0, 0.0, 0.2), &-Vector3::z(), 0.1).is_none());
    }
}
