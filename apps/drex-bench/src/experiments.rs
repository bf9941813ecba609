//! The experiments: which cells a table has. All cells of a table have the same rollouts.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use drex_core::Pose;
use drex_core::stats::upper_median;
use drex_policy::TrainOptions;
use drex_retarget::TargetHand;
use drex_robot::Robot;
use drex_trial::{
    Condition, ConditionSpread, Evaluator, GraspPath, GripForce, PathForce, Proposal, SelectionOptions,
    clustered_difference, paired_difference, select_grasps,
};
use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion, Vector3, Vector4};

use super::cell::{Actor, AssumedMass, Cell, Row, Setting};
use super::library::{self, Library, LibraryOptions};
use super::object::BenchObject;
use super::objects::{self, ObjectSpec};
use super::table::{Comparison, Table};
use drex_grasp::{Grasp, GraspOrigin, least_friction};
use drex_twin::learn::{LearnOptions, Learned, POINTS};

/// What is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Experiment {
    /// One object at three masses, the force set for each of them.
    CrossMass,
    /// Eight objects from 37 g to 726 g.
    Objects,
    /// True mass, identified mass, half and one and a half of it, one force for all: of robust and of fragile things.
    MassSource,
    /// The number of demonstrations.
    Scaling,
    /// Trained on a larger object of one kind, used on a smaller.
    Transfer,
    /// Mean and nearest demonstration, fixed force, random masses, the true mass.
    Baselines,
}

/// Masses of the letter in the paper's cross-mass table, of the letter itself, kg.
const LETTER_KG: [f64; 3] = [0.082, 0.125, 0.218];
/// Friction of the letter, the middle of the protocol's spread.
const LETTER_FRICTION: f64 = 0.55;
/// Masses of Symbol-Y in the paper's table, kg.
const SYMBOL_Y_KG: [f64; 3] = [0.117, 0.206, 0.324];
/// Standard deviation of an identified mass, as a share: twice the error (root mean square 1.5 %) that docs/mass-identification.md measures
/// on pushes with a recorded force. From the efforts of a hand's joints alone it is 13 % and more.
pub const IDENTIFIED_SD: f64 = 0.03;
/// Forces that know nothing of the object, N, of which the best is looked for.
const FIXED_FORCES_N: [f64; 3] = [5.0, 10.0, 20.0];
/// A force that knows nothing of the object, N: what the grip-force policy asks two opposed fingers for at 200 g and a friction of 0.5, 2.08 m g / μ.
const FIXED_N: f64 = 8.2;
/// Plans by which a fragile thing is weighted, and what distinguishes their seed.
const PLANNED: usize = 20;
const PLANNED_SEED: u64 = 0x706c_616e;
/// Name of the path without an ablation.
const WHOLE: &str = "whole";
/// Numbers of demonstrations.
const CLIPS: [usize; 6] = [1, 2, 5, 10, 20, 40];

/// Said of tables that compare forces.
const SAME_GRASPS: &str = "of the grasps of a policy the one is taken that suits the true mass, whatever the hand is told: cells differ in force alone";

/// What all experiments need.
pub struct Bench<'a, E> {
    pub hand: &'a TargetHand,
    pub robot: Arc<Robot>,
    /// An evaluator of grasps of this object.
    pub evaluator: &'a (dyn Fn(&BenchObject) -> Result<E> + Sync),
    pub rollouts: usize,
    pub seed: u64,
    pub library: LibraryOptions,
    pub train: TrainOptions,
    /// Grasps that are simulated before one is learned.
    pub simulated: usize,
    /// Every command is carried out in both engines.
    pub compare: bool,
    /// Beside each row of a network, one without each step of its path.
    pub ablations: bool,
    /// Acceleration of the shakes, m/s².
    pub shake_m_s2: f64,
    /// Folder for grasps.
    pub out: Option<PathBuf>,
    /// Says what is going on.
    pub note: &'a dyn Fn(&str),
}

/// An object with its grasps and its evaluator.
struct Ready<E> {
    thing: BenchObject,
    grasps: Vec<Grasp>,
    evaluator: E,
    points: Vec<Point3<f64>>,
    /// See [`Bench::easiest`].
    easiest: OnceLock<Vec<Proposal>>,
}

