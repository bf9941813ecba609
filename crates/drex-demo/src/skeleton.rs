//! A human hand made of bones: key points without a recording, for examples, tests and benches.

use drex_core::Pose;
use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::{Demonstration, HandFrame, HumanFinger, KEYPOINTS, KeyPoints, Side, mirrored};

/// A hand whose bones have the lengths of an adult's, times [`HandSkeleton::size`].
///
/// At zero angles the fingers are straight and side by side, the thumb is spread in the plane of the palm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandSkeleton {
    /// Which hand.
    pub side: Side,
    /// Factor on all lengths; 1 has 185 mm from the wrist to the middle fingertip.
    pub size: f64,
}

/// Angles of a finger, rad. Of the thumb, `spread` opposes it: it turns towards the palm about the direction of the fingers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FingerAngles {
    /// To the thumb's side at the knuckle.
    pub spread: f64,
    /// Flexion of the three joints, from the palm to the tip.
    pub flexion: [f64; 3],
}

/// Right hand in the operator frame, m: where the finger leaves the palm, and its bones.
const FINGERS: [([f64; 3], [f64; 3]); 5] = [
    ([0.012, 0.022, 0.022], [0.045, 0.032, 0.027]),
    ([0.0, 0.024, 0.092], [0.042, 0.024, 0.020]),
    ([0.0, 0.0, 0.093], [0.045, 0.027, 0.020]),
    ([0.0, -0.020, 0.087], [0.041, 0.026, 0.020]),
    ([0.0, -0.038, 0.077], [0.033, 0.019, 0.018]),
];
/// The straight thumb lies this far aside of the fingers, rad.
const THUMB_ASIDE: f64 = 0.9;

impl HandSkeleton {
    /// A hand of average size.
    pub fn new(side: Side) -> Self {
        Self { side, size: 1.0 }
    }

    /// The key points at these angles (thumb first), in the frame that `source_from_operator` leads to; the operator frame of
    /// the points is that one, exactly but for rounding.
    pub fn points(&self, angles: &[FingerAngles; 5], source_from_operator: &Pose) -> KeyPoints {
        let mut points: KeyPoints = [None; KEYPOINTS];
        points[0] = Some(Point3::origin());
        for (finger, angles) in HumanFinger::ALL.into_iter().zip(angles) {
            let (base, bones) = FINGERS[finger as usize];
            let mut at = Point3::from(base) * self.size;
            let mut frame = match finger {
                // Opposed about the fingers' direction, then aside.
                HumanFinger::Thumb => {
                    Rotation3::from_axis_angle(&Vector3::z_axis(), -angles.spread)
                        * Rotation3::from_axis_angle(&Vector3::x_axis(), -THUMB_ASIDE)
                }
                _ => Rotation3::from_axis_angle(&Vector3::x_axis(), -angles.spread),
            };
            // The thumb bends across the palm, the fingers towards it.
            let hinge = if finger == HumanFinger::Thumb { Vector3::x_axis() } else { Vector3::y_axis() };
            points[finger.base()] = Some(at);
            for (k, (bone, flexion)) in bones.iter().zip(angles.flexion).enumerate() {
                frame *= Rotation3::from_axis_angle(&hinge, flexion);
                at += frame * Vector3::z() * (bone * self.size);
                points[finger.base() + 1 + k] = Some(at);
            }
        }
        // Mirrored at x, then half a turn about z: the mirror image with y turned around.
        let half_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
        let points = match self.side {
            Side::Right => points,
            Side::Left => mirrored(&points).map(|p| p.map(|p| half_turn * p)),
        };
        points.map(|p| p.map(|p| source_from_operator * p))
    }

    /// A sequence of `frames` frames at 30 per second: the hand opens and closes while it turns and moves, each finger in its own
    /// time.
    pub fn moving(&self, frames: usize) -> Demonstration {
        let frame = |k: usize| {
            let t = k as f64 / 30.0;
            let wave = |rate: f64, phase: f64| 0.5 - 0.5 * (rate * t + phase).cos();
            let angles = std::array::from_fn(|i| {
                let close = wave(2.0, -0.25 * i as f64);
                match i {
                    0 => {
                        FingerAngles { spread: 0.4 + 0.8 * wave(1.3, 0.0), flexion: [0.2, 0.5, 0.7].map(|f| f * close) }
                    }
                    _ => FingerAngles {
                        spread: 0.1 * (2.0 - i as f64) * wave(0.9, 1.0),
                        flexion: [1.1, 1.3, 0.8].map(|f| f * close),
                    },
                }
            });
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.5, -0.4) * (0.7 * t).sin());
            let place = Translation3::new(0.05 * t.sin(), 0.03 * (1.7 * t).cos(), 0.4);
            HandFrame::new(t, self.points(&angles, &Pose::from_parts(place, turn)))
        };
        Demonstration::new("a hand made of bones", self.side, (0..frames).map(frame).collect())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::{hand_length_m, operator_frame};

    #[test]
    fn the_operator_frame_is_the_one_that_was_given() {
        let source_from_operator = Pose::new(Vector3::new(0.1, -0.2, 0.4), Vector3::new(0.3, -1.2, 2.0));
        for side in [Side::Right, Side::Left] {
            let hand = HandSkeleton { side, size: 1.2 };
            let angles = [FingerAngles { spread: 0.1, flexion: [0.5, 0.4, 0.3] }; 5];
            let points = hand.points(&angles, &source_from_operator);
            let found = operator_frame(&points, side).unwrap();
            assert!((found.inverse() * source_from_operator).rotation.angle() < 1e-12);
            assert!((found.translation.vector - source_from_operator.translation.vector).norm() < 1e-12);
            assert!((hand_length_m(&points).unwrap() - 1.2 * 0.185).abs() < 1e-12);
            // Bent fingers are in front of the palm, the thumb on its side.
            let inside = points.map(|p| p.map(|p| source_from_operator.inverse() * p));
            assert!(HumanFinger::ALL[1..].iter().all(|f| inside[f.tip()].unwrap().x > 0.03));
            let thumb = inside[HumanFinger::Thumb.tip()].unwrap();
            assert!(thumb.y * if side == Side::Right { 1.0 } else { -1.0 } > 0.02, "{thumb}");
        }
    }

    #[test]
    fn left_is_the_mirror_image_of_right() {
        let sequence = |side| HandSkeleton::new(side).moving(20).frames;
        for (right, left) in sequence(Side::Right).iter().zip(sequence(Side::Left)) {
            let own = |f: &HandFrame, side| operator_frame(&f.points, side).unwrap().inverse();
            let (to_right, to_left) = (own(right, Side::Right), own(&left, Side::Left));
            for (a, b) in right.points.iter().zip(&left.points) {
                let (a, b) = (to_right * a.unwrap(), to_left * b.unwrap());
                assert!((Point3::new(a.x, -a.y, a.z) - b).norm() < 1e-12);
            }
        }
    }
}
