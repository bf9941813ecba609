//! What a step costs: a body in the air and on a table, derivatives, fine meshes, a hand that holds, batches.
#![allow(clippy::unwrap_used, missing_docs)] // a benchmark may panic; criterion's macros make undocumented items

use std::f64::consts::{PI, TAU};
use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Base, Body, Collider, ConvexPolyhedron, Dual, ForcePoint, Geom, Job, Model, Part, Scalar, Scene,
    Shape, State, Workspace, parameter, rollout, rollout_batch, step,
};
use nalgebra::{Matrix3, Point3, RealField, UnitQuaternion, Vector3};

#[path = "../examples/pick.rs"]
#[allow(dead_code)] // it has a main of its own
mod pick;

const HALF: Vector3<f64> = Vector3::new(0.03, 0.03, 0.04);

fn unit() -> MassProperties {
    let inertia = Matrix3::from_diagonal(&Vector3::new(8.3e-4, 8.3e-4, 6e-4));
    MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia }
}

/// A box with rounded sides as a mesh of about `n` vertices would have it, standing on a flat face.
fn rounded(n: usize) -> Arc<Collider> {
    let rows = (n as f64 / 2.0).sqrt() as usize;
    let power = |x: f64| x.signum() * x.abs().powf(0.25);
    let points: Vec<Point3<f64>> = (0..=rows)
        .flat_map(|i| {
            let (s, c) = (PI * i as f64 / rows as f64).sin_cos();
            (0..2 * rows).map(move |j| {
                let (y, x) = (TAU * j as f64 / (2 * rows) as f64).sin_cos();
                let p = Vector3::new(power(s) * power(x), power(s) * power(y), power(c));
                Point3::from(HALF.component_mul(&p))
            })
        })
        .collect();
    Arc::new(Collider::convex(vec![ConvexPolyhedron::from_points(&points).unwrap()]))
}

fn block() -> Arc<Collider> {
    Arc::new(Collider::new(&[Geom::new(Shape::Box { half_m: HALF })]).unwrap())
}

/// A block is pushed for 0.15 s and slides to rest. Parameters: ln m, friction, centre of mass, start.
fn scene<T: Scalar + RealField>(shape: &Arc<Collider>, p: [T; 4]) -> (Model<T>, Scene<T>, State<T>) {
    let mut body = Body::new(&unit(), p[0].exp(), Arc::clone(shape));
    body.center_of_mass.x += p[2];
    let mut scene = Scene::on_table(p[1]);
    let at = ForcePoint::Body(Point3::new(-0.03, 0.0, -0.03));
    let force = [Vector3::x() * 1.6, Vector3::zeros()];
    scene.forces.push(AppliedForce::new(Part::Body(0), &[0.05, 0.2], &force, at).unwrap());
    let position = Vector3::new(p[3], T::zero(), T::lift(HALF.z));
    (Model::new(vec![body]), scene, State::at_rest(Pose::from_parts(position.into(), UnitQuaternion::identity())))
}

fn push<T: Scalar + RealField>(shape: &Arc<Collider>, p: [T; 4]) -> T {
    let (model, scene, start) = scene(shape, p);
    rollout(&model, &scene, &start, &[0.3]).unwrap().bodies[0].poses[0].translation.vector.x
}

const VALUES: [f64; 4] = [-1.6, 0.45, 0.001, 0.0];

fn pushes(c: &mut Criterion) {
    let dual: [Dual<4>; 4] = std::array::from_fn(|i| parameter(VALUES[i], i));
    for (name, shape) in [("a box", block()), ("13 k vertices", rounded(13_000)), ("68 k vertices", rounded(68_000))] {
        c.bench_function(&format!("push of 600 steps, {name}, plain"), |b| b.iter(|| push(&shape, black_box(VALUES))));
        c.bench_function(&format!("push of 600 steps, {name}, 4 tangents"), |b| {
            b.iter(|| push(&shape, black_box(dual)));
        });
    }
}

fn air(c: &mut Criterion) {
    let (model, mut scene, start) = scene(&block(), VALUES);
    scene.static_bodies.clear();
    let mut work = Workspace::default();
    let mut state = start.clone();
    c.bench_function("one step in the air under a known force", |b| {
        b.iter(|| {
            state.clone_from(&start);
            state.time_s = 0.1;
            step(&model, &scene, black_box(&mut state), &mut work).unwrap();
        });
    });
}

fn hand(c: &mut Criterion) {
    let of = pick::Pick { mass_kg: 0.2, friction: 0.5, cap_nm: 0.29, grip_force: 1.5, reserve_nm: 0.1, dt_s: 2e-3 };
    let (mut model, scene, start) = pick::scene(&of).unwrap();
    let mut state = rollout(&model, &scene, &start, &[3.0]).unwrap().last;
    model.articulations[0].base = Base::Fixed(state.articulations[0].base.world_from_base);
    let mut work = Workspace::default();
    c.bench_function("one step of the LEAP holding a box", |b| {
        b.iter(|| step(&model, &scene, black_box(&mut state), &mut work).unwrap());
    });
}

fn batch(c: &mut Criterion) {
    let shape = block();
    let jobs: Vec<Job<f64>> = (0..64)
        .map(|i| {
            let (model, scene, start) = scene(&shape, [VALUES[0] + 0.01 * f64::from(i), VALUES[1], 0.0, 0.0]);
            Job { model, scene, start }
        })
        .collect();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        c.bench_function(&format!("64 pushes, {threads} threads"), |b| {
            b.iter(|| pool.install(|| rollout_batch(black_box(&jobs), &[0.3])));
        });
    }
}

criterion_group!(benches, pushes, air, hand, batch);
criterion_main!(benches);
