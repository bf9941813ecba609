//! One cell of a table: who grasps, what the hand is told, how hard it squeezes; and the rollouts of it.

use std::collections::BTreeMap;

use anyhow::Result;
use drex_trial::{Belief, NoCommand, Squeeze, Verdict};
use drex_trial::{Interval, wilson};
use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use super::judge::{Condition, Judge, Judged};
use super::learned::{Learned, Proposal};

/// Who proposes grasps.
pub enum Actor<'a> {
    /// The network, for an object with these points.
    Policy(&'a Learned, &'a [Point3<f64>]),
    /// Always these, best first.
    Always(Vec<Proposal>),
}

/// What the hand takes the mass for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Told {
    /// What it is, times this.
    Times(f64),
    /// What it is, but for an error of the identification: standard deviation as a share.
    Identified(f64),
    /// This many kilograms, whatever it is.
    Always(f64),
}

/// How hard the hand squeezes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Force {
    /// As the actor says.
    Actor,
    /// As the cone programme says for what the hand is told.
    Law,
    /// As the cone programme says for what is true.
    Oracle,
}

/// One cell.
pub struct Cell<'a, J: Judge> {
    pub labels: Vec<(&'static str, String)>,
    pub judge: &'a J,
    pub actor: &'a Actor<'a>,
    /// True mass, kg.
    pub mass_kg: f64,
    pub told: Told,
    pub force: Force,
    /// Least friction at which any grasp of the library carries the load.
    pub least_friction: Option<f64>,
}

/// A line of a table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// What was varied.
    pub labels: BTreeMap<&'static str, String>,
    pub successes: usize,
    pub n: usize,
    /// 95 %, Wilson's.
    pub interval: Interval,
    /// How often each rule was broken first.
    pub failures: BTreeMap<String, usize>,
    /// Share of the rollouts in which any grasp of the library could hold on paper.
    pub bound: f64,
    /// Median commanded squeeze, N, over rollouts with a command.
    pub median_squeeze_n: Option<f64>,
    /// Whether each rollout succeeded, in order: for paired comparisons.
    #[serde(skip)]
    pub held: Vec<bool>,
}

impl<J: Judge> Cell<'_, J> {
    /// All rollouts of the cell. The same for any number of threads.
    ///
    /// # Errors
    /// If something cannot be simulated.
    pub fn run(&self, conditions: &[Condition]) -> Result<Row> {
        let judged: Vec<Judged> = conditions.par_iter().map(|c| self.rollout(c)).collect::<Result<_>>()?;
        let held: Vec<bool> = judged.iter().map(|j| j.verdict == Verdict::Success).collect();
        let successes = held.iter().filter(|h| **h).count();
        let mut failures = BTreeMap::new();
        for j in judged.iter().filter(|j| j.verdict != Verdict::Success) {
            *failures.entry(name(j.verdict)).or_insert(0) += 1;
        }
        let mut squeezes: Vec<f64> = judged.iter().map(|j| j.squeeze_n).filter(|s| *s > 0.0).collect();
        squeezes.sort_by(f64::total_cmp);
        let n = judged.len();
        let within = conditions.iter().filter(|c| self.least_friction.is_some_and(|mu| c.friction >= mu)).count();
        Ok(Row {
            labels: self.labels.iter().cloned().collect(),
            successes,
            n,
            interval: wilson(successes, n),
            failures,
            bound: within as f64 / n.max(1) as f64,
            median_squeeze_n: squeezes.get(squeezes.len() / 2).copied(),
            held,
        })
    }

    fn rollout(&self, condition: &Condition) -> Result<Judged> {
        match self.plan(condition)? {
            Ok(plan) => self.judge.run(&plan, &condition.truth(self.mass_kg)),
            Err(reason) => Ok(Judged::refused(&reason)),
        }
    }

    /// The first proposal that the hand can hold when it closes. Which it is depends on the true mass, so that cells that differ in
    /// what the hand is told differ in force alone.
    fn plan(&self, condition: &Condition) -> Result<Result<J::Plan, NoCommand>> {
        let truth = condition.belief(self.mass_kg);
        let belief = condition.belief(self.told.mass_kg(self.mass_kg, condition));
        let proposals = match self.actor {
            Actor::Policy(policy, points) => {
                let squeezes = policy.propose(points, &belief)?;
                let mut proposals = policy.propose(points, &truth)?;
                // Modes keep their order among the masses but for their weights: the force is that of the nearest in pose.
                for p in &mut proposals {
                    p.squeeze_n = nearest(&squeezes, p).map_or(p.squeeze_n, |s| s.squeeze_n);
                }
                proposals
            }
            Actor::Always(proposals) => proposals.clone(),
        };
        // None can be held: the most probable has a try with the force that it was given.
        let mut chosen = None;
        for p in &proposals {
            let grip = self.judge.grip(&p.joints, &p.object_from_palm, &truth)?;
            let holds = self.judge.plan(&grip, &truth, Squeeze::Needed)?.is_ok();
            if holds || chosen.is_none() {
                chosen = Some((p, grip));
            }
            if holds {
                break;
            }
        }
        match chosen {
            Some((p, grip)) => self.command(p, &grip, &belief, condition),
            None => Ok(Err(NoCommand::NoContact { touching: 0 })),
        }
    }

    fn command(
        &self,
        p: &Proposal,
        grip: &J::Grip,
        belief: &Belief,
        condition: &Condition,
    ) -> Result<Result<J::Plan, NoCommand>> {
        let oracle = Belief { mass_kg: self.mass_kg, friction: condition.friction };
        let (belief, squeeze) = match self.force {
            Force::Actor => (belief, Squeeze::Total(p.squeeze_n)),
            Force::Law => (belief, Squeeze::Needed),
            Force::Oracle => (&oracle, Squeeze::Needed),
        };
        self.judge.plan(grip, belief, squeeze)
    }
}

impl Told {
    fn mass_kg(self, mass_kg: f64, condition: &Condition) -> f64 {
        match self {
            Self::Times(factor) => mass_kg * factor,
            // No scale says less than a tenth of what is on it.
            Self::Identified(sd) => mass_kg * (1.0 + sd * condition.mass_error).max(0.1),
            Self::Always(kg) => kg,
        }
    }
}

/// The proposal whose hand is nearest.
fn nearest<'a>(among: &'a [Proposal], to: &Proposal) -> Option<&'a Proposal> {
    let far = |p: &Proposal| {
        let joints: f64 = p.joints.iter().zip(&to.joints).map(|(a, b)| (a - b).powi(2)).sum();
        let shift = p.object_from_palm.translation.vector - to.object_from_palm.translation.vector;
        joints + 100.0 * shift.norm_squared()
    };
    among.iter().min_by(|a, b| far(a).total_cmp(&far(b)))
}

/// The verdict as JSON and tables spell it.
fn name(verdict: Verdict) -> String {
    match serde_json::to_value(verdict) {
        Ok(serde_json::Value::String(text)) => text,
        _ => format!("{verdict:?}"),
    }
}
