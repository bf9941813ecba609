//! The bundled hands: what they are, and how they compare with the published models.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test that fails by panic is what tests are")]

use std::path::PathBuf;

use drex_core::Pose;
use drex_robot::{Robot, Shape, joint_order};
use nalgebra::{Point3, Vector3};
use serde_json::Value;

const LEAP_TIPS: [&str; 4] = ["index_tip", "middle_tip", "ring_tip", "thumb_tip"];

fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("DREX_SHARED").map(|f| PathBuf::from(f).join("data"));
    if folder.is_none() {
        eprintln!("skipped: DREX_SHARED is not set");
    }
    folder
}

/// Evenly spread joint vectors within the limits (additive sequence, no randomness needed).
fn poses_within(robot: &Robot, n: usize) -> Vec<Vec<f64>> {
    (1..=n)
        .map(|k| {
            robot
                .joints
                .iter()
                .enumerate()
                .map(|(j, joint)| {
                    let s = (k as f64 * (2.0 + j as f64).sqrt()).fract();
                    joint.limits.map_or(0.0, |(lo, hi)| lo + s * (hi - lo))
                })
                .collect()
        })
        .collect()
}

#[test]
fn joints_limits_and_masses() {
    let leap = Robot::bundled("leap_right").unwrap();
    assert_eq!(leap.joint_names(), joint_order::find("leap_menagerie").unwrap());
    assert!((leap.total_mass_kg() - 0.746).abs() < 1e-9);
    // The vendor's limits in its own order.
    let lower = [-1.047, -0.314, -0.506, -0.366];
    let upper = [1.047, 2.23, 1.885, 2.042];
    let thumb = [(-0.349, 2.094), (-0.47, 2.443), (-1.20, 1.90), (-1.34, 1.88)];
    for (id, name) in joint_order::find("leap_sdk").unwrap().iter().enumerate() {
        let expected = if id < 12 { (lower[id % 4], upper[id % 4]) } else { thumb[id - 12] };
        assert_eq!(leap.joints[leap.require_joint(name).unwrap()].limits, Some(expected), "motor {id}");
    }
    let allegro = Robot::bundled("allegro_right").unwrap();
    assert_eq!(allegro.joint_names(), joint_order::find("allegro_ros").unwrap());
    assert!((allegro.total_mass_kg() - 0.9861).abs() < 1e-9);
    assert_eq!(leap.effort_limits().unwrap(), [0.29; 16]);
    // The version 4 driver's largest duty over its duty per N m.
    let duty = [375.0, 675.0, 450.0, 285.0, 525.0, 405.0, 270.0, 270.0];
    for (j, limit) in allegro.effort_limits().unwrap().into_iter().enumerate() {
        assert!((limit - duty[if j < 12 { j % 4 } else { j - 8 }] / 1200.0).abs() < 1e-12, "joint {j}: {limit} N m");
    }
    for robot in [&leap, &allegro] {
        assert_eq!((robot.dof(), robot.actuators.len()), (16, 16));
        assert!(robot.actuators.iter().enumerate().all(|(i, a)| {
            a.joint == i
                && robot.joints[i]
                    .limits
                    .zip(a.ctrl_range)
                    .is_some_and(|(l, c)| (l.0 - c.0).abs() + (l.1 - c.1).abs() < 1e-12)
        }));
        // The mirror image has the same motors.
        let left = Robot::bundled(&robot.name.replace("right", "left")).unwrap();
        assert_eq!(left.effort_limits().unwrap(), robot.effort_limits().unwrap());
        assert!(robot.links.iter().all(|l| l.inertial.is_some()));
    }
}

