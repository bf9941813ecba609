//! The training loop.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::time::Instant;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::adam::Adam;
use crate::cloud::{box_centre, encode, farthest_points};
use crate::evaluate::{baselines, grasp_errors, mode_reports};
use crate::net::{Batch, LossParts, Scales, loss_and_gradients};
use crate::norm::{Normalisation, joint_intervals, outputs_for, relative_to, squeeze_per_weight, wrist_numbers};
use crate::policy::{Card, LARGEST_OBJECT, Scene, check_size};
use crate::split::{Split, Stream, random, shuffle, spread_grasps};
use crate::weights::{Layout, Weights};
use crate::{
    Dataset, EpochStats, Error, GraspErrors, GraspPolicy, GraspSample, PredictedGrasp, Result, TrainOptions,
    TrainReport,
};

/// After this share of the steps only the winning mode learns: each mode then settles at the centre of the grasps it wins.
const SHARE_ENDS: f64 = 0.8;

/// See [`GraspPolicy::train`].
pub(crate) fn train(
    data: &Dataset,
    options: &TrainOptions,
    progress: &mut dyn FnMut(EpochStats) -> ControlFlow<()>,
) -> Result<(GraspPolicy, TrainReport)> {
    let started = Instant::now();
    options.validate()?;
    data.validate()?;
    check_cloud(data, options)?;
    let split = Split::new(data, options.hold_out_every, options.seed);
    let samples_of = |grasps: &[Vec<usize>]| grasps.iter().flatten().map(|&s| &data.samples[s]).collect::<Vec<_>>();
    let (learned, held_out) = (samples_of(&split.train), samples_of(&split.held_out));

    let mut policy = initial_policy(data, options, &split, &learned)?;
    let mut trainer = Trainer::new(data, options, &policy, &learned);
    let mut adam = Adam::new(&policy.weights.arrays);
    let scene = policy.look(&data.points);
    let mut curve = Vec::new();
    let mut stopped_early = false;
    for epoch in 0..options.epochs {
        let parts = trainer.epoch(epoch, &mut policy.weights, &mut adam)?;
        let errors = held_out_errors(&policy, &scene, &held_out)?;
        let stats = EpochStats {
            epoch,
            joint_loss: parts.joint,
            wrist_loss: parts.wrist,
            force_loss: parts.force,
            mode_loss: parts.mode,
            total: parts.total,
            held_out: errors,
        };
        curve.push(stats);
        if progress(stats).is_break() {
            stopped_early = epoch + 1 < options.epochs;
            break;
        }
    }
    let report = TrainReport {
        train_samples: learned.len(),
        held_out_samples: held_out.len(),
        train_grasps: split.train.len(),
        held_out_grasps: split.held_out.len(),
        parameters: policy.weights.layout.parameters(),
        modes: mode_reports(&policy, data, &split)?,
        held_out: curve.last().and_then(|s| s.held_out),
        baselines: baselines(data, &split, policy.modes(), options),
        curve,
        stopped_early,
        options: options.clone(),
        seconds: started.elapsed().as_secs_f64(),
    };
    Ok((policy, report))
}

/// Errors of the policy as it is; each mass is asked once.
fn held_out_errors(policy: &GraspPolicy, scene: &Scene, held_out: &[&GraspSample]) -> Result<Option<GraspErrors>> {
    let mut by_mass: BTreeMap<u64, Vec<PredictedGrasp>> = BTreeMap::new();
    for sample in held_out {
        if let Entry::Vacant(entry) = by_mass.entry(sample.mass_kg.to_bits()) {
            entry.insert(policy.propose(scene, sample.mass_kg)?);
        }
    }
    let proposed = |s: &GraspSample| by_mass.get(&s.mass_kg.to_bits()).cloned().unwrap_or_default();
    Ok(grasp_errors(held_out, policy.card.normalisation.length_m, proposed))
}

