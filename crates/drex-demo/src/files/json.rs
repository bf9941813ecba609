//! Demonstrations in JSON: `drex-hand-demo/1`, excerpts of DexYCB, one frame per line.

use std::path::Path;

use drex_core::{Error, Pose, Result, fsutil};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;

use super::objects::{at_frame, pose_of, rotation_of};
use super::options::ASSUMED_FPS;
use super::order::{MANUS_NODES, key_point_named};
use super::{DemoUnit, HandFrame, LoadOptions, ManoModel, ManoPose, RawDemonstration, RawFrame};
use crate::{KEYPOINTS, KeyPoints, Side};

/// One hand as files have it; `null`, a coordinate that is `null` and NaN are points that were not seen.
type PointsFile = Vec<Option<Vec<Option<f64>>>>;

/// Which layout a file has.
#[derive(Deserialize)]
struct Probe {
    frames: Option<IgnoredAny>,
    hand_joints: Option<IgnoredAny>,
    keypoints: Option<IgnoredAny>,
}

#[derive(Deserialize)]
struct DemoFile {
    format: Option<String>,
    hand: Option<String>,
    units: Option<String>,
    joint_names: Option<Vec<String>>,
    source: Option<String>,
    fps: Option<f64>,
    up: Option<[f64; 3]>,
    frames: Vec<FrameFile>,
}

