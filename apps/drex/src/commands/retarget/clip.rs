//! The objectives of single frames, over a clip.

use std::time::Instant;

use anyhow::Result;
use drex_core::Pose;
use drex_demo::{Demonstration, FrameFlag};
use drex_retarget::{Retargeting, TargetHand, retarget};
use serde_json::json;

use super::file::{self, FrameRecord};
use super::{Object, options, up, upright};
use crate::cli::RetargetArgs;
use crate::ui::Ui;
use drex_report::picture::clip as picture;

pub fn run(
    args: &RetargetArgs,
    demo: &Demonstration,
    hand: &TargetHand,
    object: Option<&Object>,
    ui: &Ui,
) -> Result<()> {
    let begin = Instant::now();
    let result = retarget(demo, hand, &options(args))?;
    result.scale.note().iter().for_each(|note| ui.note(format!("  note     {note}")));
    let ms = 1e3 * begin.elapsed().as_secs_f64() / result.frames.len().max(1) as f64;
    if let Some(out) = &args.out {
        let frames: Vec<FrameRecord<'_>> =
            demo.frames.iter().zip(&result.frames).map(|(d, f)| FrameRecord::new(d.index, f)).collect();
        file::write(out, args, demo, hand, object, &result.scale, &frames, &[(); 0])?;
    }
    if let Some(path) = &args.picture {
        let world_from_source = upright(object.and_then(|_| up(args, demo, ui)));
        let poses: Vec<_> = demo
            .frames
            .iter()
            .zip(&result.frames)
            .map(|(d, f)| match (object, f.source_from_base, d.source_from_object) {
                (Some(_), Some(base), Some(object)) => picture::Posed {
                    frame: d.index,
                    q: &f.q,
                    world_from_base: world_from_source * base,
                    world_from_object: Some(world_from_source * object),
                },
                _ => picture::Posed {
                    frame: d.index,
                    q: &f.q,
                    world_from_base: hand.base_from_operator.inverse(),
                    world_from_object: None::<Pose>,
                },
            })
            .collect();
        picture::write(path, &hand.robot, object.map(|o| &o.mesh), &poses, args.every.get())?;
    }
    let summary = Summary::of(&result);
    let value = json!({
        "hand": hand.robot.name,
        "objective": result.objective,
        "frames": result.frames.len(),
        "scale": result.scale,
        "mean_objective": summary.objective,
        "mean_residual_mm": summary.residual_mm,
        "flagged_frames": summary.flagged,
        "frames_without_hand": summary.without_hand,
        "ms_per_frame": ms,
        "out": args.out,
        "picture": args.picture,
    });
    ui.answer(&value, text(args, hand, &result, &summary, ms))
}

/// Means over the frames that are hands.
struct Summary {
    objective: Option<f64>,
    residual_mm: Option<f64>,
    flagged: usize,
    without_hand: usize,
}

impl Summary {
    fn of(result: &Retargeting) -> Self {
        let mean = |values: Vec<f64>| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
        let no_hand =
            |f: &&drex_retarget::RetargetedFrame| f.flags.iter().any(|g| matches!(g, FrameFlag::NoHand { .. }));
        Self {
            objective: mean(result.frames.iter().map(|f| f.objective).filter(|o| o.is_finite()).collect()),
            residual_mm: mean(result.frames.iter().flat_map(|f| &f.fingers).filter_map(|r| r.residual_mm).collect()),
            flagged: result.frames.iter().filter(|f| !f.flags.is_empty()).count(),
            without_hand: result.frames.iter().filter(no_hand).count(),
        }
    }
}

fn text(args: &RetargetArgs, hand: &TargetHand, result: &Retargeting, s: &Summary, ms: f64) -> String {
    let number = |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    let mut lines = vec![
        format!("{} frames to {}, {ms:.3} ms a frame", result.frames.len(), hand.robot.name),
        format!(
            "  scale    {:.3} ({}; person {:.0} mm, hand {:.0} mm from wrist to fingertip)",
            result.scale.scale,
            if result.scale.automatic { "automatic" } else { "given" },
            1e3 * result.scale.human_reach_m,
            1e3 * result.scale.hand_reach_m
        ),
        format!("  mean     objective {}, fingertips {} mm off", number(s.objective, 5), number(s.residual_mm, 1)),
    ];
    if s.flagged > 0 {
        lines.push(format!("  flagged  {} frames, {} of them no hand", s.flagged, s.without_hand));
    }
    lines.extend(args.out.iter().chain(&args.picture).map(|p| format!("  written  {}", p.display())));
    lines.join("\n")
}
