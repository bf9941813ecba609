//! The same cases with every method of stepping.
#![allow(clippy::unwrap_used, missing_docs)] // a test may panic

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Body, BodyState, Collider, Dual, ForcePoint, Geom, Method, Model, Mover, Part, Record, Scalar, Scene, Scheme,
    Shape, SimError, State, Workspace, parameter, rollout, step, tangents,
};
use nalgebra::{Matrix3, Point3, RealField, UnitQuaternion, Vector3};

const G: f64 = 9.81;
/// Contact of all cases: bodies sink in by g/ω² = 1.1 µm and do not rebound (τ > 2/ω). The penalty methods need 18
/// substeps per step of 0.5 ms for it.
const FREQUENCY_RAD_S: f64 = 3e3;
const RELAXATION_S: f64 = 1e-3;

const IMPLICIT: Method = Method::SemiImplicit;
const PENALTY: Method = Method::Penalty { scheme: Scheme::SemiImplicit, substeps: None };
const EXPLICIT: Method = Method::Penalty { scheme: Scheme::Explicit, substeps: None };
const POSITIONS: Method = Method::PositionBased { substeps: 4 };
const ALL: [Method; 4] = [IMPLICIT, PENALTY, EXPLICIT, POSITIONS];

/// A box of half extents `half` and mass `mass_kg`, stepped by `method`.
fn block<T: Scalar>(half: Vector3<f64>, mass_kg: T, method: Method) -> Model<T> {
    let mut model = Model::new(vec![body(half, mass_kg)]);
    model.contact.frequency_rad_s = T::lift(FREQUENCY_RAD_S);
    model.contact.relaxation_s = T::lift(RELAXATION_S);
    model.method = method;
    model
}

fn body<T: Scalar>(half: Vector3<f64>, mass_kg: T) -> Body<T> {
    let s = half.component_mul(&half) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    Body::new(&unit, mass_kg, Arc::new(Collider::new(&[Geom::new(Shape::Box { half_m: half })]).unwrap()))
}

fn force<T: Scalar>(f: Vector3<f64>, from: f64, to: f64, at: Point3<f64>) -> AppliedForce<T> {
    AppliedForce::new(Part::Body(0), &[from, to], &[f, Vector3::zeros()], ForcePoint::Body(at)).unwrap()
}

fn at<T: Scalar>(x: f64, y: f64, z: f64) -> Pose<T> {
    Pose::from_parts(Vector3::new(x, y, z).map(T::lift).into(), UnitQuaternion::identity())
}

fn place<T: Scalar>(record: &Record<T>, k: usize) -> Vector3<T> {
    record.bodies[0].poses[k].translation.vector
}

#[test]
fn free_fall_and_lift_are_parabolas() {
    for method in ALL {
        let model = block(Vector3::repeat(0.03), 0.2, method);
        let mut start = State::at_rest(at(0.0, 0.0, 2.0));
        start.bodies[0].velocity = Vector3::new(1.0, -0.5, 0.3);
        start.bodies[0].angular_velocity = Vector3::new(3.0, 1.0, -2.0);
        let end = rollout(&model, &Scene::empty(), &start, &[0.5]).unwrap();
        let truth = Vector3::new(0.5, -0.25, 2.0 + 0.15 - 0.5 * G * 0.25);
        // Every scheme of first order is g t h / 2 beside the parabola, with h at most the step.
        let error = (place(&end, 0) - truth).norm();
        eprintln!("{method:?}: fall {error:.3e}");
        assert!(error < 1.01 * 0.5 * G * 0.5 * model.dt_s, "{method:?}: {error}");
        // m z'' = u - m g once u exceeds the weight.
        let mut scene = Scene::on_table(0.5);
        scene.forces.push(force(Vector3::z() * 0.2 * G * 1.7, 0.1, 0.3, Point3::origin()));
        let end = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.03)), &[0.25]).unwrap();
        let rise = place(&end, 0).z - 0.03;
        eprintln!("{method:?}: rise {:.3e}", rise / (0.5 * 0.7 * G * 0.15_f64.powi(2)) - 1.0);
        assert!((rise / (0.5 * 0.7 * G * 0.15_f64.powi(2)) - 1.0).abs() < 0.005, "{method:?}: {rise}");
    }
}

