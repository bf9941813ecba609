//! Motions whose truth is a formula.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, ConvexPolyhedron, Error, ForcePoint, KinematicBody, Model, Part, Scene, State,
    StaticBody, Workspace, rollout, step,
};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

const G: f64 = 9.81;

fn corners(half: Vector3<f64>) -> Vec<Point3<f64>> {
    (0..8)
        .map(|i| Point3::from(half.component_mul(&Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -1.0 } else { 1.0 }))))
        .collect()
}

fn block(half: Vector3<f64>, mass_kg: f64) -> Model<f64> {
    let s = half.component_mul(&half) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    Model::new(vec![Body::new(
        &unit,
        mass_kg,
        Arc::new(Collider::convex(vec![ConvexPolyhedron::from_points(&corners(half)).unwrap()])),
    )])
}

fn cube() -> (Vector3<f64>, Model<f64>) {
    let half = Vector3::repeat(0.03);
    (half, block(half, 0.2))
}

fn force(f: Vector3<f64>, from: f64, to: f64, at: Point3<f64>) -> AppliedForce<f64> {
    AppliedForce::new(Part::Body(0), &[from, to], &[f, Vector3::zeros()], ForcePoint::Body(at)).unwrap()
}

#[test]
fn free_fall_and_lift_are_parabolas() {
    let (_, model) = cube();
    let mut start = State::at_rest(Pose::translation(0.0, 0.0, 2.0));
    start.bodies[0].velocity = Vector3::new(1.0, -0.5, 0.3);
    start.bodies[0].angular_velocity = Vector3::new(3.0, 1.0, -2.0);
    let end = rollout(&model, &Scene::empty(), &start, &[0.5]).unwrap();
    let x = end.bodies[0].poses[0].translation.vector;
    // Semi-implicit Euler is behind the parabola by g t dt / 2.
    assert!((x - Vector3::new(0.5, -0.25, 2.0 + 0.15 - 0.5 * G * 0.25)).norm() < 1.01 * 0.5 * G * 0.5 * model.dt_s);
    // m z'' = u - m g once u exceeds the weight.
    let mut scene = Scene::on_table(0.5);
    scene.forces.push(force(Vector3::z() * 0.2 * G * 1.7, 0.1, 0.3, Point3::origin()));
    let end = rollout(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.03)), &[0.25]).unwrap();
    let rise = end.bodies[0].poses[0].translation.vector.z - 0.03;
    assert!((rise / (0.5 * 0.7 * G * 0.15_f64.powi(2)) - 1.0).abs() < 0.005, "{rise}");
}

#[test]
fn a_block_rests_at_depth_g_over_omega_squared() {
    let (_, mut model) = cube();
    model.contact.frequency_rad_s = 200.0;
    let end =
        rollout(&model, &Scene::on_table(0.5), &State::at_rest(Pose::translation(0.0, 0.0, 0.031)), &[1.0]).unwrap();
    let depth = 0.03 - end.bodies[0].poses[0].translation.vector.z;
    assert!((depth / (G / 200.0_f64.powi(2)) - 1.0).abs() < 1e-3, "{depth}");
    assert!(end.last.bodies[0].velocity.norm() < 1e-9);
}

#[test]
fn rest_depth_does_not_depend_on_the_number_of_rim_points() {
    let depth = |n: usize| {
        let points: Vec<_> = (0..n)
            .flat_map(|i| {
                let a = std::f64::consts::TAU * i as f64 / n as f64;
                [-0.05, 0.05].map(|z| Point3::new(0.03 * a.cos(), 0.03 * a.sin(), z))
            })
            .collect();
        let unit =
            MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia: Matrix3::identity() * 1e-3 };
        let mut model = Model::new(vec![Body::new(
            &unit,
            0.3,
            Arc::new(Collider::convex(vec![ConvexPolyhedron::from_points(&points).unwrap()])),
        )]);
        model.contact.frequency_rad_s = 300.0;
        let end =
            rollout(&model, &Scene::on_table(0.4), &State::at_rest(Pose::translation(0.0, 0.0, 0.05)), &[0.6]).unwrap();
        0.05 - end.bodies[0].poses[0].translation.vector.z
    };
    for n in [12, 38, 60] {
        assert!((depth(n) / (G / 9e4) - 1.0).abs() < 0.01, "{n}: {}", depth(n));
    }
}

