//! The grasp objective: contacts with the object over the whole clip.

use std::time::Instant;

use anyhow::Result;
use drex_demo::Demonstration;
use drex_mesh::{GridOptions, solid_object};
use drex_retarget::{
    AugmentOptions, Augmentation, GraspFrame, GraspOptions, GraspRetargeting, TargetHand, augment, retarget_grasp,
};
use serde_json::json;

use super::file::{self, AugmentedRecord, GraspRecord};
use super::{Object, options, up, upright};
use crate::cli::RetargetArgs;
use crate::ui::Ui;
use drex_report::picture::clip as picture;

pub fn run(
    args: &RetargetArgs,
    demo: &Demonstration,
    hand: &TargetHand,
    object: &Object,
    seed: Option<u64>,
    ui: &Ui,
) -> Result<()> {
    let mut demo = demo.clone();
    demo.up = up(args, &demo, ui);
    let mut grasp = GraspOptions::default();
    grasp.vector = options(args);
    let mut grid = GridOptions::default();
    // Most of a hand is nearer.
    grid.margin_m = Some(0.1);
    let held = solid_object("object", &object.mesh, &grid)?;
    let begin = Instant::now();
    let result = retarget_grasp(&demo, hand, &held, &grasp)?;
    result.plain.scale.note().iter().for_each(|note| ui.note(format!("  note     {note}")));
    let ms = 1e3 * begin.elapsed().as_secs_f64() / result.frames.len().max(1) as f64;
    let more = args.augment.map(|n| more(n.get(), &result, hand, &held, &grasp, seed)).transpose()?;
    if let Some(out) = &args.out {
        let grasps = more.as_ref().map_or_else(Vec::new, |m| augmented(&demo, m));
        file::write(out, args, &demo, hand, Some(object), &result.plain.scale, &records(&demo, &result), &grasps)?;
    }
    if let Some(path) = &args.picture {
        // The object stays where it is; the hand comes to it.
        let first = demo.frames.iter().find_map(|f| f.source_from_object);
        let world_from_object = upright(demo.up.zip(first).map(|(up, pose)| pose.rotation.inverse() * up));
        let poses: Vec<_> = demo
            .frames
            .iter()
            .zip(&result.frames)
            .map(|(d, f)| picture::Posed {
                frame: d.index,
                q: &f.grasp.joints_rad,
                world_from_base: world_from_object * f.grasp.object_from_base,
                world_from_object: Some(world_from_object),
            })
            .collect();
        picture::write(path, &hand.robot, Some(&object.mesh), &poses, args.every.get())?;
    }
    let summary = Summary::of(&result);
    if summary.held == 0 {
        ui.note(
            "  note     in no frame the object moves or a fingertip reaches it: if it is held, look at its poses and its unit (--unit)",
        );
    }
    let value = json!({
        "hand": hand.robot.name,
        "objective": "grasp",
        "frames": result.frames.len(),
        "scale": result.plain.scale,
        "held_frames": summary.held,
        "accepted_frames": summary.accepted,
        "contact_share": summary.share(summary.contact),
        "force_closure_share": summary.share(summary.closed),
        "squeeze_per_weight_median": summary.grip_force,
        "deepest_penetration_mm": summary.penetration_mm,
        "deepest_self_collision_mm": summary.self_collision_mm,
        "mean_joint_distance_rad": summary.joint_distance_rad,
        "largest_wrist_shift_mm": summary.wrist_shift_mm,
        "fastest_joint_rad_s": summary.joint_speed,
        "ms_per_frame": ms,
        "grasps": more.as_ref().map(|m| m.grasps.len()),
        "grasp_attempts": more.as_ref().map(|m| m.attempts),
        "symmetries": more.as_ref().map(|m| m.symmetries.len()),
        "out": args.out,
        "picture": args.picture,
    });
    let mut text = text(&demo, hand, &result, &summary, ms);
    if let Some(m) = &more {
        text += &format!(
            "\n  grasps   {} of {} attempts, in {} symmetric places of the object",
            m.grasps.len(),
            m.attempts,
            m.symmetries.len()
        );
    }
    text.extend(args.out.iter().chain(&args.picture).map(|p| format!("\n  written  {}", p.display())));
    ui.answer(&value, text)
}

/// Variants of the accepted frames.
fn more(
    count: usize,
    result: &GraspRetargeting,
    hand: &TargetHand,
    object: &drex_core::Object,
    grasp: &GraspOptions,
    seed: Option<u64>,
) -> Result<Augmentation> {
    let mut options = AugmentOptions::default();
    options.grasp = grasp.clone();
    options.seed = seed.unwrap_or(0);
    Ok(augment(result, hand, object, &options, count)?)
}

fn augmented<'a>(demo: &Demonstration, more: &'a Augmentation) -> Vec<AugmentedRecord<'a>> {
    more.grasps
        .iter()
        .map(|g| AugmentedRecord {
            frame: demo.frames[g.source_frame].index,
            symmetry: g.symmetry,
            noise_shift_mm: g.noise_shift_mm,
            noise_turn_rad: g.noise_turn_rad,
            grasp: record(demo.frames[g.source_frame].index, &g.grasp),
        })
        .collect()
}

