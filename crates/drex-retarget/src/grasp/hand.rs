//! A hand prepared for contact: where its pads are, which joints move which link, what may hit what.

use drex_core::{Pose, SdfSample, SignedDistance};
use drex_demo::HumanFinger;
use drex_grasp::{HandSurface, LinkSurface};
use drex_robot::{Finger, JointKind, Robot};
use nalgebra::{Point3, Vector3};

use super::surface_points::SurfacePoints;
use crate::pad::{Pad, palmar};
use crate::self_collision::CollisionShapes;
use crate::{Error, LinkPoint, Result, TargetFinger, TargetHand};

/// Distance between points on the hand, metres: search and verdict.
const SPACINGS_M: (f64, f64) = (0.005, 0.003);
/// A point of the last link belongs to the pad down to this cosine between its normal and the way the link bends: the palmar half
/// and the very end.
const FACING: f64 = -0.2;

/// A robot hand prepared for [`super::retarget_grasp`].
#[derive(Debug, Clone)]
pub(crate) struct GraspHand<'a> {
    pub(crate) target: &'a TargetHand,
    /// Points per link, for the search.
    pub(crate) search: Vec<SurfacePoints>,
    /// Points per link, for the verdict.
    pub(crate) fine: HandSurface,
    pub(crate) fingers: Vec<FingerPad>,
    /// Index of the thumb in `fingers`.
    pub(crate) thumb: usize,
    /// Per link, the joints that move it.
    pub(crate) movers: Vec<Vec<usize>>,
    /// Collision shapes for the search.
    pub(crate) shapes: CollisionShapes,
}

/// The part of a finger that is meant to touch.
#[derive(Debug, Clone)]
pub(crate) struct FingerPad {
    pub(crate) tip: LinkPoint,
    /// Outermost points behind the last joint, palmar side and end, and the link in whose frame they are.
    points: (usize, SurfacePoints),
    /// All of them, finer, for the verdict.
    pub(crate) fine: Pad,
}

/// Poses of a hand in the object's frame.
#[derive(Debug, Clone)]
pub(crate) struct Posed {
    pub(crate) links: Vec<Pose>,
    /// Axis and a point on it, per joint.
    pub(crate) axes: Vec<(Vector3<f64>, Point3<f64>)>,
}

impl<'a> GraspHand<'a> {
    pub(crate) fn new(target: &'a TargetHand) -> Result<Self> {
        let robot = &target.robot;
        let fine = HandSurface::with_fingers(robot, fingers(target), SPACINGS_M.1)?;
        let points = |l: usize| robot.surface_samples(l, SPACINGS_M.0).into_iter().map(|s| s.0);
        let search: Vec<SurfacePoints> = (0..robot.links.len()).map(|l| SurfacePoints::new(points(l))).collect();
        let Some(thumb) = target.fingers.iter().position(|f| f.human == HumanFinger::Thumb) else {
            return Err(Error::value(
                format!("hand \"{}\" has no thumb in its mapping", robot.name),
                "a grasp needs one: add [fingers.thumb] to the mapping file",
            ));
        };
        let poses = robot.forward_kinematics(&robot.reference_position(), &Pose::identity());
        let pads = target.fingers.iter().map(|f| {
            let points = |spacing_m| pad(robot, &poses, &f.tip, spacing_m);
            let fine = points(SPACINGS_M.1 / 2.0);
            let Some(&(link, _)) = fine.parts.first() else {
                return Err(Error::value(
                    format!(
                        "finger \"{}\" of hand \"{}\" has no collision shapes at its tip",
                        f.human.name(),
                        robot.name
                    ),
                    "add shapes to the last link of the model",
                ));
            };
            // These links are rigidly attached to one another.
            let of_part = |(l, part): &(usize, LinkSurface)| -> Vec<Point3<f64>> {
                let link_from_part = poses[link].inv_mul(&poses[*l]);
                part.samples().iter().map(|s| link_from_part * s.0).collect()
            };
            let points = SurfacePoints::outermost(points(SPACINGS_M.0 / 2.0).parts.iter().flat_map(of_part).collect());
            Ok(FingerPad { tip: f.tip, points: (link, points), fine })
        });
        let fingers = pads.collect::<Result<Vec<_>>>()?;
        let movers = (0..robot.links.len())
            .map(|l| robot.path_to(l).into_iter().flat_map(|i| robot.links[i].joints.iter().copied()).collect())
            .collect();
        Ok(Self { target, search, fine, fingers, thumb, movers, shapes: CollisionShapes::new(robot) })
    }

