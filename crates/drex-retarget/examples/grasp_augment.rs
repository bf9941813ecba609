//! Makes many grasps from one demonstration and prints how many, how fast and how varied.
//!
//! ```text
//! grasp_augment DEMO MESH [leap_right|allegro_right] [COUNT] [--hull]
//! ```
#![allow(clippy::print_stdout)] // a program for the terminal

mod object;

use std::path::Path;
use std::time::Instant;

use drex_demo::{Demonstration, LoadOptions};
use drex_retarget::{AugmentOptions, GraspOptions, TargetHand, augment, retarget_grasp};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [demo, mesh] = [0, 1].map(|i| args.get(i).map(Path::new).ok_or("give DEMO and MESH"));
    let demo = Demonstration::load(demo?, &LoadOptions::default())?;
    let target = TargetHand::bundled(args.get(2).map_or("leap_right", String::as_str))?;
    let count: usize = args.get(3).map_or(Ok(1000), |c| c.parse())?;
    let object = object::load(mesh?, args.iter().any(|a| a == "--hull"))?;
    let clip = retarget_grasp(&demo, &target, &object, &GraspOptions::default())?;
    let sources = clip.frames.iter().filter(|f| f.is_accepted() && f.evaluation.force_closure).count();
    let clock = Instant::now();
    let many = augment(&clip, &target, &object, &AugmentOptions::default(), count)?;
    let seconds = clock.elapsed().as_secs_f64();
    println!(
        "{} grasps from {sources} frames and {} symmetries: {} attempts, {:.0} % kept the rules, {seconds:.1} s, {:.0} per second",
        many.grasps.len(),
        many.symmetries.len(),
        many.attempts,
        100.0 * many.accepted as f64 / many.attempts.max(1) as f64,
        many.grasps.len() as f64 / seconds
    );
    Ok(())
}