#[test]
fn fingers_palm_and_grasp_centre() {
    for (name, normal, along) in
        [("leap_right", -Vector3::z(), Vector3::x()), ("allegro_right", Vector3::x(), Vector3::z())]
    {
        let robot = Robot::bundled(name).unwrap();
        let fingers = robot.fingers();
        let names: Vec<&str> = fingers.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["index", "middle", "ring", "thumb"]);
        assert_eq!(fingers.iter().map(|f| f.is_thumb).collect::<Vec<_>>(), [false, false, false, true]);
        for f in &fingers {
            assert_eq!((f.joints.len(), f.links.len()), (4, 5));
            assert_eq!(robot.links[f.tip_link].name, format!("{}_tip", f.name));
            assert_eq!(f.tip_point, Point3::origin());
        }
        assert_eq!(robot.links[robot.palm_link().unwrap()].name, "palm");
        let found = robot.palm_normal().unwrap();
        assert!(found.dot(&normal) > 0.999, "{name}: {found}");
        let center = robot.grasp_center().unwrap();
        assert!(center.coords.dot(&normal) > 0.03, "{name}: {center}");
        // Flexion moves every fingertip out of the palm, the fingers also back along their length.
        let straight = robot.forward_kinematics(&[0.0; 16], &Pose::identity());
        for f in fingers.iter().filter(|f| !f.is_thumb) {
            let mut q = vec![0.0; 16];
            f.joints
                .iter()
                .filter(|&&j| robot.joints[j].axis.y != 0.0 || name == "leap_right")
                .for_each(|&j| q[j] = 0.5);
            let rot = robot.joint_index("if_rot").map(|_| f.joints[1]);
            rot.into_iter().for_each(|j| q[j] = 0.0);
            let bent = robot.forward_kinematics(&q, &Pose::identity());
            let moved = bent[f.tip_link].translation.vector - straight[f.tip_link].translation.vector;
            assert!(moved.dot(&normal) > 0.03 && moved.dot(&along) < -0.005, "{name} {}: {moved}", f.name);
        }
    }
}

#[test]
fn no_shapes_overlap_in_open_and_half_closed_hands() {
    for name in ["leap_right", "allegro_right"] {
        let robot = Robot::bundled(name).unwrap();
        for q in [robot.reference_position(), robot.mid_range()] {
            let poses = robot.forward_kinematics(&q, &Pose::identity());
            for a in 0..robot.links.len() {
                let samples: Vec<Point3<f64>> =
                    robot.surface_samples(a, 0.004).iter().map(|(p, _)| poses[a] * p).collect();
                for (b, geom) in robot.collision_geoms().filter(|(b, _)| robot.may_collide(a, *b)) {
                    let inside = samples.iter().map(|p| {
                        geom.shape.signed_distance(&(poses[b] * geom.link_from_geom).inverse_transform_point(p))
                    });
                    let deepest = inside.fold(0.0, f64::min);
                    assert!(
                        deepest > -1e-3,
                        "{name}: {} is {deepest} m inside {}",
                        robot.links[a].name,
                        robot.links[b].name
                    );
                }
            }
        }
    }
}

/// (ours, theirs, link pairs, point in their link, joint names of theirs for ours)
fn largest_tip_distance(
    ours: &Robot,
    theirs: &Robot,
    their_tips: &[(&str, Point3<f64>)],
    model: &str,
    ours_from_theirs: &Pose,
) -> f64 {
    let mut worst = 0.0f64;
    for q in poses_within(ours, 200) {
        let named = theirs.joints.iter().map(|j| {
            let name = joint_order::alias(model, &j.name).unwrap();
            (j.name.as_str(), q[ours.joint_index(name).unwrap()])
        });
        let a = ours.forward_kinematics(&q, &Pose::identity());
        let b = theirs.forward_kinematics(&theirs.joint_vector(named).unwrap(), ours_from_theirs);
        for (tip, (link, point)) in LEAP_TIPS.iter().zip(their_tips) {
            let ours_at = a[ours.link_index(tip).unwrap()].translation.vector;
            let theirs_at = (b[theirs.link_index(link).unwrap()] * point).coords;
            worst = worst.max((ours_at - theirs_at).norm());
        }
    }
    worst
}

