//! What holds in every scene without a drive: stacks rest, momentum is kept, energy is not made, and no direction is
//! special.

use std::sync::Arc;

use drex_core::Pose;
use drex_diffsim::{
    Body, BodyState, Collider, Geom, Material, Model, Scene, Shape, State, StaticBody, Workspace, step,
};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use crate::common::{ball, body, cuboid, energy, momenta, resting, turned};

fn advance(model: &Model<f64>, scene: &Scene<f64>, state: &mut State<f64>, work: &mut Workspace<f64>, seconds: f64) {
    for _ in 0..(seconds / model.dt_s).round() as u64 {
        step(model, scene, state, work).unwrap();
    }
}

fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

fn vector(range: std::ops::Range<f64>) -> impl Strategy<Value = Vector3<f64>> {
    [range.clone(), range.clone(), range].prop_map(Vector3::from)
}

/// Half extents, mass, offset as a part of what is below, yaw and the gap below.
fn brick() -> impl Strategy<Value = (Vector3<f64>, f64, [f64; 2], f64, f64)> {
    (vector(0.015..0.06), 0.05..2.0_f64, [-0.25..0.25_f64, -0.25..0.25], -1.5..1.5_f64, 0.0..1e-3_f64)
}

proptest! {
    #![proptest_config(cases(16))]

    /// Two or three boxes on each other come to rest, and in two seconds nothing moves by a micrometre.
    #[test]
    fn stacks_rest_and_do_not_creep(bricks in prop::collection::vec(brick(), 2..4), friction in 0.2..1.0_f64) {
        let smallest = bricks.iter().map(|b| b.0.x.min(b.0.y)).fold(f64::INFINITY, f64::min);
        let (mut bodies, mut poses, mut top) = (Vec::new(), Vec::new(), 0.0);
        for (half, mass, offset, yaw, gap) in bricks {
            let mut b = cuboid(half, mass);
            b.material = Material::new(friction);
            bodies.push(b);
            let p = Vector3::new(offset[0] * smallest, offset[1] * smallest, top + gap + half.z);
            poses.push(turned(p, UnitQuaternion::from_scaled_axis(Vector3::z() * yaw)));
            top += gap + 2.0 * half.z;
        }
        let model = Model::new(bodies);
        let (scene, mut state, mut work) = (Scene::on_table(friction), resting(&poses), Workspace::default());
        advance(&model, &scene, &mut state, &mut work, 1.0);
        let settled = state.clone();
        advance(&model, &scene, &mut state, &mut work, 2.0);
        for (a, b) in settled.bodies.iter().zip(&state.bodies) {
            let moved = (a.world_from_body.translation.vector - b.world_from_body.translation.vector).norm();
            let turned = a.world_from_body.rotation.angle_to(&b.world_from_body.rotation);
            prop_assert!(moved < 1e-6 && turned < 1e-5, "moved by {moved:e} m, turned by {turned:e}");
            prop_assert!((b.world_from_body.rotation * Vector3::z()).z > 0.9999, "it fell");
        }
        prop_assert_eq!(work.unconverged_steps(), 0);
    }

    /// Balls that collide in free space keep momentum and angular momentum: each pushes as it is pushed.
    #[test]
    fn colliding_balls_keep_their_momentum(
        balls in prop::collection::vec((0.02..0.08_f64, 0.05..3.0_f64, vector(-0.3..0.3), vector(-0.2..0.2), vector(-30.0..30.0)), 2..7),
        friction in 0.0..1.0_f64,
    ) {
        let (mut bodies, mut state) = (Vec::new(), resting(&[]));
        for (i, (radius, mass, p, v, w)) in balls.into_iter().enumerate() {
            // Far enough from each other, on the way to the middle.
            let p = p + Vector3::new(0.3 * i as f64, 0.0, 0.0) - Vector3::new(0.9, 0.0, 0.0);
            if state.bodies.iter().any(|s: &BodyState<f64>| (s.world_from_body.translation.vector - p).norm() < 0.17) {
                continue;
            }
            let mut b = ball(radius, mass);
            b.material = Material::new(friction);
            bodies.push(b);
            state.bodies.push(BodyState { world_from_body: turned(p, UnitQuaternion::identity()), velocity: v - p * 2.0, angular_velocity: w });
        }
        let model = Model::new(bodies);
        let mut scene = Scene::empty();
        scene.gravity = Vector3::zeros();
        let (p0, l0) = momenta(&model, &state);
        let size: f64 = model.bodies.iter().zip(&state.bodies).map(|(b, s)| b.mass_kg * s.velocity.norm()).sum();
        let mut work = Workspace::default();
        for _ in 0..2000 {
            step(&model, &scene, &mut state, &mut work).unwrap();
            let (p, l) = momenta(&model, &state);
            prop_assert!((p - p0).norm() < 1e-9 * size, "momentum off by {:e}", (p - p0).norm() / size);
            prop_assert!((l - l0).norm() < 1e-9 * size, "angular momentum off by {:e}", (l - l0).norm() / size);
        }
        prop_assert_eq!(work.unconverged_steps(), 0);
    }
}

