//! Contact-aware retargeting on shapes and hands with known answers, and on two recordings where they are at hand.

use std::path::{Path, PathBuf};

use drex_core::mesh::convex_hull;
use drex_core::{Object, Pose, TriMesh};
use drex_demo::{Demonstration, HandFrame, KEYPOINTS, KeyPoints, LoadOptions, transformed};
use drex_mesh::{GridOptions, read_mesh, solid_object};
use drex_retarget::*;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// On a coarse grid, which is quick to make.
pub fn solid(mesh: &TriMesh) -> Object {
    let mut options = GridOptions::default();
    options.nodes = 40 * 40 * 40;
    options.margin_m = Some(0.05);
    solid_object("thing", mesh, &options).unwrap()
}

pub fn cuboid(x: f64, y: f64, z: f64) -> TriMesh {
    let corners: Vec<Point3<f64>> =
        (0..8).map(|i| Point3::new([-x, x][i & 1], [-y, y][i >> 1 & 1], [-z, z][i >> 2])).collect();
    convex_hull(&corners).unwrap()
}

/// Along y.
pub fn cylinder(radius: f64, half: f64) -> TriMesh {
    let ring = |i: usize, z: f64| {
        let a = std::f64::consts::TAU * i as f64 / 48.0;
        Point3::new(radius * a.cos(), z, radius * a.sin())
    };
    let points: Vec<Point3<f64>> = (0..48).flat_map(|i| [ring(i, -half), ring(i, half)]).collect();
    convex_hull(&points).unwrap()
}

/// Key points of a person whose hand is the robot's at `q`, made smaller, in the frame of the robot's base.
fn person(target: &TargetHand, q: &[f64], size: f64) -> KeyPoints {
    let poses = target.robot.forward_kinematics(q, &Pose::identity());
    let wrist = Point3::from(target.base_from_operator.translation.vector);
    let mut points = [None; KEYPOINTS];
    points[0] = Some(wrist);
    for finger in &target.fingers {
        let at = |p: &LinkPoint| wrist + (poses[p.link] * p.point - wrist) * size;
        let (tip, middle) = (at(&finger.tip), at(&finger.middle));
        let first = target.robot.path_to(finger.middle.link).into_iter().find(|&l| l != 0).unwrap();
        let base = wrist + (Point3::from(poses[first].translation.vector) - wrist) * size;
        let i = finger.human.base();
        points[i] = Some(base);
        points[i + 1] = Some(middle);
        points[i + 2] = Some(nalgebra::center(&middle, &tip));
        points[i + 3] = Some(tip);
    }
    for k in 17..21 {
        let (ring, middle) = (points[k - 4].unwrap(), points[k - 8].unwrap());
        points[k] = Some(ring + (ring - middle));
    }
    points
}

/// Joints between straight (0) and the middle of their ranges (1).
fn bent(target: &TargetHand, part: f64) -> Vec<f64> {
    let mut straight = vec![0.0; target.robot.dof()];
    target.robot.clamp_to_limits(&mut straight);
    target.robot.mid_range().iter().zip(&straight).map(|(m, s)| s + part * (m - s)).collect()
}

/// A person reaches for a thing, closes the hand around it and lifts it. Its x axis points from the thumb to the fingers.
pub fn lift(target: &TargetHand, size: f64) -> Demonstration {
    let closed = person(target, &bent(target, 0.9), size);
    let thumb = closed[4].unwrap();
    let fingers = nalgebra::center(&closed[8].unwrap(), &closed[16].unwrap());
    let x = (fingers - thumb).normalize();
    let side = closed[8].unwrap() - closed[16].unwrap();
    let y = (side - x * x.dot(&side)).normalize();
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)]));
    let place = Isometry3::from_parts(
        Translation3::from(nalgebra::center(&thumb, &fingers).coords),
        UnitQuaternion::from_rotation_matrix(&turn),
    );
    let palm = target.base_from_operator * Vector3::x();
    let frames = (0..24_u32)
        .map(|t| {
            let reach = f64::from(t.min(10)) / 10.0;
            let up = Vector3::new(0.1, 0.2, 1.0).normalize() * 0.015 * f64::from(t.saturating_sub(11));
            let shift = Translation3::from(palm * (-0.12 * (1.0 - reach)) + up);
            let points = transformed(&person(target, &bent(target, 0.3 + 0.6 * reach), size), &Pose::from(shift));
            let mut frame = HandFrame::new(f64::from(t) / 30.0, points);
            frame.source_from_object = Some(Translation3::from(up) * place);
            frame
        })
        .collect();
    Demonstration::new("a person made of a robot", target.side, frames)
}

