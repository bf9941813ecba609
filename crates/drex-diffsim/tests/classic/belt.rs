//! A conveyor belt: a long box on a prescribed path.

use std::sync::Arc;

use drex_diffsim::{Collider, Geom, KinematicBody, Model, Path, Scene, Shape, Workspace, step};
use nalgebra::Vector3;

use crate::common::{G, at, cuboid, relative, resting, within};

/// (19) Drags a box to its speed with mu g, carries it without creep, and leaves it v²/(2 mu g) further when it stops.
#[test]
fn a_belt_drags_a_box_to_its_speed() {
    let (mu, speed, end) = (0.4, 0.5, 3.0);
    let belt = Collider::new(&[Geom::new(Shape::Box { half_m: Vector3::new(5.0, 0.3, 0.05) })]).unwrap();
    let path = Path::linear(&[0.0, end], &[at(0.0, 0.0, -0.05), at(speed * end, 0.0, -0.05)]).unwrap();
    let mut scene = Scene::empty();
    scene.kinematic_bodies.push(KinematicBody::new(path, Arc::new(belt), mu));
    for mass in [0.05, 2.0] {
        let model = Model::new(vec![cuboid(Vector3::new(0.05, 0.04, 0.03), mass)]);
        let (mut state, mut work) = (resting(&[at(0.0, 0.0, 0.03)]), Workspace::default());
        let mut until = |t: f64| {
            while state.time_s < t - 1e-9 {
                step(&model, &scene, &mut state, &mut work).unwrap();
            }
            (state.bodies[0].velocity, state.bodies[0].world_from_body.translation.x)
        };
        let name = format!("19 conveyor, {mass} kg");
        within(&name, "v = mu g t", relative(until(0.1).0.x, mu * G * 0.1), 1e-3);
        let (v, x) = until(1.0);
        within(&name, "speed of the belt", (v - Vector3::x() * speed).norm() / speed, 1e-3);
        let lag = speed - x;
        within(&name, "lag v² / (2 mu g)", relative(lag, speed * speed / (2.0 * mu * G)), 0.01);
        let (_, later) = until(end);
        within(&name, "creep on the belt in 2 s, m", (speed * end - later - lag).abs(), 1e-6);
        let (v, x) = until(end + 1.0);
        within(
            &name,
            "slides v² / (2 mu g) when the belt stops",
            relative(x - later, speed * speed / (2.0 * mu * G)),
            0.01,
        );
        within(&name, "and rests, m/s", v.norm(), 1e-9);
    }
}
