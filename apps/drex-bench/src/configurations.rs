//! Configurations in which a hand can pinch: thumb and fingers face each other, at many widths.

use anyhow::{Result, bail};
use drex_core::Pose;
use drex_demo::{HumanFinger, KEYPOINTS, KeyPoints};
use drex_grasp::abduction_joints;
use drex_retarget::TargetHand;
use drex_robot::{Finger, Robot};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Configurations that are drawn.
const DRAWN: usize = 60_000;
/// Least cosine between the way that a fingertip closes and the line to its counterpart.
const FACING: f64 = 0.75;
/// Widths that are of use, metres.
const WIDTHS_M: (f64, f64) = (0.012, 0.125);
/// How far the flexion of neighbouring fingers differs, rad.
const UNEVEN_RAD: f64 = 0.12;

/// A hand about to pinch.
#[derive(Debug, Clone)]
pub struct Configuration {
    /// Model order, rad.
    pub q: Vec<f64>,
    /// From the thumb's tip to the middle of the other tips, metres.
    pub width_m: f64,
    /// The pinch in the frame of the base: origin in the middle, x from the thumb to the fingers, z away from the palm.
    pub base_from_pinch: Pose,
}

/// Configurations of one hand, narrow ones first.
pub struct Configurations {
    list: Vec<Configuration>,
}

impl Configurations {
    /// The same for the same seed.
    ///
    /// # Errors
    /// If thumb and fingers never face each other.
    pub fn of(target: &TargetHand, seed: u64) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let robot = &target.robot;
        let fingers = robot.fingers();
        let sideways = abduction_joints(robot, &fingers);
        let mut list: Vec<Configuration> = (0..DRAWN)
            .filter_map(|_| configuration(robot, &fingers, draw(robot, &fingers, &sideways, &mut rng)))
            .collect();
        if list.is_empty() {
            bail!(
                "thumb and fingers of \"{}\" never face each other: no pinch can be made up for it",
                target.robot.name
            );
        }
        list.sort_by(|a, b| a.width_m.total_cmp(&b.width_m));
        Ok(Self { list })
    }

    /// A configuration for something that is `width_m` wide, up to `wider_m` more; `None` if the hand has none.
    pub fn any(&self, width_m: f64, wider_m: f64, rng: &mut ChaCha8Rng) -> Option<&Configuration> {
        let from = self.list.partition_point(|p| p.width_m < width_m);
        let to = self.list.partition_point(|p| p.width_m < width_m + wider_m);
        (from < to).then(|| &self.list[rng.random_range(from..to)])
    }
}

/// Joint angles: fingers bent alike, the thumb anywhere.
fn draw(robot: &Robot, fingers: &[Finger], sideways: &[bool], rng: &mut ChaCha8Rng) -> Vec<f64> {
    let mut q = robot.reference_position();
    let bend: [f64; 3] = std::array::from_fn(|_| rng.random());
    for finger in fingers {
        let mut next = 0;
        for &j in &finger.joints {
            let (lo, hi) = robot.joints[j].limits.unwrap_or((0.0, 0.0));
            let share: f64 = rng.random();
            q[j] = if finger.is_thumb {
                lo + share * (hi - lo)
            } else if sideways[j] {
                0.2 * (share - 0.5)
            } else {
                let own = bend[next.min(2)] * 0.85;
                next += 1;
                let lowest = lo.max(0.0);
                lowest + own * (hi - lowest) + UNEVEN_RAD * (share - 0.5)
            };
        }
    }
    robot.clamp_to_limits(&mut q);
    q
}

