//! The training loop of the first phase, from demonstrations.

mod checkpoint;
mod rollout;

use std::f64::consts::PI;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use drex_core::Pose;
use rand::RngExt;

use crate::adam::Adam;
use crate::evaluate::{baselines, grasp_errors, log_densities, mode_reports, proposals};
use crate::loss::{Found, LossParts, Scales, Target, demo_loss};
use crate::net::{Derivatives, gradients};
use crate::norm::{Normalisation, grip_force_ratio, joint_intervals, outputs_for, wrist_numbers};
use crate::policy::{Card, LARGEST_OBJECT, Scene, check_size, same_hand};
use crate::sample::normal_vector;
use crate::split::{Split, Stream, random_of_epoch, shuffle, spread_grasps};
use crate::view::{View, turn};
use crate::weights::{Layout, Weights};
use crate::{Dataset, EpochStats, Error, GraspPolicy, GraspSample, Result, RolloutStats, TrainOptions, TrainReport};

pub use rollout::{Feedback, Rollouts};

/// After this share of the steps only the likelihood itself is maximised: each mode then settles at the centre of the grasps it explains.
const SHARE_ENDS: f64 = 0.8;

/// The spreads never fall below these: angles in rad, translation in lengths. A mode on top of a demonstration must not become a spike.
const LEAST_SPREAD: f64 = 0.02;

impl GraspPolicy {
    /// Learns from demonstrations. `progress` is called after each epoch and may end the training there; the policy learned so far is
    /// returned. [`Trainer`] does the same step by step, with checkpoints and with grasps tried in rollouts.
    ///
    /// The same data, options and seed give the same policy, byte for byte, with any number of threads on the same type of processor.
    ///
    /// # Errors
    /// [`Error::Option`] and [`Error::Dataset`] if the input cannot be used, [`Error::Diverged`] if the loss stops being a number,
    /// [`Error::NoBackend`] if the crate was built without one.
    pub fn train(
        data: &Dataset,
        options: &TrainOptions,
        progress: &mut dyn FnMut(EpochStats) -> ControlFlow<()>,
    ) -> Result<(GraspPolicy, TrainReport)> {
        let mut trainer = Trainer::new(data, options)?;
        while let Some(stats) = trainer.learn()? {
            if progress(stats).is_break() {
                break;
            }
        }
        trainer.finish()
    }
}

/// A training run that goes on epoch by epoch, can be saved after each and resumed.
///
/// ```no_run
/// # fn run(data: &drex_policy::Dataset, rollouts: &dyn drex_policy::Rollouts) -> Result<(), drex_policy::Error> {
/// use drex_policy::{TrainOptions, Trainer};
/// let folder = std::path::Path::new("checkpoints");
/// let mut trainer = Trainer::resume_or_new(data, &TrainOptions::default(), folder)?;
/// while let Some(stats) = trainer.learn()? {
///     if stats.epoch % 20 == 19 {
///         trainer.save(folder)?;
///     }
/// }
/// while let Some(_stats) = trainer.roll_out(rollouts)? {
///     trainer.save(folder)?;
/// }
/// let (policy, report) = trainer.finish()?;
/// # Ok(())
/// # }
/// ```
pub struct Trainer<'a> {
    data: &'a Dataset,
    split: Split,
    policy: GraspPolicy,
    adam: Adam,
    curve: Vec<EpochStats>,
    second: rollout::Second,
    seconds: f64,
    prepared: Prepared,
}

/// What follows from the data and the options alone.
struct Prepared {
    views: Vec<View>,
    /// As a prediction sees each object.
    scenes: Vec<Scene>,
    /// The palm of each sample in the network's frame, unturned.
    poses: Vec<Pose>,
}

impl<'a> Trainer<'a> {
    /// Ready for the first epoch.
    ///
    /// # Errors
    /// [`Error::Option`] and [`Error::Dataset`] if the input cannot be used.
    pub fn new(data: &'a Dataset, options: &TrainOptions) -> Result<Self> {
        options.validate()?;
        data.validate()?;
        check_clouds(data, options)?;
        let split = Split::new(data, options.hold_out_every, options.seed);
        let learned = split.train.iter().flatten().map(|&s| &data.samples[s]);
        let norm = Normalisation::new(learned, options.length_m);
        let layout = Layout {
            joints: data.joint_names.len(),
            modes: options.modes.min(split.train.len()),
            hidden: options.hidden,
            frequencies: options.frequencies,
            fingers: data.fingers.len(),
        };
        let card = Card::new(data, options, layout, norm);
        let policy = GraspPolicy { card, weights: Weights::initial(layout, options.seed) };
        let mut trainer = Self::around(data, split, policy);
        trainer.start_modes();
        Ok(trainer)
    }

