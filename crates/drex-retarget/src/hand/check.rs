//! Whether a mapping fits the hand.

use std::path::Path;

use drex_core::Pose;
use drex_demo::{HumanFinger, Side};
use drex_robot::{Joint, JointKind, Robot};
use nalgebra::Vector3;

use super::TargetFinger;
use super::derive::{UNSURE_SIDE, rounded};
use super::frame::{Bends, FingerCandidate, Rest, joints_to};
use crate::{Error, Result};

/// A tip nearer to the axis of its last joint does not move with it, m.
const ON_AXIS: f64 = 5e-3;
/// Least cosine between what the mapping says and what the fingers do: beyond 45 degrees it is wrong, beyond 20 remarkable.
const WRONG: f64 = 0.7;
const ODD: f64 = 0.94;
/// A wrist nearer to the knuckles than this share of the way to the tips is remarkable.
const AT_KNUCKLES: f64 = 0.15;

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
            return Err(Error::mapping(
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
    rest: &Rest<'_>,
    base_from_operator: &Pose,
    fingers: &[TargetFinger],
    notes: &mut Vec<String>,
) -> Result<Side> {
    let across = base_from_operator * Vector3::y();
    let aside = |f: &TargetFinger| across.dot(&rest.middle_of(&f.joints, &f.tip));
    let (thumbs, others): (Vec<_>, Vec<_>) = fingers.iter().partition(|f| f.human == HumanFinger::Thumb);
    let middle = others.iter().map(|f| aside(f)).sum::<f64>() / others.len().max(1) as f64;
    let thumb = thumbs.first().map_or(0.0, |f| aside(f)) - middle;
    let seen = if thumb > 0.0 { Side::Right } else { Side::Left };
    let sure = thumb.abs() > UNSURE_SIDE;
    // There is a finger beside the thumb: `derive::fingers` saw to it.
    let (first, last) = (others[0], others[others.len() - 1]);
    let row = aside(first) - aside(last);
    if sure && row * thumb < 0.0 {
        let (near, far) = (first.human.name(), last.human.name());
        let what = format!("the {near} finger is farther from the thumb than the {far} finger");
        if !rest.mapping.fingers.is_empty() {
            return rest.fail("[fingers]", what, "name them in the order from the thumb");
        }
        notes.push(what);
    }
    match rest.mapping.side {
        Some(said) if sure && said != seen => rest.fail(
            "side",
            format!(
                "the mapping says {}, but seen with the palm in front and the fingertips up the thumb is {:.0} mm to the side \
                 where a {} hand has it",
                said.name(),
                thumb.abs() * 1e3,
                seen.name()
            ),
            format!("write side = \"{}\", or load the model of the other hand", seen.name()),
        ),
        Some(said) => Ok(said),
        None if sure => {
            notes.push(format!("a {} hand: the thumb is {:.0} mm to that side", seen.name(), thumb.abs() * 1e3));
            Ok(seen)
        }
        None if row.abs() > UNSURE_SIDE => {
            let seen = if row > 0.0 { Side::Right } else { Side::Left };
            notes.push(format!("a {} hand: the index finger is on that side, the thumb in the middle", seen.name()));
            Ok(seen)
        }
        None => rest.fail(
            "side",
            "the thumb is in the middle, which does not tell left from right",
            "write a mapping file with side = \"right\" or \"left\"",
        ),
    }
}

/// Every finger has joints, its tip is its end and can move, and no two fingers share one.
pub(super) fn tips(rest: &Rest<'_>, fingers: &[FingerCandidate]) -> Result<()> {
    let robot = rest.robot;
    let half_closed = robot.forward_kinematics(&rest.half_closed(), &Pose::identity());
    for (i, f) in fingers.iter().enumerate() {
        let name = &robot.links[f.tip.link].name;
        let fail = |part: &str, what: String, remedy: String| {
            let key = f.human.map_or_else(|| "fingers".to_owned(), |h| format!("[fingers.{}] {part}", h.name()));
            rest.fail(&key, what, remedy)
        };
        let Some(&last) = f.joints.last() else {
            let remedy = "use the last link of the finger";
            return fail("tip", format!("no joint moves link \"{name}\" against the palm"), remedy.into());
        };
        let model = || robot.fingers().into_iter().find(|m| m.joints.contains(&last));
        let above = |j: &&Joint| robot.path_to(j.link).iter().rev().skip(1).any(|&l| l == f.tip.link);
        if let Some(joint) = robot.joints.iter().find(above) {
            return fail(
                "tip",
                format!("link \"{name}\" is not the end of the finger: joint \"{}\" moves links beyond it", joint.name),
                model().map_or("use the last link".into(), |m| format!("use \"{}\"", robot.links[m.tip_link].name)),
            );
        }
        let tip = rest.at(&f.tip);
        let (axis, anchor) = robot.joint_axis(&rest.poses, last);
        let arm = match robot.joints[last].kind {
            JointKind::Revolute => axis.cross(&(tip - anchor)),
            _ => tip - anchor,
        };
        if arm.norm() < ON_AXIS {
            let remedy = model().map_or("give point_m, the end of the finger in the frame of its link".into(), |m| {
                let (link, [x, y, z]) = (&robot.links[m.tip_link].name, [0, 1, 2].map(|k| m.tip_point[k]));
                format!("use link = \"{link}\", point_m = [{x:.4}, {y:.4}, {z:.4}]")
            });
            let what =
                format!("the point is at the last joint, \"{}\", and not at the finger's end", robot.joints[last].name);
            return fail("tip", what, remedy);
        }
        // The fingers of a closed gripper touch, but not those of one half open.
        let at = |f: &FingerCandidate| half_closed[f.tip.link] * f.tip.point;
        let same = |g: &&FingerCandidate| (rest.at(&g.tip) - tip).norm() < ON_AXIS && (at(g) - at(f)).norm() < ON_AXIS;
        if let Some(twin) = fingers[..i].iter().find(same) {
            let twin = twin.human.map_or("another finger", |h| h.name());
            return fail("tip", format!("{twin} has its tip there, too"), "give every finger a tip of its own".into());
        }
        if let Some(middle) = &f.middle
            && joints_to(robot, middle.link).iter().any(|j| !f.joints.contains(j) && !rest.palm_joints.contains(j))
        {
            let what = format!("link \"{}\" belongs to another finger", robot.links[middle.link].name);
            return fail("middle", what, "use a link between palm and tip".into());
        }
    }
    Ok(())
}

/// The operator frame lies along the fingers, out of the palm, behind the knuckles. What is odd but usable becomes a note.
pub(super) fn frame(
    rest: &Rest<'_>,
    bends: &Bends,
    base_from_operator: &Pose,
    fingers: &[TargetFinger],
    notes: &mut Vec<String>,
) -> Result<()> {
    let [palm, tips] = [Vector3::x(), Vector3::z()].map(|v| base_from_operator * v);
    let to = base_from_operator.inverse();
    let link = rest.mapping.wrist.link.as_ref().and_then(|name| rest.robot.link_index(name));
    let instead = |key: &str, v: &Vector3<f64>| {
        let there = link.map_or(*v, |l| rest.poses[l].inverse_transform_vector(v));
        format!("in the frame of the wrist's link it should be {key} = {}", rounded(&there))
    };
    let degrees = |cosine: f64| cosine.clamp(-1.0, 1.0).acos().to_degrees();
    let along = tips.dot(&bends.tips);
    if along < WRONG {
        let what = format!(
            "with all joints at zero the fingers point {:.0} degrees away from where tips says, to {} in the operator frame (x \
             out of the palm, z to the tips)",
            degrees(along),
            rounded(&(to * bends.tips))
        );
        return rest.fail("[wrist] tips", what, instead("tips", &bends.tips));
    }
    if along < ODD {
        notes.push(format!(
            "the straight fingers point {:.0} degrees away from z of the operator frame",
            degrees(along)
        ));
    }
    if let Some(curl) = &bends.palm {
        let out = palm.dot(curl);
        if out < WRONG {
            let side = if out < -WRONG { "out of the back of the hand" } else { "aside" };
            let what = format!(
                "x of the operator frame points {side}: the fingers bend to {} in it ({:.0} degrees away), so that they would \
                 curl the wrong way",
                rounded(&(to * curl)),
                degrees(out)
            );
            return rest.fail("[wrist] palm", what, instead("palm", curl));
        }
        if out < ODD {
            notes.push(format!("the fingers bend {:.0} degrees away from x of the operator frame", degrees(out)));
        }
    }
    for f in fingers.iter().filter(|f| f.human != HumanFinger::Thumb) {
        let tip = (to * rest.at(&f.tip)).z;
        if tip < ON_AXIS {
            let what = format!("the tip of the {} finger is {:.0} mm behind the wrist", f.human.name(), -tip * 1e3);
            return rest.fail("[wrist] point_m", what, "put the wrist behind the palm");
        }
        let knuckle = f.joints.first().map(|&j| (to * rest.joint(j)).z);
        if let Some(knuckle) = knuckle.filter(|k| *k < AT_KNUCKLES * tip) {
            notes.push(format!(
                "the wrist is {:.0} mm behind the knuckle of the {} finger; a human wrist is as far behind as the finger is long",
                knuckle * 1e3,
                f.human.name()
            ));
        }
    }
    Ok(())
}
