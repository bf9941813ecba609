//! What every hand must show: frames that do not matter, mirror images, and recordings that are broken.

use crate::support;

use crate::support::{HANDS, SEQUENCES, demonstration, shared};
use drex_demo::{Demonstration, FrameFlag, HandFrame, HandSkeleton, KEYPOINTS, Side, mirrored, transformed};
use drex_retarget::{
    Objective, RetargetOptions, RetargetedFrame, Retargeter, Retargeting, Scale, TargetHand, retarget,
};
use drex_robot::Mimic;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

const PER_FRAME: [Objective; 3] = [Objective::Vector, Objective::DexPilot, Objective::Position];

fn moved(demonstration: &Demonstration, change: impl Fn(&HandFrame) -> HandFrame) -> Demonstration {
    let frames = demonstration.frames.iter().map(change).collect();
    Demonstration::new(demonstration.source.clone(), demonstration.side, frames)
}

/// Largest difference of the joint angles, rad.
fn apart(a: &Retargeting, b: &Retargeting) -> f64 {
    let frames = a.frames.iter().zip(&b.frames);
    frames
        .flat_map(|(a, b)| [(&a.q, &b.q), (&a.q_filtered, &b.q_filtered)])
        .flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()))
        .fold(0.0, f64::max)
}

fn is_no_hand(frame: &RetargetedFrame) -> bool {
    frame.flags.iter().any(|f| matches!(f, FrameFlag::NoHand { .. }))
}

/// A made hand, and recorded ones where there is the shared folder.
fn hands_of_people() -> Vec<Demonstration> {
    let mut all = vec![HandSkeleton::new(Side::Right).moving(90)];
    if let Some(shared) = shared() {
        all.extend(SEQUENCES.map(|sequence| demonstration(&shared, sequence)));
    }
    all
}

#[test]
fn where_the_hand_is_does_not_matter() {
    let turn =
        Isometry3::from_parts(Vector3::new(0.4, -1.2, 0.7).into(), UnitQuaternion::new(Vector3::new(0.5, 1.1, -0.8)));
    let shift = Isometry3::translation(0.4, -1.2, 0.7);
    for person in hands_of_people() {
        for objective in PER_FRAME {
            // Each coordinate of `position` has its own loss: only shifting leaves it as it is.
            let change = if objective == Objective::Position { shift } else { turn };
            let other = moved(&person, |f| HandFrame::new(f.t_s, transformed(&f.points, &change)));
            for name in HANDS {
                let hand = TargetHand::bundled(name).unwrap();
                let options = RetargetOptions::new(objective);
                let [a, b] = [&person, &other].map(|d| retarget(d, &hand, &options).unwrap());
                assert!(apart(&a, &b) < 1e-9, "{name} {objective:?}: {:.1e}", apart(&a, &b));
                let (base_a, base_b) = (a.frames[7].source_from_base.unwrap(), b.frames[7].source_from_base.unwrap());
                assert!((change * base_a * base_b.inverse()).translation.vector.norm() < 1e-8);
            }
        }
    }
}

#[test]
fn with_automatic_scale_the_size_does_not_matter() {
    for person in hands_of_people() {
        for objective in [Objective::Vector, Objective::DexPilot] {
            for factor in [0.5, 1000.0 / 3.0] {
                let other = moved(&person, |f| HandFrame::new(f.t_s, f.points.map(|p| p.map(|p| p * factor))));
                let hand = TargetHand::bundled("leap_right").unwrap();
                let options = RetargetOptions::new(objective);
                let [a, b] = [&person, &other].map(|d| retarget(d, &hand, &options).unwrap());
                assert!(apart(&a, &b) < 1e-9, "{objective:?}: {:.1e}", apart(&a, &b));
                assert!((a.scale.scale / b.scale.scale / factor - 1.0).abs() < 1e-9);
                assert!(a.scale.note().is_none());
                assert!(b.scale.note().unwrap().contains("unit"));
            }
        }
    }
}

#[test]
fn mirrored_points_on_the_mirrored_hand_give_the_same_angles() {
    for person in hands_of_people() {
        let mut left = moved(&person, |f| HandFrame::new(f.t_s, mirrored(&f.points)));
        left.side = Side::Left;
        for name in HANDS {
            let right_hand = TargetHand::bundled(name).unwrap();
            let left_hand = TargetHand::bundled(&name.replace("right", "left")).unwrap();
            for objective in PER_FRAME {
                let options = RetargetOptions::new(objective);
                let a = retarget(&person, &right_hand, &options).unwrap();
                let b = retarget(&left, &left_hand, &options).unwrap();
                assert!(apart(&a, &b) < 1e-9, "{name} {objective:?}: {:.1e}", apart(&a, &b));
            }
            let error = retarget(&left, &right_hand, &RetargetOptions::default()).unwrap_err().to_string();
            assert!(error.contains("left") && error.contains("mirrored"), "{error}");
        }
    }
}

