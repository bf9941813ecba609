//! The policy of the D-REX paper as its code runs it, kept exact for comparison: what it predicts is a baseline, not a recommendation.
//!
//! Every vertex v of the mesh enters as sin(2^k v), cos(2^k v) for k = 0 .. 3 (no π, no v itself: 24 numbers) and passes through three layers of
//! 256 with ReLU; three linear heads give 16 joint angles a, two contacts r and a force f (both through a sigmoid), and the mean over the vertices
//! is taken after the heads. Mass is no input, and the mesh is always the same in the same pose: the network answers with a constant.
//!
//! [`PaperPolicy::train`] is its first phase, MSE(a) + BCE(r) + MSE(f) with r = f = 1 (algorithm 1), [`PaperPolicy::train_contacts`] its second,
//! 0.8 BCE(r) + 0.3 · 0.1 MSE(f) with no loss on the joint angles (algorithm 2). Joint angles are clipped to the limits, as labels and as answers.

mod loss;
mod net;

use std::f64::consts::PI;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::adam::Adam;
use crate::split::{Stream, random_of_epoch, shuffle};
use crate::{Error, GRAVITY_M_S2, PAPER_FORCE_N, Result};

use net::Weights;

pub(crate) use loss::{contact_loss, demo_loss};

/// Joint angles that the network gives.
pub const JOINTS: usize = 16;
/// Numbers per encoded vertex.
pub const ENCODED: usize = 24;
/// Width of the hidden layers.
pub const HIDDEN: usize = 256;
/// Demonstrations per step.
const BATCH: usize = 8;
/// Step size of Adam.
const RATE: f64 = 1e-3;

/// What the network answers: always the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PaperAnswer {
    /// Joint angles, rad, clipped to the limits.
    pub joints: Vec<f64>,
    /// Probabilities that three or more contacts, and that any contact, are made.
    pub contacts: [f64; 2],
    /// Normalised force, 0 .. 1.
    pub force: f64,
}

/// Means over an epoch of the terms of the loss.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct PaperLoss {
    /// Mean squared error of the joint angles, rad².
    pub joints: f64,
    /// Binary cross-entropy of the two contacts, mean.
    pub contacts: f64,
    /// Squared error of the force.
    pub force: f64,
    /// What was minimised.
    pub total: f64,
}

/// The result of one short simulation step: algorithm 2 looks at the number of contacts alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PaperContacts {
    /// Contacts of the scene, of whatever with whatever.
    pub contacts: usize,
    /// Contacts between hand and object.
    pub on_object: usize,
}

/// The network of the paper with its mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct PaperPolicy {
    weights: Weights,
    /// V x 24.
    encoded: Vec<f32>,
    limits: Vec<(f64, f64)>,
}

