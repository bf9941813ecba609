//! A box that is pushed: it tips, slides, or is pressed down.

use drex_diffsim::{AppliedForce, ForcePoint, Model, Part, Scene, State, Workspace, rollout, step};
use nalgebra::{Point3, Vector3};

use crate::common::{G, at, cuboid, relative, resting, within};

const HALF: Vector3<f64> = Vector3::new(0.03, 0.04, 0.1);
const MU: f64 = 0.5;

fn pushed(height: f64, times_s: &[f64], forces: &[Vector3<f64>]) -> Scene<f64> {
    let mut scene = Scene::on_table(MU);
    let point = ForcePoint::Body(Point3::new(-HALF.x, 0.0, height - HALF.z));
    scene.forces.push(AppliedForce::new(Part::Body(0), times_s, forces, point).unwrap());
    scene
}

/// What a slowly growing force does first: whether the box tips, and the force at which something happens.
fn first_move(mass: f64, height: f64) -> (bool, f64) {
    let mut model = Model::new(vec![cuboid(HALF, mass)]);
    model.dt_s = 1e-3;
    let limit = MU * mass * G;
    // From 90 % of the sliding force on, by 2 % of it in a second.
    let times: Vec<f64> = (0..=8000).map(|k| f64::from(k) * 1e-3).collect();
    let force = |t: f64| limit * (0.9 + 0.02 * t) * t.min(0.2) / 0.2;
    let forces: Vec<_> = times.iter().map(|t| Vector3::x() * force(*t)).collect();
    let scene = pushed(height, &times, &forces);
    let (mut state, mut work) = (resting(&[at(0.0, 0.0, HALF.z)]), Workspace::default());
    while state.time_s < 8.0 {
        step(&model, &scene, &mut state, &mut work).unwrap();
        let pose = state.bodies[0].world_from_body;
        let foot = (pose * Point3::new(HALF.x, 0.0, -HALF.z)).x - HALF.x;
        let tilt = pose.rotation.angle();
        if tilt > 1e-3 || foot > 1e-3 * height {
            return (tilt > 1e-3, force(state.time_s) / limit);
        }
    }
    (false, f64::INFINITY)
}

/// (15) Tips iff h > b / (2 mu), at the force m g b / (2 h); else slides from mu m g on.
#[test]
fn a_push_tips_above_the_height_b_over_two_mu_and_slides_below() {
    let limit = 2.0 * HALF.x / (2.0 * MU);
    for mass in [0.1, 1.0] {
        let name = format!("15 push, {mass} kg");
        let (mut low, mut high) = (0.9, 1.1);
        while high - low > 1e-3 {
            let middle = 0.5 * (low + high);
            if first_move(mass, middle * limit).0 { high = middle } else { low = middle }
        }
        within(&name, "tips iff h > b / (2 mu)", (0.5 * (low + high) - 1.0).abs(), 0.02);
        within(&name, "slides from F = mu m g on", (first_move(mass, 0.9 * limit).1 - 1.0).abs(), 0.02);
        within(&name, "tips from F = m g b / (2 h) on", relative(first_move(mass, 1.05 * limit).1, 1.0 / 1.05), 0.02);
    }
}

/// (15) Below the limit it slides with a = F / m - mu g.
#[test]
fn a_push_below_the_limit_accelerates_the_box() {
    for (mass, factor) in [(0.1, 1.2), (1.0, 2.0), (5.0, 1.05)] {
        let model = Model::new(vec![cuboid(HALF, mass)]);
        let force = factor * MU * mass * G;
        let scene = pushed(0.02, &[0.0, 9.0], &[Vector3::x() * force, Vector3::zeros()]);
        let record = rollout(&model, &scene, &resting(&[at(0.0, 0.0, HALF.z)]), &[0.1, 0.4]).unwrap();
        let v = &record.bodies[0].velocities;
        let truth = force / mass - MU * G;
        within(
            &format!("15 push, {mass} kg, {factor} mu m g"),
            "a = F / m - mu g",
            relative((v[1].x - v[0].x) / 0.3, truth),
            0.02,
        );
    }
}

/// (16) A box that rests on the table is pressed down and let go: with contact per unit mass, m z'' = u - m g - m (...)
/// makes z(t) affine in 1/m. Two known masses give the line, least squares over the track give the third.
#[test]
fn a_push_down_tells_the_mass() {
    let mut push = pushed(0.0, &[0.05, 0.08, 0.12], &[-Vector3::z() * 3.0, -Vector3::z() * 1.5, Vector3::zeros()]);
    let times: Vec<f64> = (0..60).map(|k| 0.04 + 2e-3 * f64::from(k)).collect();
    // The whole z(t), at a soft contact that is not overdamped, and at the default one.
    for (name, frequency, relaxation) in [("soft contact", 400.0, 1e-3), ("default contact", 1e4, 4e-3)] {
        // At the centre of the box, so that it does not tilt.
        let centre = ForcePoint::Body(Point3::origin());
        let samples = [-Vector3::z() * 3.0, -Vector3::z() * 1.5, Vector3::zeros()];
        push.forces = vec![AppliedForce::new(Part::Body(0), &[0.05, 0.08, 0.12], &samples, centre).unwrap()];
        let heights = |mass: f64| -> Vec<f64> {
            let mut model = Model::new(vec![cuboid(HALF, mass)]);
            model.contact.frequency_rad_s = frequency;
            model.contact.relaxation_s = relaxation;
            let start: State<f64> = resting(&[at(0.0, 0.0, HALF.z - G / (frequency * frequency))]);
            let record = rollout(&model, &push, &start, &times).unwrap();
            record.bodies[0].poses.iter().map(|p| p.translation.z - HALF.z).collect()
        };
        let (a, b) = (heights(0.5), heights(0.25));
        for mass in [0.117, 0.206, 0.324, 1.3] {
            let z = heights(mass);
            // z = a + (1/m - 2) (b - a) / 2.
            let line: Vec<f64> = a.iter().zip(&b).map(|(a, b)| (b - a) / 2.0).collect();
            let along: f64 = z.iter().zip(&a).zip(&line).map(|((z, a), l)| (z - a) * l).sum();
            let found = 1.0 / (2.0 + along / line.iter().map(|l| l * l).sum::<f64>());
            within(
                &format!("16 push-down, {name}, {} g", mass * 1e3),
                "mass by least squares",
                relative(found, mass),
                1e-3,
            );
        }
    }
}