/// Tilts gravity instead of the table.
fn incline(angle: f64, mu: f64, seconds: f64) -> Vector3<f64> {
    let (_, model) = cube();
    let mut scene = Scene::on_table(mu);
    scene.gravity = Vector3::new(angle.sin(), 0.0, -angle.cos()) * G;
    rollout(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.03)), &[seconds]).unwrap().bodies[0].poses[0]
        .translation
        .vector
}

#[test]
fn a_block_on_an_incline_sticks_below_the_angle_of_friction_and_slides_above() {
    let mu: f64 = 0.5;
    let limit = mu.atan();
    let half_a_degree = 0.5_f64.to_radians();
    // No creep: after five seconds close to the limit it has not moved a micrometre.
    let drift = incline(limit - half_a_degree, mu, 5.0).x;
    assert!(drift.abs() < 1e-6, "{drift}");
    let a = limit + 5.0_f64.to_radians();
    let expected = 0.5 * G * (a.sin() - mu * a.cos()) * 0.25;
    assert!((incline(a, mu, 0.5).x / expected - 1.0).abs() < 0.01);
}

#[test]
fn a_pushed_block_in_stiction_balances_the_force() {
    let (_, model) = cube();
    let mut scene = Scene::on_table(0.6);
    scene.forces.push(force(Vector3::x() * 0.2 * G * 0.5, 0.05, 10.0, Point3::new(0.0, 0.0, -0.03)));
    let r = rollout(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.03)), &[0.5, 3.0]).unwrap();
    let creep = (r.bodies[0].poses[1].translation.vector - r.bodies[0].poses[0].translation.vector).norm();
    assert!(creep < 1e-9, "{creep}");
}

#[test]
fn a_sliding_block_stops_after_v_squared_over_two_mu_g() {
    for mass in [0.02, 0.7] {
        let model = block(Vector3::repeat(0.03), mass);
        let mut start = State::at_rest(Pose::translation(0.0, 0.0, 0.03));
        start.bodies[0].velocity = Vector3::new(0.6, 0.3, 0.0);
        let x = rollout(&model, &Scene::on_table(0.4), &start, &[1.0, 2.0]).unwrap();
        let slid = x.bodies[0].poses[0].translation.vector.xy().norm();
        assert!((slid / (0.45 / (2.0 * 0.4 * G)) - 1.0).abs() < 0.005, "{slid}");
        assert!(
            (x.bodies[0].poses[1].translation.vector - x.bodies[0].poses[0].translation.vector).norm() < 1e-9,
            "it creeps"
        );
    }
}

#[test]
fn a_push_tips_above_the_height_b_over_two_mu_and_slides_below() {
    // Width b = 6 cm, friction 0.5: the limit is 6 cm above the table.
    let half = Vector3::new(0.03, 0.03, 0.05);
    for (height, tips) in [(0.054, false), (0.066, true)] {
        let model = block(half, 0.3);
        let mut scene = Scene::on_table(0.5);
        let f = 0.3 * G * if tips { 0.03 / height * 1.03 } else { 0.5 * 1.03 };
        scene.forces.push(force(Vector3::x() * f, 0.05, 0.25, Point3::new(-0.03, 0.0, height - 0.05)));
        let end = rollout(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.05)), &[0.25]).unwrap();
        let tilt = end.bodies[0].poses[0].rotation.angle().to_degrees();
        let foot = (end.bodies[0].poses[0] * Point3::new(0.03, 0.0, -0.05)).x - 0.03;
        assert_eq!(tilt > 0.3, tips, "height {height}: tilt {tilt}, foot {foot}");
        assert_eq!(foot > 1e-3, !tips, "height {height}: tilt {tilt}, foot {foot}");
    }
}

