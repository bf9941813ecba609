//! The protocol on a box: what holds, what slips, and every way to fail.
#![allow(clippy::unwrap_used)] // a test says what fails by failing

mod support;

use drex_core::Pose;
use drex_grasp::Grasp;
use drex_trial::{
    Assumed, Command, Engine, Evaluator as _, GripForce, Mismatch, NoCommand, Outcome, Trial, TrialEvaluator,
    TrialOptions, Truth, Verdict,
};
use rayon::prelude::*;
use support::{grasps, trial_of};

const ASSUMED: Assumed = Assumed { mass_kg: 0.15, friction: 0.5 };

#[test]
fn the_needed_grip_force_holds_and_a_third_of_it_does_not() {
    let trial = trial_of(|_, _| {});
    let found = grasps();
    assert!(found.len() >= 8, "{} grasps", found.len());
    let outcomes: Vec<_> = found[..8]
        .par_iter()
        .map(|g| {
            let command = trial.command(g, &ASSUMED, GripForce::Required).unwrap().unwrap();
            let enough = trial.run(&command, &Truth::as_assumed(&ASSUMED, 1), Engine::Diffsim).unwrap();
            let third = GripForce::Total(command.grip_force_n / 3.0);
            let little = trial.command(g, &ASSUMED, third).unwrap().unwrap();
            assert!((little.grip_force_n - command.grip_force_n / 3.0).abs() < 1e-3 * command.grip_force_n);
            let too_little = trial.run(&little, &Truth::as_assumed(&ASSUMED, 1), Engine::Diffsim).unwrap();
            // Whoever asks only whether it holds gets the same answer.
            let tried = trial.run_until_failure(&little, &Truth::as_assumed(&ASSUMED, 1), Engine::Diffsim).unwrap();
            assert_eq!((tried.verdict, tried.failed_at_s), (too_little.verdict, too_little.failed_at_s));
            (enough, too_little)
        })
        .collect();
    for (enough, too_little) in &outcomes {
        eprintln!("{:?} {:?}", enough, too_little.verdict);
    }
    let held = outcomes.iter().filter(|o| o.0.succeeded()).count();
    let slipped = outcomes.iter().filter(|o| !o.1.succeeded()).count();
    assert!(held >= 7 && slipped >= 7, "{held} of 8 held with the needed grip force, {slipped} slipped with a third");
    for (enough, _) in outcomes.iter().filter(|o| o.0.succeeded()) {
        assert!(enough.retained > 0.99 && enough.slip_m < 0.005 && enough.failed_at_s.is_none());
        let used = enough.friction_used.unwrap();
        assert!(used > 0.2 && used < 1.0, "{used}");
    }
    // What is delivered is what was commanded, but for the friction of the joints.
    let mut ratios: Vec<f64> = outcomes.iter().filter_map(|(o, _)| Some(o.held_n? / o.grip_force_n)).collect();
    ratios.sort_by(f64::total_cmp);
    eprintln!("delivered over commanded: {ratios:.2?}");
    assert!((0.8..1.25).contains(&ratios[ratios.len() / 2]), "{ratios:?}");
}

