//! The second phase: proposed grasps are tried, and contacts, mode probabilities and grip forces learn from what happened.
//!
//! No gradient passes through a rollout. Each round tries single modes of random views at random mass and friction, then takes a few
//! steps on, per try of mode k:
//!
//! - contacts: cross-entropy with the fingers that touched;
//! - modes: cross-entropy with π* ∝ π⁰ exp(ρ / τ), where π⁰ are the probabilities of the first phase and ρ the reward to expect of each mode on
//!   this object at this mass and friction: the mean over its tries, the nearer in load and the later the more they count (a kernel
//!   regression after Nadaraya and Watson). That is the distribution of the largest mean reward for its divergence from π⁰ (τ prices the
//!   divergence). A grasp that carries 80 g may not carry 200 g: the modes that are proposed change with the load;
//! - grip force: squared error of its logarithm to the larger of what the cone programme needs over the actual contacts and of the grip force
//!   at which the friction cone would be used by the wanted share;
//! - anchor: squared distance, in spreads, of joints and wrist of all modes to what the first phase taught;
//! - grip forces and contacts of the modes not tried stay as they were at the start of the round.
//!
//! Demonstrations go on pulling on joints and wrist, each counted by the rewards of the modes that stand for it.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Scene, Trainer, Weights};
use crate::density::log_sum_exp;
use crate::loss::{Mode, Scales, Target, demo_loss};
use crate::net::{self, Derivatives};
use crate::norm::Normalisation;
use crate::options::RolloutOptions;
use crate::split::{Stream, random_of_epoch, shuffle};
use crate::{Error, PredictedGrasp, Result, RolloutStats};

/// The feedback of a rollout on a grasp.
#[derive(Debug, Clone, PartialEq)]
pub struct Feedback {
    /// Which finger touched the object while it was to be held, in the order of the fingers of the data.
    pub fingers_in_contact: Vec<bool>,
    /// Share of the horizon in which at least `min_fingers` held the object, 0 .. 1.
    pub retained: f64,
    /// Whether the object was in the hand at the end.
    pub held: bool,
    /// Largest share of the friction cone in use while it was held, 0 .. 1: at 1 a contact slips.
    pub friction_used: Option<f64>,
    /// minimum grip force of the cone programme over the actual contacts, N.
    pub needed_grip_force_n: Option<f64>,
}

/// Tries grasps: a simulator behind a face that training knows. Tries run in parallel; the answer must depend on the arguments alone.
pub trait Rollouts: Sync {
    /// Tries `grasp` (in the frame of the object's points) on object number `object` of the data.
    ///
    /// # Errors
    /// If the rollout could not be run; a grasp that fails is no error.
    fn rollout(
        &self,
        object: usize,
        grasp: &PredictedGrasp,
        mass_kg: f64,
        friction: f64,
        seed: u64,
    ) -> Result<Feedback>;
}

/// State of the second phase.
pub(super) struct Second {
    /// The weights that the first phase ended with.
    pub anchor: Option<Weights>,
    pub curve: Vec<RolloutStats>,
    /// Rewards, per object and mode.
    pub tallies: Vec<Vec<Tally>>,
}

/// What was tried of a mode on an object, the latest last: mass, kg, friction, and the reward.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Tally(Vec<((f64, f64), f64)>);

/// What a reward counts for, one try later.
const MEMORY: f64 = 0.98;

/// Tries of a mode that are kept: the next older one would count 3e-5.
const REMEMBERED: usize = 512;

/// A try at so different a load, as a difference of logarithms, counts a quarter of one at the same load.
const OTHER_LOAD: f64 = 0.25;

/// A demonstration counts at least this much, whatever the rewards of its modes.
const LEAST_DEMO: f64 = 0.05;

impl Tally {
    fn add(&mut self, load: (f64, f64), reward: f64) {
        if self.0.len() == REMEMBERED {
            self.0.remove(0);
        }
        self.0.push((load, reward));
    }

