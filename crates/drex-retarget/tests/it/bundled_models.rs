//! The bundled hands and their mappings against the URDF files that the reference reads.

use crate::support::shared;
use drex_core::Pose;
use drex_retarget::TargetHand;
use drex_robot::{Robot, joint_order};
use nalgebra::Point3;

/// Links of the URDF at wrist, tips and middles (thumb, index, middle, ring).
struct Names {
    model: &'static str,
    file: &'static str,
    wrist: &'static str,
    tips: [&'static str; 4],
    middles: [&'static str; 4],
}

const HANDS: [Names; 2] = [
    Names {
        model: "leap_right",
        file: "data/robots/leap_hand/urdf/leap_hand_right.urdf",
        wrist: "base",
        tips: ["thumb_tip_head", "index_tip_head", "middle_tip_head", "ring_tip_head"],
        middles: ["thumb_dip", "dip", "dip_2", "dip_3"],
    },
    Names {
        model: "allegro_right",
        file: "data/robots/allegro_hand/urdf/allegro_hand_right.urdf",
        wrist: "wrist",
        tips: ["link_15.0_tip", "link_3.0_tip", "link_7.0_tip", "link_11.0_tip"],
        middles: ["link_14.0", "link_2.0", "link_6.0", "link_10.0"],
    },
];

#[test]
fn tips_and_middles_are_those_of_the_urdf() {
    let Some(shared) = shared() else { return };
    for names in HANDS {
        let hand = TargetHand::bundled(names.model).unwrap();
        let urdf = Robot::load(&shared.join(names.file)).unwrap();
        let mut worst = [0.0_f64; 2];
        for sample in 0..50 {
            // Within the limits of the bundled model, each joint at its own pace.
            let mut q = hand.robot.mid_range();
            let mut other = vec![0.0; urdf.dof()];
            for (k, joint) in urdf.joints.iter().enumerate() {
                let j = hand.robot.joint_index(joint_order::alias(names.model, &joint.name).unwrap()).unwrap();
                let (lo, hi) = hand.robot.joints[j].limits.unwrap();
                q[j] = lo + (hi - lo) * (0.5 + 0.5 * ((sample * 31 + j * 7) as f64).sin());
                other[k] = q[j];
            }
            let ours = hand.robot.forward_kinematics(&q, &Pose::identity());
            let theirs = urdf.forward_kinematics(&other, &Pose::identity());
            let to_wrist = theirs[urdf.require_link(names.wrist).unwrap()].inverse();
            let to_operator = hand.base_from_operator.inverse();
            for (finger, (tip, middle)) in hand.fingers.iter().zip(names.tips.iter().zip(names.middles)) {
                for (k, (point, link)) in [(finger.tip, tip), (finger.middle, &middle)].into_iter().enumerate() {
                    let ours = to_operator * ours[point.link] * point.point;
                    let theirs = to_wrist * theirs[urdf.require_link(link).unwrap()] * Point3::origin();
                    worst[k] = worst[k].max((ours - theirs).norm());
                }
            }
        }
        println!("{}: tips {:.2e} m, middles {:.2e} m", names.model, worst[0], worst[1]);
        // The files round their numbers.
        assert!(worst[0] < 2e-5 && worst[1] < 1e-6, "{}: {worst:?}", names.model);
        for joint in &urdf.joints {
            let j = hand.robot.require_joint(joint_order::alias(names.model, &joint.name).unwrap()).unwrap();
            assert_eq!(hand.robot.joints[j].limits, joint.limits, "{}", joint.name);
        }
    }
}
