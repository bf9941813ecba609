//! One cell of a table: who grasps, what the hand is told, how hard it grips; and the rollouts of it.

use drex_core::stats::upper_median;
use std::collections::BTreeMap;

use anyhow::Result;
use drex_grasp::GripForcePolicy;
use drex_trial::{
    Assumed, Condition, Evaluation, Evaluator, GraspPath, Interval, NoCommand, PathForce, Proposal, Uncertainty,
    Verdict, wilson,
};
use drex_twin::learn::Learned;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

/// Says which grasps there are for what is assumed.
pub type Propose<'a> = dyn Fn(&Assumed) -> Result<Vec<Proposal>> + Sync + 'a;

/// Who proposes grasps.
pub enum Actor<'a> {
    /// The network, for an object with these points and what is up for it.
    Policy(&'a Learned, &'a [Point3<f64>], Vector3<f64>),
    /// Always these, best first.
    Always(Vec<Proposal>),
    /// Whoever answers what is asked for.
    Asked(Box<Propose<'a>>),
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

/// What the hand takes the friction for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AssumedFriction {
    /// What it is, to within the error of the condition.
    Known,
    /// Anywhere in the range of the protocol.
    Unknown,
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
    pub friction: AssumedFriction,
    /// From proposals to a command.
    pub path: GraspPath,
    /// By which mass a grip is chosen among those proposed.
    pub choice: Choice,
}

impl Setting {
    /// The whole path for an object of this mass, chosen by what the hand takes it for, with the friction told.
    pub fn assuming(mass_kg: f64, told: AssumedMass) -> Self {
        let (friction, path) = (AssumedFriction::Known, GraspPath::default());
        Self { mass_kg, told, friction, path, choice: Choice::AssumedMass }
    }

    /// The same, chosen by what it is.
    pub fn chosen_by_truth(mass_kg: f64, told: AssumedMass) -> Self {
        Self { choice: Choice::True, ..Self::assuming(mass_kg, told) }
    }
}