    /// Sum of the rewards as far as they tell something about a load, and of what they count for.
    fn near(&self, load: (f64, f64)) -> (f64, f64) {
        let (mut sum, mut count, mut memory) = (0.0, 0.0, 1.0);
        for ((mass_kg, friction), reward) in self.0.iter().rev() {
            let far2 = (mass_kg / load.0).ln().powi(2) + (friction / load.1).ln().powi(2);
            // Falls off slowly, so that a mode that was not tried near here is evaluated by where it was.
            let weight = memory / (1.0 + far2 / OTHER_LOAD.powi(2)).powi(2);
            (sum, count) = (sum + weight * reward, count + weight);
            memory *= MEMORY;
        }
        (sum, count)
    }
}

impl Second {
    pub fn new(objects: usize, modes: usize) -> Self {
        Self { anchor: None, curve: Vec::new(), tallies: vec![vec![Tally::default(); modes]; objects] }
    }

    pub fn started(&self) -> bool {
        self.anchor.is_some()
    }

    /// Reward to expect of each mode on an object at a mass and a friction; that of all tried ones, as one try, where a mode has not been
    /// tried often near there.
    fn rewards(&self, object: usize, load: (f64, f64)) -> Vec<f64> {
        let near: Vec<(f64, f64)> = self.tallies[object].iter().map(|t| t.near(load)).collect();
        let count: f64 = near.iter().map(|n| n.1).sum();
        let mean = if count > 0.0 { near.iter().map(|n| n.0).sum::<f64>() / count } else { 0.5 };
        near.iter().map(|(sum, count)| (sum + mean) / (count + 1.0)).collect()
    }
}

/// A mode tried at a mass and a friction.
struct Try {
    mode: usize,
    load: (f64, f64),
    seed: u64,
    grasp: PredictedGrasp,
    feedback: Option<Feedback>,
}

/// The tries of one view, and the demonstrations that go with them.
struct Round {
    object: usize,
    scene: Scene,
    tries: Vec<Try>,
    /// At the masses and frictions `demo_loads`.
    demos: Vec<Target>,
    demo_loads: Vec<(f64, f64)>,
    /// Of tries, then demonstrations.
    scalars: Vec<f32>,
    /// Outputs at the start of the round, and of the first phase.
    before: Vec<f32>,
    anchor: Vec<f32>,
}

