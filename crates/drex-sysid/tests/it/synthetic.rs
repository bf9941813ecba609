//! Pushes simulated here, so that the truth is known and nothing but the estimator is tested.

use crate::common::{block, box_mesh, object_of, pushed_by, pushed_until, simulated};
use drex_core::{Pose, Trajectory};
use drex_recording::Drive;
use drex_sysid::{IdentifyOptions, Knowledge, Parameter, SysidError, Verdict, identify, identify_watched};
use nalgebra::{Point3, UnitQuaternion, Vector3};

const G: f64 = 9.81;

#[test]
fn lifted_slid_and_tipped_blocks_are_weighed() {
    let m = 0.137;
    let pushes = [
        simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin()),
        simulated(m, 0.4, Vector3::x() * m * G * 0.4 * 1.8, Point3::new(-0.025, 0.0, -0.03)),
        simulated(m, 0.9, Vector3::x() * m * G * (0.025 / 0.075) * 1.25, Point3::new(-0.025, 0.0, 0.035)),
    ];
    for push in pushes {
        let a = identify(std::slice::from_ref(&push), &block(), &IdentifyOptions::default()).unwrap();
        assert_eq!(a.verdict, Verdict::Identified, "{}", a.reason);
        let (found, ci) = (a.mass_kg.unwrap(), a.ci95_kg.unwrap());
        assert!((found / m - 1.0).abs() < 1e-3, "{found}");
        assert!(ci[0] < m && m < ci[1] && ci[1] / ci[0] < 1.05);
        assert_eq!(a.prior_kg, Some(1.0));
        assert_eq!(a.pushes[0].simulated.len(), push.track.len());
    }
}

/// The interval is the sum of its sources, none left out and none counted twice.
#[test]
fn sources_of_the_interval_add_up() {
    let m = 0.137;
    let push = simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin());
    let a = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
    let b = a.error_budget.unwrap();
    let parts = [b.poses, b.encoder, b.force, b.contact, b.stated, b.simulator];
    let sum = parts.iter().map(|x| x * x).sum::<f64>().sqrt();
    let half = 0.5 * (a.ci95_kg.unwrap()[1] / a.ci95_kg.unwrap()[0]).ln() / 1.96;
    assert!(b.poses > 0.0 && (sum / half - 1.0).abs() < 0.02, "{sum} {half} {b:?}");
}

/// The start is the frames at rest and the support, not a frame of the track.
#[test]
fn a_start_that_nobody_states_is_not_the_first_frame() {
    let m = 0.137;
    let lifted = simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin());
    let slid = simulated(m, 0.4, Vector3::x() * m * G * 0.4 * 1.8, Point3::new(-0.025, 0.0, -0.03));
    for mut push in [lifted, slid] {
        push.initial_pose = None;
        let mut poses = push.track.poses().to_vec();
        poses[0] = Pose::new(Vector3::new(0.004, 0.003, 0.008), Vector3::new(0.05, -0.06, 0.1)) * poses[0];
        push.track = Trajectory::from_samples(push.track.times_s(), &poses).unwrap();
        let a = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
        assert_eq!(a.verdict, Verdict::Identified, "{}", a.reason);
        let (found, ci) = (a.mass_kg.unwrap(), a.ci95_kg.unwrap());
        assert!((found / m - 1.0).abs() < 2e-3 && ci[0] < m && m < ci[1], "{found} {ci:?}");
    }
}

#[test]
fn a_torque_weighs_as_a_force_does() {
    let m = 0.137;
    // The same moment about the far edge as a force of 1.25 times what tips, and no force.
    let torque = Vector3::y() * m * G * 0.025 * 1.25;
    let mut push = pushed_by(&block(), 0.45, m, 0.9, [Vector3::zeros(), torque], Point3::origin());
    let a = identify(std::slice::from_ref(&push), &block(), &IdentifyOptions::default()).unwrap();
    assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 2e-3, "{} {:?}", a.reason, a.mass_kg);
    if let Drive::Force(f) = &mut push.drive {
        f.torques_nm.iter_mut().for_each(|t| *t *= 1.5);
    }
    let heavier = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
    assert!((heavier.mass_kg.unwrap() / (1.5 * m) - 1.0).abs() < 2e-3, "{:?}", heavier.mass_kg);
}

