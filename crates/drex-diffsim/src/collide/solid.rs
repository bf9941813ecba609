//! Planes, polyhedra and capsules against a solid given by signed distance. Faces and edges are sampled on lattices fixed
//! to them, as fine as the solid's resolution; parts whose middle is farther from the solid than their size are skipped.

use std::sync::Arc;

use nalgebra::Vector3;

use super::Pair;
use super::ball::{distance_within, unit};
use super::feature::{Ball, Feature, Frame, Plane, Side, Touch};
use super::geom::{Kind, Poly};
use super::points::STEEPEST;
use crate::SdfShape;

/// Lattice points of a plane in each direction from its origin.
const HALF_LATTICE: i64 = 1 << 15;

/// Points `origin + x i + y j` of the body that does not have the solid.
struct Lattice {
    origin: Vector3<f64>,
    x: Vector3<f64>,
    y: Vector3<f64>,
}

/// A solid, and its frame seen from the other body.
struct Solid<'a> {
    sdf: &'a Arc<SdfShape>,
    shape_from_body: &'a Frame<f64>,
    shape_from_other: Frame<f64>,
}

impl Solid<'_> {
    /// Centre and radius of a ball around it, in the frame of the other body.
    fn ball(&self) -> (Vector3<f64>, f64) {
        let (lo, hi) = self.sdf.bounds();
        (self.shape_from_other.inverse().point(&nalgebra::center(&lo, &hi).coords), 0.5 * (hi - lo).norm())
    }
}

