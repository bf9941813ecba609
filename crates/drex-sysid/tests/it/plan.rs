//! The planner: what it promises is what the estimator then does.

use crate::common::{block, box_mesh, object_of};
use drex_core::Object;
use drex_recording::{Drive, Support, SupportBox};
use drex_sysid::plan::{
    FingerLimits, ForceLimits, PlanOptions, PlannedPush, PushDrive, PushKind, RobotLimits, plan_push, tip_force_limit,
};
use drex_sysid::{IdentifyOptions, SysidError, Verdict, identify};
use nalgebra::Vector3;
use rayon::prelude::*;

fn force() -> ForceLimits {
    ForceLimits { max_n: 10.0, noise_n: 0.02, lifts: true }
}

fn finger(kp_n_m: f64) -> FingerLimits {
    FingerLimits {
        // What a stiff drive needs to move its own inertia is no matter here.
        max_n: if kp_n_m > 1e5 { 1e9 } else { 8.0 },
        max_speed_m_s: 0.3,
        stroke_m: 0.12,
        radius_m: 0.01,
        mass_kg: 0.04,
        armature_kg: if kp_n_m > 1e5 { 200.0 } else { 0.02 },
        damping_ns_m: 0.5,
        kp_n_m,
        kv_ns_m: if kp_n_m > 1e5 { 4e4 } else { 2.5 },
        friction: 0.6,
        encoder_m: Some(1e-4),
    }
}

fn robot(force: Option<ForceLimits>, finger: Option<FingerLimits>) -> RobotLimits {
    RobotLimits { reaction_s: 0.03, force, finger }
}

fn rough() -> Support {
    Support { friction: None, ..Support::default() }
}

fn plan(robot: &RobotLimits, support: &Support, masses: [f64; 2], count: usize) -> Vec<PlannedPush> {
    let mut options = PlanOptions::default();
    options.masses = count;
    options.friction = 0.5;
    plan_push(&block(), support, robot, masses, &options, |_, _| {}).unwrap()
}

/// The estimates of a hidden mass from a push done with noise, once per seed: how many, and the scatter of their logarithms.
fn repeated(push: &PlannedPush, robot: &RobotLimits, support: &Support, mass_kg: f64, seeds: u64) -> (usize, f64) {
    let mut options = PlanOptions::default();
    options.friction = 0.5;
    let errors: Vec<f64> = (0..seeds)
        .into_par_iter()
        .filter_map(|seed| {
            let done = push.push.rehearse(&block(), support, robot, &options, mass_kg, seed).unwrap();
            let found = identify(&[done], &block(), &IdentifyOptions::default()).unwrap();
            found.mass_kg.map(|m| (m / mass_kg).ln())
        })
        .collect();
    let square = errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64;
    (errors.len(), square.sqrt())
}

#[test]
fn the_scatter_of_the_recommended_push_is_the_promised_one() {
    let robot = robot(Some(force()), None);
    let m = 0.17;
    let pushes = plan(&robot, &rough(), [m; 2], 1);
    let best = &pushes[0];
    let promised = best.outcomes[0].sd_noise.unwrap();
    let (count, scatter) = repeated(best, &robot, &rough(), m, 12);
    assert_eq!(count, 12, "{}", best.text);
    // Of 12 numbers the root mean square is known to 20 %.
    assert!((promised / 1.5..promised * 1.5).contains(&scatter), "{}: {promised} promised, {scatter} found", best.text);
}

#[test]
fn lift_and_tilt_come_before_slide_when_friction_is_unknown_and_a_rigid_finger_comes_last() {
    let robot = robot(Some(force()), Some(finger(2e6)));
    let m = 0.17;
    let pushes = plan(&robot, &rough(), [m; 2], 1);
    let place =
        |test: &dyn Fn(&PlannedPush) -> bool| pushes.iter().position(|p| p.refused.is_none() && test(p)).unwrap();
    let of = |kind: PushKind| place(&|p| p.push.kind == kind && p.push.drive == PushDrive::Force);
    let (lift, tilt, slide) = (of(PushKind::Lift), of(PushKind::Tilt), of(PushKind::Slide));
    let rigid = place(&|p| p.push.drive == PushDrive::Finger);
    assert!(lift < slide && tilt < slide && slide < rigid, "{lift} {tilt} {slide} {rigid}");
    for p in pushes.iter().filter(|p| p.push.drive == PushDrive::Finger && p.refused.is_none()) {
        assert_eq!(p.verdict, Verdict::NotIdentifiable, "{}", p.text);
    }
    // What was measured agrees with the order.
    let scatter = |k: usize| repeated(&pushes[k], &robot, &rough(), m, 6);
    let (lifted, slid) = (scatter(lift), scatter(slide));
    assert!(lifted.0 == 6 && (slid.0 < 6 || slid.1 > lifted.1), "{lifted:?} {slid:?}");
    assert_eq!(repeated(&pushes[rigid], &robot, &rough(), m, 2).0, 0);
}

