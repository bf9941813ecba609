//! Parts of a solid between cutting planes.

use std::collections::BTreeMap;

use nalgebra::{Point3, Unit, Vector3};

use drex_core::TriMesh;

use drex_core::mesh::convex_hull;

/// The plane n·x = d.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plane {
    pub normal: Unit<Vector3<f64>>,
    pub offset: f64,
}

impl Plane {
    pub fn height(&self, p: &Point3<f64>) -> f64 {
        self.normal.dot(&p.coords) - self.offset
    }

    pub fn flipped(&self) -> Self {
        Self { normal: -self.normal, offset: -self.offset }
    }

    /// The plane moved along its normal.
    pub fn moved(&self, by: f64) -> Self {
        Self { normal: self.normal, offset: self.offset + by }
    }
}

/// The part of a solid inside a convex cell: the surface in the cell, and the cell.
#[derive(Debug, Clone)]
pub(super) struct Part {
    pub surface: TriMesh,
    /// A convex polytope; its corners inside the solid are corners of the part.
    pub cell: TriMesh,
}

impl Part {
    /// The whole solid with the given surface.
    pub fn whole(surface: TriMesh) -> Option<Self> {
        let (lo, hi) = surface.bounds()?;
        let margin = 0.01 * (hi - lo).norm();
        let side = |k: usize, high: bool| if high { hi[k] + margin } else { lo[k] - margin };
        let corners: Vec<Point3<f64>> =
            (0..8).map(|i| Point3::from([0, 1, 2].map(|k| side(k, i >> k & 1 == 1)))).collect();
        Some(Self { surface, cell: convex_hull(&corners).ok()? })
    }

    /// What lies behind the plane (where n·x ≤ d); `None` if nothing of the cell does.
    pub fn behind(&self, plane: &Plane) -> Option<Self> {
        let cell = convex_hull(&points_behind(&self.cell, &edges(&self.cell), plane)).ok()?;
        Some(Self { surface: clip(&self.surface, plane), cell })
    }

    /// Points whose hull is the part's: those of its surface, and the corners of the cell inside the solid.
    pub fn points(&self, inside: impl Fn(&Point3<f64>) -> bool) -> Vec<Point3<f64>> {
        let corners = self.cell.vertices.iter().filter(|p| inside(p));
        self.surface.vertices.iter().chain(corners).copied().collect()
    }
}

/// The edges of a mesh, each once.
pub(super) fn edges(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let mut all: Vec<[u32; 2]> =
        mesh.faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).map(|[a, b]| [a.min(b), a.max(b)]).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// The vertices behind the plane, and the points where edges cross it.
pub(super) fn points_behind(mesh: &TriMesh, edges: &[[u32; 2]], plane: &Plane) -> Vec<Point3<f64>> {
    let height: Vec<f64> = mesh.vertices.iter().map(|p| plane.height(p)).collect();
    let mut points: Vec<Point3<f64>> =
        mesh.vertices.iter().zip(&height).filter(|&(_, &h)| h <= 0.0).map(|(p, _)| *p).collect();
    for &[a, b] in edges {
        let (a, b) = (a as usize, b as usize);
        if (height[a] < 0.0 && height[b] > 0.0) || (height[a] > 0.0 && height[b] < 0.0) {
            points.push(crossing(mesh, &height, a, b));
        }
    }
    points
}

/// Where the edge between two vertices on different sides meets the plane.
fn crossing(mesh: &TriMesh, height: &[f64], a: usize, b: usize) -> Point3<f64> {
    let (a, b) = (a.min(b), a.max(b));
    mesh.vertices[a].lerp(&mesh.vertices[b], height[a] / (height[a] - height[b]))
}

