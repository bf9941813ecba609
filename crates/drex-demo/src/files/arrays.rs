//! Demonstrations in NumPy arrays: key points, HaMeR's output, MANO parameters.

use std::path::Path;

use drex_core::{Error, Result};
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::hamer::{CropCamera, crop_to_full};
use super::json::{side_named, unit_named};
use super::normalize::mirrored_rotation;
use super::npz::{Npz, Table};
use super::objects::{POSE_NAMES, at_frame, pose_of, rotation_of};
use super::order::MANUS_NODES;
use super::{LoadOptions, ManoModel, ManoPose, RawDemonstration, RawFrame};
use crate::{KEYPOINTS, KeyPoints, Side, mirrored};

/// Names under which key points are found. The first is HaMeR's.
const POINT_NAMES: [&str; 12] = [
    "pred_keypoints_3d",
    "keypoints",
    "keypoints_3d",
    "kpts_3d",
    "joints",
    "joints_3d",
    "joints_world",
    "hand_joints",
    "hand_keypoints",
    "landmarks",
    "world_landmarks",
    "nodes",
];
/// Shapes of one hand: 21 points, or the 25 nodes of a Manus glove, alone or with quaternions after each position.
const POINT_FORMS: [&[usize]; 4] = [&[KEYPOINTS, 3], &[3 * KEYPOINTS], &[25, 3], &[25, 7]];
/// More frames than an hour at 50 per second are no demonstration.
const MOST_FRAMES: usize = 180_000;

/// Reads an array of key points.
pub(super) fn read_npy(path: &Path, bytes: &[u8]) -> Result<RawDemonstration> {
    let points = points_of(path, &Table::from_npy(path, bytes)?)?;
    Ok(RawDemonstration { frames: points.into_iter().map(RawFrame::new).collect(), ..RawDemonstration::default() })
}