fn check_cloud(data: &Dataset, options: &TrainOptions) -> Result<()> {
    if data.points.len() < options.points {
        let what = format!("{} surface points, but the network takes {}", data.points.len(), options.points);
        return Err(data.wrong(None, None, what, "sample the surface more densely or lower the option 'points'"));
    }
    let remedy = "give metres, or set the option 'length_m' to the size of the hand";
    check_size(&data.points, options.length_m).map_err(|what| data.wrong(None, None, what, remedy))?;
    let centre = box_centre(&data.points);
    let most = LARGEST_OBJECT * options.length_m;
    for (i, sample) in data.samples.iter().enumerate() {
        let gap = (sample.object_from_palm.translation.vector - centre).norm();
        if gap > most {
            let what = format!("the palm is {gap:.3} m from the object, more than {most} m");
            return Err(data.wrong(Some(i), None, what, remedy));
        }
    }
    Ok(())
}

/// The untrained policy: each mode starts as one of the demonstrations.
fn initial_policy(
    data: &Dataset,
    options: &TrainOptions,
    split: &Split,
    learned: &[&GraspSample],
) -> Result<GraspPolicy> {
    let norm = Normalisation::new(learned.iter().copied(), options.length_m);
    let layout = Layout {
        joints: data.joint_names.len(),
        modes: options.modes.min(split.train.len()),
        hidden: options.hidden,
        frequencies: options.frequencies,
    };
    let centre = box_centre(&data.points);
    let mut weights = Weights::initial(layout, options.seed);
    let starts = spread_grasps(data, &split.train, layout.modes, options.length_m, options.seed);
    for (mode, &sample) in starts.iter().enumerate() {
        let outputs = outputs_for(data, &data.samples[sample], &centre, &norm);
        weights.mode_bias(mode).copy_from_slice(&outputs);
    }
    let card = Card::new(data, options, layout, norm);
    Ok(GraspPolicy { card, weights })
}

/// What stays the same over the epochs, and the streams of random numbers.
struct Trainer<'a> {
    options: &'a TrainOptions,
    samples: &'a [&'a GraspSample],
    norm: Normalisation,
    scales: Scales,
    /// All points of the object, for the centre of its box.
    points: &'a [Point3<f64>],
    /// Those that enter the network.
    cloud: Vec<Point3<f64>>,
    order: ChaCha8Rng,
    noise: ChaCha8Rng,
}

