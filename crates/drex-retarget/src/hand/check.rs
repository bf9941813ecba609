//! Whether a mapping fits the hand.

use std::path::Path;

use drex_core::Pose;
use drex_robot::Robot;
use nalgebra::Vector3;

use super::derive::rounded;
use super::frame::{Bends, Rest, joints_to};
use super::mapping::Mapping;
use super::{TargetFinger, TargetHand};
use crate::{HumanFinger, Result, RetargetError, Side};

/// A thumb less than this to one side of the other fingers does not tell left from right, m.
const UNSURE_SIDE: f64 = 3e-3;
/// A tip nearer to the axis of its last joint does not move with it, m.
const ON_AXIS: f64 = 5e-3;
/// Least cosine between what the mapping says and what the fingers do: beyond 45 degrees it is wrong, beyond 20 remarkable.
const WRONG: f64 = 0.7;
const ODD: f64 = 0.94;

/// Joints that follow others must lead back to one that does not.
pub(super) fn couplings(robot: &Robot, path: &Path, notes: &mut Vec<String>) -> Result<()> {
    for joint in &robot.joints {
        let mut leader = joint;
        for _ in 0..=robot.dof() {
            match leader.mimic {
                Some(m) => leader = &robot.joints[m.joint],
                None => break,
            }
        }
        if leader.mimic.is_some() {
            return Err(RetargetError::mapping(
                path,
                "mimic",
                format!("joint \"{}\" follows itself", joint.name),
                "make one joint of the ring lead",
            ));
        }
        if let Some(m) = joint.mimic {
            notes.push(format!("joint \"{}\" follows \"{}\"", joint.name, robot.joints[m.joint].name));
        } else if joint.limits.is_none() {
            notes.push(format!("joint \"{}\" has no limits", joint.name));
        }
    }
    Ok(())
}

/// Left or right: the side of the other fingers on which the thumb is.
pub(super) fn side(
    robot: &Robot,
    path: &Path,
    mapping: &Mapping,
    rest: &Rest,
    base_from_operator: &Pose,
    fingers: &[TargetFinger],
    notes: &mut Vec<String>,
) -> Result<Side> {
    let across = base_from_operator * Vector3::y();
    let aside = |f: &TargetFinger| across.dot(&rest.middle_of(robot, &f.joints, &f.tip));
    let (thumbs, others): (Vec<_>, Vec<_>) = fingers.iter().partition(|f| f.human == HumanFinger::Thumb);
    let middle = others.iter().map(|f| aside(f)).sum::<f64>() / others.len().max(1) as f64;
    let thumb = thumbs.first().map_or(0.0, |f| aside(f)) - middle;
    let seen = if thumb > 0.0 { Side::Right } else { Side::Left };
    let sure = thumb.abs() > UNSURE_SIDE;
    if let (true, [first, .., last]) = (sure, &others[..])
        && (aside(first) - aside(last)) * thumb < 0.0
    {
        let what = format!(
            "the {} finger is farther from the thumb than the {} finger",
            first.human.name(),
            last.human.name()
        );
        if !mapping.fingers.is_empty() {
            return Err(RetargetError::mapping(path, "[fingers]", what, "name them in the order from the thumb"));
        }
        notes.push(what);
    }
    let word = |side| if side == Side::Right { "right" } else { "left" };
    match mapping.side {
        Some(said) if sure && said != seen => Err(RetargetError::mapping(
            path,
            "side",
            format!(
                "the mapping says {}, but seen with the palm in front and the fingertips up the thumb is {:.0} mm to that side \
                 where a {} hand has it",
                word(said),
                thumb.abs() * 1e3,
                word(seen)
            ),
            format!("write side = \"{}\", or load the model of the other hand", word(seen)),
        )),
        Some(said) => Ok(said),
        None if sure => {
            notes.push(format!("a {} hand: the thumb is {:.0} mm to that side", word(seen), thumb.abs() * 1e3));
            Ok(seen)
        }
        None => Err(RetargetError::mapping(
            path,
            "side",
            "the thumb is in the middle, which does not tell left from right",
            "write a mapping file with side = \"right\" or \"left\"",
        )),
    }
}

/// The rest: tips at the ends of their fingers, the operator frame along them.
pub(super) fn hand(
    mut hand: TargetHand,
    path: &Path,
    mapping: &Mapping,
    rest: &Rest,
    bends: &Bends,
) -> Result<TargetHand> {
    tips(&hand, path, rest)?;
    frame(&mut hand, path, mapping, rest, bends)?;
    Ok(hand)
}

