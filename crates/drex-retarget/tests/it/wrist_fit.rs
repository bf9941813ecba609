//! Wrist fits on shapes with exact distances: what must be found, what must be refused, and that threads do not matter.

use std::sync::Arc;

use drex_core::{MassProperties, Object, Pose, SdfSample, SignedDistance, SolidGeometry};
use drex_retarget::{Error, WristFit, WristFitOptions, fit_wrist, fit_wrists};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3, Vector3};

/// An upright cylinder about the origin.
#[derive(Clone, Copy)]
struct Cylinder {
    radius: f64,
    half: f64,
}

impl SignedDistance for Cylinder {
    fn signed_distance(&self, p: &Point3<f64>) -> SdfSample {
        let r = p.x.hypot(p.y);
        let out = Vector3::new(p.x, p.y, 0.0) / r.max(1e-12);
        let (a, b) = (r - self.radius, p.z.abs() - self.half);
        let end = Vector3::z() * 1f64.copysign(p.z);
        if a > 0.0 && b > 0.0 {
            let d = a.hypot(b);
            return SdfSample { distance_m: d, gradient: (out * a + end * b) / d };
        }
        if a > b { SdfSample { distance_m: a, gradient: out } } else { SdfSample { distance_m: b, gradient: end } }
    }
}

impl SolidGeometry for Cylinder {
    fn exact(&self) -> &dyn SignedDistance {
        self
    }

    fn bounding_box(&self) -> (Point3<f64>, Point3<f64>) {
        let corner = Point3::new(self.radius, self.radius, self.half);
        (-corner, corner)
    }
}

impl Cylinder {
    fn fit(self, robot: &Robot, joints: &[f64], options: &WristFitOptions) -> WristFit {
        fit_wrist(robot, joints, &self.on_table(), options).unwrap()
    }

    /// The solid of 0.2 kg on the table.
    fn on_table(self) -> Object {
        let inertia = Matrix3::identity() * 1e-4;
        let body = MassProperties { mass_kg: 0.2, center_of_mass: Point3::origin(), inertia };
        let mut object = Object::of_parts(Vec::new(), body).with_rest_pose(Pose::translation(0.0, 0.0, self.half));
        object.geometry = Arc::new(self);
        object
    }
}

/// A half-closed hand with the thumb against the fingers, by joint name.
pub fn half_closed(robot: &Robot) -> Vec<f64> {
    let named: &[(&str, f64)] = match robot.name.as_str() {
        "leap_right" => &[
            ("if_mcp", 0.8),
            ("if_pip", 0.6),
            ("if_dip", 0.5),
            ("mf_mcp", 0.8),
            ("mf_pip", 0.6),
            ("mf_dip", 0.5),
            ("rf_mcp", 0.8),
            ("rf_pip", 0.6),
            ("rf_dip", 0.5),
            ("th_cmc", 1.5),
            ("th_axl", 0.3),
            ("th_mcp", 0.2),
            ("th_ipl", 0.3),
        ],
        _ => &[
            ("ffj1", 0.8),
            ("ffj2", 0.7),
            ("ffj3", 0.5),
            ("mfj1", 0.8),
            ("mfj2", 0.7),
            ("mfj3", 0.5),
            ("rfj1", 0.8),
            ("rfj2", 0.7),
            ("rfj3", 0.5),
            ("thj0", 1.2),
            ("thj1", 0.3),
            ("thj2", 0.4),
            ("thj3", 0.5),
        ],
    };
    robot.joint_vector(named.iter().copied()).unwrap()
}

pub fn quick() -> WristFitOptions {
    let mut options = WristFitOptions::default();
    options.initial_guesses = 256;
    options.kept = (32, 8);
    options
}

#[test]
fn both_hands_find_a_grasp_of_a_can_and_keep_the_rules() {
    let can = Cylinder { radius: 0.033, half: 0.06 };
    for name in ["leap_right", "allegro_right"] {
        let robot = Robot::bundled(name).unwrap();
        let recorded = half_closed(&robot);
        let fit = can.fit(&robot, &recorded, &quick());
        let found = &fit.evaluation;
        assert!(found.passed && found.grip_force_n.is_some() && found.force_closure, "{name}: {found:?}");
        assert!(found.penetration_mm <= 2.0 && found.table_clearance_mm >= 0.0);
        assert_eq!((fit.grasp.contacts.len(), fit.grasp.grip_force_n), (found.contacts.len(), found.grip_force_n));
        assert!(fit.largest_correction_rad() <= 0.15 + 1e-12);
        for (k, joint) in robot.joints.iter().enumerate() {
            let (lo, hi) = joint.limits.unwrap();
            assert!((lo..=hi).contains(&fit.grasp.joints_rad[k]), "{} outside its limits", joint.name);
            assert!((recorded[k] + fit.clipped_rad[k] + fit.correction_rad[k] - fit.grasp.joints_rad[k]).abs() < 1e-12);
        }
        // What the verdict says is what the geometry says, measured anew.
        let poses = robot.forward_kinematics(&fit.grasp.joints_rad, &fit.grasp.object_from_base);
        let mut deepest = f64::INFINITY;
        let mut lowest = f64::INFINITY;
        for (link, pose) in poses.iter().enumerate() {
            for (p, _) in robot.surface_samples(link, 0.003) {
                let p = pose * p;
                deepest = deepest.min(can.signed_distance(&p).distance_m);
                lowest = lowest.min(p.z + can.half);
            }
        }
        assert!((-1e3 * deepest - found.penetration_mm).abs() < 1e-9);
        assert!((1e3 * lowest - found.table_clearance_mm).abs() < 1e-9);
        let touching = found.fingers.iter().filter(|f| f.touches).count();
        assert!(touching >= 3 && found.fingers.iter().any(|f| f.touches && f.finger.starts_with("th")));
    }
}