#[test]
fn a_push_by_a_known_force_scales_with_the_mass() {
    let robot = robot(Some(force()), None);
    let over = plan(&robot, &rough(), [0.05, 0.2], 2);
    for kind in [PushKind::Lift, PushKind::Tilt, PushKind::Slide] {
        let p = over.iter().find(|p| p.push.kind == kind && p.refused.is_none()).unwrap();
        let (light, heavy) = (&p.outcomes[0], &p.outcomes[1]);
        assert!((heavy.peak_force_n / light.peak_force_n - 4.0).abs() < 1e-9);
        let words = match kind {
            PushKind::Lift => "lift at the centre of mass with a force that doubles every",
            PushKind::Slide => "slide ",
            _ => "tilt about the far edge ",
        };
        let peaks = format!("({:.2} N at 50 g to {:.2} N at 200 g)", light.peak_force_n, heavy.peak_force_n);
        assert!(p.text.starts_with(words) && p.text.contains(&peaks), "{}", p.text);
        // The same push done with the heavy mass indeed has this peak, up to a sample of the force.
        let mut options = PlanOptions::default();
        options.friction = 0.5;
        let quiet = RobotLimits { force: Some(ForceLimits { noise_n: 0.0, ..force() }), ..robot.clone() };
        let done = p.push.rehearse(&block(), &rough(), &quiet, &options, heavy.mass_kg, 0).unwrap();
        let Drive::Force(profile) = &done.drive else { panic!("no force") };
        let peak = profile.forces_n.iter().map(Vector3::norm).fold(0.0, f64::max);
        assert!((peak / heavy.peak_force_n - 1.0).abs() < 0.06, "{}: {peak} {}", p.text, heavy.peak_force_n);
    }
}

#[test]
fn limits_are_kept_and_named() {
    // Weight of 0.5 kg: 4.9 N.
    let weak = robot(Some(ForceLimits { max_n: 3.0, ..force() }), None);
    let pushes = plan(&weak, &rough(), [0.05, 0.5], 2);
    let lift = pushes.iter().find(|p| p.push.kind == PushKind::Lift).unwrap();
    assert!(lift.outcomes[0].refused.is_none());
    assert!(lift.outcomes[1].refused.as_ref().unwrap().contains("3.00 N"), "{:?}", lift.outcomes[1]);
    assert!(pushes.iter().flat_map(|p| &p.outcomes).all(|o| o.refused.is_some() || o.peak_force_n <= 3.0));
    // On ice nothing tips.
    let ice = Support { friction: Some(0.05), ..Support::default() };
    for p in plan(&weak, &ice, [0.1; 2], 1).iter().filter(|p| p.push.kind == PushKind::Tilt) {
        assert!(p.refused.as_ref().unwrap().contains("slides"), "{}", p.text);
    }
    // Nothing leans farther than allowed.
    let safe = pushes.iter().flat_map(|p| &p.outcomes).filter(|o| o.refused.is_none());
    assert!(safe.map(|o| o.tilt_deg).fold(0.0, f64::max) <= 20.1);
}

#[test]
fn an_overhang_is_used_where_there_is_a_step() {
    let step = SupportBox { center_m: [0.0, 0.0, 0.03], half_m: [0.15, 0.2, 0.03] };
    let support = Support { boxes: vec![step], ..Support::default() };
    let pushes = plan(&robot(Some(force()), None), &support, [0.2; 2], 1);
    let press = pushes.iter().find(|p| p.push.kind == PushKind::OverhangPress).unwrap();
    assert_eq!(press.refused, None, "{}", press.text);
    assert_eq!(press.verdict, Verdict::Identified);
    // The centre of mass stays behind the edge.
    let [x, y, z] = press.push.start.position_m;
    assert!((x.abs() < 0.15 && y.abs() < 0.2) && (z - 0.1).abs() < 1e-3, "{x} {y} {z}");
    let beyond = (x.abs() + 0.025 - 0.15).max(y.abs() + 0.03 - 0.2);
    assert!(beyond > 0.01, "{beyond}");
}

