//! Grasps searched for on shapes whose distance is a formula.

use drex_core::{MassProperties, SdfSample, SignedDistance, SurfacePoint, TablePlane};
use drex_grasp::{
    CheckOptions, ClosureOptions, FoundGrasp, GripForceProblem, HandSurface, SearchOptions, StaticGrasp, TorqueLimits,
    force_closure, minimum_grip_force, search_grasps, static_check_with,
};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3, Vector3};

/// A ball of this radius, m.
struct Ball(f64);

impl SignedDistance for Ball {
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        let r = point.coords.norm().max(1e-9);
        SdfSample { distance_m: r - self.0, gradient: point.coords / r }
    }
}

impl Ball {
    /// Points spread evenly (a golden spiral).
    fn surface(&self) -> Vec<SurfacePoint> {
        (0..400)
            .map(|i| {
                let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 400.0;
                let (sin, cos) = (2.399_963 * f64::from(i)).sin_cos();
                let normal = Vector3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + Vector3::z() * z;
                SurfacePoint { point: Point3::from(normal * self.0), normal }
            })
            .collect()
    }
}

fn found(hand: &str, radius: f64, change: impl FnOnce(&mut SearchOptions)) -> (Robot, Vec<FoundGrasp>) {
    let robot = Robot::bundled(hand).unwrap();
    let surface = HandSurface::new(&robot, 0.004).unwrap();
    let ball = Ball(radius);
    let table = TablePlane { up: Vector3::z_axis(), height_m: -radius };
    let mut options = SearchOptions::default();
    options.candidates = 3000;
    change(&mut options);
    let found = search_grasps(&robot, &surface, &ball, &ball.surface(), &Point3::origin(), &table, &options).unwrap();
    (robot, found)
}

#[test]
fn what_is_found_touches_is_not_inside_and_keeps_off_the_table() {
    for hand in ["leap_right", "allegro_right"] {
        let radius = 0.035;
        let (robot, found) = found(hand, radius, |_| {});
        assert!(found.len() > 30, "{hand}: {} grasps", found.len());
        // A finer sampling than the search used judges.
        let fine = HandSurface::new(&robot, 0.002).unwrap();
        for f in &found {
            let poses = robot.forward_kinematics(&f.joints, &f.object_from_base);
            let depth = fine.depths(&poses, &Ball(radius), 0.0).into_iter().fold(0.0, f64::max);
            let lowest = fine.lowest(&poses, &Vector3::z()).into_iter().fold(f64::INFINITY, f64::min);
            assert!(depth < 0.002, "{hand}: {depth} m inside");
            assert!(lowest > -radius + 0.002, "{hand}: {lowest} m");
            let thumb = fine.thumb().unwrap();
            assert!(f.contacts.iter().any(|c| c.finger == Some(thumb)));
            assert!(f.contacts.iter().filter(|c| c.finger != Some(thumb)).count() >= 2);
            for c in &f.contacts {
                assert!((c.point.coords.norm() - radius).abs() < 1e-6 && c.normal.dot(&c.point.coords) < 0.0);
            }
            assert!(f.grip_force_per_weight > 0.5 && f.grip_force_per_weight.is_finite());
            for (q, joint) in f.joints.iter().zip(&robot.joints) {
                let (low, high) = joint.limits.unwrap();
                assert!((low - 1e-12..=high + 1e-12).contains(q), "{hand}: {}", joint.name);
            }
        }
        assert!(found.iter().filter(|f| f.closed).count() * 2 > found.len());
    }
}

