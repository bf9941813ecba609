//! What shows the mass, and what does not.

use drex_diffsim::{KinematicBody, Scene, State, parameter, rollout, tangents};
use nalgebra::RealField;

use super::*;

/// A tilted, spinning box thrown onto the table.
fn toss<T: Scalar>(mass_kg: T, method: Method) -> Record<T> {
    let model = block(Vector3::new(0.02, 0.03, 0.04), mass_kg, method);
    let turned = UnitQuaternion::from_euler_angles(0.3, 0.2, 0.1);
    let mut start = State::at_rest(at(0.0, 0.0, 0.08));
    start.bodies[0].world_from_body.rotation =
        UnitQuaternion::new_unchecked(turned.into_inner().cast::<f64>().coords.map(T::lift).into());
    start.bodies[0].velocity = Vector3::new(0.3, 0.1, 0.0).map(T::lift);
    start.bodies[0].angular_velocity = Vector3::new(1.0, 4.0, 1.0).map(T::lift);
    rollout(&model, &Scene::on_table(T::lift(0.4)), &start, &[0.1, 0.2, 0.4, 0.6]).unwrap()
}

#[test]
fn a_toss_looks_the_same_for_every_mass() {
    for &method in ALL {
        let (light, heavy) = (toss(0.01, method), toss(3.0, method));
        let gap = (0..4).map(|k| (place(&light, k) - place(&heavy, k)).norm()).fold(0.0, f64::max);
        let dual = toss(parameter::<1>(0.3_f64.ln(), 0).exp(), method);
        let slope = (0..4)
            .map(|k| place(&dual, k).iter().map(|x| tangents(x)[0].abs()).fold(0.0, f64::max))
            .fold(0.0, f64::max);
        // Nothing of it: what is left is rounding in methods that reckon in newtons.
        assert!(gap < 1e-12 && slope < 1e-12, "{method:?}: {gap}, {slope}");
    }
}

#[test]
fn a_prescribed_sphere_moves_every_mass_alike() {
    let path = [Point3::new(-0.06, 0.0, 0.03), Point3::new(0.04, 0.0, 0.03)];
    for &method in ALL {
        let ends = [0.01, 3.0].map(|m| {
            let model = block(Vector3::repeat(0.03), m, method);
            let mut scene = Scene::on_table(0.4);
            scene.kinematic_bodies.push(KinematicBody::sphere(0.01, 0.6, &[0.1, 1.1], &path).unwrap());
            place(&rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.03)), &[1.3]).unwrap(), 0)
        });
        // The sphere's front ends at x = 5 cm, the block's centre is 3 cm further, and slides on.
        let slid = 0.1 * 0.1 / (2.0 * 0.4 * G);
        assert!((ends[0].x - 0.08 - slid).abs() < 5e-5, "{method:?}: {}", ends[0]);
        assert!((ends[0] - ends[1]).norm() < 1e-12, "{method:?}: {} and {}", ends[0], ends[1]);
    }
}

/// Final x, z and tilt of a block of 4 x 8 x 6 cm under a force from 0.05 s to 0.2 s at a height over its centre.
fn push<T: Scalar + RealField>(ln_mass: T, method: Method, force_n: Vector3<f64>, height: f64, until: f64) -> [T; 3] {
    let model = block(Vector3::new(0.02, 0.04, 0.03), ln_mass.exp(), method);
    let mut scene = Scene::on_table(T::lift(0.45));
    scene.forces.push(force(force_n, 0.05, 0.2, Point3::new(-0.02, 0.0, height)));
    let end = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.03)), &[until]).unwrap();
    let pose = end.bodies[0].poses[0];
    [pose.translation.vector.x, pose.translation.vector.z, (pose.rotation * Vector3::x()).z]
}

#[test]
fn derivatives_by_the_logarithm_of_the_mass_are_those_of_finite_differences() {
    let cases = [
        ("slide", Vector3::x() * 1.4, -0.03, 0.18),
        ("slide to rest", Vector3::x() * 1.4, -0.03, 0.6),
        ("lift", Vector3::new(0.3, 0.0, 3.0), 0.0, 0.18),
        ("tilt", Vector3::x() * 0.75, 0.03, 0.15),
    ];
    for &method in ALL {
        for (name, f, height, until) in cases {
            let x = 0.2_f64.ln();
            let exact = push(parameter::<1>(x, 0), method, f, height, until);
            for (k, output) in exact.iter().enumerate() {
                let slope = tangents(output)[0];
                let off = |h: f64| {
                    let at = |s: f64| push(x + s * h, method, f, height, until)[k];
                    ((at(1.0) - at(-1.0)) / (2.0 * h) - slope).abs()
                };
                let best = [1e-4, 1e-5, 1e-6].map(off).into_iter().fold(f64::INFINITY, f64::min);
                assert!(
                    best < 1e-7 * (0.01 + slope.abs()),
                    "{method:?}, {name}, output {k}: {slope}, off by {best:.2e}"
                );
            }
        }
    }
}
