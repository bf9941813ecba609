//! Selection of grasps that hold in simulation, under conditions that no evaluated rollout has.
//!
//! Four filter stages, each costlier than the one before: the motors' torques at rest, a dry run of the closing with the grip force
//! for its contacts, hill climbing from the best of these, and successive halving over simulated trials.
//!
//! Demonstrated grasps go through them on their own, so that they are refined until they hold and not discarded for others that hold as they
//! are. What they become stays near what was demonstrated.

use std::cmp::Ordering;
use std::sync::Arc;

use drex_core::Object;
use drex_grasp::{FingerClosing, Grasp, GraspChange, least_friction_index};
use drex_robot::Robot;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::assumed::{HIGHEST_FRICTION, LEAST_KG};
use crate::{Assumed, Condition, ConditionSpread, Evaluation, Evaluator, GripForce, Result};

/// Rungs of the successive halving: conditions of the rung, and of how many grasps of the first rung one goes on to the next.
const RUNGS: [(usize, usize); 3] = [(3, 2), (5, 4), (16, 4)];
/// Dry runs of the closing for one grasp that is simulated: closing says more than the contacts at rest, and takes longer.
const CLOSINGS_PER_SIMULATED: usize = 12;
/// Frictions, evenly from the lowest that a hand assumes, at which a closed grasp may have a force: the fewer it misses the better.
const FRICTION_STEPS: usize = 16;
/// Generations of the hill climbing.
const GENERATIONS: usize = 12;
/// Of how many simulated grasps one is climbed from.
const CLIMBED_ONE_OF: usize = 4;
/// Relative size of the first perturbations of a demonstrated grasp; the last are the smallest of all.
const REFINEMENT_SIZE: f64 = 4.0;
/// What a demonstrated grasp that carries nothing of what it is to carry is asked for on the way there: shares of the lightest mass, at up to so many
/// times the highest friction.
const EASIER_SHARES: [f64; 3] = [1.0, 0.5, 0.2];
const ROUGHER: f64 = 3.0;
/// Demonstrated grasps that are refined for one that is simulated.
const REFINED_PER_SIMULATED: usize = 2;
/// Perturbations of a demonstrated grasp in a generation.
const REFINEMENTS: usize = 8;
/// Demonstrated grasps that differ by less are one: frames of a hand that rests.
const SAME: GraspChange = GraspChange { joint_rad: 0.03, base_m: 0.002, base_rad: 0.03 };
/// The most by which a demonstrated grasp is changed.
const MOST_REFINED: GraspChange = GraspChange { joint_rad: 0.4, base_m: 0.02, base_rad: 0.35 };
/// Perturbations of one grasp in a generation.
const PERTURBATIONS: usize = 4;
/// Step of the simulated frictions through their range, the golden ratio: any few of them in a row cover the range evenly.
const FRICTION_STEP: f64 = 0.618_033_988_749_895;
/// The first simulated friction, as a share of the range: low, where most fails.
const FIRST_FRICTION: f64 = 0.1;
/// Share of the required grip force that is simulated: what holds with less does not depend on what one simulator gets wrong.
const SIMULATED_FORCE_SHARE: f64 = 0.85;
/// Weight of the safety margin beside holding: two trials that hold with all of it are as good as three that hold with none.
const MARGIN_WEIGHT: f64 = 0.5;
/// Share of the best score that another grasp needs to be selected.
const MIN_SCORE_SHARE: f64 = 0.9;
/// The same of a grasp that holds under a condition under which no better one does.
const MIN_SCORE_SHARE_IF_UNIQUE: f64 = 0.7;
/// Largest number of grasps that are selected.
const MAX_SELECTED: usize = 24;
/// Distinguishes the seeds of simulated trials from those of evaluated ones.
const VALIDATION_SEED: u64 = 0x70_72_61_63;

/// How grasps are selected.
#[derive(Debug, Clone, PartialEq)]
pub struct SelectionOptions {
    /// Distribution of the conditions of the trials.
    pub spread: ConditionSpread,
    /// Grasps of the first rung; zero simulates nothing and selects those that need least force.
    pub simulated: usize,
    /// Acceleration of the shakes, m/s².
    pub shake_m_s2: f64,
    /// Seed of conditions and perturbations.
    pub seed: u64,
}

