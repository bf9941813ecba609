//! Any hand: what is derived from a model.

use std::path::Path;

use crate::made_hand::{BONES, Synthetic, points, shared, zero};
use drex_core::Pose;
use drex_demo::{HandSkeleton, HumanFinger, Side};
use drex_retarget::{Objective, RetargetOptions, TargetHand, retarget};
use drex_robot::Robot;
use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;

#[test]
fn bundled_hands_derive_to_their_mappings() {
    for name in ["leap_right", "allegro_right", "leap_left", "allegro_left"] {
        let mapped = TargetHand::bundled(name).unwrap();
        let derived = TargetHand::derive(Robot::bundled(name).unwrap()).unwrap();
        assert_eq!(mapped.side, if name.ends_with("right") { Side::Right } else { Side::Left });
        assert_eq!((derived.side, derived.fingers.len()), (mapped.side, 4));
        for ((a, tip, middle), (b, mapped_tip, mapped_middle)) in
            points(&derived, &zero(&derived)).iter().zip(&points(&mapped, &zero(&mapped)))
        {
            assert_eq!(a, b);
            assert!((tip - mapped_tip).norm() < 1e-3 && (middle - mapped_middle).norm() < 1e-3, "{name} {a:?}");
        }
        assert!(derived.base_from_operator.rotation.angle_to(&mapped.base_from_operator.rotation) < 0.01, "{name}");
        assert_eq!(mapped.finger(HumanFinger::Thumb).unwrap().joints.len(), 4);
    }
    assert_eq!(TargetHand::resolve("leap").unwrap().robot.name, TargetHand::bundled("leap_right").unwrap().robot.name);
    assert!(TargetHand::resolve("shadow").unwrap_err().to_string().contains("leap_left"));
    assert!(TargetHand::resolve("/nowhere/hand.urdf").unwrap_err().to_string().contains("/nowhere/hand.urdf"));
}

