//! Which demonstrations are trained on, which are held out, and which grasps the modes start from.

use std::collections::BTreeMap;

use drex_core::Pose;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{Dataset, GraspSample, grasp_distance_m};

/// Independent streams of random numbers of one seed, so that using more of one does not change another.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Stream {
    Split = 1,
    Modes = 2,
    Order = 3,
    Noise = 4,
    Baseline = 5,
    Rollouts = 6,
    Sample = 7,
}

pub(crate) fn random(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(stream as u64);
    random
}

/// The random numbers of one epoch. They depend on nothing before it, so that training can go on from any epoch.
pub(crate) fn random_of_epoch(seed: u64, stream: Stream, epoch: usize) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream((epoch as u64 + 1) << 8 | stream as u64);
    random
}

/// Fisher-Yates.
pub(crate) fn shuffle<T>(items: &mut [T], random: &mut ChaCha8Rng) {
    for i in (1..items.len()).rev() {
        items.swap(i, random.random_range(0..=i));
    }
}

/// Distinct grasps; each lists the samples (one per mass) that share its joints and its wrist.
#[derive(Debug, Clone)]
pub(crate) struct Split {
    pub train: Vec<Vec<usize>>,
    pub held_out: Vec<Vec<usize>>,
}

impl Split {
    /// Keeps whole grasps out, not samples: the same grasp at another mass would give the answer away.
    pub fn new(data: &Dataset, every: usize, seed: u64) -> Self {
        let mut grasps = distinct_grasps(&data.samples);
        shuffle(&mut grasps, &mut random(seed, Stream::Split));
        let (mut train, mut held_out) = (Vec::new(), Vec::new());
        for (i, grasp) in grasps.into_iter().enumerate() {
            let out = every > 0 && i % every == every - 1;
            if out { held_out.push(grasp) } else { train.push(grasp) }
        }
        Self { train, held_out }
    }
}

fn distinct_grasps(samples: &[GraspSample]) -> Vec<Vec<usize>> {
    let mut index: BTreeMap<Vec<u64>, usize> = BTreeMap::new();
    let mut grasps: Vec<Vec<usize>> = Vec::new();
    for (i, s) in samples.iter().enumerate() {
        let wrist = s.object_from_base.translation.vector.iter().chain(s.object_from_base.rotation.coords.iter());
        let numbers = s.joints.iter().chain(wrist).map(|v| v.to_bits());
        let key: Vec<u64> = std::iter::once(s.object as u64).chain(numbers).collect();
        let at = *index.entry(key).or_insert(grasps.len());
        match grasps.get_mut(at) {
            Some(grasp) => grasp.push(i),
            None => grasps.push(vec![i]),
        }
    }
    grasps
}

/// `count` grasps to start the modes from (sample indices), spread over the training grasps: the first at random, each next one with
/// probability proportional to the squared distance to the nearest one chosen (k-means++, Arthur and Vassilvitskii 2007).
/// `poses` are the palms of all samples in the network's frame, so that grasps of several objects can be compared.
pub(crate) fn spread_grasps(
    data: &Dataset,
    poses: &[Pose],
    grasps: &[Vec<usize>],
    count: usize,
    length_m: f64,
    seed: u64,
) -> Vec<usize> {
    let mut random = random(seed, Stream::Modes);
    let samples: Vec<usize> = grasps.iter().filter_map(|g| g.first().copied()).collect();
    if samples.is_empty() {
        return samples;
    }
    let mut chosen = vec![samples[random.random_range(0..samples.len())]];
    let mut gap = vec![f64::INFINITY; samples.len()];
    while chosen.len() < count.min(samples.len()) {
        let last = chosen[chosen.len() - 1];
        for (gap, &s) in gap.iter_mut().zip(&samples) {
            let grasp = |s: usize| (&*data.samples[s].joints, &poses[s]);
            *gap = gap.min(grasp_distance_m(grasp(s), grasp(last), length_m).powi(2));
        }
        let mut target = random.random_range(0.0..1.0) * gap.iter().sum::<f64>();
        // The last grasp with a gap stands in when rounding leaves a rest.
        let mut next = gap.iter().rposition(|g| *g > 0.0).unwrap_or(0);
        for (i, g) in gap.iter().enumerate() {
            target -= g;
            if target < 0.0 && *g > 0.0 {
                next = i;
                break;
            }
        }
        chosen.push(samples[next]);
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    fn data(angles: &[f64], masses: &[f64]) -> Dataset {
        let sample = |angle: f64, mass_kg: f64| GraspSample {
            object: 0,
            joints: vec![angle],
            object_from_base: Pose::identity(),
            contacts: vec![true],
            grip_force_n: 20.0 * mass_kg,
            mass_kg,
            friction: 0.5,
        };
        Dataset {
            joint_names: vec!["j".into()],
            joint_limits: vec![(-10.0, 10.0)],
            hand: "toy".into(),
            fingers: vec!["f".into()],
            objects: vec![],
            samples: angles.iter().flat_map(|a| masses.iter().map(move |m| sample(*a, *m))).collect(),
        }
    }

    #[test]
    fn a_grasp_is_held_out_with_all_its_masses() {
        let angles: Vec<f64> = (0..20).map(f64::from).map(|v| v / 10.0).collect();
        let data = data(&angles, &[0.1, 0.2, 0.3]);
        let split = Split::new(&data, 4, 1);
        assert_eq!((split.train.len(), split.held_out.len()), (15, 5));
        assert!(split.train.iter().chain(&split.held_out).all(|g| g.len() == 3));
        for grasp in &split.held_out {
            let angle = data.samples[grasp[0]].joints[0];
            assert!(split.train.iter().flatten().all(|s| data.samples[*s].joints[0] != angle));
        }
        let other = Split::new(&data, 4, 2);
        assert_ne!(split.held_out, other.held_out, "the split follows the seed");
        assert!(Split::new(&data, 0, 1).held_out.is_empty());
    }

    #[test]
    fn modes_start_in_every_cluster() {
        // Three tight clusters of very different sizes: three draws must hit all three.
        let angles: Vec<f64> =
            (0..50).map(|i| [0.0, 2.0, -3.0][[0, 0, 0, 0, 1, 0, 2][i % 7]] + 1e-4 * i as f64).collect();
        let data = data(&angles, &[0.1]);
        let split = Split::new(&data, 0, 1);
        for seed in 0..10 {
            let chosen = spread_grasps(&data, &vec![Pose::identity(); 50], &split.train, 3, 0.1, seed);
            let mut clusters: Vec<i32> = chosen.iter().map(|s| data.samples[*s].joints[0].round() as i32).collect();
            clusters.sort();
            assert_eq!(clusters, [-3, 0, 2]);
        }
    }
}