#[test]
fn a_stream_is_the_clip_and_both_are_the_same_every_time() {
    let person = HandSkeleton::new(Side::Right).moving(60);
    let hand = TargetHand::bundled("allegro_right").unwrap();
    for objective in PER_FRAME {
        let mut options = RetargetOptions::new(objective);
        options.scale = Scale::Fixed(1.3);
        let clip = retarget(&person, &hand, &options).unwrap();
        let mut stream = Retargeter::new(&hand, options).unwrap();
        for _ in 0..2 {
            let frames: Vec<_> = person.frames.iter().map(|f| stream.frame(f)).collect();
            for (a, b) in clip.frames.iter().zip(&frames) {
                assert_eq!((&a.q, &a.q_filtered, a.objective, &a.flags), (&b.q, &b.q_filtered, b.objective, &b.flags));
            }
            // y ← y + α (x − y), from the first frame on.
            for pair in frames.windows(2).filter(|_| objective != Objective::Position) {
                for ((y, x), before) in pair[1].q_filtered.iter().zip(&pair[1].q).zip(&pair[0].q_filtered) {
                    assert!((y - (before + 0.2 * (x - before))).abs() < 1e-15);
                }
            }
            assert_eq!(frames[0].q, frames[0].q_filtered);
            stream.reset();
        }
    }
}

/// A stream knows the person after the first frames.
#[test]
fn a_stream_scales_itself() {
    let person = HandSkeleton::new(Side::Right).moving(60);
    let hand = TargetHand::bundled("leap_right").unwrap();
    let mut stream = Retargeter::new(&hand, RetargetOptions::default()).unwrap();
    assert!(stream.scale().is_none());
    let frames: Vec<_> = person.frames.iter().map(|f| stream.frame(f)).collect();
    let scale = stream.scale().unwrap();
    assert!(scale.automatic && (0.8..1.6).contains(&scale.scale), "{scale:?}");
    assert!((scale.human_reach_m - 0.185).abs() < 1e-9, "{scale:?}");
    let residuals = frames.iter().flat_map(|f| f.fingers.iter().filter_map(|r| r.residual_mm));
    assert!(support::mean(residuals) < 15.0);
}

#[test]
fn broken_frames_are_flagged_and_the_rest_goes_on() {
    let person = HandSkeleton::new(Side::Right).moving(40);
    let hand = TargetHand::bundled("leap_right").unwrap();
    let mut broken = person.clone();
    broken.frames[5].points[8] = Some(Point3::new(f64::NAN, 0.0, 0.0));
    broken.frames[10].points = [None; KEYPOINTS];
    let line = |i: usize| Some(Point3::new(0.0, 0.0, 0.01 * i as f64));
    broken.frames[15].points = std::array::from_fn(line);
    broken.frames[20].points[12] = broken.frames[20].points[12].map(|p| p + Vector3::new(0.3, 0.0, 0.0));
    broken.frames[25].points = broken.frames[25].points.map(|p| p.map(|p| p * 1.6));
    for objective in PER_FRAME {
        let clip = retarget(&broken, &hand, &RetargetOptions::new(objective)).unwrap();
        let good = retarget(&person, &hand, &RetargetOptions::new(objective)).unwrap();
        assert!(good.frames.iter().all(|f| f.flags.is_empty()));
        let f = &clip.frames;
        assert_eq!(f[5].flags, [FrameFlag::MissingPoints { count: 1 }]);
        assert!(f[5].fingers[1].residual_mm.is_none() && f[5].fingers[2].residual_mm.is_some());
        assert!(is_no_hand(&f[10]) && is_no_hand(&f[15]));
        assert_eq!((&f[10].q, &f[15].q), (&f[9].q, &f[14].q));
        let jump = |f: &RetargetedFrame| f.flags.iter().any(|f| matches!(f, FrameFlag::Jump { .. }));
        assert!(jump(&f[20]) && jump(&f[21]) && !jump(&f[22]));
        assert!(f[25].flags.iter().any(|f| matches!(f, FrameFlag::BoneLength { ratio } if (ratio - 1.6).abs() < 1e-6)));
        let flagged = f.iter().filter(|f| !f.flags.is_empty()).count();
        assert_eq!(flagged, 7, "{objective:?}");
    }
}

#[test]
fn hands_with_fewer_fingers_and_coupled_joints_work_too() {
    let person = HandSkeleton::new(Side::Right).moving(60);
    for fingers in 2..=4 {
        let mut hand = TargetHand::bundled("allegro_right").unwrap();
        hand.fingers.truncate(fingers);
        for finger in &hand.fingers {
            let [.., middle, last] = finger.joints[..] else { panic!("{finger:?}") };
            hand.robot.joints[last].mimic = Some(Mimic { joint: middle, multiplier: 0.7, offset: 0.05 });
        }
        for objective in PER_FRAME {
            let clip = retarget(&person, &hand, &RetargetOptions::new(objective)).unwrap();
            for frame in &clip.frames {
                assert_eq!(frame.fingers.len(), fingers);
                for q in [&frame.q, &frame.q_filtered] {
                    assert!(hand.robot.joints.iter().zip(q).all(|(j, v)| {
                        let (lo, hi) = j.limits.unwrap();
                        *v >= lo && *v <= hi
                    }));
                    let mut coupled = q.clone();
                    hand.robot.apply_mimic(&mut coupled);
                    assert!(coupled.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-12));
                }
            }
        }
        let tips = retarget(&person, &hand, &RetargetOptions::default()).unwrap();
        let mean = support::mean(tips.frames.iter().flat_map(|f| f.fingers.iter().filter_map(|r| r.residual_mm)));
        println!("{fingers} fingers: {mean:.1} mm at scale {:.2}", tips.scale.scale);
        assert!(mean < 20.0);
    }
}

