//! Which grasps of a library are learned: those that hold when they are carried out under conditions that no judged rollout has.
//!
//! Four sieves, each dearer than the one before: the motors on paper, a rehearsal of the closing and the force for its contacts, variations
//! of what went best there, and practice in the simulator that learning uses.

use std::cmp::Ordering;

use anyhow::Result;
use drex_robot::Robot;
use drex_trial::{Belief, Squeeze};
use rayon::prelude::*;

use super::bound;
use super::judge::{Condition, Judge, Judged, Spread};
use super::learned::LearnOptions;
use super::library::Grasp;
use super::thing::Thing;
use super::wraps::Closer;

/// Stages of practice: conditions under which a grasp is tried, and of how many of the first stage one goes on to the next.
const STAGES: [(usize, usize); 3] = [(3, 2), (5, 4), (16, 4)];
/// Of so many grasps that look easiest on paper one is practised: closing on the object as a rehearsal says more, and takes longer.
const REHEARSED_FOR_ONE: usize = 12;
/// Frictions, evenly from the lowest that a hand is told, at which a rehearsed grasp may have a force: the fewer it misses the better.
const TOLD: usize = 16;
/// Generations of variations, of how many practised grasps one is varied, and how often in a generation.
const GENERATIONS: usize = 12;
const VARIED_ONE_OF: usize = 4;
const VARIATIONS: usize = 4;
/// The stage of practice after which what is left is varied, and by how much in each generation.
const OFFSPRING_AFTER: usize = 1;
const OFFSPRING_SIZES: [f64; 3] = [0.5, 0.35, 0.25];
/// Frictions of practice go around by the golden ratio: any few of them in a row cover the range evenly. The first is low: there most fails.
const FRICTION_STEP: f64 = 0.618_033_988_749_895;
const FIRST_FRICTION: f64 = 0.1;
/// Share of the law's force with which grasps are practised: what holds with less does not hang on what one simulator gets wrong.
const PRACTICE_FORCE: f64 = 0.85;
/// What leeway counts beside holding: two that hold with all of it are as good as three that hold with none.
const LEEWAY: f64 = 0.5;
/// Share of the best grasp's marks that another one needs to be learned: as it is, and if it holds where no better one does.
const NEARLY_AS_GOOD: f64 = 0.9;
const WHERE_OTHERS_FAIL: f64 = 0.7;
/// Grasps that the network learns, at most.
const LEARNED: usize = 24;
/// Set apart from the seeds of judged rollouts.
pub const PRACTICE_SEED: u64 = 0x70_72_61_63;

/// A grasp as it went in practice.
pub struct Practised {
    pub grasp: Grasp,
    /// Which fingers touch once the hand has closed.
    pub fingers: Vec<bool>,
    /// Per condition a mark: zero if it did not hold, else one and a part of the leeway that it had. What barely holds in one simulator slips in another.
    pub marks: Vec<f64>,
}

/// What practice left.
pub struct Sieved {
    /// Those to learn.
    pub grasps: Vec<Practised>,
    /// Rehearsed grasps for which there is a force, and those that held under most conditions.
    pub commanded: usize,
    pub robust: usize,
    /// Lowest of the frictions that a hand may be told at which any rehearsed grasp has a force for the heaviest mass.
    pub carries_from: Option<f64>,
}

/// A grasp with the hand closed.
struct Gripped<G> {
    grasp: Grasp,
    grip: G,
    /// Place of the first of what it may be asked to carry for which there is a force, and that force, N: less is better.
    place: usize,
    squeeze_n: f64,
}

/// What a closed hand is asked to carry.
struct Task<'a, J> {
    thing: &'a Thing,
    robot: &'a Robot,
    judge: &'a J,
    /// The hand closes on this.
    closes_on: Belief,
    /// What it is to carry, for each mass, the heaviest first: the lowest friction first.
    beliefs: Vec<Vec<Belief>>,
}

