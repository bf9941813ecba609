//! The same robots in both engines.

use std::collections::BTreeMap;
use std::sync::Arc;

use drex_core::Pose;
use drex_diffsim::{
    AppliedForce, Articulation, Base, ContactForce, Control, ForcePoint, Model, Part, Path, Scene, State, Workspace,
    rollout, step,
};
use drex_mujoco::{MjcfOptions, MujocoEngine};
use drex_robot::Robot;
use nalgebra::{Point3, UnitQuaternion, Vector3};

const G: f64 = 9.81;

/// The bundled hand, and a joint vector with bent fingers.
fn hand(base: Base<f64>) -> (Articulation<f64>, Vec<f64>) {
    let robot = Arc::new(Robot::bundled("leap_right").unwrap());
    let q = robot
        .joint_vector([
            ("if_mcp", 0.5),
            ("if_pip", 0.4),
            ("mf_mcp", 0.8),
            ("mf_dip", 0.3),
            ("th_cmc", 0.9),
            ("th_mcp", 0.2),
        ])
        .unwrap();
    (Articulation::new(robot, base).unwrap(), q)
}

/// Largest difference of joint angles between the engines, rad, and how far any joint moved.
fn joints_agree(model: &Model<f64>, scene: &Scene<f64>, start: &State<f64>, until_s: f64, rad: f64, moved_rad: f64) {
    let times: Vec<f64> = (1..=50).map(|i| f64::from(i) * until_s / 50.0).collect();
    let ours = rollout(model, scene, start, &times).unwrap();
    let theirs = drex_mujoco::rollout(model, scene, start, &times, &MjcfOptions::default()).unwrap();
    let (mut worst, mut moved) = (0.0_f64, 0.0_f64);
    for (a, b) in ours.joints[0].iter().zip(&theirs.joints[0]) {
        for ((x, y), z) in a.iter().zip(b).zip(&start.articulations[0].q) {
            worst = worst.max((x - y).abs());
            moved = moved.max((x - z).abs());
        }
    }
    println!("{worst:.5} rad, joints moved by up to {moved:.3} rad");
    assert!(moved > moved_rad, "they moved {moved} rad");
    assert!(worst < rad, "{worst} rad");
}

#[test]
fn a_hand_that_closes() {
    let side = UnitQuaternion::from_euler_angles(1.2, 0.3, 0.0);
    let (arm, q) = hand(Base::Fixed(Pose::from_parts(Vector3::new(0.0, 0.0, 0.5).into(), side)));
    let control: Vec<f64> = arm.actuators.iter().map(|a| q[a.joint] + 0.3).collect();
    let start = State::new(Vec::new(), vec![arm.at_rest(&q, 0.0).unwrap()]);
    let mut scene = Scene::empty();
    scene.controls.push(Control::constant(&control).unwrap());
    joints_agree(&Model::new(Vec::new()).with_articulation(arm), &scene, &start, 1.0, 0.005, 0.2);
}

#[test]
fn a_hand_without_drives_and_friction_that_swings() {
    let side = UnitQuaternion::from_euler_angles(1.2, 0.3, 0.0);
    let (mut arm, q) = hand(Base::Fixed(Pose::from_parts(Vector3::new(0.0, 0.0, 0.5).into(), side)));
    arm.actuators.clear();
    for j in &mut arm.joints {
        (j.friction_loss, j.damping, j.limits) = (0.0, 1e-3, None);
    }
    let start = State::new(Vec::new(), vec![arm.at_rest(&q, 0.0).unwrap()]);
    joints_agree(&Model::new(Vec::new()).with_articulation(arm), &Scene::empty(), &start, 0.5, 0.002, 1.0);
}

