//! What is wrong with a frame, seen from the frame and those before it.

use drex_demo::{FrameFlag, KEYPOINTS, KeyPoints, hand_length_m};

/// Key points farther than this from the origin are no measurement, m.
const FARTHEST_M: f64 = 1e6;
/// A point that moves by this part of the hand's length from one frame to the next, and by [`SUDDEN`] times the median of such
/// movements, jumped.
const JUMP: f64 = 0.4;
const SUDDEN: f64 = 5.0;
/// Hand lengths over the median outside of this are not of the same hand.
const SAME_HAND: std::ops::Range<f64> = 0.75..1.33;
/// Number of movements that the median is taken of.
const REMEMBERED: usize = 60;

/// The points that are measurements, and how many are not.
pub(crate) fn valid_points(points: &KeyPoints) -> (KeyPoints, usize) {
    let cleaned = points.map(|p| p.filter(|p| p.iter().all(|c| c.is_finite() && c.abs() < FARTHEST_M)));
    let missing = cleaned.iter().filter(|p| p.is_none()).count();
    (cleaned, missing)
}

/// Compares each frame with those before.
#[derive(Debug, Clone, Default)]
pub(crate) struct FrameMonitor {
    /// Wrist-centred points of the last frame that was a hand.
    last: Option<KeyPoints>,
    /// Largest movements of the latest frames, oldest first.
    movements: Vec<f64>,
}

impl FrameMonitor {
    /// Flags of a frame; `points` in the operator frame, `length` the hand's length.
    pub(crate) fn check(
        &mut self,
        points: &KeyPoints,
        missing: usize,
        length: Option<f64>,
        flags: &mut Vec<FrameFlag>,
    ) {
        if missing > 0 {
            flags.push(FrameFlag::MissingPoints { count: missing });
        }
        if let Some(last) = self.last.replace(*points) {
            let moved = |i: usize| Some((points[i]? - last[i]?).norm());
            let movement = (0..KEYPOINTS).filter_map(moved).fold(0.0, f64::max);
            let mut sorted = self.movements.clone();
            sorted.sort_by(f64::total_cmp);
            let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
            if let Some(length) = length
                && movement > JUMP * length
                && movement > SUDDEN * usual
            {
                flags.push(FrameFlag::Jump { distance_mm: movement * 1e3 });
            }
            if self.movements.len() == REMEMBERED {
                self.movements.remove(0);
            }
            self.movements.push(movement);
        }
        if let (Some(length), Some(now)) = (length, hand_length_m(points)) {
            let ratio = now / length;
            if !SAME_HAND.contains(&ratio) {
                flags.push(FrameFlag::BoneLength { ratio });
            }
        }
    }
}
