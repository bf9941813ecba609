//! What predicts whether a pick succeeds, on FRoGGeR's labelled grasps: its own metric computed again, and a small
//! regression on what the cone programme says, always tested on objects that it has not seen.
//!
//! `DREX_SHARED=... cargo run --release -p drex-grasp --example frogger`
#![allow(clippy::print_stdout)] // an example prints

mod data;
mod features;
mod learn;

use learn::{Logistic, auc, spearman};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Strength of the penalty, chosen before any result was seen: ten grasps' worth per unit weight.
const PENALTY: f64 = 10.0;
const RESAMPLES: usize = 1000;

fn main() -> data::Outcome<()> {
    let Some(folder) = data::folder() else {
        println!("DREX_SHARED does not lead to data/grasps/frogger_fr3_allegro: nothing to do");
        return Ok(());
    };
    let (kinematics, objects) = data::load(&folder)?;
    let (mut rows, mut labels, mut stored, mut of_object) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (index, object) in objects.iter().enumerate() {
        for grasp in &object.grasps {
            rows.push(features::features(object, &kinematics, grasp, rows.len() as u64));
            labels.push(grasp.succeeded);
            stored.push(grasp.stored_min_weight);
            of_object.push(index);
        }
    }
    let successes = labels.iter().filter(|l| **l).count();
    println!("{} labelled grasps of {} objects, {successes} succeed", labels.len(), objects.len());
    let own: Vec<f64> = rows.iter().map(|r| r[0]).collect();
    println!("min-weight: rank correlation with the stored value {:.3}", spearman(&own, &stored));
    println!("AUC: stored {:.3}, computed {:.3}", auc(&stored, &labels), auc(&own, &labels));
    println!("\nAUC of each feature alone (below a half: less is better)");
    for (k, name) in features::NAMES.iter().enumerate() {
        let column: Vec<f64> = rows.iter().map(|r| r[k]).collect();
        println!("{:.3}  {name}", auc(&column, &labels));
    }
    println!("\nleave one object out, logistic regression:");
    let count = features::NAMES.len();
    let sets = [
        ("all features", 0..count),
        ("min-weights only", 0..features::MIN_WEIGHTS),
        ("no min-weights", features::MIN_WEIGHTS..count),
    ];
    let mut drawn = Vec::new();
    for (name, columns) in sets {
        let scores = held_out(&rows, &labels, &of_object, objects.len(), &columns.collect::<Vec<_>>());
        drawn.push(report(name, &scores, &labels, &of_object, objects.len()));
    }
    report("FRoGGeR's min-weight, computed, no regression", &own, &labels, &of_object, objects.len());
    let base = report("FRoGGeR's min-weight, stored", &stored, &labels, &of_object, objects.len());
    let gain: Vec<f64> = drawn[0].iter().zip(&base).map(|(a, b)| a - b).collect();
    let (low, high) = interval(gain);
    println!("all features over the stored value, same draws: 95 % interval {low:.3} to {high:.3}");
    let fit = Logistic::fit(&rows.iter().map(Vec::as_slice).collect::<Vec<_>>(), &labels, PENALTY);
    println!("\nweights of standardised features, fitted to all");
    for (name, w) in features::NAMES.iter().zip(&fit.weights) {
        println!("{w:6.2}  {name}");
    }
    Ok(())
}

/// Scores of each grasp by a model that has not seen its object.
fn held_out(rows: &[Vec<f64>], labels: &[bool], of_object: &[usize], objects: usize, columns: &[usize]) -> Vec<f64> {
    let chosen: Vec<Vec<f64>> = rows.iter().map(|r| columns.iter().map(|&k| r[k]).collect()).collect();
    let mut scores = vec![0.0; rows.len()];
    for held in 0..objects {
        let train: Vec<usize> = (0..rows.len()).filter(|&i| of_object[i] != held).collect();
        let x: Vec<&[f64]> = train.iter().map(|&i| chosen[i].as_slice()).collect();
        let y: Vec<bool> = train.iter().map(|&i| labels[i]).collect();
        let model = Logistic::fit(&x, &y, PENALTY);
        for i in (0..rows.len()).filter(|&i| of_object[i] == held) {
            scores[i] = model.score(&chosen[i]);
        }
    }
    scores
}

/// Prints the AUC with a 95 % interval by drawing objects with replacement, and the mean AUC within an object; returns the
/// AUC of each draw, the same draws for every predictor.
fn report(name: &str, scores: &[f64], labels: &[bool], of_object: &[usize], objects: usize) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let members: Vec<Vec<usize>> =
        (0..objects).map(|o| (0..labels.len()).filter(|&i| of_object[i] == o).collect()).collect();
    let of = |picked: &[usize]| {
        let s: Vec<f64> = picked.iter().map(|&i| scores[i]).collect();
        let l: Vec<bool> = picked.iter().map(|&i| labels[i]).collect();
        auc(&s, &l)
    };
    let drawn: Vec<f64> = (0..RESAMPLES)
        .map(|_| of(&(0..objects).flat_map(|_| members[rng.random_range(0..objects)].clone()).collect::<Vec<_>>()))
        .collect();
    let (low, high) = interval(drawn.clone());
    let within: Vec<f64> = members.iter().map(|m| of(m)).filter(|a| a.is_finite()).collect();
    println!(
        "{name}: AUC {:.3}, 95 % interval {low:.3} to {high:.3}; mean within an object {:.3} ({} objects with both outcomes)",
        auc(scores, labels),
        within.iter().sum::<f64>() / within.len() as f64,
        within.len()
    );
    drawn
}

/// Between the lowest and the highest fortieth.
fn interval(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    (values[values.len() / 40], values[values.len() - values.len() / 40 - 1])
}
