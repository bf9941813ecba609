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

use super::bound::{self, Load};
use super::judge::{Condition, Judge, Judged, Spread};
use super::library::{Grasp, Kind};
use super::thing::Thing;

/// The network learns the force at these multiples of the object's mass.
const MASS_FACTORS: [f64; 3] = [0.4, 1.0, 2.0];
/// Frictions of the force labels.
const FRICTIONS: [f64; 3] = [0.35, 0.5, 0.75];
/// Stages of practice: conditions under which a grasp is tried, and of how many of the first stage one goes on to the next.
const STAGES: [(usize, usize); 3] = [(3, 2), (5, 4), (16, 4)];
/// Of so many grasps that look easiest on paper one is practised: closing on the object as a rehearsal says more, and takes longer.
const REHEARSED_FOR_ONE: usize = 4;
/// Share of the law's force with which grasps are practised: what holds with less does not hang on what one simulator gets wrong.
const PRACTICE_FORCE: f64 = 0.85;
/// Share of the best grasp's holds that another one needs to be learned: as it is, and if it holds where no better one does.
const NEARLY_AS_GOOD: f64 = 0.9;
const WHERE_OTHERS_FAIL: f64 = 0.7;
/// Rounds of rollouts of the network, views of a round, tries of a view.
const ROUNDS: (usize, usize, usize) = (10, 6, 8);
/// Grasps that the network learns, at most.
const LEARNED: usize = 24;
/// Set apart from the seeds of judged rollouts.
const PRACTICE_SEED: u64 = 0x70_72_61_63;

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
    /// What the motors and the protocol are on paper.
    pub load: Load,
    /// Masses of the labels, kg; empty: multiples of the object's own.
    pub masses_kg: Vec<f64>,
    /// The network is told the same mass whatever it was: what randomising masses in training amounts to.
    pub mass_hidden: bool,
}

/// A trained policy.
pub struct Learned {
    policy: GraspPolicy,
    up: Vector3<f64>,
    /// What it is told in place of the mass.
    told_kg: Option<f64>,
    /// Grasps of the library that can be commanded, that held in practice under most conditions, and that were learned.
    pub commanded: usize,
    pub robust: usize,
    pub learned: usize,
    /// Those of them that were demonstrated rather than searched for.
    pub demonstrated: usize,
    /// How the training went.
    pub report: TrainReport,
    /// Grasps and forces that were learned from.
    pub samples: usize,
    /// Time of the practice, of learning from demonstrations and of learning from rollouts, s.
    pub seconds: [f64; 3],
}

/// A grasp of the library as it went in practice.
struct Practised<'a> {
    grasp: &'a Grasp,
    fingers: Vec<bool>,
    /// Per condition, whether it held.
    held: Vec<bool>,
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
        let (commanded, mut practised) = practise(thing, robot, grasps, judge, practice_kg, options)?;
        let robust = practised.iter().filter(|p| !p.held.is_empty() && 4 * count(p) >= 3 * p.held.len()).count();
        practised = chosen(practised);
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
        let demonstrated = practised.iter().filter(|p| p.grasp.kind == Kind::Retargeted).count();
        let (learned, samples) = (practised.len(), data.samples.len());
        Ok(Self { policy, up, told_kg, commanded, robust, learned, demonstrated, report, samples, seconds })
    }

    /// The network.
    pub fn policy(&self) -> &GraspPolicy {
        &self.policy
    }

    /// The grasps for an object with these points, the most probable first.
    ///
    /// # Errors
    /// If the policy is not defined for what is asked.
    pub fn propose(&self, points: &[Point3<f64>], belief: &Belief) -> Result<Vec<Proposal>> {
        let query = Query::new(points, self.told_kg.unwrap_or(belief.mass_kg), belief.friction).with_up(self.up);
        let proposals = self.policy.predict(&query)?.into_iter().map(|g| Proposal {
            joints: g.joints,
            object_from_palm: g.object_from_palm,
            squeeze_n: g.squeeze_n,
            weight: g.weight,
        });
        Ok(proposals.collect())
    }
}