    pub(crate) fn posed(&self, q: &[f64], object_from_base: &Pose) -> Posed {
        let robot = &self.target.robot;
        let links = robot.forward_kinematics(q, object_from_base);
        let axes = (0..robot.dof()).map(|j| robot.joint_axis(&links, j)).collect();
        Posed { links, axes }
    }

    /// Velocity of the point of a link per unit of joint `j`.
    pub(crate) fn velocity(&self, posed: &Posed, j: usize, point: &Point3<f64>) -> Vector3<f64> {
        let (axis, anchor) = &posed.axes[j];
        match self.target.robot.joints[j].kind {
            JointKind::Prismatic => *axis,
            _ => axis.cross(&(point - anchor)),
        }
    }
}

impl FingerPad {
    /// Link and point (object frame) of the pad nearest to the object, and what the object says there.
    pub(crate) fn nearest(
        &self,
        posed: &Posed,
        object: &dyn SignedDistance,
    ) -> Option<(usize, Point3<f64>, SdfSample)> {
        let (link, points) = &self.points;
        points.nearest(&posed.links[*link], object).map(|(point, s)| (*link, point, s))
    }

    /// The fingertip in the object's frame.
    pub(crate) fn tip(&self, posed: &Posed) -> Point3<f64> {
        posed.links[self.tip.link] * self.tip.point
    }
}

/// The fingers of the mapping, in its order: a link is of the finger with most joints on the way to it, of none if several have as many.
fn fingers(target: &TargetHand) -> Vec<Finger> {
    let robot = &target.robot;
    let moved_by = |link: usize, joints: &[usize]| -> usize {
        let path = robot.path_to(link);
        path.iter().flat_map(|&l| &robot.links[l].joints).filter(|j| joints.contains(j)).count()
    };
    let owner = |link: usize| -> Option<usize> {
        let counts: Vec<usize> = target.fingers.iter().map(|f| moved_by(link, &f.joints)).collect();
        let most = counts.iter().copied().max().filter(|&n| n > 0)?;
        let mut with_most = (0..counts.len()).filter(|&f| counts[f] == most);
        with_most.next().filter(|_| with_most.next().is_none())
    };
    let owners: Vec<Option<usize>> = (0..robot.links.len()).map(owner).collect();
    let finger = |(i, f): (usize, &TargetFinger)| Finger {
        name: f.human.name().to_owned(),
        links: (0..owners.len()).filter(|&l| owners[l] == Some(i)).collect(),
        joints: f.joints.clone(),
        tip_link: f.tip.link,
        tip_point: f.tip.point,
        is_thumb: f.human == HumanFinger::Thumb,
    };
    target.fingers.iter().enumerate().map(finger).collect()
}

/// Points of the links that move with the tip, on the palmar side and the end.
fn pad(robot: &Robot, poses: &[Pose], tip: &LinkPoint, spacing_m: f64) -> Pad {
    let path = robot.path_to(tip.link);
    let Some(&moved) = path.iter().rev().find(|&&l| !robot.links[l].joints.is_empty()) else {
        return Pad { parts: Vec::new() };
    };
    let last = robot.links[moved].joints.last();
    let palmar = last.and_then(|&j| palmar(robot, poses, j, &(poses[tip.link] * tip.point)));
    let mut rigid = vec![moved];
    for l in moved + 1..robot.links.len() {
        if robot.links[l].joints.is_empty() && robot.links[l].parent.is_some_and(|p| rigid.contains(&p)) {
            rigid.push(l);
        }
    }
    let faces = |l: usize, n: &Vector3<f64>| palmar.is_none_or(|d| (poses[l] * n).dot(&d) > FACING);
    let parts = rigid.into_iter().map(|l| {
        let kept: Vec<_> = robot.surface_samples(l, spacing_m).into_iter().filter(|s| faces(l, &s.1)).collect();
        (l, LinkSurface::new(&kept))
    });
    Pad { parts: parts.filter(|(_, s)| !s.samples().is_empty()).collect() }
}
