//! Flat contact of two convex polyhedra: the corners of the region in which a face and the other polyhedron overlap.
//!
//! Its corners are vertices of the other polyhedron, corners of the face, and crossings of their edges. Which is which
//! does not depend on whose face is taken, so a site keeps its number when two faces take turns.

use nalgebra::Vector3;

use super::Pair;
use super::feature::{Ball, Feature, Frame, Line, Plane, Side, Touch};
use super::geom::{FaceSide, Poly};

/// A vertex this far (relative to the smaller body) beyond the side of a face is still on it, so that boxes of the same
/// size stand on each other's corners.
pub(super) const BESIDE: f64 = 2e-4;
/// Cosine of the angle within which a face of the other polyhedron faces the reference face.
const FACING_COS: f64 = -0.5;

/// One of the two polyhedra, in a frame common to both.
pub(super) struct Half<'a> {
    pub poly: &'a Poly,
    pub vertices: &'a [Vector3<f64>],
    pub planes: &'a [Plane],
    /// Maps its own frame to the common one.
    pub frame: Frame<f64>,
    pub on: Side,
    /// Site of its first vertex.
    pub first_site: u32,
}

/// Points found so far and the sides of the face, in the common frame.
#[derive(Debug, Default)]
pub(crate) struct Spots {
    points: Vec<Vector3<f64>>,
    cuts: Vec<Plane>,
}

impl Pair<'_> {
    /// The touches of `face` of the first with the second polyhedron. Returns the largest depth found.
    pub fn manifold(&mut self, reference: &Half<'_>, other: &Half<'_>, face: u32, spots: &mut Spots) -> f64 {
        let (n, d) = reference.planes[face as usize];
        let sides = reference.poly.sides(face);
        let beside = BESIDE * reference.poly.half.norm().min(other.poly.half.norm());
        let Spots { points, cuts } = spots;
        points.clear();
        cuts.clear();
        cuts.extend(sides.iter().map(|s| reference.frame.plane(&s.cut)));
        let margin = self.margin;
        let mut deepest = f64::NEG_INFINITY;
        // Vertices over the face.
        let plane = reference.poly.planes[face as usize];
        for (i, v) in other.vertices.iter().enumerate() {
            let depth = d - n.dot(v);
            if depth > -margin && inside(cuts, v, beside, usize::MAX) {
                let ball = Ball { center: other.poly.vertices[i], radius: 0.0 };
                let feature = Feature::BallPlane { on: other.on, ball, plane };
                self.out.push(Touch::new(other.first_site + i as u32, feature));
                points.push(*v);
                deepest = deepest.max(depth);
            }
        }
        deepest = deepest.max(self.corners(reference, other, (&n, sides), beside, points));
        deepest.max(self.crossings(reference, other, face, beside, (points, cuts)))
    }

    /// Corners of the face that are inside the other polyhedron.
    fn corners(
        &mut self,
        reference: &Half<'_>,
        other: &Half<'_>,
        (n, sides): (&Vector3<f64>, &[FaceSide]),
        beside: f64,
        points: &mut Vec<Vector3<f64>>,
    ) -> f64 {
        let mut deepest = f64::NEG_INFINITY;
        for side in sides {
            let u = reference.vertices[side.vertex as usize];
            let mut floor: Option<(f64, usize)> = None;
            let mut outside = false;
            for (i, (m, c)) in other.planes.iter().enumerate() {
                let height = m.dot(&u) - c;
                if height <= floor.map_or(f64::NEG_INFINITY, |f| f.0.min(beside)) {
                    continue;
                }
                if m.dot(n) < FACING_COS {
                    if floor.is_none_or(|f| height > f.0) {
                        floor = Some((height, i));
                    }
                    outside = height > self.margin;
                } else {
                    outside = height > beside;
                }
                if outside {
                    break;
                }
            }
            let Some((height, i)) = floor.filter(|_| !outside) else { continue };
            if points.iter().any(|p| across(&(p - u), n) < 2.0 * beside) {
                continue;
            }
            let ball = Ball { center: *reference.poly.vertex(side.vertex), radius: 0.0 };
            let feature = Feature::BallPlane { on: reference.on, ball, plane: other.poly.planes[i] };
            self.out.push(Touch::new(reference.first_site + side.vertex, feature));
            points.push(u);
            deepest = deepest.max(-height);
        }
        deepest
    }

    /// Where edges of the other polyhedron cross the sides of the face.
    fn crossings(
        &mut self,
        reference: &Half<'_>,
        other: &Half<'_>,
        face: u32,
        beside: f64,
        (points, cuts): (&mut Vec<Vector3<f64>>, &[Plane]),
    ) -> f64 {
        let (n, d) = reference.planes[face as usize];
        let plane = reference.poly.planes[face as usize];
        let sides = reference.poly.sides(face);
        let mut deepest = f64::NEG_INFINITY;
        let vertices = (reference.poly.vertices.len() + other.poly.vertices.len()) as u32;
        for (index, edge) in other.poly.edges.iter().enumerate() {
            let [v, w] = edge.ends.map(|i| other.vertices[i as usize]);
            if n.dot(&v) - d > self.margin && n.dot(&w) - d > self.margin {
                continue;
            }
            for (k, (m, c)) in cuts.iter().enumerate() {
                let (s, t) = (m.dot(&v) - c, m.dot(&w) - c);
                if s.max(t) <= beside || s.min(t) >= -beside {
                    continue;
                }
                let x = v + (w - v) * (s / (s - t));
                let depth = d - n.dot(&x);
                if depth <= -self.margin
                    || !inside(cuts, &x, 1e-4 * beside, k)
                    || points.iter().any(|p| across(&(p - x), &n) < 2.0 * beside)
                {
                    continue;
                }
                let line = Line { origin: *other.poly.vertex(edge.ends[0]), along: edge.along, radius: 0.0 };
                let feature = Feature::LineCut { on: other.on, line, cut: sides[k].cut, plane };
                // The pair of edges by first and second polyhedron, whoever has the face.
                let site = if reference.first_site == 0 {
                    sides[k].edge * other.poly.edges.len() as u32 + index as u32
                } else {
                    index as u32 * reference.poly.edges.len() as u32 + sides[k].edge
                };
                self.out.push(Touch::new(vertices + site, feature));
                points.push(x);
                deepest = deepest.max(depth);
            }
        }
        deepest
    }
}

/// Whether x is behind all cuts but number `skip`.
fn inside(cuts: &[Plane], x: &Vector3<f64>, beside: f64, skip: usize) -> bool {
    cuts.iter().enumerate().all(|(i, (m, c))| i == skip || m.dot(x) - c <= beside)
}

/// Length of v across the unit vector n.
fn across(v: &Vector3<f64>, n: &Vector3<f64>) -> f64 {
    (v - n * v.dot(n)).norm()
}
