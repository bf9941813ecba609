//! What a frame costs: a made hand that opens, closes and pinches, on LEAP and Allegro; one iteration is one frame.
#![allow(clippy::unwrap_used, missing_docs)] // a benchmark may panic; criterion's macros make undocumented items

#[path = "../tests/support/mod.rs"]
mod support;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use drex_demo::{HandSkeleton, Side};
use drex_retarget::{Objective, RetargetOptions, Retargeter, TargetHand, retarget};
use support::HANDS;

fn frames(c: &mut Criterion) {
    let person = HandSkeleton::new(Side::Right).moving(300);
    for name in HANDS {
        let hand = TargetHand::bundled(name).unwrap();
        for objective in [Objective::Vector, Objective::DexPilot, Objective::Position] {
            let mut retargeter = Retargeter::new(&hand, RetargetOptions::new(objective)).unwrap();
            let mut next = person.frames.iter().cycle();
            c.bench_function(&format!("{name} {objective:?} frame"), |b| {
                b.iter(|| black_box(retargeter.frame(next.next().unwrap())))
            });
        }
        c.bench_function(&format!("{name} clip of 300 frames, automatic scale"), |b| {
            b.iter(|| black_box(retarget(&person, &hand, &RetargetOptions::default()).unwrap()))
        });
    }
}

criterion_group!(benches, frames);
criterion_main!(benches);
