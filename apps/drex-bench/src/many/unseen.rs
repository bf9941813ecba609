//! How grasps of objects that no network has seen hold: those that a network proposes beside those that a search finds.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use anyhow::Result;
use drex_core::stats::normal_pair;
use drex_core::{Object, Pose};
use drex_grasp::{FingerClosing, Grasp, pinch_grasps, power_grasps};
use drex_policy::Query;
use drex_policy::proposal::ProposalNetwork;
use drex_robot::Robot;
use drex_trial::{
    Assumed, Condition, ConditionSpread, Engine, Evaluator as _, GripForce, Interval, Mismatch, Proposal,
    SelectionOptions, TrialEvaluator, TrialOptions, clustered, clustered_difference, select_grasps,
};
use drex_twin::propose::proposals;
use nalgebra::{Point3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use super::data::cloud;
use super::{Category, at_rest, graspable};
use crate::cell::{Actor, AssumedFriction, AssumedMass, Cell, Row, Setting};
use crate::table::{counted, markdown_line, percent};

/// Grasps that go through the path, at most.
const PLACED: usize = 10;
/// Pinches that a search looks at for one power grasp that it tries.
const PINCHES_PER_POWER: usize = 50;
/// Grasps of a search that are closed at most.
const CLOSED: usize = 400;
/// Of those that are closed, how many go through the path of each rollout.
const KEPT: usize = 10;

/// Grasps that are tried before.
const TRIED: usize = 20;
/// In the middle of the frictions of the rollouts.
const MIDDLE_FRICTION: f64 = 0.55;
/// Standard deviation of noisy points in each direction, metres, and what distinguishes its seed.
const NOISE_M: f64 = 0.002;
const NOISE_SEED: u64 = 0x6e6f_6973;

/// What is compared.
#[derive(Debug, Clone)]
pub struct UnseenOptions {
    /// Objects, numbered from `first`.
    pub first: u64,
    pub count: u64,
    /// Rollouts of each.
    pub rollouts: usize,
    /// Pinches that the exhaustive search looks at.
    pub search: usize,
    /// Engine of the evaluated trials.
    pub engine: Engine,
    pub seed: u64,
}

/// Who proposes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    /// The network, which sees the object from all sides; its best proposal alone, or ten.
    Network(usize),
    /// The object and the points that are seen of it turned about the vertical.
    Turned,
    /// What one camera sees of it.
    OneView,
    /// The same, each point off by up to millimetres.
    Noisy,
    /// All of it, but nobody knows the friction.
    UnknownFriction,
    /// All of it, but surface, centre of mass and hand are others than those that it is planned for: [`Mismatch`].
    Off,
    /// Those of its proposals that held best where [`TRIED`] of them were tried in simulation, at all frictions; where all is as planned, and where it is not.
    Tried,
    TriedOff,
    /// A search with so many hundredths of the effort.
    Search(usize),
}

const WAYS: [Way; 11] = [
    Way::Network(1),
    Way::Network(PLACED),
    Way::Turned,
    Way::OneView,
    Way::Noisy,
    Way::UnknownFriction,
    Way::Off,
    Way::Tried,
    Way::TriedOff,
    Way::Search(10),
    Way::Search(100),
];

/// Place in [`WAYS`] of what the others are compared with.
const REFERENCE: usize = 1;

impl Way {
    fn name(self) -> String {
        match self {
            Self::Network(1) => "network, its first".into(),
            Self::Network(n) => format!("network, its first {n}"),
            Self::Turned => "network, object turned".into(),
            Self::OneView => "network, one view".into(),
            Self::Noisy => "network, noisy view".into(),
            Self::UnknownFriction => "network, friction unknown".into(),
            Self::Off => "network, object and hand off".into(),
            Self::Tried => "network, tried".into(),
            Self::TriedOff => "network, tried, object and hand off".into(),
            Self::Search(100) => "search".into(),
            Self::Search(hundredths) => format!("search, {hundredths} % of it"),
        }
    }
}