/// A grasp and how it went in simulation.
#[derive(Debug, Clone)]
pub struct ValidatedGrasp {
    /// The grasp.
    pub grasp: Grasp,
    /// The demonstrated grasp that it is or was made of.
    pub demonstration: Option<Arc<Grasp>>,
    /// For each finger whether it touches once the hand has closed.
    pub fingers: Vec<bool>,
    /// Score under each condition: zero if the grasp did not hold, else one and a part of its safety margin. What barely holds in
    /// one simulator slips in another.
    pub scores: Vec<f64>,
}

/// What the selection left.
#[derive(Debug, Clone)]
pub struct Selection {
    /// The selected grasps, the best first.
    pub grasps: Vec<ValidatedGrasp>,
    /// Number of closed grasps for which there is a grip force, refined ones and better neighbours among them.
    pub commanded: usize,
    /// Number of grasps that held under at least three quarters of their conditions.
    pub robust: usize,
    /// What became of the demonstrated ones among them.
    pub demonstrations: DemonstrationCounts,
    /// Lowest assumed friction at which a closed grasp has a grip force for the heaviest mass.
    pub carries_from: Option<f64>,
}

/// How many demonstrated grasps came how far, themselves or as what was made of them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DemonstrationCounts {
    /// That were tried, frames that are nearly the same counted once.
    pub demonstrated: usize,
    /// For which there is a grip force once the hand has closed, as demonstrated.
    pub as_demonstrated: usize,
    /// For which there is one as demonstrated or refined.
    pub commanded: usize,
    /// That held under at least three quarters of their conditions.
    pub held: usize,
    /// That were selected.
    pub selected: usize,
}

/// A grasp with the hand closed.
struct ClosedGrasp<C> {
    grasp: Grasp,
    demonstration: Option<Arc<Grasp>>,
    closed: C,
    /// Place of the first of what it may be asked to carry for which there is a force, and that force, N: less is better.
    place: usize,
    grip_force_n: f64,
}

/// A grasp to climb from.
struct Start<'a, E: Evaluator> {
    grasp: &'a Grasp,
    demonstration: Option<&'a Arc<Grasp>>,
    /// `None` if there is no force for it.
    closed: Option<&'a ClosedGrasp<E::Closed>>,
}

impl<'a, E: Evaluator> Start<'a, E> {
    fn from(closed: &'a ClosedGrasp<E::Closed>) -> Self {
        Self { grasp: &closed.grasp, demonstration: closed.demonstration.as_ref(), closed: Some(closed) }
    }
}

/// What a closed hand is asked to carry.
struct Task<'a, E> {
    object: &'a Object,
    robot: &'a Robot,
    evaluator: &'a E,
    /// Properties that the hand assumes while it closes.
    closes_on: Assumed,
    /// What it is to carry, for each mass, the heaviest first: the lowest friction first.
    loads: Vec<Vec<Assumed>>,
    /// Less, and still less, which says of a demonstrated grasp how far it is from carrying anything of that.
    easier: Vec<Vec<Assumed>>,
}