/// The grasps to learn, at each mass in turn.
///
/// # Errors
/// If a grasp is none of this hand, or cannot be simulated at all.
pub fn practise<J: Judge>(
    thing: &Thing,
    robot: &Robot,
    grasps: &[Grasp],
    judge: &J,
    masses_kg: &[f64],
    options: &LearnOptions,
) -> Result<Sieved> {
    let spread = &options.spread;
    let middle = 0.5 * (spread.friction.0 + spread.friction.1);
    // What carries the heaviest where it is smooth carries the others. What can be held where friction is higher counts as well, and what
    // carries the lightest alone: for some objects nothing else can.
    let frictions = [spread.friction.0, middle, spread.friction.1];
    let heaviest = masses_kg.iter().copied().fold(0.0, f64::max);
    let lightest = masses_kg.iter().copied().fold(f64::INFINITY, f64::min);
    let smoothest = (1.0 - spread.friction_told) * spread.friction.0;
    let at = |mass_kg: f64| -> Vec<Belief> {
        let step = (spread.friction.1 - smoothest) / (TOLD - 1) as f64;
        (0..TOLD).map(|i| Belief { mass_kg, friction: smoothest + step * i as f64 }).collect()
    };
    let mut beliefs = vec![at(heaviest)];
    if lightest < heaviest {
        beliefs.push(at(lightest));
    }
    let closes_on = Belief { mass_kg: heaviest, friction: middle };
    let task = Task { thing, robot, judge, closes_on, beliefs };

    let carried = bound::carried(thing, robot, grasps, heaviest, &frictions, options.shake_m_s2)?;
    let place = |at: Option<usize>| at.unwrap_or(frictions.len());
    let mut easiest: Vec<(usize, &Grasp)> = carried.into_iter().map(place).zip(grasps).collect();
    easiest.sort_by(|(i, a), (j, b)| i.cmp(j).then(a.squeeze_per_weight.total_cmp(&b.squeeze_per_weight)));
    // Without practice those that look best are learned as they are.
    let tried = if options.practised == 0 { LEARNED } else { options.practised };
    easiest.truncate(REHEARSED_FOR_ONE * tried);

    let gripped: Vec<Option<Gripped<J::Grip>>> =
        easiest.into_par_iter().map(|(_, g)| task.gripped(g.clone())).collect::<Result<_>>()?;
    let mut gripped: Vec<Gripped<J::Grip>> = gripped.into_iter().flatten().collect();
    let commanded = gripped.len();
    gripped.sort_by(Gripped::against);
    // What carries the heaviest at all frictions needs no better neighbour.
    let hard = gripped.partition_point(|g| g.place == 0);
    let varied = options.practised.div_ceil(VARIED_ONE_OF).saturating_sub(hard).min(gripped.len() - hard);
    let better = task.varied(&gripped[hard..hard + varied], options.train.seed)?;
    gripped.extend(better);
    gripped.sort_by(Gripped::against);
    let carries_from = gripped.first().and_then(|g| task.beliefs[0].get(g.place)).map(|b| b.friction);
    gripped.truncate(tried);

    let practised = task.try_out(gripped, masses_kg, options)?;
    let robust = practised.iter().filter(|p| !p.marks.is_empty() && 4 * p.holds() >= 3 * p.marks.len()).count();
    Ok(Sieved { grasps: chosen(practised), commanded, robust, carries_from })
}

