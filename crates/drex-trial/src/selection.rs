//! Selection of grasps that hold in simulation, under conditions that no evaluated rollout has.
//!
//! Four filter stages, each costlier than the one before: the motors' torques at rest, a dry run of the closing with the grip force
//! for its contacts, hill climbing from the best of these, and successive halving over simulated trials with mutations between the
//! rungs.

use std::cmp::Ordering;

use drex_core::Object;
use drex_grasp::{FingerClosing, Grasp, least_friction_index};
use drex_robot::Robot;
use rayon::prelude::*;

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
/// Perturbations of one grasp in a generation.
const PERTURBATIONS: usize = 4;
/// The rung after which what is left is mutated.
const MUTATION_RUNG: usize = 1;
/// Relative sizes of the mutations, generation by generation.
const MUTATION_SIZES: [f64; 3] = [0.5, 0.35, 0.25];
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
pub const VALIDATION_SEED: u64 = 0x70_72_61_63;

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
    /// Number of closed grasps for which there is a grip force.
    pub commanded: usize,
    /// Number of grasps that held under at least three quarters of their conditions.
    pub robust: usize,
    /// Lowest assumed friction at which a closed grasp has a grip force for the heaviest mass.
    pub carries_from: Option<f64>,
}

/// A grasp with the hand closed.
struct ClosedGrasp<C> {
    grasp: Grasp,
    closed: C,
    /// Place of the first of what it may be asked to carry for which there is a force, and that force, N: less is better.
    place: usize,
    grip_force_n: f64,
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
    let task = Task { object, robot, evaluator, closes_on, loads };

    let least = least_friction_index(object, robot, grasps, heaviest, &frictions, options.shake_m_s2)?;
    let place = |at: Option<usize>| at.unwrap_or(frictions.len());
    let force = |g: &Grasp| g.grip_force_n.unwrap_or(f64::INFINITY);
    let mut easiest: Vec<(usize, &Grasp)> = least.into_iter().map(place).zip(grasps).collect();
    easiest.sort_by(|(i, a), (j, b)| i.cmp(j).then(force(a).total_cmp(&force(b))));
    // Without practice those that look best are learned as they are.
    let tried = if options.simulated == 0 { MAX_SELECTED } else { options.simulated };
    easiest.truncate(CLOSINGS_PER_SIMULATED * tried);

    let closed: Vec<Option<ClosedGrasp<E::Closed>>> =
        easiest.into_par_iter().map(|(_, g)| task.close(g.clone())).collect::<Result<_>>()?;
    let mut closed: Vec<ClosedGrasp<E::Closed>> = closed.into_iter().flatten().collect();
    let commanded = closed.len();
    closed.sort_by(ClosedGrasp::against);
    // What carries the heaviest at all frictions needs no better neighbour.
    let hard = closed.partition_point(|g| g.place == 0);
    let climbed = options.simulated.div_ceil(CLIMBED_ONE_OF).saturating_sub(hard).min(closed.len() - hard);
    let better = task.climb(&closed[hard..hard + climbed], options.seed)?;
    closed.extend(better);
    closed.sort_by(ClosedGrasp::against);
    let carries_from = closed.first().and_then(|g| task.loads[0].get(g.place)).map(|b| b.friction);
    closed.truncate(tried);

    let validated = task.simulate(closed, masses_kg, options)?;
    let robust = validated.iter().filter(|p| !p.scores.is_empty() && 4 * p.holds() >= 3 * p.scores.len()).count();
    Ok(Selection { grasps: selected(validated), commanded, robust, carries_from })
}

