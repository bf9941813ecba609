//! What the fit needs to know of a hand, worked out once from the model: where the pads are and which way they press.

use drex_core::Pose;
use drex_grasp::{HandSurface, LinkSurface};
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};

use super::WristFitOptions;
use crate::pad::{Pad, palmar};
use crate::self_collision::CollisionShapes;
use crate::{Error, Result};

/// A hand prepared for fitting.
pub(crate) struct HandModel<'a> {
    pub(crate) robot: &'a Robot,
    /// Few points, for the search among starts.
    pub(crate) rough: HandSurface,
    /// Many points, for the end and the verdict.
    pub(crate) fine: HandSurface,
    /// Pads of each finger on the rough and on the fine surface.
    pub(crate) pads: [Vec<Pad>; 2],
    pub(crate) thumb: usize,
    pub(crate) shapes: CollisionShapes,
}

/// A pad point faces the way its link moves when it bends: least cosine of its normal to that way. Straight ahead (the very end of
/// a fingertip) is 0.
const FACING: f64 = 0.5;

/// A grasp as it was recorded, and the interval that each joint may use.
pub(crate) struct Recorded {
    /// Within the limits, rad.
    pub(crate) joints: Vec<f64>,
    pub(crate) clipped_rad: Vec<f64>,
    pub(crate) intervals: Vec<(f64, f64)>,
}

impl<'a> HandModel<'a> {
    pub(crate) fn new(robot: &'a Robot, options: &WristFitOptions) -> Result<Self> {
        check(options)?;
        let rough = HandSurface::new(robot, options.spacings_m.0)?;
        let fine = HandSurface::new(robot, options.spacings_m.1)?;
        let Some(thumb) = fine.thumb() else {
            return Err(Error::value(
                format!("robot \"{}\" has no thumb", robot.name),
                "use the model of a hand; name the thumb's links thumb_*",
            ));
        };
        let (others, needed) = (fine.fingers.len() - 1, options.limits.min_fingers);
        if others < needed {
            return Err(Error::value(
                format!("robot \"{}\" has {others} fingers beside the thumb; a grasp takes {needed}", robot.name),
                "lower limits.min_fingers",
            ));
        }
        let pads = [&rough, &fine].map(|surface| pads(robot, surface));
        for (finger, pad) in fine.fingers.iter().zip(&pads[1]) {
            if pad.parts.iter().all(|(_, p)| p.samples().is_empty()) {
                return Err(Error::value(
                    format!(
                        "finger \"{}\" of robot \"{}\" has no collision shapes on its last links",
                        finger.name, robot.name
                    ),
                    "add shapes to the model",
                ));
            }
        }
        Ok(Self { robot, rough, fine, pads, thumb, shapes: CollisionShapes::new(robot) })
    }

    /// Clips a recorded grasp to the joint limits.
    pub(crate) fn recorded_within(&self, joints: &[f64], correction_rad: f64) -> Result<Recorded> {
        let fail = |what, remedy| Err(Error::Joints { what, remedy });
        if joints.len() != self.robot.dof() {
            return fail(
                format!("{} values for the {} joints of \"{}\"", joints.len(), self.robot.dof(), self.robot.name),
                "give one angle per joint, in the model's order",
            );
        }
        if let Some(j) = joints.iter().position(|v| !v.is_finite()) {
            return fail(
                format!("the angle of joint \"{}\" is not finite", self.robot.joints[j].name),
                "repair the record",
            );
        }
        let mut clipped = joints.to_vec();
        self.robot.clamp_to_limits(&mut clipped);
        let intervals = clipped
            .iter()
            .zip(&self.robot.joints)
            .map(|(q, joint)| {
                let (lo, hi) = joint.limits.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
                ((q - correction_rad).max(lo), (q + correction_rad).min(hi))
            })
            .collect();
        let clipped_rad = clipped.iter().zip(joints).map(|(c, q)| c - q).collect();
        Ok(Recorded { joints: clipped, clipped_rad, intervals })
    }
}

fn check(options: &WristFitOptions) -> Result<()> {
    let ok = options.max_finger_correction_rad >= 0.0
        && options.initial_guesses >= 1
        && options.kept.0 >= 1
        && options.kept.1 >= 1;
    if ok {
        Ok(())
    } else {
        Err(Error::value(
            format!("the options of the wrist fit make no sense: {options:?}"),
            "give lengths and angles of zero or more, and at least one initial guess and kept guess",
        ))
    }
}

/// The palmar sides of the links that the last two joints of each finger move.
fn pads(robot: &Robot, surface: &HandSurface) -> Vec<Pad> {
    let poses = robot.forward_kinematics(&robot.reference_position(), &Pose::identity());
    surface
        .fingers
        .iter()
        .map(|finger| {
            let mut parts = Vec::new();
            let mut far = poses[finger.tip_link] * finger.tip_point;
            for &j in finger.joints.iter().rev().take(2) {
                let palmar = palmar(robot, &poses, j, &far);
                let next_joints = &finger.joints[finger.joints.iter().position(|&k| k == j).map_or(0, |p| p + 1)..];
                for link in rigid_part(robot, &finger.links, robot.joints[j].link, next_joints) {
                    let facing = |n: &Vector3<f64>| palmar.is_none_or(|d| (poses[link] * n).dot(&d) > FACING);
                    let samples = surface.links[link].samples().iter().filter(|s| facing(&s.1)).copied();
                    parts.push((link, LinkSurface::new(&samples.collect::<Vec<_>>())));
                }
                far = robot.joint_axis(&poses, j).1;
            }
            Pad { parts }
        })
        .collect()
}

/// Links of the finger that move with `first`, up to the next joint.
fn rigid_part(robot: &Robot, links: &[usize], first: usize, next_joints: &[usize]) -> Vec<usize> {
    let stops: Vec<usize> = next_joints.iter().map(|&j| robot.joints[j].link).collect();
    let mut part = vec![first];
    for &link in links {
        if link != first && !stops.contains(&link) && robot.links[link].parent.is_some_and(|p| part.contains(&p)) {
            part.push(link);
        }
    }
    part
}

impl HandModel<'_> {
    /// Mean point of each finger's pad at these link poses (on the last link), to place starts by.
    pub(crate) fn tips(&self, poses: &[Pose]) -> Vec<Point3<f64>> {
        self.fine.fingers.iter().map(|f| poses[f.tip_link] * f.tip_point).collect()
    }

    /// Origin of the palm, or of the base where the model has no palm.
    pub(crate) fn palm(&self, poses: &[Pose]) -> (Point3<f64>, Vector3<f64>) {
        let link = self.robot.palm_link().unwrap_or(0);
        let normal = self.robot.palm_normal().unwrap_or_else(Vector3::z);
        (Point3::from(poses[link].translation.vector), poses[link].rotation * normal)
    }
}
