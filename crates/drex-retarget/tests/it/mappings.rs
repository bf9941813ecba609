//! Mapping files: what they may say, and what is refused.

use std::path::Path;

use crate::made_hand::{Synthetic, points, shared};
use drex_demo::Side;
use drex_retarget::TargetHand;
use drex_robot::Robot;
use nalgebra::Vector3;

/// A right mapping of the synthetic hand, as text; `change` is (what, instead).
fn mapping(change: &[(&str, &str)]) -> String {
    let mut text = r#"side = "right"
[wrist]
link = "palm"
palm = [1, 0, 0]
tips = [0, 0, 1]
[fingers.thumb]
tip = { link = "thumb_end" }
[fingers.index]
tip = { link = "index_end" }
[fingers.middle]
tip = { link = "middle_end" }
middle = { link = "middle_2" }
"#
    .to_owned();
    for (what, instead) in change {
        assert!(text.contains(what), "{what}");
        text = text.replace(what, instead);
    }
    text
}

#[test]
fn a_mapping_that_does_not_fit_is_refused_with_the_remedy() {
    let file = Synthetic::default().file("mapping");
    let with = |text: &str| TargetHand::with_mapping(Robot::load(&file).unwrap(), Path::new("hand.toml"), text);
    let hand = with(&mapping(&[])).unwrap();
    assert_eq!(hand.fingers.len(), 3);
    assert!((hand.base_from_operator.translation.vector).norm() < 1e-12);
    for (what, instead, expected) in [
        ("thumb_end", "thumb_ennd", &["[fingers.thumb] tip", "did you mean \"thumb_end\"", "index_2"][..]),
        ("\"palm\"", "\"plam\"", &["[wrist] link", "did you mean \"palm\""]),
        ("\"palm\"", "\"index_2\"", &["[wrist] link", "does not move with the palm"]),
        ("\"right\"", "\"left\"", &["side", "right hand has it", "side = \"right\""]),
        ("\"right\"", "\"both\"", &["hand.toml", "both"]),
        ("[1, 0, 0]", "[-1, 0, 0]", &["out of the back of the hand", "palm = [1, 0, 0]"]),
        ("[1, 0, 0]", "[0, 1, 0]", &["points aside", "curl the wrong way", "palm = [1, 0, 0]"]),
        ("[0, 0, 1]", "[0, 1, 0]", &["[wrist] tips", "90 degrees", "tips = [0, 0, 1]"]),
        ("[0, 0, 1]", "[1, 0, 0]", &["parallel"]),
        ("[0, 0, 1]", "[0, 0, 0]", &["zero"]),
        ("tips = [0, 0, 1]", "", &["one of palm and tips is missing"]),
        ("link = \"palm\"", "", &["add link"]),
        ("link = \"palm\"", "link = \"palm\"\npoint_m = [0, 0, 0.3]", &["behind the wrist"]),
        ("link = \"palm\"", "lnk = \"palm\"", &["lnk", "line 3"]),
        ("\"index_end\"", "\"palm\"", &["[fingers.index] tip", "no joint moves link \"palm\""]),
        (
            "\"index_end\"",
            "\"index_2\"",
            &["[fingers.index] tip", "\"index_j3\" moves links beyond it", "use \"index_end\""],
        ),
        (
            "\"index_end\"",
            "\"index_3\"",
            &["the last joint, \"index_j3\"", "use link = \"index_end\", point_m = [0.0000"],
        ),
        ("\"index_end\"", "\"middle_end\"", &["[fingers.middle] tip", "index has its tip there"]),
        ("\"middle_2\"", "\"index_2\"", &["[fingers.middle] middle", "belongs to another finger"]),
        ("fingers.thumb", "fingers.ring", &["thumb", "[fingers.thumb]"]),
        ("fingers.thumb", "fingers.pollex", &["pollex"]),
    ] {
        let message = with(&mapping(&[(what, instead)])).unwrap_err().to_string();
        for part in expected {
            assert!(message.contains(part), "{what} -> {instead}: {message}");
        }
        assert!(message.contains("hand.toml"), "{message}");
    }
    let swapped = mapping(&[
        ("\"index_end\"", "\"x\""),
        ("\"middle_end\"", "\"index_end\""),
        ("\"x\"", "\"middle_end\""),
        ("middle = { link = \"middle_2\" }", ""),
    ]);
    let message = with(&swapped).unwrap_err().to_string();
    assert!(message.contains("farther from the thumb"), "{message}");
    // Only a palm is given; everything else follows from the model.
    let little = with("[wrist]\nlink = \"palm\"\npoint_m = [0.0, 0.0, -0.01]\n").unwrap();
    assert_eq!(little.fingers.len(), 5);
    assert!((little.base_from_operator.translation.vector - Vector3::new(0.0, 0.0, -0.01)).norm() < 1e-12);
    // Twenty degrees off is used, with a remark.
    let tilted = with(&mapping(&[("[1, 0, 0]", "[0.9, 0.45, 0]")])).unwrap();
    assert!(tilted.notes.iter().any(|n| n.contains("27 degrees away from x")), "{:?}", tilted.notes);
}