#[test]
fn the_static_check_of_a_found_grasp_is_the_cone_programme_on_its_contacts() {
    let radius = 0.035;
    let (robot, found) = found("leap_right", radius, |o| o.candidates = 2000);
    let surface = HandSurface::new(&robot, 0.003).unwrap();
    let (ball, table) = (Ball(radius), TablePlane { up: Vector3::z_axis(), height_m: -radius });
    let body =
        MassProperties { mass_kg: 0.1, center_of_mass: Point3::new(0.0, 0.002, 0.0), inertia: Matrix3::identity() };
    let mut options = CheckOptions::default();
    options.gamma = 1.3;
    let mut carried = 0;
    for f in found.iter().filter(|f| f.closed).take(8) {
        let (robot, joints, object_from_base) = (&robot, &f.joints[..], f.object_from_base);
        let grasp = StaticGrasp { robot, joints, object_from_base, object: &ball, body: &body, table };
        let check = static_check_with(&surface, &grasp, &options).unwrap();
        let contacts = surface.contacts(robot, joints, &object_from_base, &ball, &options.contact).unwrap();
        let motors = TorqueLimits::of_robot(robot, joints, &object_from_base, &contacts, &table.gravity()).unwrap();
        let closure = force_closure(&contacts, &ClosureOptions::about(body.center_of_mass)).unwrap();
        assert_eq!(
            (check.force_closure, check.epsilon, check.min_weight),
            (closure.closed, closure.epsilon, closure.min_weight)
        );
        assert_eq!((check.mass_kg, check.friction, check.gamma), (0.1, 0.5, 1.3));
        for (i, row) in check.contacts.iter().enumerate() {
            let finger = (i < surface.fingers.len()).then_some(i);
            assert_eq!(row.contacts, contacts.iter().filter(|c| c.finger == finger).count(), "{}", row.finger);
        }
        let free = GripForceProblem::new(contacts, 0.1, body.center_of_mass, table.gravity()).with_gamma(1.3);
        let Ok(s) = minimum_grip_force(&free.clone().with_torques(motors)) else {
            assert!(check.grip_force_n.is_none() && !check.passed && check.torque_margin.is_none());
            continue;
        };
        carried += 1;
        assert_eq!((check.grip_force_n, check.torque_margin), (Some(s.total_n), Some(s.torque_margin)));
        assert_eq!(check.friction_margin, Some(s.friction_margin));
        for (row, n) in check.contacts.iter().zip(&s.per_finger_n) {
            assert_eq!(row.normal_n, *n, "{}", row.finger);
        }
        assert_eq!(check.contacts.last().unwrap().normal_n, s.palm_n);
        assert_eq!(check.passed, check.failures.is_empty());
        // Without motors, and with a damage limit just above and just below what that needs at one contact.
        let mut other = options.clone();
        other.motors = false;
        let without = static_check_with(&surface, &grasp, &other).unwrap();
        let s = minimum_grip_force(&free).unwrap();
        assert_eq!((without.grip_force_n, without.torque_margin), (Some(s.total_n), Some(1.0)));
        other.max_normal_n = Some(0.01);
        let fragile = static_check_with(&surface, &grasp, &other).unwrap();
        assert!(fragile.grip_force_n.is_none() && fragile.failures.iter().any(|f| f.contains("limits")), "{fragile:?}");
        assert!(fragile.contacts.iter().all(|row| row.normal_n == 0.0));
    }
    assert!(carried > 0);
}

#[test]
fn a_thumb_without_limits_goes_both_ways() {
    let mut robot = Robot::bundled("leap_right").unwrap();
    let free = robot.require_joint("th_axl").unwrap();
    robot.joints[free].limits = None;
    let surface = HandSurface::new(&robot, 0.004).unwrap();
    let (ball, table) = (Ball(0.035), TablePlane { up: Vector3::z_axis(), height_m: -0.035 });
    let mut options = SearchOptions::default();
    options.candidates = 2000;
    let points = ball.surface();
    let found = search_grasps(&robot, &surface, &ball, &points, &Point3::origin(), &table, &options).unwrap();
    let (low, high) = found.iter().fold((0.0_f64, 0.0_f64), |(l, h), f| (l.min(f.joints[free]), h.max(f.joints[free])));
    assert!(low < -0.1 && high > 0.1, "{low} to {high} rad");
}

#[test]
fn seeds_and_threads() {
    let with = |seed: u64, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            found("leap_right", 0.03, |o| {
                o.seed = seed;
                o.candidates = 600;
            })
            .1
        })
    };
    let one = with(1, 1);
    assert!(!one.is_empty());
    assert_eq!(one, with(1, 2));
    assert_ne!(one, with(2, 2));
}

#[test]
fn what_is_too_wide_is_not_grasped_and_nonsense_is_refused() {
    assert!(found("leap_right", 0.2, |o| o.candidates = 300).1.is_empty());
    let robot = Robot::bundled("leap_right").unwrap();
    let surface = HandSurface::new(&robot, 0.004).unwrap();
    let table = TablePlane { up: Vector3::z_axis(), height_m: -0.03 };
    let mut options = SearchOptions::default();
    options.friction = f64::NAN;
    let ball = Ball(0.03);
    let refused = search_grasps(&robot, &surface, &ball, &ball.surface(), &Point3::origin(), &table, &options);
    assert!(refused.unwrap_err().to_string().contains("friction"));
    assert!(
        search_grasps(&robot, &surface, &ball, &[], &Point3::origin(), &table, &SearchOptions::default())
            .unwrap()
            .is_empty()
    );
}