/// Selects the grasps that hold the object at each of the masses. The same for any number of threads.
///
/// # Errors
/// If a grasp does not fit the hand, or cannot be simulated at all.
pub fn select_grasps<E: Evaluator>(
    object: &Object,
    robot: &Robot,
    grasps: &[Grasp],
    evaluator: &E,
    masses_kg: &[f64],
    options: &SelectionOptions,
) -> Result<Selection> {
    let spread = &options.spread;
    let middle = 0.5 * (spread.friction.0 + spread.friction.1);
    // What carries the heaviest where it is smooth carries the others. What can be held where friction is higher counts as well, and what
    // carries the lightest alone: for some objects nothing else can.
    let frictions = [spread.friction.0, middle, spread.friction.1];
    let heaviest = masses_kg.iter().copied().fold(0.0, f64::max);
    let lightest = masses_kg.iter().copied().fold(f64::INFINITY, f64::min);
    let smoothest = (1.0 - spread.friction_error) * spread.friction.0;
    let at = |mass_kg: f64| -> Vec<Assumed> {
        let step = (spread.friction.1 - smoothest) / (FRICTION_STEPS - 1) as f64;
        (0..FRICTION_STEPS).map(|i| Assumed { mass_kg, friction: smoothest + step * i as f64 }).collect()
    };
    let mut loads = vec![at(heaviest)];
    if lightest < heaviest {
        loads.push(at(lightest));
    }
    let closes_on = Assumed { mass_kg: heaviest, friction: middle };
    let rougher = |share: f64| -> Vec<Assumed> {
        let factor = |i: usize| 1.0 + (ROUGHER - 1.0) * (i + 1) as f64 / FRICTION_STEPS as f64;
        let friction = |i: usize| (factor(i) * spread.friction.1).min(HIGHEST_FRICTION);
        (0..FRICTION_STEPS)
            .map(|i| Assumed { mass_kg: (share * lightest).max(LEAST_KG), friction: friction(i) })
            .collect()
    };
    let easier = EASIER_SHARES.into_iter().map(rougher).collect();
    let task = Task { object, robot, evaluator, closes_on, loads, easier };

    let least = least_friction_index(object, robot, grasps, heaviest, &frictions, options.shake_m_s2)?;
    let place = |at: Option<usize>| at.unwrap_or(frictions.len());
    let force = |g: &Grasp| g.grip_force_n.unwrap_or(f64::INFINITY);
    let mut easiest: Vec<(usize, &Grasp)> = least.into_iter().map(place).zip(grasps).collect();
    easiest.sort_by(|(i, a), (j, b)| i.cmp(j).then(force(a).total_cmp(&force(b))));
    let easiest = easiest.into_iter().map(|(_, g)| g);
    // What is not simulated is not refined either.
    let apart = |g: &&Grasp| options.simulated > 0 && g.origin.is_demonstrated();
    let (shown, found): (Vec<&Grasp>, Vec<&Grasp>) = easiest.partition(apart);
    // Both are simulated alike where there are both.
    let tried = match shown.is_empty() || found.is_empty() {
        true => options.simulated,
        false => options.simulated.div_ceil(2),
    };

    let mut counts = DemonstrationCounts::default();
    let shown = task.refined(&shown, tried, options.seed, &mut counts)?;
    let found = task.closed(found, tried, options.seed)?;
    let commanded = shown.len() + found.len();
    let all = || shown.iter().chain(&found);
    let carries_from = all().map(|g| g.place).min().and_then(|at| task.loads[0].get(at)).map(|load| load.friction);
    let shown = task.simulate(shown, tried, masses_kg, options)?;
    let found = task.simulate(found, tried, masses_kg, options)?;
    counts.held = shown.iter().filter(|p| p.is_robust()).count();
    let robust = counts.held + found.iter().filter(|p| p.is_robust()).count();
    let grasps = selected(shown, found);
    counts.selected = grasps.iter().filter(|p| p.demonstration.is_some()).count();
    Ok(Selection { grasps, commanded, robust, demonstrations: counts, carries_from })
}

