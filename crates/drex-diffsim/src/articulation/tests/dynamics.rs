//! Mass matrix, bias, Jacobian.

use super::*;
use crate::{Dual, parameter, tangents};

fn robots() -> Vec<Arc<Robot>> {
    vec![
        Arc::new(Robot::bundled("leap_right").unwrap()),
        Arc::new(Robot::bundled("allegro_right").unwrap()),
        everything(),
    ]
}

/// `drex_robot` computes both with spatial vectors about the base; here points and moments are used.
#[test]
fn mass_matrix_and_bias_are_those_of_the_robot_crate() {
    let mut numbers = Numbers(1);
    for robot in robots() {
        for _ in 0..20 {
            let pose = numbers.pose();
            let arm = fixed(robot.clone(), pose);
            let state = random_state(&arm, &mut numbers, 5.0);
            let (m, b, work) = equations(&arm, &state, 0.0);
            let n = arm.dof();
            let gravity = pose.rotation.inverse() * GRAVITY;
            let reference = robot.mass_matrix(&state.q);
            assert!((DMatrix::from_row_slice(n, n, &m) - &reference).amax() < 1e-9);
            assert!((DVector::from_vec(b) - robot.bias_force(&state.q, &state.velocities, &gravity)).amax() < 1e-9);
            let mut rest = state.clone();
            rest.velocities.fill(0.0);
            let (_, b, _) = equations(&arm, &rest, 0.0);
            assert!((DVector::from_vec(b) - robot.gravity_torque(&state.q, &gravity)).amax() < 1e-9);
            for (pose, link) in robot.forward_kinematics(&state.q, &pose).iter().zip(&work.links) {
                assert!((pose.to_homogeneous() - link.world_from_link.to_homogeneous()).amax() < 1e-12);
            }
            // Joints of different branches do not see each other at all.
            for i in 0..n {
                for j in 0..n {
                    let (a, b) = (robot.joints[i].link, robot.joints[j].link);
                    let related = robot.path_to(a).contains(&b) || robot.path_to(b).contains(&a);
                    assert!(related || m[i * n + j] == 0.0, "{i} {j}");
                }
            }
        }
    }
}

/// The state with its generalised position moved by `x` along velocity number `k`.
fn moved(arm: &Articulation<f64>, state: &ArticulationState<f64>, k: usize, x: f64) -> ArticulationState<f64> {
    let mut out = state.clone();
    let axis = Vector3::ith(k % 3, x);
    let pose = &mut out.base.world_from_base;
    match (arm.base_dof(), k) {
        (6, 0..3) => pose.translation.vector += axis,
        (6, 3..6) => pose.rotation = UnitQuaternion::from_scaled_axis(axis) * pose.rotation,
        (base, k) => out.q[k - base] += x,
    }
    out
}

#[test]
fn columns_are_the_derivatives_of_the_poses() {
    let mut numbers = Numbers(2);
    let pose = numbers.pose();
    for robot in robots() {
        for base in [Base::Fixed(pose), Base::Free] {
            let arm = Articulation::new(robot.clone(), base).unwrap();
            let state = random_state(&arm, &mut numbers, 2.0);
            let (_, _, work) = equations(&arm, &state, 0.0);
            let at = |k: usize, x: f64| equations(&arm, &moved(&arm, &state, k, x), 0.0).2;
            let mut u = Vec::new();
            arm.velocity(&state, &mut u);
            for link in 0..robot.links.len() {
                let local = nalgebra::Point3::from(numbers.vector(0.1));
                let point = (work.links[link].world_from_link * local).coords;
                let mut columns = Vec::new();
                arm.columns(&work, link, &point, &mut columns);
                let (mut v, mut w) = arm.prescribed_velocity(&work, &point);
                for k in 0..arm.dof() {
                    let (a, b) = (at(k, -1e-6), at(k, 1e-6));
                    let (a, b) = (a.links[link].world_from_link, b.links[link].world_from_link);
                    let linear = (b * local - a * local) / 2e-6;
                    let angular = (b.rotation * a.rotation.inverse()).scaled_axis() / 2e-6;
                    let found: Vec<_> = columns.iter().filter(|c| c.dof == k).collect();
                    assert!(found.len() <= 1);
                    let (fl, fa) = found.first().map_or_else(Default::default, |c| (c.linear, c.angular));
                    assert!((fl - linear).amax() < 1e-8 && (fa - angular).amax() < 1e-8, "link {link}, dof {k}");
                    v += fl * u[k];
                    w += fa * u[k];
                }
                let moving = &work.links[link];
                let arm = point - moving.world_from_link.translation.vector;
                assert!((v - moving.velocity - moving.angular_velocity.cross(&arm)).amax() < 1e-12);
                assert!((w - moving.angular_velocity).amax() < 1e-12);
            }
        }
    }
}