#[test]
fn fingertips_agree_with_the_published_models() {
    let Some(shared) = shared() else { return };
    let leap = Robot::bundled("leap_right").unwrap();
    let allegro = Robot::bundled("allegro_right").unwrap();
    let o = Point3::origin();
    let finger = Point3::new(0.0, -0.048, 0.015);
    let thumb = Point3::new(0.0, -0.06, -0.015);

    let mjcf = Robot::load(&shared.join("robots/leap_hand/mjcf/right_hand_collision.xml")).unwrap();
    let tips = [("if_ds", finger), ("mf_ds", finger), ("rf_ds", finger), ("th_ds", thumb)];
    let d1 = largest_tip_distance(&leap, &mjcf, &tips, "leap_right", &Pose::identity());

    let urdf = Robot::load(&shared.join("robots/leap_hand/urdf/leap_hand_right.urdf")).unwrap();
    let palm = urdf.links[urdf.require_link("palm_lower").unwrap()].parent_from_link.inverse();
    let tips = [("index_tip_head", o), ("middle_tip_head", o), ("ring_tip_head", o), ("thumb_tip_head", o)];
    let d2 = largest_tip_distance(&leap, &urdf, &tips, "leap_right", &palm);

    let mjcf = Robot::load(&shared.join("robots/allegro_hand/mjcf/right_hand.xml")).unwrap();
    let end = |z| Point3::new(0.0, 0.0, z);
    let tips = [("ff_tip", end(0.0387)), ("mf_tip", end(0.0387)), ("rf_tip", end(0.0387)), ("th_tip", end(0.0543))];
    let d3 = largest_tip_distance(&allegro, &mjcf, &tips, "allegro_right", &Pose::identity());

    let urdf = Robot::load(&shared.join("robots/allegro_hand/urdf/allegro_hand_right.urdf")).unwrap();
    let tips = [("link_3.0_tip", o), ("link_7.0_tip", o), ("link_11.0_tip", o), ("link_15.0_tip", o)];
    let d4 = largest_tip_distance(&allegro, &urdf, &tips, "allegro_right", &Pose::identity());
    eprintln!(
        "largest fingertip distance: LEAP MJCF {d1:.1e}, LEAP URDF {d2:.1e}, Allegro MJCF {d3:.1e}, Allegro URDF {d4:.1e} m"
    );
    assert!([d1, d2, d3, d4].iter().all(|d| *d < 1e-3));
}

#[test]
fn fingers_are_found_in_the_published_models() {
    let Some(shared) = shared() else { return };
    for (file, bundled) in [
        ("leap_hand/mjcf/right_hand_collision.xml", "leap_right"),
        ("leap_hand/urdf/leap_hand_right.urdf", "leap_right"),
        ("allegro_hand/mjcf/right_hand.xml", "allegro_right"),
        ("allegro_hand/urdf/allegro_hand_right.urdf", "allegro_right"),
    ] {
        let robot = Robot::load(&shared.join("robots").join(file)).unwrap();
        let fingers = robot.fingers();
        assert_eq!(fingers.len(), 4, "{file}");
        assert_eq!(fingers.iter().filter(|f| f.is_thumb).count(), 1, "{file}");
        let ours = Robot::bundled(bundled).unwrap();
        let ours_poses = ours.forward_kinematics(&[0.0; 16], &Pose::identity());
        let palm = robot.palm_link().unwrap();
        let poses = robot.forward_kinematics(&[0.0; 16], &Pose::identity());
        // Fingers matched by their first joint.
        for f in &fingers {
            let first = joint_order::alias(bundled, &robot.joints[f.joints[0]].name).unwrap();
            let twin =
                ours.fingers().into_iter().find(|g| g.joints.contains(&ours.joint_index(first).unwrap())).unwrap();
            assert_eq!(twin.is_thumb, f.is_thumb, "{file} {}", f.name);
            let tip = poses[palm].inverse() * poses[f.tip_link] * f.tip_point;
            let apart = (tip.coords - ours_poses[twin.tip_link].translation.vector).norm();
            assert!(apart < 4e-3, "{file} {}: tips {apart} m apart", f.name);
        }
        let (a, b) = (robot.palm_normal().unwrap(), ours.palm_normal().unwrap());
        assert!(a.dot(&b) > 0.99, "{file}: {a} {b}");
    }
    // An arm with a gripper: the palm is the hand.
    let panda = Robot::load(&shared.join("robots/panda/mjcf/panda_collision.xml")).unwrap();
    assert_eq!(panda.links[panda.palm_link().unwrap()].name, "hand");
    assert_eq!(panda.fingers().len(), 2);
    assert!(panda.palm_normal().unwrap().z > 0.99 && panda.fingers().iter().all(|f| !f.is_thumb));
}

