//! Quality of a recording, before it is retargeted.

use drex_core::Surface;
use drex_core::pose::MAX_POSITION_M;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::keypoints::PARENT;
use crate::{Demonstration, HumanFinger, KEYPOINTS, KeyPoints, Side, hand_length_m, median, operator_frame};

/// Quality of a demonstration, as [`Demonstration::check`] finds it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InputReport {
    /// Share of all key points that were not seen.
    pub missing_share: f64,
    /// Median length of the hand ([`hand_length_m`]), m.
    pub hand_length_m: Option<f64>,
    /// Median over bones and frames of how far a bone's length is from its median, relative. A glove or MANO gives less than 0.01,
    /// MediaPipe 0.01 to 0.05.
    pub bone_spread: Option<f64>,
    /// Median time between frames, s.
    pub interval_s: Option<f64>,
    /// Frames whose flags are not empty.
    pub flagged: usize,
    /// Result of each frame.
    pub frames: Vec<FrameCheck>,
    /// What is odd, one sentence each.
    pub notes: Vec<String>,
}

/// Quality of one frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FrameCheck {
    /// Number of the frame in the recording.
    pub index: usize,
    /// Reasons not to trust the frame.
    pub flags: Vec<FrameFlag>,
    /// Distance of the nearest fingertip to the object's surface, mm, where both are known.
    pub object_distance_mm: Option<f64>,
}

/// Why a frame is not to be trusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
#[serde(tag = "flag", rename_all = "snake_case")]
pub enum FrameFlag {
    /// The key points define no hand: the previous joint vector is repeated.
    NoHand {
        /// Reason that the key points define no hand.
        reason: String,
    },
    /// Key points are missing; the rest was used.
    MissingPoints {
        /// Number of missing key points.
        count: usize,
    },
    /// The hand jumped since the frame before.
    Jump {
        /// Largest movement of a wrist-centred key point, mm.
        distance_mm: f64,
    },
    /// The frame does not come after the one before.
    Time {
        /// Time since the frame before, s.
        step_s: f64,
    },
    /// The object's pose is missing: that on the way between the frames around was taken.
    ObjectNotSeen,
    /// The object is not where the hand is: another frame, or a lost track.
    FarFromObject {
        /// Distance from the wrist to the origin of the object's mesh, mm.
        distance_mm: f64,
    },
    /// The lengths of the bones are not those of the rest of the sequence.
    BoneLength {
        /// Hand length over the sequence's median.
        ratio: f64,
    },
}

/// A frame lies this far off the course of its neighbours before it is a jump, at least: metres, and in robust standard deviations of the sequence.
const JUMP: (f64, f64) = (0.03, 10.0);
/// Normal standard deviation per median absolute deviation.
const MAD_TO_SIGMA: f64 = 1.4826;
/// Length of the hand over the sequence's median.
const LENGTH_RATIO: (f64, f64) = (0.8, 1.25);
/// A fingertip is touching, or is about to, below this distance; a grasp in which none does is badly tracked, metres.
const NEAR_M: f64 = 0.03;
/// An object this far from the hand is in another frame, metres.
const OTHER_FRAME_M: f64 = 1.5;
/// Share of all bending of the fingers that may be backwards before the hand must be the other one.
const BACKWARDS: f64 = -0.5;

impl Demonstration {
    /// Looks the recording over: points not seen, lengths of bones, jumps, times, side, place of the object.
    pub fn check(&self) -> InputReport {
        self.check_against(None)
    }

    /// As [`Demonstration::check`], and how far the fingertips are from the object's surface (in the frame of the object's mesh).
    pub fn check_with_object(&self, object: &dyn Surface) -> InputReport {
        self.check_against(Some(object))
    }

    fn check_against(&self, object: Option<&dyn Surface>) -> InputReport {
        let mut frames: Vec<FrameCheck> = self
            .frames
            .iter()
            .map(|f| FrameCheck { index: f.index, flags: Vec::new(), object_distance_mm: None })
            .collect();
        let mut notes = Vec::new();
        let missing_share = self.missing(&mut frames, &mut notes);
        let (hand_length_m, bone_spread) = self.bones(&mut frames, &mut notes);
        self.jumps(&mut frames);
        let interval_s = self.times(&mut frames, &mut notes);
        self.side_of_the_bend(&mut notes);
        self.object(object, &mut frames, &mut notes);
        let flagged = frames.iter().filter(|f| !f.flags.is_empty()).count();
        InputReport { missing_share, hand_length_m, bone_spread, interval_s, flagged, frames, notes }
    }

