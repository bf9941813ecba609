//! What a model says about its hand: fingers, names, palm, wrist.

use std::path::Path;

use drex_core::Pose;
use drex_demo::HumanFinger;
use drex_robot::{Robot, Shape};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::frame::{Bends, FingerCandidate, Rest, joints_to, mean};
use super::mapping::Mapping;
use super::{LinkPoint, TargetFinger, TargetHand, names};
use crate::{Error, Result};

/// Length of a robot's palm over that of its fingers, where the model does not show where the palm ends.
const PALM_PER_FINGER: f64 = 0.7;
/// A wrist is this many finger lengths behind the knuckles.
const WRIST_BEHIND: std::ops::Range<f64> = 0.3..1.6;

/// A thumb less than this to one side of the other fingers does not tell left from right, m.
pub(super) const UNSURE_SIDE: f64 = 3e-3;
/// Joints nearer to each other than this are the same, m: files round.
const SAME_JOINT: f64 = 2e-3;

/// The fingers of the mapping, else those of the model.
pub(super) fn fingers(
    robot: &Robot,
    path: &Path,
    mapping: &Mapping,
    notes: &mut Vec<String>,
) -> Result<Vec<FingerCandidate>> {
    let fingers = if mapping.fingers.is_empty() { of_model(robot, notes) } else { of_mapping(robot, path, mapping)? };
    let thumbs = fingers.iter().filter(|f| f.thumb).count();
    if thumbs == 1 && fingers.len() >= 2 {
        return Ok(fingers);
    }
    let what = match (thumbs, fingers.len() - thumbs) {
        (0, 0) => format!("robot \"{}\" has no fingers", robot.name),
        (0, n) => format!("none of the {n} fingers of robot \"{}\" is a thumb", robot.name),
        (1, _) => format!("there is no finger beside the thumb of robot \"{}\"", robot.name),
        (n, _) => format!("{n} fingers of robot \"{}\" are thumbs", robot.name),
    };
    let remedy = "write a mapping file with [fingers.thumb] and at least one of index, middle, ring, little; of a gripper with \
                  two fingers, one can be the thumb and one the index finger";
    Err(Error::mapping(path, "fingers", what, remedy))
}

fn of_mapping(robot: &Robot, path: &Path, mapping: &Mapping) -> Result<Vec<FingerCandidate>> {
    mapping
        .fingers
        .iter()
        .map(|(&human, f)| {
            let key = |part: &str| format!("[fingers.{}] {part}", human.name());
            let tip = f.tip.find(robot, path, &key("tip"))?;
            let middle = f.middle.as_ref().map(|m| m.find(robot, path, &key("middle"))).transpose()?;
            let joints = joints_to(robot, tip.link);
            Ok(FingerCandidate { human: Some(human), thumb: human == HumanFinger::Thumb, tip, middle, joints })
        })
        .collect()
}

fn of_model(robot: &Robot, notes: &mut Vec<String>) -> Vec<FingerCandidate> {
    let found: Vec<_> = robot.fingers();
    for f in &found {
        let link = &robot.links[f.tip_link].name;
        let p = f.tip_point * 1e3;
        notes.push(match f.tip_point == Point3::origin() {
            true => format!("the tip of finger \"{}\" is the origin of link \"{link}\"", f.name),
            false => format!(
                "the tip of finger \"{}\" is at ({:.1}, {:.1}, {:.1}) mm in link \"{link}\", the end of its shapes",
                f.name, p.x, p.y, p.z
            ),
        });
    }
    found
        .into_iter()
        .map(|f| FingerCandidate {
            human: names::finger(robot, &f.links, &f.joints),
            thumb: f.is_thumb,
            tip: LinkPoint { link: f.tip_link, point: f.tip_point },
            middle: None,
            joints: joints_to(robot, f.tip_link),
        })
        .collect()
}

