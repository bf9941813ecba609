//! Motions whose truth is a formula.

use drex_diffsim::{BodyState, Scene, State, Workspace, rollout, step};

use super::*;

#[test]
fn free_fall_and_lift_are_parabolas() {
    for &method in ALL {
        let model = block(Vector3::repeat(0.03), 0.2, method);
        let mut start = State::at_rest(at(0.0, 0.0, 2.0));
        start.bodies[0].velocity = Vector3::new(1.0, -0.5, 0.3);
        start.bodies[0].angular_velocity = Vector3::new(3.0, 1.0, -2.0);
        let end = rollout(&model, &Scene::empty(), &start, &[0.5]).unwrap();
        let truth = Vector3::new(0.5, -0.25, 2.0 + 0.15 - 0.5 * G * 0.25);
        // A scheme of first order is g t h / 2 beside the parabola.
        let error = (place(&end, 0) - truth).norm();
        assert!(error < 1.01 * 0.5 * G * 0.5 * substep_s(method, model.dt_s), "{method:?}: {error}");
        // m z'' = u - m g once u exceeds the weight.
        let mut scene = Scene::on_table(0.5);
        scene.forces.push(force(Vector3::z() * 0.2 * G * 1.7, 0.1, 0.3, Point3::origin()));
        let end = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.03)), &[0.25]).unwrap();
        let rise = place(&end, 0).z - 0.03;
        let truth = 0.5 * 0.7 * G * 0.15_f64.powi(2);
        // h / T of the time scheme, and g/ω of speed from the springs that the table lets go.
        let bar = substep_s(method, model.dt_s) / 0.15 + G / FREQUENCY_RAD_S * 0.15 / truth;
        assert!((rise / truth - 1.0).abs() < bar, "{method:?}: {}", rise / truth - 1.0);
    }
}

#[test]
fn a_block_rests_at_depth_g_over_omega_squared_without_creep() {
    for &method in ALL {
        let model = block(Vector3::repeat(0.03), 0.2, method);
        let mut start = State::at_rest(at(0.0, 0.0, 0.031));
        start.bodies[0].velocity = Vector3::new(0.05, 0.02, 0.0);
        let end = rollout(&model, &Scene::on_table(0.5), &start, &[1.0, 2.0]).unwrap();
        let depth = 0.03 - place(&end, 0).z;
        let creep = (place(&end, 1) - place(&end, 0)).norm();
        // What rests is a fixed point of every method, whatever the step.
        assert!((depth / (G / FREQUENCY_RAD_S.powi(2)) - 1.0).abs() < 1e-6, "{method:?}: {depth}");
        assert!(creep < 1e-12 && end.last.bodies[0].velocity.norm() < 1e-9, "{method:?}: {creep}");
    }
}

#[test]
fn a_sliding_block_stops_after_v_squared_over_two_mu_g() {
    for &method in ALL {
        for mass in [0.02, 0.7] {
            let model = block(Vector3::repeat(0.03), mass, method);
            let mut start = State::at_rest(at(0.0, 0.0, 0.03));
            start.bodies[0].velocity = Vector3::new(0.6, 0.3, 0.0);
            let x = rollout(&model, &Scene::on_table(0.4), &start, &[1.0, 2.0]).unwrap();
            let slid = place(&x, 0).xy();
            let truth = 0.45 / (2.0 * 0.4 * G);
            // Half a step more or less at the first speed: h μ g / v of the way.
            let bar = 1.1 * substep_s(method, model.dt_s) * 0.4 * G / 0.45_f64.sqrt();
            assert!((slid.norm() / truth - 1.0).abs() < bar, "{method:?}: {}", slid.norm() / truth - 1.0);
            // Sweeps that visit one corner after the other turn the block by less than a microradian.
            assert!((slid.y / slid.x - 0.5).abs() < 1e-6, "{method:?}: it leaves its line, {slid}");
            assert!(x.bodies[0].poses[0].rotation.angle() < 1e-6, "{method:?}: it turns");
            assert!((place(&x, 1) - place(&x, 0)).norm() < 1e-12, "{method:?}: it creeps");
        }
    }
}

