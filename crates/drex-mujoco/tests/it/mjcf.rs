//! The text that is written for MuJoCo, read again by the reader of robots: needs no library.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{Articulation, Base, Body, Collider, ConvexPolyhedron, Model, Scene, State};
use drex_mujoco::{Error, MjcfOptions, to_mjcf};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

fn prism() -> Model<f64> {
    let corner = |i: i32| {
        let a = 2.1 * f64::from(i / 2);
        Point3::new(0.03 * a.cos(), 0.03 * a.sin(), if i % 2 == 0 { -0.02 } else { 0.02 })
    };
    let piece = ConvexPolyhedron::from_points(&(0..6).map(corner).collect::<Vec<_>>()).unwrap();
    let unit = MassProperties {
        mass_kg: 1.0,
        center_of_mass: Point3::new(0.001, 0.002, 0.003),
        inertia: Matrix3::new(3e-4, 1e-5, 0.0, 1e-5, 3e-4, 2e-5, 0.0, 2e-5, 4e-4),
    };
    Model::new(vec![Body::new(&unit, 0.2, Arc::new(Collider::convex(vec![piece])))])
}

#[test]
fn a_hand_is_read_as_it_was_written() {
    for name in ["leap_right", "allegro_right"] {
        let robot = Arc::new(Robot::bundled(name).unwrap());
        let turned = UnitQuaternion::from_euler_angles(0.3, -0.8, 2.0);
        let base = Pose::from_parts(Vector3::new(0.1, 0.2, 0.3).into(), turned);
        let arm = Articulation::new(Arc::clone(&robot), Base::Fixed(base)).unwrap();
        let mut start = State::at_rest(Pose::translation(0.0, 0.0, 1.0));
        start.articulations.push(arm.at_rest(&robot.mid_range(), 0.0).unwrap());
        let mut scene = Scene::empty();
        scene.controls.push(drex_diffsim::Control::constant(&robot.mid_range()).unwrap());
        let text = to_mjcf(&prism().with_articulation(arm), &scene, &start, &MjcfOptions::default()).unwrap();
        let read = Robot::from_mjcf_str(&text, None).unwrap();
        assert!((read.file_world_from_base.inverse() * base).translation.vector.norm() < 1e-12);
        let q = robot.mid_range();
        let poses = robot.forward_kinematics(&q, &base);
        let again = read.forward_kinematics(&q, &base);
        assert_eq!((read.dof(), again.len()), (robot.dof(), poses.len()));
        for (a, b) in robot.links.iter().zip(&poses) {
            let other = again[read.link_index(&format!("arm_0/{}", a.name)).unwrap()];
            assert!(
                (b.inverse() * other).translation.vector.norm() < 1e-12 && b.rotation.angle_to(&other.rotation) < 1e-7
            );
        }
        let (m, n) = (robot.mass_matrix(&q), read.mass_matrix(&q));
        assert!((m.clone() - n).norm() < 1e-9 * m.norm());
        for (a, b) in robot.joints.iter().zip(&read.joints) {
            assert_eq!(b.name, format!("arm_0/{}", a.name));
            assert_eq!((a.damping, a.friction_loss, a.armature), (b.damping, b.friction_loss, b.armature));
            assert_eq!(a.limits, b.limits);
        }
        for (a, b) in robot.actuators.iter().zip(&read.actuators) {
            assert_eq!((a.joint, a.gear, a.force_range, a.ctrl_range), (b.joint, b.gear, b.force_range, b.ctrl_range));
        }
        assert_eq!(read.collision_geoms().count(), robot.collision_geoms().count());
    }
}

#[test]
fn numbers_keep_every_bit_and_what_has_no_counterpart_is_named() {
    let model = prism();
    let start = State::at_rest(Pose::translation(0.1, 1.0 / 3.0, 0.5));
    let scene = Scene::on_table(0.4);
    let text = to_mjcf(&model, &scene, &start, &MjcfOptions::default()).unwrap();
    // The body stands at its centre of mass.
    assert!(text.contains(&format!("{:?}", 1.0_f64 / 3.0 + 0.002)), "{text}");
    assert!(text.contains("<mesh name=\"body_0/0\" vertex=") && text.contains("type=\"plane\""));
}

