//! Motion in time: conservation, free bodies, bases on paths.

use nalgebra::{Matrix3, Point3};

use super::*;
use crate::{Body, Model, Scene, State, Workspace};

/// One step of the classical Runge-Kutta method under the efforts `tau`; the quaternion is a vector of four.
fn runge_kutta(
    arm: &Articulation<f64>,
    state: &ArticulationState<f64>,
    tau: &DVector<f64>,
    h: f64,
) -> ArticulationState<f64> {
    let (n, joints) = (arm.dof(), arm.joints.len());
    let pack = |s: &ArticulationState<f64>| {
        let pose = &s.base.world_from_base;
        let base = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).chain(&s.q);
        let mut y: Vec<f64> = base.copied().collect();
        arm.velocity(s, &mut y);
        DVector::from_vec(y)
    };
    let unpack = |y: &DVector<f64>| {
        let mut s = state.clone();
        let q = nalgebra::Quaternion::from(nalgebra::Vector4::from(y.fixed_rows::<4>(3)));
        s.base.world_from_base =
            Pose::from_parts(Vector3::from(y.fixed_rows::<3>(0)).into(), UnitQuaternion::new_normalize(q));
        s.q.copy_from_slice(y.rows(7, joints).as_slice());
        let u = y.rows(7 + joints, n);
        (s.base.velocity, s.base.angular_velocity) = (u.fixed_rows::<3>(0).into(), u.fixed_rows::<3>(3).into());
        s.velocities.copy_from_slice(u.rows(6, joints).as_slice());
        s
    };
    let slope = |y: &DVector<f64>| {
        let s = unpack(y);
        let (m, b, _) = equations(arm, &s, 0.0);
        let a = DMatrix::from_row_slice(n, n, &m).lu().solve(&(tau - DVector::from_vec(b))).unwrap();
        let spin = nalgebra::Quaternion::from_imag(s.base.angular_velocity * 0.5) * *s.base.world_from_base.rotation;
        let parts = s.base.velocity.iter().chain(spin.coords.iter()).chain(&s.velocities).chain(a.iter());
        DVector::from_iterator(y.len(), parts.copied())
    };
    let y = pack(state);
    let k1 = slope(&y);
    let k2 = slope(&(&y + &k1 * (0.5 * h)));
    let k3 = slope(&(&y + &k2 * (0.5 * h)));
    let k4 = slope(&(&y + &k3 * h));
    unpack(&(y + (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0)))
}

/// Efforts inside a robot change neither its linear nor its angular momentum; gravity gives it m g t.
#[test]
fn a_free_robot_keeps_its_momentum() {
    let mut numbers = Numbers(7);
    let arm = Articulation::new(everything(), Base::Free).unwrap();
    let start = random_state(&arm, &mut numbers, 2.0);
    let mut tau = DVector::from_vec(numbers.many(arm.dof(), 0.2));
    tau.rows_mut(0, 6).fill(0.0);
    let (steps, time) = (200, 0.1);
    let mut state = start.clone();
    for _ in 0..steps {
        state = runge_kutta(&arm, &state, &tau, time / f64::from(steps));
    }
    let work = equations(&arm, &start, 0.0).2;
    let (p0, l0, e0) = totals(&work);
    let (p1, l1, e1) = totals(&equations(&arm, &state, 0.0).2);
    let mass = arm.robot.total_mass_kg();
    // Gravity acts at the centre of mass, whose path is a parabola.
    let weight = GRAVITY * mass;
    let first: Vector3<f64> = work.links.iter().map(|l| l.center_of_mass() * l.mass).sum();
    let turned = (first / mass * time + p0 / mass * (0.5 * time * time)).cross(&weight);
    assert!((p1 - p0 - weight * time).norm() < 1e-9, "{}", (p1 - p0 - weight * time).norm());
    assert!((l1 - l0 - turned).norm() < 1e-9, "{}", (l1 - l0 - turned).norm());
    // Efforts are constant: their work is effort times way.
    let work: f64 = (0..state.q.len()).map(|j| tau[6 + j] * (state.q[j] - start.q[j])).sum();
    let rotors = |s: &ArticulationState<f64>| 0.5 * 0.001 * s.velocities[0] * s.velocities[0];
    let change = e1 - e0 + rotors(&state) - rotors(&start);
    assert!((change - work).abs() < 1e-9, "{change} {work}");
}