#[test]
fn a_hand_whose_base_is_moved_feels_it() {
    // Fingers without friction and drives: only the base's acceleration moves them, no gravity.
    let to = Pose::from_parts(Vector3::new(0.1, -0.2, 0.6).into(), UnitQuaternion::from_euler_angles(0.6, -0.4, 0.9));
    let path = Path::smooth(&[0.05, 0.45], &[Pose::translation(0.0, 0.0, 0.5), to]).unwrap();
    let (mut arm, q) = hand(Base::Path(path));
    arm.actuators.clear();
    for j in &mut arm.joints {
        (j.friction_loss, j.damping, j.limits) = (0.0, 1e-3, None);
    }
    let start = State::new(Vec::new(), vec![arm.at_rest(&q, 0.0).unwrap()]);
    let mut scene = Scene::empty();
    scene.gravity = Vector3::zeros();
    joints_agree(&Model::new(Vec::new()).with_articulation(arm), &scene, &start, 0.5, 0.002, 0.2);
}

#[test]
fn a_free_hand_pushed_at_a_fingertip() {
    let (mut arm, q) = hand(Base::Free);
    for j in &mut arm.joints {
        j.friction_loss = 0.0;
    }
    let control: Vec<f64> = arm.actuators.iter().map(|a| q[a.joint]).collect();
    let link = arm.robot.link_index("index_tip").unwrap() as u32;
    let mut scene = Scene::empty();
    scene.controls.push(Control::constant(&control).unwrap());
    let on = Part::Link { articulation: 0, link };
    let push = [Vector3::new(0.3, 0.5, -0.4), Vector3::zeros()];
    scene
        .forces
        .push(AppliedForce::new(on, &[0.05, 0.25], &push, ForcePoint::Body(Point3::new(0.0, 0.01, 0.0))).unwrap());
    let start = State::new(Vec::new(), vec![arm.at_rest(&q, 0.0).unwrap()]);
    let model = Model::new(Vec::new()).with_articulation(arm);
    joints_agree(&model, &scene, &start, 0.4, 0.002, 0.05);
    let ours = rollout(&model, &scene, &start, &[0.4]).unwrap().last.articulations[0].base.clone();
    let theirs =
        drex_mujoco::rollout(&model, &scene, &start, &[0.4], &MjcfOptions::default()).unwrap().last.articulations[0]
            .base
            .clone();
    let way = ours.world_from_base.translation.vector.norm();
    let apart = (ours.world_from_base.translation.vector - theirs.world_from_base.translation.vector).norm();
    let turned = ours.world_from_base.rotation.angle_to(&theirs.world_from_base.rotation);
    println!(
        "base {:.4} mm of {:.1} mm, {turned:.5} rad of {:.3}",
        apart * 1e3,
        way * 1e3,
        ours.world_from_base.rotation.angle()
    );
    assert!(way > 0.5 && apart < 5e-5 && turned < 1e-3);
}

#[path = "../../../drex-diffsim/examples/pick.rs"]
#[allow(dead_code)] // it has a main of its own
mod pick;

#[test]
fn a_hand_that_picks_a_box_or_cannot() {
    for (grip_force, reserve_nm, rises_m) in [(1.5, 0.1, 0.2), (0.5, 0.0, 0.0)] {
        let pick = pick::Pick { mass_kg: 0.2, friction: 0.5, cap_nm: 0.29, grip_force, reserve_nm, dt_s: 1e-3 };
        let (model, scene, start) = pick::scene(&pick).unwrap();
        // Before the lift, after it, and after a hold of three seconds.
        let times = [0.5, 2.5, 5.5];
        let ours = rollout(&model, &scene, &start, &times).unwrap();
        let theirs = drex_mujoco::rollout(&model, &scene, &start, &times, &MjcfOptions::default()).unwrap();
        for (engine, record) in [("ours", &ours), ("MuJoCo", &theirs)] {
            let [before, lifted, held] = [0, 1, 2].map(|i| record.bodies[0].poses[i].translation.vector);
            let (rise, drift) = (lifted.z - before.z, (held - lifted).norm());
            println!("grip force {grip_force}, {engine}: rises {rise:.4} m, drifts {:.4} mm in the hold", drift * 1e3);
            assert!((rise - rises_m).abs() < 2e-3 && drift < 1e-4);
        }
        for (a, b) in ours.bodies[0].poses.iter().zip(&theirs.bodies[0].poses) {
            let (way, turn) = ((a.translation.vector - b.translation.vector).norm(), a.rotation.angle_to(&b.rotation));
            println!("  apart by {:.3} mm, {turn:.4} rad", way * 1e3);
            assert!(way < 2e-3 && turn < 0.03);
        }
        for (a, b) in ours.joints[0][2].iter().zip(&theirs.joints[0][2]) {
            assert!((a - b).abs() < 0.01, "{a} rad, {b} rad");
        }
    }
}