#[test]
fn what_mujoco_would_change_without_a_word_is_refused() {
    let refused = |change: &dyn Fn(&mut MjcfOptions), part: &str| {
        let mut options = MjcfOptions::default();
        change(&mut options);
        let start = State::at_rest(Pose::translation(0.0, 0.0, 1.0));
        let error = to_mjcf(&prism(), &Scene::on_table(0.4), &start, &options).unwrap_err();
        assert!(matches!(error, Error::Options { .. }) && error.to_string().contains(part), "{error}");
    };
    refused(&|o| o.contact_time_s = Some(1e-4), "contact_time_s");
    refused(&|o| o.dt_s = Some(0.0), "time step");
    refused(&|o| o.impratio = f64::INFINITY, "impratio");
    refused(&|o| o.damping_ratio = -1.0, "damping_ratio");
    refused(&|o| o.impedance = [0.0, 0.95, 1e-3], "impedance");
    refused(&|o| o.impedance = [0.9, 0.8, 1e-3], "impedance");
    refused(&|o| o.impedance = [0.9, 1.0, 1e-3], "impedance");
    refused(&|o| o.impedance = [0.9, 0.95, 0.0], "depth of full impedance");
    refused(&|o| o.tolerance = f64::NAN, "tolerance");
}

/// Numbers of the first attribute of this name after `from`.
fn numbers(text: &str, from: &str, name: &str) -> Vec<f64> {
    let after = &text[text.find(from).unwrap_or_else(|| panic!("no {from} in {text}"))..];
    let value = after.split_once(&format!("{name}=\"")).unwrap().1.split_once('"').unwrap().0;
    value.split(' ').map(|x| x.parse().unwrap()).collect()
}

#[test]
fn a_box_beside_its_origin_is_written_as_a_box_around_its_centre() {
    let corner = |k: u32| {
        let side = |bit: u32, lo: f64, hi: f64| if k >> bit & 1 == 0 { lo } else { hi };
        Point3::new(side(0, 0.01, 0.05), side(1, -0.02, 0.04), side(2, 0.1, 0.12))
    };
    let piece = ConvexPolyhedron::from_points(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia: Matrix3::identity() * 0.01 };
    let model = Model::new(vec![Body::new(&unit, 0.2, Arc::new(Collider::convex(vec![piece])))]);
    let start = State::at_rest(Pose::identity());
    let text = to_mjcf(&model, &Scene::empty(), &start, &MjcfOptions::default()).unwrap();
    let near = |name: &str, expected: [f64; 3]| {
        let found = numbers(&text, "type=\"box\"", name);
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{name} {found:?}");
    };
    near("pos", [0.03, 0.01, 0.11]);
    near("size", [0.02, 0.03, 0.01]);
}

/// As heavy as nothing can push it, and as hard to turn as a ball of 16 cm.
#[test]
fn what_follows_a_path_is_heavy_and_hard_to_turn() {
    let model = prism();
    let mut scene = Scene::empty();
    let path = drex_diffsim::Path::linear(&[0.0, 1.0], &[Pose::identity(), Pose::translation(0.1, 0.0, 0.0)]).unwrap();
    scene.kinematic_bodies.push(drex_diffsim::KinematicBody::new(path, Arc::clone(&model.bodies[0].collider), 0.5));
    let start = State::at_rest(Pose::translation(0.0, 0.0, 1.0));
    let text = to_mjcf(&model, &scene, &start, &MjcfOptions::default()).unwrap();
    let (mass, inertia) = (numbers(&text, "mover_0", "mass"), numbers(&text, "mover_0", "fullinertia"));
    assert!(mass[0] > 100.0 * 0.2, "{mass:?}");
    for (k, j) in inertia.iter().enumerate() {
        let expected = if k < 3 { 0.01 * mass[0] } else { 0.0 };
        assert!((j - expected).abs() < 1e-9 * mass[0], "{inertia:?}");
    }
}