/// With the simulator's own step, linear momentum is exact, and a free robot of one link is a free body.
#[test]
fn steps_of_a_free_robot_keep_linear_momentum() {
    let mut numbers = Numbers(8);
    let arm = Articulation::new(everything(), Base::Free).unwrap();
    let mut state = random_state(&arm, &mut numbers, 3.0);
    let mut work = TreeWork::default();
    let (p0, l0, _) = totals(&equations(&arm, &state, 0.0).2);
    for k in 0..400 {
        step(&arm, &mut state, (f64::from(k) * 5e-4, 5e-4), &Vector3::zeros(), &[], &mut work);
    }
    let (p, l, _) = totals(&equations(&arm, &state, 0.0).2);
    assert!((p - p0).norm() < 1e-11, "{}", (p - p0).norm());
    assert!((l - l0).norm() < 0.01 * l0.norm(), "{} of {}", (l - l0).norm(), l0.norm());
}

fn racket(moments: [f64; 3], center: Vector3<f64>, mass: f64) -> Articulation<f64> {
    let robot =
        mjcf("<body name=\"base\"><freejoint/><inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"1 1 1\"/></body>");
    let mut arm = Articulation::new(robot, Base::Free).unwrap();
    arm.links[0] = LinkInertia {
        mass_kg: mass,
        center_of_mass: Point3::from(center),
        inertia: Matrix3::from_diagonal(&Vector3::from(moments)),
    };
    arm
}

#[test]
fn one_free_link_moves_as_a_free_body() {
    let (mut numbers, mass) = (Numbers(9), 0.7);
    let (moments, center) = ([2e-3, 3e-3, 4.5e-3], Vector3::new(0.03, -0.02, 0.05));
    let arm = racket(moments, center, mass);
    let mut state = random_state(&arm, &mut numbers, 4.0);
    let inertia = Matrix3::from_diagonal(&Vector3::from(moments));
    let properties = drex_core::MassProperties { mass_kg: mass, center_of_mass: center.into(), inertia };
    let model = Model::new(vec![Body::new(&properties, mass, Arc::new(crate::Collider::none()))]);
    let mut body = State::at_rest(state.base.world_from_base);
    let lever = state.base.world_from_base.rotation * center;
    body.bodies[0].velocity = state.base.velocity + state.base.angular_velocity.cross(&lever);
    body.bodies[0].angular_velocity = state.base.angular_velocity;
    let (mut work, mut other) = (TreeWork::default(), Workspace::default());
    for k in 0..2000 {
        step(&arm, &mut state, (f64::from(k) * model.dt_s, model.dt_s), &GRAVITY, &[], &mut work);
        crate::step(&model, &Scene::empty(), &mut body, &mut other).unwrap();
    }
    let (a, b) = (state.base.world_from_base, body.bodies[0].world_from_body);
    assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-9, "{a} {b}");
}

/// The tumbling body of MuJoCo's conservation test: energy never grows however long the step is.
#[test]
fn a_tumbling_robot_gains_no_energy() {
    let arm = racket([0.1, 0.2, 0.25], Vector3::new(0.3, -0.1, 0.2), 1.0);
    let mut state = arm.at_rest(&[], 0.0).unwrap();
    state.base.angular_velocity = Vector3::new(1.0, 2.0, 3.0);
    state.base.velocity = -state.base.angular_velocity.cross(&Vector3::new(0.3, -0.1, 0.2));
    let mut work = TreeWork::default();
    let energy = |state: &ArticulationState<f64>| {
        let work = equations(&arm, state, 0.0).2;
        let l = &work.links[0];
        0.5 * l.angular_velocity.dot(&l.inertia.times(&l.angular_velocity))
    };
    let (first, l0) = (energy(&state), totals(&equations(&arm, &state, 0.0).2).1);
    let mut last = first;
    for k in 0..500 {
        step(&arm, &mut state, (f64::from(k) * 0.01, 0.01), &Vector3::zeros(), &[], &mut work);
        let now = energy(&state);
        assert!(now <= last * (1.0 + 1e-9), "{k}: {now} after {last}");
        last = now;
    }
    let l = totals(&equations(&arm, &state, 0.0).2).1;
    assert!(last > 0.7 * first && (l - l0).norm() < 0.05 * l0.norm(), "{last} of {first}, {} {}", l.norm(), l0.norm());
}

