//! Soft contact as MuJoCo has it: what its formulas say.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    Body, Collider, Dual, Geom, Model, Scalar, Scene, Shape, SoftContact, State, parameter, rollout, tangents,
};
use nalgebra::{Matrix3, Point3, Vector3};

const HALF: f64 = 0.03;

fn cube<T: Scalar>(soft: SoftContact, mass_kg: T, dt_s: f64) -> Model<T> {
    let inertia = Matrix3::identity() * (2.0 / 3.0 * HALF * HALF);
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let collider = Collider::new(&[Geom::new(Shape::Box { half_m: Vector3::repeat(HALF) })]).unwrap();
    let mut model = Model::new(vec![Body::new(&unit, mass_kg, Arc::new(collider))]);
    model.contact.soft = Some(soft);
    model.dt_s = dt_s;
    model
}

fn stiff() -> SoftContact {
    let mut soft = SoftContact::default();
    soft.time_constant_s = 0.004;
    soft.impedance = [0.95, 0.99];
    soft.width_m = 5e-4;
    soft.friction_ratio = 10.0;
    soft
}

#[test]
fn a_cube_rests_where_stiffness_and_impedance_carry_its_weight() {
    // Four corners: 4 d / (1 - d) (k d r - 0) = g with k = 1 / (d₁ T)² and d at the surface nearly constant.
    for mass in [0.02, 1.5] {
        let model = cube(stiff(), mass, 5e-4);
        let start = State::at_rest(Pose::translation(0.0, 0.0, HALF + 1e-4));
        let end = rollout(&model, &Scene::on_table(0.4), &start, &[1.0]).unwrap();
        let depth = HALF - end.bodies[0].poses[0].translation.vector.z;
        let d = 0.95 + 0.04 * 2.0 * (depth / 5e-4_f64).powi(2);
        let expected = 9.81 * (1.0 - d) / (4.0 * d * d) * (0.99 * 0.004_f64).powi(2);
        assert!((depth / expected - 1.0).abs() < 1e-3, "{depth} against {expected}");
    }
}

#[test]
fn rebound_follows_from_the_damping_ratio_alone() {
    // x'' = -2 ζ ω x' - ω² x from x = 0 until it no longer pushes; ω = 1 / (d₁ T ζ), 2 ζ ω = 2 / (d₁ T).
    let truth = |ratio: f64| {
        let (mut x, mut v, h) = (0.0_f64, 1.0_f64, 1e-5);
        while 2.0 * v + x / (ratio * ratio) > 0.0 {
            v -= h * (2.0 * v + x / (ratio * ratio));
            x += h * v;
        }
        -v
    };
    assert!((truth(1.0) - (-2.0_f64).exp()).abs() < 1e-4);
    for (ratio, mass, speed) in [(1.0, 0.1, 1.0), (1.0, 2.0, 3.0), (0.5, 0.1, 1.0), (0.3, 0.1, 2.0)] {
        let mut soft = stiff();
        soft.damping_ratio = ratio;
        soft.impedance = [0.999, 0.999];
        let model = cube(soft, mass, 2e-5);
        let mut start = State::at_rest(Pose::translation(0.0, 0.0, HALF + 1e-6));
        start.bodies[0].velocity.z = -speed;
        let mut scene = Scene::on_table(0.4);
        scene.gravity = Vector3::zeros();
        let end = rollout(&model, &scene, &start, &[0.1]).unwrap();
        let rebound = end.last.bodies[0].velocity.z / speed;
        assert!((rebound / truth(ratio) - 1.0).abs() < 0.02, "{ratio}: {rebound} against {}", truth(ratio));
    }
}

#[test]
fn derivatives_are_those_of_finite_differences() {
    let end = |friction: f64, speed: f64| {
        let model = cube(stiff(), 0.2, 5e-4);
        let mut start = State::at_rest(Pose::translation(0.0, 0.0, HALF));
        start.bodies[0].velocity = Vector3::new(speed, 0.1, 0.0);
        rollout(&model, &Scene::on_table(friction), &start, &[0.05]).unwrap().bodies[0].poses[0].translation.vector
    };
    let model = cube(stiff(), Dual::<2>::from_re(0.2), 5e-4);
    let mut start = State::at_rest(Pose::translation(0.0, 0.0, HALF).cast());
    start.bodies[0].velocity = Vector3::new(parameter(0.7, 1), Dual::from_re(0.1), Dual::from_re(0.0));
    let x = rollout(&model, &Scene::on_table(parameter(0.3, 0)), &start, &[0.05]).unwrap().bodies[0].poses[0];
    let h = 1e-7;
    let by_friction = (end(0.3 + h, 0.7) - end(0.3 - h, 0.7)) / (2.0 * h);
    let by_speed = (end(0.3, 0.7 + h) - end(0.3, 0.7 - h)) / (2.0 * h);
    for k in 0..2 {
        let t = tangents(&x.translation.vector[k]);
        assert!((x.translation.vector[k].re - end(0.3, 0.7)[k]).abs() < 1e-12);
        assert!((t[0] - by_friction[k]).abs() < 1e-5 * (1.0 + by_friction[k].abs()), "{k}: {} {by_friction}", t[0]);
        assert!((t[1] - by_speed[k]).abs() < 1e-5, "{k}: {} {by_speed}", t[1]);
    }
}