#[test]
fn a_block_on_an_incline_sticks_below_the_angle_of_friction_and_slides_above() {
    let mu: f64 = 0.5;
    for &method in ALL {
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
        // The springs give by the load over their stiffness, after a slip while the block sinks in.
        assert!(drift.abs() < 3.0 * G / FREQUENCY_RAD_S.powi(2) && creep < 1e-12, "{method:?}: {drift}, {creep}");
        // h / T of the time scheme, doubled for the start on loose springs.
        let slid = incline(a, 0.5).0;
        assert!((slid / expected - 1.0).abs() < 2.0 * 5e-4 / 0.5, "{method:?}: {}", slid / expected - 1.0);
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
    for &method in ALL {
        // Stiffer than the rest: a corner that is relieved springs back at about g/ω, which shows as a kick of g/(ω r_x).
        let mut model = block(half, mass, method);
        model.contact.frequency_rad_s = 1e4;
        let mut scene = Scene::on_table(0.9);
        scene.forces.push(force(Vector3::x() * f, 0.1, 0.2, Point3::new(-0.02, 0.0, 0.03)));
        let record = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.05)), &times).unwrap();
        for (k, theta) in truth.iter().enumerate() {
            let simulated = record.bodies[0].poses[k].rotation.scaled_axis().y;
            // The kick grows like e^(12 t/s): a milliradian in the end, beside 0.5 % of first order in time.
            assert!(
                (simulated - theta).abs() < 0.005 * theta.abs() + 5e-4,
                "{method:?}, {k}: {simulated} against {theta}"
            );
        }
    }
}

#[test]
fn a_push_with_a_known_force_slides_by_newtons_law() {
    for &method in ALL {
        let (mass, mu, f) = (0.3, 0.5, 0.3 * G * 0.8);
        let model = block(Vector3::new(0.03, 0.03, 0.05), mass, method);
        let mut scene = Scene::on_table(mu);
        scene.forces.push(force(Vector3::x() * f, 0.1, 0.3, Point3::new(-0.03, 0.0, -0.05)));
        let record = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.05)), &[0.1, 0.3, 1.0]).unwrap();
        let a = f / mass - mu * G;
        let slid = [0.5 * a * 0.04, 0.5 * a * 0.04 * (1.0 + a / (mu * G))];
        // h / T of the time scheme, and the speed at which the friction's damper reaches its bound, μ g / (ω² τ_t), which
        // methods with short steps resolve.
        let creep = mu * G / (FREQUENCY_RAD_S.powi(2) * model.contact.tangential_relaxation_s);
        let bar = 1.1 * (substep_s(method, model.dt_s) / 0.2 + creep / (a * 0.2));
        for k in 0..2 {
            let x = place(&record, k + 1).x - place(&record, 0).x;
            assert!((x / slid[k] - 1.0).abs() < bar, "{method:?}: {x} against {}", slid[k]);
        }
    }
}

#[test]
fn contact_forces_carry_the_load() {
    for &method in ALL {
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
        assert!((total - Vector3::new(-0.5, 0.0, 1.0) * (0.2 * G)).norm() < 1e-9, "{method:?}: {total}");
        assert!(creep < 1e-12, "{method:?}: {creep}");
        for c in work.contacts() {
            assert!(c.force.dot(&c.normal) > 0.0 && !c.slips && c.key.a == Part::Body(0) && c.key.b == Part::Static(0));
        }
    }
}