/// A double pendulum in a plane: Spong, *Robot Modeling and Control*, equations of the two-link arm, angles from below.
#[test]
fn the_double_pendulum_has_its_closed_form() {
    let [m1, m2, l1, c1, c2, i1, i2, g] = [1.3, 0.8, 0.5, 0.22, 0.3, 0.03, 0.02, 9.81];
    let robot = mjcf(&format!(
        r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body name="a" pos="0 0 1">
        <joint name="shoulder" axis="0 1 0"/><inertial pos="0 0 -{c1}" mass="{m1}" diaginertia="0.1 {i1} 0.1"/>
        <body name="b" pos="0 0 -{l1}"><joint name="elbow" axis="0 1 0"/>
        <inertial pos="0 0 -{c2}" mass="{m2}" diaginertia="0.1 {i2} 0.1"/></body></body></body>"#
    ));
    let arm = fixed(robot, Pose::identity());
    let mut numbers = Numbers(3);
    for _ in 0..20 {
        let state = random_state(&arm, &mut numbers, 4.0);
        let (m, b, work) = equations(&arm, &state, 0.0);
        let ([q1, q2], [u1, u2]) = ([state.q[0], state.q[1]], [state.velocities[0], state.velocities[1]]);
        let k = m2 * l1 * c2;
        let m22 = i2 + m2 * c2 * c2;
        let m12 = m22 + k * q2.cos();
        let m11 = i1 + m1 * c1 * c1 + m2 * l1 * l1 + m22 + 2.0 * k * q2.cos();
        let gravity2 = m2 * g * c2 * (q1 + q2).sin();
        let b1 = -k * q2.sin() * (2.0 * u1 * u2 + u2 * u2) + (m1 * c1 + m2 * l1) * g * q1.sin() + gravity2;
        let b2 = k * q2.sin() * u1 * u1 + gravity2;
        for (x, y) in [(m[0], m11), (m[1], m12), (m[2], m12), (m[3], m22), (b[0], b1), (b[1], b2)] {
            assert!((x - y).abs() < 1e-12, "{x} {y}");
        }
        let kinetic = 0.5 * (m11 * u1 * u1 + 2.0 * m12 * u1 * u2 + m22 * u2 * u2);
        let height = 1.0 - c1 * q1.cos();
        let height2 = 1.0 - l1 * q1.cos() - c2 * (q1 + q2).cos();
        assert!((totals(&work).2 - kinetic - g * (m1 * height + m2 * height2)).abs() < 1e-11);
    }
}

