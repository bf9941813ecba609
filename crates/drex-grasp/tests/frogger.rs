//! FRoGGeR's labelled Allegro grasps: the metric computed from kinematics and mesh against the stored one.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // a test may stop at the first surprise and says why it is skipped

use drex_grasp::{GripForceError, GripForcePolicy, GripForceProblem, TorqueLimits};
use nalgebra::{DVector, Point3, Vector3};

#[allow(dead_code)] // the example uses more of it
#[path = "../examples/frogger/data.rs"]
mod data;
#[allow(dead_code)]
#[path = "../examples/frogger/features.rs"]
mod features;
#[allow(dead_code)]
#[path = "../examples/frogger/learn.rs"]
mod learn;

#[test]
fn min_weight_is_that_of_the_published_grasps() {
    let Some(folder) = data::folder() else {
        println!("skipped: DREX_SHARED does not lead to data/grasps/frogger_fr3_allegro");
        return;
    };
    let (kinematics, objects) = data::load(&folder).unwrap();
    let (mut own, mut wide, mut stored, mut labels) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for object in &objects {
        for grasp in &object.grasps {
            let tips = kinematics.tips(&grasp.q, &object.world_from_object);
            own.push(features::frogger_min_weight(object, &tips));
            wide.push(features::wide_min_weight(object, &tips, 0.010));
            stored.push(grasp.stored_min_weight);
            labels.push(grasp.succeeded);
        }
    }
    assert_eq!((objects.len(), labels.len()), (39, 1108));
    let rank = learn::spearman(&own, &stored);
    assert!(rank >= 0.9, "rank correlation {rank}");
    let [own, wide, stored] = [own, wide, stored].map(|s| learn::auc(&s, &labels));
    assert!((stored - 0.695).abs() < 0.005, "the labels are those of the publication: {stored}");
    assert!((own - stored).abs() <= 0.03, "{own} against {stored}");
    // The normal of the neighbourhood tells more than the one at the planned point.
    assert!(wide >= own + 0.05, "{wide} against {own}");
}

/// The grip-force policy on every real grasp, at several masses and with weak motors: an answer or a reason, never a solver's shrug.
#[test]
fn the_grip_force_policy_answers_on_every_published_grasp() {
    let Some(folder) = data::folder() else {
        println!("skipped: DREX_SHARED does not lead to data/grasps/frogger_fr3_allegro");
        return;
    };
    let (kinematics, objects) = data::load(&folder).unwrap();
    let law = GripForcePolicy::default();
    let (mut answered, mut limited, mut no_balance, mut too_weak) = (0, 0, 0, 0);
    let mut microseconds = Vec::new();
    for object in &objects {
        let up = object.world_from_object.rotation.inverse() * Vector3::z();
        for (i, grasp) in object.grasps.iter().enumerate() {
            let tips = kinematics.tips(&grasp.q, &object.world_from_object);
            let contacts = features::fine_contacts(object, &tips);
            let mass = object.mass_kg * [0.1, 1.0, 5.0][i % 3];
            let problem =
                GripForceProblem::new(contacts, mass, Point3::origin(), up * -9.81).with_torques(TorqueLimits {
                    jacobians: tips.jacobians.to_vec(),
                    limits_nm: vec![(-0.29, 0.29); 16],
                    gravity_nm: DVector::zeros(16),
                });
            let started = std::time::Instant::now();
            let outcome = law.command(&problem);
            microseconds.push(started.elapsed().as_micros());
            match outcome {
                Ok(c) => {
                    answered += 1;
                    limited += usize::from(c.margin < 1.25 - 1e-6);
                    let d = &c.distribution;
                    let lift: Vector3<f64> = d.forces.iter().sum();
                    assert!((lift - up * mass * 9.81).norm() < 1e-5 * (mass * 9.81 + c.total_n), "does not balance");
                    assert!((d.normal_n.iter().sum::<f64>() - c.total_n).abs() < 1e-5 * c.total_n);
                    assert!(d.joint_torques_nm.iter().all(|t| t.abs() < 0.29 * (1.0 + 1e-4)), "over the motors' limit");
                    assert!(c.margin >= 1.0 - 1e-6 && d.slack_n >= 0.0);
                }
                Err(GripForceError::Load { reason, .. }) => match *reason {
                    GripForceError::NoEquilibrium { .. } => no_balance += 1,
                    GripForceError::Torque { .. } | GripForceError::Total { .. } => too_weak += 1,
                    other => panic!("{other}"),
                },
                Err(other) => panic!("{} kg: {other}", mass),
            }
        }
    }
    microseconds.sort_unstable();
    println!(
        "{answered} of {} commands ({limited} with less margin than wanted), {no_balance} cannot balance, {too_weak} too weak; \
         median {} us, 98 % {} us",
        microseconds.len(),
        microseconds[microseconds.len() / 2],
        microseconds[microseconds.len() * 98 / 100]
    );
    assert!(answered > 700, "{answered}");
}

#[test]
fn rank_statistics_know_their_truths() {
    let labels = [false, true, false, true];
    assert_eq!(learn::auc(&[1.0, 4.0, 2.0, 3.0], &labels), 1.0);
    assert_eq!(learn::auc(&[4.0, 1.0, 3.0, 2.0], &labels), 0.0);
    assert_eq!(learn::auc(&[1.0; 4], &labels), 0.5);
    assert!((learn::spearman(&[1.0, 2.0, 3.0], &[10.0, 20.0, 400.0]) - 1.0).abs() < 1e-12);
    assert!((learn::spearman(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]) + 1.0).abs() < 1e-12);
    // A line through two clouds: the weight points across, the bias follows the share.
    let rows: Vec<Vec<f64>> = (0..40).map(|i| vec![f64::from(i % 7), f64::from(i)]).collect();
    let labels: Vec<bool> = (0..40).map(|i| i >= 20).collect();
    let fit = learn::Logistic::fit(&rows.iter().map(Vec::as_slice).collect::<Vec<_>>(), &labels, 1.0);
    assert!(fit.weights[1] > 5.0 * fit.weights[0].abs() && fit.weights[2].abs() < 0.2, "{:?}", fit.weights);
}