impl<E: Evaluator> Task<'_, E> {
    /// Those of the grasps, the easiest first, for which there is a force once the hand has closed, and better neighbours of the best of them that
    /// do not carry everything; those that ask for the least first.
    fn closed(&self, grasps: Vec<&Grasp>, simulated: usize, seed: u64) -> Result<Vec<ClosedGrasp<E::Closed>>> {
        // Without practice those that look best are learned as they are.
        let tried = if simulated == 0 { MAX_SELECTED } else { simulated };
        let easiest = grasps.into_par_iter().take(CLOSINGS_PER_SIMULATED * tried);
        let closed: Vec<Option<ClosedGrasp<E::Closed>>> =
            easiest.map(|g| self.close(g.clone(), None)).collect::<Result<_>>()?;
        let mut closed: Vec<ClosedGrasp<E::Closed>> = closed.into_iter().flatten().collect();
        closed.sort_by(ClosedGrasp::against);
        // What carries the heaviest at all frictions needs no better neighbour.
        let hard = closed.partition_point(|g| g.place == 0);
        let climbed = simulated.div_ceil(CLIMBED_ONE_OF).saturating_sub(hard).min(closed.len() - hard);
        let starts: Vec<Start<'_, E>> = closed[hard..hard + climbed].iter().map(Start::from).collect();
        let better = self.climb(&starts, PERTURBATIONS, 1.0, seed)?;
        closed.extend(better);
        closed.sort_by(ClosedGrasp::against);
        Ok(closed)
    }

    /// Demonstrated grasps, the easiest first, each refined until there is a force that carries the heaviest at all frictions, or as far as that goes;
    /// those that ask for the least first.
    fn refined(
        &self,
        grasps: &[&Grasp],
        simulated: usize,
        seed: u64,
        counts: &mut DemonstrationCounts,
    ) -> Result<Vec<ClosedGrasp<E::Closed>>> {
        let mut demonstrations: Vec<Arc<Grasp>> = Vec::new();
        for grasp in grasps {
            if demonstrations.len() == CLOSINGS_PER_SIMULATED * simulated {
                break;
            }
            if demonstrations.iter().all(|d| !grasp.change_from(d).is_within(&SAME)) {
                demonstrations.push(Arc::new((*grasp).clone()));
            }
        }
        counts.demonstrated = demonstrations.len();
        let closed: Vec<Option<ClosedGrasp<E::Closed>>> =
            demonstrations.par_iter().map(|g| self.close((**g).clone(), Some(g.clone()))).collect::<Result<_>>()?;
        let carries = |g: &ClosedGrasp<E::Closed>| g.place < self.loads.len() * FRICTION_STEPS;
        counts.as_demonstrated = closed.iter().flatten().filter(|g| carries(g)).count();
        let mut starts: Vec<Start<'_, E>> = demonstrations
            .iter()
            .zip(&closed)
            .map(|(grasp, closed)| Start { grasp, demonstration: Some(grasp), closed: closed.as_ref() })
            .collect();
        // Those that are nearest to carrying everything.
        starts.sort_by_key(|s| s.closed.map_or(usize::MAX, |c| c.place));
        starts.retain(|s| s.closed.is_none_or(|c| c.place > 0));
        starts.truncate(REFINED_PER_SIMULATED * simulated);
        let better = self.climb(&starts, REFINEMENTS, REFINEMENT_SIZE, seed)?;
        let mut all: Vec<ClosedGrasp<E::Closed>> = Vec::new();
        // Of each demonstration the best that it became.
        for grasp in closed.into_iter().flatten().chain(better).filter(carries) {
            let same = |o: &&mut ClosedGrasp<E::Closed>| match (&o.demonstration, &grasp.demonstration) {
                (Some(a), Some(b)) => Arc::ptr_eq(a, b),
                _ => false,
            };
            match all.iter_mut().find(same) {
                Some(before) if grasp.against(before).is_lt() => *before = grasp,
                Some(_) => {}
                None => all.push(grasp),
            }
        }
        counts.commanded = all.len();
        all.sort_by(ClosedGrasp::against);
        Ok(all)
    }

    /// Closes the hand; `None` if there is no force for anything that it may be asked to carry.
    fn close(&self, grasp: Grasp, demonstration: Option<Arc<Grasp>>) -> Result<Option<ClosedGrasp<E::Closed>>> {
        let closed = self.evaluator.close(&grasp, &self.closes_on)?;
        let needed = |assumed: &Assumed| -> Result<Option<f64>> {
            Ok(self.evaluator.grip_force_n(&closed, assumed, GripForce::Required)?.ok())
        };
        let easier: &[Vec<Assumed>] = if demonstration.is_some() { &self.easier } else { &[] };
        for (block, loads) in self.loads.iter().chain(easier).enumerate() {
            // More friction is never worse: if the most is too little, all are.
            let (mut at, mut from) = (loads.len() - 1, 0);
            let Some(mut grip_force_n) = needed(&loads[at])? else { continue };
            while from < at {
                let middle = (from + at) / 2;
                match needed(&loads[middle])? {
                    Some(n) => (at, grip_force_n) = (middle, n),
                    None => from = middle + 1,
                }
            }
            let place = block * FRICTION_STEPS + at;
            return Ok(Some(ClosedGrasp { grasp, demonstration, closed, place, grip_force_n }));
        }
        Ok(None)
    }

    /// A neighbour of a grasp with the hand closed; `None` if that holds nothing, or is too far from what was demonstrated.
    fn neighbour(
        &self,
        closing: &FingerClosing<'_>,
        grasp: &Grasp,
        demonstration: Option<&Arc<Grasp>>,
        size: f64,
        (seed, stream): (u64, u64),
    ) -> Result<Option<ClosedGrasp<E::Closed>>> {
        let near = match demonstration {
            // What it holds is up to the dry run.
            Some(demonstration) => {
                let near = closing.refined(self.object, grasp, size, seed, stream)?;
                near.filter(|g| g.change_from(demonstration).is_within(&MOST_REFINED))
            }
            None => closing.perturbed(self.object, grasp, size, seed, stream)?,
        };
        near.map_or(Ok(None), |grasp| self.close(grasp, demonstration.cloned()))
    }

    /// Where climbing from each grasp leads, over neighbours that carry more, or the same with less force; nothing for a grasp that has no
    /// better neighbour. `first` is the relative size of the first perturbations. The same for any number of threads.
    fn climb(
        &self,
        starts: &[Start<'_, E>],
        perturbations: usize,
        first: f64,
        seed: u64,
    ) -> Result<Vec<ClosedGrasp<E::Closed>>> {
        let closing = FingerClosing::new(self.robot)?;
        let mut best: Vec<Option<ClosedGrasp<E::Closed>>> = starts.iter().map(|_| None).collect();
        for generation in 0..GENERATIONS {
            let size = first * (1.0 - generation as f64 / GENERATIONS as f64);
            let all = starts.len() * perturbations;
            let found: Vec<Option<(usize, ClosedGrasp<E::Closed>)>> = (0..all)
                .into_par_iter()
                .map(|i| {
                    let (of, stream) = (i / perturbations, (generation * all + i) as u64);
                    let from = best[of].as_ref().map_or(starts[of].grasp, |b| &b.grasp);
                    let near = self.neighbour(&closing, from, starts[of].demonstration, size, (seed, stream))?;
                    Ok(near.map(|g| (of, g)))
                })
                .collect::<Result<_>>()?;
            for (of, better) in found.into_iter().flatten() {
                if best[of].as_ref().or(starts[of].closed).is_none_or(|b| better.against(b).is_lt()) {
                    best[of] = Some(better);
                }
            }
        }
        Ok(best.into_iter().flatten().collect())
    }

    /// Carries them out: under few conditions all of them, under the others those that went best; these first.
    fn simulate(
        &self,
        mut closed: Vec<ClosedGrasp<E::Closed>>,
        simulated: usize,
        masses_kg: &[f64],
        options: &SelectionOptions,
    ) -> Result<Vec<ValidatedGrasp>> {
        closed.truncate(if simulated == 0 { MAX_SELECTED } else { simulated });
        let conditions = conditions(&options.spread, options.seed);
        let conditions: Vec<(Condition, f64)> = conditions.into_iter().zip(masses_kg.iter().copied().cycle()).collect();
        let validated = |g: ClosedGrasp<E::Closed>| {
            let fingers = self.evaluator.fingers(&g.closed);
            let ClosedGrasp { grasp, demonstration, closed, .. } = g;
            (ValidatedGrasp { grasp, demonstration, fingers, scores: Vec::new() }, closed)
        };
        let mut validated: Vec<(ValidatedGrasp, E::Closed)> = closed.into_iter().map(validated).collect();
        if simulated == 0 {
            return Ok(validated.into_iter().map(|p| p.0).collect());
        }
        let mut until = 0;
        for (count_of, one_of) in RUNGS {
            until += count_of;
            validated.par_iter_mut().try_for_each(|p| self.continue_trials(p, &conditions[..until]))?;
            best(&mut validated, simulated.div_ceil(one_of));
        }
        Ok(validated.into_iter().map(|p| p.0).collect())
    }

    /// Carries a grasp out under those of the conditions that it has not seen.
    fn continue_trials(
        &self,
        (p, closed): &mut (ValidatedGrasp, E::Closed),
        conditions: &[(Condition, f64)],
    ) -> Result<()> {
        for (condition, mass_kg) in &conditions[p.scores.len()..] {
            let evaluation = attempt(self.evaluator, closed, condition, *mass_kg)?;
            p.scores.push(if evaluation.held() { 1.0 + MARGIN_WEIGHT * evaluation.safety_margin } else { 0.0 });
        }
        Ok(())
    }
}

