//! Retargets a clip with contacts and prints what came out, frame by frame.
//!
//! ```text
//! grasp_clip DEMO MESH [leap_right|allegro_right] [--hull] [--frames A-B]...
//! ```
//! With `--hull` distances are to the convex hull of the mesh. The summary is over the frames that are named, or all.
#![allow(clippy::print_stdout)] // a program for the terminal

mod object;

use std::path::Path;

use drex_demo::{Demonstration, LoadOptions};
use drex_retarget::{FingerContact, GraspFrame, GraspOptions, TargetHand, retarget_grasp};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Everything on this thread, so that its processor time is all there is.
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global()?;
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [demo, mesh] = [0, 1].map(|i| args.get(i).map(Path::new).ok_or("give DEMO and MESH"));
    let demo = Demonstration::load(demo?, &LoadOptions::default())?;
    let target = TargetHand::bundled(args.get(2).map_or("leap_right", String::as_str))?;
    let object = object::load(mesh?, args.iter().any(|a| a == "--hull"))?;

    let before = cpu_ms();
    let clip = retarget_grasp(&demo, &target, &object, &GraspOptions::default())?;
    let ms = (cpu_ms() - before) / clip.frames.len() as f64;

    let mut ranges = Vec::new();
    for (i, _) in args.iter().enumerate().filter(|(_, a)| *a == "--frames") {
        let (a, b) = args.get(i + 1).and_then(|r| r.split_once('-')).ok_or("--frames takes A-B")?;
        ranges.push(a.parse::<usize>()?..=b.parse::<usize>()?);
    }
    println!("frame held  gap/tip gap of each finger, mm (* takes part)  then see the names");
    for (i, frame) in clip.frames.iter().enumerate() {
        print(i, frame);
    }
    let used: Vec<&GraspFrame> = clip
        .frames
        .iter()
        .enumerate()
        .filter(|(i, _)| ranges.is_empty() || ranges.iter().any(|r| r.contains(i)))
        .map(|(_, f)| f)
        .collect();
    summary(&used);
    println!(
        "whole clip: fastest joint {:.2} rad/s, {ms:.2} ms CPU per frame",
        most(&clip.frames, |f| f.joint_speed_rad_s)
    );
    Ok(())
}

fn print(i: usize, f: &GraspFrame) {
    let finger =
        |c: &FingerContact| format!("{}{:6.1}/{:5.1}", if c.takes_part { '*' } else { ' ' }, c.gap_mm, c.tip_gap_mm);
    let fingers: Vec<String> = f.fingers.iter().map(finger).collect();
    let hit =
        f.evaluation.self_collision.as_ref().map_or("-".into(), |c| format!("{:.1} mm {:?}", c.depth_mm, c.links));
    let grip_force = f.grip_force_per_weight.map_or("-".into(), |s| format!("{s:.1}"));
    let why = f.reasons.join(", ");
    println!(
        "{i:4} {} {} deep {:4.2} mm self {hit} joints {:.2} rad wrist {:3.0} mm {:.2} rad speed {:.1} closure {} grip force {grip_force} {why}",
        u8::from(f.held),
        fingers.join(" "),
        f.evaluation.penetration_mm,
        f.mean_joint_distance_rad,
        f.wrist_shift_mm,
        f.wrist_turn_rad,
        f.joint_speed_rad_s,
        u8::from(f.evaluation.force_closure),
    );
}

fn summary(used: &[&GraspFrame]) {
    let n = used.len().max(1) as f64;
    let share = |rule: &dyn Fn(&GraspFrame) -> bool| 100.0 * used.iter().filter(|f| rule(f)).count() as f64 / n;
    let mean = |value: &dyn Fn(&GraspFrame) -> f64| used.iter().map(|f| value(f)).sum::<f64>() / n;
    let three = |f: &GraspFrame, gap: &dyn Fn(&FingerContact) -> f64| {
        let on = |c: &FingerContact| gap(c).abs() <= 5.0;
        f.fingers.first().is_some_and(on) && f.fingers.iter().filter(|c| on(c)).count() >= 3
    };
    println!(
        "{} frames; thumb and two fingers within 5 mm: pad {:.0} %, tip point {:.0} %",
        used.len(),
        share(&|f| three(f, &|c| c.gap_mm)),
        share(&|f| three(f, &|c| c.tip_gap_mm))
    );
    println!(
        "deepest {:.2} mm; self-collision in {:.0} %; joints {:.3} rad from the vector result; wrist moved {:.0} mm (most {:.0}), {:.2} rad; fastest joint {:.2} rad/s; force closure {:.0} %",
        most(used.iter().copied(), |f| f.evaluation.penetration_mm),
        share(&|f| f.evaluation.self_collision.is_some()),
        mean(&|f| f.mean_joint_distance_rad),
        mean(&|f| f.wrist_shift_mm),
        most(used.iter().copied(), |f| f.wrist_shift_mm),
        mean(&|f| f.wrist_turn_rad),
        most(used.iter().copied(), |f| f.joint_speed_rad_s),
        share(&|f| f.evaluation.force_closure),
    );
}

fn most<'a>(frames: impl IntoIterator<Item = &'a GraspFrame>, value: impl Fn(&GraspFrame) -> f64) -> f64 {
    frames.into_iter().map(value).fold(0.0, f64::max)
}

/// CPU time of this thread so far, ms; zero where the system does not say.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) / 1e6
}
