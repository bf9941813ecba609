//! What is measured of a human hand: how long the bones are, and how the palm's points lie to one another.

use drex_core::Pose;
use drex_demo::{HandFrame, HumanFinger, KeyPoints, OperatorFrameError, Side, canonical, operator_frame};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::frame_checks::valid_points;

/// Medians over the frames seen so far.
#[derive(Debug, Clone)]
pub(crate) struct HandMeasurements {
    side: Side,
    /// Per finger of [`MEASURED`] and bone from the wrist on, its lengths in ascending order.
    bones: [[Vec<f64>; 4]; 3],
    /// Per point of [`PALM`] and coordinate, its places in the operator frame in ascending order.
    palm: [[Vec<f64>; 3]; 6],
}

/// Fingers that the hand's length is measured on, in the order of preference.
const MEASURED: [HumanFinger; 3] = [HumanFinger::Middle, HumanFinger::Index, HumanFinger::Ring];
/// Key points that move as one: wrist, root of the thumb, knuckles.
const PALM: [usize; 6] = [0, 1, 5, 9, 13, 17];
/// Lengths of a hand outside of this are no lengths of a hand in any unit, m.
const LENGTHS_M: std::ops::Range<f64> = 1e-6..1e6;
/// Frames of a sequence that are measured, at most and evenly.
const MEASURED_FRAMES: usize = 1000;
/// Points with less breadth than this part of their length say nothing about the turn around that length (squares).
const THIN: f64 = 0.05;

impl HandMeasurements {
    /// Nobody yet.
    pub(crate) fn new(side: Side) -> Self {
        Self { side, bones: Default::default(), palm: Default::default() }
    }

    /// Of a sequence.
    pub(crate) fn of(frames: &[HandFrame], side: Side) -> Self {
        let mut measurements = Self::new(side);
        for frame in frames.iter().step_by(frames.len().div_ceil(MEASURED_FRAMES).max(1)) {
            measurements.add(&valid_points(&frame.points).0);
        }
        measurements
    }

    /// Adds a frame.
    pub(crate) fn add(&mut self, points: &KeyPoints) {
        for (finger, bones) in MEASURED.iter().zip(&mut self.bones) {
            let mut from = points[0];
            for (bone, seen) in bones.iter_mut().enumerate() {
                let to = points[finger.base() + bone];
                if let (Some(a), Some(b)) = (from, to) {
                    insert(seen, (b - a).norm());
                }
                from = to;
            }
        }
        if let Ok(points) = canonical(points, self.side) {
            for (i, places) in PALM.iter().zip(&mut self.palm) {
                for (coordinate, seen) in points[*i].iter().flat_map(|p| p.iter()).zip(places) {
                    insert(seen, *coordinate);
                }
            }
        }
    }

    /// Number of frames that the scarcest bone was seen in.
    pub(crate) fn frames(&self) -> usize {
        self.bones.iter().map(|bones| bones.iter().map(Vec::len).min().unwrap_or(0)).max().unwrap_or(0)
    }

    /// Length of the hand: the medians of its bones, added up.
    pub(crate) fn hand_length_m(&self) -> Option<f64> {
        let length = self.bones.iter().find_map(|bones| bones.iter().map(|seen| median(seen)).sum::<Option<f64>>())?;
        LENGTHS_M.contains(&length).then_some(length)
    }

    /// The operator frame of the key points; where one of its three points is missing, from what else is seen of the palm.
    pub(crate) fn operator_frame(&self, points: &KeyPoints) -> Result<Pose, OperatorFrameError> {
        let direct = operator_frame(points, self.side);
        match direct {
            Err(OperatorFrameError::Missing(_)) => self.fitted(points).ok_or(()).or(direct),
            _ => direct,
        }
    }

    /// The pose in which the human palm fits the points best (least squares; Kabsch, Acta Cryst. A32, 1976).
    fn fitted(&self, points: &KeyPoints) -> Option<Pose> {
        let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = PALM
            .iter()
            .zip(&self.palm)
            .filter_map(|(&i, [x, y, z])| Some((Vector3::new(median(x)?, median(y)?, median(z)?), points[i]?.coords)))
            .collect();
        let n = pairs.len() as f64;
        let sums = pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |s, p| (s.0 + p.0, s.1 + p.1));
        let (from, to) = (sums.0 / n, sums.1 / n);
        let spread: Matrix3<f64> = pairs.iter().map(|p| (p.1 - to) * (p.0 - from).transpose()).sum();
        if pairs.len() < 3 || !spread.iter().all(|v| v.is_finite()) {
            return None;
        }
        let svd = spread.svd(true, true);
        let (u, vt) = (svd.u?, svd.v_t?);
        let mut sizes = svd.singular_values;
        sizes.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
        if !(sizes[1] > THIN * sizes[0]) {
            return None;
        }
        // The smallest direction is turned around where that makes a rotation.
        let mut turned = Matrix3::identity();
        turned[(svd.singular_values.imin(), svd.singular_values.imin())] = (u * vt).determinant().signum();
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * turned * vt));
        let origin = Point3::from(to - rotation * from);
        Some(Isometry3::from_parts(Translation3::from(origin.coords), rotation))
    }
}

fn insert(seen: &mut Vec<f64>, value: f64) {
    seen.insert(seen.partition_point(|v| *v < value), value);
}

fn median(seen: &[f64]) -> Option<f64> {
    seen.get(seen.len() / 2).copied()
}