impl ValidatedGrasp {
    /// All scores together.
    fn score(&self) -> f64 {
        self.scores.iter().sum()
    }

    /// Whether it held under at least three quarters of its conditions.
    fn is_robust(&self) -> bool {
        !self.scores.is_empty() && 4 * self.holds() >= 3 * self.scores.len()
    }

    /// Under how many conditions it held.
    pub fn holds(&self) -> usize {
        self.scores.iter().filter(|m| **m > 0.0).count()
    }
}

impl<C> ClosedGrasp<C> {
    /// Which asks for less.
    fn against(&self, other: &Self) -> Ordering {
        self.place.cmp(&other.place).then(self.grip_force_n.total_cmp(&other.grip_force_n))
    }
}

/// The conditions of all stages.
fn conditions(spread: &ConditionSpread, seed: u64) -> Vec<Condition> {
    let mut conditions = spread.conditions(RUNGS.iter().map(|s| s.0).sum(), seed ^ VALIDATION_SEED);
    let (lowest, highest) = spread.friction;
    for (i, condition) in conditions.iter_mut().enumerate() {
        condition.friction = lowest + (highest - lowest) * (FIRST_FRICTION + FRICTION_STEP * i as f64).fract();
    }
    conditions
}

/// A grip with a little less than the force of the law, carried out.
fn attempt<E: Evaluator>(evaluator: &E, closed: &E::Closed, condition: &Condition, mass_kg: f64) -> Result<Evaluation> {
    let assumed = condition.assumed(mass_kg);
    let needed = match evaluator.grip_force_n(closed, &assumed, GripForce::Required)? {
        Ok(needed) => needed,
        Err(reason) => return Ok(Evaluation::refused(&reason)),
    };
    match evaluator.command(closed, &assumed, GripForce::Total(SIMULATED_FORCE_SHARE * needed))? {
        Ok(command) => evaluator.validate_until_failure(&command, &condition.truth(mass_kg)),
        Err(reason) => Ok(Evaluation::refused(&reason)),
    }
}

