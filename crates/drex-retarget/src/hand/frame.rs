//! The hand at rest, and which way its fingers point and bend.

use std::path::Path;

use drex_core::Pose;
use drex_demo::HumanFinger;
use drex_robot::{JointKind, Robot};
use nalgebra::{Point3, Vector3};

use super::LinkPoint;
use super::mapping::{Mapping, find_link};
use crate::{Error, Result};

/// Joints nearer to each other than this say nothing about a direction, m.
const SAME_PLACE: f64 = 5e-3;
/// Fingers whose ranges are so even that they bend to both sides alike, rad, say nothing about where the palm is.
const BOTH_WAYS: f64 = 0.05;

/// A finger before it has its human finger.
#[derive(Debug, Clone)]
pub(super) struct FingerCandidate {
    pub(super) human: Option<HumanFinger>,
    pub(super) thumb: bool,
    pub(super) tip: LinkPoint,
    pub(super) middle: Option<LinkPoint>,
    /// Joints between palm and tip.
    pub(super) joints: Vec<usize>,
}

/// A model and what its mapping file says, with all joints at zero (or as near as their limits allow): fingers straight.
pub(super) struct Rest<'a> {
    pub(super) robot: &'a Robot,
    pub(super) mapping: &'a Mapping,
    /// For messages.
    path: &'a Path,
    /// Joints that move the palm.
    pub(super) palm_joints: Vec<usize>,
    q: Vec<f64>,
    /// Of the links, in the frame of the base.
    pub(super) poses: Vec<Pose>,
}

impl<'a> Rest<'a> {
    pub(super) fn new(robot: &'a Robot, path: &'a Path, mapping: &'a Mapping, palm_joints: Vec<usize>) -> Self {
        let mut q = vec![0.0; robot.dof()];
        robot.clamp_to_limits(&mut q);
        robot.apply_mimic(&mut q);
        let poses = robot.forward_kinematics(&q, &Pose::identity());
        Self { robot, mapping, path, palm_joints, q, poses }
    }

    /// A point of a link.
    pub(super) fn at(&self, p: &LinkPoint) -> Point3<f64> {
        self.poses[p.link] * p.point
    }

    /// Where a joint is.
    pub(super) fn joint(&self, j: usize) -> Point3<f64> {
        self.robot.joint_axis(&self.poses, j).1
    }

    /// Every joint in the middle of its range.
    pub(super) fn half_closed(&self) -> Vec<f64> {
        let mut q = self.robot.mid_range();
        self.robot.apply_mimic(&mut q);
        q
    }

    /// Mean of the joints and the tip of a finger: which side of the hand it is on.
    pub(super) fn middle_of(&self, joints: &[usize], tip: &LinkPoint) -> Vector3<f64> {
        mean(joints.iter().map(|&j| self.joint(j).coords).chain([self.at(tip).coords]))
    }

    /// Whether `link` is one shape with the palm.
    pub(super) fn on_palm(&self, link: usize) -> bool {
        let movers = joints_to(self.robot, link);
        movers.len() == self.palm_joints.len() && movers.iter().all(|j| self.palm_joints.contains(j))
    }

    /// What is wrong with entry `key`, and what to do about it.
    pub(super) fn fail<T>(&self, key: &str, what: impl Into<String>, remedy: impl Into<String>) -> Result<T> {
        Err(Error::mapping(self.path, key, what, remedy))
    }

    /// Index of the link that entry `key` names.
    pub(super) fn find_link(&self, key: &str, name: &str) -> Result<usize> {
        find_link(self.robot, self.path, key, name)
    }
}

/// The joints from the base to `link`, in that order.
pub(super) fn joints_to(robot: &Robot, link: usize) -> Vec<usize> {
    robot.path_to(link).into_iter().flat_map(|l| robot.links[l].joints.iter().copied()).collect()
}

pub(super) fn mean(vectors: impl Iterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let (sum, n) = vectors.fold((Vector3::zeros(), 0), |(sum, n), v| (sum + v, n + 1));
    sum / f64::from(n.max(1))
}

/// What the fingers beside the thumb do, in the frame of the base.
pub(super) struct Bends {
    /// Unit vector along the straight fingers.
    pub(super) tips: Vector3<f64>,
    /// Unit vector at right angles to `tips`, the way the fingers bend: out of the palm. `None` if they do not bend, or to both
    /// sides alike and the thumb is on neither.
    pub(super) palm: Option<Vector3<f64>>,
    /// Whether the thumb decided which side the palm is on.
    pub(super) by_thumb: bool,
}