/// Length of the curve along which a plane cuts a surface.
pub(super) fn cut_length(mesh: &TriMesh, plane: &Plane) -> f64 {
    let height: Vec<f64> = mesh.vertices.iter().map(|p| plane.height(p)).collect();
    let length = |face: &[u32; 3]| {
        let v = face.map(|v| v as usize);
        let side = v.map(|v| height[v] > 0.0);
        // The corner that is alone on its side.
        let k = (0..3).find(|&k| side[k] != side[(k + 1) % 3] && side[k] != side[(k + 2) % 3])?;
        let end = |j: usize| {
            let (a, b) = (v[k], v[(k + j) % 3]);
            mesh.vertices[a].lerp(&mesh.vertices[b], height[a] / (height[a] - height[b]))
        };
        Some((end(1) - end(2)).norm())
    };
    mesh.faces.iter().filter_map(length).sum()
}

/// The triangles behind the plane, those that cross it cut off (Sutherland and Hodgman 1974). No lid is put on the cut.
fn clip(mesh: &TriMesh, plane: &Plane) -> TriMesh {
    let height: Vec<f64> = mesh.vertices.iter().map(|p| plane.height(p)).collect();
    let mut kept = BTreeMap::new();
    let mut cut = BTreeMap::new();
    let mut out = TriMesh::default();
    for face in &mesh.faces {
        if face.iter().all(|&v| height[v as usize] >= 0.0) {
            continue;
        }
        let mut polygon: Vec<u32> = Vec::with_capacity(4);
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            let (ha, hb) = (height[a as usize], height[b as usize]);
            if ha <= 0.0 {
                polygon.push(*kept.entry(a).or_insert_with(|| {
                    out.vertices.push(mesh.vertices[a as usize]);
                    out.vertices.len() as u32 - 1
                }));
            }
            if (ha < 0.0 && hb > 0.0) || (ha > 0.0 && hb < 0.0) {
                polygon.push(*cut.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    out.vertices.push(crossing(mesh, &height, a as usize, b as usize));
                    out.vertices.len() as u32 - 1
                }));
            }
        }
        out.faces.extend((2..polygon.len()).map(|k| [polygon[0], polygon[k - 1], polygon[k]]));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hull::hull_volume;
    use crate::shapes::{cuboid, sphere};

    #[test]
    fn eight_parts_of_a_box_have_its_volume_although_their_common_corner_is_inside() {
        let whole = Part::whole(cuboid([0.0; 3], [0.1, 0.2, 0.3])).unwrap();
        let mut parts = vec![whole];
        for (normal, offset) in [(Vector3::x_axis(), 0.03), (Vector3::y_axis(), 0.11), (Vector3::z_axis(), 0.07)] {
            let plane = Plane { normal, offset };
            parts = parts.iter().flat_map(|p| [p.behind(&plane), p.behind(&plane.flipped())]).flatten().collect();
        }
        assert_eq!(parts.len(), 8);
        let inside = |p: &Point3<f64>| (0..3).all(|k| p[k] > 0.0 && p[k] < [0.1, 0.2, 0.3][k]);
        let sum: f64 = parts.iter().map(|p| hull_volume(&convex_hull(&p.points(inside)).unwrap())).sum();
        assert!((sum - 6e-3).abs() < 1e-14, "{sum}");
    }

    #[test]
    fn a_clipped_surface_has_the_area_behind_the_plane() {
        let ball = sphere(1.0, 5);
        let plane = Plane { normal: Unit::new_normalize(Vector3::new(1.0, 2.0, 3.0)), offset: 0.3 };
        let (front, back) = (clip(&ball, &plane), clip(&ball, &plane.flipped()));
        assert!((front.area() + back.area() - ball.area()).abs() < 1e-12);
        // A zone of a sphere: 2π r h.
        assert!((front.area() / (std::f64::consts::TAU * 1.3) - 1.0).abs() < 2e-3, "{}", front.area());
        let circle = std::f64::consts::TAU * (1.0_f64 - 0.09).sqrt();
        assert!((cut_length(&ball, &plane) / circle - 1.0).abs() < 2e-3);
    }
}