impl PaperPolicy {
    /// Untrained, for a mesh with these vertices (m) and a hand with these 16 joint limits (rad).
    ///
    /// # Errors
    /// [`Error::Query`] without vertices, with such as are not finite, or with other than 16 intervals.
    pub fn new(vertices: &[Point3<f64>], limits: &[(f64, f64)], seed: u64) -> Result<Self> {
        if vertices.is_empty() {
            return Err(Error::query("the mesh has no vertices", "give the mesh of the object"));
        }
        if let Some(i) = vertices.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
            return Err(Error::query(format!("vertex {i} is not finite"), "repair the mesh"));
        }
        if limits.len() != JOINTS || limits.iter().any(|(a, b)| !(a.is_finite() && b.is_finite() && a <= b)) {
            let what = format!("{} joint limits, or such that are no interval", limits.len());
            return Err(Error::query(what, "give 16 pairs lower <= upper: paper mode knows no other hand"));
        }
        let encoded = vertices.iter().flat_map(|v| encode(v).map(|v| v as f32)).collect();
        Ok(Self { weights: Weights::initial(seed), encoded, limits: limits.to_vec() })
    }

    /// Phase 1 (algorithm 1): `epochs` passes over the demonstrations in batches of 8, all labelled r = f = 1. Returns a loss per epoch.
    ///
    /// # Errors
    /// [`Error::Query`] for demonstrations that are not 16 finite numbers, [`Error::Diverged`], [`Error::NoBackend`].
    pub fn train(&mut self, demos: &[Vec<f64>], epochs: usize, seed: u64) -> Result<Vec<PaperLoss>> {
        let labels = self.labels(demos)?;
        let mut adam = Adam::new(&self.weights.0);
        let loss = |out: &[f64], batch: &[usize]| {
            let batch: Vec<&[f64]> = batch.iter().map(|&i| labels[i].as_slice()).collect();
            demo_loss(out, &batch)
        };
        (0..epochs).map(|epoch| self.descend(&mut adam, labels.len(), epoch, seed, loss)).collect()
    }

    /// Phase 2 (algorithm 2): what the network answers is put into a scene, and `contacts` counts after one short step what touches. The
    /// labels are r = [three or more, any] and f* = min(1, m g (n + 1) / 5 N).
    ///
    /// # Errors
    /// What `contacts` answers, and those of [`train`](Self::train).
    pub fn train_contacts(
        &mut self,
        demos: usize,
        epochs: usize,
        mass_kg: f64,
        seed: u64,
        contacts: &dyn Fn(&[f64]) -> Result<PaperContacts>,
    ) -> Result<Vec<PaperLoss>> {
        // Every sample of an epoch resets to the same scene with the same answer: one count serves them all.
        let mut adam = Adam::new(&self.weights.0);
        let mut pass = |epoch: usize| {
            let found = contacts(&self.answer()?.joints)?;
            let (touching, force) = contact_labels(found, mass_kg);
            self.descend(&mut adam, demos, epoch, seed, |out, _| contact_loss(out, touching, force))
        };
        (0..epochs).map(&mut pass).collect()
    }

    /// What the network answers, the same for every mass.
    ///
    /// # Errors
    /// [`Error::NoBackend`] if the crate was built without one.
    pub fn answer(&self) -> Result<PaperAnswer> {
        let out = net::outputs(&self.weights, &self.encoded)?;
        let clipped = out.iter().zip(&self.limits).map(|(q, (a, b))| q.clamp(*a, *b));
        Ok(PaperAnswer { joints: clipped.collect(), contacts: [out[JOINTS], out[JOINTS + 1]], force: out[JOINTS + 2] })
    }

    /// Mean log-likelihood of `grasps` (nats over rad^16) under the Gaussians that this policy's squared error implies: about its answer, with
    /// the variance of `demos` about it, first one variance for all joints, then one per joint.
    ///
    /// # Errors
    /// As [`train`](Self::train).
    pub fn log_likelihoods(&self, demos: &[Vec<f64>], grasps: &[Vec<f64>]) -> Result<(f64, f64)> {
        let (demos, grasps, answer) = (self.labels(demos)?, self.labels(grasps)?, self.answer()?.joints);
        let mean_square = |of: &[Vec<f64>], j: usize| {
            of.iter().map(|q| (q[j] - answer[j]).powi(2)).sum::<f64>() / of.len().max(1) as f64
        };
        let each: Vec<f64> = (0..JOINTS).map(|j| mean_square(&demos, j).max(1e-6)).collect();
        let one = each.iter().sum::<f64>() / JOINTS as f64;
        let mean = |variance: &dyn Fn(usize) -> f64| -> f64 {
            let log = |j: usize| -0.5 * ((2.0 * PI * variance(j)).ln() + mean_square(&grasps, j) / variance(j));
            (0..JOINTS).map(log).sum()
        };
        Ok((mean(&|_| one), mean(&|j| each[j])))
    }

    fn labels(&self, demos: &[Vec<f64>]) -> Result<Vec<Vec<f64>>> {
        let wrong = |q: &Vec<f64>| q.len() != JOINTS || q.iter().any(|v| !v.is_finite());
        if demos.is_empty() {
            return Err(Error::query("there are no demonstrations", "give at least one grasp"));
        }
        if let Some(i) = demos.iter().position(wrong) {
            return Err(Error::query(format!("demonstration {i} is not 16 finite angles"), "leave it out"));
        }
        let clip = |q: &Vec<f64>| q.iter().zip(&self.limits).map(|(q, (a, b))| q.clamp(*a, *b)).collect();
        Ok(demos.iter().map(clip).collect())
    }

    /// One shuffled pass; `loss` gives the terms and the derivatives of the 19 outputs. Returns the mean loss.
    fn descend(
        &mut self,
        adam: &mut Adam,
        samples: usize,
        epoch: usize,
        seed: u64,
        loss: impl Fn(&[f64], &[usize]) -> (PaperLoss, Vec<f64>),
    ) -> Result<PaperLoss> {
        let mut order: Vec<usize> = (0..samples).collect();
        shuffle(&mut order, &mut random_of_epoch(seed, Stream::Order, epoch));
        let mut mean = PaperLoss::default();
        for batch in order.chunks(BATCH) {
            let (parts, gradient) = net::gradients(&self.weights, &self.encoded, |out| loss(out, batch))?;
            if !parts.total.is_finite() {
                return Err(Error::Diverged { epoch, loss: parts.total, learning_rate: RATE });
            }
            adam.step(&mut self.weights.0, &gradient, RATE);
            let share = batch.len() as f64 / samples as f64;
            mean.joints += share * parts.joints;
            mean.contacts += share * parts.contacts;
            mean.force += share * parts.force;
            mean.total += share * parts.total;
        }
        Ok(mean)
    }
}

