//! The pair of features that carries a contact, and what it says with derivatives.

use std::sync::Arc;

use drex_core::Pose;
use nalgebra::{Matrix3, Point3, Vector3};

use crate::math::apply_constant;
use crate::{Scalar, SdfShape};

/// A pose as a matrix: maps points of a body into the world (or of one body into the frame of another).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Frame<T> {
    pub r: Matrix3<T>,
    pub p: Vector3<T>,
}

impl<T: Scalar> Frame<T> {
    pub fn of(pose: &Pose<T>) -> Self {
        Self { r: pose.rotation.to_rotation_matrix().into_inner(), p: pose.translation.vector }
    }

    /// The same without derivatives.
    pub fn value(&self) -> Frame<f64> {
        Frame { r: self.r.map(|x| x.value()), p: self.p.map(|x| x.value()) }
    }

    pub fn point(&self, x: &Vector3<f64>) -> Vector3<T> {
        self.direction(x) + self.p
    }

    pub fn direction(&self, x: &Vector3<f64>) -> Vector3<T> {
        apply_constant(&self.r, x)
    }

    /// n and d of the plane n·x = d.
    pub fn plane(&self, (n, d): &(Vector3<f64>, f64)) -> (Vector3<T>, T) {
        let n = self.direction(n);
        (n, n.dot(&self.p) + T::lift(*d))
    }
}

impl Frame<f64> {
    /// The frame `c_from_b` of `c_from_a` (self) and `a_from_b`.
    pub fn then(&self, other: &Self) -> Self {
        Self { r: self.r * other.r, p: self.r * other.p + self.p }
    }

    pub fn inverse(&self) -> Self {
        let r = self.r.transpose();
        Self { r, p: -(r * self.p) }
    }
}

/// One of the two bodies of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    A,
    B,
}

impl Side {
    pub fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

/// A ball about a point of a body; radius zero for a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ball {
    pub center: Vector3<f64>,
    pub radius: f64,
}

/// A line of a body, thickened by a radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Line {
    pub origin: Vector3<f64>,
    /// Of unit length.
    pub along: Vector3<f64>,
    pub radius: f64,
}

/// A plane of a body: unit normal n out of it, and d of n·x = d.
pub(crate) type Plane = (Vector3<f64>, f64);

/// The pair of features that carries a contact. `on` is the body that has the first of them; the second is on the other.
/// Everything is in the frame of the body that has it.
#[derive(Debug, Clone)]
pub(crate) enum Feature {
    /// A ball or vertex in front of a face.
    BallPlane { on: Side, ball: Ball, plane: Plane },
    /// Where a line passes `cut`, a side of the face `plane` (both on the other body), in front of that face.
    LineCut { on: Side, line: Line, cut: Plane, plane: Plane },
    /// Two lines that cross. The normal, from the other body towards `on`, is `sign` times the cross product of `line`
    /// and `other`.
    LineLine { on: Side, line: Line, other: Line, sign: f64 },
    /// A ball beside a line.
    BallLine { on: Side, ball: Ball, line: Line },
    /// A ball beside a ball.
    BallBall { on: Side, ball: Ball, other: Ball },
    /// A ball beside a circle about `axis`, the rim of a cylinder (`axis.radius` is the circle's).
    BallRim { on: Side, ball: Ball, axis: Line },
    /// A thick line beside a circle about `axis`; they are nearest about `at` metres from the line's origin.
    LineRim { on: Side, line: Line, axis: Line, at: f64 },
    /// The point of a circle about `axis` that lies lowest over a plane.
    RimPlane { on: Side, axis: Line, plane: Plane },
    /// A ball at a solid given by signed distance.
    BallSdf { on: Side, ball: Ball, sdf: Arc<SdfShape>, shape_from_body: Frame<f64> },
}

/// One place where two geoms touch or nearly do.
#[derive(Debug, Clone)]
pub(crate) struct Touch {
    /// Which pair of features it is; the same from step to step.
    pub site: u32,
    /// One, or the area in m² that a surface point stands for.
    pub weight: f64,
    pub feature: Feature,
}