#[test]
fn tilting_about_an_edge_follows_the_pendulum_equation() {
    // (I_E / m) theta'' = F h(theta) / m - g r(theta) about the edge, integrated to high accuracy here.
    let half = Vector3::new(0.02, 0.04, 0.05);
    let mass = 0.25;
    let model = block(half, mass);
    let point = Point3::new(-0.02, 0.0, 0.03);
    let f = 1.4 * mass * G * 0.02 / 0.08;
    let mut scene = Scene::on_table(0.9);
    scene.forces.push(force(Vector3::x() * f, 0.1, 0.2, point));
    let times: Vec<f64> = (10..28).map(|k| f64::from(k) * 0.01).collect();
    let record = rollout(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.05)), &times).unwrap();
    let inertia = (half.x.powi(2) + half.z.powi(2)) * 4.0 / 3.0;
    let (mut theta, mut rate, dt) = (0.0_f64, 0.0_f64, 1e-6);
    let mut next = 0;
    for k in 0..180_000 {
        let t = 0.1 + f64::from(k) * dt;
        while next < times.len() && times[next] <= t {
            let simulated = record.bodies[0].poses[next].rotation.scaled_axis().y;
            assert!((simulated - theta).abs() < 0.01 * theta.abs() + 1e-3, "t {t:.3}: {simulated} against {theta}");
            next += 1;
        }
        let lever = 0.08 * theta.cos() + 0.04 * theta.sin();
        let weight = -half.x * theta.cos() + half.z * theta.sin();
        let push = if t < 0.2 { f } else { 0.0 };
        rate += dt * (push / mass * lever + G * weight) / inertia;
        theta += dt * rate;
        if theta < 0.0 {
            break;
        }
    }
    assert!(next > 12 && record.bodies[0].poses[9].rotation.angle() > 0.03);
}

#[test]
fn an_object_over_a_step_edge_rocks_about_it() {
    // The block lies half over the edge at x = 0 of a 5 cm high step; its centre is 8 mm inside.
    let half = Vector3::new(0.04, 0.03, 0.015);
    let mass = 0.2;
    let model = block(half, mass);
    let mut scene = Scene::on_table(0.6);
    let step = StaticBody::cuboid(Point3::new(-0.15, 0.0, 0.025), Vector3::new(0.15, 0.2, 0.025), 0.6).unwrap();
    scene.static_bodies.push(step);
    let start = State::at_rest(Pose::translation(-0.008, 0.0, 0.065));
    let arm = 0.04 - 0.008;
    let threshold = mass * G * 0.008 / arm;
    let tilt = |factor: f64| {
        let mut scene = scene.clone();
        scene.forces.push(force(-Vector3::z() * threshold * factor, 0.1, 0.2, Point3::new(0.04, 0.0, 0.015)));
        let r = rollout(&model, &scene, &start, &[0.05, 0.2]).unwrap();
        assert!((r.bodies[0].poses[0].translation.vector - Vector3::new(-0.008, 0.0, 0.065)).norm() < 1e-5, "it rests");
        r.bodies[0].poses[1].rotation.scaled_axis().y
    };
    assert!(tilt(0.97).abs() < 1e-4);
    // (I_E / m) theta'' = F x_F(theta) / m + g x_C(theta), x measured from the edge; integrated to high accuracy.
    let inertia = (half.x.powi(2) + half.z.powi(2)) / 3.0 + 0.008_f64.powi(2) + half.z.powi(2);
    let (mut theta, mut rate, dt) = (0.0_f64, 0.0, 1e-6);
    for _ in 0..100_000 {
        let x = |x: f64, z: f64| x * theta.cos() + z * theta.sin();
        rate += dt * (1.5 * threshold / mass * x(arm, 0.03) + G * x(-0.008, 0.015)) / inertia;
        theta += dt * rate;
    }
    let simulated = tilt(1.5);
    assert!((simulated / theta - 1.0).abs() < 0.02, "{simulated} against {theta}");
}

#[test]
fn torque_free_motion_keeps_energy_and_momentum() {
    // The tennis racket: the unstable middle axis. Bars of MuJoCo's FreeBodyGyroStable: E < 1.01 E0 in 100 s at 5 ms.
    let half = Vector3::new(0.05, 0.1, 0.15);
    let mut model = block(half, 1.0);
    model.dt_s = 5e-3;
    let mut scene = Scene::empty();
    scene.gravity = Vector3::zeros();
    let mut state = State::at_rest(Pose::identity());
    state.bodies[0].angular_velocity = Vector3::new(0.05, 5.0, 0.05);
    let energy = |s: &State<f64>| {
        let b = &s.bodies[0];
        let w = b.world_from_body.rotation.inverse() * b.angular_velocity;
        0.5 * w.dot(&(model.bodies[0].unit_inertia * w))
    };
    let first = energy(&state);
    let mut work = Workspace::default();
    for _ in 0..20_000 {
        step(&model, &scene, &mut state, &mut work).unwrap();
        assert!(energy(&state) < 1.01 * first);
    }
}

