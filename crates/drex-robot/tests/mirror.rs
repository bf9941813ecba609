//! Mirror images: the same joint values give the mirrored pose, and everything fixed to the links is mirrored with it.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test that fails by panic is what tests are")]

use std::path::PathBuf;

use drex_core::Pose;
use drex_robot::{MirrorPlane, Robot, joint_order};
use nalgebra::{Matrix3, Point3, Vector3};
use proptest::prelude::*;

const PLANES: [(MirrorPlane, [f64; 3]); 3] =
    [(MirrorPlane::X, [-1.0, 1.0, 1.0]), (MirrorPlane::Y, [1.0, -1.0, 1.0]), (MirrorPlane::Z, [1.0, 1.0, -1.0])];

/// A robot with everything that a mirror can get wrong: both kinds of joints, odd poses, anchors, references, all shapes.
const ODD: &str = r#"<mujoco model="odd">
  <asset><mesh name="wedge" vertex="0 0 0  0.03 0 0  0 0.02 0  0.004 0.003 0.05"/></asset>
  <worldbody><body name="root"><inertial pos="0.01 0.02 0.03" mass="0.3" fullinertia="3e-4 4e-4 5e-4 1e-5 2e-5 3e-5"/>
    <geom type="box" size="0.01 0.02 0.03" pos="0.01 0.02 -0.01" euler="20 30 40"/>
    <geom type="plane" size="1 1 1" pos="0 0 -0.1" euler="10 -20 5"/>
    <body name="a" pos="0.1 0.02 0.03" euler="10 50 -30"><joint name="turn" type="hinge" axis="1 2 3" pos="0.01 0.03 -0.02" ref="0.3"/>
      <geom type="mesh" mesh="wedge" pos="0.01 0 0.02" euler="3 4 5" mass="0.1"/>
      <body name="b" pos="-0.02 0.07 0.01" euler="70 -10 15"><joint name="slide" type="slide" axis="0.3 -1 0.2"/>
        <geom type="capsule" size="0.01 0.03" pos="0.02 0.01 0" euler="9 8 7" mass="0.2"/>
        <geom type="ellipsoid" size="0.01 0.03 0.02" pos="0.02 0.05 0" euler="19 8 7" mass="0.05"/>
        <geom type="cylinder" size="0.01 0.03" pos="-0.04 0.01 0" euler="29 8 7" mass="0.05"/>
      </body></body></body></worldbody></mujoco>"#;

fn models() -> Vec<Robot> {
    vec![
        Robot::bundled("leap_right").unwrap(),
        Robot::bundled("allegro_right").unwrap(),
        Robot::from_mjcf_str(ODD, None).unwrap(),
    ]
}

