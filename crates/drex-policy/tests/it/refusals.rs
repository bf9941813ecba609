//! Input that cannot be used, and what the message says.
#![cfg(feature = "flex")]

use std::ops::ControlFlow;

use crate::common::{FRICTION, box_points, small, toy};
use drex_policy::{Dataset, GraspPolicy, Query, TrainOptions, Trainer};

fn refused(data: &Dataset, options: &TrainOptions) -> String {
    GraspPolicy::train(data, options, &mut |_| ControlFlow::Continue(())).unwrap_err().to_string()
}

/// The message of training on toy data after `change`, which must name all of `words`.
fn check(change: impl FnOnce(&mut Dataset), words: &[&str]) {
    let mut data = toy(6, &[0.1, 0.2]);
    change(&mut data);
    let message = refused(&data, &small());
    for word in words {
        assert!(message.contains(word), "'{word}' is missing in: {message}");
    }
}

#[test]
fn data_that_cannot_be_used() {
    check(|d| d.samples.clear(), &["toy_hand", "no demonstrations", "at least one"]);
    check(|d| d.joint_names.clear(), &["no joints"]);
    check(|d| d.joint_names[2] = "base".into(), &["'base'", "twice"]);
    check(|d| d.joint_limits.truncate(2), &["3 joint names but 2 joint limits"]);
    check(|d| d.joint_limits[1] = (1.0, -1.0), &["'middle'", "no interval"]);
    check(|d| d.samples[3].joints[1] = f64::NAN, &["sample 3", "'middle'", "NaN"]);
    check(|d| d.samples[4].joints[0] = 2.3, &["sample 4", "'base'", "2.3", "limits", "units"]);
    check(|d| d.samples[2].joints.truncate(1), &["sample 2", "1 joint angles for 3 joints"]);
    check(|d| d.samples[1].object_from_base.translation.x = f64::INFINITY, &["sample 1", "wrist", "not finite"]);
    check(|d| d.samples[5].grip_force_n = 0.0, &["sample 5", "grip force is 0 N"]);
    check(|d| d.samples[0].mass_kg = -1.0, &["sample 0", "mass is -1 kg"]);
    check(|d| d.samples[0].grip_force_n = 1e9, &["sample 0", "times the weight", "units"]);
    check(|d| d.samples[0].mass_kg = 0.0, &["sample 0", "mass is 0 kg"]);
    check(|d| d.samples[0].mass_kg = 1000.0, &["sample 0", "mass is 1000 kg", "outside"]);
    check(|d| d.samples[3].friction = 0.0, &["sample 3", "friction is 0", "outside"]);
    check(|d| d.samples[3].friction = f64::NAN, &["sample 3", "friction is NaN"]);
    check(|d| d.samples[3].contacts = vec![false, false], &["sample 3", "contact set is empty"]);
    check(|d| d.samples[3].contacts = vec![true], &["sample 3", "1 contacts for 2 fingers"]);
    check(|d| d.fingers.clear(), &["no fingers"]);
    check(|d| d.fingers[1] = "thumb".into(), &["'thumb'", "twice"]);
    check(|d| d.objects.clear(), &["no objects"]);
    check(|d| d.samples[2].object = 4, &["sample 2", "object 4 of 1"]);
    check(|d| d.objects[0].up = nalgebra::Vector3::zeros(), &["'box'", "up"]);
    check(|d| d.objects[0].points.truncate(20), &["'box'", "20 surface points", "takes 48"]);
    check(|d| d.objects[0].points[7].y = f64::NAN, &["'box'", "surface point 7"]);
    check(|d| d.samples[2].object_from_base.translation.z = 120.0, &["sample 2", "hand is 119", "metres"]);
    check(|d| d.objects[0].points.iter_mut().for_each(|p| *p *= 1000.0), &["m across", "metres"]);
}

