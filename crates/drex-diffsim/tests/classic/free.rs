//! Motion without contact: pendulum, acrobot, spinning bodies, top; and a body that spins on a slope.
//!
//! What the tree alone can show is tested beside it (src/articulation/tests): closed forms of mass matrix and bias of the
//! double pendulum, the period of a pendulum, momentum and energy of free trees.

use drex_core::Pose;
use drex_diffsim::{Model, Scene, State, Workspace, step};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::common::{G, body, cuboid, fixed_arm, kinetic, momenta, relative, robot, turned, within};

fn weightless() -> Scene<f64> {
    let mut scene = Scene::empty();
    scene.gravity = Vector3::zeros();
    scene
}

/// (1) A point mass on a massless rod; 500 steps from rest.
#[test]
fn energy_of_a_pendulum_drifts_less_than_by_explicit_euler_and_more_than_by_runge_kutta() {
    let (l, h, start) = (0.5, 2e-3, 1.0_f64);
    let rod = robot(
        r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body name="rod"><joint name="swing"
        axis="0 1 0"/><inertial pos="0 0 -0.5" mass="2" diaginertia="1e-12 1e-12 1e-12"/></body></body>"#,
        "",
    );
    let model = {
        let mut model = Model::new(Vec::new()).with_articulation(fixed_arm(rod));
        model.dt_s = h;
        model
    };
    let mut state = State::new(Vec::new(), vec![model.articulations[0].at_rest(&[start], 0.0).unwrap()]);
    let per_mass = |q: f64, u: f64| 0.5 * l * l * u * u - G * l * q.cos();
    let (first, scale) = (per_mass(start, 0.0), G * l * (1.0 - start.cos()));
    let rate = |q: f64| -G / l * q.sin();
    let (mut work, mut euler, mut rk) = (Workspace::default(), (start, 0.0), (start, 0.0));
    let mut drift = [0.0_f64; 3];
    for _ in 0..500 {
        step(&model, &Scene::empty(), &mut state, &mut work).unwrap();
        euler = (euler.0 + h * euler.1, euler.1 + h * rate(euler.0));
        let k1 = (rk.1, rate(rk.0));
        let k2 = (rk.1 + 0.5 * h * k1.1, rate(rk.0 + 0.5 * h * k1.0));
        let k3 = (rk.1 + 0.5 * h * k2.1, rate(rk.0 + 0.5 * h * k2.0));
        let k4 = (rk.1 + h * k3.1, rate(rk.0 + h * k3.0));
        let mean = |a: f64, b: f64, c: f64, d: f64| h / 6.0 * (a + 2.0 * b + 2.0 * c + d);
        rk = (rk.0 + mean(k1.0, k2.0, k3.0, k4.0), rk.1 + mean(k1.1, k2.1, k3.1, k4.1));
        for (worst, (q, u)) in
            drift.iter_mut().zip([(state.articulations[0].q[0], state.articulations[0].velocities[0]), euler, rk])
        {
            *worst = worst.max((per_mass(q, u) - first).abs() / scale);
        }
    }
    let [ours, explicit, runge_kutta] = drift;
    within("1 pendulum, 500 steps of 2 ms", "energy drift below that of explicit Euler", ours, explicit);
    within("1 pendulum, 500 steps of 2 ms", "energy drift of Runge-Kutta 4 below ours", runge_kutta, ours);
}

