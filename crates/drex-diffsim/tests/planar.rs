//! A box that slides and turns, against the plane problem integrated on its own.
#![allow(clippy::unwrap_used, missing_docs)] // a test may panic

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{AppliedForce, Body, Collider, ConvexPiece, ForcePoint, Model, Part, Scene, State, rollout};
use nalgebra::{Matrix2x3, Matrix3, Matrix3x4, Point3, Rotation2, Vector2, Vector3, Vector4};

const G: f64 = 9.81;
const MASS_KG: f64 = 0.2;
const HALF_M: f64 = 0.03;
const FRICTION: f64 = 0.45;
const FORCE_N: f64 = 1.6;
const POINT: [f64; 3] = [-0.03, 0.01, -0.02];

/// Position and angle at each time of the box that [`FORCE_N`] along x pushes at [`POINT`] from 0.1 to 0.3 s. Three
/// velocities; each corner presses with a force that is linear in its place and balances weight and tipping moments,
/// and rubs with Coulomb's force at its own velocity; implicit Euler, the velocities by fixed-point iteration.
fn plane_problem(times: &[f64]) -> Vec<Vector3<f64>> {
    let inertia = MASS_KG * HALF_M * HALF_M * 2.0 / 3.0;
    let dt = 2e-5;
    let (mut x, mut v) = (Vector3::<f64>::zeros(), Vector3::<f64>::zeros());
    let mut pressure = Vector4::repeat(MASS_KG * G / 4.0);
    let mut out = Vec::new();
    let mut t = 0.0;
    for k in 1.. {
        let force = if (0.1..0.3).contains(&t) { Vector2::new(FORCE_N, 0.0) } else { Vector2::zeros() };
        let turn = Rotation2::new(x.z);
        let corners =
            [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(a, b)| turn * (Vector2::new(a, b) * HALF_M));
        let point = turn * Vector2::new(POINT[0], POINT[1]);
        let load = Vector3::new(force.x, force.y, point.x * force.y - point.y * force.x);
        let jacobian = corners.map(|r| Matrix2x3::new(1.0, 0.0, -r.y, 0.0, 1.0, r.x));
        let lever = Matrix3x4::from_fn(|i, j| [1.0, corners[j].x, corners[j].y][i]);
        let mass = Matrix3::from_diagonal(&Vector3::new(MASS_KG, MASS_KG, inertia));
        let mut new = v;
        for _ in 0..100 {
            let mut system = mass;
            let mut friction = Vector2::zeros();
            for (j, n) in jacobian.iter().zip(pressure.iter()) {
                let c = FRICTION * n / ((j * new).norm_squared() + 1e-14).sqrt();
                system += j.transpose() * j * (c * dt);
                friction -= j * new * c;
            }
            let next = system.lu().solve(&(mass * v + load * dt)).unwrap();
            // Tipping: friction acts half a side below the centre, the force at its own height.
            let tip =
                Vector2::new(-HALF_M * friction.x + POINT[2] * force.x, -HALF_M * friction.y + POINT[2] * force.y);
            let plane = (lever * lever.transpose()).lu().solve(&Vector3::new(MASS_KG * G, tip.x, tip.y)).unwrap();
            pressure = lever.transpose() * plane;
            let change = (next - new).norm();
            new = next;
            if change < 1e-13 {
                break;
            }
        }
        assert!(pressure.min() > 0.0, "a corner lifts: the plane problem does not hold");
        v = new;
        x += v * dt;
        t = f64::from(k) * dt;
        while out.len() < times.len() && times[out.len()] <= t + 1e-9 {
            out.push(x);
        }
        if out.len() == times.len() {
            break;
        }
    }
    out
}

#[test]
fn a_box_pushed_off_its_centre_slides_and_turns_as_the_plane_problem_says() {
    let corner = |i: i32| {
        Point3::new(2.0 * f64::from(i & 1) - 1.0, f64::from(i & 2) - 1.0, 0.5 * f64::from(i & 4) - 1.0) * HALF_M
    };
    let piece = ConvexPiece::from_points(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
    let inertia = Matrix3::identity() * (HALF_M * HALF_M * 2.0 / 3.0);
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let mut model = Model::new(vec![Body::new(&unit, MASS_KG, Arc::new(Collider::convex(vec![piece])))]);
    model.dt_s = 1e-4;
    let mut scene = Scene::on_table(FRICTION);
    let at = ForcePoint::Body(Point3::from(POINT));
    scene
        .forces
        .push(AppliedForce::new(Part::Body(0), &[0.1, 0.3], &[Vector3::x() * FORCE_N, Vector3::zeros()], at).unwrap());
    let times = [0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.8];
    let record = rollout(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, HALF_M)), &times).unwrap();
    let truth = plane_problem(&times);
    // It turns by more than half a turn and slides by more than three sides.
    assert!(truth[6].z < -3.5 && truth[6].x > 0.19, "{}", truth[6]);
    for ((t, x), pose) in times.iter().zip(&truth).zip(&record.bodies[0].poses) {
        let distance = (pose.translation.vector - Vector3::new(x.x, x.y, HALF_M)).norm();
        let front = pose.rotation * Vector3::x();
        let angle = Rotation2::new(x.z).rotation_to(&Rotation2::new(front.y.atan2(front.x))).angle();
        assert!(distance < 1e-4 && angle.abs() < 4e-3, "t {t}: {} mm, {} rad off", distance * 1e3, angle);
    }
}