    fn missing(&self, frames: &mut [FrameCheck], notes: &mut Vec<String>) -> f64 {
        let mut total = 0;
        for (check, frame) in frames.iter_mut().zip(&self.frames) {
            let count = frame.points.iter().filter(|p| !p.is_some_and(|p| p.iter().all(|v| v.is_finite()))).count();
            total += count;
            if let Err(e) = operator_frame(&frame.points, self.side) {
                check.flags.push(FrameFlag::NoHand { reason: e.to_string() });
            } else if count > 0 {
                check.flags.push(FrameFlag::MissingPoints { count });
            }
        }
        let share = total as f64 / (KEYPOINTS * self.frames.len()).max(1) as f64;
        if share > 0.05 {
            notes.push(format!("{:.0} % of the key points were not seen", 100.0 * share));
        }
        share
    }

    fn bones(&self, frames: &mut [FrameCheck], notes: &mut Vec<String>) -> (Option<f64>, Option<f64>) {
        let lengths: Vec<Option<f64>> = self.frames.iter().map(|f| hand_length_m(&f.points)).collect();
        let typical = median(&mut lengths.iter().flatten().copied().collect::<Vec<_>>());
        let Some(typical) = typical else { return (None, None) };
        for (check, length) in frames.iter_mut().zip(&lengths) {
            if let Some(ratio) = length.map(|l| l / typical)
                && !(LENGTH_RATIO.0..=LENGTH_RATIO.1).contains(&ratio)
            {
                check.flags.push(FrameFlag::BoneLength { ratio });
            }
        }
        let mut spreads = Vec::new();
        for bone in 1..KEYPOINTS {
            let length = |p: &KeyPoints| Some((p[bone]? - p[PARENT[bone]]?).norm()).filter(|l| l.is_finite());
            let mut all: Vec<f64> = self.frames.iter().filter_map(|f| length(&f.points)).collect();
            if let Some(usual) = median(&mut all).filter(|m| *m > 0.0) {
                spreads.extend(all.iter().map(|l| (l / usual - 1.0).abs()));
            }
        }
        let spread = median(&mut spreads);
        if let Some(s) = spread.filter(|s| *s > 0.08) {
            notes.push(format!(
                "bones change their length by {:.0} % in the middle of all: the tracking is poor",
                100.0 * s
            ));
        }
        (Some(typical), spread)
    }

    /// A jump leaves the course of its neighbours; fast motion does not.
    fn jumps(&self, frames: &mut [FrameCheck]) {
        let off_course = |i: usize, about_wrist: bool| -> Option<f64> {
            let points = |k: usize| {
                let p = &self.frames[k].points;
                let origin = if about_wrist { p[0]? } else { Point3::origin() };
                Some(p.map(|q| q.map(|q| q - origin.coords)))
            };
            let (before, here, after) = (points(i - 1)?, points(i)?, points(i + 1)?);
            let used = if about_wrist { 1..KEYPOINTS } else { 0..1 };
            let off = used.filter_map(|k| Some((here[k]? - nalgebra::center(&before[k]?, &after[k]?)).norm()));
            off.fold(None, |worst: Option<f64>, d| Some(worst.map_or(d, |w| w.max(d)))).filter(|d| d.is_finite())
        };
        let inner = 1..self.frames.len().saturating_sub(1);
        let all: Vec<(usize, f64)> =
            inner.flat_map(|i| [true, false].map(|about| Some((i, off_course(i, about)?)))).flatten().collect();
        let mut distances: Vec<f64> = all.iter().map(|(_, d)| *d).collect();
        let Some(middle) = median(&mut distances) else { return };
        let mut off: Vec<f64> = distances.iter().map(|d| (d - middle).abs()).collect();
        let sigma = MAD_TO_SIGMA * median(&mut off).unwrap_or(0.0);
        let limit = JUMP.0.max(middle + JUMP.1 * sigma);
        for (i, distance) in all.into_iter().filter(|(_, d)| *d > limit) {
            let flags = &mut frames[i].flags;
            if !flags.iter().any(|f| matches!(f, FrameFlag::Jump { .. })) {
                flags.push(FrameFlag::Jump { distance_mm: 1e3 * distance });
            }
        }
    }

