//! Time of one cone programme: forces only, and with the friction margin.
#![allow(missing_docs, clippy::unwrap_used)] // a benchmark

use criterion::{Criterion, criterion_group, criterion_main};
use drex_grasp::{
    ClosureOptions, Contact, GripForcePolicy, GripForceProblem, TorqueLimits, distribute, force_closure,
    minimum_grip_force, smallest_forces,
};
use nalgebra::{DVector, Matrix3xX, Point3, Vector3};

fn thumb_against_three() -> GripForceProblem {
    let mut contacts = vec![Contact::new(Point3::new(-0.03, 0.0, 0.0), Vector3::x(), 0.5)];
    for y in [-0.02, 0.0, 0.02] {
        contacts.push(Contact::new(Point3::new(0.03, y, 0.002 * y), -Vector3::x(), 0.5));
    }
    GripForceProblem::new(contacts, 0.206, Point3::origin(), Vector3::new(0.0, 0.0, -9.81))
}

/// Thumb against three fingers with `per_finger` points each and four joints per finger.
fn with_motors(per_finger: usize) -> GripForceProblem {
    let mut contacts = Vec::new();
    let mut jacobians = Vec::new();
    for (finger, [x, y]) in [[0.03, -0.02], [0.03, 0.0], [0.03, 0.02], [-0.03, 0.0]].into_iter().enumerate() {
        for k in 0..per_finger {
            let point = Point3::new(x, y + 0.002 * k as f64, 0.003 * k as f64);
            contacts.push(Contact::new(point, Vector3::new(-f64::signum(x), 0.0, 0.0), 0.5).by_finger(finger));
            let mut j = Matrix3xX::zeros(16);
            for joint in 0..4 {
                let arm = 0.02 + 0.02 * joint as f64;
                j.set_column(4 * finger + joint, &Vector3::new(arm, 0.3 * arm, if joint == 0 { arm } else { 0.0 }));
            }
            jacobians.push(j);
        }
    }
    let torques = TorqueLimits { jacobians, limits_nm: vec![(-0.29, 0.29); 16], gravity_nm: DVector::zeros(16) };
    GripForceProblem::new(contacts, 0.1, Point3::origin(), Vector3::new(0.0, 0.0, -9.81)).with_torques(torques)
}

fn run(c: &mut Criterion) {
    let problem = thumb_against_three();
    c.bench_function("smallest forces, 4 contacts", |b| b.iter(|| smallest_forces(&problem).unwrap()));
    c.bench_function("minimum grip force with friction margin, 4 contacts", |b| {
        b.iter(|| minimum_grip_force(&problem).unwrap())
    });
    for per_finger in [1, 2] {
        let problem = with_motors(per_finger);
        let n = problem.contacts.len();
        let command = GripForcePolicy::default().command(&problem).unwrap();
        c.bench_function(&format!("share of a grip force, {n} contacts, 16 joints"), |b| {
            b.iter(|| distribute(&problem, command.total_n).unwrap())
        });
        c.bench_function(&format!("grip-force policy, {n} contacts, 16 joints"), |b| {
            b.iter(|| GripForcePolicy::default().command(&problem).unwrap())
        });
    }
    let options = ClosureOptions::default();
    c.bench_function("force closure with epsilon, 4 contacts", |b| {
        b.iter(|| force_closure(&problem.contacts, &options).unwrap())
    });
}

criterion_group!(benches, run);
criterion_main!(benches);