#[test]
fn options_that_make_no_sense_are_refused() {
    let mut hand = TargetHand::bundled("leap_right").unwrap();
    let refused = |hand: &TargetHand, objective, change: fn(&mut RetargetOptions)| {
        let mut options = RetargetOptions::new(objective);
        change(&mut options);
        Retargeter::new(hand, options).unwrap_err().to_string()
    };
    assert!(refused(&hand, Objective::Vector, |o| o.scale = Scale::Fixed(-1.0)).contains("scale -1"));
    assert!(refused(&hand, Objective::Vector, |o| o.low_pass_alpha = 0.0).contains("freeze"));
    assert!(refused(&hand, Objective::Vector, |o| o.norm_delta = f64::NAN).contains("norm_delta"));
    assert!(refused(&hand, Objective::Grasp, |_| ()).contains("whole sequence"));
    hand.fingers.remove(0);
    assert!(refused(&hand, Objective::DexPilot, |_| ()).contains("thumb"));
}

/// Coordinates as a broken reader might give them.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![8 => -0.3..0.3_f64, 1 => Just(0.0), 1 => any::<f64>()]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(48) })]

    #[test]
    fn nothing_makes_it_panic_or_leave_the_limits(
        coordinates in prop::collection::vec(prop::collection::vec(coordinate(), 3 * KEYPOINTS), 1..6),
        missing in prop::collection::vec(prop::collection::vec(prop::bool::weighted(0.3), KEYPOINTS), 6),
        allegro: bool,
        objective in prop::sample::select(PER_FRAME.to_vec()),
        automatic: bool,
    ) {
        let frames = coordinates.iter().zip(&missing).enumerate().map(|(i, (c, missing))| {
            let point = |k: usize| (!missing[k]).then(|| Point3::new(c[3 * k], c[3 * k + 1], c[3 * k + 2]));
            HandFrame::new(i as f64, std::array::from_fn(point))
        });
        let hand = TargetHand::bundled(HANDS[usize::from(allegro)]).unwrap();
        let mut options = RetargetOptions::new(objective);
        options.scale = if automatic { Scale::Auto } else { Scale::Fixed(1.6) };
        let demonstration = Demonstration::new("garbage", Side::Right, frames.collect());
        if let Ok(clip) = retarget(&demonstration, &hand, &options) {
            for frame in &clip.frames {
                for q in [&frame.q, &frame.q_filtered] {
                    for (value, joint) in q.iter().zip(&hand.robot.joints) {
                        let (lo, hi) = joint.limits.unwrap();
                        prop_assert!(*value >= lo && *value <= hi);
                    }
                }
                prop_assert!(frame.objective.is_finite() || is_no_hand(frame));
                let base = frame.source_from_base;
                prop_assert!(base.is_none_or(|b| b.to_matrix().iter().all(|v| v.is_finite())));
            }
        }
    }
}

/// A recorded hand of which three points in ten are missing: what is left of the palm says where it is.
#[test]
fn most_frames_with_missing_points_are_still_used() {
    let Some(shared) = shared() else { return };
    for sequence in SEQUENCES {
        let person = demonstration(&shared, sequence);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut thinned = person.clone();
        for p in thinned.frames.iter_mut().flat_map(|f| &mut f.points) {
            *p = p.filter(|_| !random.random_bool(0.3));
        }
        for name in HANDS {
            let hand = TargetHand::bundled(name).unwrap();
            let mut options = RetargetOptions::default();
            options.scale = Scale::Fixed(1.2);
            let [whole, part] = [&person, &thinned].map(|d| retarget(d, &hand, &options).unwrap());
            let used: Vec<_> = whole.frames.iter().zip(&part.frames).filter(|(_, f)| !is_no_hand(f)).collect();
            let tips = support::mean(used.iter().map(|(a, b)| difference(&a.q, &b.q)));
            println!("{sequence} {name}: {} of {} frames, {tips:.3} rad", used.len(), part.frames.len());
            assert!(used.len() * 10 >= part.frames.len() * 8);
            assert!(
                part.frames
                    .iter()
                    .zip(&thinned.frames)
                    .all(|(f, points)| { f.flags.is_empty() == points.points.iter().all(Option::is_some) })
            );
        }
    }
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    support::mean(a.iter().zip(b).map(|(a, b)| (a - b).abs()))
}