/// Holds the joints that move all fingers, and takes them out of the fingers' lists.
pub(super) fn hold_palm(robot: &mut Robot, fingers: &mut [FingerCandidate], notes: &mut Vec<String>) -> Vec<usize> {
    let common: Vec<usize> = match fingers {
        [] => Vec::new(),
        [first, rest @ ..] => {
            first.joints.iter().copied().filter(|j| rest.iter().all(|f| f.joints.contains(j))).collect()
        }
    };
    for finger in fingers {
        finger.joints.retain(|j| !common.contains(j));
    }
    for &j in &common {
        let joint = &mut robot.joints[j];
        let (lo, hi) = joint.limits.unwrap_or((0.0, 0.0));
        let held = 0.0_f64.max(lo).min(hi);
        joint.limits = Some((held, held));
        notes.push(format!("joint \"{}\" moves the palm and is held at {held}", joint.name));
    }
    common
}

/// Gives every finger its human finger: by name if the names tell all of them apart, else by the order along the palm.
pub(super) fn label(
    rest: &Rest<'_>,
    bends: &Bends,
    mut fingers: Vec<FingerCandidate>,
    notes: &mut Vec<String>,
) -> Result<Vec<TargetFinger>> {
    fingers.sort_by_key(|f| !f.thumb);
    fingers[0].human = Some(HumanFinger::Thumb);
    let told_apart =
        (0..fingers.len()).all(|i| fingers[i].human.is_some() && (0..i).all(|k| fingers[i].human != fingers[k].human));
    if !told_apart {
        by_order(rest, bends, &mut fingers)?;
    }
    if rest.mapping.fingers.is_empty() {
        let how = if told_apart { "names" } else { "order along the palm" };
        let names = fingers.iter().filter_map(|f| Some((f.human?.name(), &rest.robot.links[f.tip.link].name)));
        let names: Vec<String> = names.map(|(human, tip)| format!("{human} ends in \"{tip}\"")).collect();
        notes.push(format!("fingers by their {how}: {}", names.join(", ")));
    }
    let mut fingers: Vec<TargetFinger> = fingers
        .into_iter()
        .filter_map(|f| {
            let middle = f.middle.unwrap_or_else(|| middle_point(rest, &f));
            Some(TargetFinger { human: f.human?, tip: f.tip, middle, joints: f.joints })
        })
        .collect();
    fingers.sort_by_key(|f| f.human);
    Ok(fingers)
}

/// Index, middle, ring and little finger by their order along the palm, from the thumb on. The thumb is first in `fingers`.
fn by_order(rest: &Rest<'_>, bends: &Bends, fingers: &mut [FingerCandidate]) -> Result<()> {
    let fail = |what: String| rest.fail("fingers", what, "write a mapping file that names the tip of each finger");
    let Some(across) = bends.across() else {
        return fail("names do not tell the fingers apart, and they do not bend to one side".to_owned());
    };
    let Some((thumb, others)) = fingers.split_first_mut() else { return Ok(()) };
    if others.len() > 4 {
        return fail(format!("{} fingers beside the thumb", others.len()));
    }
    let aside = |f: &FingerCandidate| across.dot(&rest.middle_of(&f.joints, &f.tip));
    let middle = others.iter().map(&aside).sum::<f64>() / others.len() as f64;
    let side = aside(thumb) - middle;
    if side.abs() < UNSURE_SIDE {
        return fail("names do not tell the fingers apart, and the thumb is in the middle of them".to_owned());
    }
    others.sort_by(|a, b| (side * aside(b)).total_cmp(&(side * aside(a))));
    for (finger, human) in others.iter_mut().zip(&HumanFinger::ALL[1..]) {
        finger.human = Some(*human);
    }
    Ok(())
}

/// Where a finger's joint is that follows the human [`HumanFinger::middle`]: the last but one, of two the last, of one half
/// way to the tip.
fn middle_point(rest: &Rest<'_>, finger: &FingerCandidate) -> LinkPoint {
    let at = |j: usize| LinkPoint { link: rest.robot.joints[j].link, point: rest.robot.joints[j].anchor };
    match finger.joints[..] {
        [.., middle, last] => at(if finger.joints.len() == 2 { last } else { middle }),
        [only] => {
            let half = nalgebra::center(&rest.joint(only), &rest.at(&finger.tip));
            let link = finger.tip.link;
            LinkPoint { link, point: rest.poses[link].inverse() * half }
        }
        [] => finger.tip,
    }
}

