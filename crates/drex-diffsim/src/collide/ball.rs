//! A ball or vertex against a shape: signed distance, and the feature that is nearest.

use nalgebra::Vector3;

use super::Pair;
use super::feature::{Ball, Feature, Line, Plane, Side, Touch};
use super::geom::{Cylinder, Kind, Poly};
use crate::SdfShape;

/// The nearest feature of a shape.
#[derive(Debug, Clone, Copy)]
pub(super) enum Target {
    Plane(Plane),
    Line(Line),
    Ball(Ball),
    Rim(Line),
}

impl Target {
    /// An edge or corner: a point beside it has no steady normal.
    pub fn is_sharp(&self) -> bool {
        match self {
            Self::Plane(_) => false,
            Self::Rim(_) => true,
            Self::Line(line) => line.radius <= 0.0,
            Self::Ball(ball) => ball.radius <= 0.0,
        }
    }

    pub fn feature(self, on: Side, ball: Ball) -> Feature {
        match self {
            Self::Plane(plane) => Feature::BallPlane { on, ball, plane },
            Self::Line(line) => Feature::BallLine { on, ball, line },
            Self::Ball(other) => Feature::BallBall { on, ball, other },
            Self::Rim(axis) => Feature::BallRim { on, ball, axis },
        }
    }
}

impl Pair<'_> {
    /// A ball on the body `on` against `other`, a shape of the other body.
    pub fn ball(&mut self, on: Side, center: &Vector3<f64>, radius: f64, other: &Kind, site: u32) {
        let x = match on {
            Side::A => self.a_from_b.r.tr_mul(&(center - self.a_from_b.p)),
            Side::B => self.a_from_b.point(center),
        };
        if let Kind::Sdf { sdf, shape_from_body } = other {
            let gap = distance_within(sdf, &shape_from_body.point(&x), radius + self.margin);
            if gap.is_some_and(|gap| gap < radius + self.margin) {
                let ball = Ball { center: *center, radius };
                let feature = Feature::BallSdf { on, ball, sdf: sdf.clone(), shape_from_body: *shape_from_body };
                self.out.push(Touch::new(site, feature));
            }
        } else if let Some((distance, target)) = nearest(other, &x, radius + self.margin)
            && distance < radius + self.margin
        {
            self.out.push(Touch::new(site, target.feature(on, Ball { center: *center, radius })));
        }
    }

    /// The vertices of a polyhedron below a plane.
    pub fn plane_poly(&mut self, plane: &Plane, poly: &Poly) {
        let (n, d) = self.a_from_b.inverse().plane(plane);
        for (i, v) in poly.vertices.iter().enumerate() {
            if n.dot(v) - d < self.margin {
                let ball = Ball { center: *v, radius: 0.0 };
                let feature = Feature::BallPlane { on: Side::B, ball, plane: *plane };
                self.out.push(Touch { weight: poly.weights[i], ..Touch::new(i as u32, feature) });
            }
        }
    }
}

/// Signed distance of a shape at x (both in the frame of its body) and the feature that has it. `None` if it is more
/// than `limit`, or for a shape without features.
pub(super) fn nearest(kind: &Kind, x: &Vector3<f64>, limit: f64) -> Option<(f64, Target)> {
    match kind {
        Kind::Plane((n, d)) => Some((n.dot(x) - d, Target::Plane((*n, *d)))),
        Kind::Sphere { center, radius } => {
            Some(((x - center).norm() - radius, Target::Ball(Ball { center: *center, radius: *radius })))
        }
        Kind::Capsule { ends, radius } => {
            let (along, length) = unit(&(ends[1] - ends[0]));
            let s = along.dot(&(x - ends[0])).clamp(0.0, length);
            let foot = ends[0] + along * s;
            let target = if s <= 0.0 || s >= length {
                Target::Ball(Ball { center: foot, radius: *radius })
            } else {
                Target::Line(Line { origin: ends[0], along, radius: *radius })
            };
            Some(((x - foot).norm() - radius, target))
        }
        Kind::Cylinder(cylinder) => Some(nearest_of_cylinder(cylinder, x)),
        Kind::Poly(poly) => nearest_of_poly(poly, x, limit),
        _ => None,
    }
}

/// Signed distance of a solid at a point of its frame; `None` if its bounding box is farther than `limit`. The solid is
/// not asked about points outside its box by more than that: there a grid may be slow or have no answer.
pub(super) fn distance_within(sdf: &SdfShape, x: &Vector3<f64>, limit: f64) -> Option<f64> {
    let (lo, hi) = sdf.bounds();
    let outside = (lo.coords - x).sup(&(x - hi.coords)).sup(&Vector3::zeros()).norm();
    (outside <= limit).then(|| sdf.sample(&(*x).into()).distance_m)
}

