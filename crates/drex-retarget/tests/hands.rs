//! Any hand: what is derived from a model, what a mapping file may say, and what is refused.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test that fails by panic is what tests are")]

use std::path::PathBuf;

use drex_core::Pose;
use drex_retarget::{HumanFinger, Side, TargetHand};
use nalgebra::{Point3, Vector3};

fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("DREX_SHARED").map(|f| PathBuf::from(f).join("data/robots"));
    if folder.is_none() {
        eprintln!("skipped: DREX_SHARED is not set");
    }
    folder
}

#[test]
fn probe() {
    let Some(shared) = shared() else { return };
    for (file, reference) in [
        ("leap_hand/urdf/leap_hand_right.urdf", "leap_right"),
        ("leap_hand/mjcf/right_hand_collision.xml", "leap_right"),
        ("leap_hand/urdf/leap_hand_left.urdf", "leap_left"),
        ("allegro_hand/urdf/allegro_hand_right.urdf", "allegro_right"),
        ("allegro_hand/urdf/allegro_hand_left.urdf", "allegro_left"),
        ("allegro_hand/mjcf/right_hand.xml", "allegro_right"),
        ("allegro_hand/mjcf/left_hand.xml", "allegro_left"),
    ] {
        let hand = TargetHand::load(&shared.join(file), None).unwrap();
        println!("== {file} {:?}", hand.side);
        for n in &hand.notes {
            println!("   {n}");
        }
        let bundled = TargetHand::bundled(reference).unwrap();
        let poses = |h: &TargetHand| {
            let p = h.robot.forward_kinematics(&vec![0.0; h.robot.dof()], &Pose::identity());
            h.fingers
                .iter()
                .map(|f| {
                    let to = h.base_from_operator.inverse();
                    let palm = p[h.robot.palm_link().unwrap()];
                    (f.human, to * p[f.tip.link] * f.tip.point, to * p[f.middle.link] * f.middle.point, palm)
                })
                .collect::<Vec<_>>()
        };
        for (a, b) in poses(&hand).iter().zip(&poses(&bundled)) {
            println!("{:?} tip {:.4} mid {:.4}   {:.4?} {:.4?}", a.0, (a.1 - b.1).norm(), (a.2 - b.2).norm(), a.1, b.1);
        }
    }
}