fn records<'a>(demo: &Demonstration, result: &'a GraspRetargeting) -> Vec<GraspRecord<'a>> {
    demo.frames.iter().zip(&result.frames).map(|(d, f)| record(d.index, f)).collect()
}

fn record(frame: usize, f: &GraspFrame) -> GraspRecord<'_> {
    GraspRecord {
        frame,
        t_s: f.t_s,
        q: &f.grasp.joints_rad,
        accepted: f.is_accepted(),
        reasons: &f.reasons,
        object_from_base: (&f.grasp.object_from_base).into(),
        held: f.held,
        fingers: &f.fingers,
        penetration_mm: f.evaluation.penetration_mm,
        deepest_link: f.evaluation.deepest_link.as_deref(),
        self_collision: f.evaluation.self_collision.as_ref(),
        mean_joint_distance_rad: f.mean_joint_distance_rad,
        largest_joint_distance_rad: f.largest_joint_distance_rad,
        wrist_shift_mm: f.wrist_shift_mm,
        wrist_turn_rad: f.wrist_turn_rad,
        joint_speed_rad_s: f.joint_speed_rad_s,
        force_closure: f.evaluation.force_closure,
        grip_force_per_weight: f.grip_force_per_weight,
        flags: &f.flags,
    }
}

/// Figures over the held frames.
struct Summary {
    held: usize,
    accepted: usize,
    contact: usize,
    closed: usize,
    grip_force: Option<f64>,
    penetration_mm: f64,
    self_collision_mm: f64,
    joint_distance_rad: Option<f64>,
    wrist_shift_mm: f64,
    joint_speed: f64,
}

impl Summary {
    fn of(result: &GraspRetargeting) -> Self {
        let held: Vec<_> = result.frames.iter().filter(|f| f.held).collect();
        let most = |v: &dyn Fn(&GraspFrame) -> f64| result.frames.iter().map(v).fold(0.0, f64::max);
        let mut grip_forces: Vec<f64> = held.iter().filter_map(|f| f.grip_force_per_weight).collect();
        grip_forces.sort_by(f64::total_cmp);
        Self {
            held: held.len(),
            accepted: result.frames.iter().filter(|f| f.is_accepted()).count(),
            contact: held.iter().filter(|f| f.evaluation.fingers_touch).count(),
            closed: held.iter().filter(|f| f.grip_force_per_weight.is_some()).count(),
            grip_force: grip_forces.get(grip_forces.len() / 2).copied(),
            penetration_mm: most(&|f| f.evaluation.penetration_mm),
            self_collision_mm: most(&|f| f.evaluation.self_collision.as_ref().map_or(0.0, |c| c.depth_mm)),
            joint_distance_rad: (!held.is_empty())
                .then(|| held.iter().map(|f| f.mean_joint_distance_rad).sum::<f64>() / held.len() as f64),
            wrist_shift_mm: most(&|f| f.wrist_shift_mm),
            joint_speed: most(&|f| f.joint_speed_rad_s),
        }
    }

    /// Share of the held frames; `None` without any.
    fn share(&self, count: usize) -> Option<f64> {
        (self.held > 0).then(|| count as f64 / self.held as f64)
    }
}

fn text(demo: &Demonstration, hand: &TargetHand, result: &GraspRetargeting, s: &Summary, ms: f64) -> String {
    let mut lines =
        vec![format!("{} frames to {}, {ms:.2} ms a frame: {} held", result.frames.len(), hand.robot.name, s.held)];
    lines.push("  frame  thumb  index middle   ring  mm from the surface   inside  joints  wrist  grip force".into());
    for (d, f) in demo.frames.iter().zip(&result.frames).filter(|(_, f)| f.held) {
        let gaps: Vec<String> = f.fingers.iter().map(|g| format!("{:6.1}", g.gap_mm)).collect();
        lines.push(format!(
            "  {:5} {} {:>20.1} mm {:4.2} rad {:3.0} mm {}{}",
            d.index,
            gaps.join(" "),
            f.evaluation.penetration_mm,
            f.mean_joint_distance_rad,
            f.wrist_shift_mm,
            f.grip_force_per_weight.map_or("cannot carry".into(), |w| format!("{w:.1} weights")),
            f.reasons.iter().map(|r| format!("; {r}")).collect::<String>()
        ));
    }
    let percent = |n| s.share(n).map_or("-".into(), |v| format!("{:.0} %", 100.0 * v));
    lines.push(format!(
        "  accepted {} of {} held frames; thumb and two fingers touch in {}, the weight can be carried in {}",
        s.accepted,
        s.held,
        percent(s.contact),
        percent(s.closed)
    ));
    lines.push(format!(
        "  at most  in all frames {:.1} mm inside the object, {:.1} mm inside itself, wrist {:.0} mm from the person's, {:.1} rad/s",
        s.penetration_mm, s.self_collision_mm, s.wrist_shift_mm, s.joint_speed
    ));
    lines.extend(
        s.joint_distance_rad.map(|d| format!("  mean     {d:.2} rad from the plain result, in the held frames")),
    );
    lines.join("\n")
}