impl<E> Ready<E> {
    /// A network, asked for this object.
    fn policy<'a>(&'a self, learned: &'a Learned) -> Actor<'a> {
        Actor::Policy(learned, &self.points, self.thing.object.table().up.into_inner())
    }
}

impl<E: Evaluator> Bench<'_, E> {
    /// Runs an experiment on the objects given, or on its own.
    ///
    /// # Errors
    /// If an object cannot be grasped at all, a training fails, or something cannot be simulated.
    pub fn run(&self, experiment: Experiment, given: Option<&[ObjectSpec]>) -> Result<Table> {
        let own = |names: &[&str]| names.iter().map(|n| objects::named(n)).collect::<Result<Vec<_>>>();
        let specs = match (given, experiment) {
            (Some(specs), _) => specs.to_vec(),
            (None, Experiment::Objects) => objects::eight()?,
            (None, Experiment::CrossMass) => own(&["letter_u"])?,
            (None, Experiment::MassSource) => {
                let mut specs = own(&["cube", "spam_can", "spray_bottle"])?;
                specs.extend(objects::fragile()?);
                specs
            }
            (None, Experiment::Scaling) => own(&["cube"])?,
            (None, Experiment::Transfer) => own(&["screwdriver", "small_screwdriver"])?,
            (None, Experiment::Baselines) => own(&["letter_y"])?,
        };
        let mut table = Table::default();
        match experiment {
            Experiment::CrossMass => self.cross_mass(&specs, &mut table)?,
            Experiment::Objects => self.objects(&specs, &mut table)?,
            Experiment::MassSource => self.mass_source(&specs, &mut table)?,
            Experiment::Scaling => self.scaling(&specs, &mut table)?,
            Experiment::Transfer => self.transfer(&specs, &mut table)?,
            Experiment::Baselines => self.baselines(&specs, &mut table)?,
        }
        Ok(table)
    }

    /// One object at three masses: the force of each at each, and of half the mass.
    fn cross_mass(&self, specs: &[ObjectSpec], table: &mut Table) -> Result<()> {
        for spec in specs {
            let masses = three_masses(spec, "letter_u", LETTER_KG);
            // One object has one friction.
            let spec = ObjectSpec { friction: spec.friction.or(Some(LETTER_FRICTION)), ..spec.clone() };
            let ready = self.ready(&spec)?;
            let policy = self.learn(&ready, &ready.grasps, masses.to_vec(), false)?;
            let actor = ready.policy(&policy);
            for mass_kg in masses {
                let least = self.least_friction(&ready, mass_kg)?;
                let told = masses.map(|m| (grams(m), AssumedMass::Always(m)));
                for (name, told) in told.into_iter().chain([("half".to_owned(), AssumedMass::Times(0.5))]) {
                    let labels = vec![("object", spec.name.clone()), ("told", name), ("true", grams(mass_kg))];
                    let setting = Setting::chosen_by_truth(mass_kg, told);
                    self.add(&ready, &actor, labels, setting, least, table)?;
                }
            }
        }
        table.notes.push("the row says what the force is set for, and what the object weighs".into());
        table.notes.push(format!("friction within a tenth of the object's, {LETTER_FRICTION} if it says none"));
        table.notes.push(SAME_GRASPS.into());
        Ok(())
    }

    fn objects(&self, specs: &[ObjectSpec], table: &mut Table) -> Result<()> {
        for spec in specs {
            let ready = self.ready(spec)?;
            let policy = self.learn(&ready, &ready.grasps, Vec::new(), false)?;
            let actor = ready.policy(&policy);
            let labels = vec![("object", spec.name.clone()), ("true", grams(spec.mass_kg))];
            let least = self.least_friction(&ready, spec.mass_kg)?;
            let told = AssumedMass::Identified(IDENTIFIED_SD);
            let setting = Setting::assuming(spec.mass_kg, told);
            self.add(&ready, &actor, labels, setting, least, table)?;
        }
        let n = whole(&table.rows).count().max(1) as f64;
        let rate = whole(&table.rows).map(|r| r.interval.value).sum::<f64>() / n;
        let bound = whole(&table.rows).map(|r| r.bound).sum::<f64>() / n;
        table.notes.push(format!("mean over objects: {:.1} % of rollouts, bound {:.1} %", 100.0 * rate, 100.0 * bound));
        table.notes.push(identified_note());
        Ok(())
    }

    fn mass_source(&self, specs: &[ObjectSpec], table: &mut Table) -> Result<()> {
        for spec in specs {
            let ready = self.ready(spec)?;
            let policy = self.learn(&ready, &ready.grasps, Vec::new(), false)?;
            let actor = ready.policy(&policy);
            let mass_kg = match spec.damaged_at_n {
                Some(limit_n) => objects::damaged_by_half_as_much_again(limit_n, self.grip_per_weight(&ready, &actor)?),
                None => spec.mass_kg,
            };
            let least = self.least_friction(&ready, mass_kg)?;
            let sources = [
                ("identified", AssumedMass::Identified(IDENTIFIED_SD)),
                ("true", AssumedMass::Times(1.0)),
                ("+50 %", AssumedMass::Times(1.5)),
                ("-50 %", AssumedMass::Times(0.5)),
            ];
            let sources = sources.map(|(name, told)| (name.to_owned(), told, PathForce::Required));
            let fixed = FIXED_FORCES_N.map(|n| (format!("{n} N"), AssumedMass::Times(1.0), PathForce::Fixed(n)));
            let first = table.rows.len();
            for (name, told, force) in sources.into_iter().chain(fixed) {
                let labels = vec![("mass", name), ("object", spec.name.clone()), ("true", grams(mass_kg))];
                let path = GraspPath { force, ..GraspPath::default() };
                let setting = Setting { path, ..Setting::chosen_by_truth(mass_kg, told) };
                self.add(&ready, &actor, labels, setting, least, table)?;
            }
            let rows: Vec<&Row> = whole(&table.rows[first..]).collect();
            let others = rows[1..].iter().map(|r| (&r.labels["mass"], paired_difference(&r.held, &rows[0].held)));
            let compare =
                |(name, difference)| Comparison { what: format!("{}: {name} minus identified", spec.name), difference };
            let others: Vec<Comparison> = others.map(compare).collect();
            table.comparisons.extend(others);
        }
        table.comparisons.extend(mass_sources(specs, &table.rows));
        table.notes.push(identified_note());
        let limits = specs.iter().filter_map(|s| Some(format!("{} {} N", s.name, s.damaged_at_n?)));
        let limits: Vec<String> = limits.collect();
        if !limits.is_empty() {
            table.notes.push(format!(
                "damaged by a finger that presses harder than this, which nobody tells the hand: {}",
                limits.join(", ")
            ));
            table.notes.push("what can be damaged is weighted, before any rollout, until its limit is between what the hand presses with for its mass and for half as much again".into());
        }
        table.notes.push(SAME_GRASPS.into());
        table.notes.push("one force for all is pressed with by the first grasp of the policy that can".into());
        Ok(())
    }

    /// The first demonstrations only, more and more of them.
    fn scaling(&self, specs: &[ObjectSpec], table: &mut Table) -> Result<()> {
        for spec in specs {
            let ready = self.ready(spec)?;
            let least = self.least_friction(&ready, spec.mass_kg)?;
            let mut clips: Vec<usize> =
                ready.grasps.iter().filter(|g| g.origin == GraspOrigin::Retargeted).map(|g| g.source).collect();
            clips.dedup();
            if clips.is_empty() {
                bail!(
                    "none of the {} demonstrations of \"{}\" gives a grasp: ask for more of them (--clips) or for another object (--only)",
                    self.library.demonstrations.clips,
                    spec.name
                );
            }
            for count in CLIPS.into_iter().filter(|c| *c <= clips.len()) {
                let among = &clips[..count];
                let grasps: Vec<Grasp> = ready
                    .grasps
                    .iter()
                    .filter(|g| g.origin == GraspOrigin::Retargeted && among.contains(&g.source))
                    .cloned()
                    .collect();
                let labels = vec![
                    ("demonstrations", count.to_string()),
                    ("grasps", grasps.len().to_string()),
                    ("object", spec.name.clone()),
                ];
                let policy = match self.learn(&ready, &grasps, Vec::new(), false) {
                    Ok(policy) => policy,
                    // So few that none can carry it: that is a result, not an error.
                    Err(error) => {
                        table.notes.push(format!("{count} demonstrations of {}: {error}", spec.name));
                        continue;
                    }
                };
                let actor = ready.policy(&policy);
                let told = AssumedMass::Identified(IDENTIFIED_SD);
                let setting = Setting::assuming(spec.mass_kg, told);
                self.add(&ready, &actor, labels, setting, least, table)?;
            }
            if CLIPS.into_iter().any(|count| count > clips.len()) {
                let (give, asked) = (clips.len(), self.library.demonstrations.clips);
                table.notes.push(format!(
                    "{give} of {asked} demonstrations of {} give a grasp; rows of more need more of them (--clips)",
                    spec.name
                ));
            }
        }
        table.notes.push(
            "demonstrations that give a grasp, in the order in which they were made, and the grasps that they give"
                .into(),
        );
        Ok(())
    }

    /// Trained on the first object, used on all.
    fn transfer(&self, specs: &[ObjectSpec], table: &mut Table) -> Result<()> {
        let first = self.ready(specs.first().context("there is no object")?)?;
        let policy = self.learn(&first, &first.grasps, Vec::new(), false)?;
        for spec in specs {
            let ready = self.ready(spec)?;
            let least = self.least_friction(&ready, spec.mass_kg)?;
            let own = match spec.name == first.thing.spec.name {
                true => None,
                false => Some(self.learn(&ready, &ready.grasps, Vec::new(), false)?),
            };
            let sources = [(&first.thing.spec, Some(&policy)), (spec, own.as_ref())];
            let sources = sources.into_iter().filter_map(|(from, policy)| Some((from.name.clone(), policy?)));
            for (from, policy) in sources {
                let actor = ready.policy(policy);
                let labels = vec![("object", spec.name.clone()), ("trained on", from), ("true", grams(spec.mass_kg))];
                // The force is not what is transferred: the law has the contacts of this object.
                let told = AssumedMass::Times(1.0);
                let setting = Setting::assuming(spec.mass_kg, told);
                self.add(&ready, &actor, labels, setting, least, table)?;
            }
        }
        Ok(())
    }

    fn baselines(&self, specs: &[ObjectSpec], table: &mut Table) -> Result<()> {
        for spec in specs {
            let masses = three_masses(spec, "letter_y", SYMBOL_Y_KG);
            let ready = self.ready(spec)?;
            let ours = self.learn(&ready, &ready.grasps, masses.to_vec(), false)?;
            let random = self.learn(&ready, &ready.grasps, masses.to_vec(), true)?;
            let policy = ready.policy(&ours);
            let randomised = ready.policy(&random);
            let demonstrated = |g: &&Grasp| matches!(g.origin, GraspOrigin::Retargeted | GraspOrigin::Refined);
            let demonstrations: Vec<Grasp> = ready.grasps.iter().filter(demonstrated).cloned().collect();
            let mean = Actor::Always(vec![mean_grasp(&demonstrations)?]);
            let nearest = Actor::Always(vec![nearest_grasp(&demonstrations)?]);
            for mass_kg in masses {
                let least = self.least_friction(&ready, mass_kg)?;
                let whole = GraspPath::default();
                let of_network = GraspPath { force: PathForce::Proposed, ..whole };
                let methods = [
                    ("mean demonstration", &mean, AssumedMass::Times(1.0), whole),
                    ("nearest demonstration", &nearest, AssumedMass::Times(1.0), whole),
                    ("force of the network", &policy, AssumedMass::Identified(IDENTIFIED_SD), of_network),
                    ("random masses", &randomised, AssumedMass::Times(1.0), of_network),
                    ("ours", &policy, AssumedMass::Identified(IDENTIFIED_SD), whole),
                    ("ours, true mass", &policy, AssumedMass::Times(1.0), whole),
                ];
                for (name, actor, told, path) in methods {
                    let labels =
                        vec![("method", name.to_owned()), ("object", spec.name.clone()), ("true", grams(mass_kg))];
                    let setting = Setting { path, ..Setting::chosen_by_truth(mass_kg, told) };
                    self.add(&ready, actor, labels, setting, least, table)?;
                }
            }
        }
        table.notes.push(identified_note());
        table.notes.push("random masses: trained at all of them, told none; there, and in \"force of the network\", the mass that the hand is told chooses the grasp too".into());
        table.notes.push(SAME_GRASPS.into());
        Ok(())
    }

    fn add(
        &self,
        ready: &Ready<E>,
        actor: &Actor<'_>,
        labels: Vec<(&'static str, String)>,
        setting: Setting,
        least_friction: Option<f64>,
        table: &mut Table,
    ) -> Result<()> {
        let whole = GraspPath::default();
        let (validated, easiest);
        let mut steps = vec![(None, actor, setting.path)];
        if let Actor::Policy(learned, ..) = actor
            && self.ablations
            && setting.path == whole
        {
            validated = Actor::Always(learned.validated.iter().map(|p| always(p.grasp.clone())).collect());
            easiest = Actor::Always(self.easiest(ready)?);
            steps = vec![
                (Some(WHOLE), actor, whole),
                (Some("no network"), &validated, whole),
                (Some("no network, no practice"), &easiest, whole),
                (Some("no dry run"), actor, GraspPath { dry_run: false, ..whole }),
                (Some("first that carries"), actor, GraspPath { cautious: false, ..whole }),
                (Some("fixed force"), actor, GraspPath { force: PathForce::Fixed(FIXED_N), ..whole }),
            ];
        }
        for (step, actor, path) in steps {
            let step = step.map(|name: &str| ("path", name.to_owned()));
            let labels = labels.iter().cloned().chain(step).collect();
            let (evaluator, setting, compare) = (&ready.evaluator, Setting { path, ..setting }, self.compare);
            let damaged_at_n = ready.thing.spec.damaged_at_n;
            let cell = Cell { labels, evaluator, actor, setting, damaged_at_n, least_friction, compare };
            let start = Instant::now();
            let row: Row = cell.run(&self.conditions(&ready.thing))?;
            table.judging_s += start.elapsed().as_secs_f64();
            (self.note)(&row.text());
            table.rows.push(row);
        }
        Ok(())
    }

    /// The grip force in weights of the object, median over plans of other conditions than those of the rollouts.
    fn grip_per_weight(&self, ready: &Ready<E>, actor: &Actor<'_>) -> Result<f64> {
        let spec = &ready.thing.spec;
        let conditions = ConditionSpread::around(spec.friction).conditions(PLANNED, self.seed ^ PLANNED_SEED);
        let plan = |condition: &Condition| {
            let assumed = condition.assumed(spec.mass_kg);
            let proposals = actor.propose(&assumed)?;
            if proposals.is_empty() {
                return Ok(None);
            }
            let planned = GraspPath::default().plan(&ready.evaluator, proposals, &assumed)?;
            Ok(ready.evaluator.grip_force_n(&planned.closed, &assumed, GripForce::Required)?.ok())
        };
        let planned = conditions.iter().map(plan).collect::<Result<Vec<Option<f64>>>>()?;
        let force_n = upper_median(planned.into_iter().flatten()).context("no grasp of it has a command")?;
        Ok(force_n / (9.81 * spec.mass_kg))
    }

    /// The grasps of the library that ask for the least force once the hand has closed.
    fn easiest(&self, ready: &Ready<E>) -> Result<Vec<Proposal>> {
        if let Some(easiest) = ready.easiest.get() {
            return Ok(easiest.clone());
        }
        let object = &ready.thing.object;
        let options = SelectionOptions {
            spread: ConditionSpread::around(ready.thing.spec.friction),
            simulated: 0,
            shake_m_s2: self.shake_m_s2,
            seed: self.seed,
        };
        let masses_kg = [object.mass_kg()];
        let selected = select_grasps(object, &self.robot, &ready.grasps, &ready.evaluator, &masses_kg, &options)?;
        let easiest = selected.grasps.into_iter().map(|g| always(g.grasp)).collect();
        Ok(ready.easiest.get_or_init(|| easiest).clone())
    }

    fn conditions(&self, thing: &BenchObject) -> Vec<Condition> {
        ConditionSpread::around(thing.spec.friction).conditions(self.rollouts, self.seed)
    }

    fn ready(&self, spec: &ObjectSpec) -> Result<Ready<E>> {
        let thing = BenchObject::new(spec)?;
        let file = library::file(self.out.as_deref(), &spec.name)?;
        let library = Library::of(&thing, self.hand, &self.library, file.as_deref())?;
        (self.note)(&format!("{:>10}  {} grasps of {}", "grasps", library.grasps.len(), spec.name));
        let (evaluator, points) = ((self.evaluator)(&thing)?, thing.object.point_cloud(POINTS, self.seed));
        Ok(Ready { thing, grasps: library.grasps, evaluator, points, easiest: OnceLock::new() })
    }

    fn learn(&self, ready: &Ready<E>, grasps: &[Grasp], masses_kg: Vec<f64>, mass_hidden: bool) -> Result<Learned> {
        let spread = ConditionSpread::around(ready.thing.spec.friction);
        let options = LearnOptions {
            train: self.train.clone(),
            spread,
            simulated: self.simulated,
            shake_m_s2: self.shake_m_s2,
            masses_kg,
            mass_hidden,
        };
        let learned = Learned::train(&ready.thing.object, &self.robot, grasps, &ready.evaluator, &options)?;
        let from = learned.carries_from.map_or(String::new(), |mu| format!(" (from a friction of {mu:.2} on)"));
        (self.note)(&format!(
            "{:>10}  {}: {} of {} grasps can be commanded{from}, {} held in practice, {} learned ({}); practice {:.0} s, learning {:.0} s",
            "trained",
            ready.thing.spec.name,
            learned.commanded,
            grasps.len(),
            learned.robust,
            learned.learned.total(),
            learned.learned,
            learned.seconds[0],
            learned.seconds[1]
        ));
        Ok(learned)
    }

    fn least_friction(&self, ready: &Ready<E>, mass_kg: f64) -> Result<Option<f64>> {
        Ok(least_friction(&ready.thing.object, &self.robot, &ready.grasps, mass_kg, self.shake_m_s2)?)
    }
}