/// A line of the table.
#[derive(Debug, Clone, Serialize)]
pub struct UnseenRow {
    /// Who proposes.
    pub way: String,
    /// Rollouts that held, and of how many.
    pub successes: usize,
    pub n: usize,
    /// 95 %, clustered by object.
    pub interval: Interval,
    /// The rate less that of the network's first ten under the same conditions, 95 %, clustered by object.
    pub difference: Interval,
    /// How often each rule was broken first, of what was carried out.
    pub failures: BTreeMap<String, usize>,
    /// Why there was no command, and how often.
    pub refusals: BTreeMap<String, usize>,
    /// Grasps that go through the path per rollout, mean.
    pub candidates: f64,
    /// Time of the network, and to place what it proposes, ms per rollout; of a search, which is made once for each object, all of it.
    pub propose_ms: f64,
    pub place_ms: f64,
}

/// What was counted of one way with one object.
#[derive(Debug, Default, Clone, Copy)]
struct Tally {
    asked: usize,
    placed: usize,
    propose_s: f64,
    place_s: f64,
}

/// Runs the comparison; `say` gets a line for each object.
///
/// # Errors
/// If an object cannot be made or simulated.
pub fn unseen(
    network: &ProposalNetwork,
    hand: &Arc<Robot>,
    options: &UnseenOptions,
    say: &dyn Fn(String),
) -> Result<Vec<UnseenRow>> {
    let mut all: Vec<Vec<(Row, Tally)>> = WAYS.iter().map(|_| Vec::new()).collect();
    for number in options.first..options.first + options.count {
        let spec = graspable(&Category::HELD_OUT, options.seed, number)?;
        let seed = options.seed.wrapping_add(number);
        let object = at_rest(&spec, seed)?;
        let conditions = ConditionSpread::default().conditions(options.rollouts, seed);
        let start = Instant::now();
        let tried = tried(network, hand, &object, seed)?;
        let tried = (tried, start.elapsed().as_secs_f64());
        let mut line = format!("{:14} {:4.0} g", spec.name, 1e3 * spec.mass_kg);
        for (way, rows) in WAYS.into_iter().zip(&mut all) {
            let (row, tally) = one(network, hand, (&object, &tried), way, &conditions, options, seed)?;
            line += &format!("  {:2}", row.successes);
            rows.push((row, tally));
        }
        say(line);
    }
    let reference = &all[REFERENCE];
    Ok(WAYS.into_iter().zip(&all).map(|(way, rows)| summary(way, rows, reference)).collect())
}

fn summary(way: Way, rows: &[(Row, Tally)], reference: &[(Row, Tally)]) -> UnseenRow {
    let groups: Vec<(usize, usize)> = rows.iter().map(|(r, _)| (r.successes, r.n)).collect();
    let both: Vec<(usize, usize, usize)> =
        rows.iter().zip(reference).map(|((a, _), (b, _))| (a.successes, b.successes, a.n)).collect();
    let counts = |of: fn(&Row) -> &BTreeMap<String, usize>| {
        let mut sum = BTreeMap::new();
        for (name, n) in rows.iter().flat_map(|(r, _)| of(r)) {
            *sum.entry(name.clone()).or_insert(0) += n;
        }
        sum
    };
    let mean = |of: &dyn Fn(&Tally) -> f64| {
        let asked: usize = rows.iter().map(|(_, t)| t.asked).sum();
        rows.iter().map(|(_, t)| of(t)).sum::<f64>() / asked.max(1) as f64
    };
    UnseenRow {
        way: way.name(),
        successes: groups.iter().map(|g| g.0).sum(),
        n: groups.iter().map(|g| g.1).sum(),
        interval: clustered(&groups),
        difference: clustered_difference(&both),
        refusals: counts(|r| &r.refusals),
        failures: counts(|r| &r.failures),
        candidates: mean(&|t| t.placed as f64),
        propose_ms: 1e3 * mean(&|t| t.propose_s),
        place_ms: 1e3 * mean(&|t| t.place_s),
    }
}