#[test]
fn bodies_rest_on_each_other_and_push_back_alike() {
    for &method in ALL {
        let half = Vector3::repeat(0.03);
        let mut model = block(half, 0.1, method);
        model.bodies.push(body(half, 0.5));
        model.bodies[1].material.friction = 0.5;
        let bodies = [at(0.0, 0.0, 0.03), at(0.004, 0.003, 0.09)].map(BodyState::at_rest);
        let mut state = State::new(bodies.to_vec(), Vec::new());
        let mut work = Workspace::default();
        let scene = Scene::on_table(0.5);
        for _ in 0..2000 {
            step(&model, &scene, &mut state, &mut work).unwrap();
        }
        let on = |b: Part| work.contacts().filter(|c| c.key.b == b).map(|c| c.force).sum::<Vector3<f64>>();
        let errors = [on(Part::Static(0)).z / (0.6 * G) - 1.0, on(Part::Body(1)).z / (0.5 * G) + 1.0];
        let speed = state.bodies.iter().map(|b| b.velocity.norm() + b.angular_velocity.norm()).fold(0.0, f64::max);
        let aside = (state.bodies[1].world_from_body.translation.vector - Vector3::new(0.004, 0.003, 0.09)).norm();
        assert!(errors.iter().all(|e| e.abs() < 1e-9) && speed < 1e-9, "{method:?}: {errors:?}, {speed}");
        // The upper block stands off the middle of the lower one, which tilts by g/ω² over a few centimetres.
        assert!(aside < 2e-5, "{method:?}: {aside}");
    }
}

#[test]
fn torque_free_spinning_keeps_energy_and_momentum() {
    for &method in ALL {
        // The tennis racket: the unstable middle axis, 20 s with several flips.
        let model = block(Vector3::new(0.05, 0.1, 0.15), 1.0, method);
        let mut scene = Scene::empty();
        scene.gravity = Vector3::zeros();
        let mut state = State::at_rest(Pose::identity());
        state.bodies[0].angular_velocity = Vector3::new(0.05, 5.0, 0.05);
        let kept = |s: &State<f64>| {
            let b = &s.bodies[0];
            let w = b.world_from_body.rotation.inverse() * b.angular_velocity;
            let l = model.bodies[0].unit_inertia * w;
            (0.5 * w.dot(&l), b.world_from_body.rotation * l)
        };
        let (energy, momentum) = kept(&state);
        let mut work = Workspace::default();
        let mut drift = (0.0_f64, 0.0_f64);
        for _ in 0..40_000 {
            step(&model, &scene, &mut state, &mut work).unwrap();
            let (e, l) = kept(&state);
            drift = (drift.0.max((e / energy - 1.0).abs()), drift.1.max((l - momentum).norm() / momentum.norm()));
        }
        // First order in the step; explicit Euler turns by the old velocity, which costs several times as much.
        let h = substep_s(method, model.dt_s);
        let (most_energy, most_momentum) =
            if is_explicit(method) { (95.0 * h, 75.0 * h) } else { (20.0 * h, 10.0 * h) };
        assert!(drift.0 < most_energy && drift.1 < most_momentum, "{method:?}: {drift:?}");
    }
}

#[test]
fn a_symmetric_top_precesses_at_the_rate_of_its_momentum() {
    // J1 = J2: the axis turns about the angular momentum L at |L| / J1.
    for &method in ALL {
        let mut model = block(Vector3::repeat(0.05), 1.0, method);
        model.bodies[0].unit_inertia = Matrix3::from_diagonal(&Vector3::new(2e-3, 2e-3, 3e-3));
        model.dt_s = 1e-4;
        let mut scene = Scene::empty();
        scene.gravity = Vector3::zeros();
        let mut state = State::at_rest(Pose::identity());
        state.bodies[0].angular_velocity = Vector3::new(0.6, 0.0, 2.0);
        let l = Vector3::new(0.6 * 2e-3, 0.0, 2.0 * 3e-3);
        let end = rollout(&model, &scene, &state, &[1.0]).unwrap();
        let expected = UnitQuaternion::from_scaled_axis(l.normalize() * (l.norm() / 2e-3)) * Vector3::z();
        let error = (end.bodies[0].poses[0].rotation * Vector3::z()).angle(&expected);
        assert!(error < 0.2 * model.dt_s, "{method:?}: {error}");
    }
}