/// The first so many by how they went, one of each demonstration.
fn best<G>(validated: &mut Vec<(ValidatedGrasp, G)>, most: usize) {
    validated.sort_by(|(a, _), (b, _)| b.score().total_cmp(&a.score()));
    let mut seen = Vec::new();
    validated.retain(|(p, _)| {
        let demonstration = p.demonstration.as_ref().map(Arc::as_ptr);
        let new = demonstration.is_none_or(|d| !seen.contains(&d));
        seen.extend(demonstration);
        new
    });
    validated.truncate(most);
}

/// The best of those sorted by how they went: the demonstrated ones that hold about as often as anything does, then whatever holds under a
/// condition under which nothing before it does, then the best of the others, no more of them than of the demonstrated ones if there are any.
fn selected(shown: Vec<ValidatedGrasp>, found: Vec<ValidatedGrasp>) -> Vec<ValidatedGrasp> {
    let most = |of: &dyn Fn(&ValidatedGrasp) -> f64| shown.iter().chain(&found).map(of).fold(0.0, f64::max);
    let (best, most_holds) = (most(&ValidatedGrasp::score), most(&|p| p.holds() as f64));
    let as_good = |p: &ValidatedGrasp, share: f64| p.score() >= share * best;
    let (mut out, worse): (Vec<ValidatedGrasp>, Vec<ValidatedGrasp>) =
        shown.into_iter().partition(|p| p.holds() as f64 >= MIN_SCORE_SHARE * most_holds);
    out.truncate(MAX_SELECTED);
    let demonstrated = out.len();
    let mut rest = Vec::new();
    for p in worse.into_iter().chain(found) {
        let new = p.scores.iter().enumerate().any(|(c, m)| *m > 0.0 && out.iter().all(|o| o.scores[c] == 0.0));
        if new && as_good(&p, MIN_SCORE_SHARE_IF_UNIQUE) { out.push(p) } else { rest.push(p) }
    }
    let room =
        MAX_SELECTED.min(if demonstrated > 0 { 2 * demonstrated } else { MAX_SELECTED }).saturating_sub(out.len());
    // Those that often fail where others hold would only be in the way; where nothing holds, they are all there is.
    out.extend(rest.into_iter().filter(|p| as_good(p, MIN_SCORE_SHARE)).take(room));
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use drex_core::mesh::convex_hull;
    use drex_grasp::{GraspOrigin, OriginCounts, pinch_grasps};
    use drex_mesh::{AssetOptions, asset_from_mesh};
    use nalgebra::Point3;

    use super::*;
    use crate::formula::PinchByFirstJoint;

    /// 1 kg to 0.2 kg on a cube, whose grasps are as strong as their first joint says.
    fn task<'a>(object: &'a Object, robot: &'a Robot, masses_kg: &[f64]) -> Task<'a, PinchByFirstJoint> {
        let at = |mass_kg: &f64| -> Vec<Assumed> {
            (0..FRICTION_STEPS).map(|i| Assumed { mass_kg: *mass_kg, friction: 0.3 + 0.03 * i as f64 }).collect()
        };
        let closes_on = Assumed { mass_kg: masses_kg[0], friction: 0.5 };
        let loads = masses_kg.iter().map(at).collect();
        Task { object, robot, evaluator: &PinchByFirstJoint, closes_on, loads, easier: Vec::new() }
    }

    /// A cube of 57 mm and 120 g.
    fn cube() -> (Object, Robot) {
        let corner = |k: usize| Point3::from([0, 1, 2].map(|axis| if k >> axis & 1 == 1 { 0.057 } else { 0.0 }));
        let mesh = convex_hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
        let mut options = AssetOptions::default();
        options.mass_kg = Some(0.12);
        let asset = asset_from_mesh(&mesh, &options).unwrap();
        (asset.to_object("cube").unwrap(), Robot::bundled("leap_right").unwrap())
    }

    #[test]
    fn the_first_load_that_is_carried_is_found_by_halving_as_by_looking_at_all() {
        let (object, robot) = cube();
        let task = task(&object, &robot, &[1.0, 0.2]);
        let grasp = pinch_grasps(&object, &robot, 4000, 0).unwrap().swap_remove(0);
        let loads: Vec<&Assumed> = task.loads.iter().flatten().collect();
        let mut places = Vec::new();
        for strongest in 0..70 {
            let mut grasp = grasp.clone();
            grasp.joints_rad[0] = f64::from(strongest);
            let carries =
                |b: &&Assumed| PinchByFirstJoint.command(&grasp.joints_rad[0], b, GripForce::Required).unwrap().is_ok();
            let expected = loads.iter().position(carries);
            let found = task.close(grasp, None).unwrap();
            assert_eq!(found.as_ref().map(|g| g.place), expected, "{strongest} N");
            if let Some(g) = found {
                assert_eq!(
                    g.grip_force_n,
                    PinchByFirstJoint.command(&1e3, loads[g.place], GripForce::Required).unwrap().unwrap()
                );
            }
            places.extend(expected);
        }
        assert!(places.contains(&0) && places.iter().any(|p| *p > FRICTION_STEPS), "{places:?}");
    }

    #[test]
    fn climbing_leads_to_neighbours_that_carry_more() {
        let (object, robot) = cube();
        // As strong, N, as the first joint says in rad: 20 g are at the edge of what that carries.
        let task = task(&object, &robot, &[0.02]);
        let found = pinch_grasps(&object, &robot, 20_000, 0).unwrap();
        let mut start: Vec<_> =
            found.into_iter().filter_map(|g| task.close(g, None).unwrap()).filter(|g| g.place > 0).collect();
        // Many of them have no neighbour that is better, or none that is out of the object and off the table.
        assert!(start.len() >= 12, "{} to begin with", start.len());
        start.iter_mut().for_each(|g| g.grasp.origin = GraspOrigin::Retargeted);
        let starts: Vec<Start<'_, PinchByFirstJoint>> = start[..12].iter().map(Start::from).collect();
        let better = task.climb(&starts, PERTURBATIONS, 1.0, 1).unwrap();
        assert!(!better.is_empty());
        for b in &better {
            let parent = start.iter().find(|g| g.grasp.source == b.grasp.source).unwrap();
            assert!(b.against(parent).is_lt() && b.grasp.joints_rad[0] > parent.grasp.joints_rad[0]);
            assert_eq!(b.grasp.origin, parent.grasp.origin.perturbed());
        }
        let origins = OriginCounts::of(better.iter().map(|b| b.grasp.origin));
        assert_eq!(origins, OriginCounts { refined: better.len(), ..OriginCounts::default() });
        let again = task.climb(&starts, PERTURBATIONS, 1.0, 1).unwrap();
        assert!(again.iter().map(|g| &g.grasp).eq(better.iter().map(|g| &g.grasp)));
    }

    #[test]
    fn demonstrations_are_refined_until_they_hold_and_others_come_behind_them() {
        let (object, robot) = cube();
        // 28 g take 0.92 N where friction is highest and 1.24 N where it is lowest, and a grasp is as strong, N, as its first joint says in rad.
        let mass_kg = 0.028;
        let found = pinch_grasps(&object, &robot, 60_000, 0).unwrap();
        let strength = |g: &Grasp| g.joints_rad[0];
        let some = |range: std::ops::Range<f64>, origin: Option<GraspOrigin>| {
            let within = found.iter().filter(|g| range.contains(&strength(g))).take(12).cloned();
            let grasps: Vec<Grasp> = within.map(|g| Grasp { origin: origin.unwrap_or(g.origin), ..g }).collect();
            assert_eq!(grasps.len(), 12, "{range:?}");
            grasps
        };
        // Strong ones that nobody demonstrated, demonstrated ones near enough to be refined, and such as are far too weak.
        let shown = Some(GraspOrigin::Retargeted);
        let mut all = some(1.35..9.0, None);
        all.extend(some(0.82..0.91, shown));
        all.extend(some(0.0..0.4, shown));
        let evaluator = PinchByFirstJoint;
        let spread = ConditionSpread::around(Some(0.5));
        let options = SelectionOptions { spread, simulated: 16, shake_m_s2: 4.9, seed: 2 };
        let select =
            |grasps: &[Grasp]| select_grasps(&object, &robot, grasps, &evaluator, &[mass_kg], &options).unwrap();
        let Selection { grasps, demonstrations: counts, .. } = select(&all);
        assert_eq!(counts.as_demonstrated, 0, "{counts:?}");
        assert!(counts.commanded > 0 && counts.held > 0 && counts.selected > 0, "{counts:?}");
        assert!(counts.demonstrated == 24 && counts.commanded <= 12, "{counts:?}");
        assert!(2 * counts.selected >= grasps.len(), "{} of {}", counts.selected, grasps.len());
        for g in &grasps {
            let Some(demonstration) = &g.demonstration else { continue };
            assert_eq!((g.grasp.origin, g.grasp.source), (GraspOrigin::Refined, demonstration.source));
            let change = g.grasp.change_from(demonstration);
            assert!(change.is_within(&MOST_REFINED) && change.joint_rad > 0.0, "{change:?}");
            assert!(strength(&g.grasp) > 0.91 && strength(demonstration) < 0.91);
        }
        let again = select(&all).grasps;
        assert!(again.iter().map(|g| &g.grasp).eq(grasps.iter().map(|g| &g.grasp)));
        // Without demonstrations the others are all there is.
        let others = select(&all[..12]);
        assert_eq!(others.demonstrations, DemonstrationCounts::default());
        assert!(!others.grasps.is_empty());
    }

    #[test]
    fn each_stage_sees_low_and_high_friction() {
        let frictions = conditions(&ConditionSpread::default(), 3).into_iter().map(|c| c.friction);
        let quarters: Vec<usize> = frictions.map(|f| ((f - 0.3) / 0.125) as usize).collect();
        assert_eq!(quarters[..4], [0, 2, 1, 3]);
        assert_eq!([0, 1, 2, 3].map(|q| quarters.iter().filter(|x| **x == q).count()), [6; 4]);
    }

    #[test]
    fn of_grasps_that_hold_as_often_those_that_slip_least_come_first() {
        let (object, robot) = cube();
        let grasp = pinch_grasps(&object, &robot, 4000, 0).unwrap().swap_remove(0);
        let validated = |scores: &[f64]| {
            (
                ValidatedGrasp {
                    grasp: grasp.clone(),
                    demonstration: None,
                    fingers: vec![true; 4],
                    scores: scores.to_vec(),
                },
                (),
            )
        };
        let mut all = vec![validated(&[1.1, 1.0, 1.0]), validated(&[1.5, 1.4, 0.0]), validated(&[1.4, 1.5, 1.25])];
        best(&mut all, 2);
        let scores: Vec<f64> = all.iter().map(|p| p.0.score()).collect();
        assert_eq!((scores, all[0].0.holds(), all[1].0.holds()), (vec![1.4 + 1.5 + 1.25, 1.1 + 1.0 + 1.0], 3, 3));
    }

    #[test]
    fn what_holds_where_no_better_one_does_is_learned_too() {
        let (object, robot) = cube();
        let grasp = pinch_grasps(&object, &robot, 4000, 0).unwrap().swap_remove(0);
        let validated = |held: &[u8]| ValidatedGrasp {
            grasp: grasp.clone(),
            demonstration: None,
            fingers: vec![true; 4],
            scores: held.iter().map(|h| f64::from(*h)).collect(),
        };
        let best = [1, 1, 1, 1, 1, 1, 1, 1, 1, 0];
        let other = [1, 1, 1, 1, 1, 1, 0, 0, 0, 1];
        let worse = [1, 1, 1, 1, 1, 1, 1, 0, 0, 0];
        let kept = selected(Vec::new(), vec![validated(&best), validated(&other), validated(&worse)]);
        assert_eq!(kept.len(), 2);
        assert!(kept[1].scores[9] > 0.0 && kept[1].scores[6] == 0.0);
    }
}