    fn around(data: &'a Dataset, split: Split, policy: GraspPolicy) -> Self {
        let views: Vec<View> = data.objects.iter().map(|o| View::new(&o.points, o.up(), policy.card.points)).collect();
        let scenes: Vec<Scene> = views.iter().map(|v| policy.look(v, None)).collect();
        let pose = |s: &GraspSample| scenes[s.object].frame.network_from_object * s.object_from_base;
        let poses = data.samples.iter().map(pose).collect();
        let adam = Adam::new(&policy.weights.arrays);
        let second = rollout::Second::new(data.objects.len(), policy.modes());
        Self {
            data,
            split,
            policy,
            adam,
            curve: Vec::new(),
            second,
            seconds: 0.0,
            prepared: Prepared { views, scenes, poses },
        }
    }

    /// Each mode starts as one of the demonstrations, and the spreads as those of the others about the nearest start.
    fn start_modes(&mut self) {
        let (card, layout) = (&self.policy.card, self.policy.card.network);
        let poses = &self.prepared.poses;
        let (length, seed) = (card.normalisation.length_m, card.training.seed);
        let starts = spread_grasps(self.data, poses, &self.split.train, layout.modes, length, seed);
        for (mode, &s) in starts.iter().enumerate() {
            let outputs = outputs_for(&self.data.joint_limits, &self.data.samples[s], &poses[s], &card.normalisation);
            self.policy.weights.mode_bias(mode).copy_from_slice(&outputs);
        }
        let mut squares = vec![0.0; layout.spreads()];
        let grasp = |s: usize| (&*self.data.samples[s].joints, &poses[s]);
        let mut count = 0.0;
        for s in self.split.train.iter().filter_map(|g| g.first().copied()) {
            let distance = |&&start: &&usize| crate::grasp_distance_m(grasp(s), grasp(start), length);
            let nearest = starts.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
            let Some(&nearest) = nearest else { continue };
            for (j, square) in squares[..layout.joints].iter_mut().enumerate() {
                *square += (self.data.samples[s].joints[j] - self.data.samples[nearest].joints[j]).powi(2);
            }
            let gap = (poses[s].translation.vector - poses[nearest].translation.vector).norm_squared();
            squares[layout.joints] += gap / (3.0 * length * length);
            squares[layout.joints + 1] += poses[s].rotation.angle_to(&poses[nearest].rotation).powi(2) / 3.0;
            count += 1.0;
        }
        for (spread, square) in self.policy.weights.log_spread_mut().iter_mut().zip(squares) {
            *spread = (square / f64::max(count, 1.0)).sqrt().max(2.0 * LEAST_SPREAD).ln() as f32;
        }
    }

    /// One pass over the demonstrations; none after the last epoch of the options.
    ///
    /// # Errors
    /// [`Error::Diverged`] if the loss stops being a number, [`Error::NoBackend`] if the crate was built without one.
    pub fn learn(&mut self) -> Result<Option<EpochStats>> {
        let epoch = self.curve.len();
        if epoch >= self.options().epochs || self.second.started() {
            return Ok(None);
        }
        let started = Instant::now();
        let parts = self.pass(epoch)?;
        let length = self.options().length_m;
        let held_out: Vec<usize> = self.split.held_out.iter().flatten().copied().collect();
        let proposed = proposals(&self.policy, &self.prepared.scenes, self.data, &held_out)?;
        let held_out: Vec<&GraspSample> = held_out.iter().map(|&s| &self.data.samples[s]).collect();
        let densities = log_densities(&self.policy, &held_out, &proposed);
        let stats = EpochStats {
            epoch,
            joint_loss: parts.joint,
            wrist_loss: parts.wrist * length * length,
            force_loss: parts.force,
            contact_loss: parts.contact,
            nll: parts.nll + 3.0 * length.ln(),
            total: parts.total,
            held_out: grasp_errors(&held_out, length, |i| proposed[i].clone()),
            held_out_log_likelihood: densities.map(|d| d.1),
            held_out_joint_log_likelihood: densities.map(|d| d.0),
        };
        self.curve.push(stats);
        self.seconds += started.elapsed().as_secs_f64();
        Ok(Some(stats))
    }

