//! A made-up person's hand that moves, on a robot hand: how near the fingertips come, with each of the three objectives.
//!
//!     cargo run --release -p drex-retarget --example moving_hand -- [leap | allegro | leap_left | FILE.urdf]
//!
//! Per objective: the scale, the median and the worst distance of a fingertip from the person's (scaled), the time per frame, and the
//! frames that are flagged. `drex retarget` does the same for recordings.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::time::Instant;

use drex_demo::{HandSkeleton, Side};
use drex_retarget::{Objective, RetargetOptions, TargetHand, retarget};

fn main() {
    if let Err(e) = run() {
        eprintln!("{e}");
        std::process::exit(1);
    }
}

fn run() -> drex_retarget::Result<()> {
    let name = std::env::args().nth(1).unwrap_or_else(|| "leap".into());
    let hand = TargetHand::resolve(&name)?;
    for note in &hand.notes {
        println!("{note}");
    }
    let side = if name.ends_with("_left") { Side::Left } else { Side::Right };
    let person = HandSkeleton::new(side).moving(120);
    for objective in [Objective::Vector, Objective::DexPilot, Objective::Position] {
        let start = Instant::now();
        let clip = retarget(&person, &hand, &RetargetOptions::new(objective))?;
        let ms = 1e3 * start.elapsed().as_secs_f64() / clip.frames.len() as f64;
        let mut off: Vec<f64> = clip.frames.iter().flat_map(|f| &f.fingers).filter_map(|f| f.residual_mm).collect();
        off.sort_by(f64::total_cmp);
        let flagged = clip.frames.iter().filter(|f| !f.flags.is_empty()).count();
        println!(
            "{objective:?}: scale {:.2}, fingertips off by {:.1} mm (worst {:.1}), {ms:.3} ms a frame, {flagged} of {} frames flagged",
            clip.scale.scale,
            off.get(off.len() / 2).copied().unwrap_or(f64::NAN),
            off.last().copied().unwrap_or(f64::NAN),
            clip.frames.len()
        );
    }
    Ok(())
}
