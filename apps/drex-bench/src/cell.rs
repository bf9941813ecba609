//! One cell of a table: who grasps, what the hand is told, how hard it grips; and the rollouts of it.

use drex_core::stats::upper_median;
use std::collections::BTreeMap;

use anyhow::Result;
use drex_trial::{Assumed, Condition, Evaluation, Evaluator, GripForce, Interval, NoCommand, Verdict, wilson};
use drex_twin::learn::{Learned, Proposal};
use drex_twin::rank;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

/// Who proposes grasps.
pub enum Actor<'a> {
    /// The network, for an object with these points and what is up for it.
    Policy(&'a Learned, &'a [Point3<f64>], Vector3<f64>),
    /// Always these, best first.
    Always(Vec<Proposal>),
}

/// What the hand takes the mass for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AssumedMass {
    /// What it is, times this.
    Times(f64),
    /// What it is, but for an error of the identification: standard deviation as a share.
    Identified(f64),
    /// This many kilograms, whatever it is.
    Always(f64),
}

/// How hard the hand grips.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Force {
    /// As the actor says.
    Actor,
    /// As the cone programme says for what the hand is told.
    Law,
    /// As the cone programme says for what is true.
    Oracle,
}

/// By which mass a grip is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Choice {
    /// What the hand takes it for: all that a hand on a bench can do.
    AssumedMass,
    /// What it is: cells of a table that are told different masses then have the same grips and differ in force alone.
    True,
}

/// What differs from cell to cell of a table.
#[derive(Debug, Clone, Copy)]
pub struct Setting {
    /// True mass, kg.
    pub mass_kg: f64,
    pub told: AssumedMass,
    pub force: Force,
    /// By which mass a grip is chosen among those proposed.
    pub choice: Choice,
}

/// One cell.
pub struct Cell<'a, E: Evaluator> {
    pub labels: Vec<(&'static str, String)>,
    pub evaluator: &'a E,
    pub actor: &'a Actor<'a>,
    pub setting: Setting,
    /// Least friction at which any grasp of the library carries the load.
    pub least_friction: Option<f64>,
    /// Whether every command is carried out in the engine of the practice as well, to compare.
    pub compare: bool,
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
    /// Median commanded grip force, N, over rollouts with a command.
    #[serde(rename = "median_squeeze_n")]
    pub median_grip_force_n: Option<f64>,
    /// Median of the grip force that was delivered in the hold, N, over rollouts that came so far.
    pub median_delivered_n: Option<f64>,
    /// The same commands under the same conditions in both engines, where that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub agreement: Option<Agreement>,
    /// Whether each rollout succeeded, in order: for paired comparisons.
    #[serde(skip)]
    pub held: Vec<bool>,
}

/// How often two engines say the same of a command that was carried out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Agreement {
    /// Rollouts in which both held or both failed.
    pub same: usize,
    pub n: usize,
    /// The others: verdict of the evaluator, then that of the practice.
    pub disagreements: BTreeMap<String, usize>,
}