/// Rows of the whole path.
fn whole(rows: &[Row]) -> impl Iterator<Item = &Row> {
    rows.iter().filter(|r| r.labels.get("path").is_none_or(|p| p == WHOLE))
}

/// The paper's masses for the paper's object; for others their own mass, as much lighter and heavier.
fn three_masses(spec: &ObjectSpec, paper: &str, masses: [f64; 3]) -> [f64; 3] {
    if spec.name == paper { masses } else { masses.map(|m| m / masses[1] * spec.mass_kg) }
}

/// By how much each source of the mass holds more than an identified mass, of all robust and of all fragile things, clustered by object.
fn mass_sources(specs: &[ObjectSpec], rows: &[Row]) -> Vec<Comparison> {
    let kinds = [("robust things", false), ("fragile things", true)];
    let of = |object: &str, mass: &str| {
        whole(rows).find(|r| r.labels["object"] == object && r.labels["mass"] == mass).map(|r| r.successes)
    };
    let mut masses: Vec<&str> = whole(rows).map(|r| r.labels["mass"].as_str()).filter(|m| *m != "identified").collect();
    masses.sort_unstable();
    masses.dedup();
    let mut out = Vec::new();
    for (kind, fragile) in kinds {
        let objects: Vec<&str> =
            specs.iter().filter(|s| s.damaged_at_n.is_some() == fragile).map(|s| s.name.as_str()).collect();
        for mass in masses.iter().filter(|_| objects.len() > 1) {
            let pair = |o: &&str| Some((of(o, mass)?, of(o, "identified")?, rows[0].n));
            let groups: Vec<(usize, usize, usize)> = objects.iter().filter_map(pair).collect();
            let what = format!("{kind}: {mass} minus identified");
            out.push(Comparison { what, difference: clustered_difference(&groups) });
        }
    }
    out
}