/// The operator frame in the frame of the base.
pub(super) fn operator(
    rest: &Rest<'_>,
    bends: &Bends,
    fingers: &[TargetFinger],
    notes: &mut Vec<String>,
) -> Result<Pose> {
    let (robot, wrist) = (rest.robot, &rest.mapping.wrist);
    let link = wrist.link.as_ref().map(|name| rest.find_link("[wrist] link", name)).transpose()?;
    if let Some(link) = link
        && !rest.on_palm(link)
    {
        return rest.fail(
            "[wrist] link",
            format!("link \"{}\" does not move with the palm", robot.links[link].name),
            "use the palm's link or one that is fixed to it",
        );
    }
    let (palm, tips) = match (link, wrist.palm, wrist.tips) {
        (Some(link), Some(palm), Some(tips)) => {
            (rest.poses[link] * Vector3::from(palm), rest.poses[link] * Vector3::from(tips))
        }
        _ => {
            let Some(palm) = bends.palm else {
                return rest.fail(
                    "[wrist]",
                    format!("the fingers of robot \"{}\" do not bend to one side, so that it has no palm", robot.name),
                    "give wrist.link, and in its frame palm (out of the palm) and tips (to the fingertips)",
                );
            };
            notes.push(format!(
                "out of the palm is {}, to the fingertips {} in the frame of the base, {}",
                rounded(&palm),
                rounded(&bends.tips),
                match bends.by_thumb {
                    true => "from their hinges and the side on which the thumb is",
                    false => "from how the fingers bend",
                }
            ));
            (palm, bends.tips)
        }
    };
    let (Some(tips), Some(y)) = (tips.try_normalize(1e-9), tips.cross(&palm).try_normalize(1e-9)) else {
        return rest.fail(
            "[wrist] palm, tips",
            "the two directions are parallel or zero",
            "give two directions at right angles",
        );
    };
    let x = y.cross(&tips);
    let origin = match link {
        Some(link) => rest.poses[link] * Point3::from(wrist.point_m.unwrap_or_default()),
        None => wrist_point(rest, &x, &tips, fingers, notes),
    };
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, tips]));
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    Ok(Isometry3::from_parts(Translation3::from(origin.coords), rotation))
}

