//! Convex pieces: a bounded set of extreme points with the edges and planes of their hull.

use std::collections::BTreeSet;

use drex_core::mesh::convex_hull_faces;
use nalgebra::{Point3, Vector3};

use crate::{Result, SimError};

/// Directions in which extreme points are looked for. Even, so that no direction is horizontal.
const DIRECTIONS: usize = 4096;
/// Most vertices a piece keeps.
const MAX_VERTICES: usize = 128;
/// Relative thickness below which a point counts as lying in a plane.
const FLAT: f64 = 2e-6;
/// Cosine of the angle under which two neighbouring triangles are one face.
const COPLANAR_COS: f64 = 0.999_99;

/// A convex polyhedron, in the frame of the body that carries it.
///
/// Its vertices are the points that are extreme in one of some thousand directions, so their number, and with it the
/// cost and the stiffness of contact, is bounded however fine the mesh is: a box keeps its eight corners, the rims of a
/// cylinder as many points as the mesh has (up to the bound).
#[derive(Debug, Clone, PartialEq)]
pub struct ConvexPiece {
    vertices: Vec<Point3<f64>>,
    edges: Vec<[u32; 2]>,
    planes: Vec<(Vector3<f64>, f64)>,
    /// Corners of the bounding box.
    bounds: (Point3<f64>, Point3<f64>),
}

impl ConvexPiece {
    /// The convex hull of `points`, metres.
    ///
    /// # Errors
    /// If a coordinate is not finite or the points span no volume.
    pub fn from_points(points: &[Point3<f64>]) -> Result<Self> {
        if points.iter().any(|p| p.iter().any(|c| !c.is_finite())) {
            return Err(SimError::NotFinite { what: "a vertex of a convex piece".into() });
        }
        let vertices = spread_out(extreme_points(points), MAX_VERTICES);
        let size = vertices.iter().map(|p| (p - vertices[0]).norm()).fold(0.0, f64::max);
        let triangles =
            convex_hull_faces(&vertices, FLAT * size).ok_or(SimError::FlatPiece { points: points.len() })?;
        Ok(Self::from_hull(vertices, &triangles))
    }

    /// Corner points, metres.
    pub fn vertices(&self) -> &[Point3<f64>] {
        &self.vertices
    }

    /// Edges between faces that are not coplanar, as pairs of vertex indices.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// Outward unit normal n and offset d of each face plane: inside where n·x <= d.
    pub fn planes(&self) -> &[(Vector3<f64>, f64)] {
        &self.planes
    }

    /// Bound on the distance of a point of the piece from `p`: the farthest corner of the bounding box.
    pub(crate) fn farthest_from(&self, p: &Point3<f64>) -> f64 {
        (self.bounds.0 - p).abs().sup(&(self.bounds.1 - p).abs()).norm()
    }

    fn from_hull(vertices: Vec<Point3<f64>>, triangles: &[[u32; 3]]) -> Self {
        let triangles: Vec<[usize; 3]> = triangles.iter().map(|t| t.map(|v| v as usize)).collect();
        let normal = |t: &[usize; 3]| {
            let (a, b, c) = (vertices[t[0]], vertices[t[1]], vertices[t[2]]);
            (b - a).cross(&(c - a)).normalize()
        };
        let normals: Vec<Vector3<f64>> = triangles.iter().map(normal).collect();
        let mut planes: Vec<(Vector3<f64>, f64)> = Vec::new();
        for (t, n) in triangles.iter().zip(&normals) {
            if !planes.iter().any(|(m, _)| m.dot(n) > COPLANAR_COS) {
                let d = vertices.iter().map(|v| n.dot(&v.coords)).fold(f64::NEG_INFINITY, f64::max);
                debug_assert!(d - n.dot(&vertices[t[0]].coords) < 1e-3);
                planes.push((*n, d));
            }
        }
        let mut edges = Vec::new();
        for (i, t) in triangles.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                if a < b {
                    let twin = triangles.iter().position(|s| (0..3).any(|j| s[j] == b && s[(j + 1) % 3] == a));
                    if twin.is_none_or(|j| normals[i].dot(&normals[j]) < COPLANAR_COS) {
                        edges.push([a as u32, b as u32]);
                    }
                }
            }
        }
        let (lo, hi) = vertices.iter().fold((vertices[0], vertices[0]), |(lo, hi), p| (lo.inf(p), hi.sup(p)));
        Self { vertices, edges, planes, bounds: (lo, hi) }
    }
}