/// Thumb and at least two fingers within 5 mm, by their pads.
fn phases(frame: &GraspFrame) -> bool {
    frame.fingers[0].touches && frame.fingers.iter().filter(|f| f.gap_mm.abs() <= 5.0).count() >= 3
}

/// What phases for every clip, whatever the grasp.
fn keeps_the_limits(target: &TargetHand, clip: &GraspRetargeting) {
    for (t, frame) in clip.frames.iter().enumerate() {
        assert!(frame.joint_speed_rad_s <= 8.5, "frame {t}: {} rad/s", frame.joint_speed_rad_s);
        for (q, joint) in frame.grasp.joints_rad.iter().zip(&target.robot.joints) {
            let (lo, hi) = joint.limits.unwrap();
            assert!((lo..=hi).contains(q), "frame {t}: {} is {q}", joint.name);
        }
    }
}

#[test]
fn a_lifted_thing_is_held() {
    for name in ["leap_right", "allegro_right"] {
        let target = TargetHand::bundled(name).unwrap();
        for (what, mesh) in [("box", cuboid(0.03, 0.08, 0.06)), ("cylinder", cylinder(0.033, 0.09))] {
            let thing = solid(&mesh);
            let demo = lift(&target, 0.75);
            let clip = retarget_grasp(&demo, &target, &thing, &GraspOptions::default()).unwrap();
            keeps_the_limits(&target, &clip);
            assert_eq!(clip.frames.len(), demo.frames.len());
            // It moves from frame 12 on.
            let moving = &clip.frames[14..];
            assert!(moving.iter().all(|f| f.held), "{name} {what}: not seen to be held");
            let share = moving.iter().filter(|f| phases(f)).count() as f64 / moving.len() as f64;
            assert!(share >= 0.8, "{name} {what}: held in {share:.2} of the frames");
            for f in moving {
                assert!(f.evaluation.penetration_mm <= 2.0, "{name} {what}: {} mm deep", f.evaluation.penetration_mm);
                assert!(
                    f.evaluation.self_collision.as_ref().is_none_or(|c| c.depth_mm < 1.0),
                    "{name} {what}: {:?}",
                    f.evaluation.self_collision
                );
            }
            let closed = moving.iter().filter(|f| f.evaluation.force_closure).count();
            assert!(2 * closed >= moving.len(), "{name} {what}: force closure in {closed} of {}", moving.len());
        }
    }
}

#[test]
fn without_an_object_at_hand_it_is_the_vector_result() {
    let target = TargetHand::bundled("allegro_right").unwrap();
    let thing = solid(&cuboid(0.03, 0.04, 0.05));
    let mut demo = lift(&target, 0.75);
    for frame in &mut demo.frames {
        frame.source_from_object = Some(Isometry3::translation(3.0, 0.0, 0.0));
    }
    let plain = retarget(&demo, &target, &RetargetOptions::default()).unwrap();
    let clip = retarget_grasp(&demo, &target, &thing, &GraspOptions::default()).unwrap();
    for (a, b) in clip.frames.iter().zip(&plain.frames) {
        assert!(!a.held);
        let most = a.grasp.joints_rad.iter().zip(&b.q).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
        assert!(a.evaluation.self_collision.is_some() || a.joint_speed_rad_s > 8.0 || most < 0.02, "{most} rad away");
        assert!(a.evaluation.penetration_mm == 0.0);
    }
    keeps_the_limits(&target, &clip);
}

/// Frames `from..to` of a demonstration, as a clip of their own.
fn cut(demo: &Demonstration, from: usize, to: usize) -> Demonstration {
    let mut part = demo.clone();
    part.frames = demo.frames[from..to].to_vec();
    part
}

#[test]
fn every_cut_of_a_clip_is_retargeted() {
    // The larger box is one that the hand cannot get out of: there the frames beside a free one are asked for help.
    for (hand, size) in [("leap_right", 1.0), ("leap_right", 2.5), ("allegro_right", 2.5)] {
        let target = TargetHand::bundled(hand).unwrap();
        let thing = solid(&cuboid(0.03 * size, 0.08 * size, 0.06 * size));
        let demo = lift(&target, 0.75);
        let n = demo.frames.len();
        let cuts = (1..=3).flat_map(|len| (0..=n - len).map(move |from| (from, from + len)));
        for (from, to) in cuts.chain([(0, n - 1), (1, n), (5, 16), (9, 15)]) {
            let part = cut(&demo, from, to);
            let clip = retarget_grasp(&part, &target, &thing, &GraspOptions::default()).unwrap();
            assert_eq!(clip.frames.len(), to - from, "{hand}, frames {from} to {to}");
            keeps_the_limits(&target, &clip);
        }
    }
    let target = TargetHand::bundled("leap_right").unwrap();
    let thing = solid(&cuboid(0.03, 0.08, 0.06));
    let empty = cut(&lift(&target, 0.75), 0, 0);
    let error = retarget_grasp(&empty, &target, &thing, &GraspOptions::default()).unwrap_err();
    assert!(error.to_string().contains("pose of the object"), "{error}");
}

