//! What every reader's result goes through: order, unit, hand, times, object, range, and whether it can be a hand at all.

use std::path::Path;

use drex_core::{Error, Result};
use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion};

use super::options::ASSUMED_FPS;
use super::{DemoUnit, Demonstration, HandFrame, LoadOptions, RawDemonstration, RawFrame, objects, order};
use crate::{KeyPointOrder, KeyPoints, Side, hand_length_m, median, mirrored};

/// Lengths of a human hand along the middle finger, metres: a child's and more than a giant's.
const HAND_LENGTH_M: (f64, f64) = (0.08, 0.35);
/// Beyond the range by this factor it is another unit.
const OTHER_UNIT: f64 = 3.0;
/// Key points farther from the origin than this are rubbish, metres.
const FARTHEST_POINT_M: f64 = 1000.0;

/// The demonstration in `raw`, read from `path`.
pub(super) fn normalize(path: &Path, mut raw: RawDemonstration, options: &LoadOptions) -> Result<Demonstration> {
    if raw.frames.is_empty() {
        return Err(Error::content(path, None, "the recording holds no frames", "record again or give another file"));
    }
    let mut notes = std::mem::take(&mut raw.notes);
    let collapsed =
        raw.frames.iter_mut().filter_map(|f| is_one_point(&f.points).then(|| f.points = Default::default()));
    match collapsed.count() {
        0 => {}
        n => notes.push(format!("{n} frames have all key points in one place and are taken as not seen")),
    }
    if !raw.named || options.order == KeyPointOrder::Mano {
        order::put_in_order(path, &mut raw.frames, options.order)?;
    }
    let unit = options.unit.or(raw.unit).unwrap_or(DemoUnit::M);
    raw.frames.iter_mut().for_each(|f| in_metres(f, unit));
    check_length(path, &raw.frames, options.unit.is_some(), &mut notes)?;
    drop_far_points(&mut raw.frames, &mut notes);
    if options.mirrored {
        raw.frames.iter_mut().for_each(turn_back);
        notes.push("the recording was mirrored and is turned back; its object poses are left out".into());
    }
    let side = side(&raw, options, &mut notes);
    let fps = options.fps.or(raw.fps);
    if fps.is_some_and(|fps| !(fps > 0.0 && fps.is_finite())) {
        return Err(Error::content(path, None, "the frame rate is not positive", "give frames per second"));
    }
    if fps.is_none() && raw.frames.iter().any(|f| f.t_s.is_none()) {
        notes.push(format!("no times and no frame rate: {ASSUMED_FPS} frames per second are assumed"));
    }
    let frame = |(index, f): (usize, &RawFrame)| HandFrame {
        index,
        t_s: f
            .t_s
            .filter(|t| t.is_finite() && options.fps.is_none())
            .unwrap_or(index as f64 / fps.unwrap_or(ASSUMED_FPS)),
        points: f.points,
        source_from_mano_wrist: f.wrist,
        source_from_object: f.object,
        score: f.score,
    };
    let mut frames: Vec<HandFrame> = raw.frames.iter().enumerate().map(frame).collect();
    if let Some(poses) = &options.object_poses {
        objects::attach(poses, unit, fps, &mut frames)?;
    }
    objects::check_positions(path, &frames)?;
    let count = frames.len();
    let (first, last) = (options.first_frame.unwrap_or(0), options.last_frame.unwrap_or(usize::MAX));
    frames.retain(|f| (first..=last).contains(&f.index));
    if frames.is_empty() {
        let what = format!("frames {first} to {last} of {count} frames are none");
        return Err(Error::content(path, None, what, "give numbers of frames that are there"));
    }
    let of_file = || path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let source = raw.source.unwrap_or_else(of_file);
    let up = raw.up.and_then(|u| Unit::try_new(u, 1e-6));
    Ok(Demonstration { source, side, frames, up, notes })
}