/// Lifted, the mass is proportional to the force: it is as uncertain as the gain of the sensor, and off by what the gain is off.
#[test]
fn an_uncertain_force_makes_the_mass_as_uncertain() {
    let m = 0.137;
    let push = simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin());
    for (mean, sd) in [(1.0, 0.02), (1.1, 0.08)] {
        let mut options = IdentifyOptions::default();
        options.parameters.set(Parameter::ForceGain, Knowledge::Prior { mean, sd }).unwrap();
        let a = identify(std::slice::from_ref(&push), &block(), &options).unwrap();
        assert!((a.mass_kg.unwrap() / (mean * m)).ln().abs() < 0.01, "{:?}", a.mass_kg);
        let ci = a.ci95_kg.unwrap();
        let found = (ci[1] / ci[0]).ln() / (2.0 * 1.96);
        assert!((found / sd - 1.0).abs() < 0.15, "sd {found} of the mass with {sd} of the force");
        assert!(!a.assumptions.iter().any(|s| s.contains("plays no part")), "{:?}", a.assumptions);
    }
}

#[test]
fn masses_beyond_the_first_scan_are_found() {
    for m in [0.008, 4.0] {
        let push = simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin());
        let a = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
        assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 5e-3, "{m}: {:?}", a.mass_kg);
    }
}

#[test]
fn a_steady_slide_with_unknown_friction_gives_the_product_and_a_coast_gives_both() {
    let (m, mu) = (0.2, 0.35);
    let push = simulated(m, mu, Vector3::x() * mu * m * G * 1.6, Point3::new(-0.025, 0.0, -0.03));
    let mut options = IdentifyOptions::default();
    options.parameters.set(Parameter::Friction, Knowledge::Free).unwrap();
    let both = identify(std::slice::from_ref(&push), &block(), &options).unwrap();
    assert_eq!(both.verdict, Verdict::Identified, "{}", both.reason);
    assert!((both.mass_kg.unwrap() / m - 1.0).abs() < 0.05 && (both.friction.unwrap() / mu - 1.0).abs() < 0.05);

    // A quasi-static slide: just above the limit, and the track ends before the coast.
    let mut slow = pushed_until(1.1, m, mu, Vector3::x() * mu * m * G * 1.04, Point3::new(-0.025, 0.0, -0.03));
    let keep = slow.track.times_s().iter().filter(|t| **t < 1.1).count();
    slow.track = Trajectory::from_samples(&slow.track.times_s()[..keep], &slow.track.poses()[..keep]).unwrap();
    let product = identify(&[slow], &block(), &options).unwrap();
    assert_eq!(product.verdict, Verdict::OnlyMuM, "{} {:?}", product.reason, product.mass_kg);
    assert!((product.mu_m_kg.unwrap() / (mu * m) - 1.0).abs() < 0.1);
    assert!(product.mass_kg.is_none() && product.ci95_kg.is_none());
}

#[test]
fn a_push_too_weak_to_move_anything_is_no_measurement() {
    let push = simulated(0.3, 0.5, Vector3::x() * 0.2, Point3::new(-0.025, 0.0, -0.03));
    // It does exclude light masses, which would have moved.
    let a = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
    assert_eq!(a.verdict, Verdict::NotIdentifiable, "{:?}", a.mass_kg);
    assert!(a.mass_kg.is_none() && a.ci95_kg.is_none());
}

#[test]
fn nothing_pushed_nothing_known() {
    let mut push = simulated(0.3, 0.5, Vector3::z() * 5.0, Point3::origin());
    push.drive = Drive::Nothing;
    push.starts_at_rest = false;
    let a = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
    assert_eq!(a.verdict, Verdict::NotIdentifiable);
    assert!(a.reason.contains("no known force acted on the object"), "{}", a.reason);
    // The profile was computed and is flat.
    assert_eq!(a.profile.len(), 7);
    assert!(a.profile.iter().all(|p| (p.1 - a.profile[0].1).abs() < 1e-6 * (1.0 + a.profile[0].1)));
}