/// Our primitives against the published visual meshes, rigid part by rigid part, at zero, both ways.
#[test]
fn shapes_cover_the_published_meshes() {
    let Some(shared) = shared() else { return };
    for (file, bundled) in
        [("leap_hand/mjcf/right_hand.xml", "leap_right"), ("allegro_hand/mjcf/right_hand.xml", "allegro_right")]
    {
        let theirs = Robot::load(&shared.join("robots").join(file)).unwrap();
        let ours = Robot::bundled(bundled).unwrap();
        let a = ours.forward_kinematics(&[0.0; 16], &Pose::identity());
        let b = theirs.forward_kinematics(&[0.0; 16], &Pose::identity());
        // The joint that moves a link stands for the rigid part.
        let part = |robot: &Robot, mut l: usize| {
            while robot.links[l].joints.is_empty() && robot.links[l].parent.is_some() {
                l = robot.links[l].parent.unwrap();
            }
            robot.links[l].joints.first().map(|&j| robot.joints[j].name.clone())
        };
        let (mut uncovered, mut proud) = (Vec::new(), Vec::new());
        let mut parts: Vec<_> = (0..ours.links.len()).map(|l| part(&ours, l)).collect();
        parts.dedup();
        for this in parts {
            let mesh_points: Vec<Point3<f64>> = (0..theirs.links.len())
                .filter(|&i| part(&theirs, i) == this)
                .flat_map(|i| theirs.links[i].geoms.iter().map(move |g| (i, g)))
                .filter(|(_, g)| matches!(g.shape, Shape::Mesh(_)) && !g.collides())
                .flat_map(|(i, g)| {
                    g.shape.surface_samples(0.002).into_iter().map(move |(p, _)| (i, g.link_from_geom * p))
                })
                .map(|(i, p)| b[i] * p)
                .collect();
            let mine: Vec<_> = ours.collision_geoms().filter(|(l, _)| part(&ours, *l) == this).collect();
            // A point inside our shapes is covered; one outside counts with its distance.
            uncovered.extend(mesh_points.iter().map(|p| {
                let distance = |(l, g): &(usize, &drex_robot::Geom)| {
                    g.shape.signed_distance(&(a[*l] * g.link_from_geom).inverse_transform_point(p))
                };
                mine.iter().map(distance).fold(f64::INFINITY, f64::min).max(0.0)
            }));
            // A point of our surface counts with its distance to the nearest point sampled on their mesh.
            let surface = (0..ours.links.len())
                .filter(|&l| part(&ours, l) == this)
                .flat_map(|l| ours.surface_samples(l, 0.005).into_iter().map(move |(p, _)| (l, p)));
            proud.extend(surface.map(|(l, p)| {
                let p = a[l] * p;
                mesh_points.iter().map(|m| (m - p).norm_squared()).fold(f64::INFINITY, f64::min).sqrt()
            }));
        }
        let mean = |v: &[f64]| 1e3 * v.iter().sum::<f64>() / v.len() as f64;
        let beyond = |v: &[f64]| 100.0 * v.iter().filter(|d| **d > 4e-3).count() as f64 / v.len() as f64;
        eprintln!(
            "{bundled}: {} mesh points are {:.2} mm outside our shapes on average ({:.1} % more than 4 mm); {} points of our surface are {:.2} mm from the meshes ({:.1} % more than 4 mm)",
            uncovered.len(),
            mean(&uncovered),
            beyond(&uncovered),
            proud.len(),
            mean(&proud),
            beyond(&proud)
        );
        assert!(mean(&uncovered) < 1.0 && beyond(&uncovered) < 5.0);
        assert!(mean(&proud) < 4.0, "{bundled}");
    }
}