fn within(robot: &Robot, parts: &[f64]) -> Vec<f64> {
    let limits = robot.joints.iter().map(|j| j.limits.unwrap_or((-1.5, 1.5)));
    limits.zip(parts.iter().cycle()).map(|((lo, hi), s)| lo + s * (hi - lo)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn the_same_joint_values_give_the_mirrored_pose(parts in prop::collection::vec(0.0..1.0f64, 16), which in 0..3usize) {
        let robot = &models()[which];
        let q = within(robot, &parts);
        let qd: Vec<f64> = parts.iter().rev().take(robot.dof()).map(|s| s - 0.5).collect();
        let poses = robot.forward_kinematics(&q, &Pose::identity());
        for (plane, signs) in PLANES {
            let signs = Vector3::from(signs);
            let m = Matrix3::from_diagonal(&signs);
            let image = robot.mirrored_through(plane);
            let mirrored = image.forward_kinematics(&q, &Pose::identity());
            for (link, (a, b)) in poses.iter().zip(&mirrored).enumerate() {
                let (ra, rb) = (a.rotation.to_rotation_matrix(), b.rotation.to_rotation_matrix());
                prop_assert!((m * ra.matrix() * m - rb.matrix()).norm() < 1e-15);
                let p = Point3::new(0.01, 0.02, 0.03);
                let (at, image_at) = (a * p, b * Point3::from(m * p.coords));
                prop_assert!((m * at.coords - image_at.coords).norm() < 1e-15);
                let (linear, angular) = robot.jacobian(&poses, link, &at);
                let (image_linear, image_angular) = image.jacobian(&mirrored, link, &image_at);
                prop_assert!((m * linear - image_linear).norm() < 1e-14);
                prop_assert!((m * angular + image_angular).norm() < 1e-14);
            }
            // Mass matrix and bias force are numbers of the joints: the mirror does not change them.
            prop_assert!((robot.mass_matrix(&q) - image.mass_matrix(&q)).norm() < 1e-12);
            let g = Vector3::new(1.0, 2.0, -9.0);
            let (f, image_f) = (robot.bias_force(&q, &qd, &g), image.bias_force(&q, &qd, &(m * g)));
            prop_assert!((f - image_f).norm() < 1e-12);
        }
    }
}

#[test]
fn mirrored_twice_is_the_original() {
    for robot in models() {
        for (plane, _) in PLANES {
            let image = robot.mirrored_through(plane);
            assert_ne!(image, robot);
            assert_eq!(image.joint_names(), robot.joint_names());
            assert_eq!(image.actuators, robot.actuators);
            assert_eq!(image.mirrored_through(plane), robot);
            assert!((image.total_mass_kg() - robot.total_mass_kg()).abs() < 1e-15);
        }
        assert_eq!(robot.mirrored(), robot.mirrored_through(MirrorPlane::Y));
    }
    assert_eq!(Robot::bundled("leap_right").unwrap().mirrored().name, Robot::bundled("leap_left").unwrap().name);
    assert_eq!(Robot::from_mjcf_str(ODD, None).unwrap().mirrored().name, "odd_mirrored");
}

/// Mirrored points of the surface lie on the surface of the image, and their normals point out of it.
#[test]
fn surfaces_are_mirrored() {
    for robot in models() {
        for (plane, signs) in PLANES {
            let signs = Vector3::from(signs);
            let image = robot.mirrored_through(plane);
            for ((link, geom), (_, other)) in robot.collision_geoms().zip(image.collision_geoms()) {
                let mirror = |p: &Point3<f64>| Point3::from(p.coords.component_mul(&signs));
                let distance = |p: &Point3<f64>| other.shape.signed_distance(&(other.link_from_geom.inverse() * p));
                for (p, n) in geom.shape.surface_samples(0.005) {
                    let (p, n) = (geom.link_from_geom * p, geom.link_from_geom * n);
                    let (on, out) = (distance(&mirror(&p)), distance(&mirror(&(p + n * 1e-4))));
                    assert!(on.abs() < 1e-9 && out > 5e-5, "{} link {link}: {on} {out}", robot.name);
                }
                // A plane has no points; ask it for distances off it.
                for p in [Point3::new(0.1, 0.2, 0.3), Point3::new(-0.1, 0.2, -0.3)] {
                    let expected = geom.shape.signed_distance(&(geom.link_from_geom.inverse() * p));
                    assert!((distance(&mirror(&p)) - expected).abs() < 1e-12);
                }
            }
        }
    }
}

#[test]
fn left_hands_by_name() {
    for (left, right) in [("leap_left", "leap_right"), ("allegro_left", "allegro_right")] {
        assert_eq!(Robot::bundled(left).unwrap(), Robot::bundled(right).unwrap().mirrored());
        assert_eq!(Robot::resolve(left, &PathBuf::from("/nowhere")).unwrap(), Robot::bundled(left).unwrap());
        assert!(Robot::bundled_mjcf(left).is_none());
        let normals = [left, right].map(|n| Robot::bundled(n).unwrap().palm_normal().unwrap());
        assert!((normals[0].component_mul(&Vector3::new(1.0, -1.0, 1.0)) - normals[1]).norm() < 1e-12);
    }
    assert!(Robot::bundled("panda_left").unwrap_err().to_string().contains("leap_left"));
}

/// The vendors' left models are the mirror images but for the signs that [`joint_order::reversed_in_left`] lists, where the base of
/// LEAP's is, that LEAP's fingertips are half a millimetre aside of the middle of their fingers (which are not mirrored), and 10 mm
/// at the thumb of Allegro's URDF.
#[test]
fn vendors_left_models() {
    let Some(folder) = std::env::var_os("DREX_SHARED").map(|f| PathBuf::from(f).join("data/robots")) else {
        eprintln!("skipped: DREX_SHARED is not set");
        return;
    };
    let leap = ["index", "middle", "ring", "thumb"].map(|f| [format!("{f}_tip"), format!("{f}_tip_head")]);
    let numbered = [("index", 11), ("middle", 7), ("ring", 3), ("thumb", 15)];
    let allegro_urdf = numbered.map(|(f, n)| [format!("{f}_tip"), format!("link_{n}.0_tip")]);
    let letters = [("index", "ff"), ("middle", "mf"), ("ring", "rf"), ("thumb", "th")];
    let allegro_mjcf = letters.map(|(f, l)| [format!("{f}_distal"), format!("{l}_distal")]);
    for (file, model, tips, tolerance) in [
        ("leap_hand/urdf/leap_hand_left.urdf", "leap_left", leap, 3e-3),
        ("allegro_hand/urdf/allegro_hand_left.urdf", "allegro_left", allegro_urdf, 2e-6),
        ("allegro_hand/mjcf/left_hand.xml", "allegro_left", allegro_mjcf, 1e-6),
    ] {
        let ours = Robot::bundled(model).unwrap();
        let vendor = Robot::load(&folder.join(file)).unwrap();
        let reversed = joint_order::reversed_in_left(model).unwrap();
        let known = |name: &str| joint_order::alias(&model.replace("left", "right"), name).unwrap();
        let counterpart = |name: &str| match (file.ends_with("left.urdf"), known(name)) {
            (true, joint) if joint.starts_with("ffj") => joint.replace("ff", "rf"),
            (true, joint) if joint.starts_with("rfj") => joint.replace("rf", "ff"),
            (_, joint) => joint.to_owned(),
        };
        // Where the tips are, less where they are at the first joint vector.
        let mut start: Option<Vec<Vector3<f64>>> = None;
        let mut worst = 0.0f64;
        for k in 0..50_i32 {
            let parts: Vec<f64> = (0..16).map(|j| (0.3 + f64::from(k) * (2.0 + f64::from(j)).sqrt()).fract()).collect();
            let q = within(&ours, &parts);
            let theirs = vendor.joints.iter().map(|joint| {
                let name = counterpart(&joint.name);
                let value = q[ours.require_joint(&name).unwrap()];
                if reversed.contains(&name.as_str()) { -value } else { value }
            });
            let theirs: Vec<f64> = theirs.collect();
            let outside = theirs
                .iter()
                .zip(&vendor.joints)
                .any(|(v, j)| j.limits.is_some_and(|(lo, hi)| *v < lo - 1e-9 || *v > hi + 1e-9));
            assert!(!outside, "{file}: the limits are those of the mirror image");
            let a = ours.forward_kinematics(&q, &Pose::identity());
            let b = vendor.forward_kinematics(&theirs, &Pose::identity());
            let (a_palm, b_palm) = (a[ours.palm_link().unwrap()], b[vendor.palm_link().unwrap()]);
            let apart: Vec<Vector3<f64>> = tips
                .iter()
                .map(|[mine, its]| {
                    let mine = (a_palm.inverse() * a[ours.require_link(mine).unwrap()]).translation.vector;
                    let its = (b_palm.inverse() * b[vendor.require_link(its).unwrap()]).translation.vector;
                    mine - its
                })
                .collect();
            let first = start.get_or_insert_with(|| apart.clone());
            for ((now, then), [tip, _]) in apart.iter().zip(first).zip(&tips) {
                let moved = match file.ends_with("allegro_hand_left.urdf") && tip.starts_with("thumb") {
                    // Beyond the first joint, so that it turns with it.
                    true => (now.norm() - 0.010).abs(),
                    false => (*now - *then).norm(),
                };
                worst = worst.max(moved);
                assert!(moved < tolerance, "{file} {tip}: {now} {then}");
            }
        }
        eprintln!("{file}: to {worst:.1e} m");
    }
}
