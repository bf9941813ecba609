//! The network as the bench uses it: trained on libraries of grasps, asked at a mass and a friction.

use std::ops::ControlFlow;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use drex_core::Pose;
use drex_policy::{Dataset, GraspPolicy, GraspSample, TrainOptions};
use drex_robot::Robot;
use drex_trial::Belief;
use nalgebra::Point3;
use rayon::prelude::*;

use super::judge::Judge;
use super::library::Grasp;
use super::thing::Thing;

/// The network learns the force at these multiples of the object's mass.
const MASS_FACTORS: [f64; 3] = [0.4, 1.0, 2.0];

/// One grasp that was proposed.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// Model order, rad.
    pub joints: Vec<f64>,
    pub object_from_palm: Pose,
    /// Sum of normal forces, N.
    pub squeeze_n: f64,
}

/// How a policy is trained.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnOptions {
    pub train: TrainOptions,
    /// Friction of the force labels.
    pub friction: f64,
    /// Masses of the labels, kg; empty: multiples of the object's own.
    pub masses_kg: Vec<f64>,
    /// The network is told the same mass whatever it was: what randomising masses in training amounts to.
    pub mass_hidden: bool,
}

/// A trained policy.
pub struct Learned {
    policy: GraspPolicy,
    friction: f64,
    /// What it is told in place of the mass.
    told_kg: Option<f64>,
    /// Grasps that could not carry the object at any mass of the labels.
    pub left_out: usize,
}

impl Learned {
    /// Trains on grasps of an object; the force labels are what the judge's law needs for each.
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
        let masses: Vec<f64> = match options.masses_kg.is_empty() {
            true => MASS_FACTORS.map(|f| f * thing.spec.mass_kg).to_vec(),
            false => options.masses_kg.clone(),
        };
        let hidden = (masses.iter().map(|m| m.ln()).sum::<f64>() / masses.len() as f64).exp();
        let told_kg = options.mass_hidden.then_some(hidden);
        let per_grasp: Vec<Vec<GraspSample>> =
            grasps.par_iter().map(|g| samples(g, judge, &masses, options.friction, told_kg)).collect::<Result<_>>()?;
        let left_out = per_grasp.iter().filter(|s| s.is_empty()).count();
        let samples: Vec<GraspSample> = per_grasp.into_iter().flatten().collect();
        if samples.is_empty() {
            bail!(
                "none of the {} grasps of \"{}\" can carry it at friction {} with the motors of {}: it may be too heavy for this hand",
                grasps.len(),
                thing.spec.name,
                options.friction,
                robot.name
            );
        }
        let limits = robot.joints.iter().map(|j| {
            j.limits
                .with_context(|| format!("joint {} of {} has no limits; the network needs them", j.name, robot.name))
        });
        let data = Dataset {
            joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
            joint_limits: limits.collect::<Result<_>>()?,
            hand: robot.name.clone(),
            points: thing.cloud(options.train.seed),
            samples,
        };
        let (policy, _) = GraspPolicy::train(&data, &options.train, &mut |_| ControlFlow::Continue(()))?;
        Ok(Self { policy, friction: options.friction, told_kg, left_out })
    }

    /// The grasps for an object with these points, the most probable first.
    ///
    /// # Errors
    /// If the policy is not defined for what is asked.
    pub fn propose(&self, points: &[Point3<f64>], belief: &Belief) -> Result<Vec<Proposal>> {
        let grasps = self.policy.predict(points, self.told_kg.unwrap_or(belief.mass_kg))?;
        // The labels are for one friction; a squeeze holds by friction, so that less of it takes as much more force.
        let scale = self.friction / belief.friction;
        let proposals = grasps.into_iter().map(|g| Proposal {
            joints: g.joints,
            object_from_palm: g.object_from_palm,
            squeeze_n: g.squeeze_n * scale,
        });
        Ok(proposals.collect())
    }
}

/// The grasp with the force that it needs at each of the masses.
fn samples<J: Judge>(
    grasp: &Grasp,
    judge: &J,
    masses: &[f64],
    friction: f64,
    told_kg: Option<f64>,
) -> Result<Vec<GraspSample>> {
    let object_from_palm = grasp.pose()?;
    let mut out = Vec::new();
    for &mass_kg in masses {
        let belief = Belief { mass_kg, friction };
        if let Some(squeeze_n) = judge.needed_n(&grasp.joints_rad, &object_from_palm, &belief)? {
            out.push(GraspSample {
                joints: grasp.joints_rad.clone(),
                object_from_palm,
                squeeze_n,
                mass_kg: told_kg.unwrap_or(mass_kg),
            });
        }
    }
    Ok(out)
}
