//! What is refused, and that nothing ends in numbers that are none.

use drex_diffsim::{Articulation, Base, Error, Scene, State, Workspace, rollout, step};
use drex_robot::Robot;
use proptest::prelude::*;

use super::*;

/// A block that is pushed over the table, by penalty forces in one substep of a millisecond.
fn single(scheme: Scheme, frequency_rad_s: f64, relaxation_s: f64) -> drex_diffsim::Result<Record<f64>> {
    let mut model = block(Vector3::new(0.02, 0.04, 0.03), 0.2, Method::Penalty { scheme, substeps: Some(1) });
    model.dt_s = 1e-3;
    model.contact.frequency_rad_s = frequency_rad_s;
    model.contact.relaxation_s = relaxation_s;
    model.contact.tangential_relaxation_s = relaxation_s;
    let mut scene = Scene::on_table(0.8);
    scene.forces.push(force(Vector3::new(0.4, 0.1, 0.0), 0.05, 0.25, Point3::new(-0.02, 0.01, 0.0)));
    rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.03)), &[0.1, 1.0])
}

#[test]
fn a_step_too_long_for_the_springs_is_refused() {
    // Damped oscillators: semi-implicit Euler needs h² ω² + 2 h ω² τ < 4 (rocking: up to three times as much), explicit
    // Euler h < τ and no more than that beside it.
    let stable = [(Scheme::SemiImplicit, 400.0, 1e-3), (Scheme::Explicit, 400.0, 2e-3)];
    for (scheme, frequency, tau) in stable {
        let end = place(&single(scheme, frequency, tau).unwrap(), 1);
        assert!((end.z - 0.03 + G / frequency.powi(2)).abs() < 2e-6, "{scheme:?}: {end}");
    }
    for frequency in [1.2e3, 3e3, 1e4, 1e6] {
        for (scheme, tau) in [(Scheme::SemiImplicit, 1e-3), (Scheme::SemiImplicit, 4e-3), (Scheme::Explicit, 4e-3)] {
            let end = single(scheme, frequency, tau);
            assert!(matches!(end, Err(Error::Stiff { .. })), "{scheme:?} at {frequency}, {tau}: {end:?}");
        }
    }
    // Explicit Euler grows slowly where it is not damped enough.
    assert!(matches!(single(Scheme::Explicit, 300.0, 1e-3), Err(Error::Stiff { .. })));
    assert!(matches!(single(Scheme::Explicit, 300.0, 0.0), Err(Error::Undamped)));
}

#[test]
fn chosen_substeps_are_enough_and_not_endless() {
    for scheme in [Scheme::SemiImplicit, Scheme::Explicit] {
        let run = |frequency: f64| {
            let mut model = block(Vector3::new(0.05, 0.05, 0.004), 0.05, Method::Penalty { scheme, substeps: None });
            model.contact.frequency_rad_s = frequency;
            let mut scene = Scene::on_table(0.8);
            scene.forces.push(force(Vector3::new(0.1, 0.1, 0.0), 0.05, 0.1, Point3::new(-0.05, 0.05, 0.0)));
            rollout(&model, &scene, &State::at_rest(at(0.0, 0.0, 0.004)), &[0.3])
        };
        for frequency in [300.0, 3e3, 1e4] {
            let z = place(&run(frequency).unwrap(), 0).z;
            let depth = 0.004 - z;
            assert!((depth * frequency.powi(2) / G - 1.0).abs() < 0.02, "{scheme:?} at {frequency}: {depth}");
        }
        let endless = run(1e7);
        assert!(matches!(endless, Err(Error::Stiff { substeps, .. }) if substeps > 1e4), "{endless:?}");
    }
}

#[test]
fn methods_without_robots_say_so() {
    let text = "<mujoco><worldbody><body><joint axis=\"0 0 1\"/>\
        <inertial pos=\"0.1 0 0\" mass=\"1\" diaginertia=\"0.01 0.01 0.01\"/></body></worldbody></mujoco>";
    let robot = Arc::new(Robot::from_mjcf_str(text, None).unwrap());
    for method in [PENALTY, EXPLICIT, POSITIONS] {
        let arm = Articulation::new(robot.clone(), Base::Fixed(Pose::identity())).unwrap();
        let rest = arm.at_rest(&[0.0], 0.0).unwrap();
        let mut model = Model::new(Vec::new()).with_articulation(arm);
        model.method = method;
        let mut state = State::new(Vec::new(), vec![rest]);
        assert_eq!(model.check(), Err(Error::Method));
        assert_eq!(step(&model, &Scene::empty(), &mut state, &mut Workspace::default()), Err(Error::Method));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn a_rollout_ends_in_numbers_or_in_an_error(
        which in 0_usize..3,
        substeps in 1_u32..6,
        exponents in (-4.0..-2.0_f64, 1.0..5.0_f64, -5.0..-1.0_f64, -2.0..3.0_f64),
        spin in -40.0..40.0_f64,
        friction in 0.0..1.5_f64,
        flat in 0.002..0.05_f64,
    ) {
        let (dt, frequency, tau, pull) = exponents;
        let scheme = if which == 0 { Scheme::SemiImplicit } else { Scheme::Explicit };
        let method = match which {
            2 => Method::PositionBased { substeps },
            _ => Method::Penalty { scheme, substeps: Some(substeps) },
        };
        let half = Vector3::new(0.03, 0.05, flat);
        let mut model = block(half, 0.1, method);
        model.dt_s = 10_f64.powf(dt);
        model.contact.frequency_rad_s = 10_f64.powf(frequency);
        model.contact.relaxation_s = 10_f64.powf(tau);
        model.contact.tangential_relaxation_s = 10_f64.powf(tau);
        let mut scene = Scene::on_table(friction);
        scene.forces.push(force(Vector3::new(1.0, 0.0, -0.5) * 10_f64.powf(pull), 0.01, 0.05, Point3::new(0.03, 0.0, 0.0)));
        let mut start = State::at_rest(at(0.0, 0.0, flat));
        start.bodies[0].angular_velocity = Vector3::new(0.3 * spin, spin, 0.0);
        match rollout(&model, &scene, &start, &[0.02, 0.1]) {
            Ok(r) => prop_assert!(r.bodies[0].poses.iter().all(|p| p.to_homogeneous().iter().all(|x| x.is_finite()))),
            Err(e) => prop_assert!(matches!(e, Error::Stiff { .. } | Error::Diverged { .. }), "{}", e),
        }
    }
}
