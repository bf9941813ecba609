//! The middle of a capsule against other capsules and the edges of polyhedra. Its ends are balls.

use nalgebra::Vector3;

use super::Pair;
use super::ball::unit;
use super::feature::{Ball, Feature, Line, Plane, Side, Touch};
use super::geom::{Kind, Poly};

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
        let (line, length) = capsule_line(a, radius);
        let (other, other_length) = capsule_line(b, other_radius);
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

    /// Sites: 0 and 1 are the ends (not found here), then the edges of the polyhedron, then its vertices.
    pub fn capsule_poly(&mut self, ends: &[Vector3<f64>; 2], radius: f64, poly: &Poly) {
        let b_from_a = self.a_from_b.inverse();
        let (line, length) = capsule_line(ends, radius);
        let (p, e) = (b_from_a.point(&line.origin), b_from_a.direction(&line.along));
        let q = p + e * length;
        let limit = radius + self.margin;
        let (lo, hi) = (p.inf(&q).add_scalar(-limit), p.sup(&q).add_scalar(limit));
        let inside = |s: f64| s > 1e-6 * radius && s < length - 1e-6 * radius;
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
            let in_cone =
                n.dot(&edge.along.cross(&n1)) > -OUTSIDE_CONE && n.dot(&n2.cross(&edge.along)) > -OUTSIDE_CONE;
            // Behind the edge, but out of the polyhedron again on its far side.
            let beyond = |(m, d): &Plane| m.dot(&(p + e * s)) - d > OUTSIDE_CONE * gap.abs();
            if gap < limit && in_cone && (gap >= 0.0 || !poly.planes.iter().any(beyond)) {
                let other = Line { origin: *v, along: edge.along, radius: 0.0 };
                self.out.push(Touch::new(2 + i as u32, Feature::LineLine { on: Side::A, line, other, sign }));
                if best.is_none_or(|(g, _)| gap > g) {
                    best = Some((gap, n));
                }
            }
        }
        // A capsule deep inside crosses edges on the far side as well.
        if let Some((_, n)) = best {
            let mut i = first;
            while i < self.out.len() {
                let keep = match &self.out[i].feature {
                    Feature::LineLine { other, sign, .. } => e.cross(&other.along).dot(&n) * sign > 0.0,
                    _ => true,
                };
                if keep { i += 1 } else { drop(self.out.remove(i)) }
            }
        }
        for (i, v) in poly.vertices.iter().enumerate() {
            if (0..3).any(|k| v[k] > hi[k] || v[k] < lo[k]) {
                continue;
            }
            let s = e.dot(&(v - p));
            let apart = p + e * s - v;
            let sticks_out = |f: &u32| {
                let sides = poly.sides(*f);
                sides.iter().enumerate().filter(|(_, side)| side.vertex == i as u32).all(|(k, _)| {
                    let next = poly.vertex(sides[(k + 1) % sides.len()].vertex);
                    (next - v).dot(&apart) <= 0.0
                })
            };
            if inside(s) && apart.norm() < limit && apart.norm() > 0.0 && poly.faces_at(i as u32).iter().all(sticks_out)
            {
                let ball = Ball { center: *v, radius: 0.0 };
                let site = 2 + (poly.edges.len() + i) as u32;
                self.out.push(Touch::new(site, Feature::BallLine { on: Side::B, ball, line }));
            }
        }
    }
}

fn capsule_line(ends: &[Vector3<f64>; 2], radius: f64) -> (Line, f64) {
    let (along, length) = unit(&(ends[1] - ends[0]));
    (Line { origin: ends[0], along, radius }, length)
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
