//! What training must achieve on data whose answer is known.
#![allow(clippy::unwrap_used, missing_docs)] // a test says what fails by failing
#![cfg(feature = "flex")]

mod common;

use std::ops::ControlFlow;

use common::{box_points, small, toy, ways};
use drex_policy::{EpochStats, GRAVITY_M_S2, GraspPolicy, TrainReport, grasp_distance_m};
use nalgebra::Point3;

const MASSES: [f64; 3] = [0.1, 0.2, 0.4];

fn quiet(_: EpochStats) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn trained() -> (GraspPolicy, TrainReport) {
    GraspPolicy::train(&toy(36, &MASSES), &small(), &mut quiet).unwrap()
}

#[test]
fn two_ways_to_grasp_become_two_modes_with_their_force() {
    let (policy, report) = trained();
    assert_eq!((report.train_grasps, report.held_out_grasps), (32, 4));
    assert_eq!((report.train_samples, report.held_out_samples), (96, 12));
    // 0.05 and 0.8 kg were never trained on: the force must follow the weight outside the data too.
    for mass in [0.05, 0.1, 0.15, 0.3, 0.4, 0.8] {
        let grasps = policy.predict(&box_points(), mass).unwrap();
        assert_eq!(grasps.len(), 2);
        assert!((grasps.iter().map(|g| g.weight).sum::<f64>() - 1.0).abs() < 1e-9);
        assert!(grasps[0].weight >= grasps[1].weight);
        for (i, (joints, pose, ratio)) in ways().iter().enumerate() {
            let distance = |g: &drex_policy::PredictedGrasp| {
                grasp_distance_m((&g.joints, &g.object_from_palm), (joints, pose), 0.1)
            };
            let nearest = grasps.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
            assert!(distance(nearest) < 0.005, "way {i} at {mass} kg is {} m off", distance(nearest));
            let needed = ratio * mass * GRAVITY_M_S2;
            assert!(
                (nearest.squeeze_n / needed - 1.0).abs() < 0.05,
                "way {i} at {mass} kg: {} N for {needed} N",
                nearest.squeeze_n
            );
            let share = [2.0 / 3.0, 1.0 / 3.0][i];
            assert!((nearest.weight - share).abs() < 0.1, "way {i} has weight {}", nearest.weight);
        }
    }
}

#[test]
fn a_squeeze_that_grows_faster_than_the_weight_is_learned() {
    // From 2 times the weight at the lightest to 3 times at the heaviest, as when weak joints force a worse distribution.
    let mut data = toy(24, &MASSES);
    let ratio = |mass: f64| 2.0 + (mass / 0.1).ln() / 4f64.ln();
    for s in &mut data.samples {
        s.squeeze_n = ratio(s.mass_kg) * s.mass_kg * GRAVITY_M_S2;
    }
    let (policy, _) = GraspPolicy::train(&data, &small().with_epochs(150), &mut quiet).unwrap();
    for mass in [0.1, 0.14, 0.2, 0.3, 0.4] {
        for g in policy.predict(&box_points(), mass).unwrap() {
            let needed = ratio(mass) * mass * GRAVITY_M_S2;
            assert!((g.squeeze_n / needed - 1.0).abs() < 0.05, "{mass} kg: {} N for {needed} N", g.squeeze_n);
        }
    }
    // Outside the data the last ratio stays: the force is exactly proportional to the mass.
    let at = |mass: f64| policy.predict(&box_points(), mass).unwrap()[0].squeeze_n;
    assert!((at(1.6) / at(0.8) - 2.0).abs() < 1e-9 && (at(0.4) / at(0.8) - 0.5).abs() < 1e-9);
}

#[test]
fn the_report_beats_the_mean_and_counts_right() {
    let (_, report) = trained();
    let (found, rules) = (report.held_out.unwrap(), report.baselines.unwrap());
    assert!(found.joint_rms_rad < 0.3 * rules.mean_demonstration.joint_rms_rad, "{found:?} {rules:?}");
    assert!(found.wrist_m < 0.3 * rules.mean_demonstration.wrist_m);
    assert!(found.force_relative < 0.05 && rules.mean_demonstration.force_relative > 0.3);
    assert!(rules.nearest_demonstration.joint_rms_rad <= rules.random_demonstrations.joint_rms_rad);
    assert_eq!(report.modes.iter().map(|m| m.demonstrations).sum::<usize>(), report.train_grasps);
    assert!(report.modes.iter().all(|m| m.nearest_demonstration_rad < 0.05));
    assert_eq!(report.curve.len(), 60);
    assert!(report.curve[59].total < 0.5 * report.curve[0].total);
    assert!(!report.stopped_early);
}