/// The residuals of poses and encoder are their noise, and the commands are those of the plan.
#[test]
fn a_simulated_push_of_a_fingertip_leaves_the_noise_of_its_encoder() {
    let limits = robot(None, Some(finger(150.0)));
    let m = 0.17;
    let pushes = plan(&limits, &rough(), [m; 2], 1);
    let push = pushes.iter().find(|p| p.refused.is_none() && p.push.kind == PushKind::Tilt).unwrap();
    let mut options = PlanOptions::default();
    options.friction = 0.5;
    let done = push.push.rehearse(&block(), &rough(), &limits, &options, m, 3).unwrap();
    let Drive::Finger(finger) = &done.drive else { panic!("no fingertip") };
    let speed = push.push.speed_m_s.unwrap();
    let steps = finger.commands.windows(2).zip(finger.command_times_s.windows(2));
    let speeds: Vec<f64> = steps.map(|(c, t)| (c[1] - c[0]).norm() / (t[1] - t[0])).collect();
    assert!(speeds[0] == 0.0, "it rests before it pushes");
    let whole = speeds.iter().filter(|v| (*v / speed - 1.0).abs() < 1e-6).count();
    assert!(whole > 10, "{whole} of {} steps at {speed} m/s", speeds.len());
    // Once it leans far enough, the tip stays for a while and goes back half as fast again.
    let back = speeds.iter().position(|v| (v / (1.5 * speed) - 1.0).abs() < 1e-6).unwrap();
    let stays = speeds[..back].iter().rev().skip(1).take_while(|v| **v == 0.0).count();
    assert!(stays > 3, "{stays} steps before it goes back");
    let found = identify(std::slice::from_ref(&done), &block(), &IdentifyOptions::default()).unwrap();
    let (rms, noise) = (found.pushes[0].rms_position_m.unwrap(), done.noise.unwrap().position_m);
    assert!(
        (0.5..2.0).contains(&(rms / (3.0_f64.sqrt() * noise))),
        "{rms} m of poses with {noise} m in each direction"
    );
    let rms = found.pushes[0].rms_encoder_m.unwrap();
    assert!((0.5e-4..2e-4).contains(&rms), "{rms} m of an encoder with 1e-4 m");
}

#[test]
fn the_plan_does_not_depend_on_threads() {
    let robot = robot(Some(force()), Some(finger(150.0)));
    let plans: Vec<String> = [1, 2]
        .iter()
        .map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(*threads).build().unwrap();
            serde_json::to_string(&pool.install(|| plan(&robot, &rough(), [0.2; 2], 1))).unwrap()
        })
        .collect();
    assert_eq!(plans[0], plans[1]);
}

#[test]
fn nonsense_is_refused() {
    let options = PlanOptions::default();
    let plan = |object: &Object, robot: &RobotLimits, masses| {
        plan_push(object, &rough(), robot, masses, &options, |_, _| {}).unwrap_err()
    };
    let good = robot(Some(force()), None);
    assert!(matches!(plan(&block(), &robot(None, None), [0.1, 0.2]), SysidError::Option { option: "robot", .. }));
    assert!(matches!(plan(&block(), &good, [0.2, 0.1]), SysidError::Option { option: "masses_kg", .. }));
    let soft = robot(None, Some(finger(-1.0)));
    assert!(plan(&block(), &soft, [0.1, 0.2]).to_string().contains("kp_n_m"));
    // A block whose centre of mass is beside its base.
    let mut lopsided = object_of(&box_mesh(Vector3::new(0.02, 0.02, 0.02), Vector3::zeros()));
    lopsided.mass_properties.center_of_mass.x = 0.05;
    assert!(plan(&lopsided, &good, [0.1, 0.2]).to_string().contains("does not stand"));
}

#[test]
fn torque_limits_bound_the_force_of_a_fingertip() {
    let hand = drex_robot::Robot::bundled("allegro_right").unwrap();
    let limit = tip_force_limit(&hand, &hand.mid_range()).unwrap().unwrap();
    // Joints of some tenths of a newton metre, fingers of a decimetre: newtons.
    assert!((0.5..20.0).contains(&limit), "{limit}");
    assert!(tip_force_limit(&hand, &[0.0]).is_err());
}