    /// One pass over the samples, each batch of one object in one pose; the means of the terms of the loss.
    fn pass(&mut self, epoch: usize) -> Result<LossParts> {
        let options = self.options().clone();
        let mut order = random_of_epoch(options.seed, Stream::Order, epoch);
        let mut noise = random_of_epoch(options.seed, Stream::Noise, epoch);
        let batches = self.batches(options.batch, &mut order);
        let samples: usize = batches.iter().map(Vec::len).sum();
        let mut mean = LossParts::default();
        for (i, batch) in batches.iter().enumerate() {
            let done = (epoch as f64 + i as f64 / batches.len() as f64) / options.epochs as f64;
            let rate = options.learning_rate * 0.5 * (1.0 + (PI * done).cos());
            let mut scales = self.scales();
            scales.share = options.share * (1.0 - done / SHARE_ENDS).max(0.0);
            let scene = self.shaken(self.data.samples[batch[0]].object, &mut noise);
            let (scalars, targets) = self.targets(batch, &scene);
            let weights = &self.policy.weights;
            let (parts, gradient) = gradients(weights, &scene.encoded, &scalars, |outputs| {
                let found = demo_loss(&weights.layout, outputs, weights.log_spread(), &targets, &scales, true);
                let Found { parts, outputs, log_spread, .. } = found;
                (parts, Derivatives { outputs, log_spread })
            })?;
            if !parts.total.is_finite() {
                return Err(Error::Diverged { epoch, loss: parts.total, learning_rate: options.learning_rate });
            }
            self.step(&gradient, rate);
            mean.add(&parts, batch.len() as f64 / samples as f64);
        }
        Ok(mean)
    }

    /// The training samples in random order, in batches of one object each.
    fn batches(&self, size: usize, random: &mut rand_chacha::ChaCha8Rng) -> Vec<Vec<usize>> {
        let mut batches = Vec::new();
        let mut samples: Vec<usize> = self.split.train.iter().flatten().copied().collect();
        shuffle(&mut samples, random);
        for object in 0..self.data.objects.len() {
            let own: Vec<usize> = samples.iter().copied().filter(|&s| self.data.samples[s].object == object).collect();
            batches.extend(own.chunks(size).map(<[usize]>::to_vec));
        }
        shuffle(&mut batches, random);
        batches
    }

    /// An object in a random pose, its points shaken.
    fn shaken(&self, object: usize, noise: &mut rand_chacha::ChaCha8Rng) -> Scene {
        let o = self.options();
        let yaw = o.yaw_range_rad * noise.random_range(-1.0..1.0);
        let mut lean = normal_vector(noise) * o.tilt_rad;
        lean.z = 0.0;
        let shift = normal_vector(noise) * o.shift_m;
        let view = &self.prepared.views[object];
        let frame = view.frame(&turn(yaw, lean), &shift, None);
        let encoded = view.encode(&frame, o.length_m, o.frequencies, || normal_vector(noise) * o.point_noise_m);
        Scene { frame, encoded }
    }

    /// Samples in the network's numbers, as seen in a scene of their object.
    fn targets(&self, batch: &[usize], scene: &Scene) -> (Vec<f32>, Vec<Target>) {
        let norm = &self.policy.card.normalisation;
        let (mut scalars, mut targets) = (Vec::new(), Vec::new());
        for &s in batch {
            let sample = &self.data.samples[s];
            scalars.extend(norm.scalars(sample.mass_kg, sample.friction, scene.frame.table_m));
            targets.push(Target {
                joints: sample.joints.clone(),
                wrist: wrist_numbers(&(scene.frame.network_from_object * sample.object_from_base), norm.length_m),
                log_ratio: grip_force_ratio(sample).ln(),
                contacts: sample.contacts.clone(),
                weight: 1.0,
            });
        }
        (scalars, targets)
    }

    fn step(&mut self, gradient: &[Vec<f32>], rate: f64) {
        self.adam.step(&mut self.policy.weights.arrays, gradient, rate);
        let least = LEAST_SPREAD.ln() as f32;
        self.policy.weights.log_spread_mut().iter_mut().for_each(|s| *s = s.max(least));
    }

    fn scales(&self) -> Scales {
        Scales {
            joint_intervals: joint_intervals(&self.policy.card.joint_limits_rad),
            log_ratio_interval: self.policy.card.normalisation.log_ratio_interval(),
            share: 0.0,
            nearest_weight: self.options().nearest_weight,
            force_weight: self.options().force_weight,
            contact_weight: self.options().contact_weight,
        }
    }

    /// The policy as it is now.
    pub fn policy(&self) -> &GraspPolicy {
        &self.policy
    }