/// (1) E = T + V of the acrobot in closed form; the error of a first-order method halves with the step.
#[test]
fn energy_of_an_acrobot_is_kept_to_first_order() {
    let (m1, m2, l1, c1, c2, i1, i2) = (1.0, 1.3, 1.0, 0.5, 0.9, 0.083, 0.33);
    let arm = robot(
        r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <body name="upper"><joint name="shoulder" axis="0 -1 0"/><inertial pos="0 0 -0.5" mass="1" diaginertia="0.083 0.083 0.01"/>
        <body name="lower" pos="0 0 -1"><joint name="elbow" axis="0 -1 0"/><inertial pos="0 0 -0.9" mass="1.3"
        diaginertia="0.33 0.33 0.01"/></body></body></body>"#,
        "",
    );
    let total = |q: &[f64], u: &[f64]| {
        let c = q[1].cos();
        let m12 = i2 + m2 * c2 * c2 + m2 * l1 * c2 * c;
        let m11 = i1 + i2 + m2 * l1 * l1 + 2.0 * m2 * l1 * c2 * c + m1 * c1 * c1 + m2 * c2 * c2;
        let m22 = i2 + m2 * c2 * c2;
        0.5 * (m11 * u[0] * u[0] + m22 * u[1] * u[1]) + m12 * u[0] * u[1]
            - m1 * G * c1 * q[0].cos()
            - m2 * G * (l1 * q[0].cos() + c2 * (q[0] + q[1]).cos())
    };
    let drift = |h: f64| {
        let mut model = Model::new(Vec::new()).with_articulation(fixed_arm(arm.clone()));
        model.dt_s = h;
        let mut state = State::new(Vec::new(), vec![model.articulations[0].at_rest(&[1.2, -0.7], 0.0).unwrap()]);
        let first = total(&state.articulations[0].q, &state.articulations[0].velocities);
        let (mut work, mut worst) = (Workspace::default(), 0.0_f64);
        for _ in 0..(1.0 / h).round() as u32 {
            step(&model, &Scene::empty(), &mut state, &mut work).unwrap();
            worst = worst.max((total(&state.articulations[0].q, &state.articulations[0].velocities) - first).abs());
        }
        worst / (m1 * G * c1 + m2 * G * (l1 + c2))
    };
    let (coarse, fine) = (drift(1e-3), drift(5e-4));
    within("1 acrobot, 1 s at 0.5 ms", "E = T + V, of m g l", fine, 5e-3);
    within("1 acrobot, half the step", "half the drift", (coarse / fine / 2.0 - 1.0).abs(), 0.1);
}

/// (2) Euler's equations of a symmetric body at phases where the accelerated component is zero, so that a step of 1e-18 s
/// shows the derivative to the last digits.
#[test]
fn derivatives_of_a_torque_free_body_are_exact() {
    let h = 1e-18;
    let mut worst = [0.0_f64; 2];
    for (i1, i3) in [(0.04, 0.02), (0.02, 0.035)] {
        for w in [Vector3::new(2.0, 0.0, 6.0), Vector3::new(0.0, 4.0, -6.0)] {
            let mut model = Model::new(vec![body(&[], Vector3::new(i1, i1, i3), 0.7)]);
            model.dt_s = h;
            let mut state = State::at_rest(Pose::identity());
            state.bodies[0].angular_velocity = w;
            step(&model, &Scene::empty(), &mut state, &mut Workspace::default()).unwrap();
            let s = (i3 - i1) / i1 * w.z;
            let truth = Vector3::new(-s * w.y, s * w.x, 0.0);
            let b = &state.bodies[0];
            worst[0] = worst[0].max(((b.angular_velocity - w) / h - truth).amax() / truth.amax());
            worst[0] = worst[0].max((b.velocity.z / h + G).abs() / G);
            worst[1] = worst[1].max((b.world_from_body.rotation.coords.xyz() * (2.0 / h) - w).amax() / w.amax());
        }
    }
    within("2 torque-free body, derivatives", "I w' = -w x I w, v' = g", worst[0], 32.0 * f64::EPSILON);
    within("2 torque-free body, derivatives", "2 q' = w q", worst[1], 32.0 * f64::EPSILON);
}