/// The reference takes LEAP's link `base` and Allegro's link `wrist` as its operator frame.
#[test]
fn vendors_models_derive_to_the_frame_of_the_reference() {
    let Some(shared) = shared() else { return };
    for (file, bundled, frame, tips) in [
        (
            "leap_hand/urdf/leap_hand_right.urdf",
            "leap_right",
            Some("base"),
            ["thumb", "index", "middle", "ring"].map(|f| format!("{f}_tip_head")),
        ),
        (
            "leap_hand/urdf/leap_hand_left.urdf",
            "leap_left",
            Some("base"),
            ["thumb", "index", "middle", "ring"].map(|f| format!("{f}_tip_head")),
        ),
        (
            "allegro_hand/urdf/allegro_hand_right.urdf",
            "allegro_right",
            Some("wrist"),
            [15, 3, 7, 11].map(|n| format!("link_{n}.0_tip")),
        ),
        (
            "allegro_hand/urdf/allegro_hand_left.urdf",
            "allegro_left",
            Some("wrist"),
            [15, 11, 7, 3].map(|n| format!("link_{n}.0_tip")),
        ),
        (
            "leap_hand/mjcf/right_hand_collision.xml",
            "leap_right",
            None,
            ["th", "if", "mf", "rf"].map(|f| format!("{f}_ds")),
        ),
        (
            "allegro_hand/mjcf/right_hand.xml",
            "allegro_right",
            None,
            ["th", "ff", "mf", "rf"].map(|f| format!("{f}_tip")),
        ),
        ("allegro_hand/mjcf/left_hand.xml", "allegro_left", None, ["th", "ff", "mf", "rf"].map(|f| format!("{f}_tip"))),
    ] {
        let hand = TargetHand::load(&shared.join(file), None).unwrap();
        let reference = TargetHand::bundled(bundled).unwrap();
        assert_eq!(hand.side, reference.side, "{file}");
        let found: Vec<&str> = hand.fingers.iter().map(|f| hand.robot.links[f.tip.link].name.as_str()).collect();
        assert_eq!(found, tips, "{file}");
        if let Some(frame) = frame {
            let poses = hand.robot.forward_kinematics(&zero(&hand), &Pose::identity());
            let expected = poses[hand.robot.require_link(frame).unwrap()];
            let turned = hand.base_from_operator.rotation.angle_to(&expected.rotation).to_degrees();
            eprintln!("{file}: turned by {turned:.4} degrees");
            assert!(turned < 0.1, "{file}: {turned}");
            assert!((hand.base_from_operator.translation.vector - expected.translation.vector).norm() < 1e-9, "{file}");
        }
        // LEAP's left model has a base elsewhere, and fingers that are not mirrored; the thumb of Allegro's left URDF is 10 mm
        // aside of the one of its MJCF, which is the mirror image.
        let tolerance = if file.ends_with("left.urdf") { 0.013 } else { 0.003 };
        for ((human, tip, _), (_, expected, _)) in
            points(&hand, &zero(&hand)).iter().zip(&points(&reference, &zero(&reference)))
        {
            let apart = (tip - expected).norm();
            assert!(apart < tolerance, "{file}: {human:?} {apart}");
            eprintln!("{file} {human:?}: {:.2} mm", apart * 1e3);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn a_hand_in_any_frame_and_with_any_names(
        turn in prop::array::uniform3(-3.0..3.0f64),
        shift in prop::array::uniform3(-0.2..0.2f64),
        which in 0..4usize,
        flags in prop::array::uniform5(any::<bool>()),
    ) {
        let names = [
            ["thumb", "index", "middle", "ring", "pinky"],
            ["0", "1", "2", "3", "4"],
            ["rh_THJ", "rh_FFJ", "rh_MFJ", "rh_RFJ", "rh_LFJ"],
            ["Thumb", "b", "c", "d", "e"],
        ][which];
        let [left, reversed, wrist_link, arm, coupled] = flags;
        let side = if left { -1.0 } else { 1.0 };
        let base_from_operator = Isometry3::new(Vector3::from(shift), Vector3::from(turn));
        let synthetic = Synthetic { side, base_from_operator, names, reversed, wrist_link, arm, coupled };
        let hand = TargetHand::load(&synthetic.file(&format!("any_{which}")), None).unwrap();
        prop_assert_eq!(hand.side, if left { Side::Left } else { Side::Right });
        let tips: Vec<String> = hand.fingers.iter().map(|f| hand.robot.links[f.tip.link].name.clone()).collect();
        prop_assert_eq!(tips, names.map(|n| format!("{n}_end")));
        prop_assert_eq!(hand.fingers.iter().map(|f| f.human).collect::<Vec<_>>(), HumanFinger::ALL);
        // The arm's joint stands at the end of its range that is nearest to zero.
        let held = Isometry3::rotation(Vector3::z() * if arm { 0.3 } else { 0.0 });
        let expected = base_from_operator * held;
        prop_assert!(hand.base_from_operator.rotation.angle_to(&expected.rotation) < 1e-6);
        prop_assert!((hand.base_from_operator.translation.vector - expected.translation.vector).norm() < 1e-6, "{:?}", hand.notes);
        for (human, tip, middle) in points(&hand, &zero(&hand)).iter().skip(1) {
            let k = *human as usize as f64 - 1.0;
            let knuckle = Point3::new(0.0, side * (0.03 - 0.02 * k), 0.09);
            prop_assert!((tip - (knuckle + Vector3::z() * BONES.iter().sum::<f64>())).norm() < 1e-6);
            prop_assert!((middle - (knuckle + Vector3::z() * BONES[0])).norm() < 1e-6);
        }
        let closed = hand.robot.joints.iter().filter(|j| j.limits.is_some_and(|(lo, hi)| lo == hi)).count();
        prop_assert_eq!(closed, usize::from(arm));
        prop_assert_eq!(hand.notes.iter().any(|n| n.contains("follows")), coupled);
    }

    /// Trees of links that are no hands, or strange ones: an answer or a message, never a panic.
    #[test]
    fn any_tree_of_links(
        links in prop::collection::vec((0..100usize, 0..4usize, 0..9usize, prop::array::uniform3(-0.05..0.05f64), any::<bool>()), 1..24),
    ) {
        let words = ["thumb", "index", "ring", "base", "wrist", "x", "tip", "ff", "rf"];
        let mut text = "<robot name=\"tree\"><link name=\"l0\"/>".to_owned();
        for (i, (parent, kind, word, p, zero)) in links.iter().enumerate() {
            let (child, parent) = (format!("{}_{}", words[*word], i + 1), parent % (i + 1));
            let parent = match parent {
                0 => "l0".to_owned(),
                k => format!("{}_{k}", words[links[k - 1].2]),
            };
            let kind = ["revolute", "prismatic", "fixed", "continuous"][*kind];
            let p = if *zero { [0.0; 3] } else { *p };
            text += &format!(
                "<link name=\"{child}\"/><joint name=\"j{i}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
                 <origin xyz=\"{} {} {}\"/><axis xyz=\"{} 1 0\"/><limit lower=\"-1\" upper=\"0.3\" effort=\"1\" velocity=\"1\"/></joint>",
                p[0], p[1], p[2], i % 3
            );
        }
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("hands_tree.urdf");
        std::fs::write(&path, text + "</robot>").unwrap();
        let robot = Robot::load(&path).unwrap();
        match TargetHand::derive(robot) {
            Ok(hand) => prop_assert!(hand.fingers.len() >= 2 && hand.fingers.iter().all(|f| !f.joints.is_empty())),
            Err(e) => prop_assert!(e.to_string().contains("; "), "{e}"),
        }
    }

    #[test]
    fn mirrored_hands_move_as_mirror_images(parts in prop::collection::vec(0.0..1.0f64, 16), which in 0..2usize) {
        let right = TargetHand::bundled(["leap_right", "allegro_right"][which]).unwrap();
        let left = TargetHand::bundled(["leap_left", "allegro_left"][which]).unwrap();
        let limits = right.robot.joints.iter().map(|j| j.limits.unwrap());
        let q: Vec<f64> = limits.zip(&parts).map(|((lo, hi), s)| lo + s * (hi - lo)).collect();
        for ((a, tip, middle), (b, left_tip, left_middle)) in points(&right, &q).iter().zip(&points(&left, &q)) {
            prop_assert_eq!(a, b);
            prop_assert!((Point3::new(tip.x, -tip.y, tip.z) - left_tip).norm() < 1e-15);
            prop_assert!((Point3::new(middle.x, -middle.y, middle.z) - left_middle).norm() < 1e-15);
        }
        let twice = left.mirrored();
        prop_assert_eq!(twice.robot, right.robot.clone());
        prop_assert_eq!((twice.fingers, twice.side), (right.fingers.clone(), right.side));
        prop_assert_eq!(twice.base_from_operator, right.base_from_operator);
        prop_assert_eq!(right.clone().for_side(Side::Right).base_from_operator, right.base_from_operator);
        prop_assert_eq!(right.for_side(Side::Left).base_from_operator, left.base_from_operator);
    }
}
/// Ring and little finger on a link of their own that folds the palm.
#[test]
fn fingers_that_share_a_part_of_the_palm() {
    let names = ["Thumb", "Index", "Middle", "Ring", "Pinky"];
    let mut text = Synthetic { names, ..Synthetic::default() }.urdf();
    for name in ["Ring", "Pinky"] {
        let joint = format!("<joint name=\"{name}_j0\" type=\"revolute\"><parent link=\"palm\"/>");
        assert!(text.contains(&joint));
        text = text.replace(&joint, &joint.replace("palm", "fold"));
    }
    let fold = "<link name=\"fold\"/><joint name=\"folding\" type=\"revolute\"><parent link=\"palm\"/><child link=\"fold\"/>\
                <axis xyz=\"0 0 1\"/><limit lower=\"0\" upper=\"0.5\" effort=\"1\" velocity=\"1\"/></joint></robot>";
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("hands_fold.urdf");
    std::fs::write(&path, text.replace("</robot>", fold)).unwrap();
    let hand = TargetHand::load(&path, None).unwrap();
    let tips: Vec<&str> = hand.fingers.iter().map(|f| hand.robot.links[f.tip.link].name.as_str()).collect();
    assert_eq!(tips, names.map(|n| format!("{n}_end")));
    assert_eq!(hand.fingers.iter().map(|f| f.joints.len()).collect::<Vec<_>>(), [4, 4, 4, 5, 5]);
    assert!(hand.base_from_operator.rotation.angle() < 1e-6);
}

/// A coupled hand that nobody mapped follows a person, on either side.
#[test]
fn a_derived_hand_can_be_retargeted_to() {
    let file = Synthetic { arm: true, wrist_link: true, ..Synthetic::default() }.file("follows");
    let right = TargetHand::load(&file, None).unwrap();
    for side in [Side::Right, Side::Left] {
        let hand = right.clone().for_side(side);
        let person = HandSkeleton::new(side).moving(60);
        for objective in [Objective::Vector, Objective::DexPilot, Objective::Position] {
            let clip = retarget(&person, &hand, &RetargetOptions::new(objective)).unwrap();
            let worst = clip.frames.iter().flat_map(|f| &f.fingers).filter_map(|f| f.residual_mm).fold(0.0, f64::max);
            let mean = clip.frames.iter().flat_map(|f| &f.fingers).filter_map(|f| f.residual_mm).sum::<f64>() / 300.0;
            eprintln!(
                "{side:?} {objective:?}: residual {mean:.1} mm, at most {worst:.1} mm, scale {:.2}",
                clip.scale.scale
            );
            assert!(mean < 15.0, "{side:?} {objective:?}: {mean}");
            for frame in &clip.frames {
                for q in [&frame.q, &frame.q_filtered] {
                    let mut followed = q.clone();
                    hand.robot.apply_mimic(&mut followed);
                    assert!(followed.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-12), "a follower is elsewhere");
                    let mut within = q.clone();
                    hand.robot.clamp_to_limits(&mut within);
                    assert!(within.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-12), "{within:?} {q:?}");
                }
            }
        }
    }
}