pub(super) fn unit(v: &Vector3<f64>) -> (Vector3<f64>, f64) {
    let length = v.norm();
    if length > 0.0 { (v / length, length) } else { (Vector3::z(), 0.0) }
}

/// Inside: side or end, whichever is nearer.
fn nearest_of_cylinder(c: &Cylinder, x: &Vector3<f64>) -> (f64, Target) {
    let w = x - c.center;
    let s = w.dot(&c.axis);
    let beside = (w - c.axis * s).norm() - c.radius;
    let above = s.abs() - c.half_length;
    let end = c.axis * 1.0_f64.copysign(s);
    let line = Line { origin: c.center, along: c.axis, radius: c.radius };
    if beside > 0.0 && above > 0.0 {
        let rim = Line { origin: c.center + end * c.half_length, ..line };
        (beside.hypot(above), Target::Rim(rim))
    } else if above > beside {
        (above, Target::Plane((end, end.dot(&c.center) + c.half_length)))
    } else {
        (beside, Target::Line(line))
    }
}

/// A feature of a polyhedron.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Spot {
    Face(u32),
    Edge(u32),
    Vertex(u32),
}

/// Inside: the face of least penetration. Outside: walks from the face that x is farthest in front of to the nearest
/// feature. What is nearest among its neighbours is nearest of all, for the polyhedron is convex.
fn nearest_of_poly(poly: &Poly, x: &Vector3<f64>, limit: f64) -> Option<(f64, Target)> {
    let mut best = (f64::NEG_INFINITY, 0);
    for (f, (n, d)) in poly.planes.iter().enumerate() {
        let distance = n.dot(x) - d;
        if distance > best.0 {
            best = (distance, f);
            if distance > limit {
                return None;
            }
        }
    }
    let (distance, face) = best;
    let plane = Target::Plane(poly.planes[face]);
    // Too near for a difference of points to have a direction.
    if distance < 1e-9 * poly.half.max() {
        return Some((distance, plane));
    }
    let (mut square, mut spot) = nearest_of_face(poly, face as u32, x);
    loop {
        let around = match spot {
            Spot::Face(_) => &[][..],
            Spot::Edge(e) => &poly.edges[e as usize].faces[..],
            Spot::Vertex(v) => poly.faces_at(v),
        };
        let next = around.iter().map(|&f| nearest_of_face(poly, f, x)).min_by(|a, b| a.0.total_cmp(&b.0));
        match next {
            Some(nearer) if nearer.0 < square * (1.0 - 1e-12) => (square, spot) = nearer,
            _ => break,
        }
    }
    let target = match spot {
        Spot::Face(f) => Target::Plane(poly.planes[f as usize]),
        Spot::Edge(e) => {
            let edge = &poly.edges[e as usize];
            Target::Line(Line { origin: *poly.vertex(edge.ends[0]), along: edge.along, radius: 0.0 })
        }
        Spot::Vertex(v) => Target::Ball(Ball { center: *poly.vertex(v), radius: 0.0 }),
    };
    Some((square.sqrt(), target))
}

/// Squared distance of x from a face, and its feature that is nearest.
fn nearest_of_face(poly: &Poly, face: u32, x: &Vector3<f64>) -> (f64, Spot) {
    let sides = poly.sides(face);
    let mut best = (f64::INFINITY, Spot::Face(face));
    for (i, side) in sides.iter().enumerate() {
        if side.cut.0.dot(x) <= side.cut.1 {
            continue;
        }
        let next = sides[(i + 1) % sides.len()].vertex;
        let (a, b) = (poly.vertex(side.vertex), poly.vertex(next));
        let (ab, ax) = (b - a, x - a);
        let s = ab.dot(&ax) / ab.norm_squared();
        let found = if s <= 0.0 {
            (ax.norm_squared(), Spot::Vertex(side.vertex))
        } else if s >= 1.0 {
            ((x - b).norm_squared(), Spot::Vertex(next))
        } else {
            ((ax - ab * s).norm_squared(), Spot::Edge(side.edge))
        };
        if found.0 < best.0 {
            best = found;
        }
    }
    if best.0 == f64::INFINITY {
        let (n, d) = &poly.planes[face as usize];
        best.0 = (n.dot(x) - d).powi(2);
    }
    best
}