fn pendulum(base: Base<f64>) -> Articulation<f64> {
    let robot = mjcf(
        r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body name="rod"><joint name="swing"
        axis="0 1 0"/><inertial pos="0 0 -0.5" mass="2" diaginertia="1e-9 1e-9 1e-9"/></body></body>"#,
    );
    Articulation::new(robot, base).unwrap()
}

/// Period by the arithmetic-geometric mean: T = 2π √(l/g) / agm(1, cos(amplitude/2)); energy stays where it was.
#[test]
fn a_pendulum_has_its_period_and_keeps_its_energy() {
    let (l, g, amplitude) = (0.5, 9.81, 1.2_f64);
    let arm = pendulum(Base::Fixed(Pose::identity()));
    let (mut a, mut b) = (1.0, (0.5 * amplitude).cos());
    for _ in 0..6 {
        (a, b) = (0.5 * (a + b), f64::sqrt(a * b));
    }
    let period = std::f64::consts::TAU * f64::sqrt(l / g) / a;
    let mut state = arm.at_rest(&[amplitude], 0.0).unwrap();
    let (h, mut work) = (2e-4, TreeWork::default());
    let first = totals(&equations(&arm, &state, 0.0).2).2;
    let (mut crossings, mut worst): (Vec<f64>, f64) = (Vec::new(), 0.0);
    for k in 0..40_000 {
        let before = state.q[0];
        step(&arm, &mut state, (f64::from(k) * h, h), &GRAVITY, &[], &mut work);
        if before < 0.0 && state.q[0] >= 0.0 {
            crossings.push(h * (f64::from(k) + before / (before - state.q[0])));
        }
        worst = worst.max((totals(&equations(&arm, &state, 0.0).2).2 - first).abs());
    }
    let found = (crossings[crossings.len() - 1] - crossings[0]) / (crossings.len() - 1) as f64;
    assert!((found / period - 1.0).abs() < 1e-5, "{found} {period}");
    assert!(worst < 2e-3 * 2.0 * g * l * (1.0 - amplitude.cos()), "{worst}");
}

fn path_of(numbers: &mut Numbers) -> Path {
    let poses: Vec<_> = (0..6).map(|_| numbers.pose()).collect();
    Path::smooth(&[0.0, 0.3, 0.5, 1.1, 1.2, 2.0], &poses).unwrap()
}

#[test]
fn velocity_and_acceleration_of_a_path_are_its_derivatives() {
    let mut numbers = Numbers(10);
    for _ in 0..10 {
        let path = path_of(&mut numbers);
        for k in 1..200 {
            let t = 0.01 * f64::from(k) + 0.0037;
            let (a, b, now) = (path.at(t - 1e-5), path.at(t + 1e-5), path.at(t));
            let close = |x: Vector3<f64>, y: Vector3<f64>| (x - y).norm() < 1e-6 * (1.0 + y.norm());
            assert!(close((b.pose.translation.vector - a.pose.translation.vector) / 2e-5, now.velocity));
            assert!(close(mean_rate(&a.pose.rotation, &b.pose.rotation, 2e-5), now.angular_velocity), "{t}");
            assert!(close((b.velocity - a.velocity) / 2e-5, now.acceleration));
            assert!(close((b.angular_velocity - a.angular_velocity) / 2e-5, now.angular_acceleration), "{t}");
        }
    }
}