fn tips(hand: &TargetHand, path: &Path, rest: &Rest) -> Result<()> {
    let robot = &hand.robot;
    for (i, f) in hand.fingers.iter().enumerate() {
        let fail = |what: String, remedy: String| {
            Err(RetargetError::mapping(path, format!("[fingers.{}] tip", f.human.name()), what, remedy))
        };
        let link = &robot.links[f.tip.link].name;
        let beyond = robot
            .joints
            .iter()
            .find(|j| robot.links[j.link].parent.is_some_and(|p| robot.path_to(p).contains(&f.tip.link)));
        if let Some(joint) = beyond {
            let end = robot.fingers().into_iter().find(|e| e.links.contains(&f.tip.link));
            return fail(
                format!("link \"{link}\" is not the end of the finger, joint \"{}\" moves links beyond it", joint.name),
                match end {
                    Some(end) => format!("use \"{}\"", robot.links[end.tip_link].name),
                    None => "use the last link".to_owned(),
                },
            );
        }
        let tip = rest.at(&f.tip);
        if let Some(&last) = f.joints.last() {
            let (axis, anchor) = robot.joint_axis(&rest.poses, last);
            let arm = tip - anchor;
            let turns = robot.joints[last].kind == drex_robot::JointKind::Revolute;
            if turns && axis.cross(&arm).norm() < ON_AXIS {
                let remedy = match robot.fingers().into_iter().find(|e| e.joints.contains(&last)) {
                    Some(end) => {
                        let p = end.tip_point.coords;
                        let end = &robot.links[end.tip_link].name;
                        format!("use link = \"{end}\", point_m = [{:.4}, {:.4}, {:.4}]", p.x, p.y, p.z)
                    }
                    None => "give point_m, the end of the finger in the frame of its link".to_owned(),
                };
                let name = &robot.joints[last].name;
                return fail(format!("the point is on the axis of joint \"{name}\", which cannot move it"), remedy);
            }
        }
        if let Some(twin) = hand.fingers[..i].iter().find(|g| (rest.at(&g.tip) - tip).norm() < ON_AXIS) {
            return fail(
                format!("the point is where the {} has its tip", twin.human.name()),
                "give every finger a tip of its own".to_owned(),
            );
        }
        if joints_to(robot, f.middle.link).iter().any(|j| !f.joints.contains(j) && !rest.palm_joints.contains(j)) {
            return Err(RetargetError::mapping(
                path,
                format!("[fingers.{}] middle", f.human.name()),
                format!("link \"{}\" belongs to another finger", robot.links[f.middle.link].name),
                "use a link between palm and tip",
            ));
        }
    }
    Ok(())
}

fn frame(hand: &mut TargetHand, path: &Path, mapping: &Mapping, rest: &Rest, bends: &Bends) -> Result<()> {
    let [palm, tips] = [Vector3::x(), Vector3::z()].map(|v| hand.base_from_operator * v);
    let in_operator = |v: &Vector3<f64>| rounded(&hand.base_from_operator.inverse_transform_vector(v));
    let link = mapping.wrist.link.as_ref().and_then(|name| hand.robot.link_index(name));
    let instead = |key: &str, v: &Vector3<f64>| {
        let there = link.map_or(*v, |l| rest.poses[l].inverse_transform_vector(v));
        format!("in the frame of the wrist's link it should be {key} = {}", rounded(&there))
    };
    let degrees = |cosine: f64| cosine.clamp(-1.0, 1.0).acos().to_degrees();
    let mut odd = Vec::new();
    let along = tips.dot(&bends.tips);
    if along < WRONG {
        return Err(RetargetError::mapping(
            path,
            "[wrist] tips",
            format!(
                "with all joints at zero the fingers point {:.0} degrees away from where tips says, to {} in the operator frame \
                 (x out of the palm, z to the tips)",
                degrees(along),
                in_operator(&bends.tips)
            ),
            instead("tips", &bends.tips),
        ));
    }
    if along < ODD {
        odd.push(format!("the straight fingers point {:.0} degrees away from z of the operator frame", degrees(along)));
    }
    if let Some(curl) = &bends.palm {
        let out = palm.dot(curl);
        if out < WRONG {
            let side = if out < -WRONG { "out of the back of the hand" } else { "aside" };
            return Err(RetargetError::mapping(
                path,
                "[wrist] palm",
                format!(
                    "x of the operator frame points {side}: the fingers bend to {} in it ({:.0} degrees away), so that they would \
                     curl the wrong way",
                    in_operator(curl),
                    degrees(out)
                ),
                instead("palm", curl),
            ));
        }
        if out < ODD {
            odd.push(format!("the fingers bend {:.0} degrees away from x of the operator frame", degrees(out)));
        }
    }
    let from_wrist = |p: nalgebra::Point3<f64>| hand.base_from_operator.inverse() * p;
    for f in &hand.fingers {
        let tip = from_wrist(rest.at(&f.tip));
        if f.human != HumanFinger::Thumb && tip.z < ON_AXIS {
            return Err(RetargetError::mapping(
                path,
                "[wrist] point_m",
                format!("the tip of the {} finger is {:.0} mm behind the wrist", f.human.name(), -tip.z * 1e3),
                "put the wrist behind the palm",
            ));
        }
        let knuckle = f.joints.first().map(|&j| from_wrist(rest.joint(&hand.robot, j)).z);
        if let Some(knuckle) = knuckle
            && f.human != HumanFinger::Thumb
            && knuckle < 0.15 * tip.z
        {
            odd.push(format!(
                "the wrist is {:.0} mm behind the knuckle of the {} finger; a person's is as far behind as the finger is long",
                knuckle * 1e3,
                f.human.name()
            ));
        }
    }
    hand.notes.extend(odd);
    Ok(())
}