/// (2) R(t) = exp(L t / I1) R(0) exp(z (1 - I3/I1) w3 t) and w3 constant, over four periods.
#[test]
fn a_symmetric_body_turns_and_precesses_at_its_two_rates() {
    let (i1, i3) = (0.04, 0.02);
    let w0 = Vector3::new(2.0, 0.0, 6.0);
    let start = UnitQuaternion::from_euler_angles(0.3, -0.5, 1.1);
    let momentum = start * Vector3::new(i1 * w0.x, i1 * w0.y, i3 * w0.z);
    let (s, p) = ((i3 - i1) / i1 * w0.z, momentum.norm() / i1);
    let period = std::f64::consts::TAU / f64::max(f64::abs(s), p);
    // Largest deviation, and the same as a part of what is allowed at its time.
    let deviation = |h: f64| {
        let mut model = Model::new(vec![body(&[], Vector3::new(i1, i1, i3), 0.7)]);
        model.dt_s = h;
        let mut state = State::at_rest(turned(Vector3::zeros(), start));
        state.bodies[0].angular_velocity = start * w0;
        let (mut work, mut used, mut error) = (Workspace::default(), 0.0_f64, 0.0_f64);
        for k in 1..=(4.0 * period / h) as u32 {
            step(&model, &weightless(), &mut state, &mut work).unwrap();
            let t = f64::from(k) * h;
            let turn = |w: Vector3<f64>| UnitQuaternion::from_scaled_axis(w * t);
            let truth = turn(momentum / i1) * start * turn(Vector3::z() * -s);
            let b = &state.bodies[0];
            let q = b.world_from_body.rotation;
            let off = (q.to_rotation_matrix().matrix() - truth.to_rotation_matrix().matrix()).amax();
            let w = Vector3::new(w0.x * (s * t).cos(), w0.x * (s * t).sin(), w0.z);
            let off = off.max((q.inverse() * b.angular_velocity - w).amax());
            error = error.max(off);
            used = used.max(off / (1e-3 * (1.0 + 256.0 * t / period)));
        }
        (used, error)
    };
    let ((used, coarse), (_, fine)) = (deviation(5e-4), deviation(2.5e-4));
    within("2 torque-free body, four periods", "closed form of R(t), w(t), in parts of (1 + 256 t/T) 1e-3", used, 1.0);
    within("2 torque-free body, half the step", "half the deviation", relative(coarse / fine, 2.0), 0.1);
}

/// (3) The boxes of MuJoCo's FreeBodyConservation, 10 ms.
#[test]
fn a_tumbling_box_loses_a_little_energy_and_never_gains_any() {
    let tilt = UnitQuaternion::from_euler_angles(10_f64.to_radians(), 20_f64.to_radians(), 30_f64.to_radians());
    for (rotation, center) in [(UnitQuaternion::identity(), Vector3::zeros()), (tilt, Vector3::new(0.03, 0.02, 0.01))] {
        let mut box_ = cuboid(Vector3::new(0.1, 0.2, 0.3), 1.0);
        let r: Matrix3<f64> = rotation.to_rotation_matrix().into_inner();
        box_.unit_inertia = r * box_.unit_inertia * r.transpose();
        box_.center_of_mass = center.into();
        let mut model = Model::new(vec![box_]);
        model.dt_s = 0.01;
        let mut state = State::at_rest(Pose::identity());
        let w = Vector3::new(1.0, 2.0, 3.0);
        state.bodies[0].angular_velocity = w;
        state.bodies[0].velocity = w.cross(&center);
        let spin = |s: &State<f64>| {
            let com = (s.bodies[0].world_from_body * model.bodies[0].center_of_mass).coords;
            let (p, l) = momenta(&model, s);
            l - com.cross(&p)
        };
        let (first, l0, mut work, mut gain) = (kinetic(&model, &state), spin(&state), Workspace::default(), 0.0_f64);
        for _ in 0..500 {
            let before = kinetic(&model, &state);
            step(&model, &weightless(), &mut state, &mut work).unwrap();
            gain = gain.max(kinetic(&model, &state) / before - 1.0);
        }
        within("3 tumbling box, 5 s at 10 ms", "energy never rises", gain, 1e-9);
        within("3 tumbling box, 5 s at 10 ms", "energy lost", 1.0 - kinetic(&model, &state) / first, 0.3);
        within("3 tumbling box, 5 s at 10 ms", "angular momentum kept, N m s", (spin(&state) - l0).norm(), 0.05);
    }
}

/// (3) The boxes of MuJoCo's FreeBodyGyroStable: tumbling about the middle axis, and fast about the first.
#[test]
fn a_spinning_box_gains_no_energy_in_100_seconds() {
    for w in [Vector3::new(0.05, 5.0, 0.05), Vector3::new(20.0, 0.05, 0.05)] {
        let mut model = Model::new(vec![cuboid(Vector3::new(0.1, 0.2, 0.3), 1.0)]);
        model.dt_s = 5e-3;
        let mut state = State::at_rest(Pose::identity());
        state.bodies[0].angular_velocity = w;
        let (first, mut work, mut most) = (kinetic(&model, &state), Workspace::default(), 0.0_f64);
        for _ in 0..20_000 {
            step(&model, &weightless(), &mut state, &mut work).unwrap();
            most = most.max(kinetic(&model, &state) / first - 1.0);
        }
        within("3 tennis racket, 100 s at 5 ms", "energy gained", most.max(0.0), 0.01);
    }
}