impl Bends {
    pub(super) fn new(rest: &Rest<'_>, fingers: &[FingerCandidate]) -> Result<Self> {
        let others = || fingers.iter().filter(|f| !f.thumb);
        let along: Vec<Vector3<f64>> = others().map(|f| direction(rest, f)).collect();
        let Some(tips) = mean(along.iter().copied()).try_normalize(0.1) else {
            return rest.fail(
                "fingers",
                "the fingers beside the thumb point in no common direction when all joints are at zero",
                "this is not built like a human hand; map only fingers that point the same way",
            );
        };
        let curl = mean(others().zip(&along).map(|(f, along)| curl(rest, f, along)));
        let across = |v: Vector3<f64>, least: f64| (v - tips * tips.dot(&v)).try_normalize(least);
        let palm = across(curl, BOTH_WAYS);
        let by_thumb = palm.is_none();
        Ok(Self { tips, palm: palm.or_else(|| across(towards_thumb(rest, fingers, &tips)?, 1e-6)), by_thumb })
    }

    /// Towards the thumb in a right hand.
    pub(super) fn across(&self) -> Option<Vector3<f64>> {
        self.palm.map(|palm| self.tips.cross(&palm))
    }
}

/// Unit vector along the straight finger: from its last joint but one to its last, across the axis of that one.
fn direction(rest: &Rest<'_>, finger: &FingerCandidate) -> Vector3<f64> {
    let tip = rest.at(&finger.tip);
    let Some((&last, before)) = finger.joints.split_last() else { return Vector3::zeros() };
    let (axis, end) = rest.robot.joint_axis(&rest.poses, last);
    let across = |v: Vector3<f64>| match rest.robot.joints[last].kind {
        JointKind::Revolute => v - axis * axis.dot(&v),
        _ => v,
    };
    before
        .last()
        .and_then(|&j| across(end - rest.joint(j)).try_normalize(SAME_PLACE))
        .or_else(|| across(tip - end).try_normalize(1e-6))
        .unwrap_or_else(Vector3::zeros)
}

/// How the last two joints turn a finger that points `along`, from zero to the middle of their ranges, rad.
fn curl(rest: &Rest<'_>, finger: &FingerCandidate, along: &Vector3<f64>) -> Vector3<f64> {
    let mut curl = Vector3::zeros();
    for &j in finger.joints.iter().rev().take(2) {
        let joint = &rest.robot.joints[j];
        if joint.kind == JointKind::Revolute {
            curl += rest.robot.joint_axis(&rest.poses, j).0.cross(along) * middle_of_range(rest, j);
        }
    }
    curl
}

/// At right angles to the fingers and their last hinges, to the side on which the thumb is, if it is on one.
fn towards_thumb(rest: &Rest<'_>, fingers: &[FingerCandidate], tips: &Vector3<f64>) -> Option<Vector3<f64>> {
    let (thumbs, others): (Vec<&FingerCandidate>, Vec<&FingerCandidate>) = fingers.iter().partition(|f| f.thumb);
    let place = |f: &&FingerCandidate| rest.middle_of(&f.joints, &f.tip);
    let thumb = place(thumbs.first()?) - mean(others.iter().map(place));
    let hinges =
        others.iter().filter_map(|f| f.joints.last().filter(|&&j| rest.robot.joints[j].kind == JointKind::Revolute));
    let sides = hinges.map(|&j| {
        let side = rest.robot.joint_axis(&rest.poses, j).0.cross(tips);
        side * side.dot(&thumb).signum()
    });
    let side = mean(sides).try_normalize(0.5)?;
    (side.dot(&thumb) > SAME_PLACE).then_some(side)
}

/// Middle of a joint's range less its value at rest; of the joint that it follows, if it has no limits of its own.
fn middle_of_range(rest: &Rest<'_>, j: usize) -> f64 {
    let joint = &rest.robot.joints[j];
    match (joint.limits, joint.mimic) {
        (Some((lo, hi)), _) => 0.5 * (lo + hi) - rest.q[j],
        (None, Some(m)) => rest.robot.joints[m.joint]
            .limits
            .map_or(0.0, |(lo, hi)| m.multiplier * 0.5 * (lo + hi) + m.offset - rest.q[j]),
        (None, None) => 0.0,
    }
}