#[test]
fn a_path_passes_its_samples_smoothly_and_rests_at_its_ends() {
    let mut numbers = Numbers(11);
    let path = path_of(&mut numbers);
    for t in [0.0, 0.3, 0.5, 1.1, 1.2, 2.0] {
        let (a, b) = (path.at(t - 1e-9), path.at(t + 1e-9));
        assert!((a.pose.to_homogeneous() - b.pose.to_homogeneous()).amax() < 1e-7);
        assert!((a.velocity - b.velocity).norm() < 1e-6 && (a.angular_velocity - b.angular_velocity).norm() < 1e-6);
    }
    for t in [-1.0, 0.0, 2.0, 5.0] {
        assert_eq!((path.at(t).velocity, path.at(t).angular_velocity), (Vector3::zeros(), Vector3::zeros()));
    }
    // A lift between two rests: no faster than 1.5 times the mean, never past its ends.
    let poses = [0.0, 0.0, 0.2, 0.2].map(|z| Pose::translation(0.1, 0.0, z));
    let path = Path::smooth(&[0.0, 1.0, 2.0, 3.0], &poses).unwrap();
    for k in 0..300 {
        let t = 0.01 * f64::from(k);
        let (pose, v) = (path.at(t).pose, path.at(t).velocity);
        assert!((0.0..=0.2).contains(&pose.translation.z) && (0.0..=0.3 + 1e-12).contains(&v.z));
        assert!(t > 1.0 || pose.translation.z == 0.0);
    }
}

/// A pendulum whose pivot is moved sideways: θ'' = -(g sin θ + a cos θ) / l, integrated beside it.
#[test]
fn a_moving_base_swings_what_hangs_on_it() {
    let path =
        Path::smooth(&[0.1, 0.6, 0.9, 1.5], &[0.0, 0.3, 0.1, 0.4].map(|x| Pose::translation(x, 0.0, 0.2 * x))).unwrap();
    let arm = pendulum(Base::Path(path.clone()));
    let mut state = arm.at_rest(&[0.0], 0.0).unwrap();
    let (h, mut work, mut t) = (1e-4, TreeWork::default(), 0.0);
    // x(θ) = -l sin θ for an axis along y.
    let force = |t: f64, q: f64| {
        let a = path.at(t).acceleration;
        ((a.x) * q.cos() - (9.81 + a.z) * q.sin()) / 0.5
    };
    let (mut q, mut u) = (0.0, 0.0);
    for k in 0..20_000 {
        step(&arm, &mut state, (t, h), &GRAVITY, &[], &mut work);
        let (qm, um) = (q + 0.5 * h * u, u + 0.5 * h * force(t, q));
        (q, u) = (q + h * um, u + h * force(t + 0.5 * h, qm));
        t = f64::from(k + 1) * h;
        assert!((state.q[0] - q).abs() < 1e-3, "{t}: {} {q}", state.q[0]);
    }
    assert!(q.abs() + u.abs() > 0.1);
    let end = path.at(2.0).pose;
    assert!((state.base.world_from_base.to_homogeneous() - end.to_homogeneous()).amax() < 1e-12);
}

#[test]
fn bad_paths_are_refused_by_name() {
    let p = Pose::identity();
    let turned = Pose::rotation(Vector3::new(0.0, 0.0, std::f64::consts::PI));
    let message = |r: crate::Result<Path>| r.unwrap_err().to_string();
    assert!(message(Path::smooth(&[], &[])).contains("0 times"));
    assert!(message(Path::smooth(&[0.0, 1.0], &[p])).contains("2 times but 1 values"));
    assert!(message(Path::smooth(&[0.0, 0.0], &[p, p])).contains("time 1"));
    assert!(message(Path::smooth(&[0.0, f64::NAN], &[p, p])).contains("time 1"));
    assert!(message(Path::smooth(&[0.0, 1.0], &[p, Pose::translation(f64::NAN, 0.0, 0.0)])).contains("sample 1"));
    assert!(message(Path::smooth(&[0.0, 1.0], &[p, turned])).contains("half a turn"));
    let one = Path::smooth(&[3.0], &[p]).unwrap();
    assert_eq!(one.at(-1.0).pose, one.at(7.0).pose);
}