#[test]
fn what_is_missing_is_said() {
    let target = TargetHand::bundled("leap_right").unwrap();
    let thing = solid(&cuboid(0.03, 0.04, 0.05));
    let mut demo = lift(&target, 0.75);
    let mut options = GraspOptions::default();
    options.max_joint_speed = 0.0;
    let error = retarget_grasp(&demo, &target, &thing, &options).unwrap_err().to_string();
    assert!(error.contains("max_joint_speed"), "{error}");
    demo.frames.iter_mut().for_each(|f| f.source_from_object = None);
    let error = retarget_grasp(&demo, &target, &thing, &GraspOptions::default()).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("pose of the object"), "{error}");
}

#[test]
fn an_object_that_is_hidden_for_a_while_moves_on_between() {
    let target = TargetHand::bundled("leap_right").unwrap();
    let thing = solid(&cuboid(0.03, 0.04, 0.05));
    let mut demo = lift(&target, 0.75);
    let whole = retarget_grasp(&demo, &target, &thing, &GraspOptions::default()).unwrap();
    let hidden = [0, 7, demo.frames.len() - 1];
    hidden.iter().for_each(|&t| demo.frames[t].source_from_object = None);
    let clip = retarget_grasp(&demo, &target, &thing, &GraspOptions::default()).unwrap();
    for (t, (a, b)) in clip.frames.iter().zip(&whole.frames).enumerate() {
        assert_eq!(a.flags.contains(&drex_demo::FrameFlag::ObjectNotSeen), hidden.contains(&t));
        assert_eq!(a.held, b.held, "frame {t}");
    }
}

#[test]
fn hostile_key_points_do_not_panic() {
    let target = TargetHand::bundled("leap_right").unwrap();
    let thing = solid(&cuboid(0.03, 0.04, 0.05));
    let mut demo = lift(&target, 0.75);
    for (t, frame) in demo.frames.iter_mut().enumerate() {
        for k in 0..KEYPOINTS {
            match (7 * t + 3 * k) % 10 {
                0 | 1 => frame.points[k] = None,
                2 => frame.points[k] = Some(Point3::new(f64::NAN, 0.0, 1.0)),
                3 if t % 5 == 0 => frame.points[k] = Some(Point3::new(1e9, 0.0, -1e9)),
                _ => {}
            }
        }
    }
    let clip = retarget_grasp(&demo, &target, &thing, &GraspOptions::default()).unwrap();
    keeps_the_limits(&target, &clip);
    assert!(clip.frames.iter().any(|f| !f.flags.is_empty()));
}

#[test]
fn one_lift_gives_many_grasps_and_always_the_same() {
    let target = TargetHand::bundled("allegro_right").unwrap();
    let thing = solid(&cuboid(0.03, 0.08, 0.06));
    let symmetries = symmetries(&thing, 0.001);
    assert_eq!(symmetries.len(), 4, "a box with three different edges has three half turns");
    let demo = lift(&target, 0.75);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let clip = retarget_grasp(&demo, &target, &thing, &GraspOptions::default()).unwrap();
            let many = augment(&clip, &target, &thing, &AugmentOptions::default(), 40).unwrap();
            (clip.frames, many)
        })
    };
    let (frames, many) = run(1);
    assert_eq!((frames, many.clone()), run(3));
    assert_eq!(many.grasps.len(), 40, "{} attempts, {} accepted", many.attempts, many.accepted);
    for g in &many.grasps {
        assert!(g.grasp.is_accepted() && g.grasp.evaluation.force_closure && phases(&g.grasp) && g.symmetry < 4);
    }
    let used: std::collections::BTreeSet<usize> = many.grasps.iter().map(|g| g.symmetry).collect();
    assert!(used.len() > 1, "only {used:?}");
}