#[test]
fn contacts_of_a_pick_are_told_alike() {
    let pick = pick::Pick { mass_kg: 0.2, friction: 0.5, cap_nm: 0.29, grip_force: 1.5, reserve_nm: 0.1, dt_s: 1e-3 };
    let (model, scene, start) = pick::scene(&pick).unwrap();
    let mut engine = MujocoEngine::new(&model, &scene, &start, &MjcfOptions::default()).unwrap();
    let mut state = start.clone();
    let mut work = Workspace::default();
    for _ in 0..3000 {
        engine.step().unwrap();
        step(&model, &scene, &mut state, &mut work).unwrap();
    }
    // The box hangs, so that the forces of the fingers together carry it. What presses index and middle finger against
    // each other through the box is not determined by statics, so that only normal forces compare.
    let per_link = |contacts: &mut dyn Iterator<Item = ContactForce<f64>>| {
        let mut sum = Vector3::zeros();
        let mut normal = BTreeMap::<Part, f64>::new();
        for c in contacts.filter(|c| c.force.norm() > 0.0) {
            assert_eq!(c.key.a, Part::Body(0), "{c:?}");
            assert!(c.normal.dot(&c.force) > 0.0 && c.velocity.norm() < 1e-3 && c.depth.abs() < 1e-3, "{c:?}");
            sum += c.force;
            *normal.entry(c.key.b).or_default() += c.force.dot(&c.normal);
        }
        assert!((sum - Vector3::z() * 0.2 * G).norm() < 0.02, "{sum}");
        normal
    };
    let ours = per_link(&mut work.contacts().copied());
    let theirs = per_link(&mut engine.contacts().into_iter());
    assert!(ours.len() == 3 && ours.keys().eq(theirs.keys()), "{ours:?} {theirs:?}");
    for (a, b) in ours.values().zip(theirs.values()) {
        println!("{a:.3} N, {b:.3} N");
        assert!((a - b).abs() < 0.2 * a, "{a} N, {b} N");
    }
}

#[test]
fn links_of_a_hand_touch_each_other_only_where_they_should() {
    // The fingers are spread into one another. With self-collision both engines stop them, without it neither does.
    for self_collision in [false, true] {
        let (mut arm, _) = hand(Base::Fixed(Pose::identity()));
        arm.self_collision = self_collision;
        let q = arm.robot.joint_vector([("if_mcp", 0.2), ("mf_mcp", 0.2)]).unwrap();
        let control = arm.control([("if_rot", 0.9), ("mf_rot", -0.9), ("if_mcp", 0.2), ("mf_mcp", 0.2)], 0.0).unwrap();
        let start = State::new(Vec::new(), vec![arm.at_rest(&q, 0.0).unwrap()]);
        let mut scene = Scene::empty();
        scene.controls.push(Control::constant(&control).unwrap());
        let joint = arm.robot.joint_index("if_rot").unwrap();
        let model = Model::new(Vec::new()).with_articulation(arm);
        let ours = rollout(&model, &scene, &start, &[1.0]).unwrap();
        let theirs = drex_mujoco::rollout(&model, &scene, &start, &[1.0], &MjcfOptions::default()).unwrap();
        let (a, b) = (ours.joints[0][0][joint], theirs.joints[0][0][joint]);
        println!("self-collision {self_collision}: {a:.3} rad, {b:.3} rad");
        assert!((a - b).abs() < 0.02 && (a.abs() < 0.7) == self_collision);
    }
}
