//! Paper mode beside the mixture on the 132 real grasps of the D-REX authors (LEAP hand, joint angles only).
#![cfg(feature = "flex")]

use crate::common;

use std::ops::ControlFlow;

use crate::common::{leap_limits, tin};
use drex_core::Pose;
use drex_policy::paper::{PaperContacts, PaperPolicy};
use drex_policy::{Dataset, GRAVITY_M_S2, GraspPolicy, GraspSample, ObjectCloud, Query, TrainOptions};

/// The grasps as both modes learn them: clipped to the limits of the hand.
fn leap_grasps() -> Option<Vec<Vec<f64>>> {
    let clip = |g: Vec<f64>| g.iter().zip(leap_limits()).map(|(q, (a, b))| q.clamp(a, b)).collect();
    Some(common::leap_grasps()?.into_iter().map(clip).collect())
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Median over `from` of the distance to the nearest of `to`.
fn to_nearest(from: &[Vec<f64>], to: &[Vec<f64>]) -> f64 {
    median(from.iter().map(|a| to.iter().map(|b| distance(a, b)).fold(f64::INFINITY, f64::min)).collect())
}

fn dataset(grasps: &[Vec<f64>]) -> Dataset {
    let sample = |joints: &Vec<f64>| GraspSample {
        object: 0,
        joints: joints.clone(),
        object_from_base: Pose::translation(0.0, 0.0, 0.1),
        contacts: vec![true; 4],
        grip_force_n: 3.0 * 0.2 * GRAVITY_M_S2,
        mass_kg: 0.2,
        friction: 0.5,
    };
    Dataset {
        hand: "leap_right".into(),
        joint_names: (0..16).map(|j| format!("joint{j}")).collect(),
        joint_limits: leap_limits(),
        fingers: ["thumb", "index", "middle", "ring"].map(String::from).to_vec(),
        objects: vec![ObjectCloud::upright("tin", tin())],
        samples: grasps.iter().map(sample).collect(),
    }
}

#[test]
fn the_mixture_explains_grasps_held_out_better_than_the_paper() {
    let Some(grasps) = leap_grasps() else { return };
    // Frames of a clip follow each other: every eighth one held out has its neighbours among the training grasps; a block has not.
    let every = |i: usize| i % 8 == 7;
    let block = |part: usize| move |i: usize| i / 22 == part;
    let mut blocks = (0.0, 0.0, 0.0);
    for (name, held) in std::iter::once(("every eighth", &every as &dyn Fn(usize) -> bool)).chain(
        [0, 1, 2, 3, 4, 5].map(|part| ("block of 22", Box::leak(Box::new(block(part))) as &dyn Fn(usize) -> bool)),
    ) {
        let pick = |out: bool| -> Vec<Vec<f64>> {
            grasps.iter().enumerate().filter(|(i, _)| held(*i) == out).map(|(_, g)| g.clone()).collect()
        };
        let (train, test) = (pick(false), pick(true));
        let mut paper = PaperPolicy::new(&tin()[..128], &leap_limits(), 1).unwrap();
        paper.train(&train, 30, 1).unwrap();
        let (one, each) = paper.log_likelihoods(&train, &test).unwrap();

        let options = TrainOptions::default().with_hold_out_every(0).with_epochs(60);
        let (policy, _) = GraspPolicy::train(&dataset(&train), &options, &mut |_| ControlFlow::Continue(())).unwrap();
        let points = tin();
        let query = Query::new(&points, 0.2, 0.5);
        let ours = test.iter().map(|q| policy.log_density(&query, q, None).unwrap()).sum::<f64>() / test.len() as f64;
        let modes: Vec<Vec<f64>> = policy.predict(&query).unwrap().into_iter().map(|g| g.joints).collect();
        let samples: Vec<Vec<f64>> = policy.sample(&query, 200, 3).unwrap().into_iter().map(|g| g.joints).collect();
        let mean: Vec<f64> = (0..16).map(|j| train.iter().map(|g| g[j]).sum::<f64>() / train.len() as f64).collect();
        let from_mean = median(test.iter().map(|g| distance(g, &mean)).collect());
        let from_modes = to_nearest(&test, &modes);
        let (modes_real, samples_real) = (to_nearest(&modes, &grasps), to_nearest(&samples, &grasps));
        let mean_real = to_nearest(&[mean], &grasps);
        eprintln!(
            "{name}: log-likelihood {ours:.1} nats, paper {one:.1} (one variance) {each:.1} (one per joint); median distance of a held-out \
             grasp to the nearest mode {from_modes:.2} rad, to the mean {from_mean:.2}; of a mode to a real grasp {modes_real:.2}, of a \
             sample {samples_real:.2}, of the mean {mean_real:.2}"
        );
        assert!(from_modes < from_mean, "{from_modes} {from_mean}");
        assert!(modes_real < 0.87 && samples_real < 0.87, "{modes_real} {samples_real}");
        if name == "every eighth" {
            assert!(ours > one.max(each) + 5.0, "{ours} against {one} and {each}");
        } else {
            blocks = (blocks.0 + ours / 6.0, blocks.1 + one / 6.0, blocks.2 + each / 6.0);
        }
    }
    eprintln!("blocks, mean: ours {:.1}, paper {:.1} and {:.1}", blocks.0, blocks.1, blocks.2);
    assert!(blocks.0 > blocks.1.max(blocks.2), "{blocks:?}");
}

#[test]
fn paper_mode_becomes_the_mean_of_the_real_grasps() {
    let Some(grasps) = leap_grasps() else { return };
    let mut paper = PaperPolicy::new(&tin()[..128], &leap_limits(), 1).unwrap();
    let curve = paper.train(&grasps, 60, 1).unwrap();
    let answer = paper.answer().unwrap();
    let mean: Vec<f64> = (0..16).map(|j| grasps.iter().map(|g| g[j]).sum::<f64>() / 132.0).collect();
    let off = distance(&answer.joints, &mean);
    let gap = median(grasps.iter().map(|g| distance(g, &answer.joints)).collect());
    eprintln!("off the mean by {off:.3} rad; median demonstration {gap:.2} rad from it; losses {:?}", curve.last());
    assert!(off < 0.25 && (0.7..1.05).contains(&gap));
    // The second phase has no loss on the joint angles: they drift.
    let contacts = |_: &[f64]| Ok(PaperContacts { contacts: 2, on_object: 1 });
    let curve = paper.train_contacts(132, 5, 0.21, 1, &contacts).unwrap();
    let after = paper.answer().unwrap();
    eprintln!(
        "second phase: drift {:.3} rad, force {:.2}, {:?}",
        distance(&after.joints, &answer.joints),
        after.force,
        curve.last()
    );
    assert!(after.contacts[0] < 0.5 && after.force < answer.force);
}