/// A link called wrist or base, if it is where a wrist would be; else the wrist of the bundled hand with the same joints; else the
/// last joint that moves the palm; else a point behind the fingers where the palm ends.
fn wrist_point(
    rest: &Rest<'_>,
    x: &Vector3<f64>,
    z: &Vector3<f64>,
    fingers: &[TargetFinger],
    notes: &mut Vec<String>,
) -> Point3<f64> {
    let others = || fingers.iter().filter(|f| f.human != HumanFinger::Thumb);
    let knuckles = mean(others().map(|f| rest.joint(f.joints[0]).coords));
    let ends = mean(others().map(|f| rest.at(&f.tip).coords));
    let length = z.dot(&(ends - knuckles));
    let fits = |p: &Vector3<f64>| {
        let off = knuckles - p;
        let behind = z.dot(&off);
        WRIST_BEHIND.contains(&(behind / length)) && (off - z * behind).norm() < PALM_PER_FINGER * length
    };
    let robot = rest.robot;
    let palm_links = || (0..robot.links.len()).filter(|&l| rest.on_palm(l));
    for word in ["wrist", "base"] {
        let mut called = palm_links().filter(|&l| names::has_word(&robot.links[l].name, word));
        if let Some(link) = called.find(|&l| fits(&rest.poses[l].translation.vector)) {
            notes.push(format!("the wrist is the origin of link \"{}\"", robot.links[link].name));
            return Point3::from(rest.poses[link].translation.vector);
        }
    }
    if let Some((point, name)) = like_bundled(rest, x, z, fingers) {
        notes.push(format!("the wrist is that of the bundled hand \"{name}\", which has the same joints"));
        return point;
    }
    if let Some(&j) = rest.palm_joints.last()
        && fits(&rest.joint(j).coords)
    {
        notes.push(format!("the wrist is at joint \"{}\", the last that moves the palm", robot.joints[j].name));
        return rest.joint(j);
    }
    // Beside the fingertips and level with the last joints, which is where straight fingers lie.
    let y = z.cross(x);
    let level = mean(others().filter_map(|f| Some(rest.joint(*f.joints.last()?).coords)));
    let aside = others().map(|f| y.dot(&rest.at(&f.tip).coords));
    let (lo, hi) = aside.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
    let line = x * x.dot(&level) + y * (0.5 * (lo + hi));
    let end = palm_links()
        .flat_map(|l| robot.links[l].geoms.iter().map(move |g| (l, g)))
        .filter(|(_, g)| g.collides())
        .filter_map(|(l, g)| {
            let place = rest.poses[l] * g.link_from_geom;
            let points = match &g.shape {
                Shape::Mesh(mesh) => mesh.vertices.clone(),
                other => other.to_mesh(24)?.vertices,
            };
            points.iter().map(|p| z.dot(&(place * p).coords)).min_by(f64::total_cmp)
        })
        .min_by(f64::total_cmp);
    let knuckles = z.dot(&knuckles);
    let (end, how) = match end {
        Some(end) if WRIST_BEHIND.contains(&((knuckles - end) / length)) => (end, "where the palm's shapes end"),
        _ => (knuckles - PALM_PER_FINGER * length, "at 0.7 finger lengths, for the palm's shapes do not show it"),
    };
    notes.push(format!("the wrist is {:.0} mm behind the knuckles, {how}", (knuckles - end) * 1e3));
    Point3::from(line + z * end)
}

/// The wrist of the bundled hand whose joints are where this hand's are, and its name.
fn like_bundled(
    rest: &Rest<'_>,
    x: &Vector3<f64>,
    z: &Vector3<f64>,
    fingers: &[TargetFinger],
) -> Option<(Point3<f64>, &'static str)> {
    let joints = |robot: &Robot, poses: &[Pose], fingers: &[TargetFinger]| -> Vec<Vec<Vector3<f64>>> {
        let at = |&j: &usize| robot.joint_axis(poses, j).1.coords;
        fingers.iter().map(|f| f.joints.iter().map(at).collect()).collect()
    };
    let axes = Matrix3::from_columns(&[*x, z.cross(x), *z]);
    let ours = joints(rest.robot, &rest.poses, fingers);
    let center = mean(ours.iter().flatten().copied());
    ["leap_right", "leap_left", "allegro_right", "allegro_left"].into_iter().find_map(|name| {
        let hand = TargetHand::bundled(name).ok()?;
        let straight = hand.robot.forward_kinematics(&vec![0.0; hand.robot.dof()], &Pose::identity());
        let its = joints(&hand.robot, &straight, &hand.fingers);
        let its_center = mean(its.iter().flatten().copied());
        let turn = axes * hand.base_from_operator.rotation.to_rotation_matrix().matrix().transpose();
        let place = |p: &Vector3<f64>| turn * (p - its_center) + center;
        let same = ours.len() == its.len()
            && ours
                .iter()
                .zip(&its)
                .all(|(a, b)| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - place(b)).norm() < SAME_JOINT));
        same.then(|| (Point3::from(place(&hand.base_from_operator.translation.vector)), name))
    })
}

/// A direction for messages.
pub(super) fn rounded(v: &Vector3<f64>) -> String {
    let [x, y, z] = [v.x, v.y, v.z].map(|c| (c * 100.0).round() / 100.0 + 0.0);
    format!("[{x}, {y}, {z}]")
}