impl Pair<'_> {
    fn solid<'s>(&self, sdf: &'s Arc<SdfShape>, shape_from_body: &'s Frame<f64>) -> Solid<'s> {
        Solid { sdf, shape_from_body, shape_from_other: shape_from_body.then(&self.a_from_b.inverse()) }
    }

    /// Sites: lattice points of the plane.
    pub fn plane_sdf(&mut self, (n, d): &Plane, sdf: &Arc<SdfShape>, shape_from_body: &Frame<f64>) {
        let solid = self.solid(sdf, shape_from_body);
        let (x, y) = across(n);
        let h = sdf.resolution_m();
        let (center, radius) = solid.ball();
        let range = |axis: &Vector3<f64>| {
            let middle = axis.dot(&center);
            [middle - radius, middle + radius].map(|s| ((s / h) as i64).clamp(-HALF_LATTICE, HALF_LATTICE - 1))
        };
        let lattice = Lattice { origin: n * *d, x: x * h, y: y * h };
        let site = |i: i64, j: i64| (((i + HALF_LATTICE) << 16) + j + HALF_LATTICE) as u32;
        self.lattice(&lattice, range(&x), range(&y), &solid, &site, |_| true);
    }

    /// Sites: vertices, then lattice points of the edges, then those of the faces.
    pub fn poly_sdf(&mut self, poly: &Poly, sdf: &Arc<SdfShape>, shape_from_body: &Frame<f64>) {
        let solid = self.solid(sdf, shape_from_body);
        let h = sdf.resolution_m();
        for (i, v) in poly.vertices.iter().enumerate() {
            let lattice = Lattice { origin: *v, x: Vector3::zeros(), y: Vector3::zeros() };
            self.lattice(&lattice, [0, 0], [0, 0], &solid, &|_, _| i as u32, |_| true);
        }
        let (center, radius) = solid.ball();
        let mut next = poly.vertices.len() as i64;
        // From 1 on: the ends of edges are vertices.
        let range = |origin: &Vector3<f64>, axis: &Vector3<f64>, count: i64| {
            let middle = axis.dot(&(center - origin));
            [((middle - radius) / h).floor() as i64, ((middle + radius) / h).ceil() as i64].map(|k| k.clamp(1, count))
        };
        for edge in &poly.edges {
            let (v, w) = (poly.vertex(edge.ends[0]), poly.vertex(edge.ends[1]));
            let count = ((w - v).norm() / h).ceil() as i64 - 1;
            if count > 0 {
                let lattice = Lattice { origin: *v, x: edge.along * h, y: Vector3::zeros() };
                let site = |i: i64, _: i64| (next + i) as u32;
                self.lattice(&lattice, range(v, &edge.along, count), [0, 0], &solid, &site, |_| true);
            }
            next += count.max(0) + 1;
        }
        for (f, (n, d)) in poly.planes.iter().enumerate() {
            let sides = poly.sides(f as u32);
            let Some(first) = sides.first() else { continue };
            let (x, y) = across(n);
            let corners = || sides.iter().map(|s| poly.vertex(s.vertex));
            let least = |axis: &Vector3<f64>| corners().map(|c| axis.dot(c)).fold(f64::INFINITY, f64::min);
            let most = |axis: &Vector3<f64>| corners().map(|c| axis.dot(c)).fold(f64::NEG_INFINITY, f64::max);
            let count = |axis: &Vector3<f64>| ((most(axis) - least(axis)) / h).ceil() as i64;
            let (columns, rows) = (count(&x), count(&y));
            let up = n * (d - n.dot(poly.vertex(first.vertex)));
            let origin = poly.vertex(first.vertex) + up;
            let origin = origin + x * (least(&x) - x.dot(&origin)) + y * (least(&y) - y.dot(&origin));
            let reaches = n.dot(&center) - d < radius + self.margin;
            if columns > 0 && rows > 0 && reaches {
                let lattice = Lattice { origin, x: x * h, y: y * h };
                let site = |i: i64, j: i64| (next + i * (rows + 1) + j) as u32;
                let (i, j) = (range(&origin, &x, columns), range(&origin, &y, rows));
                let on_face = |p: &Vector3<f64>| sides.iter().all(|s| s.cut.0.dot(p) < s.cut.1 - 1e-9 * h);
                self.lattice(&lattice, i, j, &solid, &site, on_face);
            }
            next += (columns.max(0) + 1) * (rows.max(0) + 1);
        }
    }

    /// All points of a part of a lattice that are less than the margin outside the solid.
    fn lattice(
        &mut self,
        lattice: &Lattice,
        columns: [i64; 2],
        rows: [i64; 2],
        solid: &Solid<'_>,
        site: &impl Fn(i64, i64) -> u32,
        on_face: impl Fn(&Vector3<f64>) -> bool,
    ) {
        // Parts still to look at. Each is split into two at most, so the stack is as deep as the sizes have bits.
        let mut parts = [[0; 4]; 80];
        parts[0] = [columns[0], columns[1], rows[0], rows[1]];
        let mut depth = usize::from(columns[0] <= columns[1] && rows[0] <= rows[1]);
        while depth > 0 {
            depth -= 1;
            let [i0, i1, j0, j1] = parts[depth];
            let middle = lattice.origin + lattice.x * (0.5 * (i0 + i1) as f64) + lattice.y * (0.5 * (j0 + j1) as f64);
            let reach = 0.5 * (lattice.x * (i1 - i0) as f64 + lattice.y * (j1 - j0) as f64).norm();
            let at = solid.shape_from_other.point(&middle);
            let Some(gap) = distance_within(solid.sdf, &at, reach + self.margin) else { continue };
            if gap > STEEPEST * reach + self.margin {
                continue;
            }
            if i0 == i1 && j0 == j1 {
                if gap < self.margin && on_face(&middle) {
                    let ball = Ball { center: middle, radius: 0.0 };
                    let (sdf, shape_from_body) = (solid.sdf.clone(), *solid.shape_from_body);
                    let feature = Feature::BallSdf { on: Side::A, ball, sdf, shape_from_body };
                    self.out.push(Touch::new(site(i0, j0), feature));
                }
                continue;
            }
            let [low, high] = if i1 - i0 >= j1 - j0 {
                let half = (i0 + i1).div_euclid(2);
                [[i0, half, j0, j1], [half + 1, i1, j0, j1]]
            } else {
                let half = (j0 + j1).div_euclid(2);
                [[i0, i1, j0, half], [i0, i1, half + 1, j1]]
            };
            if depth + 2 <= parts.len() {
                parts[depth] = high;
                parts[depth + 1] = low;
                depth += 2;
            }
        }
    }

    /// The middle of a capsule: where its axis is nearest to the solid, and nearer than beside. Sites: from 2 on, the
    /// sample it was found from.
    pub fn capsule_sdf(&mut self, ends: &[Vector3<f64>; 2], radius: f64, kind: &Kind) {
        let Kind::Sdf { sdf, shape_from_body } = kind else { return };
        let solid = self.solid(sdf, shape_from_body);
        let (along, length) = unit(&(ends[1] - ends[0]));
        let samples = (length / sdf.resolution_m().max(0.25 * radius)).ceil().clamp(2.0, 256.0) as u32;
        let step = length / f64::from(samples);
        let limit = radius + self.margin;
        let distance = |s: f64| {
            let x = solid.shape_from_other.point(&(ends[0] + along * s));
            distance_within(solid.sdf, &x, limit + step).unwrap_or(f64::INFINITY)
        };
        let mut before = [distance(0.0), distance(step)];
        for k in 1..samples {
            let after = distance(step * f64::from(k + 1));
            let [left, here] = before;
            before = [here, after];
            // Strictly nearer than one neighbour: a capsule flat on the solid touches with its ends.
            if here > left || here > after || (here == left && here == after) || here > limit + step {
                continue;
            }
            let middle = step * f64::from(k);
            let (mut lo, mut hi) = (middle - step, middle + step);
            for _ in 0..30 {
                let (s, t) = (lo + 0.382 * (hi - lo), hi - 0.382 * (hi - lo));
                if distance(s) < distance(t) { hi = t } else { lo = s }
            }
            let s = 0.5 * (lo + hi);
            if distance(s) < limit && s > 1e-6 * radius && s < length - 1e-6 * radius {
                let ball = Ball { center: ends[0] + along * s, radius };
                let (sdf, shape_from_body) = (sdf.clone(), *shape_from_body);
                let feature = Feature::BallSdf { on: Side::A, ball, sdf, shape_from_body };
                self.out.push(Touch::new(2 + k, feature));
            }
        }
    }
}

/// Two directions across a unit vector.
fn across(n: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let x = Vector3::ith(n.iamin(), 1.0).cross(n).normalize();
    (x, n.cross(&x))
}