#[test]
fn a_small_grip_force_is_not_what_the_closing_left() {
    // Rough enough for a third of the grip force to hold, so that what is delivered can be seen.
    let trial = trial_of(|_, _| {});
    let rough = Truth { friction: 1.2, ..Truth::as_assumed(&ASSUMED, 1) };
    let mut ratios: Vec<f64> = grasps()
        .par_iter()
        .filter_map(|g| {
            let needed = trial.command(g, &ASSUMED, GripForce::Required).unwrap().unwrap();
            let third = GripForce::Total(needed.grip_force_n / 3.0);
            let little = trial.command(g, &ASSUMED, third).unwrap().unwrap();
            Some(trial.run(&little, &rough, Engine::Diffsim).unwrap().held_n? / little.grip_force_n)
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    // Of one in ten the closing leaves half as much again; the middle and the upper quarter say what is done about it.
    assert!(ratios.len() >= 16, "{ratios:?}");
    assert!(ratios[ratios.len() / 2] < 1.25 && ratios[3 * ratios.len() / 4] < 1.4, "{ratios:?}");
}

/// The first of the grasps that holds.
fn holding(trial: &Trial, truth: &Truth) -> (Command, Outcome) {
    let tried = |g: &Grasp| {
        let command = trial.command(g, &ASSUMED, GripForce::Required).unwrap().unwrap();
        let outcome = trial.run(&command, truth, Engine::Diffsim).unwrap();
        (command, outcome)
    };
    grasps().iter().map(tried).find(|(_, outcome)| outcome.succeeded()).unwrap()
}

#[test]
fn a_film_shows_the_run_and_does_not_change_it() {
    let trial = trial_of(|_, _| {});
    let truth = Truth::as_assumed(&ASSUMED, 1);
    let (command, outcome) = holding(&trial, &truth);
    let (filmed, frames) = trial.record(&command, &truth, Engine::Diffsim, 0.1).unwrap();
    assert_eq!(filmed, outcome);
    assert_eq!(trial.run_until_failure(&command, &truth, Engine::Diffsim).unwrap(), outcome);
    for (i, frame) in frames.iter().enumerate() {
        assert!((frame.time_s - 0.1 * i as f64).abs() < 0.005, "frame {i} at {} s", frame.time_s);
    }
    // A grasp that holds lifts the object with the hand, and presses while it does.
    let height = |f: &drex_trial::Frame| f.world_from_object.translation.z;
    let highest = frames.iter().map(height).fold(0.0, f64::max);
    assert!((0.18..0.25).contains(&(highest - height(&frames[0]))), "lifted by {highest} m");
    let top = frames.iter().max_by(|a, b| height(a).total_cmp(&height(b))).unwrap();
    assert!(top.finger_n.iter().sum::<f64>() > 0.5 * command.grip_force_n, "{:?}", top.finger_n);
    assert!(frames[0].finger_n.iter().all(|n| *n == 0.0), "{:?}", frames[0].finger_n);
    let refused = trial.record(&command, &truth, Engine::Diffsim, f64::NAN).unwrap_err();
    assert!(refused.to_string().contains("NaN"), "{refused}");
}

#[test]
fn a_command_is_carried_out_by_the_hand_that_is_there() {
    let known = trial_of(|_, _| {});
    let truth = Truth::as_assumed(&ASSUMED, 1);
    let (command, same) = holding(&known, &truth);
    let outcome = |alone: fn(&mut Mismatch), seed| {
        let mut mismatch = Mismatch::NONE;
        alone(&mut mismatch);
        known.mismatched(&mismatch, seed).unwrap().run(&command, &truth, Engine::Diffsim).unwrap()
    };
    assert_eq!(outcome(|_| {}, 5), same);
    // Each of them is something else, and another seed another of it; lateness is the same for all.
    let surface = |m: &mut Mismatch| m.surface_m = 1.2e-3;
    let centre = |m: &mut Mismatch| m.centre_m = 0.01;
    let joints = |m: &mut Mismatch| m.joint_share = 0.2;
    for alone in [surface, centre, joints] {
        let one = outcome(alone, 5);
        assert_ne!(one, same);
        assert_eq!(one, outcome(alone, 5));
        assert_ne!(one, outcome(alone, 6));
    }
    let late = |m: &mut Mismatch| m.latency_s = 0.02;
    assert_ne!(outcome(late, 5), same);
    assert_eq!(outcome(late, 5), outcome(late, 6));
    // Commands are angles: of drives of which some have hardly any stiffness, hardly any press as is meant.
    let weak = (0..4).map(|seed| outcome(|m| m.joint_share = 0.95, seed));
    assert_eq!(weak.filter(Outcome::succeeded).count(), 0);
    // Of an evaluator what counts is off, and what grasps are selected by is not.
    let options = TrialOptions::default();
    let evaluator = TrialEvaluator::new(known.object(), known.hand(), &options, Engine::Diffsim).unwrap();
    let evaluator = evaluator.evaluating_with(Mismatch::default());
    assert_eq!(evaluator.validate(&command, &truth).unwrap(), same.clone().into());
    assert_ne!(evaluator.evaluate(&command, &truth).unwrap(), same.clone().into());
    let mut early = Mismatch::NONE;
    early.latency_s = -0.01;
    assert!(known.mismatched(&early, 1).err().unwrap().to_string().contains("latency_s is -0.01"));
}

#[test]
fn every_failure_has_its_name() {
    let trial = trial_of(|_, _| {});
    let found = grasps();
    let g = &found[0];
    let command = trial.command(g, &ASSUMED, GripForce::Required).unwrap().unwrap();
    let truth = Truth::as_assumed(&ASSUMED, 1);

    let heavy = trial.run(&command, &Truth { mass_kg: 3.0, ..truth }, Engine::Diffsim).unwrap();
    assert!(matches!(heavy.verdict, Verdict::Slip | Verdict::Drop), "{heavy:?}");
    let away = trial.run(&command, &Truth { shift_m: [0.3, 0.0], ..truth }, Engine::Diffsim).unwrap();
    assert_eq!(away.verdict, Verdict::NoContact);
    assert!(away.failed_at_s.is_some());

    let fragile = trial_of(|object, _| object.max_finger_n = Some(0.2));
    let crushed = fragile.run(&command, &truth, Engine::Diffsim).unwrap();
    assert_eq!(crushed.verdict, Verdict::Crushed);
    let refused = fragile.command(g, &ASSUMED, GripForce::Required).unwrap().unwrap_err();
    assert!(matches!(refused, NoCommand::Crushes(_)), "{refused}");

    let mut low = command.clone();
    low.world_from_base.translation.z -= 0.07;
    let table = trial.run(&low, &truth, Engine::Diffsim).unwrap();
    assert_eq!(table.verdict, Verdict::Table);
    // A hand that knows where the table is does not begin.
    let moved = |z: f64| Grasp { object_from_base: Pose::translation(0.0, 0.0, z) * g.object_from_base, ..g.clone() };
    let into_table = trial.command(&moved(-0.03), &ASSUMED, GripForce::Required).unwrap().unwrap_err();
    assert!(matches!(into_table, NoCommand::Table { force_n } if force_n > 1.0), "{into_table}");

    let heavy = Assumed { mass_kg: 5.0, ..ASSUMED };
    let weak = trial.command(g, &heavy, GripForce::Required).unwrap().unwrap_err();
    assert!(matches!(weak, NoCommand::TorqueLimit(_)), "{weak}");
    let smooth = Assumed { friction: 0.01, ..ASSUMED };
    let cannot = trial.command(g, &smooth, GripForce::Required).unwrap().unwrap_err();
    assert!(matches!(cannot, NoCommand::CannotCarry(_) | NoCommand::TorqueLimit(_)), "{cannot}");
    let nothing = trial.command(&moved(1.0), &ASSUMED, GripForce::Required).unwrap().unwrap_err();
    assert_eq!(nothing, NoCommand::NoContact { touching: 0 });
}

#[test]
fn numbers_without_meaning_are_refused() {
    let trial = trial_of(|_, _| {});
    let grasp = Grasp::new(trial.hand(), vec![0.0; 16], Pose::identity());
    for (mass_kg, friction) in [(0.0, 0.5), (1000.0, 0.5), (f64::NAN, 0.5), (0.2, 0.0), (0.2, f64::INFINITY)] {
        let assumed = Assumed { mass_kg, friction };
        let message = trial.command(&grasp, &assumed, GripForce::Required).unwrap_err().to_string();
        assert!(message.contains("mass") || message.contains("friction"), "{message}");
    }
    let short = Grasp { joints_rad: vec![0.0; 3], ..grasp };
    let message = trial.command(&short, &ASSUMED, GripForce::Required).unwrap_err().to_string();
    assert!(message.contains("with 3 angles") && message.contains("leap_right"), "{message}");
    let lost = Grasp { joints_rad: vec![f64::NAN; 16], ..short };
    let message = trial.command(&lost, &ASSUMED, GripForce::Required).unwrap_err().to_string();
    assert!(message.contains("not finite"), "{message}");
}

#[test]
fn threads_change_nothing() {
    let trial = trial_of(|_, _| {});
    let g = &grasps()[0];
    let command = trial.command(g, &ASSUMED, GripForce::Required).unwrap().unwrap();
    let all = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            (0..4u64)
                .into_par_iter()
                .map(|seed| trial.run(&command, &Truth::as_assumed(&ASSUMED, seed), Engine::Diffsim).unwrap())
                .collect::<Vec<_>>()
        })
    };
    assert_eq!(all(1), all(2));
}

