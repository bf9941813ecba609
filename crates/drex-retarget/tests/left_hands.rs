//! Left hands, moved and scaled hands: what retargeting must not depend on.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test that fails by panic is what tests are")]

use drex_core::Pose;
use drex_retarget::{
    Demonstration, HandFrame, HandSkeleton, Objective, RetargetOptions, Retargeting, Scale, Side, TargetHand, mirrored,
    retarget, transformed,
};
use nalgebra::{Point3, Vector3};

const FRAMES: usize = 60;

fn with_points(clip: &Demonstration, side: Side, map: impl Fn(&HandFrame) -> HandFrame) -> Demonstration {
    Demonstration::new("mapped", side, clip.frames.iter().map(map).collect())
}

fn farthest(a: &Retargeting, b: &Retargeting) -> f64 {
    let of = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert_eq!(a.frames.len(), b.frames.len());
    a.frames
        .iter()
        .zip(&b.frames)
        .map(|(a, b)| of(&a.q, &b.q).max(of(&a.q_filtered, &b.q_filtered)))
        .fold(0.0, f64::max)
}

#[test]
fn a_mirrored_hand_gives_the_same_joint_values_on_the_mirrored_robot() {
    let clip = HandSkeleton::new(Side::Right).moving(FRAMES);
    let image = with_points(&clip, Side::Left, |f| HandFrame::new(f.t_s, mirrored(&f.points)));
    for name in ["leap", "allegro"] {
        let right = TargetHand::bundled(&format!("{name}_right")).unwrap();
        let left = TargetHand::bundled(&format!("{name}_left")).unwrap();
        for objective in [Objective::Vector, Objective::DexPilot] {
            let options = RetargetOptions::new(objective);
            let (a, b) = (retarget(&clip, &right, &options).unwrap(), retarget(&image, &left, &options).unwrap());
            let apart = farthest(&a, &b);
            println!("{name} {objective:?}: largest difference {apart:e} rad");
            assert!(apart < 1e-9, "{name} {objective:?}: {apart}");
            // And not because nothing moves.
            let mut still = a.clone();
            still.frames = vec![a.frames[0].clone(); FRAMES];
            assert!(farthest(&a, &still) > 0.5);
        }
        assert!(retarget(&clip, &left, &RetargetOptions::default()).unwrap_err().to_string().contains("left"));
    }
}

#[test]
fn where_the_hand_is_does_not_matter_nor_how_large() {
    let clip = HandSkeleton::new(Side::Right).moving(FRAMES);
    let elsewhere = Pose::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.4, 2.0, -1.0));
    let moved = with_points(&clip, Side::Right, |f| HandFrame::new(f.t_s, transformed(&f.points, &elsewhere)));
    let large = with_points(&clip, Side::Right, |f| {
        HandFrame::new(f.t_s, f.points.map(|p| p.map(|p| Point3::from(p.coords * 1.3))))
    });
    for name in ["leap_right", "allegro_left"] {
        let hand = TargetHand::bundled(name).unwrap().for_side(Side::Right);
        for objective in [Objective::Vector, Objective::DexPilot] {
            let options = RetargetOptions::new(objective);
            let plain = retarget(&clip, &hand, &options).unwrap();
            let apart = farthest(&plain, &retarget(&moved, &hand, &options).unwrap());
            assert!(apart < 1e-6, "{name} {objective:?} moved: {apart}");
            let larger = retarget(&large, &hand, &options).unwrap();
            assert!((larger.scale.scale * 1.3 / plain.scale.scale - 1.0).abs() < 1e-6);
            let apart = farthest(&plain, &larger);
            assert!(apart < 1e-6, "{name} {objective:?} scaled: {apart}");
        }
        let mut fixed = RetargetOptions::default();
        fixed.scale = Scale::Fixed(1.1);
        let apart = farthest(&retarget(&clip, &hand, &fixed).unwrap(), &retarget(&moved, &hand, &fixed).unwrap());
        assert!(apart < 1e-6, "{name} fixed: {apart}");
    }
}