/// A contact with derivatives, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place<T> {
    /// Half way between the two surfaces, metres.
    pub point: Vector3<T>,
    /// From b towards a, of unit length.
    pub normal: Vector3<T>,
    /// Penetration, metres; negative for a gap.
    pub depth: T,
}

impl Touch {
    pub fn new(site: u32, feature: Feature) -> Self {
        Self { site, weight: 1.0, feature }
    }

    /// Where the two features are when the bodies are at these frames, with derivatives.
    pub fn evaluate<T: Scalar>(&self, world_from_a: &Frame<T>, world_from_b: &Frame<T>) -> Place<T> {
        let on = self.feature.on();
        let (here, there) = match on {
            Side::A => (world_from_a, world_from_b),
            Side::B => (world_from_b, world_from_a),
        };
        let place = self.feature.place(here, there);
        match on {
            Side::A => place,
            Side::B => Place { normal: -place.normal, ..place },
        }
    }
}

impl Feature {
    pub fn on(&self) -> Side {
        *self.on_ref()
    }

    /// The same with the bodies called by each other's names.
    pub fn flip(&mut self) {
        let on = self.on_mut();
        *on = on.other();
    }

    /// With the normal from `there` to `here`.
    fn place<T: Scalar>(&self, here: &Frame<T>, there: &Frame<T>) -> Place<T> {
        let half = T::lift(0.5);
        // A ball at x in front of a plane.
        let over = |x: Vector3<T>, radius: T, n: Vector3<T>, d: T| {
            let gap = n.dot(&x) - d;
            Place { point: x - n * ((gap + radius) * half), normal: n, depth: radius - gap }
        };
        // A ball at x beside a ball at y.
        let beside = |x: Vector3<T>, radius: T, y: Vector3<T>, other: T| {
            let (n, gap) = direction(&(x - y));
            Place { point: y + n * ((gap + other - radius) * half), normal: n, depth: radius + other - gap }
        };
        match self {
            Self::BallPlane { ball, plane, .. } => {
                let (n, d) = there.plane(plane);
                over(here.point(&ball.center), T::lift(ball.radius), n, d)
            }
            Self::LineCut { line, cut, plane, .. } => {
                let (n, d) = there.plane(plane);
                let (m, c) = there.plane(cut);
                let (x, e) = (here.point(&line.origin), here.direction(&line.along));
                over(x + e * ((c - m.dot(&x)) / m.dot(&e)), T::lift(line.radius), n, d)
            }
            Self::LineLine { line, other, sign, .. } => {
                let (x, e) = (here.point(&line.origin), here.direction(&line.along));
                let (y, f) = (there.point(&other.origin), there.direction(&other.along));
                let cross = e.cross(&f) * T::lift(*sign);
                let square = cross.norm_squared();
                let n = cross / square.sqrt();
                let w = x - y;
                let (ef, ew, fw) = (e.dot(&f), e.dot(&w), f.dot(&w));
                let (x, y) = (x + e * ((ef * fw - ew) / square), y + f * ((fw - ef * ew) / square));
                let (r, s) = (T::lift(line.radius), T::lift(other.radius));
                let point = (x - n * r + y + n * s) * half;
                Place { point, normal: n, depth: r + s - n.dot(&w) }
            }
            Self::BallLine { ball, line, .. } => {
                let x = here.point(&ball.center);
                let (y, e) = (there.point(&line.origin), there.direction(&line.along));
                beside(x, T::lift(ball.radius), y + e * e.dot(&(x - y)), T::lift(line.radius))
            }
            Self::BallBall { ball, other, .. } => beside(
                here.point(&ball.center),
                T::lift(ball.radius),
                there.point(&other.center),
                T::lift(other.radius),
            ),
            Self::BallRim { ball, axis, .. } => {
                let x = here.point(&ball.center);
                let (c, e) = (there.point(&axis.origin), there.direction(&axis.along));
                let radial = direction(&across(&(x - c), &e)).0;
                beside(x, T::lift(ball.radius), c + radial * T::lift(axis.radius), T::zero())
            }
            Self::LineRim { line, axis, at, .. } => {
                let (x, e) = (here.point(&line.origin), here.direction(&line.along));
                let (c, axial) = (there.point(&axis.origin), there.direction(&axis.along));
                let r = T::lift(axis.radius);
                let x = x + e * T::lift(*at);
                let (radial, distance) = direction(&across(&(x - c), &axial));
                let y = c + radial * r;
                // One step of Newton's method on e·(x - y) = 0 along the line.
                let sideways = across(&e, &axial);
                let turning = across(&sideways, &radial) * (r / distance);
                let x = x - e * (e.dot(&(x - y)) / (T::one() - e.dot(&turning)));
                let y = c + direction(&across(&(x - c), &axial)).0 * r;
                beside(x, T::lift(line.radius), y, T::zero())
            }
            Self::RimPlane { axis, plane, .. } => {
                let (n, d) = there.plane(plane);
                let (c, e) = (here.point(&axis.origin), here.direction(&axis.along));
                let down = direction(&-across(&n, &e)).0;
                over(c + down * T::lift(axis.radius), T::zero(), n, d)
            }
            Self::BallSdf { ball, sdf, shape_from_body, .. } => {
                let x = here.point(&ball.center);
                let (gap, n) = against_sdf(sdf, shape_from_body, &x, there);
                let r = T::lift(ball.radius);
                Place { point: x - n * ((gap + r) * half), normal: n, depth: r - gap }
            }
        }
    }

