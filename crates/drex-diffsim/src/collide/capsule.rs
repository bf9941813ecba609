//! The middle of a capsule against other capsules and the edges of polyhedra. Its ends are balls.

use nalgebra::Vector3;

use super::Pair;
use super::ball::unit;
use super::feature::{Ball, Feature, Line, Plane, Side, Touch};
use super::geom::{Edge, Kind, Poly};

/// Lines whose angle has a smaller sine do not cross.
const PARALLEL: f64 = 1e-3;
/// A normal may lie this far (sine) outside the normals of an edge: a capsule flat on a face touches both its sides.
const OUTSIDE_CONE: f64 = 0.035;

impl Pair<'_> {
    /// The touches from `start` on are those of the ends of a.
    /// Sites: 0 and 1 are the ends of a, 2 and 3 those of b, 4 where they cross.
    pub fn capsule_capsule(
        &mut self,
        a: &[Vector3<f64>; 2],
        radius: f64,
        kind: &Kind,
        b: &[Vector3<f64>; 2],
        other_radius: f64,
        start: usize,
    ) {
        let first = self.out.len();
        self.ball(Side::B, &b[0], other_radius, kind, 2);
        self.ball(Side::B, &b[1], other_radius, kind, 3);
        // Two ends that touch each other have been found from the other side already.
        let pair = |t: &Touch| match &t.feature {
            Feature::BallBall { on: Side::A, ball, other } => Some((ball.center, other.center)),
            Feature::BallBall { on: Side::B, ball, other } => Some((other.center, ball.center)),
            _ => None,
        };
        let earlier = |t: &Touch, out: &[Touch]| {
            pair(t).is_some_and(|p| out.iter().any(|o| o.site < 2 && o.feature.on() == Side::A && pair(o) == Some(p)))
        };
        for i in (first..self.out.len()).rev() {
            if earlier(&self.out[i], &self.out[start..first]) {
                self.out.remove(i);
            }
        }
        let Rod { line, length, .. } = Rod::new(a, radius, Side::A);
        let Rod { line: other, length: other_length, .. } = Rod::new(b, other_radius, Side::B);
        let there = (self.a_from_b.point(&other.origin), self.a_from_b.direction(&other.along));
        let Some((s, t)) = crossing((&line.origin, &line.along), (&there.0, &there.1)) else { return };
        let inside = |s: f64, length: f64, radius: f64| s > 1e-6 * radius && s < length - 1e-6 * radius;
        if !inside(s, length, radius) || !inside(t, other_length, other_radius) {
            return;
        }
        let apart = line.origin + line.along * s - there.0 - there.1 * t;
        if apart.norm() < radius + other_radius + self.margin {
            let sign = if line.along.cross(&there.1).dot(&apart) < 0.0 { -1.0 } else { 1.0 };
            self.out.push(Touch::new(4, Feature::LineLine { on: Side::A, line, other, sign }));
        }
    }

    /// A thick segment without its ends against the edges and vertices of a polyhedron on the other body. Sites: the
    /// edges from `site` on, then the vertices. With `towards` (out of the polyhedron, in its frame) only touches whose
    /// normals are that way.
    pub fn rod_poly(&mut self, rod: &Rod, poly: &Poly, site: u32, towards: Option<Vector3<f64>>) {
        let poly_from_rod = match rod.on {
            Side::A => self.a_from_b.inverse(),
            Side::B => self.a_from_b,
        };
        let Rod { line, length, on } = rod;
        let (p, e) = (poly_from_rod.point(&line.origin), poly_from_rod.direction(&line.along));
        let q = p + e * *length;
        let limit = line.radius + self.margin;
        let (lo, hi) = (p.inf(&q).add_scalar(-limit), p.sup(&q).add_scalar(limit));
        let inside = |s: f64| s > 1e-6 * line.radius && s < length - 1e-6 * line.radius;
        let out_of = |n: &Vector3<f64>| towards.is_none_or(|t| t.dot(n) > 0.5);
        let first = self.out.len();
        let mut best: Option<(f64, Vector3<f64>)> = None;
        for (i, edge) in poly.edges.iter().enumerate() {
            let (v, w) = (poly.vertex(edge.ends[0]), poly.vertex(edge.ends[1]));
            let (from, to) = (v.inf(w), v.sup(w));
            if (0..3).any(|k| from[k] > hi[k] || to[k] < lo[k]) {
                continue;
            }
            let Some((s, t)) = crossing((&p, &e), (v, &edge.along)) else { continue };
            if !inside(s) || t < 0.0 || t > (w - v).norm() {
                continue;
            }
            let [n1, n2] = edge.faces.map(|f| poly.planes[f as usize].0);
            let cross = e.cross(&edge.along).normalize();
            let sign = if cross.dot(&(n1 + n2)) < 0.0 { -1.0 } else { 1.0 };
            let n = cross * sign;
            let gap = n.dot(&(p - v));
            // Behind the edge, but out of the polyhedron again on its far side.
            let beyond = |(m, d): &Plane| m.dot(&(p + e * s)) - d > OUTSIDE_CONE * gap.abs();
            if gap >= limit || !in_cone(poly, edge, &n) || !out_of(&n) || (gap < 0.0 && poly.planes.iter().any(beyond))
            {
                continue;
            }
            let other = Line { origin: *v, along: edge.along, radius: 0.0 };
            self.out.push(Touch::new(site + i as u32, Feature::LineLine { on: *on, line: *line, other, sign }));
            if best.is_none_or(|(g, _)| gap > g) {
                best = Some((gap, n));
            }
        }
        // A rod deep inside crosses edges on the far side as well.
        if let Some((_, n)) = best {
            for i in (first..self.out.len()).rev() {
                let Feature::LineLine { other, sign, .. } = &self.out[i].feature else { continue };
                if e.cross(&other.along).dot(&n) * sign <= 0.0 {
                    self.out.remove(i);
                }
            }
        }
        for (i, v) in poly.vertices.iter().enumerate() {
            if (0..3).any(|k| v[k] > hi[k] || v[k] < lo[k]) {
                continue;
            }
            let s = e.dot(&(v - p));
            let apart = p + e * s - v;
            let distance = apart.norm();
            let crossed = |t: &Touch| match &t.feature {
                Feature::LineLine { other, .. } => crossing((&p, &e), (&other.origin, &other.along))
                    .is_some_and(|c| (c.0 - s).abs() < 0.02 * line.radius),
                _ => false,
            };
            if inside(s)
                && !self.out[first..].iter().any(crossed)
                && distance < limit
                && distance > 0.0
                && out_of(&(apart / distance))
                && sticks_out(poly, i as u32, &apart)
            {
                let ball = Ball { center: *v, radius: 0.0 };
                let site = site + (poly.edges.len() + i) as u32;
                self.out.push(Touch::new(site, Feature::BallLine { on: on.other(), ball, line: *line }));
            }
        }
    }
}

