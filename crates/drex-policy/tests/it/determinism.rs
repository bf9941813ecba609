//! The same seed gives the same bytes, whatever the number of threads.
#![cfg(feature = "flex")]

use std::fs;
use std::ops::ControlFlow;

use crate::common::toy;
use drex_policy::{GraspPolicy, TrainOptions, TrainReport};
use nalgebra::{Point3, Vector3};

/// Trains with `threads` threads (0: as many as rayon chooses by itself) at sizes at which the backend does use them; all files of the policy, and the report without its time.
fn bytes(threads: usize, seed: u64) -> (Vec<Vec<u8>>, TrainReport) {
    let mut data = toy(40, &[0.1, 0.2, 0.3]);
    let spread = |i: u32, k: f64| (f64::from(i) * k).sin() * 0.05;
    data.objects[0].points =
        (0..1024).map(|i| Point3::from(Vector3::new(spread(i, 1.1), spread(i, 2.3), spread(i, 3.7)))).collect();
    let options = TrainOptions::default().with_points(1024).with_hidden(128).with_epochs(2).with_seed(seed);
    let train = || GraspPolicy::train(&data, &options, &mut |_| ControlFlow::Continue(())).unwrap();
    let (policy, mut report) = if threads == 0 {
        train()
    } else {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(train)
    };
    report.seconds = 0.0;
    let folder = tempfile::tempdir().unwrap();
    policy.save(folder.path()).unwrap();
    let mut files: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    (files.iter().map(|f| fs::read(f).unwrap()).collect(), report)
}

#[test]
fn threads_do_not_change_a_bit() {
    let one = bytes(1, 3);
    for threads in [0, 2, 3, 7] {
        assert!(one == bytes(threads, 3), "{threads} threads");
    }
    assert!(one.0 != bytes(1, 4).0, "the seed must matter");
}
