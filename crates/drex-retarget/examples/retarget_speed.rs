//! Objective and time of the per-frame objectives on recorded clips of key points.
//!
//! ```text
//! cargo run --release -p drex-retarget --example retarget_speed -- [--runs N] [--frames N] [--json] FOLDER...
//! ```
//! A folder phases `hand.json` (format "drex-hand-demo/1"); where the outputs of dex-retargeting are beside it
//! (`golden_HAND_METHOD.json`), the ratio of the mean objectives is printed. The scale is 1.6, as there. Times are wall clock
//! per frame; with `--runs N` the least of N runs over the clip (the same work each time), to leave out what else the machine does.
#![allow(clippy::print_stdout, missing_docs)] // a program for the terminal

use std::path::Path;
use std::time::Instant;

use drex_demo::{HandFrame, KEYPOINTS};
use drex_retarget::{Objective, RetargetOptions, Retargeter, Scale, TargetHand};
use nalgebra::Point3;
use serde_json::{Value, json};

const HANDS: [(&str, &str); 2] = [("leap_right", "leap_hand"), ("allegro_right", "allegro_hand")];
const METHODS: [(&str, Objective); 3] =
    [("vector", Objective::Vector), ("dexpilot", Objective::DexPilot), ("position", Objective::Position)];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut folders = Vec::new();
    let (mut runs, mut most_frames, mut as_json) = (1, usize::MAX, false);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--runs" => runs = args.next().ok_or("--runs needs a number")?.parse()?,
            "--frames" => most_frames = args.next().ok_or("--frames needs a number")?.parse()?,
            "--json" => as_json = true,
            _ => folders.push(arg),
        }
    }
    let mut rows = Vec::new();
    for folder in &folders {
        let mut frames = read_frames(Path::new(folder))?;
        frames.truncate(most_frames);
        for (hand_name, other_name) in HANDS {
            let hand = TargetHand::bundled(hand_name)?;
            for (method, objective) in METHODS {
                let mut options = RetargetOptions::new(objective);
                if objective != Objective::Position {
                    options.scale = Scale::Fixed(1.6);
                }
                let (mean_objective, mut times_ms) = run(&hand, &options, &frames, runs)?;
                times_ms.sort_by(f64::total_cmp);
                let part = |p: f64| times_ms.get((p * times_ms.len() as f64) as usize).copied().unwrap_or(f64::NAN);
                let golden = Path::new(folder).join(format!("golden_{other_name}_{method}.json"));
                let ratio = reference(&golden).map(|theirs| mean_objective / theirs);
                let sequence = Path::new(folder).file_name().map(|n| n.to_string_lossy().into_owned());
                let row = json!({
                    "sequence": sequence, "hand": hand_name, "method": method, "frames": frames.len(),
                    "mean_objective": mean_objective, "objective_ratio": ratio,
                    "median_ms": part(0.5), "p95_ms": part(0.95),
                });
                if !as_json {
                    println!(
                        "{:24} {hand_name:14} {method:9} objective {mean_objective:.5}{}  {:.4} ms (p95 {:.4})",
                        sequence.unwrap_or_default(),
                        ratio.map_or(String::new(), |r| format!(" = {r:.4} x reference")),
                        part(0.5),
                        part(0.95)
                    );
                }
                rows.push(row);
            }
        }
    }
    if as_json {
        println!("{}", Value::from(rows));
    }
    Ok(())
}

/// Mean objective and per frame the least time, ms.
fn run(
    hand: &TargetHand,
    options: &RetargetOptions,
    frames: &[HandFrame],
    runs: usize,
) -> drex_retarget::Result<(f64, Vec<f64>)> {
    let mut times_ms = vec![f64::INFINITY; frames.len()];
    let mut sum = 0.0;
    for _ in 0..runs.max(1) {
        let mut retargeter = Retargeter::new(hand, options.clone())?;
        sum = 0.0;
        for (frame, least) in frames.iter().zip(&mut times_ms) {
            let clock = Instant::now();
            let solved = retargeter.frame(frame);
            *least = least.min(clock.elapsed().as_secs_f64() * 1e3);
            sum += solved.objective;
        }
    }
    Ok((sum / frames.len().max(1) as f64, times_ms))
}

fn read_frames(folder: &Path) -> Result<Vec<HandFrame>, Box<dyn std::error::Error>> {
    let file: Value = serde_json::from_slice(&std::fs::read(folder.join("hand.json"))?)?;
    let frames = file["frames"].as_array().ok_or("hand.json has no frames")?;
    Ok(frames
        .iter()
        .map(|f| {
            let coordinate = |i: usize, k: usize| f["keypoints"][i][k].as_f64();
            let point = |i| Some(Point3::new(coordinate(i, 0)?, coordinate(i, 1)?, coordinate(i, 2)?));
            HandFrame::new(f["t"].as_f64().unwrap_or(0.0), std::array::from_fn::<_, KEYPOINTS, _>(point))
        })
        .collect())
}

/// The reference's mean objective.
fn reference(golden: &Path) -> Option<f64> {
    let file: Value = serde_json::from_slice(&std::fs::read(golden).ok()?).ok()?;
    file["obj_mean"].as_f64()
}