/// One cell.
pub struct Cell<'a, E: Evaluator> {
    pub labels: Vec<(&'static str, String)>,
    pub evaluator: &'a E,
    pub actor: &'a Actor<'a>,
    pub setting: Setting,
    /// Largest normal force of a finger before the object is damaged, N, which nobody tells the hand.
    pub damaged_at_n: Option<f64>,
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
    /// How often each rule was broken first, of what was carried out.
    pub failures: BTreeMap<String, usize>,
    /// Why there was no command, and how often.
    pub refusals: BTreeMap<String, usize>,
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

/// One rollout of a cell.
struct Rollout {
    evaluation: Evaluation,
    /// What the engine of the practice says, if that is compared and there was a command.
    other: Option<Evaluation>,
    /// There was no command.
    refused: bool,
}

impl<E: Evaluator> Cell<'_, E> {
    /// All rollouts of the cell. The same for any number of threads.
    ///
    /// # Errors
    /// If something cannot be simulated.
    pub fn run(&self, conditions: &[Condition]) -> Result<Row> {
        let rollouts: Vec<Rollout> = conditions.par_iter().map(|c| self.rollout(c)).collect::<Result<_>>()?;
        let agreement = self.compare.then(|| agreement(&rollouts));
        let (mut failures, mut refusals) = (BTreeMap::new(), BTreeMap::new());
        for r in rollouts.iter().filter(|r| !r.evaluation.held()) {
            let counts = if r.refused { &mut refusals } else { &mut failures };
            *counts.entry(name(r.evaluation.verdict)).or_insert(0) += 1;
        }
        let evaluations: Vec<Evaluation> = rollouts.into_iter().map(|r| r.evaluation).collect();
        let held: Vec<bool> = evaluations.iter().map(Evaluation::held).collect();
        let successes = held.iter().filter(|h| **h).count();
        let n = evaluations.len();
        let within = conditions.iter().filter(|c| self.least_friction.is_some_and(|mu| c.friction >= mu)).count();
        Ok(Row {
            labels: self.labels.iter().cloned().collect(),
            successes,
            n,
            interval: wilson(successes, n),
            failures,
            refusals,
            bound: within as f64 / n.max(1) as f64,
            median_grip_force_n: upper_median(evaluations.iter().map(|e| e.grip_force_n).filter(|s| *s > 0.0)),
            median_delivered_n: upper_median(evaluations.iter().filter_map(|e| e.held_n)),
            agreement,
            held,
        })
    }

    fn rollout(&self, condition: &Condition) -> Result<Rollout> {
        let truth = condition.truth(self.setting.mass_kg);
        match self.plan(condition)? {
            Ok(command) => {
                let other = self.compare.then(|| self.evaluator.validate(&command, &truth)).transpose()?;
                let other = other.map(|other| self.or_damaged(other));
                Ok(Rollout {
                    evaluation: self.or_damaged(self.evaluator.evaluate(&command, &truth)?),
                    other,
                    refused: false,
                })
            }
            Err(reason) => Ok(Rollout { evaluation: Evaluation::refused(&reason), other: None, refused: true }),
        }
    }

    /// What holds has not held if a finger pressed harder than the object stands.
    fn or_damaged(&self, evaluation: Evaluation) -> Evaluation {
        match self.damaged_at_n.is_some_and(|most| evaluation.held() && evaluation.peak_finger_n > most) {
            true => Evaluation { verdict: Verdict::Crushed, safety_margin: 0.0, ..evaluation },
            false => evaluation,
        }
    }

    /// What the hand is commanded.
    pub fn plan(&self, condition: &Condition) -> Result<Result<E::Command, NoCommand>> {
        let Setting { mass_kg, told, friction, path, choice } = &self.setting;
        let told_kg = told.mass_kg(*mass_kg, condition.mass_error);
        let chosen_for_kg = match choice {
            // The force of a proposal is for what was asked, which must not be the truth.
            Choice::True if path.force != PathForce::Proposed => *mass_kg,
            Choice::True | Choice::AssumedMass => told_kg,
        };
        let chosen_for = friction.assumptions(condition, chosen_for_kg)?;
        let proposals = self.actor.propose(&chosen_for[0])?;
        if proposals.is_empty() {
            return Ok(Err(NoCommand::NoContact { touching: 0 }));
        }
        let planned = path.plan_in_turn(self.evaluator, proposals, &chosen_for)?;
        if chosen_for_kg == told_kg || planned.command.is_err() {
            return Ok(planned.command);
        }
        // It is this grip, also where there is no force for what is told: cells differ in force alone.
        let told = Assumed { mass_kg: told_kg, ..chosen_for[planned.turn] };
        Ok(self.evaluator.command(&planned.closed, &told, path.grip_force(&planned.proposal))?)
    }
}

impl AssumedFriction {
    /// What the hand assumes in turn of an object that it takes for `mass_kg`.
    fn assumptions(self, condition: &Condition, mass_kg: f64) -> Result<Vec<Assumed>> {
        match self {
            Self::Known => Ok(vec![condition.assumed(mass_kg)]),
            Self::Unknown => {
                let uncertainty = Uncertainty::new(vec![mass_kg], Uncertainty::ANY_FRICTION)?;
                Ok(uncertainty.in_turn(&GripForcePolicy::default()).map(|(_, assumed)| assumed).to_vec())
            }
        }
    }
}