#[test]
fn a_clock_offset_and_a_bias_do_not_spoil_the_mass() {
    let m = 0.2;
    let mut push = simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin());
    let moved: Vec<Pose> = push.track.poses().iter().map(|p| Pose::translation(0.0, 0.0, 0.006) * p).collect();
    let times: Vec<f64> = push.track.times_s().iter().map(|t| t + 0.03).collect();
    push.track = Trajectory::from_samples(&times, &moved).unwrap();
    let a = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
    assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 0.005, "{:?}", a.mass_kg);
    assert!((a.pushes[0].clock_offset_s.unwrap() - 0.03).abs() < 2e-3);
    assert!((a.pushes[0].position_bias_m.unwrap()[2] - 0.006).abs() < 1e-3);
}

#[test]
fn outliers_are_set_aside() {
    let m = 0.2;
    let mut push = simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin());
    let mut poses = push.track.poses().to_vec();
    poses[15] = Pose::new(Vector3::new(0.05, -0.04, 0.03), Vector3::new(0.4, 0.1, -0.3)) * poses[15];
    push.track = Trajectory::from_samples(push.track.times_s(), &poses).unwrap();
    let a = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
    assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 0.005, "{:?}", a.mass_kg);
    assert_eq!(a.pushes[0].outliers, 1);
}

#[test]
fn a_yaw_that_no_simulation_reproduces_does_not_hide_the_mass() {
    let m = 0.2;
    let still = simulated(m, 0.4, Vector3::z() * m * G * 1.6, Point3::origin());
    let mut turning = still.clone();
    let yaw = |t: f64| UnitQuaternion::from_scaled_axis(Vector3::z() * 0.1 * (3.0 * t).sin());
    let times = still.track.times_s();
    let poses: Vec<Pose> = times.iter().zip(still.track.poses()).map(|(t, p)| p * yaw(*t)).collect();
    turning.track = Trajectory::from_samples(times, &poses).unwrap();
    let of = |push| identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
    let (a, b) = (of(still), of(turning));
    assert_eq!(b.pushes[0].outliers, 0);
    // It is said, and of nothing else.
    assert!(!a.reason.contains("DOUBTFUL"), "{}", a.reason);
    assert!(b.reason.contains("DOUBTFUL") && b.reason.contains("rotations of `block`"), "{}", b.reason);
    assert!((b.mass_kg.unwrap() / m - 1.0).abs() < 5e-3, "{:?}", b.mass_kg);
    assert!(b.sd_log_mass.unwrap() < 1.5 * a.sd_log_mass.unwrap(), "{:?} {:?}", b.sd_log_mass, a.sd_log_mass);
}

/// A lift by a string that is tied to nothing; the poses are those of a lift all the same.
#[test]
fn a_force_that_acts_on_nothing_is_doubted() {
    let reason = |height_m: f64| {
        let push = simulated(0.2, 0.4, Vector3::z() * 0.2 * G * 1.6, Point3::new(0.0, 0.0, height_m));
        identify(&[push], &block(), &IdentifyOptions::default()).unwrap().reason
    };
    let doubted = reason(0.07);
    assert!(doubted.contains("DOUBTFUL") && doubted.contains("30 mm outside the mesh"), "{doubted}");
    let fine = reason(0.04);
    assert!(!fine.contains("DOUBTFUL"), "{fine}");
}

#[test]
fn progress_never_goes_back_and_ends() {
    let push = simulated(0.2, 0.4, Vector3::z() * 3.0, Point3::origin());
    let seen = std::sync::Mutex::new(Vec::new());
    identify_watched(&[push], &block(), &IdentifyOptions::default(), &|part| seen.lock().unwrap().push(part)).unwrap();
    let seen = seen.into_inner().unwrap();
    assert!(seen.len() > 3 && seen.windows(2).all(|w| w[0] <= w[1]) && seen.last() == Some(&1.0), "{seen:?}");
}