#[test]
fn a_symmetric_top_precesses_at_the_rate_of_its_momentum() {
    // J1 = J2: the axis turns about the angular momentum L at |L| / J1.
    let unit = MassProperties {
        mass_kg: 1.0,
        center_of_mass: Point3::origin(),
        inertia: Matrix3::from_diagonal(&Vector3::new(2e-3, 2e-3, 3e-3)),
    };
    let shape =
        Arc::new(Collider::convex(vec![ConvexPolyhedron::from_points(&corners(Vector3::repeat(0.05))).unwrap()]));
    let mut model = Model::new(vec![Body::new(&unit, 1.0, shape)]);
    model.dt_s = 1e-4;
    let mut scene = Scene::empty();
    scene.gravity = Vector3::zeros();
    let mut state = State::at_rest(Pose::identity());
    state.bodies[0].angular_velocity = Vector3::new(0.6, 0.0, 2.0);
    let l = Vector3::new(0.6 * 2e-3, 0.0, 2.0 * 3e-3);
    let t = 1.0;
    let end = rollout(&model, &scene, &state, &[t]).unwrap();
    let expected = UnitQuaternion::from_scaled_axis(l.normalize() * (l.norm() / 2e-3 * t)) * Vector3::z();
    let axis = end.bodies[0].poses[0].rotation * Vector3::z();
    assert!(axis.angle(&expected) < 2e-3, "{}", axis.angle(&expected));
}

#[test]
fn a_prescribed_sphere_moves_every_mass_alike() {
    let path = [Point3::new(-0.06, 0.0, 0.03), Point3::new(0.04, 0.0, 0.03)];
    let ends: Vec<Pose> = [0.01, 3.0]
        .iter()
        .map(|m| {
            let model = block(Vector3::repeat(0.03), *m);
            let mut scene = Scene::on_table(0.4);
            scene.kinematic_bodies.push(KinematicBody::sphere(0.01, 0.6, &[0.1, 1.1], &path).unwrap());
            rollout(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.03)), &[1.3]).unwrap().bodies[0].poses
                [0]
        })
        .collect();
    // The sphere's front ends at x = 5 cm, the block's centre is 3 cm further.
    assert!((ends[0].translation.vector.x - 0.08).abs() < 2e-3, "{}", ends[0]);
    assert_eq!(ends[0], ends[1]);
}

#[test]
fn nonsense_is_refused_by_name() {
    let (half, mut model) = cube();
    let start = State::at_rest(Pose::translation(0.0, 0.0, 0.03));
    let scene = Scene::on_table(0.5);
    for mass in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let r = rollout(&block(half, mass), &scene, &start, &[0.1]);
        assert!(matches!(r, Err(Error::Mass { body: 0, .. })), "{mass}");
    }
    let deep = State::at_rest(Pose::translation(0.0, 0.0, -0.1));
    assert!(matches!(rollout(&model, &scene, &deep, &[0.1]), Err(Error::StartsInside { .. })));
    model.dt_s = 0.5;
    assert!(matches!(rollout(&model, &scene, &start, &[0.1]), Err(Error::TimeStep { .. })));
    model.dt_s = 5e-4;
    assert!(matches!(rollout(&model, &scene, &start, &[0.2, 0.1]), Err(Error::Series { .. })));
    let mut nan = start.clone();
    nan.bodies[0].velocity.x = f64::NAN;
    assert!(matches!(rollout(&model, &scene, &nan, &[0.1]), Err(Error::NotFinite { .. })));
    model.bodies[0].unit_inertia[(0, 0)] = 1.0;
    assert!(matches!(rollout(&model, &scene, &start, &[0.1]), Err(Error::Inertia { .. })));
    assert!(
        AppliedForce::<f64>::new(
            Part::Body(0),
            &[0.0, 0.0],
            &[Vector3::zeros(); 2],
            ForcePoint::Body(Point3::origin())
        )
        .is_err()
    );
    let wild = AppliedForce::<f64>::new(
        Part::Body(0),
        &[0.0, 1.0],
        &[Vector3::repeat(1e9); 2],
        ForcePoint::Body(Point3::origin()),
    )
    .unwrap();
    let mut pushed = scene.clone();
    pushed.forces.push(wild);
    assert!(matches!(rollout(&cube().1, &pushed, &start, &[1.0]), Err(Error::Diverged { .. })));
}
