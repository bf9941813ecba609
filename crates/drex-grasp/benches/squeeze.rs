//! Time of one cone programme: forces only, and with the friction margin.
#![allow(missing_docs, clippy::unwrap_used)] // a benchmark

use criterion::{Criterion, criterion_group, criterion_main};
use drex_grasp::{ClosureOptions, Contact, SqueezeProblem, force_closure, smallest_forces, smallest_squeeze};
use nalgebra::{Point3, Vector3};

fn thumb_against_three() -> SqueezeProblem {
    let mut contacts = vec![Contact::new(Point3::new(-0.03, 0.0, 0.0), Vector3::x(), 0.5)];
    for y in [-0.02, 0.0, 0.02] {
        contacts.push(Contact::new(Point3::new(0.03, y, 0.002 * y), -Vector3::x(), 0.5));
    }
    SqueezeProblem::new(contacts, 0.206, Point3::origin(), Vector3::new(0.0, 0.0, -9.81))
}

fn run(c: &mut Criterion) {
    let problem = thumb_against_three();
    c.bench_function("smallest forces, 4 contacts", |b| b.iter(|| smallest_forces(&problem).unwrap()));
    c.bench_function("smallest squeeze with friction margin, 4 contacts", |b| {
        b.iter(|| smallest_squeeze(&problem).unwrap())
    });
    let options = ClosureOptions::default();
    c.bench_function("force closure with epsilon, 4 contacts", |b| {
        b.iter(|| force_closure(&problem.contacts, &options).unwrap())
    });
}

criterion_group!(benches, run);
criterion_main!(benches);