/// A box, ball or capsule.
fn thing() -> impl Strategy<Value = Body<f64>> {
    (0..3_u8, vector(0.015..0.06), 0.05..2.0_f64, 0.0..1.0_f64).prop_map(|(kind, size, mass, friction)| {
        let mut b = match kind {
            0 => cuboid(size, mass),
            1 => ball(size.x, mass),
            _ => {
                let (r, l) = (size.x, size.y);
                // A cylinder of the same size, near enough for an inertia that exists.
                let across = (3.0 * r * r + 4.0 * (l + r) * (l + r)) / 12.0;
                let geom = Geom::new(Shape::Capsule { radius_m: r, half_length_m: l });
                body(&[geom], Vector3::new(across, across, 0.5 * r * r), mass)
            }
        };
        b.material = Material::new(friction);
        b
    })
}

/// Near the origin, turned and moving somehow.
fn motion() -> impl Strategy<Value = BodyState<f64>> {
    (vector(-0.05..0.05), vector(-2.0..2.0), vector(-1.5..1.5), vector(-15.0..15.0)).prop_map(|(p, turn, v, w)| {
        BodyState {
            world_from_body: turned(p, UnitQuaternion::from_scaled_axis(turn)),
            velocity: v,
            angular_velocity: w,
        }
    })
}

/// Things thrown above a table, one over the other.
fn thrown(things: Vec<(Body<f64>, BodyState<f64>)>) -> (Model<f64>, State<f64>) {
    let (bodies, mut states): (Vec<_>, Vec<_>) = things.into_iter().unzip();
    for (i, s) in states.iter_mut().enumerate() {
        s.world_from_body.translation.z += 0.2 + 0.35 * i as f64;
    }
    (Model::new(bodies), State::new(states, Vec::new()))
}