/// Human grasps of a tin, recorded in the order of LEAP's drivers: clipped to the limits, fingers and thumb close on each
/// other in front of the palm. With the columns in another order they do not.
#[test]
fn recorded_grasps_look_like_grasps() {
    let Some(shared) = shared() else { return };
    let rows = read_npy(&shared.join("drex_real/demos/cookie_leap_grasps.npy"));
    let meta: Value =
        serde_json::from_str(&std::fs::read_to_string(shared.join("drex_real/demos/cookie_leap_grasps.json")).unwrap())
            .unwrap();
    assert!(meta["joint_order"].as_str().unwrap().contains("LEAP SDK"));
    let robot = Robot::bundled("leap_right").unwrap();
    let fingers = robot.fingers();
    let normal = robot.palm_normal().unwrap();
    let measure = |order: &[&str]| {
        let (mut gap, mut front, mut clipped) = (0.0, 0.0, 0usize);
        for row in &rows {
            let mut q = robot.joint_vector_full(order, row).unwrap();
            clipped += robot.clamp_to_limits(&mut q);
            let poses = robot.forward_kinematics(&q, &Pose::identity());
            let tip = |i: usize| (poses[fingers[i].tip_link] * fingers[i].tip_point).coords;
            gap += (0..3).map(|i| (tip(i) - tip(3)).norm()).sum::<f64>() / 3.0;
            front += (0..4).map(|i| tip(i).dot(&normal)).fold(f64::INFINITY, f64::min);
        }
        let n = rows.len() as f64;
        (gap / n, front / n, clipped as f64 / n)
    };
    let open = {
        let poses = robot.forward_kinematics(&[0.0; 16], &Pose::identity());
        let tip = |i: usize| poses[fingers[i].tip_link].translation.vector;
        (0..3).map(|i| (tip(i) - tip(3)).norm()).sum::<f64>() / 3.0
    };
    let right = measure(joint_order::find("leap_sdk").unwrap());
    let wrong = measure(joint_order::find("leap_menagerie").unwrap());
    eprintln!(
        "{} grasps: fingertips to thumb {:.0} mm on average (open hand {:.0}), the hindmost tip {:.0} mm in front of the palm frame, {:.1} joints clipped; read in the wrong order {:.0} mm, {:.0} mm, {:.1}",
        rows.len(),
        right.0 * 1e3,
        open * 1e3,
        right.1 * 1e3,
        right.2,
        wrong.0 * 1e3,
        wrong.1 * 1e3,
        wrong.2
    );
    assert!(right.0 < 0.6 * open && right.1 > 0.03);
    assert!(right.2 < wrong.2, "the right order needs less clipping");
}

/// A two-dimensional float array in NumPy's format, little endian, C order.
fn read_npy(path: &std::path::Path) -> Vec<Vec<f64>> {
    let bytes = std::fs::read(path).unwrap();
    let header_len = u16::from_le_bytes([bytes[8], bytes[9]]) as usize;
    let header = std::str::from_utf8(&bytes[10..10 + header_len]).unwrap();
    let width = if header.contains("<f8") { 8 } else { 4 };
    assert!(header.contains("(132, 16)") && header.contains("'fortran_order': False"), "{header}");
    let values: Vec<f64> = bytes[10 + header_len..]
        .chunks_exact(width)
        .map(|c| {
            if width == 8 {
                f64::from_le_bytes(c.try_into().unwrap())
            } else {
                f64::from(f32::from_le_bytes(c.try_into().unwrap()))
            }
        })
        .collect();
    values.chunks(16).map(<[f64]>::to_vec).collect()
}