#[cfg(not(feature = "mujoco"))]
#[test]
fn a_build_without_mujoco_says_so() {
    assert!(Engine::Diffsim.check().is_ok() && Engine::Mujoco.check().is_err());
    let trial = trial_of(|_, _| {});
    let g = &grasps()[0];
    let command = trial.command(g, &ASSUMED, GripForce::Required).unwrap().unwrap();
    let message = trial.run(&command, &Truth::as_assumed(&ASSUMED, 1), Engine::Mujoco).unwrap_err().to_string();
    assert!(message.contains("mujoco"), "{message}");
}

#[cfg(feature = "mujoco")]
#[test]
fn both_engines_say_the_same() {
    let trial = trial_of(|_, _| {});
    let found = grasps();
    let agree = found[..6]
        .par_iter()
        .map(|g| {
            let command = trial.command(g, &ASSUMED, GripForce::Required).unwrap().unwrap();
            let of = |engine| trial.run(&command, &Truth::as_assumed(&ASSUMED, 1), engine).unwrap();
            let (a, b) = (of(Engine::Diffsim), of(Engine::Mujoco));
            eprintln!("{:?} {:?}", a.verdict, b.verdict);
            a.succeeded() == b.succeeded()
        })
        .filter(|same| *same)
        .count();
    assert!(agree >= 5, "{agree} of 6");
}