/// r and f* of algorithm 2.
pub fn contact_labels(found: PaperContacts, mass_kg: f64) -> ([f64; 2], f64) {
    let touching = [f64::from(u8::from(found.contacts >= 3)), f64::from(u8::from(found.contacts > 0))];
    let force = (mass_kg * GRAVITY_M_S2 * (found.on_object as f64 + 1.0) / PAPER_FORCE_N).min(1.0);
    (touching, force)
}

/// sin(2^k x), cos(2^k x) per coordinate, k = 0 .. 3.
fn encode(vertex: &Point3<f64>) -> [f64; ENCODED] {
    std::array::from_fn(|i| {
        let angle = f64::from(1u32 << (i / 2 % 4)) * vertex[i / 8];
        if i % 2 == 0 { angle.sin() } else { angle.cos() }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_is_the_papers() {
        let v = Point3::new(0.3, -0.7, 1.1);
        let e = encode(&v);
        for (axis, x) in v.iter().enumerate() {
            for k in 0..4 {
                let angle = 2f64.powi(k) * x;
                let at = 8 * axis + 2 * k as usize;
                assert_eq!((e[at], e[at + 1]), (angle.sin(), angle.cos()));
            }
        }
    }

    #[test]
    fn labels_of_the_second_phase() {
        let of = |contacts, on_object, mass| contact_labels(PaperContacts { contacts, on_object }, mass);
        assert_eq!(of(0, 0, 0.1).0, [0.0, 0.0]);
        assert_eq!(of(2, 1, 0.1).0, [0.0, 1.0]);
        assert_eq!(of(3, 3, 0.1).0, [1.0, 1.0]);
        assert!((of(3, 3, 0.1).1 - 0.1 * 9.81 * 4.0 / 5.0).abs() < 1e-12);
        assert_eq!(of(8, 8, 1.0).1, 1.0);
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let (vertex, limits) = ([Point3::origin()], [(0.0, 1.0); JOINTS]);
        let says = |r: Result<PaperPolicy>, word: &str| assert!(r.unwrap_err().to_string().contains(word));
        says(PaperPolicy::new(&[], &limits, 0), "no vertices");
        says(PaperPolicy::new(&[Point3::new(f64::NAN, 0.0, 0.0)], &limits, 0), "vertex 0");
        says(PaperPolicy::new(&vertex, &limits[..3], 0), "3 joint limits");
        let mut policy = PaperPolicy::new(&vertex, &limits, 0).unwrap();
        assert!(policy.train(&[vec![0.0; 3]], 1, 0).unwrap_err().to_string().contains("demonstration 0"));
        assert!(policy.train(&[], 1, 0).unwrap_err().to_string().contains("no demonstrations"));
    }

    #[cfg(feature = "flex")]
    #[test]
    fn it_learns_the_mean_and_drifts_in_the_second_phase() {
        // Two demonstrations far apart, one outside a limit: the answer is the mean of the clipped ones.
        let vertices: Vec<_> = (0..6).map(|i| Point3::new(0.02 * f64::from(i), 0.01, -0.03)).collect();
        let mut policy = PaperPolicy::new(&vertices, &[(-0.5, 0.5); JOINTS], 1).unwrap();
        let curve = policy.train(&[vec![-0.4; 16], vec![2.0; 16]], 150, 1).unwrap();
        let answer = policy.answer().unwrap();
        assert!(answer.joints.iter().all(|q| (q - 0.05).abs() < 0.02), "{answer:?}");
        assert!(answer.force > 0.95 && answer.contacts.iter().all(|c| *c > 0.95));
        assert!((curve[149].joints - 0.45f64.powi(2)).abs() < 1e-3);
        // One joint label unit of variance: the densities of the two demonstrations are those of that Gaussian.
        let (one, each) = policy.log_likelihoods(&[vec![-0.4; 16], vec![0.5; 16]], &[vec![0.05; 16]]).unwrap();
        let expected = -8.0 * (2.0 * PI * 0.45f64.powi(2)).ln();
        assert!((one - expected).abs() < 0.1 && (each - expected).abs() < 0.1, "{one} {each} {expected}");
        let none = |_: &[f64]| Ok(PaperContacts { contacts: 0, on_object: 0 });
        let curve = policy.train_contacts(2, 30, 0.1, 2, &none).unwrap();
        let after = policy.answer().unwrap();
        assert!(after.contacts[0] < answer.contacts[0] && after.force < answer.force);
        assert_eq!(curve[0].joints, 0.0, "nothing holds the joint angles");
    }
}