impl Pair<'_> {
    /// A capsule whose axis goes through a polyhedron: where it is deepest, out through the nearest face. Site: after
    /// those of edges and vertices.
    pub fn rod_through(&mut self, rod: &Rod, poly: &Poly) {
        let b_from_a = self.a_from_b.inverse();
        let (p, e) = (b_from_a.point(&rod.line.origin), b_from_a.direction(&rod.line.along));
        let (mut from, mut to) = (0.0_f64, rod.length);
        for (n, d) in &poly.planes {
            let (height, slope) = (n.dot(&p) - d, n.dot(&e));
            match slope {
                _ if slope < 0.0 => from = from.max(-height / slope),
                _ if slope > 0.0 => to = to.min(-height / slope),
                _ if height > 0.0 => return,
                _ => {}
            }
        }
        if from >= to {
            return;
        }
        let highest = |s: f64| {
            let x = p + e * s;
            poly.planes.iter().map(|plane| (plane.0.dot(&x) - plane.1, plane)).max_by(|a, b| a.0.total_cmp(&b.0))
        };
        let height = |s: f64| highest(s).map_or(f64::INFINITY, |h| h.0);
        // Convex along the axis.
        let (mut lo, mut hi) = (from, to);
        for _ in 0..40 {
            let (s, t) = (lo + 0.382 * (hi - lo), hi - 0.382 * (hi - lo));
            if height(s) < height(t) { hi = t } else { lo = s }
        }
        let s = 0.5 * (lo + hi);
        if let Some((gap, plane)) = highest(s)
            && gap < 0.0
        {
            let ball = Ball { center: rod.line.origin + rod.line.along * s, radius: rod.line.radius };
            let site = 2 + (poly.edges.len() + poly.vertices.len()) as u32;
            self.out.push(Touch::new(site, Feature::BallPlane { on: rod.on, ball, plane: *plane }));
        }
    }
}

/// A thick segment from the origin of its line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rod {
    pub line: Line,
    pub length: f64,
    pub on: Side,
}

impl Rod {
    pub fn new(ends: &[Vector3<f64>; 2], radius: f64, on: Side) -> Self {
        let (along, length) = unit(&(ends[1] - ends[0]));
        Self { line: Line { origin: ends[0], along, radius }, length, on }
    }
}

/// Whether a unit normal across an edge is between the normals of its faces, or nearly so.
pub(super) fn in_cone(poly: &Poly, edge: &Edge, n: &Vector3<f64>) -> bool {
    let [n1, n2] = edge.faces.map(|f| poly.planes[f as usize].0);
    n.dot(&edge.along.cross(&n1)) > -OUTSIDE_CONE && n.dot(&n2.cross(&edge.along)) > -OUTSIDE_CONE
}

/// Whether no edge at a vertex leads (more than hardly) in the direction d.
fn sticks_out(poly: &Poly, vertex: u32, d: &Vector3<f64>) -> bool {
    let v = poly.vertex(vertex);
    let limit = OUTSIDE_CONE * d.norm();
    poly.faces_at(vertex).iter().all(|&f| {
        let sides = poly.sides(f);
        sides.iter().enumerate().filter(|(_, side)| side.vertex == vertex).all(|(k, _)| {
            let edge = poly.vertex(sides[(k + 1) % sides.len()].vertex) - v;
            edge.dot(d) <= limit * edge.norm()
        })
    })
}

/// Where two lines (origin, unit direction) are nearest to each other, as lengths along them; `None` if parallel.
pub(super) fn crossing(
    (x, e): (&Vector3<f64>, &Vector3<f64>),
    (y, f): (&Vector3<f64>, &Vector3<f64>),
) -> Option<(f64, f64)> {
    let square = e.cross(f).norm_squared();
    if square < PARALLEL * PARALLEL {
        return None;
    }
    let w = x - y;
    let (ef, ew, fw) = (e.dot(f), e.dot(&w), f.dot(&w));
    Some(((ef * fw - ew) / square, (fw - ef * ew) / square))
}