    fn times(&self, frames: &mut [FrameCheck], notes: &mut Vec<String>) -> Option<f64> {
        let mut bad = 0;
        let mut steps = Vec::new();
        for (i, pair) in self.frames.windows(2).enumerate() {
            let step = pair[1].t_s - pair[0].t_s;
            if step > 0.0 && step.is_finite() {
                steps.push(step);
            } else {
                bad += 1;
                frames[i + 1].flags.push(FrameFlag::Time { step_s: if step.is_finite() { step } else { 0.0 } });
            }
        }
        if bad > 0 {
            notes.push(format!("{bad} times do not come after the time before"));
        }
        let usual = median(&mut steps);
        if let Some(usual) = usual {
            let gaps = steps.iter().filter(|s| **s > 3.5 * usual).count();
            if gaps > 0 {
                notes.push(format!("{gaps} gaps of more than three frames"));
            }
        }
        let still = self.frames.windows(2).filter(|w| w[0].points == w[1].points && w[0].points[0].is_some()).count();
        if 10 * still > self.frames.len() {
            notes.push(format!("{still} frames repeat the one before"));
        }
        usual
    }

    /// Fingers bend towards the palm. If they seem to bend backwards, the hand is the other one.
    fn side_of_the_bend(&self, notes: &mut Vec<String>) {
        let (mut sum, mut total) = (0.0, 0.0);
        for frame in &self.frames {
            let Ok(operator) = operator_frame(&frame.points, self.side) else { continue };
            let palm = operator * nalgebra::Vector3::x();
            for finger in &HumanFinger::ALL[1..] {
                let at = |i: usize| frame.points[i];
                let (Some(base), Some(middle), Some(tip)) = (at(finger.base()), at(finger.middle()), at(finger.tip()))
                else {
                    continue;
                };
                let (first, rest) = (middle - base, tip - middle);
                let Some(along) = first.try_normalize(1e-9) else { continue };
                let bend = (rest - along * along.dot(&rest)).dot(&palm);
                if bend.is_finite() {
                    sum += bend;
                    total += bend.abs();
                }
            }
        }
        if total > 0.0 && sum / total < BACKWARDS {
            let other = if self.side == Side::Right { "left" } else { "right" };
            notes.push(format!("the fingers bend backwards: this seems to be a {other} hand, or a mirrored recording"));
        }
    }

    fn object(&self, object: Option<&dyn Surface>, frames: &mut [FrameCheck], notes: &mut Vec<String>) {
        let posed = self.frames.iter().filter(|f| f.source_from_object.is_some()).count();
        if posed == 0 {
            return;
        }
        if posed < self.frames.len() {
            notes.push(format!("{} frames have no object pose", self.frames.len() - posed));
        }
        let mut away = 0;
        for (check, frame) in frames.iter_mut().zip(&self.frames) {
            let (Some(pose), Some(wrist)) = (frame.source_from_object, frame.points[0]) else { continue };
            let distance = (wrist.coords - pose.translation.vector).norm();
            if !(distance < OTHER_FRAME_M) {
                away += 1;
                check.flags.push(FrameFlag::FarFromObject { distance_mm: 1e3 * distance.min(MAX_POSITION_M) });
            } else if let Some(surface) = object {
                let near = HumanFinger::ALL.iter().filter_map(|f| {
                    let p = pose.inverse_transform_point(&frame.points[f.tip()]?);
                    Some((surface.nearest(&p).point - p).norm()).filter(|d| d.is_finite())
                });
                check.object_distance_mm = near.min_by(f64::total_cmp).map(|d| 1e3 * d);
            }
        }
        if away > 0 {
            notes.push(format!(
                "in {away} frames the object is more than {OTHER_FRAME_M} m from the hand: is it in the same frame?"
            ));
        }
        let nearest = frames.iter().filter_map(|f| f.object_distance_mm).min_by(f64::total_cmp);
        if let Some(d) = nearest.filter(|d| *d > 1e3 * NEAR_M) {
            notes.push(format!(
                "no fingertip comes nearer to the object than {d:.0} mm: hand and object do not fit together"
            ));
        }
    }
}
