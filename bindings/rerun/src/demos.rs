//! Demonstrations of people: key points of a hand about the object at rest.

use anyhow::{Context, Result};
use drex_demo::{Demonstration, KEYPOINTS, KeyPoints, LoadOptions};
use drex_twin::manifest::RecordedAs;
use nalgebra::Point3;
use re_sdk_types::archetypes::{LineStrips3D, Points3D};
use re_sdk_types::components::LineStrip3D;

use crate::recorder::{Recorder, Times, point};
use crate::twin::Twin;

const POINT_M: f32 = 0.003;
const BONE_M: f32 = 0.0012;
const SKIN_RGB: [u8; 3] = [196, 130, 98];

/// Records every clip on a timeline of its own.
pub fn record(recorder: &Recorder, twin: &mut Twin) -> Result<()> {
    let Some(config) = &twin.folder.manifest.grasps else {
        twin.missing.push("demonstrations, grasps and trial: the manifest has no [grasps]".into());
        return Ok(());
    };
    if config.recorded == RecordedAs::Robot {
        // Joint angles without a wrist; where the hand was is found by the stage grasps.
        return Ok(());
    }
    for file in twin.folder.demonstrations()? {
        let demo = Demonstration::load(&file, &LoadOptions::default())?;
        let clip = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let (mut times_s, mut hands) = (Vec::new(), Vec::new());
        for frame in &demo.frames {
            if let Some(source_from_object) = frame.source_from_object {
                let world_from_source = twin.world_from_mesh * source_from_object.inverse();
                times_s.push(frame.t_s);
                hands.push(frame.points.map(|p| p.map(|p| world_from_source * p)));
            }
        }
        if hands.is_empty() {
            twin.missing.push(format!("{}: no frame has a pose of the object", file.display()));
            continue;
        }
        record_clip(recorder, &clip, &times_s, &hands).with_context(|| file.display().to_string())?;
    }
    Ok(())
}

fn record_clip(recorder: &Recorder, clip: &str, times_s: &[f64], hands: &[KeyPoints]) -> Result<()> {
    let timeline = format!("demonstration_{clip}");
    let times = Times::Seconds(&timeline, times_s);
    let seen: Vec<Vec<&Point3<f64>>> = hands.iter().map(|h| h.iter().flatten().collect()).collect();
    let points = Points3D::new(seen.iter().flatten().map(|p| point(p)));
    let entity = ["world", "demonstrations", clip, "key_points"];
    recorder.columns(&entity, times, hands.len(), points.columns(seen.iter().map(Vec::len))?)?;
    let look = Points3D::update_fields().with_radii([POINT_M]).with_colors([SKIN_RGB]);
    recorder.starting(&entity, times, &look)?;

    let bones: Vec<Vec<LineStrip3D>> = hands.iter().map(bones).collect();
    let strips = LineStrips3D::new(bones.iter().flatten().cloned());
    let entity = ["world", "demonstrations", clip, "bones"];
    recorder.columns(&entity, times, hands.len(), strips.columns(bones.iter().map(Vec::len))?)?;
    recorder.starting(&entity, times, &LineStrips3D::update_fields().with_radii([BONE_M]).with_colors([SKIN_RGB]))
}

/// Wrist to tip of each finger whose points were all seen.
fn bones(hand: &KeyPoints) -> Vec<LineStrip3D> {
    let chain = |first: usize| -> Option<LineStrip3D> {
        let points: Option<Vec<[f32; 3]>> =
            std::iter::once(0).chain(first..first + 4).map(|k| hand[k].as_ref().map(point)).collect();
        Some(LineStrip3D::from(points?))
    };
    (1..KEYPOINTS).step_by(4).filter_map(chain).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finger_with_a_point_that_was_not_seen_has_no_bones() {
        let mut hand: KeyPoints = std::array::from_fn(|k| Some(Point3::new(k as f64, 0.0, 0.0)));
        let all = bones(&hand);
        assert_eq!(all.len(), 5);
        assert_eq!(all[4].0.iter().map(|p| p.x()).collect::<Vec<_>>(), [0.0, 17.0, 18.0, 19.0, 20.0]);
        hand[8] = None;
        assert_eq!(bones(&hand).len(), 4);
        hand[0] = None;
        assert!(bones(&hand).is_empty());
    }
}