fn grams(kg: f64) -> String {
    format!("{:.0} g", 1e3 * kg)
}

fn identified_note() -> String {
    format!("an identified mass is off by a normal error of {:.0} %", 100.0 * IDENTIFIED_SD)
}

/// The mean of joints and wrists.
fn mean_grasp(grasps: &[Grasp]) -> Result<Proposal> {
    let first = grasps.first().context("there is no grasp")?;
    let n = grasps.len() as f64;
    let mut joints = vec![0.0; first.joints_rad.len()];
    let (mut at, mut turn) = (Vector3::zeros(), Vector4::zeros());
    let reference = first.object_from_base.rotation;
    for g in grasps {
        joints.iter_mut().zip(&g.joints_rad).for_each(|(m, q)| *m += q / n);
        let pose = g.object_from_base;
        at += pose.translation.vector / n;
        // Both signs are the same turn.
        let sign = pose.rotation.coords.dot(&reference.coords).signum();
        turn += pose.rotation.coords * sign / n;
    }
    let rotation = UnitQuaternion::try_new(Quaternion::from(turn), 1e-9).unwrap_or(reference);
    let object_from_base = Pose::from_parts(Translation3::from(at), rotation);
    Ok(always(Grasp { joints_rad: joints, object_from_base, ..first.clone() }))
}