impl Trainer<'_> {
    /// One round of rollouts and what is learned from it; none after the last one of the options. The first round ends the first phase.
    ///
    /// # Errors
    /// What `rollouts` answers, [`Error::Rollout`] if its feedback cannot be used, [`Error::Diverged`] if the loss stops being a number.
    pub fn roll_out(&mut self, rollouts: &dyn Rollouts) -> Result<Option<RolloutStats>> {
        let options = self.options().rollouts.clone();
        let epoch = self.second.curve.len();
        if epoch >= options.epochs {
            return Ok(None);
        }
        let started = std::time::Instant::now();
        let anchor = match self.second.anchor.take() {
            Some(anchor) => anchor,
            None => {
                self.adam = crate::adam::Adam::new(&self.policy.weights.arrays);
                self.policy.weights.clone()
            }
        };
        let outcome = self.round(epoch, &options, &anchor, rollouts);
        self.second.anchor = Some(anchor);
        let stats = outcome?;
        self.second.curve.push(stats);
        self.seconds += started.elapsed().as_secs_f64();
        Ok(Some(stats))
    }

    fn round(
        &mut self,
        epoch: usize,
        options: &RolloutOptions,
        anchor: &Weights,
        rollouts: &dyn Rollouts,
    ) -> Result<RolloutStats> {
        let mut random = random_of_epoch(self.options().seed, Stream::Rollouts, epoch);
        let mut rounds = Vec::new();
        for _ in 0..options.scenes {
            rounds.push(self.draw(options, anchor, &mut random)?);
        }
        self.try_all(&mut rounds, rollouts)?;
        for (round, t) in rounds.iter().flat_map(|r| r.tries.iter().map(move |t| (r, t))) {
            if let Some(feedback) = &t.feedback {
                self.second.tallies[round.object][t.mode].add(t.load, reward(feedback));
            }
        }
        let mut stats = self.stats(epoch, options, &rounds);
        self.weigh_demos(&mut rounds, anchor);
        let rewards = |r: &Round| r.tries.iter().map(|t| self.second.rewards(r.object, t.load)).collect();
        let rewards: Vec<Vec<Vec<f64>>> = rounds.iter().map(rewards).collect();
        for _ in 0..options.passes {
            for (round, rewards) in rounds.iter().zip(&rewards) {
                let scales = self.scales();
                let weights = &self.policy.weights;
                let (loss, gradient) = net::gradients(weights, &round.scene.encoded, &round.scalars, |outputs| {
                    let learner = Learner {
                        weights,
                        anchor,
                        options,
                        scales: &scales,
                        norm: &self.policy.card.normalisation,
                        round,
                        rewards,
                    };
                    learner.loss(outputs)
                })?;
                if !loss.is_finite() {
                    return Err(Error::Diverged { epoch, loss, learning_rate: options.learning_rate });
                }
                self.step(&gradient, options.learning_rate);
            }
        }
        (stats.joint_drift_rad, stats.wrist_drift_m) = self.drift(&rounds)?;
        Ok(stats)
    }

    /// A random object in a random pose, with modes to try.
    fn draw(&self, options: &RolloutOptions, anchor: &Weights, random: &mut ChaCha8Rng) -> Result<Round> {
        let mut train: Vec<usize> = self.split.train.iter().flatten().copied().collect();
        // Objects are drawn as often as they have demonstrations, and only such as have any.
        let object = self.data.samples[train[random.random_range(0..train.len())]].object;
        train.retain(|&s| self.data.samples[s].object == object);
        shuffle(&mut train, random);
        train.truncate(options.tries);
        let scene = self.shaken(object, random);
        let (demo_scalars, demos) = self.targets(&train, &scene);
        let demo_loads = train.iter().map(|&s| (self.data.samples[s].mass_kg, self.data.samples[s].friction)).collect();
        let norm = self.policy.card.normalisation;
        let mut log_uniform = |(least, most): (f64, f64)| {
            let share: f64 = random.random_range(0.0..1.0);
            (least.ln() + share * (most / least).ln()).exp()
        };
        let ranges = (self.policy.mass_range_kg(), self.policy.friction_range());
        let loads: Vec<_> = (0..options.tries).map(|_| (log_uniform(ranges.0), log_uniform(ranges.1))).collect();
        let mut scalars: Vec<f32> = loads.iter().flat_map(|&(m, f)| norm.scalars(m, f, scene.frame.table_m)).collect();
        scalars.extend(demo_scalars);
        let before = net::outputs(&self.policy.weights, &scene.encoded, &scalars)?;
        let anchor = net::outputs(anchor, &scene.encoded, &scalars)?;
        let layout = self.policy.weights.layout;
        let first = random.random_range(0..layout.modes);
        let rows = before.chunks_exact(layout.modes * layout.mode_width());
        let mut tries = Vec::new();
        for (i, (row, &load)) in rows.zip(&loads).enumerate() {
            let mode = (first + i) % layout.modes;
            let grasp = self.policy.decode(row, &scene, load).swap_remove(mode);
            tries.push(Try { mode, load, seed: random.random(), grasp, feedback: None });
        }
        Ok(Round { object, scene, tries, demos, demo_loads, scalars, before, anchor })
    }

    /// Runs all tries in parallel; the answers are taken in order, so the number of threads changes nothing.
    fn try_all(&self, rounds: &mut [Round], rollouts: &dyn Rollouts) -> Result<()> {
        let all: Vec<(usize, &mut Try)> =
            rounds.iter_mut().flat_map(|r| r.tries.iter_mut().map(|t| (r.object, t))).collect();
        let answers: Vec<Result<()>> = all
            .into_par_iter()
            .map(|(object, t)| {
                let feedback = rollouts.rollout(object, &t.grasp, t.load.0, t.load.1, t.seed)?;
                self.check(object, t, &feedback)?;
                t.feedback = Some(feedback);
                Ok(())
            })
            .collect();
        answers.into_iter().collect()
    }

    fn check(&self, object: usize, t: &Try, feedback: &Feedback) -> Result<()> {
        let fingers = self.data.fingers.len();
        let what = if feedback.fingers_in_contact.len() != fingers {
            format!("{} contacts for {fingers} fingers", feedback.fingers_in_contact.len())
        } else if !(0.0..=1.0).contains(&feedback.retained) {
            format!("retained is {}, not 0 .. 1", feedback.retained)
        } else if feedback.friction_used.is_some_and(|u| !(0.0..=10.0).contains(&u)) {
            format!("friction_used is {:?}, not 0 .. 1", feedback.friction_used)
        } else if feedback.needed_grip_force_n.is_some_and(|n| !(n >= 0.0 && n.is_finite())) {
            format!("needed_grip_force_n is {:?}, no force", feedback.needed_grip_force_n)
        } else {
            return Ok(());
        };
        Err(Error::Rollout {
            object: self.data.objects[object].name.clone(),
            mass_kg: t.load.0,
            friction: t.load.1,
            what,
            remedy: "repair the simulator that answers".into(),
        })
    }

    /// A demonstration counts by the rewards of the modes that stood for it, relative to the mean of its object.
    fn weigh_demos(&self, rounds: &mut [Round], anchor: &Weights) {
        let layout = self.policy.weights.layout;
        for round in rounds {
            let start = round.tries.len() * layout.modes * layout.mode_width();
            let outputs = &round.anchor[start..];
            let found = demo_loss(&layout, outputs, anchor.log_spread(), &round.demos, &self.scales(), false);
            let earned: Vec<f64> = found
                .responsible
                .chunks_exact(layout.modes)
                .zip(&round.demo_loads)
                .map(|(r, load)| {
                    r.iter().zip(self.second.rewards(round.object, *load)).map(|(r, reward)| r * reward).sum()
                })
                .collect();
            let mean = earned.iter().sum::<f64>() / earned.len().max(1) as f64;
            for (demo, earned) in round.demos.iter_mut().zip(earned) {
                demo.weight = if mean > 0.0 { (earned / mean).max(LEAST_DEMO) } else { 1.0 };
            }
        }
    }

    fn stats(&self, epoch: usize, options: &RolloutOptions, rounds: &[Round]) -> RolloutStats {
        let layout = self.policy.weights.layout;
        let scales = self.scales();
        let mut sum = RolloutStats {
            epoch,
            tried: 0,
            held: 0.0,
            reward: 0.0,
            policy_reward: 0.0,
            force_gap: 0.0,
            contact_loss: 0.0,
            joint_drift_rad: 0.0,
            wrist_drift_m: 0.0,
        };
        let mut targets = 0.0;
        for round in rounds {
            let rows = round.before.chunks_exact(layout.modes * layout.mode_width());
            for (t, row) in round.tries.iter().zip(rows) {
                let Some(feedback) = &t.feedback else { continue };
                sum.tried += 1;
                sum.held += f64::from(u8::from(feedback.held));
                sum.reward += reward(feedback);
                let logits = row.chunks_exact(layout.mode_width()).map(|m| f64::from(m[layout.logit()]));
                let log_z = log_sum_exp(logits.clone());
                let rewards = self.second.rewards(round.object, t.load);
                sum.policy_reward += logits.zip(&rewards).map(|(l, r)| (l - log_z).exp() * r).sum::<f64>();
                let width = layout.mode_width();
                let mode = Mode::new(&layout, &scales, &row[t.mode * width..(t.mode + 1) * width]);
                let touching = feedback.fingers_in_contact.iter().enumerate();
                sum.contact_loss += touching.map(|(f, c)| mode.contact(f, f64::from(u8::from(*c))).0).sum::<f64>();
                if let Some(target) = target_grip_force(feedback, t.grasp.grip_force_n, options) {
                    sum.force_gap += (target / t.grasp.grip_force_n).ln().abs();
                    targets += 1.0;
                }
            }
        }
        let tried = sum.tried.max(1) as f64;
        sum.force_gap /= f64::max(targets, 1.0);
        for mean in [&mut sum.held, &mut sum.reward, &mut sum.policy_reward, &mut sum.contact_loss] {
            *mean /= tried;
        }
        sum
    }

    /// How far joints (RMS, rad) and palms (mean, m) are from the first phase, over all modes of the tries.
    fn drift(&self, rounds: &[Round]) -> Result<(f64, f64)> {
        let layout = self.policy.weights.layout;
        let (mut joints, mut wrist, mut count) = (0.0, 0.0, 0.0);
        for round in rounds {
            let now = net::outputs(&self.policy.weights, &round.scene.encoded, &round.scalars)?;
            let rows = now.chunks_exact(layout.modes * layout.mode_width());
            let old = round.anchor.chunks_exact(layout.modes * layout.mode_width());
            for ((now, old), t) in rows.zip(old).zip(&round.tries) {
                let decode = |row| self.policy.decode(row, &round.scene, t.load);
                for (a, b) in decode(now).iter().zip(&decode(old)) {
                    joints += crate::metric::joint_rms_rad(&a.joints, &b.joints).powi(2);
                    wrist += (a.object_from_base.translation.vector - b.object_from_base.translation.vector).norm();
                    count += 1.0;
                }
            }
        }
        let count = f64::max(count, 1.0);
        Ok(((joints / count).sqrt(), wrist / count))
    }
}