#[test]
fn an_object_that_does_not_fit_the_hand_is_refused_with_reasons() {
    let robot = Robot::bundled("leap_right").unwrap();
    // A pea: no posture of an open hand puts thumb and two fingers on it.
    let pea = Cylinder { radius: 0.003, half: 0.003 };
    let fit = pea.fit(&robot, &robot.joint_vector::<&str>([]).unwrap(), &quick());
    assert!(!fit.evaluation.passed && fit.evaluation.grip_force_n.is_none(), "{fit:?}");
    let words = "touch the object, 2 are asked for (not touching: ";
    assert!(fit.evaluation.failures.iter().any(|f| f.contains(words)), "{:?}", fit.evaluation.failures);
}

#[test]
fn without_corrections_the_record_is_kept() {
    let robot = Robot::bundled("leap_right").unwrap();
    let mut options = quick();
    options.max_finger_correction_rad = 0.0;
    let recorded = half_closed(&robot);
    let fit = Cylinder { radius: 0.033, half: 0.06 }.fit(&robot, &recorded, &options);
    assert_eq!(fit.largest_correction_rad(), 0.0);
    assert_eq!(fit.grasp.joints_rad, recorded);
}

#[test]
fn angles_beyond_the_limits_are_clipped_and_said_so() {
    let robot = Robot::bundled("leap_right").unwrap();
    let mut recorded = half_closed(&robot);
    let j = robot.joint_index("if_mcp").unwrap();
    let upper = robot.joints[j].limits.unwrap().1;
    recorded[j] = upper + 0.4;
    let fit = Cylinder { radius: 0.033, half: 0.06 }.fit(&robot, &recorded, &quick());
    assert!((fit.clipped_rad[j] + 0.4).abs() < 1e-12);
    assert!(fit.grasp.joints_rad[j] <= upper && fit.grasp.joints_rad[j] >= upper - 0.15 - 1e-12);
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let robot = Robot::bundled("leap_right").unwrap();
    let can = Cylinder { radius: 0.035, half: 0.05 };
    let rows: Vec<Vec<f64>> = (0..4)
        .map(|i| half_closed(&robot).iter().enumerate().map(|(k, q)| q + 0.05 * ((i * 16 + k) as f64).sin()).collect())
        .collect();
    let mut options = quick();
    options.initial_guesses = 64;
    options.kept = (8, 2);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fit_wrists(&robot, &rows, &can.on_table(), &options)).unwrap()
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(format!("{one:?}"), format!("{three:?}"));
    assert_eq!(one[2], fit_wrist(&robot, &rows[2], &can.on_table(), &options).unwrap());
    let other = fit_wrist(&robot, &rows[2], &can.on_table(), &options.with_seed(1)).unwrap();
    assert_ne!(one[2].grasp.object_from_base, other.grasp.object_from_base, "the seed has no effect");
}

#[test]
fn bad_input_is_refused_by_name() {
    let robot = Robot::bundled("leap_right").unwrap();
    let can = Cylinder { radius: 0.03, half: 0.05 };
    let fit = |rows: &[Vec<f64>], options: &WristFitOptions| fit_wrists(&robot, rows, &can.on_table(), options);
    let mut nan = half_closed(&robot);
    nan[3] = f64::NAN;
    let message = fit(&[half_closed(&robot), nan], &quick()).unwrap_err().to_string();
    assert!(message.contains("row 1") && message.contains(&robot.joints[3].name), "{message}");
    assert!(matches!(fit(&[vec![0.0; 3]], &quick()), Err(Error::Joints { .. })));
    let mut options = quick();
    options.initial_guesses = 0;
    assert!(matches!(fit(&[half_closed(&robot)], &options), Err(Error::Core(_))));
    options = quick();
    options.limits.min_fingers = 9;
    assert!(fit(&[], &options).is_err());
    assert!(fit(&[], &quick()).unwrap().is_empty());
}