/// Reads an archive.
pub(super) fn read_npz(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<RawDemonstration> {
    let mut source = Source { npz: Npz::open(path, bytes)?, path, rows: 0 };
    let mut raw = RawDemonstration::default();
    let hamer = source.has(&["pred_keypoints_3d", "pred_cam", "pred_cam_t", "pred_cam_t_full"]);
    let named = source.npz.first_of(&POINT_NAMES).map(str::to_owned);
    let has_mano = source.has(&["global_orient", "hand_pose", "pose", "poses", "mano_pose", "mano_poses"]);
    let name = if named.is_none() && !has_mano { Some(source.only_points(&mut raw.notes)?) } else { named };
    let points = name.map(|n| points_of(path, &source.npz.table(&n)?)).transpose()?;
    // HaMeR's key points and MANO's have a known order.
    raw.named = hamer || points.is_none();
    source.rows = match &points {
        Some(points) => points.len(),
        None => source.count_of_mano()?,
    };
    let orient = source.per_frame(&["wrist_rotation", "wrist_rotations", "global_orient"], &[&[3, 3], &[3], &[4]])?;
    let orient = orient.map(|rows| rotations(path, &rows, "rotation of the wrist")).transpose()?;
    let points = match points {
        Some(points) => points,
        None => mano_points(&mut source, options, orient.as_deref())?,
    };
    raw.frames = points.into_iter().map(RawFrame::new).collect();
    if let Some(orient) = orient {
        raw.frames.iter_mut().zip(orient).for_each(|(f, r)| f.wrist = r);
    }
    let right = source.per_frame(&["right", "is_right"], &[&[]])?;
    let right: Option<Vec<bool>> = right.map(|rows| rows.iter().map(|r| r[0] != 0.0).collect());
    if hamer {
        hamer_camera(&mut source, &mut raw, right.as_deref(), options)?;
    }
    if let Some(rows) = source.per_frame(&POSE_NAMES[..POSE_NAMES.len() - 1], &[&[4, 4], &[3, 4], &[7]])? {
        for (i, (frame, row)) in raw.frames.iter_mut().zip(&rows).enumerate() {
            frame.object = pose_of(row).map_err(|e| Error::at(path, None, at_frame(i, "object pose", e)))?;
        }
    }
    if let Some(rows) = source.per_frame(&["t", "time", "times", "timestamp", "timestamps"], &[&[]])? {
        raw.frames.iter_mut().zip(&rows).for_each(|(f, row)| f.t_s = Some(row[0]));
    }
    // Some files have a confidence per point under these names: that is no score of the frame.
    if let Ok(Some(rows)) = source.per_frame(&["score", "scores", "confidence"], &[&[]]) {
        raw.frames.iter_mut().zip(&rows).for_each(|(f, row)| f.score = Some(row[0]));
    }
    raw.fps = source.single(&["fps", "frame_rate"])?;
    raw.unit = unit_named(path, source.text(&["units", "unit"])?.as_deref())?;
    raw.side = side_named(path, source.text(&["side", "hand", "handedness"])?.as_deref())?;
    if let Some(name) = source.npz.first_of(&["up", "up_estimated"]) {
        raw.up = source.npz.table(name)?.rows(path, &[&[3]], name)?.next().map(Vector3::from_column_slice);
    }
    if let Some(right) = right {
        keep_one_side(&mut raw, &right, options);
    }
    // "frame" may also name the coordinate frame.
    let is_text = source.text(&["frame"])?.is_some();
    let numbers: &[&'static str] =
        if is_text { &["frame_index", "frame_id"] } else { &["frame", "frame_index", "frame_id"] };
    if let Some(rows) = source.per_frame(numbers, &[&[]])? {
        spread(path, &mut raw, &rows)?;
    }
    Ok(raw)
}

/// The archive while it is read.
struct Source<'a> {
    npz: Npz<'a>,
    path: &'a Path,
    /// Frames, or detections.
    rows: usize,
}

impl Source<'_> {
    fn has(&self, names: &[&'static str]) -> bool {
        self.npz.first_of(names).is_some()
    }

    /// The name of the one array that has the shape of key points.
    fn only_points(&mut self, notes: &mut Vec<String>) -> Result<String> {
        let names = self.npz.names().to_vec();
        let fits = |s: &mut Self, n: &String| s.npz.table(n).is_ok_and(|t| t.rows(s.path, &POINT_FORMS, n).is_ok());
        let mut hits: Vec<String> = names.into_iter().filter(|n| fits(self, n)).collect();
        match (hits.pop(), hits.is_empty()) {
            (Some(name), true) => {
                notes.push(format!("the array \"{name}\" is taken for the key points"));
                Ok(name)
            }
            (hit, _) => {
                let what = if hit.is_some() { "several arrays could be" } else { "no array holds" };
                let what = format!("{what} key points (n x 21 x 3): {}", self.npz.listing());
                Err(Error::content(self.path, None, what, "name them keypoints"))
            }
        }
    }

    /// Rows of the first of `names` that is there, one per frame; a single row counts for all.
    fn per_frame(&mut self, names: &[&'static str], forms: &[&[usize]]) -> Result<Option<Vec<Vec<f64>>>> {
        let Some(name) = self.npz.first_of(names) else { return Ok(None) };
        let table = self.npz.table(name)?;
        let rows: Vec<Vec<f64>> = table.rows(self.path, forms, name)?.map(<[f64]>::to_vec).collect();
        match rows.len() {
            n if n == self.rows => Ok(Some(rows)),
            1 => Ok(Some(vec![rows[0].clone(); self.rows])),
            n => {
                let what = format!("{n} rows of {name} for {} frames", self.rows);
                Err(Error::content(self.path, None, what, "save one per frame"))
            }
        }
    }

    fn single(&mut self, names: &[&'static str]) -> Result<Option<f64>> {
        let Some(name) = self.npz.first_of(names) else { return Ok(None) };
        Ok(self.npz.table(name)?.numbers.first().copied())
    }

    fn text(&mut self, names: &[&'static str]) -> Result<Option<String>> {
        let Some(name) = self.npz.first_of(names) else { return Ok(None) };
        Ok(self.npz.array(name)?.text().map(str::to_owned))
    }

    /// Frames of MANO parameters.
    fn count_of_mano(&mut self) -> Result<usize> {
        let Some(name) = self.npz.first_of(&MANO_POSES).or(self.npz.first_of(&["hand_pose"])) else {
            let what = format!("MANO parameters without the fingers (hand_pose or pose): {}", self.npz.listing());
            return Err(Error::content(self.path, None, what, "save them all"));
        };
        let table = self.npz.table(name)?;
        Ok(table.rows(self.path, &[&[48], &[15, 3, 3], &[45], &[15, 3]], name)?.len())
    }
}

/// Names of arrays of 48 axis-angle parameters.
const MANO_POSES: [&str; 4] = ["mano_pose", "mano_poses", "pose", "poses"];

/// Key points of MANO parameters, by the user's model.
fn mano_points(
    source: &mut Source<'_>,
    options: &LoadOptions,
    orient: Option<&[Option<UnitQuaternion<f64>>]>,
) -> Result<Vec<KeyPoints>> {
    let model = ManoModel::of_options(source.path, options)?;
    let path = source.path;
    let whole = source.per_frame(&MANO_POSES, &[&[48]])?;
    let fingers = source.per_frame(&["hand_pose"], &[&[15, 3, 3], &[45], &[15, 3]])?;
    let name = source.npz.first_of(&["betas", "shape", "mano_betas"]);
    let betas = name.map(|n| source.npz.table(n)).transpose()?;
    let transl = source.per_frame(&["transl", "trans", "translation", "mano_trans"], &[&[3]])?;
    let n = source.rows;
    (0..n)
        .map(|i| {
            let at = |e| Error::at(path, None, at_frame(i, "MANO parameters", e));
            let t = transl.as_ref().map_or_else(Vector3::zeros, |rows| Vector3::from_column_slice(&rows[i]));
            let shape: &[f64] = betas.as_ref().map_or(&[], |b| {
                let width = if b.shape.len() == 2 && b.shape[0] == n { b.shape[1] } else { b.numbers.len() };
                let start = if width == b.numbers.len() { 0 } else { i * width };
                b.numbers.get(start..start + width).unwrap_or_default()
            });
            let turn = orient.map_or(Some(UnitQuaternion::identity()), |o| o[i]);
            let given = [whole.as_ref(), fingers.as_ref()].into_iter().flatten().flat_map(|rows| &rows[i]);
            let (Some(turn), true) = (turn, given.chain(shape).chain(&t).all(|v| v.is_finite())) else {
                return Ok(KeyPoints::default());
            };
            let pose = match (&whole, &fingers) {
                (Some(rows), _) => ManoPose::from_axis_angles(&rows[i], shape, t).map_err(at)?,
                (None, Some(rows)) if rows[i].len() == 135 => {
                    let mut joints = [UnitQuaternion::identity(); 15];
                    for (joint, numbers) in joints.iter_mut().zip(rows[i].chunks_exact(9)) {
                        *joint = rotation_of(numbers).map_err(at)?.unwrap_or_default();
                    }
                    ManoPose::from_rotations(turn, joints, shape, t)
                }
                (None, fingers) => {
                    let angles = fingers.as_ref().map_or(&[][..], |rows| &rows[i]);
                    let both = [turn.scaled_axis().as_slice(), angles].concat();
                    ManoPose::from_axis_angles(&both, shape, t).map_err(at)?
                }
            };
            Ok(model.key_points(&pose, options.mano_flat_hand))
        })
        .collect()
}

/// Puts HaMeR's hands, which are right hands about their own origin, where they were: left ones are turned around, all are
/// moved into the camera's frame.
fn hamer_camera(
    source: &mut Source<'_>,
    raw: &mut RawDemonstration,
    right: Option<&[bool]>,
    options: &LoadOptions,
) -> Result<()> {
    let full = source.per_frame(&["pred_cam_t_full", "cam_t_full", "cam_t"], &[&[3]])?;
    let crop = source.per_frame(&["pred_cam"], &[&[3]])?;
    let center = source.per_frame(&["box_center"], &[&[2]])?;
    let size = source.per_frame(&["box_size"], &[&[]])?;
    let picture = source.per_frame(&["img_size"], &[&[2]])?;
    let about_crop = source.per_frame(&["pred_cam_t"], &[&[3]])?;
    if right.is_none() {
        raw.notes.push("HaMeR's \"right\" is not in the file: right hands are assumed".into());
    }
    let right_of = |i: usize| right.is_none_or(|r| r[i]);
    let translation = |i: usize| -> Option<Vector3<f64>> {
        match (&crop, &center, &size, &picture, &full) {
            (Some(cam), Some(center), Some(size), Some(picture), _) => {
                let camera = CropCamera {
                    pred_cam: [cam[i][0], cam[i][1], cam[i][2]],
                    box_center: [center[i][0], center[i][1]],
                    box_size: size[i][0],
                    img_size: [picture[i][0], picture[i][1]],
                    right: right_of(i),
                };
                crop_to_full(&camera, options.focal_px)
            }
            (.., Some(full)) => Some(Vector3::from_column_slice(&full[i])),
            _ => about_crop.as_ref().map(|t| {
                let x = if right_of(i) { t[i][0] } else { -t[i][0] };
                Vector3::new(x, t[i][1], t[i][2])
            }),
        }
    };
    let in_picture = crop.is_some() && center.is_some() && size.is_some() && picture.is_some();
    if !in_picture && full.is_none() {
        raw.notes.push(
            "HaMeR's box_center, box_size and img_size are not in the file: the wrist's path is not that of the whole picture".into(),
        );
    } else if options.focal_px.is_none() || !in_picture {
        raw.notes.push("the focal length is HaMeR's guess: depth is not metric; give the camera's focal length".into());
    }
    let nowhere = (0..raw.frames.len()).filter(|&i| translation(i).is_none()).count();
    if nowhere > 0 {
        raw.notes
            .push(format!("{nowhere} of HaMeR's frames have no place in the camera's frame and stay about the origin"));
    }
    for (i, frame) in raw.frames.iter_mut().enumerate() {
        if !right_of(i) {
            frame.points = mirrored(&frame.points);
            frame.wrist = frame.wrist.map(mirrored_rotation);
        }
        let t = translation(i).unwrap_or_else(Vector3::zeros);
        frame.points = frame.points.map(|p| p.map(|p| p + t));
    }
    Ok(())
}

/// Where detections of both hands are mixed, those of the hand asked for stay, else those of the one seen more often.
fn keep_one_side(raw: &mut RawDemonstration, right: &[bool], options: &LoadOptions) {
    let rights = right.iter().filter(|r| **r).count();
    let (more, fewer) =
        if 2 * rights >= right.len() { (Side::Right, right.len() - rights) } else { (Side::Left, rights) };
    let side = options.side.filter(|_| fewer > 0).unwrap_or(more);
    raw.side = Some(side);
    if fewer > 0 {
        let mut dropped = 0;
        for (frame, _) in raw.frames.iter_mut().zip(right).filter(|(_, r)| **r != (side == Side::Right)) {
            frame.points = KeyPoints::default();
            dropped += 1;
        }
        raw.notes.push(format!("{dropped} detections are of the other hand and are left out"));
    }
}

/// Puts detections at the numbers of their frames; frames without one are hands that were not seen.
fn spread(path: &Path, raw: &mut RawDemonstration, numbers: &[Vec<f64>]) -> Result<()> {
    let refuse = |what: String| Error::content(path, None, what, "number the frames from 0");
    let last = numbers.iter().map(|r| r[0]).fold(0.0, f64::max);
    if numbers.iter().any(|r| !(r[0] >= 0.0 && r[0].fract() == 0.0)) || !(last < MOST_FRAMES as f64) {
        return Err(refuse(format!("frame numbers up to {last} that are not whole or not below {MOST_FRAMES}")));
    }
    let count = if numbers.is_empty() { 0 } else { last as usize + 1 };
    let mut frames = vec![RawFrame::new(KeyPoints::default()); count];
    let mut doubled = 0;
    for (frame, number) in raw.frames.drain(..).zip(numbers) {
        let slot = &mut frames[number[0] as usize];
        // Of several detections the surest counts.
        let seen = |f: &RawFrame| f.points.iter().any(Option::is_some);
        if seen(slot) && seen(&frame) {
            doubled += 1;
        }
        if !seen(slot) || seen(&frame) && frame.score.unwrap_or(0.0) > slot.score.unwrap_or(0.0) {
            *slot = frame;
        }
    }
    if doubled > 0 {
        raw.notes.push(format!("{doubled} frames have more than one detection: the surest, or the first, is taken"));
    }
    raw.frames = frames;
    Ok(())
}

/// Key points of every frame; a coordinate that is not finite makes a point that was not seen.
fn points_of(path: &Path, table: &Table) -> Result<Vec<KeyPoints>> {
    let rows = table.rows(path, &POINT_FORMS, "key points")?;
    let hand = |row: &[f64]| {
        let width = if row.len() == 25 * 7 { 7 } else { 3 };
        let node = |i: usize| {
            let [x, y, z] = [0, 1, 2].map(|c| row[width * i + c]);
            [x, y, z].iter().all(|v| v.is_finite()).then(|| Point3::new(x, y, z))
        };
        let glove = row.len() != 3 * KEYPOINTS;
        std::array::from_fn(|i| node(if glove { MANUS_NODES[i] } else { i }))
    };
    Ok(rows.map(hand).collect())
}

fn rotations(path: &Path, rows: &[Vec<f64>], what: &str) -> Result<Vec<Option<UnitQuaternion<f64>>>> {
    let one = |(i, row): (usize, &Vec<f64>)| rotation_of(row).map_err(|e| Error::at(path, None, at_frame(i, what, e)));
    rows.iter().enumerate().map(one).collect()
}