impl<E: Evaluator> Task<'_, E> {
    /// Closes the hand; `None` if there is no force for anything that it may be asked to carry.
    fn close(&self, grasp: Grasp) -> Result<Option<ClosedGrasp<E::Closed>>> {
        let closed = self.evaluator.close(&grasp, &self.closes_on)?;
        let needed = |assumed: &Assumed| -> Result<Option<f64>> {
            Ok(self.evaluator.grip_force_n(&closed, assumed, GripForce::Required)?.ok())
        };
        for (block, loads) in self.loads.iter().enumerate() {
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
            return Ok(Some(ClosedGrasp { grasp, closed, place: block * FRICTION_STEPS + at, grip_force_n }));
        }
        Ok(None)
    }

    /// Where climbing from each grasp leads, over neighbours that carry more, or the same with less force; nothing for a grasp that has no
    /// better neighbour. The same for any number of threads.
    fn climb(&self, closed: &[ClosedGrasp<E::Closed>], seed: u64) -> Result<Vec<ClosedGrasp<E::Closed>>> {
        let closing = FingerClosing::new(self.robot)?;
        let mut best: Vec<Option<ClosedGrasp<E::Closed>>> = closed.iter().map(|_| None).collect();
        for generation in 0..GENERATIONS {
            let size = 1.0 - generation as f64 / GENERATIONS as f64;
            let perturbations: Vec<(usize, u64)> = (0..closed.len() * PERTURBATIONS)
                .map(|i| (i / PERTURBATIONS, (generation * closed.len() * PERTURBATIONS + i) as u64))
                .collect();
            let found: Vec<Option<(usize, ClosedGrasp<E::Closed>)>> = perturbations
                .into_par_iter()
                .map(|(of, stream)| {
                    let from = best[of].as_ref().unwrap_or(&closed[of]);
                    let Some(grasp) = closing.perturbed(self.object, &from.grasp, size, seed, stream)? else {
                        return Ok(None);
                    };
                    Ok(self.close(grasp)?.map(|g| (of, g)))
                })
                .collect::<Result<_>>()?;
            for (of, better) in found.into_iter().flatten() {
                if better.against(best[of].as_ref().unwrap_or(&closed[of])).is_lt() {
                    best[of] = Some(better);
                }
            }
        }
        Ok(best.into_iter().flatten().collect())
    }

    /// Carries them out: under few conditions all of them, under the others those that went best; these first.
    fn simulate(
        &self,
        closed: Vec<ClosedGrasp<E::Closed>>,
        masses_kg: &[f64],
        options: &SelectionOptions,
    ) -> Result<Vec<ValidatedGrasp>> {
        let conditions = conditions(&options.spread, options.seed);
        let conditions: Vec<(Condition, f64)> = conditions.into_iter().zip(masses_kg.iter().copied().cycle()).collect();
        let validated = |g: ClosedGrasp<E::Closed>| {
            let fingers = self.evaluator.fingers(&g.closed);
            (ValidatedGrasp { grasp: g.grasp, fingers, scores: Vec::new() }, g.closed)
        };
        let mut validated: Vec<(ValidatedGrasp, E::Closed)> = closed.into_iter().map(validated).collect();
        if options.simulated == 0 {
            return Ok(validated.into_iter().map(|p| p.0).collect());
        }
        let mut until = 0;
        for (rung, (count_of, one_of)) in RUNGS.into_iter().enumerate() {
            until += count_of;
            validated.par_iter_mut().try_for_each(|p| self.continue_trials(p, &conditions[..until]))?;
            best(&mut validated, options.simulated.div_ceil(one_of));
            if rung != MUTATION_RUNG {
                continue;
            }
            for (generation, size) in MUTATION_SIZES.into_iter().enumerate() {
                let seed = (!options.seed).wrapping_sub(generation as u64);
                validated.extend(self.mutate(&validated, &conditions[..until], size, seed)?);
                best(&mut validated, options.simulated.div_ceil(one_of));
            }
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

    /// Variations of grasps in practice, those that went no worse than what they come from.
    fn mutate(
        &self,
        parents: &[(ValidatedGrasp, E::Closed)],
        conditions: &[(Condition, f64)],
        size: f64,
        seed: u64,
    ) -> Result<Vec<(ValidatedGrasp, E::Closed)>> {
        let closing = FingerClosing::new(self.robot)?;
        let born = |i: usize| {
            let parent = &parents[i / PERTURBATIONS].0;
            let Some(grasp) = closing.perturbed(self.object, &parent.grasp, size, seed, i as u64)? else {
                return Ok(None);
            };
            let Some(ClosedGrasp { grasp, closed, .. }) = self.close(grasp)? else { return Ok(None) };
            let fingers = self.evaluator.fingers(&closed);
            let mut child = (ValidatedGrasp { grasp, fingers, scores: Vec::new() }, closed);
            // A few conditions say of most that they are no better.
            for until in [RUNGS[0].0, conditions.len()] {
                self.continue_trials(&mut child, &conditions[..until])?;
                if child.0.score() < parent.scores[..until].iter().sum::<f64>() {
                    return Ok(None);
                }
            }
            Ok(Some(child))
        };
        let children: Vec<Option<_>> =
            (0..parents.len() * PERTURBATIONS).into_par_iter().map(born).collect::<Result<_>>()?;
        Ok(children.into_iter().flatten().collect())
    }
}

impl ValidatedGrasp {
    /// All scores together.
    fn score(&self) -> f64 {
        self.scores.iter().sum()
    }

    /// Under how many conditions it held.
    fn holds(&self) -> usize {
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

/// The first so many by how they went.
fn best<G>(validated: &mut Vec<(ValidatedGrasp, G)>, most: usize) {
    validated.sort_by(|(a, _), (b, _)| b.score().total_cmp(&a.score()));
    validated.truncate(most);
}

/// Of those sorted by how they went the best ones, and before them whatever holds under a condition that no better one stands.
fn selected(validated: Vec<ValidatedGrasp>) -> Vec<ValidatedGrasp> {
    let best = validated.first().map_or(0.0, ValidatedGrasp::score);
    let as_good = |p: &ValidatedGrasp, share: f64| p.score() >= share * best;
    let mut out: Vec<ValidatedGrasp> = Vec::new();
    let mut rest = Vec::new();
    for p in validated {
        let new = p.scores.iter().enumerate().any(|(c, m)| *m > 0.0 && out.iter().all(|o| o.scores[c] == 0.0));
        if new && as_good(&p, MIN_SCORE_SHARE_IF_UNIQUE) { out.push(p) } else { rest.push(p) }
    }
    let room = MAX_SELECTED.saturating_sub(out.len());
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
        Task { object, robot, evaluator: &PinchByFirstJoint, closes_on, loads: masses_kg.iter().map(at).collect() }
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
            let found = task.close(grasp).unwrap();
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
            found.into_iter().filter_map(|g| task.close(g).unwrap()).filter(|g| g.place > 0).collect();
        // Many of them have no neighbour that is better, or none that is out of the object and off the table.
        assert!(start.len() >= 12, "{} to begin with", start.len());
        start.iter_mut().for_each(|g| g.grasp.origin = GraspOrigin::Retargeted);
        let better = task.climb(&start[..12], 1).unwrap();
        assert!(!better.is_empty());
        for b in &better {
            let parent = start.iter().find(|g| g.grasp.source == b.grasp.source).unwrap();
            assert!(b.against(parent).is_lt() && b.grasp.joints_rad[0] > parent.grasp.joints_rad[0]);
            assert_eq!(b.grasp.origin, parent.grasp.origin.perturbed());
        }
        let origins = OriginCounts::of(better.iter().map(|b| b.grasp.origin));
        assert_eq!(origins, OriginCounts { refined: better.len(), ..OriginCounts::default() });
        let again = task.climb(&start[..12], 1).unwrap();
        assert!(again.iter().map(|g| &g.grasp).eq(better.iter().map(|g| &g.grasp)));
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
            (ValidatedGrasp { grasp: grasp.clone(), fingers: vec![true; 4], scores: scores.to_vec() }, ())
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
            fingers: vec![true; 4],
            scores: held.iter().map(|h| f64::from(*h)).collect(),
        };
        let best = [1, 1, 1, 1, 1, 1, 1, 1, 1, 0];
        let other = [1, 1, 1, 1, 1, 1, 0, 0, 0, 1];
        let worse = [1, 1, 1, 1, 1, 1, 1, 0, 0, 0];
        let kept = selected(vec![validated(&best), validated(&other), validated(&worse)]);
        assert_eq!(kept.len(), 2);
        assert!(kept[1].scores[9] > 0.0 && kept[1].scores[6] == 0.0);
    }
}