impl<'a> Trainer<'a> {
    fn new(data: &'a Dataset, options: &'a TrainOptions, policy: &GraspPolicy, samples: &'a [&'a GraspSample]) -> Self {
        Self {
            options,
            samples,
            norm: policy.card.normalisation,
            scales: Scales {
                joint_intervals: joint_intervals(&data.joint_limits),
                log_ratio_interval: policy.card.normalisation.log_ratio_interval(),
                length_m: options.length_m,
                share: options.share,
                force_weight: options.force_weight,
                mode_weight: options.mode_weight,
            },
            points: &data.points,
            cloud: farthest_points(&data.points, &box_centre(&data.points), options.points),
            order: random(options.seed, Stream::Order),
            noise: random(options.seed, Stream::Noise),
        }
    }

    /// One pass over the samples in random order; the means of the terms of the loss.
    fn epoch(&mut self, epoch: usize, weights: &mut Weights, adam: &mut Adam) -> Result<LossParts> {
        let mut order: Vec<usize> = (0..self.samples.len()).collect();
        shuffle(&mut order, &mut self.order);
        let batches = order.len().div_ceil(self.options.batch);
        let mut mean = LossParts::default();
        for (i, batch) in order.chunks(self.options.batch).enumerate() {
            let done = (epoch as f64 + i as f64 / batches as f64) / self.options.epochs as f64;
            let rate = self.options.learning_rate * 0.5 * (1.0 + (PI * done).cos());
            self.scales.share = self.options.share * (1.0 - done / SHARE_ENDS).max(0.0);
            let (parts, gradients) = self.gradients(batch, weights)?;
            if !parts.total.is_finite() {
                return Err(Error::Diverged { epoch, loss: parts.total, learning_rate: self.options.learning_rate });
            }
            adam.step(&mut weights.arrays, &gradients, rate);
            let part = batch.len() as f64 / order.len() as f64;
            mean.joint += part * parts.joint;
            mean.wrist += part * parts.wrist;
            mean.force += part * parts.force;
            mean.mode += part * parts.mode;
            mean.total += part * parts.total;
        }
        Ok(mean)
    }

    /// Loss and gradients of one batch, with object and wrists turned and the points shaken.
    fn gradients(&mut self, batch: &[usize], weights: &Weights) -> Result<(LossParts, Vec<Vec<f32>>)> {
        let yaw = self.options.yaw_range_rad * self.noise.random_range(-1.0..1.0);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        // The box of the turned object is another box: a prediction will see its centre, not the turned one.
        let centre = box_centre(&self.points.iter().map(|p| turn * p).collect::<Vec<_>>());
        let mut encoded = Vec::new();
        for p in &self.cloud {
            let shaken = (turn * p).coords - centre + normal_vector(&mut self.noise) * self.options.point_noise_m;
            encode(&shaken, self.options.length_m, self.options.frequencies, &mut encoded);
        }
        let (mut mass, mut joints, mut wrist, mut log_ratio) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for &sample in batch {
            let sample = self.samples[sample];
            mass.push(self.norm.mass_input(sample.mass_kg));
            joints.extend(sample.joints.iter().map(|v| *v as f32));
            let pose = relative_to(&(turn * sample.object_from_palm), &centre);
            wrist.extend(wrist_numbers(&pose, self.options.length_m).map(|v| v as f32));
            log_ratio.push(squeeze_per_weight(sample).ln() as f32);
        }
        let batch = Batch { encoded: &encoded, mass: &mass, joints: &joints, wrist: &wrist, log_ratio: &log_ratio };
        loss_and_gradients(weights, &batch, &self.scales)
    }
}

/// Three independent standard normal numbers (Box and Muller 1958).
fn normal_vector(random: &mut ChaCha8Rng) -> Vector3<f64> {
    let mut pair = || {
        let radius = (-2.0 * (1.0 - random.random_range(0.0..1.0_f64)).ln()).sqrt();
        let angle = random.random_range(0.0..2.0 * PI);
        (radius * angle.cos(), radius * angle.sin())
    };
    let ((x, y), (z, _)) = (pair(), pair());
    Vector3::new(x, y, z)
}

#[cfg(all(test, feature = "flex"))]
mod tests {
    use super::*;
    use drex_core::Pose;

    #[test]
    fn numbers_that_overflow_stop_the_training() {
        let sample =
            GraspSample { joints: vec![0.5], object_from_palm: Pose::identity(), squeeze_n: 4.0, mass_kg: 0.2 };
        let data = Dataset {
            joint_names: vec!["j".into()],
            joint_limits: vec![(0.0, 1.0)],
            hand: "toy".into(),
            points: (0..8)
                .map(|i| Point3::new(f64::from(i % 2), f64::from(i / 2 % 2), f64::from(i / 4)) * 0.1)
                .collect(),
            samples: vec![sample],
        };
        let options = TrainOptions::default().with_points(8).with_hidden(4);
        let split = Split::new(&data, 0, 0);
        let learned = [&data.samples[0]];
        let mut policy = initial_policy(&data, &options, &split, &learned).unwrap();
        let mut trainer = Trainer::new(&data, &options, &policy, &learned);
        let mut adam = Adam::new(&policy.weights.arrays);
        assert!(trainer.epoch(0, &mut policy.weights, &mut adam).is_ok());
        policy.weights.arrays.iter_mut().flatten().for_each(|w| *w = f32::MAX);
        let message = trainer.epoch(7, &mut policy.weights, &mut adam).unwrap_err().to_string();
        assert!(message.contains("epoch 7") && message.contains("lower the learning rate"), "{message}");
    }
}