#[test]
fn the_answer_does_not_depend_on_threads() {
    let push = simulated(0.2, 0.9, Vector3::x() * 0.8, Point3::new(-0.025, 0.0, 0.035));
    let answers: Vec<_> = [1, 2]
        .iter()
        .map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(*threads).build().unwrap();
            let run = || identify(std::slice::from_ref(&push), &block(), &IdentifyOptions::default());
            let mut a = pool.install(run).unwrap();
            a.seconds = 0.0;
            serde_json::to_string(&a).unwrap()
        })
        .collect();
    assert_eq!(answers[0], answers[1]);
}

#[test]
fn json_has_the_agreed_keys() {
    let mut push = simulated(0.2, 0.4, Vector3::z() * 3.0, Point3::origin());
    push.drive = Drive::Nothing;
    let a = identify(&[push], &block(), &IdentifyOptions::default()).unwrap();
    let json = serde_json::to_value(&a).unwrap();
    assert_eq!(json["verdict"], "not_identifiable");
    assert!(json["mass_kg"].is_null() && json["ci95_kg"].is_null() && json["mu_m_kg"].is_null());
    assert!(json["reason"].is_string());
    assert!(a.seconds > 0.0 && json.get("seconds").is_none(), "a time would be another in every run");
}

#[test]
fn how_well_the_mesh_is_known_is_an_assumption() {
    let mut push = simulated(0.2, 0.4, Vector3::z() * 0.2 * G * 1.6, Point3::origin());
    for (sd, says) in [(None, "mesh_sd_m"), (Some(0.0), "exact, as stated"), (Some(0.002), "known to 2.0 mm")] {
        push.mesh_sd_m = sd;
        let a = identify(std::slice::from_ref(&push), &block(), &IdentifyOptions::default()).unwrap();
        let of_mesh: Vec<&String> = a.assumptions.iter().filter(|s| s.starts_with("the mesh is")).collect();
        assert!(of_mesh.len() == 1 && of_mesh[0].contains(says), "{sd:?}: {of_mesh:?}");
    }
}

#[test]
fn unusable_input_is_refused() {
    let push = simulated(0.2, 0.4, Vector3::z() * 3.0, Point3::origin());
    let options = IdentifyOptions::default();
    assert!(matches!(identify(&[], &block(), &options), Err(SysidError::NoRecording)));
    let mut short = push.clone();
    short.track = Trajectory::from_samples(&[0.0, 0.1], &[Pose::identity(); 2]).unwrap();
    assert!(matches!(identify(&[short], &block(), &options), Err(SysidError::TooFewPoses { poses: 2, .. })));
    for scan_kg in [[2.0, 0.02], [0.1, 0.1], [0.0, 1.0]] {
        let mut bad = IdentifyOptions::default();
        bad.scan_kg = scan_kg;
        assert!(matches!(
            identify(std::slice::from_ref(&push), &block(), &bad),
            Err(SysidError::Option { option: "scan_kg", .. })
        ));
    }
    // A mesh in millimetres: it would start deep inside the table.
    let huge = object_of(&box_mesh(Vector3::new(25.0, 30.0, 40.0), Vector3::zeros()));
    assert!(identify(&[push], &huge, &options).is_err());
}

#[test]
fn poses_tell_the_mass_once_the_object_moves_and_what_else_is_free_is_given() {
    let (m, mu) = (0.2, 0.35);
    let push = simulated(m, mu, Vector3::x() * mu * m * G * 1.6, Point3::new(-0.025, 0.0, -0.03));
    let mut options = IdentifyOptions::default();
    options.parameters.set(Parameter::Friction, Knowledge::Free).unwrap();
    let a = identify(&[push], &block(), &options).unwrap();
    let push = &a.pushes[0];
    assert_eq!(push.information.len(), push.times_s.len());
    // Nothing but poses was observed.
    let sum: f64 = push.information.iter().sum();
    assert!((sum - 1.0).abs() < 1e-9, "{sum}");
    let before = push.information.iter().zip(&push.times_s).filter(|(_, t)| **t < 0.3).map(|x| x.0).sum::<f64>();
    assert!(before < 0.3, "{before}");
    assert_eq!(a.estimates.len(), 1);
    let friction = &a.estimates[0];
    assert_eq!((friction.parameter, friction.push.as_deref()), (Parameter::Friction, None));
    assert!((friction.value - mu).abs() < 4.0 * friction.sd && friction.sd < 0.3 * mu, "{friction:?}");
}