impl<J: Judge> Task<'_, J> {
    /// Closes the hand; `None` if there is no force for anything that it may be asked to carry.
    fn gripped(&self, grasp: Grasp) -> Result<Option<Gripped<J::Grip>>> {
        let grip = self.judge.grip(&grasp.joints_rad, &grasp.pose()?, &self.closes_on)?;
        let needed =
            |belief: &Belief| -> Result<Option<f64>> { Ok(self.judge.squeeze_n(&grip, belief, Squeeze::Needed)?.ok()) };
        for (block, beliefs) in self.beliefs.iter().enumerate() {
            // More friction is never worse: if the most is too little, all are.
            let (mut at, mut from) = (beliefs.len() - 1, 0);
            let Some(mut squeeze_n) = needed(&beliefs[at])? else { continue };
            while from < at {
                let middle = (from + at) / 2;
                match needed(&beliefs[middle])? {
                    Some(n) => (at, squeeze_n) = (middle, n),
                    None => from = middle + 1,
                }
            }
            return Ok(Some(Gripped { grasp, grip, place: block * TOLD + at, squeeze_n }));
        }
        Ok(None)
    }

    /// Where climbing from each grasp leads, over neighbours that carry more, or the same with less force; nothing for a grasp that has no
    /// better neighbour. The same for any number of threads.
    fn varied(&self, gripped: &[Gripped<J::Grip>], seed: u64) -> Result<Vec<Gripped<J::Grip>>> {
        let closer = Closer::new(self.robot)?;
        let mut best: Vec<Option<Gripped<J::Grip>>> = gripped.iter().map(|_| None).collect();
        for generation in 0..GENERATIONS {
            let size = 1.0 - generation as f64 / GENERATIONS as f64;
            let variations: Vec<(usize, u64)> = (0..gripped.len() * VARIATIONS)
                .map(|i| (i / VARIATIONS, (generation * gripped.len() * VARIATIONS + i) as u64))
                .collect();
            let found: Vec<Option<(usize, Gripped<J::Grip>)>> = variations
                .into_par_iter()
                .map(|(of, stream)| {
                    let from = best[of].as_ref().unwrap_or(&gripped[of]);
                    let Some(grasp) = closer.varied(self.thing, &from.grasp, size, seed, stream)? else {
                        return Ok(None);
                    };
                    Ok(self.gripped(grasp)?.map(|g| (of, g)))
                })
                .collect::<Result<_>>()?;
            for (of, better) in found.into_iter().flatten() {
                if better.against(best[of].as_ref().unwrap_or(&gripped[of])).is_lt() {
                    best[of] = Some(better);
                }
            }
        }
        Ok(best.into_iter().flatten().collect())
    }

    /// Carries them out: under few conditions all of them, under the others those that went best; these first.
    fn try_out(
        &self,
        gripped: Vec<Gripped<J::Grip>>,
        masses_kg: &[f64],
        options: &LearnOptions,
    ) -> Result<Vec<Practised>> {
        let conditions = conditions(&options.spread, options.train.seed);
        let conditions: Vec<(Condition, f64)> = conditions.into_iter().zip(masses_kg.iter().copied().cycle()).collect();
        let practised = |g: Gripped<J::Grip>| {
            let fingers = self.judge.fingers(&g.grip);
            (Practised { grasp: g.grasp, fingers, marks: Vec::new() }, g.grip)
        };
        let mut practised: Vec<(Practised, J::Grip)> = gripped.into_iter().map(practised).collect();
        if options.practised == 0 {
            return Ok(practised.into_iter().map(|p| p.0).collect());
        }
        let mut until = 0;
        for (stage, (count_of, one_of)) in STAGES.into_iter().enumerate() {
            until += count_of;
            practised.par_iter_mut().try_for_each(|p| self.go_on(p, &conditions[..until]))?;
            best(&mut practised, options.practised.div_ceil(one_of));
            if stage != OFFSPRING_AFTER {
                continue;
            }
            for (generation, size) in OFFSPRING_SIZES.into_iter().enumerate() {
                let seed = (!options.train.seed).wrapping_sub(generation as u64);
                practised.extend(self.offspring(&practised, &conditions[..until], size, seed)?);
                best(&mut practised, options.practised.div_ceil(one_of));
            }
        }
        Ok(practised.into_iter().map(|p| p.0).collect())
    }

    /// Carries a grasp out under those of the conditions that it has not seen.
    fn go_on(&self, (p, grip): &mut (Practised, J::Grip), conditions: &[(Condition, f64)]) -> Result<()> {
        for (condition, mass_kg) in &conditions[p.marks.len()..] {
            let judged = attempt(self.judge, grip, condition, *mass_kg)?;
            p.marks.push(if judged.held() { 1.0 + LEEWAY * judged.leeway } else { 0.0 });
        }
        Ok(())
    }

    /// Variations of grasps in practice, those that went no worse than what they come from.
    fn offspring(
        &self,
        parents: &[(Practised, J::Grip)],
        conditions: &[(Condition, f64)],
        size: f64,
        seed: u64,
    ) -> Result<Vec<(Practised, J::Grip)>> {
        let closer = Closer::new(self.robot)?;
        let born = |i: usize| {
            let parent = &parents[i / VARIATIONS].0;
            let Some(grasp) = closer.varied(self.thing, &parent.grasp, size, seed, i as u64)? else {
                return Ok(None);
            };
            let Some(Gripped { grasp, grip, .. }) = self.gripped(grasp)? else { return Ok(None) };
            let fingers = self.judge.fingers(&grip);
            let mut child = (Practised { grasp, fingers, marks: Vec::new() }, grip);
            // A few conditions say of most that they are no better.
            for until in [STAGES[0].0, conditions.len()] {
                self.go_on(&mut child, &conditions[..until])?;
                if child.0.mark() < parent.marks[..until].iter().sum::<f64>() {
                    return Ok(None);
                }
            }
            Ok(Some(child))
        };
        let children: Vec<Option<_>> =
            (0..parents.len() * VARIATIONS).into_par_iter().map(born).collect::<Result<_>>()?;
        Ok(children.into_iter().flatten().collect())
    }
}

