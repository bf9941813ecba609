//! What a grasp synthesis costs: pinches alone, and power grasps and pinches, of a can and a ball by the bundled hands.
#![allow(missing_docs, clippy::unwrap_used)] // a benchmark

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape};
use drex_grasp::{pinch_grasps, synthesize_grasps};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3};

const MASS_KG: f64 = 0.2;
/// A hundredth of what `drex_trial::find_grasp` looks at: the time is proportional to it.
const CANDIDATES: usize = 1000;

/// A solid on the table, friction 0.5, its origin this high; what its inertia is makes no difference here.
fn standing(shape: PrimitiveShape, height_m: f64) -> Object {
    let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape: Pose::identity() }).unwrap();
    let inertia = Matrix3::identity() * (0.4 * MASS_KG * height_m * height_m);
    let body = MassProperties { mass_kg: MASS_KG, center_of_mass: Point3::origin(), inertia };
    let mut object = Object::of_parts(vec![part], body);
    object.friction = 0.5;
    object.with_rest_pose(Pose::translation(0.0, 0.0, height_m))
}

fn run(c: &mut Criterion) {
    let can = standing(PrimitiveShape::Cylinder { radius_m: 0.033, half_length_m: 0.05 }, 0.05);
    let ball = standing(PrimitiveShape::Sphere { radius_m: 0.035 }, 0.035);
    let mut group = c.benchmark_group(format!("{CANDIDATES} candidates"));
    group.sample_size(10);
    for hand in ["leap_right", "allegro_right"] {
        let robot = Robot::bundled(hand).unwrap();
        for (name, object) in [("can", &can), ("ball", &ball)] {
            let mut seed = 0;
            group.bench_function(format!("pinches of a {name}, {hand}"), |b| {
                b.iter(|| {
                    seed += 1;
                    black_box(pinch_grasps(object, &robot, CANDIDATES, seed).unwrap())
                })
            });
            group.bench_function(format!("power grasps and pinches of a {name}, {hand}"), |b| {
                b.iter(|| {
                    seed += 1;
                    black_box(synthesize_grasps(object, &robot, CANDIDATES, seed).unwrap())
                })
            });
        }
    }
    group.finish();
}

criterion_group!(benches, run);
criterion_main!(benches);