#[test]
fn a_spinning_ball_is_stopped_by_the_torsional_friction_of_its_spot() {
    let (radius_m, ring_m, mu, rate) = (0.03, 0.004, 0.5, 8.0);
    for &method in ALL {
        let inertia = Matrix3::identity() * (0.4 * radius_m * radius_m);
        let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
        let mut model = block(Vector3::repeat(radius_m), 0.2, method);
        model.bodies[0] =
            Body::new(&unit, 0.2, Arc::new(Collider::new(&[Geom::new(Shape::Sphere { radius_m })]).unwrap()));
        model.bodies[0].material.torsion_radius_m = ring_m;
        let mut start = State::at_rest(at(0.0, 0.0, radius_m));
        start.bodies[0].angular_velocity = Vector3::z() * rate;
        let record = rollout(&model, &Scene::on_table(mu), &start, &[1.0, 1.2]).unwrap();
        let angle = |k: usize| record.bodies[0].poses[k].rotation.scaled_axis().z;
        let slowing = mu * ring_m * G / (0.4 * radius_m * radius_m);
        let truth = rate * rate / (2.0 * slowing);
        assert!((angle(0) / truth - 1.0).abs() < 0.01, "{method:?}: {} against {truth}", angle(0));
        assert!((angle(1) - angle(0)).abs() < 1e-9, "{method:?}: it creeps");
    }
}

#[test]
fn methods_agree_on_a_slide_that_turns() {
    // Pushed beside its middle: friction at four corners in four directions, then rest.
    let run = |method: Method, dt_s: f64| {
        let mut model = block(Vector3::new(0.02, 0.04, 0.03), 0.2, method);
        model.dt_s = dt_s;
        let mut scene = Scene::on_table(0.5);
        scene.forces.push(force(Vector3::new(1.3, 0.4, 0.0), 0.05, 0.25, Point3::new(-0.02, 0.03, -0.02)));
        let record = rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.03)), &[0.15, 0.25, 0.8]).unwrap();
        record.bodies[0].poses.clone()
    };
    let truth = run(IMPLICIT, 1e-5);
    assert!(truth[2].rotation.angle() > 0.5 && truth[2].translation.vector.x > 0.05, "{}", truth[2]);
    for &method in ALL {
        let poses = run(method, 2e-4);
        let off = poses.iter().zip(&truth).map(|(p, q)| {
            ((p.translation.vector - q.translation.vector).norm(), (p.rotation.inverse() * q.rotation).angle())
        });
        let off = off.fold((0.0_f64, 0.0_f64), |a, b| (a.0.max(b.0), a.1.max(b.1)));
        // First order again: a tenth of a millimetre of 5 cm and two milliradians of 0.5 rad.
        assert!(off.0 < 1e-4 && off.1 < 2e-3, "{method:?}: {off:?}");
    }
}

#[test]
fn a_lifted_box_whose_edge_slides_to_and_fro_stays_on_its_line() {
    // Lifted at one side, the lower edge slides back, then forth once the box is let go, with friction springs as soft as
    // 1e4 N/m. The friction of both corners has to turn round together, at any step.
    let half = Vector3::new(0.06, 0.06, 0.025);
    let run = |method: Method, dt_s: f64| {
        let mut model = block(half, 0.2, method);
        model.contact.stiffness_n_m = Some(1e4);
        model.contact.relaxation_s = 2e-3;
        model.contact.tangential_relaxation_s = 2e-3;
        model.dt_s = dt_s;
        let mut scene = Scene::on_table(0.3);
        scene.forces.push(force(Vector3::z() * (0.75 * 0.2 * G), 0.05, 0.117, Point3::new(-0.06, 0.0, 0.0)));
        let start = State::at_rest(at(0.0, 0.0, 0.025 - 0.2 * G / 1e4));
        rollout(&model, &scene, &start, &[0.11, 0.15, 0.2]).unwrap().bodies[0].poses.clone()
    };
    let truth = run(IMPLICIT, 1e-5);
    let corner = Point3::new(0.06, 0.06, -0.025);
    assert!((truth[0] * corner).x < 0.0598 && (truth[2] * corner).x > 0.065, "{}", truth[2]);
    for &method in ALL {
        for dt_s in [4e-4, 1e-4] {
            for (p, q) in run(method, dt_s).iter().zip(&truth) {
                let turn = (p.rotation * q.rotation.inverse()).scaled_axis();
                assert!(turn.x.abs() < 1e-5 && turn.z.abs() < 1e-5, "{method:?} at {dt_s}: it turns by {turn}");
                let off = (p.translation.vector - q.translation.vector).norm() + turn.y.abs() * half.x;
                assert!(off < 6e-4 * dt_s / 4e-4, "{method:?} at {dt_s}: {off}");
            }
        }
    }
}

