//! What training must achieve on data whose answer is known.
#![cfg(feature = "flex")]

use std::ops::ControlFlow;

use crate::common::{FRICTION, TOUCHES, box_points, small, toy, ways};
use drex_policy::{
    EpochStats, GRAVITY_M_S2, GraspPolicy, PredictedGrasp, Query, TrainReport, grasp_distance_m, normalised_grip_force,
};
use nalgebra::Point3;

const MASSES: [f64; 3] = [0.1, 0.2, 0.4];

fn quiet(_: EpochStats) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn ask(policy: &GraspPolicy, points: &[Point3<f64>], mass: f64) -> Vec<PredictedGrasp> {
    policy.predict(&Query::new(points, mass, FRICTION)).unwrap()
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
        let grasps = ask(&policy, &box_points(), mass);
        assert_eq!(grasps.len(), 2);
        assert!((grasps.iter().map(|g| g.weight).sum::<f64>() - 1.0).abs() < 1e-9);
        assert!(grasps[0].weight >= grasps[1].weight);
        for (i, (joints, pose, ratio)) in ways().iter().enumerate() {
            let distance = |g: &PredictedGrasp| grasp_distance_m((&g.joints, &g.object_from_base), (joints, pose), 0.1);
            let nearest = grasps.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
            assert!(distance(nearest) < 0.005, "way {i} at {mass} kg is {} m off", distance(nearest));
            let needed = ratio * mass * GRAVITY_M_S2;
            assert!(
                (nearest.grip_force_n / needed - 1.0).abs() < 0.05,
                "way {i} at {mass} kg: {} N for {needed} N",
                nearest.grip_force_n
            );
            for (p, touches) in nearest.contacts.iter().zip(TOUCHES[i]) {
                assert!((*p > 0.8) == touches && (*p < 0.2) != touches, "way {i}: contacts {:?}", nearest.contacts);
            }
            let share = [2.0 / 3.0, 1.0 / 3.0][i];
            assert!((nearest.weight - share).abs() < 0.1, "way {i} has weight {}", nearest.weight);
        }
    }
}