/// A frame of a [`DemoFile`], and a line of a stream.
#[derive(Deserialize)]
struct FrameFile {
    t: Option<f64>,
    keypoints: Option<PointsFile>,
    canonical: Option<PointsFile>,
    wrist_rotation: Option<Value>,
    object_pose: Option<Value>,
    object_pose_3x4: Option<Value>,
    object_pose_4x4: Option<Value>,
    score: Option<f64>,
    mp_label: Option<String>,
    mano_pose_axis_angle_48: Option<Vec<f64>>,
    #[serde(default)]
    mano_betas_10: Vec<f64>,
    mano_trans_3: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct DexYcbFile {
    hand_joints: Vec<PointsFile>,
    #[serde(default)]
    object_poses: Vec<Value>,
    #[serde(default)]
    world2wrist: Vec<Value>,
    up_estimated: Option<[f64; 3]>,
    units: Option<String>,
    fps: Option<f64>,
    hand: Option<String>,
}

/// Reads any of the layouts.
pub(super) fn read(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<RawDemonstration> {
    let text = std::str::from_utf8(bytes)
        .map_err(|_| Error::content(path, None, "the file is not text (UTF-8)", "check that this is the right file"))?;
    let text = without_nan(text.trim_start_matches('\u{feff}'));
    let first = text.lines().find(|l| !l.trim().is_empty()).unwrap_or_default();
    if serde_json::from_str::<Probe>(first).is_ok_and(|p| p.keypoints.is_some() && p.frames.is_none()) {
        return read_lines(path, &text);
    }
    let remedy = "write drex-hand-demo/1, or one frame with keypoints per line";
    if !first.trim_start().starts_with('{') {
        let what = if first.is_empty() { "the file is empty" } else { "the file is no JSON object" };
        return Err(Error::content(path, None, what, remedy));
    }
    let probe: Probe = fsutil::from_json(path, &text)?;
    if probe.hand_joints.is_some() {
        read_dexycb(path, &text)
    } else if probe.frames.is_some() {
        read_demo(path, &text, options)
    } else {
        let what = "neither \"frames\" nor \"hand_joints\" nor \"keypoints\"";
        Err(Error::content(path, None, what, remedy))
    }
}

/// One line of a stream.
pub(super) fn frame_of_line(path: &Path, line: &str, line_no: usize) -> Result<HandFrame> {
    let index = line_no.saturating_sub(1);
    let RawFrame { t_s, points, wrist, object, score } = raw_frame_of_line(path, line, line_no)?;
    Ok(HandFrame {
        index,
        t_s: t_s.unwrap_or(index as f64 / ASSUMED_FPS),
        points,
        source_from_mano_wrist: wrist,
        source_from_object: object,
        score,
    })
}

fn raw_frame_of_line(path: &Path, line: &str, line_no: usize) -> Result<RawFrame> {
    let refuse = |what: String| {
        Error::content(path, line_no, what, "give {\"t\": seconds, \"keypoints\": [[x, y, z] or null, 21 times]}")
    };
    let frame: FrameFile = serde_json::from_str(&without_nan(line)).map_err(|e| {
        let message = e.to_string();
        let message = message.rsplit_once(" at line ").map_or(message.as_str(), |(head, _)| head);
        refuse(format!("column {}: {message}", e.column()))
    })?;
    if frame.keypoints.is_none() {
        return Err(refuse("no \"keypoints\"".into()));
    }
    raw_frame(&frame, None).map_err(|e| Error::at(path, line_no, e))
}

fn read_lines(path: &Path, text: &str) -> Result<RawDemonstration> {
    let lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
    let frames = lines.map(|(i, line)| raw_frame_of_line(path, line, i + 1)).collect::<Result<_>>()?;
    let mut raw = RawDemonstration { frames, ..RawDemonstration::default() };
    raw.labels = labels(text.lines().filter_map(|l| serde_json::from_str::<FrameFile>(l).ok()?.mp_label));
    Ok(raw)
}

fn read_demo(path: &Path, text: &str, options: &LoadOptions) -> Result<RawDemonstration> {
    let file: DemoFile = fsutil::from_json(path, text)?;
    if let Some(format) = file.format.as_ref().filter(|f| *f != FORMAT) {
        let what = format!("the format is `{format}`");
        return Err(Error::content(path, None, what, format!("write {FORMAT} or use a newer drex")));
    }
    let places = file.joint_names.as_ref().map(|names| places(path, names)).transpose()?;
    let mut raw = RawDemonstration {
        source: file.source,
        side: side_named(path, file.hand.as_deref())?,
        labels: labels(file.frames.iter().filter_map(|f| f.mp_label.clone())),
        unit: unit_named(path, file.units.as_deref())?,
        fps: file.fps,
        up: file.up.map(Vector3::from),
        named: places.is_some(),
        ..RawDemonstration::default()
    };
    let mut model = None;
    let mut canonical = 0;
    for (i, frame) in file.frames.iter().enumerate() {
        let at = |e| Error::at(path, None, at_frame(i, "drex-hand-demo/1", e));
        let mut out = raw_frame(frame, places.as_deref()).map_err(at)?;
        let mano = frame.mano_pose_axis_angle_48.as_deref().map(|pose| {
            let t = frame.mano_trans_3.map_or_else(Vector3::zeros, Vector3::from);
            ManoPose::from_axis_angles(pose, &frame.mano_betas_10, t)
        });
        let mano = mano.transpose().map_err(at)?;
        out.wrist = out.wrist.or(mano.as_ref().map(|m| m.global_orient));
        if frame.keypoints.is_none() {
            if let Some(pose) = &mano {
                if model.is_none() {
                    model = Some(ManoModel::of_options(path, options)?);
                }
                out.points = model.as_ref().map(|m| m.key_points(pose, options.mano_flat_hand)).unwrap_or_default();
            } else if frame.canonical.is_some() {
                canonical += 1;
            }
        }
        raw.frames.push(out);
    }
    if canonical > 0 {
        raw.notes.push(format!(
            "{canonical} frames have no keypoints but only canonical ones: the wrist does not move in them"
        ));
    }
    Ok(raw)
}

fn read_dexycb(path: &Path, text: &str) -> Result<RawDemonstration> {
    let file: DexYcbFile = fsutil::from_json(path, text)?;
    let n = file.hand_joints.len();
    for (name, count) in [("object_poses", file.object_poses.len()), ("world2wrist", file.world2wrist.len())] {
        if count != 0 && count != n {
            let what = format!("{count} {name} for {n} hand_joints");
            return Err(Error::content(path, None, what, "give one per frame, or none"));
        }
    }
    let mut raw = RawDemonstration {
        side: side_named(path, file.hand.as_deref())?,
        unit: unit_named(path, file.units.as_deref())?,
        fps: file.fps,
        up: file.up_estimated.map(Vector3::from),
        ..RawDemonstration::default()
    };
    for (i, points) in file.hand_joints.iter().enumerate() {
        let at = |e| Error::at(path, None, at_frame(i, "hand", e));
        let mut frame = RawFrame::new(key_points(points, None).map_err(at)?);
        frame.object = file.object_poses.get(i).map(pose).transpose().map_err(at)?.flatten();
        let wrist_from_world = file.world2wrist.get(i).map(pose).transpose().map_err(at)?.flatten();
        frame.wrist = wrist_from_world.map(|p| p.rotation.inverse());
        raw.frames.push(frame);
    }
    Ok(raw)
}

/// Name of the format that [`crate::Demonstration::save_json`] writes.
pub(super) const FORMAT: &str = "drex-hand-demo/1";

fn raw_frame(frame: &FrameFile, places: Option<&[usize]>) -> Result<RawFrame> {
    let points = frame.keypoints.as_ref().or(frame.canonical.as_ref());
    let points = points.map(|p| key_points(p, places)).transpose()?.unwrap_or_default();
    let object = [&frame.object_pose, &frame.object_pose_3x4, &frame.object_pose_4x4].into_iter().flatten().next();
    Ok(RawFrame {
        t_s: frame.t,
        points,
        wrist: frame.wrist_rotation.as_ref().map(rotation).transpose()?.flatten(),
        object: object.map(pose).transpose()?.flatten(),
        score: frame.score,
    })
}

/// 21 points, or the 25 nodes of a glove; `places` gives the key point of each item where the file names its points. An empty
/// list is a hand that was not seen.
fn key_points(points: &PointsFile, places: Option<&[usize]>) -> Result<KeyPoints> {
    let point = |i: usize| -> Result<Option<Point3<f64>>> {
        match points[i].as_deref() {
            None => Ok(None),
            Some([x, y, z]) => Ok((*x).zip(*y).zip(*z).map(|((x, y), z)| Point3::new(x, y, z))),
            Some(other) => {
                Err(Error::value(format!("key point {i} has {} coordinates", other.len()), "give x, y, z or null"))
            }
        }
    };
    let mut out = KeyPoints::default();
    match (points.len(), places) {
        (0, _) => {}
        (n, Some(places)) if n == places.len() => {
            for (i, &place) in places.iter().enumerate() {
                out[place] = point(i)?;
            }
        }
        (KEYPOINTS, None) => {
            for (i, slot) in out.iter_mut().enumerate() {
                *slot = point(i)?;
            }
        }
        (25, None) => {
            for (slot, node) in out.iter_mut().zip(MANUS_NODES) {
                *slot = point(node)?;
            }
        }
        (n, _) => return Err(Error::value(format!("{n} key points"), "give 21, or [] for a hand that was not seen")),
    }
    Ok(out)
}

/// The key point of each of the file's joint names.
fn places(path: &Path, names: &[String]) -> Result<Vec<usize>> {
    let refuse =
        |what: String| Error::content(path, None, what, "name the 21 points as documented, or leave the names out");
    let mut seen = [false; KEYPOINTS];
    let mut out = Vec::new();
    for name in names {
        let place = key_point_named(name).ok_or_else(|| refuse(format!("the joint name `{name}` is not known")))?;
        if std::mem::replace(&mut seen[place], true) {
            return Err(refuse(format!("the joint name `{name}` is there twice")));
        }
        out.push(place);
    }
    if out.len() != KEYPOINTS {
        return Err(refuse(format!("{} joint names", out.len())));
    }
    Ok(out)
}

/// Every number in nested lists, in order; `null` is NaN.
fn flat(value: &Value, out: &mut Vec<f64>) -> Result<()> {
    match value {
        Value::Null => out.push(f64::NAN),
        Value::Number(n) => out.push(n.as_f64().unwrap_or(f64::NAN)),
        Value::Array(items) => items.iter().try_for_each(|v| flat(v, out))?,
        _ => return Err(Error::value("a pose is no list of numbers", "give rows of numbers")),
    }
    Ok(())
}

fn pose(value: &Value) -> Result<Option<Pose>> {
    let mut numbers = Vec::new();
    flat(value, &mut numbers)?;
    if value.is_null() { Ok(None) } else { pose_of(&numbers) }
}

fn rotation(value: &Value) -> Result<Option<UnitQuaternion<f64>>> {
    let mut numbers = Vec::new();
    flat(value, &mut numbers)?;
    if value.is_null() { Ok(None) } else { rotation_of(&numbers) }
}

/// The hand that a file names.
pub(super) fn side_named(path: &Path, name: Option<&str>) -> Result<Option<Side>> {
    match name.map(|n| n.trim().to_ascii_lowercase()).as_deref() {
        None => Ok(None),
        Some("right" | "r") => Ok(Some(Side::Right)),
        Some("left" | "l") => Ok(Some(Side::Left)),
        Some(other) => Err(Error::content(path, None, format!("the hand is `{other}`"), "write \"right\" or \"left\"")),
    }
}

/// The unit that a file names.
pub(super) fn unit_named(path: &Path, name: Option<&str>) -> Result<Option<DemoUnit>> {
    name.map(|n| {
        DemoUnit::parse(n).ok_or_else(|| Error::content(path, None, format!("the unit is `{n}`"), "write m, cm or mm"))
    })
    .transpose()
}

/// Frames that MediaPipe called (left, right).
fn labels(names: impl Iterator<Item = String>) -> (usize, usize) {
    names.fold((0, 0), |(left, right), name| match name.as_str() {
        "Left" => (left + 1, right),
        "Right" => (left, right + 1),
        _ => (left, right),
    })
}

/// The text with the bare `NaN` and `Infinity` that Python writes made `null`; JSON knows neither.
fn without_nan(text: &str) -> std::borrow::Cow<'_, str> {
    if !(text.contains("NaN") || text.contains("Infinity")) {
        return text.into();
    }
    let mut out = String::with_capacity(text.len());
    let (mut rest, mut in_string) = (text, false);
    while let Some(c) = rest.chars().next() {
        let word = ["-Infinity", "Infinity", "NaN"].into_iter().find(|w| !in_string && rest.starts_with(w));
        let length = match word {
            Some(word) => {
                out.push_str("null");
                word.len()
            }
            // An escaped character cannot end the string.
            None if in_string && c == '\\' => 1 + rest[1..].chars().next().map_or(0, char::len_utf8),
            None => c.len_utf8(),
        };
        if word.is_none() {
            in_string ^= c == '"';
            out.push_str(&rest[..length]);
        }
        rest = &rest[length..];
    }
    out.into()
}
