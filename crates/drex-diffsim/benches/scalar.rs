//! A push of 600 steps on plain numbers, on our dual numbers and on those of num-dual, with one to four tangents.
//! Run with `cargo bench -p drex-diffsim --features num-dual --bench scalar`.
#![allow(clippy::unwrap_used, missing_docs)] // a benchmark may panic; criterion's macros make undocumented items

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, ConvexPolyhedron, Dual, ForcePoint, Model, Part, Scalar, Scene, State, rollout,
};
use nalgebra::{ComplexField, Matrix3, Point3, UnitQuaternion, Vector3};
use num_dual::DualSVec64;

fn shape() -> Arc<Collider> {
    let half = Vector3::new(0.03, 0.03, 0.04);
    let corner =
        |i: usize| Point3::from(half.component_mul(&Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -1.0 } else { 1.0 })));
    Arc::new(Collider::convex(vec![ConvexPolyhedron::from_points(&(0..8).map(corner).collect::<Vec<_>>()).unwrap()]))
}

/// Final x of a block that is pushed and slides to rest. As many of ln m, friction, the centre of mass and the start
/// pose are parameters as `T` has tangents.
fn push<T: Scalar>(shape: &Arc<Collider>, values: [f64; 4]) -> T {
    let at = |k: usize| T::with_tangents(values[k], |i| f64::from(u8::from(i == k)));
    let unit = MassProperties {
        mass_kg: 1.0,
        center_of_mass: Point3::origin(),
        inertia: Matrix3::from_diagonal(&Vector3::new(8.3e-4, 8.3e-4, 6e-4)),
    };
    let mut body = Body::new(&unit, ComplexField::exp(at(0)), Arc::clone(shape));
    body.center_of_mass.x += at(2);
    let model = Model::new(vec![body]);
    let mut scene = Scene::on_table(at(1));
    let point = ForcePoint::Body(Point3::new(-0.03, 0.0, -0.03));
    scene
        .forces
        .push(AppliedForce::new(Part::Body(0), &[0.05, 0.2], &[Vector3::x() * 1.6, Vector3::zeros()], point).unwrap());
    let position = Vector3::new(at(3), T::zero(), T::lift(0.04));
    let start = State::at_rest(Pose::from_parts(position.into(), UnitQuaternion::identity()));
    rollout(&model, &scene, &start, &[0.3]).unwrap().bodies[0].poses[0].translation.vector.x
}

fn one<T: Scalar>(c: &mut Criterion, name: &str, shape: &Arc<Collider>) {
    let values = [0.2_f64.ln(), 0.45, 0.001, 0.0];
    c.bench_function(&format!("push of 600 steps, {name}"), |b| b.iter(|| push::<T>(shape, black_box(values))));
}

fn bench(c: &mut Criterion) {
    let shape = shape();
    one::<f64>(c, "f64", &shape);
    one::<Dual<1>>(c, "Dual<1>", &shape);
    one::<DualSVec64<1>>(c, "num-dual 1", &shape);
    one::<Dual<2>>(c, "Dual<2>", &shape);
    one::<DualSVec64<2>>(c, "num-dual 2", &shape);
    one::<Dual<4>>(c, "Dual<4>", &shape);
    one::<DualSVec64<4>>(c, "num-dual 4", &shape);
}

criterion_group!(benches, bench);
criterion_main!(benches);
