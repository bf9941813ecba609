//! The network as the bench uses it: trained on the grasps of a library that hold in practice, then by rollouts of its own.

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use drex_core::Pose;
use drex_policy::{
    Dataset, Feedback, GraspPolicy, GraspSample, ObjectCloud, PredictedGrasp, Query, Rollouts, TrainOptions,
    TrainReport, Trainer,
};
use drex_robot::Robot;
use drex_trial::{Belief, Squeeze};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::judge::{Condition, Judge, Judged, Spread};
use super::library::{Grasp, Origins};
use super::practice::{PRACTICE_SEED, Practised, Sieved, practise};
use super::thing::Thing;

/// The network learns the force at these multiples of the object's mass.
const MASS_FACTORS: [f64; 3] = [0.4, 1.0, 2.0];
/// Frictions of the force labels.
const FRICTIONS: [f64; 3] = [0.35, 0.5, 0.75];
/// Rounds of rollouts of the network, views of a round, tries of a view.
const ROUNDS: (usize, usize, usize) = (10, 6, 8);
/// More than the motors of any hand squeeze with, N.
const MORE_THAN_ANY_N: f64 = 1e4;

/// One grasp that was proposed.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// Model order, rad.
    pub joints: Vec<f64>,
    pub object_from_palm: Pose,
    /// Sum of normal forces, N.
    pub squeeze_n: f64,
    /// How probable it is among those proposed.
    pub weight: f64,
}

/// How a policy is trained.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnOptions {
    pub train: TrainOptions,
    /// Conditions under which grasps are practised.
    pub spread: Spread,
    /// Grasps that are practised in the simulator before one is learned, those that need least force; zero practises nothing.
    pub practised: usize,
    /// Acceleration of the shakes, m/s².
    pub shake_m_s2: f64,
    /// Masses of the labels, kg; empty: multiples of the object's own.
    pub masses_kg: Vec<f64>,
    /// The network is told the same mass whatever it was: what randomising masses in training amounts to.
    pub mass_hidden: bool,
}

/// A trained policy.
pub struct Learned {
    policy: GraspPolicy,
    /// What it is told in place of the mass.
    told_kg: Option<f64>,
    /// Grasps of the library that can be commanded, and that held in practice under most conditions.
    pub commanded: usize,
    pub robust: usize,
    /// Those that were learned.
    pub learned: Origins,
    /// Lowest of the frictions that a hand may be told at which a rehearsed grasp has a force for the heaviest mass.
    pub carries_from: Option<f64>,
    /// How the training went.
    pub report: TrainReport,
    /// Grasps and forces that were learned from.
    pub samples: usize,
    /// Time of the practice, of learning from demonstrations and of learning from rollouts, s.
    pub seconds: [f64; 3],
}

impl Learned {
    /// Trains on grasps of an object: those that hold in practice, with the force that the cone programme asks for once the hand has
    /// closed; then by rollouts of what the network proposes. All in drex-diffsim.
    ///
    /// # Errors
    /// If no grasp can carry the object at any of the masses, or the training fails.
    pub fn train<J: Judge>(
        thing: &Thing,
        robot: &Arc<Robot>,
        grasps: &[Grasp],
        judge: &J,
        options: &LearnOptions,
    ) -> Result<Self> {
        let start = Instant::now();
        let masses: Vec<f64> = match options.masses_kg.is_empty() {
            true => MASS_FACTORS.map(|f| f * thing.spec.mass_kg).to_vec(),
            false => options.masses_kg.clone(),
        };
        let middle = (masses.iter().map(|m| m.ln()).sum::<f64>() / masses.len() as f64).exp();
        let told_kg = options.mass_hidden.then_some(middle);
        // What is to hold at several masses is practised at all of them.
        let own = [thing.spec.mass_kg];
        let practice_kg = if options.masses_kg.is_empty() { &own[..] } else { &masses[..] };
        let Sieved { grasps: practised, commanded, robust, carries_from } =
            practise(thing, robot, grasps, judge, practice_kg, options)?;
        let samples: Vec<GraspSample> = practised
            .par_iter()
            .map(|p| samples(p, judge, &masses, told_kg))
            .collect::<Result<Vec<_>>>()?
            .into_iter()
            .flatten()
            .collect();
        if samples.is_empty() {
            bail!(
                "none of the {} grasps of \"{}\" can carry {:.0} g with the motors of {}: it may be too heavy or too smooth for this hand",
                grasps.len(),
                thing.spec.name,
                1e3 * middle,
                robot.name
            );
        }
        let limits = robot.joints.iter().map(|j| {
            j.limits
                .with_context(|| format!("joint {} of {} has no limits; the network needs them", j.name, robot.name))
        });
        let up = thing.table.up.into_inner();
        let data = Dataset {
            joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
            joint_limits: limits.collect::<Result<_>>()?,
            hand: robot.name.clone(),
            fingers: robot.fingers().into_iter().map(|f| f.name).collect(),
            objects: vec![ObjectCloud { name: thing.spec.name.clone(), points: thing.cloud(options.train.seed), up }],
            samples,
        };
        let mut train = options.train.clone();
        // Every grasp that held has a mode of its own; a mean of two may hold nothing.
        train.modes = practised.len();
        train.hold_out_every = 0;
        (train.rollouts.epochs, train.rollouts.scenes, train.rollouts.tries) = ROUNDS;
        train.rollouts.epochs = train.rollouts.epochs.min(options.practised / 10);
        let practised_s = start.elapsed().as_secs_f64();
        let mut trainer = Trainer::new(&data, &train)?;
        while trainer.learn()?.is_some() {}
        let learned_s = start.elapsed().as_secs_f64();
        let practice = Practice { judge, spread: options.spread };
        while trainer.roll_out(&practice)?.is_some() {}
        let (policy, report) = trainer.finish()?;
        let seconds = [practised_s, learned_s - practised_s, start.elapsed().as_secs_f64() - learned_s];
        let (learned, samples) = (Origins::of(practised.iter().map(|p| p.grasp.kind)), data.samples.len());
        Ok(Self { policy, told_kg, commanded, robust, learned, carries_from, report, samples, seconds })
    }