fn one(
    network: &ProposalNetwork,
    hand: &Arc<Robot>,
    // With grasps that were tried in simulation, and how long that took, s.
    (object, tried): (&Object, &(Vec<Proposal>, f64)),
    way: Way,
    conditions: &[Condition],
    options: &UnseenOptions,
    seed: u64,
) -> Result<(Row, Tally)> {
    let turned = object.clone().with_rest_pose(Pose::rotation(Vector3::z() * 2.0) * object.world_from_object);
    let object = if way == Way::Turned { &turned } else { object };
    let evaluator = TrialEvaluator::new(object, hand, &TrialOptions::default(), options.engine)?;
    let evaluator = match way {
        Way::Off | Way::TriedOff => evaluator.evaluating_with(Mismatch::default()),
        _ => evaluator,
    };
    let closing = FingerClosing::new(hand)?;
    let tally = Mutex::new(Tally::default());
    let count = |of: &dyn Fn(&mut Tally)| tally.lock().map(|mut t| of(&mut t)).unwrap_or_default();
    // What is made once for each object.
    let once = |seconds: f64, placed: usize| {
        count(&|t| {
            t.asked += conditions.len();
            t.placed += placed * conditions.len();
            t.propose_s += seconds * conditions.len() as f64;
        });
    };
    let (points, views) = cloud(object, seed);
    let seen: Vec<Point3<f64>> = match views.first() {
        Some(view) if matches!(way, Way::OneView | Way::Noisy) => {
            view.iter().map(|i| points[usize::from(*i)]).collect()
        }
        _ => points,
    };
    let seen = if way == Way::Noisy { noisy(&seen, seed) } else { seen };
    let propose = |assumed: &Assumed, most: usize| -> Result<Vec<Proposal>> {
        let start = Instant::now();
        network.propose(&Query::new(&seen, assumed.mass_kg, assumed.friction), most)?;
        let (propose_s, start) = (start.elapsed().as_secs_f64(), Instant::now());
        let placed = proposals(network, &closing, object, &seen, assumed, most, seed)?;
        count(&|t| {
            t.asked += 1;
            t.placed += placed.len();
            t.propose_s += propose_s;
            t.place_s += start.elapsed().as_secs_f64() - propose_s;
        });
        Ok(placed)
    };
    let actor = match way {
        Way::Network(most) => Actor::Asked(Box::new(move |a| propose(a, most))),
        Way::Turned | Way::OneView | Way::Noisy | Way::UnknownFriction | Way::Off => {
            Actor::Asked(Box::new(move |a| propose(a, PLACED)))
        }
        Way::Tried | Way::TriedOff => {
            once(tried.1, tried.0.len());
            Actor::Always(tried.0.clone())
        }
        Way::Search(hundredths) => {
            let start = Instant::now();
            let kept = searched(object, hand, &evaluator, options.search, hundredths, seed)?;
            once(start.elapsed().as_secs_f64(), kept.len());
            Actor::Always(kept)
        }
    };
    let friction = match way {
        Way::UnknownFriction => AssumedFriction::Unknown,
        _ => AssumedFriction::Known,
    };
    let setting = Setting { friction, ..Setting::assuming(object.mass_kg(), AssumedMass::Times(1.0)) };
    let cell = Cell {
        labels: Vec::new(),
        evaluator: &evaluator,
        actor: &actor,
        setting,
        damaged_at_n: None,
        least_friction: None,
        compare: false,
    };
    let row = cell.run(conditions)?;
    drop(cell);
    drop(actor);
    let tally = tally.into_inner().unwrap_or_default();
    Ok((row, tally))
}

/// The grasps of the network that hold best in simulation, under conditions that no rollout of the table has.
fn tried(network: &ProposalNetwork, hand: &Arc<Robot>, object: &Object, seed: u64) -> Result<Vec<Proposal>> {
    let options = TrialOptions::default();
    let evaluator = TrialEvaluator::new(object, hand, &options, Engine::Diffsim)?;
    let (seen, _) = cloud(object, seed);
    let assumed = Assumed { mass_kg: object.mass_kg(), friction: MIDDLE_FRICTION };
    let placed = proposals(network, &FingerClosing::new(hand)?, object, &seen, &assumed, 2 * TRIED, seed)?;
    let grasps: Vec<Grasp> = placed.into_iter().map(|p| p.grasp).collect();
    let (spread, shake_m_s2) = (ConditionSpread::default(), options.shake_m_s2);
    let selection = SelectionOptions { spread, simulated: TRIED, shake_m_s2, seed };
    let selected = select_grasps(object, hand, &grasps, &evaluator, &[object.mass_kg()], &selection)?;
    Ok(in_order(selected.grasps.into_iter().map(|g| (g.grasp, 0.0))))
}

/// Proposals whose order is that of the path: weights fall by more than what is as good as another.
fn in_order(grasps: impl Iterator<Item = (Grasp, f64)>) -> Vec<Proposal> {
    grasps
        .enumerate()
        .map(|(i, (grasp, grip_force_n))| Proposal { grasp, grip_force_n, weight: 0.4_f64.powi(i as i32) })
        .collect()
}