#[test]
fn options_that_cannot_be_used() {
    let data = toy(6, &[0.1]);
    for (options, word) in [
        (small().with_epochs(0), "'epochs'"),
        (small().with_batch(0), "'batch'"),
        (small().with_modes(0), "'modes'"),
        (small().with_hidden(1_000_000), "'hidden'"),
        (small().with_hold_out_every(1), "'hold_out_every'"),
        (small().with_learning_rate(f64::NAN), "'learning_rate'"),
        (small().with_rollouts(drex_policy::RolloutOptions::default().with_tries(0)), "'rollouts.tries'"),
    ] {
        let message = refused(&data, &options);
        assert!(message.contains(word), "{message}");
    }
    assert!(serde_json::from_str::<TrainOptions>(r#"{"epoch": 3}"#).unwrap_err().to_string().contains("epoch"));
    assert_eq!(
        serde_json::from_str::<TrainOptions>(r#"{"epochs": 3}"#).unwrap(),
        TrainOptions::default().with_epochs(3)
    );
}

#[test]
fn queries_that_cannot_be_answered() {
    let (policy, _) =
        GraspPolicy::train(&toy(6, &[0.1, 0.2]), &small().with_epochs(1), &mut |_| ControlFlow::Continue(())).unwrap();
    let points = box_points();
    let says = |query: Query<'_>, word: &str| {
        let message = policy.predict(&query).unwrap_err().to_string();
        assert!(message.contains(word), "{message}");
    };
    let plain = |points| Query::new(points, 0.1, FRICTION);
    says(plain(&points[..40]), "40 points, but the policy takes 48");
    says(plain(&[]), "0 points");
    for mass in [0.0, -0.1, f64::NAN, f64::INFINITY, 1000.0] {
        says(Query::new(&points, mass, FRICTION), "too far from the 0.1 .. 0.2 kg");
    }
    for friction in [0.0, -0.5, f64::NAN, 0.1, 3.0] {
        says(Query::new(&points, 0.1, friction), "friction");
    }
    says(plain(&points).with_up(nalgebra::Vector3::zeros()), "up");
    says(plain(&points).with_table_below_m(-0.1), "table");
    says(plain(&points).with_table_below_m(f64::NAN), "table");
    let mut broken = points.clone();
    broken[3].z = f64::NEG_INFINITY;
    says(plain(&broken), "point 3 is not finite");
    let millimetres: Vec<_> = points.iter().map(|p| p * 1000.0).collect();
    says(plain(&millimetres), "metres");
    let message = policy.log_density(&plain(&points), &[0.1], None).unwrap_err().to_string();
    assert!(message.contains("1 joint angles for 3 joints"), "{message}");
}

#[test]
fn another_hand_is_named() {
    let data = toy(6, &[0.1, 0.2]);
    let options = small().with_epochs(1);
    let (policy, _) = GraspPolicy::train(&data, &options, &mut |_| ControlFlow::Continue(())).unwrap();
    let names = |n: [&str; 3]| n.map(String::from);
    policy.check_hand("toy_hand", &names(["base", "middle", "tip"])).unwrap();
    let folder = tempfile::tempdir().unwrap();
    Trainer::new(&data, &options).unwrap().save(folder.path()).unwrap();
    for (hand, joints, word) in [
        ("other_hand", ["base", "middle", "tip"], "two hands"),
        ("toy_hand", ["middle", "base", "tip"], "joint 0 is 'base' here and 'middle' there"),
        ("toy_hand", ["base", "middle", "end"], "missing joint 'tip', unknown joint 'end'"),
    ] {
        let message = policy.check_hand(hand, &names(joints)).unwrap_err().to_string();
        assert!(message.contains(word) && message.contains("toy_hand"), "{message}");
        let mut other = data.clone();
        (other.hand, other.joint_names) = (hand.into(), names(joints).to_vec());
        let Err(refused) = Trainer::resume(&other, folder.path()) else { panic!("{word}: resumed") };
        assert!(refused.to_string().contains(word), "{refused}");
    }
    let mut other = data.clone();
    other.samples[0].joints[0] += 1e-9;
    let Err(refused) = Trainer::resume(&other, folder.path()) else { panic!("resumed") };
    assert!(refused.to_string().contains("other demonstrations"), "{refused}");
}