/// Which hand: the option, the file, MediaPipe's label, or the right one with a note.
///
/// MediaPipe's label takes the picture for a mirror image, as a selfie camera shows it: of a camera that does not mirror, it
/// calls a right hand "Left". In a picture that is mirrored its label is true.
fn side(raw: &RawDemonstration, options: &LoadOptions, notes: &mut Vec<String>) -> Side {
    let (left, right) = raw.labels;
    if left > 0 && right > 0 {
        notes.push(format!("the detector changed its mind about the hand: {left} frames \"Left\", {right} \"Right\""));
    }
    let called = (left != right).then_some(if left > right { Side::Left } else { Side::Right });
    let labelled = called.map(|s| if options.mirrored { s } else { s.other() });
    let named = options.side.or(raw.side);
    let word = |s: Side| format!("{s:?}").to_lowercase();
    if let (Some(told), Some(file)) = (options.side, raw.side)
        && told != file
    {
        notes.push(format!("the file says {} hand; it is taken as a {} hand as asked", word(file), word(told)));
    }
    if let (Some(named), Some(label)) = (named, labelled)
        && named != label
    {
        notes.push(format!(
            "it is taken as a {} hand, but the detector's label means a {} hand",
            word(named),
            word(label)
        ));
    }
    named.or(labelled).unwrap_or_else(|| {
        notes.push("nothing says which hand it is: a right hand is assumed".into());
        Side::Right
    })
}

fn is_one_point(points: &KeyPoints) -> bool {
    let first = points[0];
    first.is_some() && points.iter().all(|p| *p == first)
}

fn in_metres(frame: &mut RawFrame, unit: DemoUnit) {
    let k = unit.metres();
    frame.points = frame.points.map(|p| p.map(|p| p * k).filter(|p| p.iter().all(|v| v.is_finite())));
    if let Some(pose) = &mut frame.object {
        pose.translation.vector *= k;
    }
}

/// The mirror image about the plane x = 0: rotations become M R M with M = diag(-1, 1, 1).
fn turn_back(frame: &mut RawFrame) {
    frame.points = mirrored(&frame.points);
    frame.wrist = frame.wrist.map(mirrored_rotation);
    frame.object = None;
}

/// M R M with M = diag(-1, 1, 1).
pub(super) fn mirrored_rotation(r: UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let m = Matrix3::from_diagonal(&nalgebra::Vector3::new(-1.0, 1.0, 1.0));
    let turned = m * r.to_rotation_matrix().matrix() * m;
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turned))
}

/// Notes a hand of unusual length and refuses one that must be in another unit.
fn check_length(path: &Path, frames: &[RawFrame], unit_is_told: bool, notes: &mut Vec<String>) -> Result<()> {
    let mut lengths: Vec<f64> = frames.iter().filter_map(|f| hand_length_m(&f.points)).collect();
    let Some(length) = median(&mut lengths) else {
        notes.push("in no frame a whole finger was seen: the length of the hand is not known".into());
        return Ok(());
    };
    let (low, high) = HAND_LENGTH_M;
    if (low..=high).contains(&length) {
        return Ok(());
    }
    let what = format!("the hand is {length:.3} m long from wrist to fingertip; hands are 0.13 to 0.25 m");
    if unit_is_told || (low / OTHER_UNIT..=high * OTHER_UNIT).contains(&length) {
        notes.push(format!("{what}: probably another unit"));
        return Ok(());
    }
    let remedy = "state the unit (mm, cm or m); picture coordinates and normalised points have none and cannot be used";
    Err(Error::content(path, None, what, remedy))
}