impl Practised {
    /// All marks together.
    fn mark(&self) -> f64 {
        self.marks.iter().sum()
    }

    /// Under how many conditions it held.
    fn holds(&self) -> usize {
        self.marks.iter().filter(|m| **m > 0.0).count()
    }
}

impl<G> Gripped<G> {
    /// Which asks for less.
    fn against(&self, other: &Self) -> Ordering {
        self.place.cmp(&other.place).then(self.squeeze_n.total_cmp(&other.squeeze_n))
    }
}

/// The conditions of all stages.
fn conditions(spread: &Spread, seed: u64) -> Vec<Condition> {
    let mut conditions = spread.conditions(STAGES.iter().map(|s| s.0).sum(), seed ^ PRACTICE_SEED);
    let (lowest, highest) = spread.friction;
    for (i, condition) in conditions.iter_mut().enumerate() {
        condition.friction = lowest + (highest - lowest) * (FIRST_FRICTION + FRICTION_STEP * i as f64).fract();
    }
    conditions
}

/// A grip with a little less than the force of the law, carried out.
fn attempt<J: Judge>(judge: &J, grip: &J::Grip, condition: &Condition, mass_kg: f64) -> Result<Judged> {
    let belief = condition.belief(mass_kg);
    let needed = match judge.squeeze_n(grip, &belief, Squeeze::Needed)? {
        Ok(needed) => needed,
        Err(reason) => return Ok(Judged::refused(&reason)),
    };
    match judge.plan(grip, &belief, Squeeze::Total(PRACTICE_FORCE * needed))? {
        Ok(plan) => judge.try_out(&plan, &condition.truth(mass_kg)),
        Err(reason) => Ok(Judged::refused(&reason)),
    }
}

/// The first so many by how they went.
fn best<G>(practised: &mut Vec<(Practised, G)>, most: usize) {
    practised.sort_by(|(a, _), (b, _)| b.mark().total_cmp(&a.mark()));
    practised.truncate(most);
}