/// Half for the end, half for the way there.
fn reward(feedback: &Feedback) -> f64 {
    0.5 * f64::from(u8::from(feedback.held)) + 0.5 * feedback.retained
}

/// The grip force that a rollout asks for, N; none if it tells nothing about gripping.
fn target_grip_force(feedback: &Feedback, grip_force_n: f64, options: &RolloutOptions) -> Option<f64> {
    let slip = feedback.friction_used.map(|used| grip_force_n * used / options.wanted_friction_share);
    // Lost although fingers were there, and the cone unknown: more than this was needed, nobody knows how much.
    let touching = feedback.fingers_in_contact.iter().filter(|c| **c).count();
    let lost = !feedback.held && slip.is_none() && touching >= options.min_fingers;
    let raised = lost.then_some(grip_force_n * options.raise);
    let wanted = [feedback.needed_grip_force_n, slip, raised].into_iter().flatten().fold(0.0, f64::max);
    (wanted > 0.0).then_some(wanted)
}

/// The loss of one view's tries and demonstrations.
struct Learner<'a> {
    weights: &'a Weights,
    anchor: &'a Weights,
    options: &'a RolloutOptions,
    scales: &'a Scales,
    norm: &'a Normalisation,
    round: &'a Round,
    /// Reward to expect of each mode, per try.
    rewards: &'a [Vec<f64>],
}