/// A second reader on the published URDF files: same joints, limits, origins and masses.
#[test]
fn urdf_rs_reads_the_same() {
    let Some(shared) = shared() else { return };
    for file in [
        "leap_hand/urdf/leap_hand_right.urdf",
        "leap_hand/urdf/leap_hand_left.urdf",
        "allegro_hand/urdf/allegro_hand_right.urdf",
        "allegro_hand/urdf/allegro_hand_left.urdf",
        "panda/urdf/panda_collision.urdf",
    ] {
        let path = shared.join("robots").join(file);
        let ours = Robot::load(&path).unwrap();
        let theirs = urdf_rs::read_file(&path).unwrap();
        assert_eq!(ours.links.len(), theirs.links.len(), "{file}");
        let movable: Vec<_> = theirs.joints.iter().filter(|j| j.joint_type != urdf_rs::JointType::Fixed).collect();
        assert_eq!(ours.dof(), movable.len(), "{file}");
        for j in &movable {
            let i = ours.require_joint(&j.name).unwrap();
            let joint = &ours.joints[i];
            assert_eq!(joint.limits, Some((j.limit.lower, j.limit.upper)));
            assert_eq!((joint.effort_limit, joint.velocity_limit), (Some(j.limit.effort), Some(j.limit.velocity)));
            let link = &ours.links[joint.link];
            assert_eq!(link.name, j.child.link);
            assert_eq!(ours.links[link.parent.unwrap()].name, j.parent.link);
            assert_eq!(link.parent_from_link.translation.vector, Vector3::from(j.origin.xyz.0));
            assert!((joint.axis - Vector3::from(j.axis.xyz.0).normalize()).norm() < 1e-15);
        }
        for l in &theirs.links {
            let link = &ours.links[ours.require_link(&l.name).unwrap()];
            if l.inertial.mass.value > 0.0 {
                assert_eq!(link.inertial.unwrap().mass_kg, l.inertial.mass.value);
            }
            assert_eq!(link.geoms.iter().filter(|g| g.collides()).count(), l.collision.len(), "{file} {}", l.name);
        }
    }
}

#[test]
fn orders_name_the_same_joints() {
    for (name, model) in [
        ("leap_sdk", "leap_right"),
        ("leap_menagerie", "leap_right"),
        ("leap_urdf", "leap_right"),
        ("allegro_ros", "allegro_right"),
        ("allegro_menagerie", "allegro_right"),
        ("allegro_urdf", "allegro_right"),
    ] {
        let robot = Robot::bundled(model).unwrap();
        let order = joint_order::find(name).unwrap();
        let values: Vec<f64> = (0..16).map(f64::from).collect();
        let q = robot.joint_vector_full(order, &values).unwrap();
        let back = joint_order::convert(&q, &robot.joint_names(), order).unwrap();
        assert_eq!(back, values);
    }
    // Motor numbers in the depth-first order of the URDF and of MuJoCo Menagerie.
    let sdk: Vec<f64> = (0..16).map(f64::from).collect();
    let to = |name: &str| {
        joint_order::convert(&sdk, joint_order::find("leap_sdk").unwrap(), joint_order::find(name).unwrap()).unwrap()
    };
    assert_eq!(to("leap_urdf"), [1., 0., 2., 3., 12., 13., 14., 15., 5., 4., 6., 7., 9., 8., 10., 11.]);
    assert_eq!(to("leap_menagerie"), [1., 0., 2., 3., 5., 4., 6., 7., 9., 8., 10., 11., 12., 13., 14., 15.]);
    assert!(joint_order::require("leap").unwrap_err().to_string().contains("leap_sdk"));
    assert!(
        joint_order::convert(&sdk, joint_order::find("leap_sdk").unwrap(), joint_order::find("allegro_ros").unwrap())
            .is_err()
    );
    assert_eq!(joint_order::alias("leap_right", "1"), Some("if_mcp"));
    assert_eq!(joint_order::alias("allegro_right", "joint_12.0"), Some("thj0"));
    assert_eq!(
        (
            joint_order::alias("leap_right", "01"),
            joint_order::alias("leap_right", "16"),
            joint_order::alias("panda", "0")
        ),
        (None, None, None)
    );
}