impl<E: Evaluator> Cell<'_, E> {
    /// All rollouts of the cell. The same for any number of threads.
    ///
    /// # Errors
    /// If something cannot be simulated.
    pub fn run(&self, conditions: &[Condition]) -> Result<Row> {
        let grips = self.grips(conditions)?;
        let both: Vec<(Evaluation, Option<Evaluation>)> =
            conditions.par_iter().map(|c| self.rollout(c, &grips)).collect::<Result<_>>()?;
        let agreement = self.compare.then(|| agreement(&both));
        let judged: Vec<Evaluation> = both.into_iter().map(|b| b.0).collect();
        let held: Vec<bool> = judged.iter().map(|j| j.verdict == Verdict::Success).collect();
        let successes = held.iter().filter(|h| **h).count();
        let mut failures = BTreeMap::new();
        for j in judged.iter().filter(|j| j.verdict != Verdict::Success) {
            *failures.entry(name(j.verdict)).or_insert(0) += 1;
        }
        let n = judged.len();
        let within = conditions.iter().filter(|c| self.least_friction.is_some_and(|mu| c.friction >= mu)).count();
        Ok(Row {
            labels: self.labels.iter().cloned().collect(),
            successes,
            n,
            interval: wilson(successes, n),
            failures,
            bound: within as f64 / n.max(1) as f64,
            median_grip_force_n: upper_median(judged.iter().map(|j| j.grip_force_n).filter(|s| *s > 0.0)),
            median_delivered_n: upper_median(judged.iter().filter_map(|j| j.held_n)),
            agreement,
            held,
        })
    }

    /// The proposals at the mean of the masses and frictions, each with the hand closed on the object. Mass and friction change what the
    /// network thinks of a grasp and how hard it grips; where the hand goes is asked once for a cell.
    fn grips(&self, conditions: &[Condition]) -> Result<Vec<(Proposal, E::Closed)>> {
        let mean = conditions.iter().map(|c| c.friction).sum::<f64>() / conditions.len().max(1) as f64;
        let mass_kg = match self.setting.choice {
            Choice::AssumedMass => self.setting.told.mass_kg(self.setting.mass_kg, 0.0),
            Choice::True => self.setting.mass_kg,
        };
        let assumed = Assumed { mass_kg, friction: mean };
        let proposals = match self.actor {
            Actor::Policy(policy, points, up) => policy.propose(points, up, &assumed)?,
            Actor::Always(proposals) => proposals.clone(),
        };
        let grip = |p: Proposal| self.evaluator.close(&p.grasp, &assumed).map(|closed| (p, closed)).map_err(Into::into);
        proposals.into_par_iter().map(grip).collect()
    }

    /// What the evaluator says, and what the engine of the practice says if that is compared and there was a command.
    fn rollout(
        &self,
        condition: &Condition,
        grips: &[(Proposal, E::Closed)],
    ) -> Result<(Evaluation, Option<Evaluation>)> {
        let truth = condition.truth(self.setting.mass_kg);
        match self.plan(condition, grips)? {
            Ok(plan) => {
                let other = self.compare.then(|| self.evaluator.validate(&plan, &truth)).transpose()?;
                Ok((self.evaluator.evaluate(&plan, &truth)?, other))
            }
            Err(reason) => Ok((Evaluation::refused(&reason), None)),
        }
    }

    /// The first grip, as [`rank::sort`] has them, for which the hand has a force.
    fn plan(&self, condition: &Condition, grips: &[(Proposal, E::Closed)]) -> Result<Result<E::Command, NoCommand>> {
        let assumed = condition.assumed(self.setting.told.mass_kg(self.setting.mass_kg, condition.mass_error));
        let chosen_for = match self.setting.choice {
            Choice::AssumedMass => assumed,
            Choice::True => condition.assumed(self.setting.mass_kg),
        };
        // The grips at this friction: how probable each is and how hard it grips where it is chosen, and how hard for what is told.
        let mut order: Vec<(f64, [f64; 2], &E::Closed)> = match self.actor {
            Actor::Policy(policy, points, up) => {
                let (by, told) = (policy.propose(points, up, &chosen_for)?, policy.propose(points, up, &assumed)?);
                let ask = |(p, grip)| {
                    let (by, told) = (nearest(&by, p).unwrap_or(p), nearest(&told, p).unwrap_or(p));
                    (by.weight, [by.grip_force_n, told.grip_force_n], grip)
                };
                grips.iter().map(|(p, grip)| ask((p, grip))).collect()
            }
            Actor::Always(_) => grips.iter().map(|(p, grip)| (p.weight, [p.grip_force_n; 2], grip)).collect(),
        };
        rank::sort(&mut order, |o| o.0, |o| o.1[0]);
        let mut reason = NoCommand::NoContact { touching: 0 };
        for (_, [by_n, told_n], grip) in order {
            match self.command(by_n, grip, &chosen_for, condition)? {
                Ok(plan) if self.setting.choice == Choice::AssumedMass => return Ok(Ok(plan)),
                // It is this grip, also where there is no force for what is told: cells differ in force alone.
                Ok(_) => return self.command(told_n, grip, &assumed, condition),
                Err(why) => reason = why,
            }
        }
        Ok(Err(reason))
    }

    fn command(
        &self,
        grip_force_n: f64,
        grip: &E::Closed,
        assumed: &Assumed,
        condition: &Condition,
    ) -> Result<Result<E::Command, NoCommand>> {
        let oracle = Assumed { mass_kg: self.setting.mass_kg, friction: condition.friction };
        let (assumed, grip_force) = match self.setting.force {
            Force::Actor => (assumed, GripForce::Total(grip_force_n)),
            Force::Law => (assumed, GripForce::Required),
            Force::Oracle => (&oracle, GripForce::Required),
        };
        Ok(self.evaluator.command(grip, assumed, grip_force)?)
    }
}