impl Actor<'_> {
    /// Proposals for what is assumed.
    pub fn propose(&self, assumed: &Assumed) -> Result<Vec<Proposal>> {
        match self {
            Self::Policy(policy, points, up) => Ok(policy.propose(points, up, assumed)?),
            Self::Always(proposals) => Ok(proposals.clone()),
            Self::Asked(propose) => propose(assumed),
        }
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

/// Counts the rollouts that both engines carried out.
fn agreement(rollouts: &[Rollout]) -> Agreement {
    let mut out = Agreement { same: 0, n: 0, disagreements: BTreeMap::new() };
    for (evaluation, other) in rollouts.iter().filter_map(|r| Some((&r.evaluation, r.other.as_ref()?))) {
        out.n += 1;
        if evaluation.held() == other.held() {
            out.same += 1;
        } else {
            *out.disagreements.entry(format!("{}/{}", name(evaluation.verdict), name(other.verdict))).or_insert(0) += 1;
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

    use std::sync::Arc;

    use super::*;
    use crate::formula::PinchByFirstJoint;
    use crate::object::BenchObject;
    use crate::objects;
    use drex_core::Pose;
    use drex_grasp::{Grasp, synthesize_grasps};
    use drex_hw::control::EStop;
    use drex_policy::TrainOptions;
    use drex_robot::Robot;
    use drex_trial::{Command, ConditionSpread, Engine, TrialEvaluator, TrialOptions};
    use drex_twin::Predictor;
    use drex_twin::deploy::{DeployOptions, deploy};
    use drex_twin::learn::{LearnOptions, POINTS};

    #[test]
    fn the_grip_does_not_change_with_what_is_told_where_it_is_chosen_by_what_is_true() {
        let grasp = Grasp::new(&Robot::bundled("leap_right").unwrap(), Vec::new(), Pose::identity());
        let proposal = |strongest_n: f64, weight: f64| Proposal {
            grasp: Grasp { joints_rad: vec![strongest_n], ..grasp.clone() },
            grip_force_n: 0.0,
            weight,
        };
        // 100 g take 4.5 N at the lowest friction that is told, 7.5 N at 0.6 of it, 300 g 13.
        let actor = Actor::Always(vec![proposal(8.0, 0.9), proposal(50.0, 0.1)]);
        let conditions = ConditionSpread::around(Some(0.5)).conditions(30, 4);
        let run = |told, choice| {
            let path = GraspPath::default();
            let setting = Setting { path, choice, ..Setting::assuming(0.1, AssumedMass::Times(told)) };
            let cell = Cell {
                labels: vec![],
                evaluator: &PinchByFirstJoint,
                actor: &actor,
                setting,
                damaged_at_n: None,
                least_friction: None,
                compare: false,
            };
            cell.run(&conditions).unwrap()
        };
        assert_eq!(run(1.0, Choice::True).successes, 30);
        let row = run(3.0, Choice::True);
        assert_eq!((row.successes, row.refusals["torque_limit"]), (0, 30), "the weak grip, refused");
        assert_eq!(run(3.0, Choice::AssumedMass).successes, 30, "the strong one");
    }

    #[test]
    fn crushed_slipped_and_refused_are_counted_apart() {
        let grasp = Grasp::new(&Robot::bundled("leap_right").unwrap(), Vec::new(), Pose::identity());
        let grasp = Grasp { joints_rad: vec![12.0], ..grasp };
        let actor = Actor::Always(vec![Proposal { grasp, grip_force_n: 0.0, weight: 1.0 }]);
        let conditions = ConditionSpread::around(Some(0.5)).conditions(30, 4);
        let run = |assumed, damaged_at_n| {
            let cell = Cell {
                labels: vec![],
                evaluator: &PinchByFirstJoint,
                actor: &actor,
                setting: Setting::assuming(0.1, AssumedMass::Times(assumed)),
                damaged_at_n,
                least_friction: None,
                compare: true,
            };
            let row = cell.run(&conditions).unwrap();
            let counts = |of: &BTreeMap<String, usize>| of.iter().map(|(k, n)| format!("{k} {n}")).collect::<String>();
            (row.successes, counts(&row.failures), counts(&row.refusals), row.agreement.unwrap().same)
        };
        // 100 g take 3.7 to 4.5 N, half of it on each side.
        assert_eq!(run(1.0, None), (30, String::new(), String::new(), 30));
        assert_eq!(run(1.0, Some(3.0)), (30, String::new(), String::new(), 30));
        assert_eq!(run(2.0, None), (30, String::new(), String::new(), 30));
        assert_eq!(run(2.0, Some(3.0)), (0, "crushed 30".into(), String::new(), 30));
        assert_eq!(run(0.5, Some(3.0)), (0, "slip 30".into(), String::new(), 30));
        assert_eq!(run(4.0, Some(3.0)), (0, String::new(), "torque_limit 30".into(), 0));
    }

    struct Silent;

    impl drex_twin::Progress for Silent {}

    #[test]
    fn what_is_deployed_is_what_a_table_evaluates() {
        let robot = Arc::new(Robot::bundled("leap_right").unwrap());
        let object = BenchObject::new(&objects::named("cube").unwrap()).unwrap().object.with_mass(0.08);
        let evaluator = TrialEvaluator::new(&object, &robot, &TrialOptions::default(), Engine::Diffsim).unwrap();
        let mut grasps = synthesize_grasps(&object, &robot, 4000, 5).unwrap();
        grasps.truncate(12);
        let options = LearnOptions {
            train: TrainOptions::default().with_epochs(40).with_points(POINTS).with_seed(5),
            spread: ConditionSpread::around(Some(object.friction)),
            simulated: 0,
            shake_m_s2: 4.9,
            masses_kg: Vec::new(),
            mass_hidden: false,
        };
        let learned = Learned::train(&object, &robot, &grasps, &evaluator, &options).unwrap();

        let points = object.point_cloud(POINTS, 5);
        let actor = Actor::Policy(&learned, &points, object.table().up.into_inner());
        let (told, path) = (AssumedMass::Times(1.0), GraspPath::default());
        let setting = Setting { path, ..Setting::assuming(object.mass_kg(), told) };
        let evaluator = &evaluator;
        let of = |setting| {
            let (labels, damaged_at_n, least_friction, compare) = (vec![], None, None, false);
            Cell { labels, evaluator, actor: &actor, setting, damaged_at_n, least_friction, compare }
        };
        let cell = of(setting);
        let (kg, friction) = (object.mass_kg(), object.friction);
        let condition = ConditionSpread::around(Some(friction)).conditions(1, 5)[0];
        let condition = Condition { friction_factor: 1.0, friction, ..condition };
        let tabled = cell.plan(&condition).unwrap().unwrap();

        let folder = tempfile::tempdir().unwrap();
        learned.policy().save(folder.path()).unwrap();
        let world_from_object = Pose::translation(0.4, -0.2, 0.0) * object.world_from_object;
        let placed = object.with_rest_pose(world_from_object);
        let mut predictor = Predictor::new(learned.policy().clone(), (*robot).clone(), placed, 5);
        predictor.folder = folder.path().to_owned();
        let prediction = predictor.predict().unwrap();
        // All digits of all numbers.
        let bytes = |command: &Command| format!("{command:?}");
        assert_eq!(bytes(prediction.command.as_ref().unwrap()), bytes(&tabled));
        assert!(bytes(&tabled).contains(&format!("{:?}", prediction.reach)), "fingers open and close otherwise");

        // A network's force is the one for what the hand is told, whatever is true.
        let by_network = |mass_kg: f64, told: AssumedMass| {
            let path = GraspPath { force: PathForce::Proposed, ..GraspPath::default() };
            let setting = Setting { path, ..Setting::chosen_by_truth(mass_kg, told) };
            bytes(&of(setting).plan(&condition).unwrap().unwrap())
        };
        let half = 0.5 * kg;
        assert_eq!(by_network(kg, AssumedMass::Always(half)), by_network(half, AssumedMass::Times(1.0)));
        assert_ne!(by_network(kg, AssumedMass::Always(half)), by_network(kg, AssumedMass::Times(1.0)));

        deploy(&predictor, &prediction, &DeployOptions::default(), &EStop::new(), &Silent).unwrap();
        let text = std::fs::read(folder.path().join("deploy.json")).unwrap();
        let file: serde_json::Value = serde_json::from_slice(&text).unwrap();
        assert_eq!(file["grasp"]["needed_squeeze_n"], tabled.grip_force_n);
        assert_eq!(file["grasp"]["joints_rad"], serde_json::json!(tabled.joints));
        assert_eq!(file["open_rad"], serde_json::json!(prediction.reach.open));
    }
}