/// The points with normal noise.
fn noisy(points: &[Point3<f64>], seed: u64) -> Vec<Point3<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ NOISE_SEED);
    let mut draw = |_, _| NOISE_M * normal_pair(random.random_range(0.0..1.0), random.random_range(0.0..TAU))[0];
    points.iter().map(|p| p + Vector3::from_fn(&mut draw)).collect()
}

/// The grasps of a search that need least friction and then least force once the hand has closed, the best first.
fn searched(
    object: &Object,
    hand: &Arc<Robot>,
    evaluator: &TrialEvaluator,
    search: usize,
    hundredths: usize,
    seed: u64,
) -> Result<Vec<Proposal>> {
    let share = |of: usize| (of * hundredths).div_ceil(100);
    let mut found = power_grasps(object, hand, share(search / PINCHES_PER_POWER), seed)?;
    found.extend(pinch_grasps(object, hand, share(search), seed)?);
    let force = |g: &Grasp| g.grip_force_n.unwrap_or(f64::INFINITY);
    found.sort_by(|a, b| force(a).total_cmp(&force(b)));
    found.truncate(share(CLOSED));
    let frictions = [0.27, 0.35, 0.45, 0.55, 0.65, 0.8];
    let mass_kg = object.mass_kg();
    let close = |grasp: Grasp| -> Result<Option<(usize, Proposal)>> {
        let hand = evaluator.close(&grasp, &Assumed { mass_kg, friction: MIDDLE_FRICTION })?;
        for (place, friction) in frictions.into_iter().enumerate() {
            if let Ok(grip_force_n) =
                evaluator.grip_force_n(&hand, &Assumed { mass_kg, friction }, GripForce::Required)?
            {
                return Ok(Some((place, Proposal { grasp, grip_force_n, weight: 0.0 })));
            }
        }
        Ok(None)
    };
    let closed: Vec<Option<(usize, Proposal)>> = found.into_par_iter().map(close).collect::<Result<_>>()?;
    let mut closed: Vec<(usize, Proposal)> = closed.into_iter().flatten().collect();
    closed.sort_by(|(i, a), (j, b)| i.cmp(j).then(a.grip_force_n.total_cmp(&b.grip_force_n)));
    closed.truncate(KEPT);
    Ok(in_order(closed.into_iter().map(|(_, p)| (p.grasp, p.grip_force_n))))
}

impl UnseenRow {
    /// A line for people.
    pub fn text(&self) -> String {
        let Self { way, successes, n, interval, difference, candidates, propose_ms, place_ms, .. } = self;
        format!(
            "{way:24} {successes:4} of {n:4}  {:5.1} % ({:.1} to {:.1})  {:+.1} ({:+.1} to {:+.1})  {candidates:4.1} candidates  \
             {propose_ms:8.1} ms + {place_ms:6.1} ms  no command: {}  {}",
            100.0 * interval.value,
            100.0 * interval.low,
            100.0 * interval.high,
            100.0 * difference.value,
            100.0 * difference.low,
            100.0 * difference.high,
            counted(&self.refusals),
            counted(&self.failures),
        )
    }

    /// A table of Markdown.
    pub fn markdown(rows: &[Self]) -> String {
        let columns =
            ["who proposes", "held", "95 %", "points apart", "95 %", "candidates", "ms", "no command", "failed"];
        let mut lines = vec![markdown_line(&columns), format!("|{}", "---|".repeat(columns.len()))];
        for (i, r) in rows.iter().enumerate() {
            let Interval { value, low, high } = r.difference;
            let apart = |share: f64| format!("{:+.1}", 100.0 * share);
            lines.push(markdown_line(&[
                r.way.clone(),
                format!("{} of {}, {} %", r.successes, r.n, percent(r.interval.value)),
                format!("{} to {} %", percent(r.interval.low), percent(r.interval.high)),
                if i == REFERENCE { String::new() } else { apart(value) },
                if i == REFERENCE { String::new() } else { format!("{} to {}", apart(low), apart(high)) },
                format!("{:.1}", r.candidates),
                format!("{:.1} + {:.1}", r.propose_ms, r.place_ms),
                counted(&r.refusals),
                counted(&r.failures),
            ]));
        }
        lines.join("\n") + "\n"
    }
}