#[test]
fn a_cylinder_turns_about_its_axis_and_a_wedge_does_not_at_all() {
    let round = solid(&cylinder(0.03, 0.08));
    assert!(symmetries(&round, 0.001).len() >= 12);
    let mut corners = cuboid(0.03, 0.05, 0.08).vertices;
    corners[0] = Point3::origin();
    corners[3] = Point3::new(0.01, 0.02, 0.0);
    let wedge = solid(&convex_hull(&corners).unwrap());
    assert_eq!(symmetries(&wedge, 0.001).len(), 1);
}

/// The folder of recordings, or the remark that there is none.
fn shared() -> Option<PathBuf> {
    let found = std::env::var_os("DREX_SHARED").map(PathBuf::from);
    if found.is_none() {
        eprintln!("skipped: DREX_SHARED is not set");
    }
    found
}

/// The demands on a recording: share of frames held by pads, penetration, self-collision, closeness to the person, speed, closure.
/// `clean` is the share of frames without penetration or self-collision.
fn demands(demo: &Path, mesh: &Path, hand: &str, frames: &[std::ops::RangeInclusive<usize>], clean: f64) {
    let target = TargetHand::bundled(hand).unwrap();
    let mut grid = GridOptions::default();
    grid.margin_m = Some(0.1);
    let thing = solid_object("thing", &convex_hull(&read_mesh(mesh).unwrap().vertices).unwrap(), &grid).unwrap();
    let demo = Demonstration::load(demo, &LoadOptions::default()).unwrap();
    let clip = retarget_grasp(&demo, &target, &thing, &GraspOptions::default()).unwrap();
    keeps_the_limits(&target, &clip);
    let used: Vec<&GraspFrame> = frames.iter().cloned().flatten().map(|t| &clip.frames[t]).collect();
    let share = |rule: &dyn Fn(&GraspFrame) -> bool| used.iter().filter(|f| rule(f)).count() as f64 / used.len() as f64;
    let mean = |value: &dyn Fn(&GraspFrame) -> f64| used.iter().map(|f| value(f)).sum::<f64>() / used.len() as f64;
    assert!(share(&phases) >= 0.8, "{hand}: held in {:.2}", share(&phases));
    assert!(share(&|f| f.evaluation.penetration_mm <= 2.0) >= clean, "{hand}: penetration");
    assert!(share(&|f| f.evaluation.self_collision.is_none()) >= clean, "{hand}: self-collision");
    assert!(mean(&|f| f.mean_joint_distance_rad) <= 0.35, "{hand}: {} rad", mean(&|f| f.mean_joint_distance_rad));
    assert!(mean(&|f| f.wrist_shift_mm) <= 120.0, "{hand}: {} mm", mean(&|f| f.wrist_shift_mm));
    assert!(
        share(&|f| f.evaluation.force_closure) >= 0.6,
        "{hand}: force closure in {:.2}",
        share(&|f| f.evaluation.force_closure)
    );
}

#[test]
fn a_recorded_box_is_held() {
    let Some(shared) = shared() else { return };
    let folder = shared.join("data/grasps/dexycb_cracker_box");
    for hand in ["leap_right", "allegro_right"] {
        demands(&folder.join("demo.json"), &folder.join("object.obj"), hand, &[24..=73], 1.0);
    }
}

#[test]
fn every_pair_of_frames_of_a_recorded_box_is_retargeted() {
    let Some(shared) = shared() else { return };
    let folder = shared.join("data/grasps/dexycb_cracker_box");
    let thing = solid(&convex_hull(&read_mesh(&folder.join("object.obj")).unwrap().vertices).unwrap());
    let demo = Demonstration::load(&folder.join("demo.json"), &LoadOptions::default()).unwrap();
    for hand in ["leap_right", "allegro_right"] {
        let target = TargetHand::bundled(hand).unwrap();
        for from in 0..demo.frames.len() - 1 {
            let clip = retarget_grasp(&cut(&demo, from, from + 2), &target, &thing, &GraspOptions::default());
            assert_eq!(clip.unwrap().frames.len(), 2, "{hand}, frames {from} and {}", from + 1);
        }
    }
}

#[test]
fn a_recorded_bottle_is_held() {
    let Some(shared) = shared() else { return };
    // Tracked so badly that each frame is another grasp, in which rounding decides.
    let folder = shared.join("data/demos/dexmv_relocate_mustard");
    for hand in ["leap_right", "allegro_right"] {
        demands(&folder.join("hand.json"), &folder.join("object_collision.obj"), hand, &[42..=52, 72..=88], 0.95);
    }
}