/// The points that lie farthest out in one of [`DIRECTIONS`] directions (a Fibonacci lattice), each once.
/// The lattice is generic, so of points on a flat face only its corners are found.
fn extreme_points(points: &[Point3<f64>]) -> Vec<Point3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let mut found = BTreeSet::new();
    for i in 0..DIRECTIONS {
        let z = 1.0 - (2 * i + 1) as f64 / DIRECTIONS as f64;
        let (r, a) = ((1.0 - z * z).sqrt(), golden * i as f64 + 0.1);
        let n = Vector3::new(r * a.cos(), r * a.sin(), z);
        let best = points.iter().enumerate().max_by(|x, y| n.dot(&x.1.coords).total_cmp(&n.dot(&y.1.coords)));
        found.extend(best.map(|(k, _)| k));
    }
    let mut kept: Vec<Point3<f64>> = Vec::new();
    let size = found.iter().map(|&k| (points[k] - points[0]).norm()).fold(0.0, f64::max);
    for k in found {
        if kept.iter().all(|p| (p - points[k]).norm() > FLAT * size) {
            kept.push(points[k]);
        }
    }
    kept
}

/// At most `limit` of `points`, chosen so that each is the farthest from those already chosen; order of `points` kept.
fn spread_out(points: Vec<Point3<f64>>, limit: usize) -> Vec<Point3<f64>> {
    if points.len() <= limit {
        return points;
    }
    let center = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let farthest = |d: &[f64]| (0..d.len()).max_by(|&a, &b| d[a].total_cmp(&d[b])).unwrap_or(0);
    let mut chosen = BTreeSet::new();
    let mut distance: Vec<f64> = points.iter().map(|p| (p.coords - center).norm()).collect();
    let mut next = farthest(&distance);
    distance = vec![f64::INFINITY; points.len()];
    while chosen.len() < limit {
        chosen.insert(next);
        for (d, p) in distance.iter_mut().zip(&points) {
            *d = d.min((p - points[next]).norm());
        }
        next = farthest(&distance);
    }
    chosen.into_iter().map(|i| points[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid_box(hx: f64, hy: f64, hz: f64, n: usize) -> Vec<Point3<f64>> {
        let mut out = Vec::new();
        for i in 0..=n {
            for j in 0..=n {
                for k in 0..=n {
                    let f = |m: usize, h: f64| h * (2.0 * m as f64 / n as f64 - 1.0);
                    out.push(Point3::new(f(i, hx), f(j, hy), f(k, hz)));
                }
            }
        }
        out
    }

    #[test]
    fn a_box_keeps_eight_corners_however_fine_its_mesh() {
        for n in [1, 7, 20] {
            let piece = ConvexPiece::from_points(&grid_box(0.014, 0.039, 0.012, n)).unwrap();
            assert_eq!((piece.vertices().len(), piece.edges().len(), piece.planes().len()), (8, 12, 6), "n = {n}");
        }
    }

    #[test]
    fn a_cylinder_keeps_its_rims() {
        let rim = |z: f64| {
            (0..38).map(move |i| {
                let a = std::f64::consts::TAU * f64::from(i) / 38.0;
                Point3::new(0.03 * a.cos(), 0.03 * a.sin(), z)
            })
        };
        let points: Vec<_> = rim(-0.05).chain(rim(0.0)).chain(rim(0.05)).collect();
        let piece = ConvexPiece::from_points(&points).unwrap();
        assert_eq!((piece.vertices().len(), piece.edges().len(), piece.planes().len()), (76, 114, 40));
    }

    #[test]
    fn a_ball_is_bounded_and_flat_points_are_refused() {
        let ball: Vec<_> = (0..3000)
            .map(|i| {
                let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 3000.0;
                let a = 2.4 * f64::from(i);
                Point3::new((1.0 - z * z).sqrt() * a.cos(), (1.0 - z * z).sqrt() * a.sin(), z)
            })
            .collect();
        let piece = ConvexPiece::from_points(&ball).unwrap();
        assert_eq!(piece.vertices().len(), MAX_VERTICES);
        assert_eq!(piece.vertices().len() + piece.planes().len() - piece.edges().len(), 2, "Euler's formula");
        let flat: Vec<_> = ball.iter().map(|p| Point3::new(p.x, p.y, 0.2)).collect();
        assert!(matches!(ConvexPiece::from_points(&flat), Err(SimError::FlatPiece { points: 3000 })));
        assert!(ConvexPiece::from_points(&[]).is_err());
    }
}