/// Forces on links do the work that the columns say.
#[test]
fn external_forces_enter_by_the_transposed_jacobian() {
    let mut numbers = Numbers(4);
    for base in [Base::Fixed(numbers.pose()), Base::Free] {
        let arm = Articulation::new(everything(), base).unwrap();
        let state = random_state(&arm, &mut numbers, 3.0);
        let (_, plain, mut work) = equations(&arm, &state, 0.0);
        let forces: Vec<_> = [1, 4, 5]
            .map(|link| LinkForce {
                link,
                point: numbers.vector(1.0),
                force: numbers.vector(3.0),
                moment: numbers.vector(0.5),
            })
            .into();
        let mut b = vec![0.0; arm.dof()];
        arm.bias(&mut work, &GRAVITY, &forces, &mut b);
        for f in &forces {
            let mut columns = Vec::new();
            arm.columns(&work, f.link, &f.point, &mut columns);
            columns.iter().for_each(|c| b[c.dof] += c.linear.dot(&f.force) + c.angular.dot(&f.moment));
        }
        assert!(b.iter().zip(&plain).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}

/// A tree whose numbers depend on eight parameters: masses, inertia, armature, base, state.
fn parametric<T: Scalar>(p: &[T; 8], free: bool) -> (Vec<T>, Vec<T>) {
    let arm = fixed(everything(), Pose::translation(0.3, -0.2, 0.1));
    let mut arm: Articulation<T> = arm.lift();
    arm.links[1].mass_kg *= p[0];
    arm.links[4].center_of_mass.x += p[1];
    arm.links[3].inertia *= p[2];
    arm.joints[0].armature += p[3];
    if free {
        arm.base = Base::Free;
    } else if let Base::Fixed(pose) = &mut arm.base {
        pose.rotation = crate::math::exp(&Vector3::new(p[4], p[5], T::zero()));
    }
    let n = arm.joints.len();
    let mut state = arm.at_rest(&(0..n).map(|i| T::lift(0.3 * i as f64 - 0.5)).collect::<Vec<_>>(), 0.0).unwrap();
    state.q[1] += p[6];
    state.velocities = (0..n).map(|i| T::lift(1.5 - 0.7 * i as f64)).collect();
    state.velocities[2] += p[7];
    if free {
        state.base.world_from_base.rotation = crate::math::exp(&Vector3::new(p[4], T::lift(0.4), T::zero()));
        state.base.angular_velocity = Vector3::new(T::one(), T::lift(-2.0), p[5]);
    }
    let (m, mut b, mut work) = equations(&arm, &state, 0.0);
    if free {
        // The bias of a step goes through a solve of its own.
        arm.step_bias(&mut work, &GRAVITY.map(T::lift), &[], (&m, 5e-3), &mut b);
    }
    (m, b)
}

#[test]
fn derivatives_by_masses_and_state_are_those_of_finite_differences() {
    let p0 = [1.1, 0.01, 0.9, 0.002, 0.3, 0.2, -0.4, 0.5];
    // Armature is small: its step too.
    let steps: [f64; 8] = std::array::from_fn(|i| if i == 3 { 1e-6 } else { 1e-5 });
    for free in [false, true] {
        let (m, b) = parametric::<Dual<8>>(&std::array::from_fn(|i| parameter(p0[i], i)), free);
        for i in 0..8 {
            let at = |x: f64| {
                let mut p = p0;
                p[i] += x;
                parametric(&p, free)
            };
            let ((m0, b0), (m1, b1)) = (at(-steps[i]), at(steps[i]));
            let pairs = m.iter().zip(m0.iter().zip(&m1)).chain(b.iter().zip(b0.iter().zip(&b1)));
            for (dual, (a, b)) in pairs {
                let (found, reference) = (tangents(dual)[i], (b - a) / (2.0 * steps[i]));
                assert!((found - reference).abs() < 1e-7 * (1.0 + reference.abs()), "{i}: {found} {reference}");
            }
        }
    }
}

/// A base on a path is a free base whose acceleration somebody chose.
#[test]
fn a_prescribed_acceleration_acts_as_the_same_free_one() {
    let mut numbers = Numbers(5);
    let poses: Vec<_> = (0..4).map(|_| numbers.pose()).collect();
    let path = Path::smooth(&[0.0, 0.3, 0.7, 1.0], &poses).unwrap();
    for t in [0.1, 0.35, 0.6, 0.95] {
        let at = path.at(t);
        let arm = Articulation::new(everything(), Base::Path(path.clone())).unwrap();
        let mut state = random_state(&arm, &mut numbers, 3.0);
        let (_, bias, _) = equations(&arm, &state, t);
        let free = Articulation::new(everything(), Base::Free).unwrap();
        state.base = arm.prescribed_base(t);
        let (m, b, _) = equations(&free, &state, t);
        let n = free.dof();
        for j in 0..arm.dof() {
            let row = &m[(6 + j) * n..(6 + j) * n + 6];
            let base = (0..3).map(|k| row[k] * at.acceleration[k] + row[3 + k] * at.angular_acceleration[k]);
            let expected = b[6 + j] + base.sum::<f64>();
            assert!((bias[j] - expected).abs() < 1e-10 * (1.0 + expected.abs()), "{} {expected}", bias[j]);
        }
    }
}

#[test]
#[allow(clippy::print_stdout)] // what it is for
#[ignore = "timing; run with --release --ignored --nocapture"]
fn timing() {
    fn run<T: Scalar>(name: &str, base: Base<f64>) {
        let arm = Articulation::new(Arc::new(Robot::bundled("leap_right").unwrap()), base).unwrap();
        let state = random_state(&arm, &mut Numbers(6), 1.0);
        let arm: Articulation<T> = arm.lift();
        let lifted = |v: &[f64]| v.iter().map(|x| T::lift(*x)).collect::<Vec<_>>();
        let mut s = arm.at_rest(&lifted(&state.q), 0.0).unwrap();
        s.velocities = lifted(&state.velocities);
        let n = arm.dof();
        let (mut m, mut b, mut work) = (vec![T::zero(); n * n], vec![T::zero(); n], TreeWork::default());
        let (mut joint_forces, control) = (Vec::new(), vec![0.3; arm.actuators.len()]);
        let gravity = GRAVITY.map(T::lift);
        let mut times = [f64::INFINITY; 5];
        for _ in 0..200 {
            for (k, best) in times.iter_mut().enumerate() {
                let clock = std::time::Instant::now();
                for _ in 0..100 {
                    match k {
                        0 => arm.kinematics(&s, 0.0, 5e-4, &mut work),
                        1 => arm.mass_matrix(&work, &mut m),
                        2 => arm.bias(&mut work, &gravity, &[], &mut b),
                        3 => arm.joint_forces(&s, &work, &control, 5e-4, &mut joint_forces),
                        _ => arm.step_bias(&mut work, &gravity, &[], (&m, 5e-4), &mut b),
                    }
                    std::hint::black_box((&mut work, &mut m, &mut b, &mut joint_forces));
                }
                *best = best.min(clock.elapsed().as_secs_f64() * 1e4);
            }
        }
        let [k, m, b, l, s] = times;
        println!(
            "{name}: kinematics {k:.2}, mass matrix {m:.2}, bias {b:.2}: {:.2} us; joint forces {l:.2}, step bias {s:.2}",
            k + m + b
        );
    }
    run::<f64>("LEAP fixed, f64", Base::Fixed(Pose::identity()));
    run::<Dual<4>>("LEAP fixed, Dual<4>", Base::Fixed(Pose::identity()));
    run::<f64>("LEAP free, f64", Base::Free);
    run::<Dual<4>>("LEAP free, Dual<4>", Base::Free);
}