#[test]
fn a_block_rests_at_depth_g_over_omega_squared_without_creep() {
    for method in ALL {
        let model = block(Vector3::repeat(0.03), 0.2, method);
        let mut start = State::at_rest(at(0.0, 0.0, 0.031));
        start.bodies[0].velocity = Vector3::new(0.05, 0.02, 0.0);
        let end = rollout(&model, &Scene::on_table(0.5), &start, &[1.0, 2.0]).unwrap();
        let depth = 0.03 - place(&end, 0).z;
        let creep = (place(&end, 1) - place(&end, 0)).norm();
        eprintln!("{method:?}: depth {:.3e} creep {creep:.3e} speed {:.3e}", depth / (G / FREQUENCY_RAD_S.powi(2)) - 1.0, end.last.bodies[0].velocity.norm());
        assert!((depth / (G / FREQUENCY_RAD_S.powi(2)) - 1.0).abs() < 1e-3, "{method:?}: {depth}");
        assert!(creep < 1e-9 && end.last.bodies[0].velocity.norm() < 1e-9, "{method:?}: {creep}");
    }
}

#[test]
fn a_sliding_block_stops_after_v_squared_over_two_mu_g() {
    for method in ALL {
        for mass in [0.02, 0.7] {
            let model = block(Vector3::repeat(0.03), mass, method);
            let mut start = State::at_rest(at(0.0, 0.0, 0.03));
            start.bodies[0].velocity = Vector3::new(0.6, 0.3, 0.0);
            let x = rollout(&model, &Scene::on_table(0.4), &start, &[1.0, 2.0]).unwrap();
            let slid = place(&x, 0).xy();
            let truth = 0.45 / (2.0 * 0.4 * G);
            let rest = (place(&x, 1) - place(&x, 0)).norm();
            eprintln!("{method:?}: slid {:.3e}, aside {:.3e}, rest {rest:.3e}, turned {:.3e}", slid.norm() / truth - 1.0, slid.y / slid.x - 0.5, x.bodies[0].poses[0].rotation.angle());
            assert!((slid.norm() / truth - 1.0).abs() < 0.005, "{method:?}: {slid}");
            assert!((slid.y / slid.x - 0.5).abs() < 1e-3, "{method:?}: it leaves its line, {slid}");
            assert!(rest < 1e-9, "{method:?}: it creeps");
        }
    }
}

#[test]
fn a_block_on_an_incline_sticks_below_the_angle_of_friction_and_slides_above() {
    let mu: f64 = 0.5;
    for method in ALL {
        let incline = |angle: f64, seconds: f64| {
            let mut scene = Scene::on_table(mu);
            scene.gravity = Vector3::new(angle.sin(), 0.0, -angle.cos()) * G;
            let model = block(Vector3::repeat(0.03), 0.2, method);
            let end = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.03)), &[0.2, seconds]).unwrap();
            (place(&end, 1).x, (place(&end, 1) - place(&end, 0)).norm())
        };
        let limit = mu.atan();
        let (drift, creep) = incline(limit - 0.5_f64.to_radians(), 3.0);
        let a = limit + 5.0_f64.to_radians();
        let expected = 0.5 * G * (a.sin() - mu * a.cos()) * 0.25;
        eprintln!("{method:?}: drift {drift:.3e} creep {creep:.3e} slide {:.3e}", incline(a, 0.5).0 / expected - 1.0);
        // The springs give by the load over their stiffness.
        assert!(drift.abs() < 3.0 * G / FREQUENCY_RAD_S.powi(2) && creep < 1e-9, "{method:?}: {drift}, {creep}");
        assert!((incline(a, 0.5).0 / expected - 1.0).abs() < 0.01, "{method:?}");
    }
}

