//! What one identification costs: a block lifted and tilted by a known force, with meshes of 8, 13 thousand and 68 thousand vertices.
#![allow(clippy::unwrap_used, missing_docs)] // a benchmark may panic; criterion's macros make undocumented items

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use drex_core::mesh::convex_hull;
use drex_core::{ConvexPart, MassProperties, Object};
use drex_recording::{PushRecording, Support};
use drex_sysid::plan::{ForceLimits, PlanOptions, PlannedPush, PushKind, RobotLimits, plan_push};
use drex_sysid::{IdentifyOptions, identify};
use nalgebra::{Matrix3, Point3, Vector3};

const HALF: Vector3<f64> = Vector3::new(0.02, 0.03, 0.04);
const MASS_KG: f64 = 0.2;

/// A block whose faces carry a grid of about `vertices` points in all.
fn block(vertices: usize) -> Object {
    let n = ((vertices as f64 / 6.0).sqrt().round() as usize).max(2);
    let at = |k: usize| 2.0 * k as f64 / (n - 1) as f64 - 1.0;
    let face = |axis: usize, side: f64| {
        (0..n * n).map(move |k| {
            let mut p = Vector3::from_element(side);
            p[(axis + 1) % 3] = at(k / n);
            p[(axis + 2) % 3] = at(k % n);
            Point3::from(HALF.component_mul(&p))
        })
    };
    let points: Vec<Point3<f64>> = (0..6).flat_map(|f| face(f / 2, if f % 2 == 0 { -1.0 } else { 1.0 })).collect();
    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let part = ConvexPart::of_hull(convex_hull(&points).unwrap());
    Object::of_parts(vec![part], unit)
}

/// The planner's first push of a kind, done in simulation.
fn push(object: &Object, kind: PushKind) -> PushRecording {
    let force = ForceLimits { max_n: 10.0, noise_n: 0.02, lifts: true };
    let robot = RobotLimits { reaction_s: 0.03, force: Some(force), finger: None };
    let support = Support { friction: Some(0.6), ..Support::default() };
    let mut options = PlanOptions::default();
    options.masses = 1;
    let plan = plan_push(object, &support, &robot, [MASS_KG; 2], &options, |_, _| {}).unwrap();
    let short = |p: &&PlannedPush| (1e3 * p.outcomes[0].seconds) as u64;
    let chosen = plan.iter().filter(|p| p.push.kind == kind && p.refused.is_none()).min_by_key(short).unwrap();
    chosen.push.rehearse(object, &support, &robot, &options, MASS_KG, 1).unwrap()
}

fn identifications(c: &mut Criterion) {
    let mut group = c.benchmark_group("identify");
    group.sample_size(10).warm_up_time(Duration::from_secs(1));
    for (name, vertices) in [("8", 8), ("13 k", 13_000), ("68 k", 68_000)] {
        let object = block(vertices);
        for (what, kind) in [("lift", PushKind::Lift), ("tilt", PushKind::Tilt)] {
            let recording = [push(&object, kind)];
            let once = identify(&recording, &object, &IdentifyOptions::default()).unwrap();
            group.bench_function(format!("{what}, {name} vertices, {} simulations", once.simulations), |b| {
                b.iter(|| identify(black_box(&recording), &object, &IdentifyOptions::default()).unwrap());
            });
        }
    }
    group.finish();
}

criterion_group!(benches, identifications);
criterion_main!(benches);