#[test]
fn a_mapping_file_may_name_its_model() {
    let model = Synthetic::default().file("named");
    let path = model.with_extension("toml");
    let name = model.file_name().unwrap().to_str().unwrap();
    std::fs::write(&path, format!("model = \"{name}\"\n{}", mapping(&[]))).unwrap();
    assert_eq!(TargetHand::load(&path, None).unwrap().fingers.len(), 3);
    assert_eq!(TargetHand::resolve(path.to_str().unwrap()).unwrap().fingers.len(), 3);
    assert_eq!(TargetHand::load(&model, Some(&path)).unwrap().fingers.len(), 3);
    std::fs::write(&path, mapping(&[])).unwrap();
    assert!(TargetHand::load(&path, None).unwrap_err().to_string().contains("add model = "));
    std::fs::write(&path, "model = \"leap_right\"\n").unwrap();
    assert_eq!(TargetHand::load(&path, None).unwrap().robot.name, TargetHand::bundled("leap").unwrap().robot.name);
}

#[test]
fn joints_that_follow_each_other_in_a_ring_are_refused() {
    let text = Synthetic::default().urdf().replace("<mimic joint=\"index_j2\"", "<mimic joint=\"index_j3\"");
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("hands_ring.urdf");
    std::fs::write(&path, text).unwrap();
    let message = TargetHand::load(&path, None).unwrap_err().to_string();
    assert!(message.contains("\"index_j3\""), "{message}");
}

#[test]
fn grippers_and_arms_are_no_hands_but_can_be_mapped() {
    let Some(shared) = shared() else { return };
    let panda = shared.join("panda/urdf/panda_collision.urdf");
    let message = TargetHand::load(&panda, None).unwrap_err().to_string();
    assert!(message.contains("thumb") && message.contains("mapping file"), "{message}");
    let text = r#"
side = "right"
[wrist]
link = "panda_hand"
point_m = [0, 0, -0.03]
palm = [1, 0, 0]
tips = [0, 0, 1]
[fingers.thumb]
tip = { link = "panda_leftfinger", point_m = [0, 0, 0.045] }
[fingers.index]
tip = { link = "panda_rightfinger", point_m = [0, 0, 0.045] }
"#;
    let with = |text: &str| TargetHand::with_mapping(Robot::load(&panda).unwrap(), Path::new("panda.toml"), text);
    let hand = with(text).unwrap();
    assert_eq!((hand.side, hand.fingers.len()), (Side::Right, 2));
    assert!(hand.notes.iter().any(|n| n.contains("panda_joint7") && n.contains("held")), "{:?}", hand.notes);
    assert!(hand.notes.iter().any(|n| n.contains("panda_finger_joint2") && n.contains("follows")));
    // The open gripper: thumb and index finger 8 cm apart, thumb on its side.
    let mut q = hand.robot.reference_position();
    hand.fingers.iter().flat_map(|f| &f.joints).for_each(|&j| q[j] = 0.04);
    hand.robot.clamp_to_limits(&mut q);
    let tips = points(&hand, &q);
    assert!((tips[0].1 - tips[1].1 - Vector3::new(0.0, 0.08, 0.0)).norm() < 1e-9, "{tips:?}");
    // Without the palm nothing says which way it faces.
    let message = with(&text.replace("palm = [1, 0, 0]", "").replace("tips = [0, 0, 1]", "")).unwrap_err().to_string();
    assert!(message.contains("has no palm") && message.contains("wrist.link"), "{message}");
    let message = with(&text.replace("point_m = [0, 0, 0.045]", "point_m = [0, 0, 0]")).unwrap_err().to_string();
    assert!(message.contains("the last joint, \"panda_finger_joint1\""), "{message}");
}