/// A grasp that is always proposed, without a force.
fn always(grasp: Grasp) -> Proposal {
    Proposal { grasp, grip_force_n: 0.0, weight: 1.0 }
}

/// The demonstration nearest to the mean, by joints.
fn nearest_grasp(grasps: &[Grasp]) -> Result<Proposal> {
    let mean = mean_grasp(grasps)?;
    let far = |g: &Grasp| g.joints_rad.iter().zip(&mean.grasp.joints_rad).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    let g = grasps.iter().min_by(|a, b| far(a).total_cmp(&far(b))).context("there is no grasp")?;
    Ok(always(g.clone()))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use drex_trial::Assumed;

    use super::*;
    use crate::formula::PinchFormula;

    /// A bench with few demonstrations, judged by a formula.
    fn bench(hand: &TargetHand) -> Bench<'_, PinchFormula> {
        let mut library = LibraryOptions::default();
        (library.demonstrations.clips, library.demonstrations.per_clip) = (3, 3);
        library.candidates = 10_000;
        Bench {
            robot: Arc::new(hand.robot.clone()),
            hand,
            evaluator: &|_: &BenchObject| Ok(PinchFormula { strongest_n: 60.0 }),
            rollouts: 120,
            seed: 3,
            library,
            train: TrainOptions::default().with_epochs(60).with_hold_out_every(0),
            simulated: 20,
            compare: true,
            ablations: false,
            shake_m_s2: 4.9,
            out: None,
            note: &|_| {},
        }
    }

    /// Of a box that the hand can hold.
    fn table(experiment: Experiment) -> Table {
        let hand = TargetHand::bundled("leap_right").unwrap();
        bench(&hand).run(experiment, Some(&[objects::named("spam_can").unwrap()])).unwrap()
    }

    fn rate(table: &Table, labels: &[(&str, &str)]) -> f64 {
        let fits = |r: &&Row| labels.iter().all(|(k, v)| r.labels.get(k).is_some_and(|l| l == v));
        table.rows.iter().find(fits).unwrap().interval.value
    }

    #[test]
    fn the_force_for_another_mass_slips_where_the_formula_says() {
        let table = table(Experiment::CrossMass);
        assert_eq!(table.rows.len(), 12);
        // Masses in the paper's proportions: 239, 365 and 637 g.
        for mass in ["239 g", "365 g", "637 g"] {
            assert!(rate(&table, &[("told", mass), ("true", mass)]) > 0.9, "{}", table.text());
            assert!(rate(&table, &[("told", "half"), ("true", mass)]) < 0.05, "{}", table.text());
        }
        assert!(rate(&table, &[("told", "239 g"), ("true", "637 g")]) < 0.05);
        assert!(rate(&table, &[("told", "637 g"), ("true", "239 g")]) > 0.9);
        for row in &table.rows {
            let (failures, refused) = (row.failures.values().sum::<usize>(), row.refusals.values().sum::<usize>());
            assert_eq!((row.n, failures + refused), (120, 120 - row.successes));
            assert!((0.0..=1.0).contains(&row.bound));
            // One formula says the same twice, of every command that there was.
            let agreement = row.agreement.as_ref().unwrap();
            assert_eq!((agreement.same, agreement.n), (120 - refused, 120 - refused));
        }
        // A heavier thing is not easier to hold at all.
        let bounds: Vec<f64> = [0, 4, 8].iter().map(|i| table.rows[*i].bound).collect();
        assert!(bounds[0] >= bounds[1] && bounds[1] >= bounds[2], "{bounds:?}");
        let csv = table.csv();
        assert!(csv.starts_with("object,told,true,successes,n,") && csv.lines().count() == 13, "{csv}");
        let svg = table.svg("cross-mass");
        assert!(svg.matches("<rect").count() == 12 && svg.contains("told half"), "{svg}");
    }

    #[test]
    fn an_identified_mass_is_nearly_as_good_as_the_true_one() {
        let table = table(Experiment::MassSource);
        let [true_mass, ..] = &table.comparisons[..] else { panic!("{}", table.text()) };
        assert!(true_mass.what.contains("true") && true_mass.difference.value.abs() < 0.1, "{}", table.text());
        assert!(
            rate(&table, &[("mass", "-50 %")]) < 0.05 && rate(&table, &[("mass", "true")]) > 0.9,
            "{}",
            table.text()
        );
    }

    #[test]
    fn each_step_of_the_path_has_a_row() {
        let hand = TargetHand::bundled("leap_right").unwrap();
        let bench = Bench { ablations: true, ..bench(&hand) };
        let table = bench.run(Experiment::Objects, Some(&[objects::named("spam_can").unwrap()])).unwrap();
        let paths: Vec<&str> = table.rows.iter().map(|r| r.labels["path"].as_str()).collect();
        assert_eq!(
            paths,
            ["whole", "no network", "no network, no practice", "no dry run", "first that carries", "fixed force"]
        );
        // The can of 365 g takes 10 N and more where friction is low: the formula's motors have them, one force for all has not.
        assert!(
            rate(&table, &[("path", "whole")]) > 0.9 && rate(&table, &[("path", "fixed force")]) < 0.3,
            "{}",
            table.text()
        );
        assert!(table.rows[5].median_grip_force_n == Some(FIXED_N), "{}", table.text());
        // The others are in no mean and in no comparison.
        let mean = format!("mean over objects: {:.1} %", 100.0 * rate(&table, &[("path", "whole")]));
        assert!(table.notes[0].starts_with(&mean), "{}", table.text());
        let table = bench.run(Experiment::MassSource, Some(&[objects::named("spam_can").unwrap()])).unwrap();
        let held = |mass: &str| {
            &table.rows.iter().find(|r| r.labels["mass"] == mass && r.labels["path"] == WHOLE).unwrap().held
        };
        assert_eq!(table.comparisons[0].difference, paired_difference(held("true"), held("identified")));
    }

    #[test]
    fn what_lies_on_another_side_in_its_frame_is_grasped_alike() {
        let hand = TargetHand::bundled("leap_right").unwrap();
        let mut bench = bench(&hand);
        (bench.library.candidates, bench.simulated) = (3000, 0);
        bench.train = bench.train.with_epochs(2);
        let can = objects::named("spam_can").unwrap();
        // The same can on the same table in axes that are turned about y: up is x.
        let turn = Pose::rotation(Vector3::y() * std::f64::consts::FRAC_PI_2);
        let mut mesh = can.mesh.clone();
        mesh.vertices.iter_mut().for_each(|v| *v = turn * *v);
        let turned = ObjectSpec { mesh, up: Some(Vector3::x()), ..can.clone() };

        let ready = bench.ready(&can).unwrap();
        let learned = bench.learn(&ready, &ready.grasps, Vec::new(), false).unwrap();
        let proposed = |ready: &Ready<PinchFormula>| match ready.policy(&learned) {
            Actor::Policy(policy, points, up) => {
                policy.propose(points, &up, &Assumed { mass_kg: can.mass_kg, friction: 0.5 }).unwrap()
            }
            Actor::Always(_) | Actor::Asked(_) => panic!("a network was asked for"),
        };
        let thing = BenchObject::new(&turned).unwrap();
        let points = ready.points.iter().map(|p| turn * p).collect();
        let other = Ready {
            thing,
            grasps: Vec::new(),
            evaluator: PinchFormula { strongest_n: 60.0 },
            points,
            easiest: OnceLock::new(),
        };
        let (here, there) = (proposed(&ready), proposed(&other));
        assert!(!here.is_empty() && here.len() == there.len());
        for (a, b) in here.iter().zip(&there) {
            let off = (turn * a.grasp.object_from_base).inverse() * b.grasp.object_from_base;
            assert!(off.translation.vector.norm() < 1e-4 && off.rotation.angle() < 1e-3, "{off}");
        }
    }

    #[test]
    fn the_mean_of_turned_hands_is_between_them() {
        let hand = Robot::bundled("leap_right").unwrap();
        let library = |angle: f64, q: f64| Grasp::new(&hand, vec![q; 16], Pose::rotation(Vector3::z() * angle));
        let grasps = [library(0.2, 0.1), library(0.6, 0.5), library(0.4, 0.3)];
        let mean = mean_grasp(&grasps).unwrap();
        assert!((mean.grasp.joints_rad[0] - 0.3).abs() < 1e-12);
        assert!((mean.grasp.object_from_base.rotation.angle() - 0.4).abs() < 1e-9);
        assert_eq!(nearest_grasp(&grasps).unwrap().grasp.joints_rad, vec![0.3; 16]);
    }
}