impl Learner<'_> {
    fn loss(&self, outputs: &[f32]) -> (f64, Derivatives) {
        let layout = self.weights.layout;
        let row = layout.modes * layout.mode_width();
        let start = self.round.tries.len() * row;
        let mut derivatives = vec![0.0; outputs.len()];
        let mut loss = 0.0;
        for (i, t) in self.round.tries.iter().enumerate() {
            let part = i * row..(i + 1) * row;
            loss += self.of_try(t, &self.rewards[i], &outputs[part.clone()], part.start, &mut derivatives[part]);
        }
        for (i, out) in outputs.chunks_exact(row).enumerate() {
            loss += self.of_anchor(out, i * row, outputs.len() / row, &mut derivatives[i * row..(i + 1) * row]);
        }
        // Rollouts know more about contacts and grip forces than demonstrations do.
        let scales = Scales { nearest_weight: 0.0, force_weight: 0.0, contact_weight: 0.0, ..self.scales.clone() };
        let found = demo_loss(&layout, &outputs[start..], self.weights.log_spread(), &self.round.demos, &scales, false);
        loss += self.options.demo_weight * found.parts.total;
        let weight = self.options.demo_weight as f32;
        derivatives[start..].iter_mut().zip(&found.outputs).for_each(|(s, d)| *s += weight * d);
        // The spreads stay what the demonstrations taught.
        (loss, Derivatives { outputs: derivatives, log_spread: vec![0.0; layout.spreads()] })
    }

    /// Contacts, grip force and probability of the mode that was tried; the others keep what they had.
    fn of_try(&self, t: &Try, rewards: &[f64], out: &[f32], start: usize, derivatives: &mut [f32]) -> f64 {
        let layout = self.weights.layout;
        let width = layout.mode_width();
        let Some(feedback) = &t.feedback else { return 0.0 };
        let scale = 1.0 / self.round.tries.len() as f64;
        let (before, anchor) = (&self.round.before[start..], &self.round.anchor[start..]);
        let log = |out: &[f32], k: usize| f64::from(out[k * width + layout.logit()]);
        let log_z = log_sum_exp((0..layout.modes).map(|k| log(out, k)));
        let wish = |k: usize| log(anchor, k) + rewards[k] / self.options.reward_temperature;
        let wish_z = log_sum_exp((0..layout.modes).map(wish));
        let mut loss = 0.0;
        for k in 0..layout.modes {
            let of = k * width..(k + 1) * width;
            let mode = Mode::new(&layout, self.scales, &out[of.clone()]);
            let slope = &mut derivatives[of.clone()];
            let (probability, wished) = ((log(out, k) - log_z).exp(), (wish(k) - wish_z).exp());
            loss -= scale * wished * (log(out, k) - log_z);
            slope[layout.logit()] += (scale * (probability - wished)) as f32;
            let mut pull = |i: usize, weight: f64| {
                let gap = f64::from(out[k * width + i] - before[k * width + i]);
                slope[i] += (scale * weight * 2.0 * gap) as f32;
                loss += scale * weight * gap * gap;
            };
            if k != t.mode {
                pull(layout.force(), self.scales.force_weight / layout.modes as f64);
                (0..layout.fingers).for_each(|f| pull(layout.contacts() + f, 0.1 / layout.modes as f64));
                continue;
            }
            for (f, touched) in feedback.fingers_in_contact.iter().enumerate() {
                let (entropy, d) = mode.contact(f, f64::from(u8::from(*touched)));
                loss += scale * self.scales.contact_weight * entropy;
                slope[layout.contacts() + f] += (scale * self.scales.contact_weight * d) as f32;
            }
            if let Some(wanted) = target_grip_force(feedback, t.grasp.grip_force_n, self.options) {
                // Kept inside what the network can express, or its output would run to infinity.
                let target = self.norm.log_ratio(wanted, t.load.0, t.load.1);
                let (found, d) = mode.log_ratio();
                let gap = found - target;
                loss += scale * self.scales.force_weight * gap * gap;
                slope[layout.force()] += (scale * self.scales.force_weight * 2.0 * gap * d) as f32;
            }
        }
        loss
    }

    /// Joints and wrists of all modes stay near what the first phase taught.
    fn of_anchor(&self, out: &[f32], start: usize, rows: usize, derivatives: &mut [f32]) -> f64 {
        let layout = self.weights.layout;
        let width = layout.mode_width();
        let scale = self.options.anchor_weight / (rows * layout.modes) as f64;
        let inverse: Vec<f64> = self.anchor.log_spread().iter().map(|s| f64::from(-s).exp()).collect();
        let (mut parts, mut d) = (vec![0.0; layout.spreads()], vec![0.0; layout.joints + 9]);
        let mut loss = 0.0;
        for k in 0..layout.modes {
            let old = &self.round.anchor[start + k * width..start + (k + 1) * width];
            let taught = Mode::new(&layout, self.scales, old);
            let joints: Vec<f64> = (0..layout.joints).map(|j| taught.joint(j).0).collect();
            let wrist: [f64; 9] = std::array::from_fn(|i| f64::from(old[layout.wrist() + i]));
            let mode = Mode::new(&layout, self.scales, &out[k * width..(k + 1) * width]);
            loss += scale * mode.distance(&joints, &wrist, &inverse, &mut parts, &mut d);
            derivatives[k * width..].iter_mut().zip(&d).for_each(|(s, d)| *s += (scale * d) as f32);
        }
        loss
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mode_is_evaluated_by_its_tries_at_similar_loads() {
        let mut second = Second::new(1, 3);
        // The first mode carries what is light, the second what is heavy; the third was tried once, on the light.
        for _ in 0..20 {
            for (mode, at_light, at_heavy) in [(0, 1.0, 0.0), (1, 0.0, 1.0)] {
                second.tallies[0][mode].add((0.08, 0.5), at_light);
                second.tallies[0][mode].add((0.22, 0.5), at_heavy);
            }
        }
        second.tallies[0][2].add((0.08, 0.5), 1.0);
        let (light, heavy) = (second.rewards(0, (0.085, 0.5)), second.rewards(0, (0.2, 0.55)));
        assert!(light[0] > 0.9 && light[1] < 0.1, "{light:?}");
        assert!(heavy[0] < 0.1 && heavy[1] > 0.9, "{heavy:?}");
        // One try moves it half of the way from what is usual there; far from it it says little.
        assert!((light[2] - 0.75).abs() < 0.05 && (heavy[2] - 0.5).abs() < 0.05, "{light:?} {heavy:?}");
        assert_eq!(Second::new(1, 2).rewards(0, (0.1, 0.5)), [0.5, 0.5]);
        // What is forgotten hardly counted.
        let mut tally = Tally::default();
        (0..2 * REMEMBERED).for_each(|i| tally.add((0.1, 0.5), f64::from(u8::from(i >= REMEMBERED))));
        assert_eq!(tally.0.len(), REMEMBERED);
        assert!((tally.near((0.1, 0.5)).1 * (1.0 - MEMORY) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn the_wanted_grip_force_follows_what_was_measured() {
        let options = RolloutOptions::default();
        let feedback = |used: Option<f64>, needed: Option<f64>, held: bool, contacts: usize| Feedback {
            fingers_in_contact: (0..4).map(|i| i < contacts).collect(),
            retained: 1.0,
            held,
            friction_used: used,
            needed_grip_force_n: needed,
        };
        let wanted = |f: Feedback| target_grip_force(&f, 4.0, &options);
        // At 0.7 of the cone nothing changes; at 1 the grip force rises, at 0.35 it halves, never below what is needed.
        assert!((wanted(feedback(Some(0.7), None, true, 3)).unwrap() - 4.0).abs() < 1e-12);
        assert!((wanted(feedback(Some(1.0), None, false, 3)).unwrap() - 4.0 / 0.7).abs() < 1e-12);
        assert!((wanted(feedback(Some(0.35), Some(1.0), true, 3)).unwrap() - 2.0).abs() < 1e-12);
        assert_eq!(wanted(feedback(Some(0.35), Some(3.0), true, 3)), Some(3.0));
        assert!((wanted(feedback(None, None, false, 2)).unwrap() - 5.2).abs() < 1e-12);
        assert_eq!(wanted(feedback(None, None, false, 1)), None, "without fingers a force tells nothing");
        assert_eq!(wanted(feedback(None, None, true, 3)), None);
    }
}
