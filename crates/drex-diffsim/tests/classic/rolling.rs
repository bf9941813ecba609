//! A ball that slides until it rolls.

use drex_diffsim::{Model, Scene, Workspace, step};

use crate::common::{G, at, ball, relative, resting, within};

/// (10) Slides until t = 2 v0 / (7 mu g), then rolls at 5/7 v0 and keeps that speed.
#[test]
fn a_bowling_ball_slides_and_then_rolls() {
    for (mass, radius, mu, v0) in [(7.0, 0.11, 0.12, 3.0), (0.05, 0.02, 0.4, 1.0)] {
        let model = Model::new(vec![ball(radius, mass)]);
        let scene = Scene::on_table(mu);
        // Where it rests, so that the load does not change.
        let mut state = resting(&[at(0.0, 0.0, radius - G / 1e8)]);
        state.bodies[0].velocity.x = v0;
        let (mut work, mut rolls_at, truth) = (Workspace::default(), None, 2.0 * v0 / (7.0 * mu * G));
        let mut first_speed = 0.0;
        while state.time_s < truth + 2.0 {
            step(&model, &scene, &mut state, &mut work).unwrap();
            if rolls_at.is_none() && work.contacts().all(|c| !c.slips) {
                rolls_at = Some(state.time_s);
            }
            if state.time_s < truth + 0.2 {
                first_speed = state.bodies[0].velocity.x;
            }
        }
        let name = format!("10 bowling ball, {mass} kg, mu {mu}");
        within(&name, "rolls from t = 2 v0 / (7 mu g)", relative(rolls_at.unwrap(), truth), 0.01);
        within(&name, "v = 5/7 v0", relative(first_speed, 5.0 / 7.0 * v0), 0.01);
        within(&name, "and so it stays", relative(state.bodies[0].velocity.x, first_speed), 1e-9);
        within(&name, "w R = v", relative(state.bodies[0].angular_velocity.y * radius, first_speed), 1e-5);
    }
}