impl AssumedMass {
    /// `mass_error` in standard deviations.
    fn mass_kg(self, mass_kg: f64, mass_error: f64) -> f64 {
        match self {
            Self::Times(factor) => mass_kg * factor,
            // No scale says less than a tenth of what is on it.
            Self::Identified(sd) => mass_kg * (1.0 + sd * mass_error).max(0.1),
            Self::Always(kg) => kg,
        }
    }
}

/// The proposal whose hand is nearest.
fn nearest<'a>(among: &'a [Proposal], to: &Proposal) -> Option<&'a Proposal> {
    let far = |p: &Proposal| {
        let (a, b) = (&p.grasp, &to.grasp);
        let joints: f64 = a.joints_rad.iter().zip(&b.joints_rad).map(|(a, b)| (a - b).powi(2)).sum();
        let shift = a.object_from_base.translation.vector - b.object_from_base.translation.vector;
        joints + 100.0 * shift.norm_squared()
    };
    among.iter().min_by(|a, b| far(a).total_cmp(&far(b)))
}

/// Counts the rollouts that both engines carried out.
fn agreement(both: &[(Evaluation, Option<Evaluation>)]) -> Agreement {
    let mut out = Agreement { same: 0, n: 0, disagreements: BTreeMap::new() };
    for (judged, other) in both.iter().filter_map(|(j, o)| Some((j, o.as_ref()?))) {
        out.n += 1;
        if judged.held() == other.held() {
            out.same += 1;
        } else {
            *out.disagreements.entry(format!("{}/{}", name(judged.verdict), name(other.verdict))).or_insert(0) += 1;
        }
    }
    out
}

/// The verdict as JSON and tables spell it.
fn name(verdict: Verdict) -> String {
    match serde_json::to_value(verdict) {
        Ok(serde_json::Value::String(text)) => text,
        _ => format!("{verdict:?}"),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::formula::PinchByFirstJoint;
    use drex_core::Pose;
    use drex_grasp::Grasp;
    use drex_robot::Robot;
    use drex_trial::ConditionSpread;

    #[test]
    fn the_grip_does_not_change_with_what_is_told_where_it_is_chosen_by_what_is_true() {
        let grasp = Grasp::new(&Robot::bundled("leap_right").unwrap(), Vec::new(), Pose::identity());
        let proposal = |strongest_n: f64, weight: f64| Proposal {
            grasp: Grasp { joints_rad: vec![strongest_n], ..grasp.clone() },
            grip_force_n: 0.0,
            weight,
        };
        // 100 g take 4.5 N at the lowest friction that is told, 300 g 13.
        let actor = Actor::Always(vec![proposal(7.0, 0.9), proposal(50.0, 0.1)]);
        let conditions = ConditionSpread::around(Some(0.5)).conditions(30, 4);
        let run = |told, choice| {
            let setting = Setting { mass_kg: 0.1, told: AssumedMass::Times(told), force: Force::Law, choice };
            let cell = Cell {
                labels: vec![],
                evaluator: &PinchByFirstJoint,
                actor: &actor,
                setting,
                least_friction: None,
                compare: false,
            };
            cell.run(&conditions).unwrap()
        };
        assert_eq!(run(1.0, Choice::True).successes, 30);
        let row = run(3.0, Choice::True);
        assert_eq!((row.successes, row.failures["torque_limit"]), (0, 30), "the weak grip, refused");
        assert_eq!(run(3.0, Choice::AssumedMass).successes, 30, "the strong one");
    }
}