proptest! {
    #![proptest_config(cases(48))]

    /// Springs of contacts give back what they took: energy of motion and height is never above that of the start, and
    /// whenever nothing touches, never above what it was when nothing touched before. On a table, and in a groove where
    /// things get wedged.
    #[test]
    fn energy_is_not_made(
        things in prop::collection::vec((thing(), motion()), 1..4),
        friction in 0.0..1.5_f64,
        stiff in any::<bool>(),
        groove in prop_oneof![Just(0.0), 0.3..1.1_f64],
    ) {
        let (mut model, mut state) = thrown(things);
        if !stiff {
            // Contact that rebounds with about half the speed.
            model.contact.frequency_rad_s = 2000.0;
            (model.contact.relaxation_s, model.contact.tangential_relaxation_s) = (2e-4, 2e-4);
        }
        let mut scene = Scene::on_table(friction);
        if groove > 0.0 {
            for tilt in [groove, -groove] {
                let q = UnitQuaternion::from_scaled_axis(Vector3::y() * tilt);
                let plane = turned(q * Vector3::z() * -0.1, q);
                scene.static_bodies.push(StaticBody::new(plane, Arc::new(Collider::plane()), friction));
            }
        }
        let first = energy(&model, &state, &scene.gravity);
        let (mut work, mut least) = (Workspace::default(), first);
        for _ in 0..3000 {
            step(&model, &scene, &mut state, &mut work).unwrap();
            let now = energy(&model, &state, &scene.gravity);
            prop_assert!(now <= first * (1.0 + 1e-12), "{now} J after {first} J");
            if state.anchors.is_empty() {
                prop_assert!(now <= least * (1.0 + 1e-12), "{now} J after {least} J in the air");
                least = now;
            }
        }
        prop_assert_eq!(work.unconverged_steps(), 0);
    }

    /// The whole scene turned and moved, gravity with it, does the same, but for rounding that impacts amplify.
    #[test]
    fn no_direction_is_special(
        things in prop::collection::vec((thing(), motion()), 1..3), friction in 0.0..1.0_f64,
        shift in vector(-1.0..1.0), turn in vector(-2.0..2.0),
    ) {
        let (model, mut state) = thrown(things);
        let moved = turned(shift, UnitQuaternion::from_scaled_axis(turn));
        let mut scene = Scene::on_table(friction);
        scene.static_bodies.push(StaticBody::cuboid(Point3::new(0.1, 0.0, 0.02), Vector3::new(0.05, 0.3, 0.03), friction).unwrap());
        let mut other_scene = Scene::empty();
        other_scene.gravity = moved.rotation * scene.gravity;
        for f in &scene.static_bodies {
            let mut f = f.clone();
            f.world_from_body = moved * f.world_from_body;
            other_scene.static_bodies.push(f);
        }
        let mut other = state.clone();
        for s in &mut other.bodies {
            s.world_from_body = moved * s.world_from_body;
            s.velocity = moved.rotation * s.velocity;
            s.angular_velocity = moved.rotation * s.angular_velocity;
        }
        let (mut work, mut other_work) = (Workspace::default(), Workspace::default());
        advance(&model, &scene, &mut state, &mut work, 0.4);
        advance(&model, &other_scene, &mut other, &mut other_work, 0.4);
        prop_assert_eq!((work.unconverged_steps(), other_work.unconverged_steps()), (0, 0));
        for (a, b) in state.bodies.iter().zip(&other.bodies) {
            let back: Pose = moved.inverse() * b.world_from_body;
            let apart = (back.translation.vector - a.world_from_body.translation.vector).norm()
                + back.rotation.angle_to(&a.world_from_body.rotation) * 0.05;
            prop_assert!(apart < 1e-6, "{apart:e} m apart");
        }
    }
}

/// Wedged between a table and the side of a block, at a friction where the two contacts nearly lock each other: Newton's
/// method alone goes in circles here.
#[test]
fn a_capsule_between_a_table_and_a_block_is_solved_in_every_step() {
    let (radius_m, half_length_m, friction) = (0.0438, 0.0493, 0.9557);
    let geom = Geom::new(Shape::Capsule { radius_m, half_length_m });
    let model = Model::new(vec![body(&[geom], Vector3::new(3.369e-3, 3.369e-3, 9.594e-4), 0.05)]);
    let mut scene = Scene::on_table(friction);
    scene
        .static_bodies
        .push(StaticBody::cuboid(Point3::new(0.1, 0.0, 0.02), Vector3::new(0.05, 0.3, 0.03), friction).unwrap());
    let mut unsolved = 0;
    for k in 0..40 {
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(-1.9584 + 0.01 * f64::from(k), 0.2206, 1.1925));
        let mut state = resting(&[turned(Vector3::new(-0.0267, 0.0, 0.2209), lean)]);
        state.bodies[0].velocity = Vector3::new(0.1049, -0.2798, -0.7822);
        state.bodies[0].angular_velocity = Vector3::new(-7.883, -1.0129, -6.6141);
        let mut work = Workspace::default();
        advance(&model, &scene, &mut state, &mut work, 0.4);
        unsolved += work.unconverged_steps();
    }
    assert_eq!(unsolved, 0);
}
