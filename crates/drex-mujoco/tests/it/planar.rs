//! A box that slides and turns, against the plane problem integrated on its own.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{AppliedForce, Body, Collider, ForcePoint, Geom, Model, Part, Record, Scene, Shape, State, rollout};
use nalgebra::{Matrix2x3, Matrix3, Matrix3x4, Point3, Rotation2, Vector2, Vector3, Vector4};

const G: f64 = 9.81;
const MASS_KG: f64 = 0.2;
const HALF_M: f64 = 0.03;
const FRICTION: f64 = 0.45;
const FORCE_N: f64 = 1.6;
const POINT: [f64; 3] = [-0.03, 0.01, -0.02];
const TIMES_S: [f64; 7] = [0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.8];

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

/// The same box as a body on a table.
fn box_on_table() -> (Model<f64>, Scene<f64>, State<f64>) {
    let collider = Collider::new(&[Geom::new(Shape::Box { half_m: Vector3::repeat(HALF_M) })]).unwrap();
    let inertia = Matrix3::identity() * (HALF_M * HALF_M * 2.0 / 3.0);
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let mut model = Model::new(vec![Body::new(&unit, MASS_KG, Arc::new(collider))]);
    model.dt_s = 1e-4;
    let mut scene = Scene::on_table(FRICTION);
    let (force, at) = ([Vector3::x() * FORCE_N, Vector3::zeros()], ForcePoint::Body(Point3::from(POINT)));
    scene.forces.push(AppliedForce::new(Part::Body(0), &[0.1, 0.3], &force, at).unwrap());
    (model, scene, State::at_rest(Pose::translation(0.0, 0.0, HALF_M)))
}

/// Largest distance and angle between a motion and that of the plane problem, metres and rad.
fn apart(record: &Record<f64>, truth: &[Vector3<f64>]) -> (f64, f64) {
    let mut worst = (0.0_f64, 0.0_f64);
    for (x, pose) in truth.iter().zip(&record.bodies[0].poses) {
        let front = pose.rotation * Vector3::x();
        let angle = Rotation2::new(x.z).rotation_to(&Rotation2::new(front.y.atan2(front.x))).angle();
        worst.0 = worst.0.max((pose.translation.vector - Vector3::new(x.x, x.y, HALF_M)).norm());
        worst.1 = worst.1.max(angle.abs());
    }
    worst
}

#[test]
fn a_box_pushed_off_its_centre_slides_and_turns_as_the_plane_problem_says() {
    let truth = plane_problem(&TIMES_S);
    // It turns by more than half a turn and slides by more than three sides.
    assert!(truth[6].z < -3.5 && truth[6].x > 0.19, "{}", truth[6]);
    let (model, scene, start) = box_on_table();
    let (distance, angle) = apart(&rollout(&model, &scene, &start, &TIMES_S).unwrap(), &truth);
    println!("ours: {:.3} mm, {:.3} degrees", distance * 1e3, angle.to_degrees());
    assert!(distance < 1e-4 && angle < 4e-3, "{distance} m, {angle} rad off");
}

/// What the second engine makes of it; see the README.
#[cfg(feature = "engine")]
#[test]
fn mujoco_is_within_a_side_of_the_plane_problem() {
    use drex_mujoco::MjcfOptions;
    let truth = plane_problem(&TIMES_S);
    let (model, scene, start) = box_on_table();
    for (dt_s, steps, impratio) in [
        (5e-4, 4.0, 10.0),
        (5e-4, 8.0, 10.0),
        (5e-4, 16.0, 10.0),
        (5e-4, 4.0, 100.0),
        (5e-4, 8.0, 100.0),
        (5e-4, 16.0, 100.0),
        (1e-4, 8.0, 10.0),
        (1e-4, 40.0, 10.0),
        (5e-5, 8.0, 10.0),
        (5e-5, 80.0, 100.0),
    ] {
        let mut options = MjcfOptions::default();
        (options.dt_s, options.contact_time_s, options.impratio) = (Some(dt_s), Some(steps * dt_s), impratio);
        let record = drex_mujoco::rollout(&model, &scene, &start, &TIMES_S, &options).unwrap();
        let (distance, angle) = apart(&record, &truth);
        println!(
            "MuJoCo, step {:.2} ms, time constant {:.1} ms, impratio {impratio}: {:.1} mm, {:.1} degrees",
            dt_s * 1e3,
            steps * dt_s * 1e3,
            distance * 1e3,
            angle.to_degrees()
        );
        assert!(distance < 2.0 * HALF_M);
    }
}
