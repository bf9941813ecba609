//! What the search finds, against formulas, brute force and finite differences.

mod cylinders;
mod derivatives;
mod polys;
mod round;
mod solids;
mod speed;

use drex_core::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::*;
use crate::{ConvexPolyhedron, Scalar};

pub(super) type V = Vector3<f64>;

pub(super) fn geom(shape: &Shape) -> CollisionGeom {
    CollisionGeom::new(shape, &Pose::identity()).unwrap()
}

pub(super) fn cuboid(x: f64, y: f64, z: f64) -> Shape {
    Shape::Box { half_m: V::new(x, y, z) }
}

pub(super) fn at(x: f64, y: f64, z: f64) -> Pose {
    Pose::translation(x, y, z)
}

pub(super) fn turned(p: V, r: V) -> Pose {
    Pose::from_parts(Translation3::from(p), UnitQuaternion::from_scaled_axis(r))
}

/// A rounded lump of `n` corners, the same for the same n.
pub(super) fn lump(n: usize) -> Shape {
    let s = |k: usize, a: f64| (k as f64 * a.sqrt()).fract() - 0.5;
    let points: Vec<Point3<f64>> = (1..=n)
        .map(|k| {
            let v = V::new(s(k, 2.0), s(k, 3.0), s(k, 5.0)).normalize();
            Point3::from(v.component_mul(&V::new(0.04, 0.03, 0.02)))
        })
        .collect();
    Shape::Convex(std::sync::Arc::new(ConvexPolyhedron::from_points(&points).unwrap()))
}

impl Touch {
    fn at_poses<T: Scalar>(&self, world_from_a: &Pose<T>, world_from_b: &Pose<T>) -> Place<T> {
        self.evaluate(&Frame::of(world_from_a), &Frame::of(world_from_b))
    }
}

fn find(
    a: &CollisionGeom,
    world_from_a: &Pose,
    b: &CollisionGeom,
    world_from_b: &Pose,
    margin: f64,
    work: &mut CollideWork,
    out: &mut Vec<Touch>,
) {
    super::find(a, &Frame::of(world_from_a), b, &Frame::of(world_from_b), margin, work, out);
}

/// The deepest penetration of two geoms, metres; `None` if they do not touch.
fn deepest(
    a: &CollisionGeom,
    world_from_a: &Pose,
    b: &CollisionGeom,
    world_from_b: &Pose,
    work: &mut CollideWork,
) -> Option<f64> {
    let mut touches = Vec::new();
    find(a, world_from_a, b, world_from_b, 0.0, work, &mut touches);
    touches.iter().map(|t| t.at_poses(world_from_a, world_from_b).depth).max_by(f64::total_cmp)
}

pub(super) fn touches(a: &Shape, pa: &Pose, b: &Shape, pb: &Pose, margin: f64) -> Vec<Touch> {
    let mut out = Vec::new();
    find(&geom(a), pa, &geom(b), pb, margin, &mut CollideWork::default(), &mut out);
    assert!(out.windows(2).all(|w| w[0].site < w[1].site), "sorted, no site twice");
    out
}

pub(super) fn places(a: &Shape, pa: &Pose, b: &Shape, pb: &Pose, margin: f64) -> Vec<Place<f64>> {
    touches(a, pa, b, pb, margin).iter().map(|t| t.at_poses(pa, pb)).collect()
}

pub(super) fn deepest_place(places: &[Place<f64>]) -> Option<Place<f64>> {
    places.iter().max_by(|a, b| a.depth.total_cmp(&b.depth)).copied()
}

/// Any rotation, and translations in a box.
pub(super) fn any_pose(size: f64) -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(-size..=size), prop::array::uniform3(-2.0..2.0))
        .prop_map(|(p, r)| turned(V::from(p), V::from(r)))
}

pub(super) fn any_direction() -> impl Strategy<Value = V> {
    prop::array::uniform3(-1.0..1.0)
        .prop_filter_map("a direction", |v| Some(V::from(v)).filter(|v| v.norm() > 0.1).map(|v| v.normalize()))
}

/// One shape of every kind that has a volume.
pub(super) fn any_solid() -> impl Strategy<Value = Shape> {
    prop_oneof![
        Just(Shape::Sphere { radius_m: 0.03 }),
        Just(Shape::Capsule { radius_m: 0.012, half_length_m: 0.04 }),
        Just(Shape::Cylinder { radius_m: 0.02, half_length_m: 0.035 }),
        Just(cuboid(0.02, 0.03, 0.045)),
        Just(cuboid(0.1, 0.008, 0.01)),
        Just(lump(14)),
        Just(lump(120)),
    ]
}

/// A polyhedron.
pub(super) fn any_poly() -> impl Strategy<Value = Shape> {
    prop_oneof![Just(cuboid(0.02, 0.03, 0.045)), Just(cuboid(0.1, 0.008, 0.01)), Just(lump(14)), Just(lump(120))]
}

/// Moves b along `u` from far away until it is `depth` inside a.
pub(super) fn brought_together(a: &Shape, pa: &Pose, b: &Shape, turn: &Pose, u: &V, depth: f64) -> Pose {
    let (ga, gb) = (geom(a), geom(b));
    let placed = |s: f64| {
        let mut p = *turn;
        p.translation.vector = pa.translation.vector + u * s;
        p
    };
    let (mut near, mut far) = (0.0, 0.5);
    let mut work = CollideWork::default();
    for _ in 0..60 {
        let middle = 0.5 * (near + far);
        match deepest(&ga, pa, &gb, &placed(middle), &mut work) {
            Some(d) if d > depth => near = middle,
            _ => far = middle,
        }
    }
    placed(near)
}