#[test]
fn tilting_about_an_edge_follows_the_pendulum_equation() {
    // (I_E / m) theta'' = F h(theta) / m - g r(theta) about the edge, integrated to high accuracy here.
    let half: Vector3<f64> = Vector3::new(0.02, 0.04, 0.05);
    let mass = 0.25;
    let f = 1.4 * mass * G * 0.02 / 0.08;
    let times: Vec<f64> = (10..28).map(|k| f64::from(k) * 0.01).collect();
    let inertia = (half.x.powi(2) + half.z.powi(2)) * 4.0 / 3.0;
    let (mut theta, mut rate, dt) = (0.0_f64, 0.0_f64, 1e-6);
    let mut truth = Vec::new();
    for k in 0..180_000 {
        let t = 0.1 + f64::from(k) * dt;
        if truth.len() < times.len() && times[truth.len()] <= t {
            truth.push(theta);
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
    assert!(truth.len() > 12 && truth[9] > 0.03);
    for method in ALL {
        // Stiffer than the rest: a corner that is relieved springs back at about g/ω, which shows as a kick of g/(ω r_x).
        let mut model = block(half, mass, method);
        model.contact.frequency_rad_s = 1e4;
        let mut scene = Scene::on_table(0.9);
        scene.forces.push(force(Vector3::x() * f, 0.1, 0.2, Point3::new(-0.02, 0.0, 0.03)));
        let record = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.05)), &times).unwrap();
        let mut worst = 0.0_f64;
        for (k, theta) in truth.iter().enumerate() {
            let simulated = record.bodies[0].poses[k].rotation.scaled_axis().y;
            worst = worst.max((simulated - theta).abs());
            assert!((simulated - theta).abs() < 0.02 * theta.abs() + 1e-3, "{method:?}, t {}: {simulated} against {theta}", times[k]);
        }
        eprintln!("{method:?}: worst {worst:.3e} of {:.3}", truth.iter().fold(0.0_f64, |a, b| a.max(*b)));
    }
}

#[test]
fn a_push_with_a_known_force_slides_by_newtons_law() {
    for method in ALL {
        let (mass, mu, f) = (0.3, 0.5, 0.3 * G * 0.8);
        let model = block(Vector3::new(0.03, 0.03, 0.05), mass, method);
        let mut scene = Scene::on_table(mu);
        scene.forces.push(force(Vector3::x() * f, 0.1, 0.3, Point3::new(-0.03, 0.0, -0.05)));
        let record = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.05)), &[0.1, 0.3, 1.0]).unwrap();
        let a = f / mass - mu * G;
        let slid = [0.5 * a * 0.04, 0.5 * a * 0.04 * (1.0 + a / (mu * G))];
        for k in 0..2 {
            let x = place(&record, k + 1).x - place(&record, 0).x;
            eprintln!("{method:?}: {:.3e}", x / slid[k] - 1.0);
            assert!((x / slid[k] - 1.0).abs() < 0.005, "{method:?}: {x} against {}", slid[k]);
        }
    }
}

#[test]
fn contact_forces_carry_the_load() {
    for method in ALL {
        // A push that friction holds: contacts carry the weight and hold against the push.
        let model = block(Vector3::repeat(0.03), 0.2, method);
        let mut scene = Scene::on_table(0.6);
        scene.forces.push(force(Vector3::x() * 0.2 * G * 0.5, 0.05, 10.0, Point3::new(0.0, 0.0, -0.01)));
        let mut state = State::at_rest(at(0.0, 0.0, 0.03));
        let mut work = Workspace::default();
        let mut middle = Vector3::zeros();
        for k in 0..2000 {
            if k == 1000 {
                middle = state.bodies[0].world_from_body.translation.vector;
            }
            step(&model, &scene, &mut state, &mut work).unwrap();
        }
        let total: Vector3<f64> = work.contacts().map(|c| c.force).sum();
        let creep = (state.bodies[0].world_from_body.translation.vector - middle).norm();
        eprintln!("{method:?}: total {:.3e}, creep {creep:.3e}", (total - Vector3::new(-0.5, 0.0, 1.0) * (0.2 * G)).norm());
        assert!((total - Vector3::new(-0.5, 0.0, 1.0) * (0.2 * G)).norm() < 1e-6, "{method:?}: {total}");
        assert!(creep < 1e-9, "{method:?}: {creep}");
        for c in work.contacts() {
            assert!(c.force.dot(&c.normal) > 0.0 && !c.slips && c.key.a == Part::Body(0) && c.key.b == Part::Fixed(0));
        }
    }
}