    fn on_ref(&self) -> &Side {
        match self {
            Self::BallPlane { on, .. }
            | Self::LineCut { on, .. }
            | Self::LineLine { on, .. }
            | Self::BallLine { on, .. }
            | Self::BallBall { on, .. }
            | Self::BallRim { on, .. }
            | Self::LineRim { on, .. }
            | Self::RimPlane { on, .. }
            | Self::BallSdf { on, .. } => on,
        }
    }

    fn on_mut(&mut self) -> &mut Side {
        match self {
            Self::BallPlane { on, .. }
            | Self::LineCut { on, .. }
            | Self::LineLine { on, .. }
            | Self::BallLine { on, .. }
            | Self::BallBall { on, .. }
            | Self::BallRim { on, .. }
            | Self::LineRim { on, .. }
            | Self::RimPlane { on, .. }
            | Self::BallSdf { on, .. } => on,
        }
    }
}

/// Direction and length; z for what has no length, whose derivative would not exist.
fn direction<T: Scalar>(v: &Vector3<T>) -> (Vector3<T>, T) {
    let square = v.norm_squared();
    if square.value() <= 0.0 {
        return (Vector3::new(T::zero(), T::zero(), T::one()), T::zero());
    }
    let length = square.sqrt();
    (v / length, length)
}

/// The part of v that is perpendicular to the unit vector e.
fn across<T: Scalar>(v: &Vector3<T>, e: &Vector3<T>) -> Vector3<T> {
    v - e * v.dot(e)
}

/// Signed distance and world normal at the world point x of a solid on the body `there`. To first order about the value
/// of x: the distance by its gradient, the gradient by central differences.
fn against_sdf<T: Scalar>(
    sdf: &SdfShape,
    shape_from_body: &Frame<f64>,
    x: &Vector3<T>,
    there: &Frame<T>,
) -> (T, Vector3<T>) {
    let lift = |m: &Matrix3<f64>| m.map(T::lift);
    let y = lift(&shape_from_body.r) * there.r.tr_mul(&(x - there.p)) + shape_from_body.p.map(T::lift);
    let at = y.map(|c| c.value());
    let here = sdf.sample(&Point3::from(at));
    let (mut gap, mut n) = (T::lift(here.distance_m), here.gradient.map(T::lift));
    if T::TANGENTS > 0 {
        let moved = y - at.map(T::lift);
        gap += n.dot(&moved);
        let h = 0.1 * sdf.resolution_m();
        for k in 0..3 {
            let step = Vector3::ith(k, h);
            let ahead = sdf.sample(&Point3::from(at + step)).gradient;
            let behind = sdf.sample(&Point3::from(at - step)).gradient;
            n += ((ahead - behind) / (2.0 * h)).map(T::lift) * moved[k];
        }
        n = direction(&n).0;
    }
    (gap, there.r * (lift(&shape_from_body.r.transpose()) * n))
}