#[test]
fn a_grip_force_that_grows_faster_than_the_weight_is_learned() {
    // From 2 times the weight at the lightest to 3 times at the heaviest, as when weak joints force a worse distribution.
    let mut data = toy(24, &MASSES);
    let ratio = |mass: f64| 2.0 + (mass / 0.1).ln() / 4f64.ln();
    for s in &mut data.samples {
        s.grip_force_n = ratio(s.mass_kg) * s.mass_kg * GRAVITY_M_S2;
    }
    let (policy, _) = GraspPolicy::train(&data, &small().with_epochs(150), &mut quiet).unwrap();
    for mass in [0.1, 0.14, 0.2, 0.3, 0.4] {
        for g in ask(&policy, &box_points(), mass) {
            let needed = ratio(mass) * mass * GRAVITY_M_S2;
            assert!((g.grip_force_n / needed - 1.0).abs() < 0.05, "{mass} kg: {} N for {needed} N", g.grip_force_n);
        }
    }
    // Outside the data the last ratio stays: the force is exactly proportional to the mass.
    let at = |mass: f64| ask(&policy, &box_points(), mass)[0].grip_force_n;
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
    let nominal = ask(&policy, &box_points(), 0.2);
    // Other points of the same box, in other order, with the box moved: the wrist moves with it.
    let shift = nalgebra::Vector3::new(0.3, -0.2, 0.1);
    let mut points: Vec<Point3<f64>> = box_points().iter().map(|p| p + shift).collect();
    points.reverse();
    points.extend(box_points().iter().take(40).map(|p| p + shift + nalgebra::Vector3::new(0.0, 0.0, 1e-4)));
    let moved = ask(&policy, &points, 0.2);
    for (a, b) in nominal.iter().zip(&moved) {
        let gap = (b.object_from_base.translation.vector - a.object_from_base.translation.vector - shift).norm();
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
    for g in ask(&policy, &box_points(), 0.2) {
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
    assert_eq!(ask(&policy, &box_points(), 0.1).len(), 3);
    assert!(report.held_out.is_none() && report.baselines.is_none());
}

#[test]
fn one_grasp_at_one_mass_is_enough() {
    let (policy, _) = GraspPolicy::train(&toy(1, &[0.3]), &small(), &mut quiet).unwrap();
    let grasps = ask(&policy, &box_points(), 0.6);
    assert_eq!(grasps.len(), 1);
    let (_, _, ratio) = &ways()[0];
    assert!((grasps[0].grip_force_n / (ratio * 0.6 * GRAVITY_M_S2) - 1.0).abs() < 0.05);
}

#[test]
fn a_turned_object_turns_the_grasp_when_trained_so() {
    let mut options = small().with_epochs(400).with_hidden(48).with_points(150);
    // With little share the modes may divide the headings among them instead of the ways.
    (options.yaw_range_rad, options.share) = (0.6, 0.3);
    let (policy, _) = GraspPolicy::train(&toy(18, &[0.2]), &options, &mut quiet).unwrap();
    for angle in [-0.4, 0.0, 0.4] {
        let turn = nalgebra::Isometry3::rotation(nalgebra::Vector3::z() * angle);
        let points: Vec<_> = box_points().iter().map(|p| turn * p).collect();
        let grasps = ask(&policy, &points, 0.2);
        for (joints, pose, _) in ways() {
            let pose = turn * pose;
            let distance =
                |g: &PredictedGrasp| grasp_distance_m((&g.joints, &g.object_from_base), (&joints, &pose), 0.1);
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
    assert_eq!(ask(&policy, &box_points(), 0.2).len(), 2);
}

#[test]
fn friction_is_an_input_and_the_force_follows_it_outside_the_data() {
    // Two opposed contacts need m g / mu; at high friction a hook under the object needs less friction than that.
    let law = |mass: f64, mu: f64| mass * GRAVITY_M_S2 / mu * (1.0 + 0.3 * (mu / 0.3).ln());
    let mut data = toy(24, &[0.1, 0.2]);
    let samples = data.samples.clone();
    data.samples.clear();
    for mu in [0.3, 0.5, 0.8] {
        data.samples.extend(samples.iter().map(|s| {
            let grip_force_n = law(s.mass_kg, mu);
            drex_policy::GraspSample { friction: mu, grip_force_n, ..s.clone() }
        }));
    }
    let (policy, report) = GraspPolicy::train(&data, &small(), &mut quiet).unwrap();
    assert_eq!(report.train_grasps, 21, "the same grasp at another friction is the same grasp");
    assert_eq!(policy.friction_range(), (0.3, 0.8));
    let grip_force = |mu: f64| policy.predict(&Query::new(&box_points(), 0.15, mu)).unwrap()[0].grip_force_n;
    for mu in [0.3, 0.4, 0.6, 0.8] {
        assert!((grip_force(mu) / law(0.15, mu) - 1.0).abs() < 0.06, "friction {mu}: {} N", grip_force(mu));
    }
    assert!(
        (grip_force(0.15) / grip_force(0.3) - 2.0).abs() < 1e-6,
        "below the data the force goes with one over the friction"
    );
}

#[test]
fn two_objects_keep_their_own_grasps() {
    // A box and a plate, each with its own single way.
    let mut data = toy(24, &[0.2]);
    let plate = box_points().iter().map(|p| Point3::new(1.6 * p.x, 1.6 * p.y, 0.2 * p.z)).collect();
    data.objects.push(drex_policy::ObjectCloud::upright("plate", plate));
    for (i, s) in data.samples.iter_mut().enumerate() {
        s.object = usize::from(i % 3 == 2);
    }
    let (policy, _) = GraspPolicy::train(&data, &small().with_epochs(400), &mut quiet).unwrap();
    for (object, (joints, _, ratio)) in data.objects.iter().zip(ways()) {
        let best = &ask(&policy, &object.points, 0.2)[0];
        assert!(best.weight > 0.8, "{}: {}", object.name, best.weight);
        let gap = best.joints.iter().zip(&joints).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(gap < 0.1, "{}: {:?} for {joints:?}", object.name, best.joints);
        assert!((best.grip_force_n / (ratio * 0.2 * GRAVITY_M_S2) - 1.0).abs() < 0.1, "{}", object.name);
    }
}

#[test]
fn up_may_be_any_axis_and_the_table_is_seen() {
    // All points enter, so that thinning a grid with its many equal distances does not choose others.
    let (policy, _) = GraspPolicy::train(&toy(12, &MASSES), &small().with_points(150), &mut quiet).unwrap();
    let nominal = ask(&policy, &box_points(), 0.2);
    // The same scene in a frame in which up is x.
    let turn = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
    let points: Vec<_> = box_points().iter().map(|p| turn * p).collect();
    let query = Query::new(&points, 0.2, FRICTION).with_up(nalgebra::Vector3::x() * 3.0);
    for (a, b) in nominal.iter().zip(policy.predict(&query).unwrap()) {
        let expected = turn * a.object_from_base;
        assert!((expected.translation.vector - b.object_from_base.translation.vector).norm() < 1e-5);
        assert!(expected.rotation.angle_to(&b.object_from_base.rotation) < 1e-4);
    }
    // Said or found, the table is the same; another one is another input.
    let said = policy.predict(&Query::new(&box_points(), 0.2, FRICTION).with_table_below_m(0.05)).unwrap();
    assert_eq!(said, nominal);
    let higher = policy.predict(&Query::new(&box_points(), 0.2, FRICTION).with_table_below_m(0.2)).unwrap();
    assert_ne!(higher, nominal);
}

#[test]
fn samples_scatter_as_the_spread_says_and_density_prefers_what_was_shown() {
    let (policy, report) = trained();
    let points = box_points();
    let query = Query::new(&points, 0.2, FRICTION);
    let drawn = policy.sample(&query, 400, 7).unwrap();
    assert_eq!(drawn, policy.sample(&query, 400, 7).unwrap());
    assert_ne!(drawn, policy.sample(&query, 400, 8).unwrap());
    let modes = policy.predict(&query).unwrap();
    let first = drawn.iter().filter(|g| g.grip_force_n == modes[0].grip_force_n).count() as f64 / 400.0;
    assert!((first - modes[0].weight).abs() < 0.08, "{first} for {}", modes[0].weight);
    let spread = policy.spread();
    // Variance of Student's t: spread² ν / (ν - 2), with ν 20.
    let gap: f64 = drawn
        .iter()
        .map(|g| {
            let mode = modes.iter().find(|m| m.grip_force_n == g.grip_force_n).unwrap();
            (g.object_from_base.translation.vector - mode.object_from_base.translation.vector).norm_squared() / 3.0
        })
        .sum::<f64>()
        / 400.0;
    let ratio = gap / (spread.wrist_m.powi(2) * 20.0 / 18.0);
    assert!((0.6..1.6).contains(&ratio), "{ratio}");
    let (joints, pose, _) = &ways()[0];
    let near = policy.log_density(&query, joints, Some(pose)).unwrap();
    let off: Vec<f64> = joints.iter().map(|q| q + 0.2).collect();
    assert!(near > policy.log_density(&query, &off, Some(pose)).unwrap() + 5.0);
    assert!(report.held_out_log_likelihood.unwrap() > 0.0, "{:?}", report.held_out_log_likelihood);
    assert_eq!((normalised_grip_force(2.5), normalised_grip_force(60.0)), (0.5, 1.0));
}