#[test]
fn round_things_that_slide_end_up_rolling() {
    // Angular momentum about the ground is kept: v = v₀ / (1 + J / (m r²)), with J / (m r²) of 2/5 and 1/2.
    let (r, v) = (0.03, 0.5);
    let lying = Pose::from_parts(
        nalgebra::Translation3::identity(),
        UnitQuaternion::from_euler_angles(std::f64::consts::FRAC_PI_2, 0.0, 0.0),
    );
    let cylinder = Geom::new(Shape::Cylinder { radius_m: r, half_length_m: 0.04 }).at(lying);
    for (geom, ratio) in [(Geom::new(Shape::Sphere { radius_m: r }), 0.4), (cylinder, 0.5)] {
        let along = if ratio == 0.4 { 0.4 * r * r } else { r * r / 4.0 + 0.08 * 0.08 / 12.0 };
        let inertia = Matrix3::from_diagonal(&Vector3::new(along, ratio * r * r, along));
        let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
        for &method in ALL {
            let mut model = block(Vector3::repeat(r), 0.2, method);
            model.bodies[0] = Body::new(&unit, 0.2, Arc::new(Collider::new(std::slice::from_ref(&geom)).unwrap()));
            let mut start = State::at_rest(at(0.0, 0.0, r));
            start.bodies[0].velocity.x = v;
            let end = &rollout(&model, &Scene::on_table(0.4), &start, &[0.3, 0.6]).unwrap();
            let speed = (place(end, 1).x - place(end, 0).x) / 0.3;
            let rolls = v / (1.0 + ratio);
            assert!((speed / rolls - 1.0).abs() < 2e-3, "{method:?}, {geom:?}: {speed} against {rolls}");
            let spin = end.last.bodies[0].angular_velocity;
            assert!((spin.y * r / rolls - 1.0).abs() < 2e-3 && spin.xz().norm() < 1e-4, "{method:?}: {spin}");
        }
    }
}

#[test]
fn runs_repeat_to_the_bit() {
    for &method in ALL {
        let model = block(Vector3::new(0.02, 0.03, 0.04), 0.2, method);
        let mut scene = Scene::on_table(0.4);
        scene.forces.push(force(Vector3::new(1.0, 0.3, 0.0), 0.02, 0.15, Point3::new(-0.02, 0.01, 0.02)));
        let run = |start: &State<f64>| rollout(&model, &scene, start, &[0.1, 0.25]).unwrap();
        let start = State::at_rest(at(0.0, 0.0, 0.041));
        assert_eq!(run(&start), run(&start), "{method:?}");
        // And go on from a saved state with a workspace that has seen nothing.
        let (mut state, mut work) = (start.clone(), Workspace::default());
        let mut again = start;
        for _ in 0..300 {
            step(&model, &scene, &mut state, &mut work).unwrap();
            step(&model, &scene, &mut again, &mut Workspace::default()).unwrap();
        }
        assert_eq!(state, again, "{method:?}");
    }
}
