//! A push of one second: plain numbers and dual numbers with one to four tangents.
#![allow(clippy::unwrap_used, missing_docs)] // a benchmark may panic; criterion's macros make undocumented items

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, ConvexPiece, ForcePoint, Model, Part, Scalar, Scene, State, parameter, rollout,
};
use nalgebra::{Matrix3, Point3, RealField, Vector3};

fn shape() -> Arc<Collider> {
    let half = Vector3::new(0.03, 0.03, 0.04);
    let corner =
        |i: usize| Point3::from(half.component_mul(&Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -1.0 } else { 1.0 })));
    Arc::new(Collider::convex(vec![ConvexPiece::from_points(&(0..8).map(corner).collect::<Vec<_>>()).unwrap()]))
}

fn push<T: Scalar + RealField>(shape: &Arc<Collider>, log_mass: T, friction: T) -> T {
    let unit = MassProperties {
        mass_kg: 1.0,
        center_of_mass: Point3::origin(),
        inertia: Matrix3::from_diagonal(&Vector3::new(8.3e-4, 8.3e-4, 6e-4)),
    };
    let model = Model::new(vec![Body::new(&unit, log_mass.exp(), Arc::clone(shape))]);
    let mut scene = Scene::on_table(friction);
    let at = ForcePoint::Body(Point3::new(-0.03, 0.0, -0.03));
    scene
        .forces
        .push(AppliedForce::new(Part::Body(0), &[0.1, 0.3], &[Vector3::x() * 1.6, Vector3::zeros()], at).unwrap());
    let start = State::at_rest(Pose::from_parts(
        Vector3::new(T::zero(), T::zero(), T::lift(0.04)).into(),
        nalgebra::UnitQuaternion::identity(),
    ));
    rollout(&model, &scene, &start, &[1.0]).unwrap().bodies[0].poses[0].translation.vector.x
}

fn duals<const N: usize>(c: &mut Criterion, shape: &Arc<Collider>) {
    c.bench_function(&format!("push of 1 s, dual numbers, {N} tangents"), |b| {
        b.iter(|| push(shape, black_box(parameter::<N>(0.2_f64.ln(), 0)), parameter::<N>(0.45, N - 1)));
    });
}

fn bench(c: &mut Criterion) {
    let shape = shape();
    c.bench_function("push of 1 s, plain", |b| b.iter(|| push(&shape, black_box(0.2_f64.ln()), 0.45)));
    duals::<1>(c, &shape);
    duals::<2>(c, &shape);
    duals::<3>(c, &shape);
    duals::<4>(c, &shape);
}

criterion_group!(benches, bench);
criterion_main!(benches);