    /// The network.
    pub fn policy(&self) -> &GraspPolicy {
        &self.policy
    }

    /// The grasps for an object with these points, `up` for it the way from the table, the most probable first.
    ///
    /// # Errors
    /// If the policy is not defined for what is asked.
    pub fn propose(&self, points: &[Point3<f64>], up: &Vector3<f64>, belief: &Belief) -> Result<Vec<Proposal>> {
        let query = Query::new(points, self.told_kg.unwrap_or(belief.mass_kg), belief.friction).with_up(*up);
        let proposals = self.policy.predict(&query)?.into_iter().map(|g| Proposal {
            joints: g.joints,
            object_from_palm: g.object_from_palm,
            squeeze_n: g.squeeze_n,
            weight: g.weight,
        });
        Ok(proposals.collect())
    }
}

/// The grasp with the force that it needs at each of the masses and frictions.
fn samples<J: Judge>(
    practised: &Practised,
    judge: &J,
    masses: &[f64],
    told_kg: Option<f64>,
) -> Result<Vec<GraspSample>> {
    let (grasp, object_from_palm) = (&practised.grasp, practised.grasp.pose()?);
    let mut out = Vec::new();
    let grip =
        judge.grip(&grasp.joints_rad, &object_from_palm, &Belief { mass_kg: masses[0], friction: FRICTIONS[1] })?;
    for (mass_kg, friction) in masses.iter().flat_map(|m| FRICTIONS.map(|f| (*m, f))) {
        let belief = Belief { mass_kg, friction };
        if let Some(squeeze_n) = needed_n(judge, &grip, &belief)? {
            out.push(GraspSample {
                object: 0,
                joints: grasp.joints_rad.clone(),
                object_from_palm,
                contacts: practised.fingers.clone(),
                squeeze_n,
                mass_kg: told_kg.unwrap_or(mass_kg),
                friction,
            });
        }
    }
    Ok(out)
}

/// The squeeze that the law asks for; all that the motors have where they have too little for it but may still carry. Without these
/// the network would know heavy things only by the cases that are easy.
fn needed_n<J: Judge>(judge: &J, grip: &J::Grip, belief: &Belief) -> Result<Option<f64>> {
    for squeeze in [Squeeze::Needed, Squeeze::Total(MORE_THAN_ANY_N)] {
        if let Ok(squeeze_n) = judge.squeeze_n(grip, belief, squeeze)? {
            return Ok(Some(squeeze_n));
        }
    }
    Ok(None)
}

/// Rollouts of what the network proposes, with its own force.
struct Practice<'a, J> {
    judge: &'a J,
    spread: Spread,
}

impl<J: Judge> Rollouts for Practice<'_, J> {
    fn rollout(
        &self,
        object: usize,
        grasp: &PredictedGrasp,
        mass_kg: f64,
        friction: f64,
        seed: u64,
    ) -> drex_policy::Result<Feedback> {
        self.feedback(grasp, mass_kg, friction, seed).map_err(|e| drex_policy::Error::Rollout {
            object: format!("number {object}"),
            mass_kg,
            friction,
            what: format!("{e:#}"),
            remedy: "see what the simulator says".into(),
        })
    }
}

impl<J: Judge> Practice<'_, J> {
    fn feedback(&self, grasp: &PredictedGrasp, mass_kg: f64, friction: f64, seed: u64) -> Result<Feedback> {
        let belief = Belief { mass_kg, friction };
        let grip = self.judge.grip(&grasp.joints, &grasp.object_from_palm, &belief)?;
        let needed = needed_n(self.judge, &grip, &belief)?;
        let condition = Condition { friction, ..self.spread.conditions(1, seed ^ PRACTICE_SEED)[0] };
        let judged = match self.judge.plan(&grip, &belief, Squeeze::Total(grasp.squeeze_n))? {
            Ok(plan) => self.judge.practise(&plan, &condition.truth(mass_kg))?,
            Err(reason) => Judged::refused(&reason),
        };
        let fingers_in_contact = match judged.fingers.is_empty() {
            true => self.judge.fingers(&grip),
            false => judged.fingers.clone(),
        };
        Ok(Feedback {
            fingers_in_contact,
            retained: judged.retained,
            held: judged.held(),
            friction_used: judged.friction_used,
            needed_squeeze_n: needed,
        })
    }
}