/// Rehearses every grasp, and carries those that need least force out under conditions that no judged rollout has, at each mass
/// in turn.
fn practise<'a, J: Judge>(
    thing: &Thing,
    robot: &Robot,
    grasps: &'a [Grasp],
    judge: &J,
    masses_kg: &[f64],
    options: &LearnOptions,
) -> Result<(usize, Vec<Practised<'a>>)> {
    let spread = &options.spread;
    let all = STAGES.iter().map(|s| s.0).sum();
    let conditions: Vec<(Condition, f64)> = spread
        .conditions(all, options.train.seed ^ PRACTICE_SEED)
        .into_iter()
        .zip(masses_kg.iter().copied().cycle())
        .collect();
    let middle = 0.5 * (spread.friction.0 + spread.friction.1);
    // What carries the heaviest where it is smooth carries the others. What can be held where friction is higher counts as well, and what
    // carries the lightest alone: for some objects nothing else can.
    let frictions = [spread.friction.0, middle, spread.friction.1];
    let heaviest = masses_kg.iter().copied().fold(0.0, f64::max);
    let lightest = masses_kg.iter().copied().fold(f64::INFINITY, f64::min);
    let at = |mass_kg: f64| frictions.map(|friction| Belief { mass_kg, friction });
    let mut beliefs = at(heaviest).to_vec();
    if lightest < heaviest {
        beliefs.extend(at(lightest));
    }
    // On paper first.
    let carried = bound::carried(thing, robot, grasps, heaviest, &frictions, &options.load)?;
    let place = |at: Option<usize>| at.unwrap_or(frictions.len());
    let mut easiest: Vec<(usize, &Grasp)> = carried.into_iter().map(place).zip(grasps).collect();
    easiest.sort_by(|(i, a), (j, b)| i.cmp(j).then(a.squeeze_per_weight.total_cmp(&b.squeeze_per_weight)));
    easiest.truncate(REHEARSED_FOR_ONE * options.practised.max(LEARNED));
    let gripped: Vec<Option<(f64, &Grasp, J::Grip)>> = easiest
        .into_par_iter()
        .map(|(_, g)| {
            let grip = judge.grip(&g.joints_rad, &g.pose()?, &Belief { mass_kg: heaviest, friction: middle })?;
            for (place, belief) in beliefs.iter().enumerate() {
                if let Ok(plan) = judge.plan(&grip, belief, Squeeze::Needed)? {
                    return Ok(Some((judge.squeeze_n(&plan) + 1e3 * place as f64, g, grip)));
                }
            }
            Ok(None)
        })
        .collect::<Result<_>>()?;
    let mut gripped: Vec<(f64, &Grasp, J::Grip)> = gripped.into_iter().flatten().collect();
    let commanded = gripped.len();
    gripped.sort_by(|a, b| a.0.total_cmp(&b.0));
    gripped.truncate(if options.practised == 0 { LEARNED } else { options.practised });
    let mut practised: Vec<(Practised<'_>, &J::Grip)> = gripped
        .iter()
        .map(|(_, grasp, grip)| (Practised { grasp, fingers: judge.fingers(grip), held: Vec::new() }, grip))
        .collect();
    // Few conditions for all of them, the others for those that went best.
    let mut conditions = &conditions[..];
    for (count_of, one_of) in STAGES {
        if options.practised == 0 {
            break;
        }
        let (now, later) = conditions.split_at(count_of);
        conditions = later;
        practised.par_iter_mut().try_for_each(|(p, grip)| {
            for (condition, mass_kg) in now {
                p.held.push(attempt(judge, grip, condition, *mass_kg)?.held());
            }
            anyhow::Ok(())
        })?;
        practised.sort_by_key(|(p, _)| std::cmp::Reverse(count(p)));
        practised.truncate(options.practised.div_ceil(one_of));
    }
    let practised = practised.into_iter().map(|p| p.0).collect();
    Ok((commanded, practised))
}

/// A grip with a little less than the force of the law, carried out.
fn attempt<J: Judge>(judge: &J, grip: &J::Grip, condition: &Condition, mass_kg: f64) -> Result<Judged> {
    let belief = condition.belief(mass_kg);
    let needed = match judge.plan(grip, &belief, Squeeze::Needed)? {
        Ok(plan) => judge.squeeze_n(&plan),
        Err(reason) => return Ok(Judged::refused(&reason)),
    };
    match judge.plan(grip, &belief, Squeeze::Total(PRACTICE_FORCE * needed))? {
        Ok(plan) => judge.practise(&plan, &condition.truth(mass_kg)),
        Err(reason) => Ok(Judged::refused(&reason)),
    }
}

fn count(p: &Practised<'_>) -> usize {
    p.held.iter().filter(|h| **h).count()
}

/// Of those sorted by success the best ones, and before them whatever holds under a condition that no better one stands.
fn chosen(practised: Vec<Practised<'_>>) -> Vec<Practised<'_>> {
    let best = practised.first().map_or(0, count) as f64;
    let holds = |p: &Practised<'_>, share: f64| count(p) as f64 >= share * best;
    let mut out: Vec<Practised<'_>> = Vec::new();
    let mut rest = Vec::new();
    for p in practised {
        let new = p.held.iter().enumerate().any(|(c, held)| *held && !out.iter().any(|o| o.held[c]));
        if new && holds(&p, WHERE_OTHERS_FAIL) { out.push(p) } else { rest.push(p) }
    }
    let room = LEARNED.saturating_sub(out.len());
    // Those that often fail where others hold would only be in the way; where nothing holds, they are all there is.
    out.extend(rest.into_iter().filter(|p| holds(p, NEARLY_AS_GOOD)).take(room));
    out
}

/// The grasp with the force that it needs at each of the masses and frictions.
fn samples<J: Judge>(
    practised: &Practised<'_>,
    judge: &J,
    masses: &[f64],
    told_kg: Option<f64>,
) -> Result<Vec<GraspSample>> {
    let (grasp, object_from_palm) = (practised.grasp, practised.grasp.pose()?);
    let mut out = Vec::new();
    let grip =
        judge.grip(&grasp.joints_rad, &object_from_palm, &Belief { mass_kg: masses[0], friction: FRICTIONS[1] })?;
    for (mass_kg, friction) in masses.iter().flat_map(|m| FRICTIONS.map(|f| (*m, f))) {
        let belief = Belief { mass_kg, friction };
        if let Ok(plan) = judge.plan(&grip, &belief, Squeeze::Needed)? {
            out.push(GraspSample {
                object: 0,
                joints: grasp.joints_rad.clone(),
                object_from_palm,
                contacts: practised.fingers.clone(),
                squeeze_n: judge.squeeze_n(&plan),
                mass_kg: told_kg.unwrap_or(mass_kg),
                friction,
            });
        }
    }
    Ok(out)
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
        let needed = self.judge.plan(&grip, &belief, Squeeze::Needed)?.ok().map(|plan| self.judge.squeeze_n(&plan));
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