/// Of those sorted by how they went the best ones, and before them whatever holds under a condition that no better one stands.
fn chosen(practised: Vec<Practised>) -> Vec<Practised> {
    let best = practised.first().map_or(0.0, Practised::mark);
    let as_good = |p: &Practised, share: f64| p.mark() >= share * best;
    let mut out: Vec<Practised> = Vec::new();
    let mut rest = Vec::new();
    for p in practised {
        let new = p.marks.iter().enumerate().any(|(c, m)| *m > 0.0 && out.iter().all(|o| o.marks[c] == 0.0));
        if new && as_good(&p, WHERE_OTHERS_FAIL) { out.push(p) } else { rest.push(p) }
    }
    let room = LEARNED.saturating_sub(out.len());
    // Those that often fail where others hold would only be in the way; where nothing holds, they are all there is.
    out.extend(rest.into_iter().filter(|p| as_good(p, NEARLY_AS_GOOD)).take(room));
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::judge::fake::ByHand;
    use super::super::library::{Kind, Origins, searched};
    use super::super::objects;
    use super::*;

    /// 1 kg to 0.2 kg on a cube, whose grasps are as strong as their first joint says.
    fn task<'a>(thing: &'a Thing, robot: &'a Robot, masses_kg: &[f64]) -> Task<'a, ByHand> {
        let at = |mass_kg: &f64| -> Vec<Belief> {
            (0..TOLD).map(|i| Belief { mass_kg: *mass_kg, friction: 0.3 + 0.03 * i as f64 }).collect()
        };
        let closes_on = Belief { mass_kg: masses_kg[0], friction: 0.5 };
        Task { thing, robot, judge: &ByHand, closes_on, beliefs: masses_kg.iter().map(at).collect() }
    }

    fn cube() -> (Thing, Robot) {
        (Thing::new(&objects::named("cube").unwrap()).unwrap(), Robot::bundled("leap_right").unwrap())
    }

    #[test]
    fn the_first_load_that_is_carried_is_found_by_halving_as_by_looking_at_all() {
        let (thing, robot) = cube();
        let task = task(&thing, &robot, &[1.0, 0.2]);
        let grasp = searched(&thing, &robot, 4000, 0.5, 0).unwrap().swap_remove(0);
        let loads: Vec<&Belief> = task.beliefs.iter().flatten().collect();
        let mut places = Vec::new();
        for strongest in 0..70 {
            let mut grasp = grasp.clone();
            grasp.joints_rad[0] = f64::from(strongest);
            let carries = |b: &&Belief| ByHand.plan(&grasp.joints_rad[0], b, Squeeze::Needed).unwrap().is_ok();
            let expected = loads.iter().position(carries);
            let found = task.gripped(grasp).unwrap();
            assert_eq!(found.as_ref().map(|g| g.place), expected, "{strongest} N");
            if let Some(g) = found {
                assert_eq!(g.squeeze_n, ByHand.plan(&1e3, loads[g.place], Squeeze::Needed).unwrap().unwrap());
            }
            places.extend(expected);
        }
        assert!(places.contains(&0) && places.iter().any(|p| *p > TOLD), "{places:?}");
    }

    #[test]
    fn climbing_leads_to_neighbours_that_carry_more() {
        let (thing, robot) = cube();
        // As strong, N, as the first joint says in rad: 20 g are at the edge of what that carries.
        let task = task(&thing, &robot, &[0.02]);
        let found = searched(&thing, &robot, 20_000, 0.5, 0).unwrap();
        let mut start: Vec<_> =
            found.into_iter().filter_map(|g| task.gripped(g).unwrap()).filter(|g| g.place > 0).collect();
        // Many of them have no neighbour that is better, or none that is out of the object and off the table.
        assert!(start.len() >= 12, "{} to begin with", start.len());
        start.iter_mut().for_each(|g| g.grasp.kind = Kind::Retargeted);
        let better = task.varied(&start[..12], 1).unwrap();
        assert!(!better.is_empty());
        for b in &better {
            let parent = start.iter().find(|g| g.grasp.clip == b.grasp.clip).unwrap();
            assert!(b.against(parent).is_lt() && b.grasp.joints_rad[0] > parent.grasp.joints_rad[0]);
            assert_eq!(b.grasp.kind, parent.grasp.kind.varied());
        }
        let origins = Origins::of(better.iter().map(|b| b.grasp.kind));
        assert_eq!(origins, Origins { refined: better.len(), ..Origins::default() });
        let again = task.varied(&start[..12], 1).unwrap();
        assert!(again.iter().map(|g| &g.grasp).eq(better.iter().map(|g| &g.grasp)));
    }

    #[test]
    fn each_stage_sees_low_and_high_friction() {
        let frictions = conditions(&Spread::default(), 3).into_iter().map(|c| c.friction);
        let quarters: Vec<usize> = frictions.map(|f| ((f - 0.3) / 0.125) as usize).collect();
        assert_eq!(quarters[..4], [0, 2, 1, 3]);
        assert_eq!([0, 1, 2, 3].map(|q| quarters.iter().filter(|x| **x == q).count()), [6; 4]);
    }

    #[test]
    fn of_grasps_that_hold_as_often_those_that_slip_least_come_first() {
        let (thing, robot) = cube();
        let grasp = searched(&thing, &robot, 4000, 0.5, 0).unwrap().swap_remove(0);
        let practised =
            |marks: &[f64]| (Practised { grasp: grasp.clone(), fingers: vec![true; 4], marks: marks.to_vec() }, ());
        let mut all = vec![practised(&[1.1, 1.0, 1.0]), practised(&[1.5, 1.4, 0.0]), practised(&[1.4, 1.5, 1.25])];
        best(&mut all, 2);
        let marks: Vec<f64> = all.iter().map(|p| p.0.mark()).collect();
        assert_eq!((marks, all[0].0.holds(), all[1].0.holds()), (vec![1.4 + 1.5 + 1.25, 1.1 + 1.0 + 1.0], 3, 3));
    }

    #[test]
    fn what_holds_where_no_better_one_does_is_learned_too() {
        let (thing, robot) = cube();
        let grasp = searched(&thing, &robot, 4000, 0.5, 0).unwrap().swap_remove(0);
        let practised = |held: &[u8]| Practised {
            grasp: grasp.clone(),
            fingers: vec![true; 4],
            marks: held.iter().map(|h| f64::from(*h)).collect(),
        };
        let best = [1, 1, 1, 1, 1, 1, 1, 1, 1, 0];
        let other = [1, 1, 1, 1, 1, 1, 0, 0, 0, 1];
        let worse = [1, 1, 1, 1, 1, 1, 1, 0, 0, 0];
        let kept = chosen(vec![practised(&best), practised(&other), practised(&worse)]);
        assert_eq!(kept.len(), 2);
        assert!(kept[1].marks[9] > 0.0 && kept[1].marks[6] == 0.0);
    }
}
