//! What `drex grasp` costs on the demo's twin: opening it, the network's proposals, and a prediction, which closes the hand in a dry run for each
//! proposal until one has a command. `DREX_DEMO` names the folder of a demo that has run:
//!
//! ```sh
//! drex demo && DREX_DEMO=$PWD/drex-demo cargo bench -p drex-twin --bench predict
//! ```
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stderr)] // a benchmark

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use drex_policy::Query;
use drex_twin::learn::propose;
use drex_twin::{PredictOptions, Predictor};
use nalgebra::Vector3;

fn run(c: &mut Criterion) {
    let Some(demo) = std::env::var_os("DREX_DEMO") else {
        eprintln!("skipped drex grasp: DREX_DEMO names no folder of a demo that has run");
        return;
    };
    let open = || Predictor::open(Path::new(&demo), None, &PredictOptions::default(), None).unwrap();
    let mut group = c.benchmark_group("drex grasp");
    group.sample_size(10);
    group.bench_function("open the twin", |b| b.iter(|| black_box(open())));
    let predictor = open();
    let object = &predictor.object;
    let points = object.point_cloud(predictor.policy.points(), 0);
    let up = object.world_from_object.rotation.inverse() * Vector3::z();
    let query = Query::new(&points, object.mass_kg(), object.friction).with_up(up);
    let proposals = propose(&predictor.policy, &query).unwrap().len();
    group.bench_function(format!("{proposals} proposals of the network"), |b| {
        b.iter(|| black_box(propose(&predictor.policy, &query).unwrap()))
    });
    let place = predictor.predict().unwrap().place;
    group.bench_function(format!("predict: proposals, and a dry run of each until number {place} is taken"), |b| {
        b.iter(|| black_box(predictor.predict().unwrap()))
    });
    group.finish();
}

criterion_group!(benches, run);
criterion_main!(benches);