/// (4) A top as three hinges (precession, nutation, spin).
struct Top {
    model: Model<f64>,
    tilt: f64,
    /// m g l.
    moment: f64,
    /// About a transverse axis through the pivot, and about the axis of symmetry.
    inertia: (f64, f64),
}

impl Top {
    fn new(dt_s: f64) -> Self {
        let (mass, l, tilt, across, along) = (0.5, 0.06, 0.5, 6e-4, 1e-3);
        let links = format!(
            r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
            <body name="a"><joint name="precession" axis="0 0 1"/>
            <body name="b" euler="{tilt} 0 0"><joint name="nutation" axis="1 0 0"/>
            <body name="c"><joint name="spin" axis="0 0 1"/>
            <inertial pos="0 0 {l}" mass="{mass}" diaginertia="{across} {across} {along}"/></body></body></body></body>"#
        );
        let mut model = Model::new(Vec::new()).with_articulation(fixed_arm(robot(&links, "")));
        model.dt_s = dt_s;
        Self { model, tilt, moment: mass * G * l, inertia: (across + mass * l * l, along) }
    }

    /// Mean rate of precession over a time from a spin w3 and a rate of precession, and the largest nod.
    fn run(&self, w3: f64, precession: f64, seconds: f64) -> (f64, f64) {
        let mut arm = self.model.articulations[0].at_rest(&[0.0; 3], 0.0).unwrap();
        arm.velocities = vec![precession, 0.0, w3 - precession * self.tilt.cos()];
        let mut state = State::new(Vec::new(), vec![arm]);
        let (mut work, mut nod) = (Workspace::default(), 0.0_f64);
        for _ in 0..(seconds / self.model.dt_s).round() as u32 {
            step(&self.model, &Scene::empty(), &mut state, &mut work).unwrap();
            nod = nod.max(state.articulations[0].q[1].abs());
        }
        (state.articulations[0].q[0] / state.time_s, nod)
    }
}

#[test]
fn a_heavy_top_precesses_steadily() {
    let top = Top::new(1e-4);
    let ((i1, i3), c) = (top.inertia, top.tilt.cos());
    for w3 in [60.0_f64, 400.0] {
        let root = (i3 * i3 * w3 * w3 - 4.0 * i1 * top.moment * c).sqrt();
        let steady = (i3 * w3 - root) / (2.0 * i1 * c);
        let (rate, nod) = top.run(w3, steady, std::f64::consts::TAU / steady);
        let name = format!("4 heavy top, {w3} rad/s, one turn");
        within(&name, "W = (I3 w3 - sqrt(I3² w3² - 4 I1 m g l cos t)) / (2 I1 cos t)", relative(rate, steady), 0.01);
        within(&name, "the tilt stays, rad", nod, 0.01);
    }
}

/// (4) Released with spin only, the top nods 40 times while it precesses at m g l / (I3 w3) in the mean.
#[test]
fn a_fast_top_released_from_rest_nods_and_precesses() {
    let top = Top::new(1e-5);
    let ((i1, i3), w3) = (top.inertia, 1200.0);
    let nodding = std::f64::consts::TAU * i1 / (i3 * w3);
    let (rate, nod) = top.run(w3, 0.0, 40.0 * nodding);
    within("4 heavy top released, 40 nods", "W -> m g l / (I3 w3)", relative(rate, top.moment / (i3 * w3)), 0.01);
    let (_, first) = top.run(w3, 0.0, nodding);
    let truth = 2.0 * i1 * top.moment * top.tilt.sin() / (i3 * w3).powi(2);
    within("4 heavy top released, first nod", "depth -> 2 I1 m g l sin t / (I3 w3)²", relative(first, truth), 0.02);
    assert!(nod < 2.0 * truth);
}