fn configuration(robot: &Robot, fingers: &[Finger], q: Vec<f64>) -> Option<Configuration> {
    let poses = robot.forward_kinematics(&q, &Pose::identity());
    let tip = |f: &Finger| (poses[f.tip_link] * f.tip_point).coords;
    let thumb = fingers.iter().find(|f| f.is_thumb)?;
    let others: Vec<&Finger> = fingers.iter().filter(|f| !f.is_thumb).collect();
    let middle = others.iter().map(|f| tip(f)).sum::<Vector3<f64>>() / others.len() as f64;
    let between = middle - tip(thumb);
    let width_m = between.norm();
    if !(WIDTHS_M.0..WIDTHS_M.1).contains(&width_m) {
        return None;
    }
    let axis = between / width_m;
    // The way that a tip goes when its last joints, which bend the pad, turn on.
    let closes = |f: &Finger| {
        let last = &f.joints[f.joints.len().saturating_sub(2)..];
        let velocity = last.iter().map(|&j| {
            let (a, at) = robot.joint_axis(&poses, j);
            a.cross(&(tip(f) - at.coords))
        });
        velocity.sum::<Vector3<f64>>().try_normalize(1e-6)
    };
    let fingers_close = others.iter().filter_map(|f| closes(f)).sum::<Vector3<f64>>().try_normalize(1e-6)?;
    if closes(thumb)?.dot(&axis) < FACING || fingers_close.dot(&-axis) < FACING {
        return None;
    }
    let center = Point3::from(0.5 * (middle + tip(thumb)));
    let palm = others.iter().map(|f| poses[f.links[0]].translation.vector).sum::<Vector3<f64>>() / others.len() as f64;
    let base_from_pinch = frame(&center, &axis, &(center.coords - palm))?;
    Some(Configuration { q, width_m, base_from_pinch })
}

/// A frame at `origin` with x along the unit vector `axis` and z as near to `approach` as that allows.
pub fn frame(origin: &Point3<f64>, axis: &Vector3<f64>, approach: &Vector3<f64>) -> Option<Pose> {
    let z = (approach - axis * axis.dot(approach)).try_normalize(1e-6)?;
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[*axis, z.cross(axis), z]));
    Some(Pose::from_parts(Translation3::from(origin.coords), UnitQuaternion::from_rotation_matrix(&turn)))
}

/// Key points of a person whose hand is `size` times the robot's at `q`, in the frame that `object_from_base` leads to; a finger that
/// the robot does not have lies beside its neighbour.
pub fn human(target: &TargetHand, q: &[f64], size: f64, object_from_base: &Pose) -> KeyPoints {
    let poses = target.robot.forward_kinematics(q, object_from_base);
    let wrist = object_from_base * Point3::from(target.base_from_operator.translation.vector);
    let mut points: KeyPoints = [None; KEYPOINTS];
    points[0] = Some(wrist);
    for finger in &target.fingers {
        let scaled = |p: Point3<f64>| wrist + (p - wrist) * size;
        let tip = scaled(poses[finger.tip.link] * finger.tip.point);
        let middle = scaled(poses[finger.middle.link] * finger.middle.point);
        let first = target.robot.path_to(finger.middle.link).into_iter().find(|&l| l != 0);
        let base = first.map_or(middle, |l| scaled(Point3::from(poses[l].translation.vector)));
        let at = finger.human.base();
        points[at..at + 4].copy_from_slice(&[
            Some(base),
            Some(middle),
            Some(nalgebra::center(&middle, &tip)),
            Some(tip),
        ]);
    }
    let (ring, middle, little) = (HumanFinger::Ring.base(), HumanFinger::Middle.base(), HumanFinger::Little.base());
    for k in 0..4 {
        if let (None, Some(r), Some(m)) = (points[little + k], points[ring + k], points[middle + k]) {
            points[little + k] = Some(r + (r - m));
        }
    }
    points
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn both_hands_pinch_from_narrow_to_wide() {
        for name in ["leap_right", "allegro_right"] {
            let target = TargetHand::bundled(name).unwrap();
            let configurations = Configurations::of(&target, 0).unwrap();
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            for width in [0.03, 0.06, 0.09] {
                let configuration = configurations.any(width, 0.015, &mut rng).unwrap();
                // x leads from the thumb's tip to the middle of the others.
                let poses = target.robot.forward_kinematics(&configuration.q, &Pose::identity());
                let thumb = &target.fingers[0];
                let tip = configuration.base_from_pinch.inverse() * (poses[thumb.tip.link] * thumb.tip.point);
                assert!((tip.x + 0.5 * configuration.width_m).abs() < 0.004 && tip.y.abs() < 0.004, "{name}: {tip}");
                let mut q = configuration.q.clone();
                assert_eq!(target.robot.clamp_to_limits(&mut q), 0);
            }
        }
    }
}