#[test]
fn another_sampling_and_another_frame_give_the_same_grasp() {
    let (policy, _) = trained();
    let nominal = policy.predict(&box_points(), 0.2).unwrap();
    // Other points of the same box, in other order, with the box moved: the wrist moves with it.
    let shift = nalgebra::Vector3::new(0.3, -0.2, 0.1);
    let mut points: Vec<Point3<f64>> = box_points().iter().map(|p| p + shift).collect();
    points.reverse();
    points.extend(box_points().iter().take(40).map(|p| p + shift + nalgebra::Vector3::new(0.0, 0.0, 1e-4)));
    let moved = policy.predict(&points, 0.2).unwrap();
    for (a, b) in nominal.iter().zip(&moved) {
        let gap = (b.object_from_palm.translation.vector - a.object_from_palm.translation.vector - shift).norm();
        assert!(gap < 0.003, "wrist off by {gap} m");
        assert!(a.joints.iter().zip(&b.joints).all(|(x, y)| (x - y).abs() < 0.03));
    }
}

#[test]
fn predictions_stay_inside_limits_even_where_demonstrations_lie_on_them() {
    let mut data = toy(12, &[0.2]);
    for s in &mut data.samples {
        s.joints[0] = 2.0;
        s.joints[1] = -0.6;
    }
    let (policy, _) = GraspPolicy::train(&data, &small(), &mut quiet).unwrap();
    for g in policy.predict(&box_points(), 0.2).unwrap() {
        for (q, (lower, upper)) in g.joints.iter().zip(&data.joint_limits) {
            assert!(lower <= q && q <= upper);
        }
        assert!((g.joints[0] - 2.0).abs() < 0.02 && (g.joints[1] + 0.6).abs() < 0.02, "{:?}", g.joints);
    }
}

#[test]
fn more_modes_than_grasps_are_not_kept() {
    let options = small().with_modes(50).with_hold_out_every(0).with_epochs(2);
    let (policy, report) = GraspPolicy::train(&toy(3, &MASSES), &options, &mut quiet).unwrap();
    assert_eq!(policy.modes(), 3);
    assert_eq!(policy.predict(&box_points(), 0.1).unwrap().len(), 3);
    assert!(report.held_out.is_none() && report.baselines.is_none());
}

#[test]
fn one_grasp_at_one_mass_is_enough() {
    let (policy, _) = GraspPolicy::train(&toy(1, &[0.3]), &small(), &mut quiet).unwrap();
    let grasps = policy.predict(&box_points(), 0.6).unwrap();
    assert_eq!(grasps.len(), 1);
    let (_, _, ratio) = &ways()[0];
    assert!((grasps[0].squeeze_n / (ratio * 0.6 * GRAVITY_M_S2) - 1.0).abs() < 0.05);
}

#[test]
fn a_turned_object_turns_the_grasp_when_trained_so() {
    let mut options = small().with_epochs(250).with_hidden(48);
    options.yaw_range_rad = 0.6;
    let (policy, _) = GraspPolicy::train(&toy(18, &[0.2]), &options, &mut quiet).unwrap();
    for angle in [-0.4, 0.0, 0.4] {
        let turn = nalgebra::Isometry3::rotation(nalgebra::Vector3::z() * angle);
        let points: Vec<_> = box_points().iter().map(|p| turn * p).collect();
        let grasps = policy.predict(&points, 0.2).unwrap();
        for (joints, pose, _) in ways() {
            let pose = turn * pose;
            let distance = |g: &drex_policy::PredictedGrasp| {
                grasp_distance_m((&g.joints, &g.object_from_palm), (&joints, &pose), 0.1)
            };
            let nearest = grasps.iter().map(distance).fold(f64::INFINITY, f64::min);
            assert!(nearest < 0.02, "turned by {angle} rad, {nearest} m off");
        }
    }
}

#[test]
fn the_caller_can_stop() {
    let mut seen = 0;
    let mut stop = |s: EpochStats| {
        seen += 1;
        if s.epoch == 4 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let (policy, report) = GraspPolicy::train(&toy(9, &MASSES), &small(), &mut stop).unwrap();
    assert_eq!(seen, 5);
    assert!(report.stopped_early && report.curve.len() == 5);
    assert_eq!(policy.predict(&box_points(), 0.2).unwrap().len(), 2);
}