fn drop_far_points(frames: &mut [RawFrame], notes: &mut Vec<String>) {
    let mut dropped = 0;
    for p in frames.iter_mut().flat_map(|f| f.points.iter_mut()) {
        if p.is_some_and(|p| p.coords.amax() > FARTHEST_POINT_M) {
            *p = None;
            dropped += 1;
        }
    }
    if dropped > 0 {
        notes.push(format!("{dropped} key points are farther than a kilometre away and are taken as not seen"));
    }
}

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::unwrap_used)]

    use nalgebra::Point3;

    use super::*;
    use crate::HumanFinger;

    /// An open right hand, palm towards +z, fingers along +y, the thumb to +x, 0.18 m long.
    pub(crate) fn open_hand() -> KeyPoints {
        let mut points: KeyPoints = Default::default();
        points[0] = Some(Point3::origin());
        for (i, finger) in HumanFinger::ALL.into_iter().enumerate() {
            let (base, step) = if i == 0 {
                (Point3::new(0.03, 0.02, 0.005), nalgebra::Vector3::new(0.02, 0.025, 0.004))
            } else {
                (Point3::new(0.045 - 0.02 * i as f64, 0.09, 0.0), nalgebra::Vector3::new(0.0, 0.03, 0.002))
            };
            for j in 0..4 {
                points[finger.base() + j] = Some(base + step * j as f64);
            }
        }
        points
    }

    fn raw(points: KeyPoints, n: usize) -> RawDemonstration {
        RawDemonstration {
            frames: vec![RawFrame::new(points); n],
            side: Some(Side::Right),
            ..RawDemonstration::default()
        }
    }

    fn done(raw: RawDemonstration, options: &LoadOptions) -> Result<Demonstration> {
        normalize(Path::new("demo.npy"), raw, options)
    }

    #[test]
    fn millimetres_are_refused_until_they_are_stated() {
        let long = open_hand().map(|p| p.map(|p| p * 1000.0));
        let said = done(raw(long, 2), &LoadOptions::default()).unwrap_err().to_string();
        assert!(said.contains("state the unit"), "{said}");
        let told = LoadOptions { unit: Some(DemoUnit::Mm), ..LoadOptions::default() };
        let demo = done(raw(long, 2), &told).unwrap();
        assert!((hand_length_m(&demo.frames[0].points).unwrap() - 0.18).abs() < 0.002);
        let large = open_hand().map(|p| p.map(|p| p * 2.5));
        assert!(done(raw(large, 2), &LoadOptions::default()).unwrap().notes.iter().any(|n| n.contains("another unit")));
    }

    #[test]
    fn a_mirrored_recording_is_turned_back() {
        let mut mirror = raw(mirrored(&open_hand()), 1);
        mirror.side = None;
        mirror.labels = (0, 1);
        let options = LoadOptions { mirrored: true, ..LoadOptions::default() };
        let demo = done(mirror, &options).unwrap();
        assert_eq!(demo.side, Side::Right, "in a mirror image MediaPipe's label is true");
        assert_eq!(demo.frames[0].points, open_hand());
        let mut plain = raw(open_hand(), 1);
        plain.side = None;
        plain.labels = (1, 0);
        assert_eq!(done(plain, &LoadOptions::default()).unwrap().side, Side::Right, "\"Left\" is a right hand");
    }

    #[test]
    fn a_rotation_in_the_mirror_has_its_axis_turned() {
        let r = UnitQuaternion::from_scaled_axis(nalgebra::Vector3::new(0.3, -0.5, 0.7));
        let axis = mirrored_rotation(r).scaled_axis();
        assert!((axis - nalgebra::Vector3::new(0.3, 0.5, -0.7)).norm() < 1e-12);
    }

    #[test]
    fn times_and_range_follow_the_options() {
        let mut timed = raw(open_hand(), 10);
        timed.frames.iter_mut().enumerate().for_each(|(i, f)| f.t_s = Some(i as f64));
        let mut options = LoadOptions { first_frame: Some(3), last_frame: Some(5), ..LoadOptions::default() };
        let demo = done(timed, &options).unwrap();
        assert_eq!(demo.frames.iter().map(|f| (f.index, f.t_s)).collect::<Vec<_>>(), [(3, 3.0), (4, 4.0), (5, 5.0)]);
        options.fps = Some(10.0);
        assert_eq!(done(raw(open_hand(), 10), &options).unwrap().frames[0].t_s, 0.3);
        options.first_frame = Some(20);
        assert!(done(raw(open_hand(), 10), &options).is_err());
        options.fps = Some(0.0);
        assert!(done(raw(open_hand(), 10), &options).is_err());
    }

    #[test]
    fn rubbish_points_are_missing_points() {
        let mut points = open_hand();
        points[7] = Some(Point3::new(1e9, 0.0, 0.0));
        let mut raw = raw(points, 2);
        raw.frames[1].points = [Some(Point3::origin()); 21];
        let demo = done(raw, &LoadOptions::default()).unwrap();
        assert!(demo.frames[0].points[7].is_none() && demo.frames[1].points.iter().all(Option::is_none));
        assert!(
            demo.notes.iter().any(|n| n.contains("kilometre")) && demo.notes.iter().any(|n| n.contains("one place"))
        );
    }
}
