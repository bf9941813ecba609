//! Flat contact of two convex polyhedra: the corners of the region in which a face and the other polyhedron overlap.
//!
//! Its corners are vertices of the other polyhedron, corners of the face, and crossings of their edges. Which is which
//! does not depend on whose face is taken, so a site keeps its number when two faces take turns.

use nalgebra::Vector3;

use super::Pair;
use super::feature::{Ball, Feature, Frame, Line, Plane, Side, Touch};
use super::geom::Poly;

/// A vertex this far (relative to the smaller body) beyond the side of a face is still on it, so that boxes of the same
/// size stand on each other's corners.
pub(super) const BESIDE: f64 = 2e-4;
/// Cosine of the angle within which a face of the other polyhedron faces the reference face.
const FACING: f64 = 0.5;
/// Cosine of the angle within which its normal is as good as that of the reference face.
const ALONG: f64 = 0.97;

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

impl Half<'_> {
    /// A box around it in the common frame.
    pub fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let middle = self.frame.point(&self.poly.middle);
        let reach = (self.frame.r * self.poly.axes).abs() * self.poly.half;
        (middle - reach, middle + reach)
    }
}

/// Points found so far with their depths, and the sides of the face, in the common frame.
#[derive(Debug, Default)]
pub(crate) struct Spots {
    points: Vec<(Vector3<f64>, f64)>,
    cuts: Vec<Plane>,
    /// Heights of the vertices of the other polyhedron over the face, and whether they are inside its sides.
    heights: Vec<(f64, bool)>,
}

impl Spots {
    /// A lower bound on the width of what is in both bodies: the least height of a triangle of such points.
    pub fn width(&self) -> f64 {
        let inside = || self.points.iter().filter(|(_, depth)| *depth > 0.0).map(|(p, _)| *p);
        let Some(a) = inside().next() else { return 0.0 };
        let farthest = |size: &dyn Fn(&Vector3<f64>) -> f64| {
            inside().map(|p| (size(&p), p)).fold((0.0, a), |best, next| if next.0 > best.0 { next } else { best })
        };
        let (ab, b) = farthest(&|p| (p - a).norm());
        let (area, c) = farthest(&|p| (b - a).cross(&(p - a)).norm());
        let longest = ab.max((c - a).norm()).max((c - b).norm());
        if longest > 0.0 { area / longest } else { 0.0 }
    }
}

impl Pair<'_> {
    /// The touches of `face` of the first with the second polyhedron. Returns the largest depth found.
    pub fn manifold(&mut self, reference: &Half<'_>, other: &Half<'_>, face: u32, spots: &mut Spots) -> f64 {
        let (n, d) = reference.planes[face as usize];
        let sides = reference.poly.sides(face);
        let beside = BESIDE * reference.poly.half.norm().min(other.poly.half.norm());
        let Spots { points, cuts, heights } = spots;
        points.clear();
        heights.clear();
        cuts.clear();
        cuts.extend(sides.iter().map(|s| reference.frame.plane(&s.cut)));
        let margin = self.margin;
        let mut deepest = f64::NEG_INFINITY;
        // Vertices over the face.
        let plane = reference.poly.planes[face as usize];
        for (i, v) in other.vertices.iter().enumerate() {
            let depth = d - n.dot(v);
            let over = depth > -margin && inside(cuts, v, beside, usize::MAX);
            heights.push((-depth, over));
            if over {
                let ball = Ball { center: other.poly.vertices[i], radius: 0.0 };
                let feature = Feature::BallPlane { on: other.on, ball, plane };
                self.out.push(Touch::new(other.first_site + i as u32, feature));
                points.push((*v, depth));
                deepest = deepest.max(depth);
            }
        }
        deepest = deepest.max(self.corners(reference, other, face, beside, points));
        deepest.max(self.crossings(reference, other, face, beside, spots))
    }

    /// Corners of the face that are inside the other polyhedron.
    fn corners(
        &mut self,
        reference: &Half<'_>,
        other: &Half<'_>,
        face: u32,
        beside: f64,
        points: &mut Vec<(Vector3<f64>, f64)>,
    ) -> f64 {
        let n = &reference.planes[face as usize].0;
        let plane = reference.poly.planes[face as usize];
        let mut deepest = f64::NEG_INFINITY;
        for side in reference.poly.sides(face) {
            let u = reference.vertices[side.vertex as usize];
            // The face of the other that a ray from the corner leaves it by, and how far that is.
            let mut floor = (f64::INFINITY, 0);
            let outside = other.planes.iter().enumerate().any(|(i, (m, c))| {
                let (height, facing) = (m.dot(&u) - c, -m.dot(n));
                if facing < FACING {
                    return height > beside;
                }
                if -height < floor.0 * facing {
                    floor = (-height / facing, i);
                }
                height > self.margin
            });
            let (depth, i) = floor;
            if outside || depth == f64::INFINITY || points.iter().any(|(p, _)| is_near(&(p - u), n, beside)) {
                continue;
            }
            let feature = if other.planes[i].0.dot(n) < -ALONG {
                let ball = Ball { center: *reference.poly.vertex(side.vertex), radius: 0.0 };
                Feature::BallPlane { on: reference.on, ball, plane: other.poly.planes[i] }
            } else {
                // A steep face: its point under the corner, against the reference face.
                let center = other.frame.r.tr_mul(&(u - n * depth - other.frame.p));
                Feature::BallPlane { on: other.on, ball: Ball { center, radius: 0.0 }, plane }
            };
            self.out.push(Touch::new(reference.first_site + side.vertex, feature));
            points.push((u, depth));
            deepest = deepest.max(depth);
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
        Spots { points, cuts, heights }: &mut Spots,
    ) -> f64 {
        let (n, d) = reference.planes[face as usize];
        let plane = reference.poly.planes[face as usize];
        let sides = reference.poly.sides(face);
        let mut deepest = f64::NEG_INFINITY;
        let vertices = (reference.poly.vertices.len() + other.poly.vertices.len()) as u32;
        for (index, edge) in other.poly.edges.iter().enumerate() {
            let [a, b] = edge.ends.map(|i| heights[i as usize]);
            if a.0 > self.margin && b.0 > self.margin || a.1 && b.1 {
                continue;
            }
            let [v, w] = edge.ends.map(|i| other.vertices[i as usize]);
            for (k, (m, c)) in cuts.iter().enumerate() {
                let (s, t) = (m.dot(&v) - c, m.dot(&w) - c);
                if s.max(t) <= beside || s.min(t) >= -beside {
                    continue;
                }
                let x = v + (w - v) * (s / (s - t));
                let depth = d - n.dot(&x);
                if depth <= -self.margin
                    || !inside(cuts, &x, 1e-4 * beside, k)
                    || points.iter().any(|(p, _)| is_near(&(p - x), &n, beside))
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
                points.push((x, depth));
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

/// Whether two points that differ by v are one, seen along the unit vector n.
fn is_near(v: &Vector3<f64>, n: &Vector3<f64>, beside: f64) -> bool {
    v.norm_squared() - v.dot(n).powi(2) < 4.0 * beside * beside
}