    /// The settings of this run.
    pub fn options(&self) -> &TrainOptions {
        &self.policy.card.training
    }

    /// Finished epochs of the first phase.
    pub fn epochs(&self) -> &[EpochStats] {
        &self.curve
    }

    /// Finished rounds of rollouts.
    pub fn rollouts(&self) -> &[RolloutStats] {
        &self.second.curve
    }

    /// The policy and the record of the run.
    ///
    /// # Errors
    /// As [`learn`](Self::learn).
    pub fn finish(self) -> Result<(GraspPolicy, TrainReport)> {
        let (data, split, scenes) = (self.data, &self.split, &self.prepared.scenes);
        let held_out: Vec<usize> = split.held_out.iter().flatten().copied().collect();
        let proposed = proposals(&self.policy, scenes, data, &held_out)?;
        let held_out: Vec<&GraspSample> = held_out.iter().map(|&s| &data.samples[s]).collect();
        let densities = log_densities(&self.policy, &held_out, &proposed);
        let report = TrainReport {
            train_samples: split.train.iter().map(Vec::len).sum(),
            held_out_samples: held_out.len(),
            train_grasps: split.train.len(),
            held_out_grasps: split.held_out.len(),
            parameters: self.policy.weights.layout.parameters(),
            modes: mode_reports(&self.policy, data, split, scenes)?,
            held_out: grasp_errors(&held_out, self.options().length_m, |i| proposed[i].clone()),
            held_out_log_likelihood: densities.map(|d| d.1),
            held_out_joint_log_likelihood: densities.map(|d| d.0),
            spread: self.policy.spread(),
            baselines: baselines(&self.policy, data, split, scenes, &self.prepared.poses),
            stopped_early: self.curve.len() < self.options().epochs,
            options: self.options().clone(),
            seconds: self.seconds,
            rollouts: self.second.curve,
            curve: self.curve,
        };
        Ok((self.policy, report))
    }

    /// Writes the whole state into `folder/checkpoint.safetensors`, in one step: whenever the process dies, the folder holds the old
    /// checkpoint or the new one.
    ///
    /// # Errors
    /// [`Error::Core`] if the file cannot be written.
    pub fn save(&self, folder: &Path) -> Result<()> {
        checkpoint::save(self, folder)
    }

    /// Goes on where [`save`](Self::save) stopped: the run ends with the same bytes as one that was never interrupted.
    ///
    /// # Errors
    /// [`Error::Core`] if the file cannot be read, [`Error::File`] if it is damaged, of another version or made with other data,
    /// [`Error::Hand`] if the data are of another hand or have other joints.
    pub fn resume(data: &'a Dataset, folder: &Path) -> Result<Self> {
        data.validate()?;
        checkpoint::load(data, folder)
    }

    /// [`resume`](Self::resume) if `folder` holds a checkpoint, otherwise [`new`](Self::new).
    ///
    /// # Errors
    /// As those, and [`Error::File`] if the checkpoint was made with other options.
    pub fn resume_or_new(data: &'a Dataset, options: &TrainOptions, folder: &Path) -> Result<Self> {
        if !checkpoint::path(folder).exists() {
            return Self::new(data, options);
        }
        let trainer = Self::resume(data, folder)?;
        if trainer.options() != options {
            let what = "the checkpoint was made with other options";
            return Err(Error::file(&checkpoint::path(folder), what, "use those options, or remove the checkpoint"));
        }
        Ok(trainer)
    }
}

fn check_clouds(data: &Dataset, options: &TrainOptions) -> Result<()> {
    let remedy = "give metres, or set the option 'length_m' to the size of the hand";
    let mut centres = Vec::new();
    for object in &data.objects {
        let name = &object.name;
        if object.points.len() < options.points {
            let what = format!(
                "object '{name}' has {} surface points, but the network takes {}",
                object.points.len(),
                options.points
            );
            return Err(data.wrong(None, None, what, "sample the surface more densely or lower the option 'points'"));
        }
        check_size(&object.points, options.length_m)
            .map_err(|what| data.wrong(None, None, format!("object '{name}': {what}"), remedy))?;
        centres.push(crate::cloud::box_centre(&object.points));
    }
    let most = LARGEST_OBJECT * options.length_m;
    for (i, sample) in data.samples.iter().enumerate() {
        let gap = (sample.object_from_base.translation.vector - centres[sample.object]).norm();
        if gap > most {
            let what = format!("the hand is {gap:.3} m from the object, more than {most} m");
            return Err(data.wrong(Some(i), None, what, remedy));
        }
    }
    Ok(())
}