#[test]
fn a_hand_that_bends_both_ways_has_its_palm_where_the_thumb_is() {
    let even = |text: String| {
        text.replace("lower=\"-0.2\" upper=\"1.5\"", "lower=\"-1.5\" upper=\"1.5\"")
            .replace("lower=\"0\" upper=\"1.6\"", "lower=\"-1.6\" upper=\"1.6\"")
            .replace("lower=\"0\" upper=\"1.2\"", "lower=\"-1.2\" upper=\"1.2\"")
    };
    let load = |name: &str, text: String| {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("hands_{name}.urdf"));
        std::fs::write(&path, text).unwrap();
        TargetHand::load(&path, None)
    };
    let hand = load("even", even(Synthetic::default().urdf())).unwrap();
    assert!(hand.base_from_operator.rotation.angle() < 1e-6 && hand.side == Side::Right);
    assert!(hand.notes.iter().any(|n| n.contains("the side on which the thumb is")), "{:?}", hand.notes);
    // No joint limits at all.
    let unlimited =
        Synthetic { coupled: false, ..Synthetic::default() }.urdf().replace("type=\"revolute\"", "type=\"continuous\"");
    let hand = load("unlimited", unlimited).unwrap();
    assert!(hand.base_from_operator.rotation.angle() < 1e-6);
    assert_eq!(hand.notes.iter().filter(|n| n.contains("no limits")).count(), 20);
    // The thumb in the middle: index and little finger tell left from right, if names tell them.
    let thumb = "xyz=\"0.01 0.04 0.03\" rpy=\"-0.9 0 0\"";
    let middle = "xyz=\"0.02 0 0.03\" rpy=\"0 0.9 0\"";
    let central = Synthetic::default().urdf().replace(thumb, middle);
    assert!(central.contains(middle));
    let hand = load("central", central).unwrap();
    assert!(hand.side == Side::Right && hand.notes.iter().any(|n| n.contains("thumb in the middle")));
    let names = ["thumb", "a", "b", "c", "d"];
    let unnamed = Synthetic { names, ..Synthetic::default() }.urdf().replace(thumb, middle);
    let message = load("unnamed", unnamed).unwrap_err().to_string();
    assert!(message.contains("mapping file"), "{message}");
}
