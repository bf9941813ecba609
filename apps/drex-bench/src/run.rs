//! The commands: synthetic demonstrations, and rollouts of the policy.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::ValueEnum as _;
use drex_bench::generate::random_object;
use drex_bench::twins::{Fault, SyntheticTwin};
use drex_core::fsutil;
use drex_grasp::GraspOrigin;
use drex_policy::TrainOptions;
use drex_policy::proposal::{GraspedObject, HandCard, ProposalNetwork, ProposalOptions, train};
use drex_report::picture::clip::{self, Posed};
use drex_retarget::TargetHand;
use drex_robot::Robot;
use drex_trial::{Engine, TrialEvaluator, TrialOptions};
use drex_twin::learn::POINTS;
use drex_twin::timings::{self, Timing};
use drex_twin::with_torque_cap;
use rayon::prelude::*;
use serde::Serialize;

use crate::cli::{
    Command, Common, DemosArgs, GraspArgs, GraspDataArgs, GraspTrainArgs, ObjectsArgs, Output, TwinsArgs, UnseenArgs,
};
use crate::experiments::Bench;
use crate::library::{self, Library, LibraryOptions};
use crate::many::{self, Category, DataOptions, UnseenOptions, UnseenRow, at_rest, graspable, grasped_object, kept};
use crate::object::BenchObject;
use crate::objects::{self, ObjectSpec};
use crate::table::Table;
use crate::tables;

/// Hands that the search between opposite points looks at, for each demonstration.
const CANDIDATES_PER_CLIP: usize = 20_000;

/// Runs one of the benches.
pub fn run(command: &Command, seed: u64, output: Output) -> Result<()> {
    match command {
        Command::Demos(args) => demos(args, seed, output),
        Command::Grasp(args) => grasp(args, seed, output),
        Command::Objects(args) => random_objects(args, seed, output),
        Command::Twins(args) => twins(args, seed, output),
        Command::GraspData(args) => grasp_data(args, seed, output),
        Command::GraspTrain(args) => grasp_train(args, seed, output),
        Command::Unseen(args) => {
            let rows = unseen(args, seed)?;
            output.answer(&rows, rows.iter().map(UnseenRow::text).collect::<Vec<_>>().join("\n"))
        }
        Command::Tables(args) => tables::tables(args, seed, output, markdown),
    }
}

/// The hand that a command's table is of, and the table.
fn markdown(command: &Command, seed: u64) -> Result<(String, String)> {
    match command {
        Command::Grasp(args) => {
            let (table, robot) = grasp_table(args, seed)?;
            Ok((robot.name.clone(), table.markdown()))
        }
        Command::Unseen(args) => {
            let hand = TargetHand::resolve(&args.hand)?.robot.name;
            Ok((hand, UnseenRow::markdown(&unseen(args, seed)?)))
        }
        _ => bail!("this command makes no table"),
    }
}

/// One line of `bench objects`.
#[derive(Serialize)]
struct ObjectRow {
    object: String,
    mass_kg: f64,
    friction: f64,
    center_of_mass_m: [f64; 3],
}

fn random_objects(args: &ObjectsArgs, seed: u64, output: Output) -> Result<()> {
    let make = |number| {
        let object = random_object(seed, number, args.mass);
        object.write(&args.out).with_context(|| format!("object \"{}\"", object.name))?;
        Ok(ObjectRow {
            mass_kg: object.mass_properties.mass_kg,
            friction: object.friction,
            center_of_mass_m: object.mass_properties.center_of_mass.into(),
            object: object.name,
        })
    };
    let rows = (0..u64::from(args.count)).map(make).collect::<Result<Vec<_>>>()?;
    let line = |r: &ObjectRow| {
        let [x, y, z] = r.center_of_mass_m.map(|c| 1e3 * c);
        format!(
            "{:14} {:6.1} g  friction {:.3}  centre of mass {x:+5.1} {y:+5.1} {z:+5.1} mm",
            r.object,
            1e3 * r.mass_kg,
            r.friction
        )
    };
    output.answer(&rows, rows.iter().map(line).collect::<Vec<_>>().join("\n"))
}

/// One line of `bench twins`.
#[derive(Serialize)]
struct TwinRow {
    twin: String,
    mass_kg: f64,
    friction: f64,
    size_m: [f64; 3],
    largest_lean_rad: f64,
    fault: Option<&'static str>,
}

fn twins(args: &TwinsArgs, seed: u64, output: Output) -> Result<()> {
    let make = |twin: Result<SyntheticTwin>| {
        let twin = twin?;
        twin.write(&args.out).with_context(|| format!("twin \"{}\"", twin.name))?;
        Ok(TwinRow {
            mass_kg: twin.mass_kg,
            friction: twin.friction,
            size_m: twin.size_m,
            largest_lean_rad: twin.largest_lean_rad,
            fault: twin.fault.map(Fault::as_str),
            twin: twin.name,
        })
    };
    let whole = (0..args.count).into_par_iter().map(|number| make(SyntheticTwin::new(seed, number)));
    let broken = (0..args.broken).into_par_iter().map(|number| make(SyntheticTwin::broken(seed, number)));
    let rows = whole.chain(broken).collect::<Result<Vec<_>>>()?;
    let line = |r: &TwinRow| {
        let [x, y, z] = r.size_m.map(|s| 1e3 * s);
        format!(
            "{:10} {:5.1} g  friction {:.3}  {x:4.1} x {y:4.1} x {z:5.1} mm  leans {:4.1} degrees  {}",
            r.twin,
            1e3 * r.mass_kg,
            r.friction,
            r.largest_lean_rad.to_degrees(),
            r.fault.unwrap_or_default()
        )
        .trim_end()
        .to_owned()
    };
    output.answer(&rows, rows.iter().map(line).collect::<Vec<_>>().join("\n"))
}

/// One line of `bench grasp-data`.
#[derive(Serialize)]
struct GraspDataRow {
    object: String,
    mass_kg: f64,
    grasps: usize,
    simulated: usize,
    held: usize,
    seconds: f64,
}

fn grasp_data(args: &GraspDataArgs, seed: u64, output: Output) -> Result<()> {
    let hand = Arc::new(TargetHand::resolve(&args.hand)?.robot);
    let categories: &[Category] = if args.held_out { &Category::HELD_OUT } else { &Category::TRAINED };
    let options = DataOptions {
        pinches: args.pinches,
        powers: args.powers,
        closed: args.closed,
        climbed: args.climbed,
        simulated: args.simulated,
    };
    let mut rows = Vec::new();
    for number in args.first..args.first + args.count {
        let spec = graspable(categories, seed, number)?;
        let start = Instant::now();
        let file = fsutil::output_path(&args.out, &format!("{}.json", spec.name))?;
        let seed = seed.wrapping_add(number);
        let object = kept(&file, || grasped_object(&at_rest(&spec, seed)?, &hand, &options, seed))?;
        let row = GraspDataRow {
            mass_kg: spec.mass_kg,
            grasps: object.grasps.len(),
            simulated: object.grasps.iter().filter(|g| g.held.is_some()).count(),
            held: object.grasps.iter().filter(|g| g.held == Some(true)).count(),
            object: object.name,
            seconds: start.elapsed().as_secs_f64(),
        };
        eprintln!("{}", row.text());
        rows.push(row);
    }
    output.answer(&rows, rows.iter().map(GraspDataRow::text).collect::<Vec<_>>().join("\n"))
}

impl GraspDataRow {
    fn text(&self) -> String {
        let Self { object, mass_kg, grasps, simulated, held, seconds } = self;
        format!(
            "{object:14} {:4.0} g  {grasps:4} grasps, {held:2} of {simulated:2} held  {seconds:5.1} s",
            1e3 * mass_kg
        )
    }
}

/// The answer of `bench grasp-train`.
#[derive(Serialize)]
struct GraspTrainAnswer {
    objects: usize,
    grasps: usize,
    steps: usize,
    rates: f64,
    changes: f64,
    seconds: f64,
}

fn grasp_train(args: &GraspTrainArgs, seed: u64, output: Output) -> Result<()> {
    let robot = TargetHand::resolve(&args.hand)?.robot;
    let hand = HandCard {
        name: robot.name.clone(),
        joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
        joint_limits_rad: robot
            .joints
            .iter()
            .map(|j| j.limits.unwrap_or((-std::f64::consts::PI, std::f64::consts::PI)))
            .collect(),
    };
    let objects = grasped_objects(&args.data)?;
    let options =
        ProposalOptions { prototypes: args.prototypes, steps: args.steps, seed, ..ProposalOptions::default() };
    let start = Instant::now();
    let mut last = None;
    let network = train(&objects, hand, &options, &mut |progress| {
        eprintln!("step {:6}: rates {:8.4}, changes {:.4}", progress.step, progress.rates, progress.changes);
        last = Some(progress);
        ControlFlow::Continue(())
    })?;
    network.save(&args.out)?;
    let answer = GraspTrainAnswer {
        objects: objects.len(),
        grasps: objects.iter().map(|o| o.grasps.len()).sum(),
        steps: args.steps,
        rates: last.map_or(f64::NAN, |p| p.rates),
        changes: last.map_or(f64::NAN, |p| p.changes),
        seconds: start.elapsed().as_secs_f64(),
    };
    let text = format!(
        "{} grasps of {} objects, {} steps in {:.0} s",
        answer.grasps, answer.objects, answer.steps, answer.seconds
    );
    output.answer(&answer, text)
}

/// The files of a folder of `grasp-data`, by name.
fn grasped_objects(folder: &Path) -> Result<Vec<GraspedObject>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("{}", folder.display()))?;
    let mut files: Vec<_> = entries.map(|e| Ok(e?.path())).collect::<Result<_>>()?;
    files.retain(|f| f.extension().is_some_and(|e| e == "json"));
    files.sort();
    let read = |file: &std::path::PathBuf| -> Result<GraspedObject> {
        serde_json::from_str(&fsutil::read_text(file)?).with_context(|| format!("{}", file.display()))
    };
    files.iter().map(read).collect()
}

/// The rows of `bench unseen`.
fn unseen(args: &UnseenArgs, seed: u64) -> Result<Vec<UnseenRow>> {
    let hand = Arc::new(TargetHand::resolve(&args.hand)?.robot);
    let network = match &args.network {
        Some(file) => ProposalNetwork::load(file)?,
        None => ProposalNetwork::bundled(&hand.name).with_context(|| {
            format!("no network ships for {}: train one (grasp-train) and give it (--network)", hand.name)
        })?,
    };
    let &UnseenArgs { first, count, rollouts, search, engine, .. } = args;
    let options = UnseenOptions { first, count, rollouts: rollouts as usize, search, engine: engine.into(), seed };
    many::unseen(&network, &hand, &options, &|line| eprintln!("{line}"))
}

/// One line of `bench demos`.
#[derive(Serialize)]
struct DemosRow {
    object: String,
    mass_kg: f64,
    size_mm: [f64; 3],
    grasps: usize,
    retargeted: usize,
    clips_that_hold: usize,
    wrapped: usize,
    /// Median of the minimum grip force at rest in units of the weight.
    #[serde(rename = "median_squeeze_per_weight")]
    median_grip_force_per_weight: f64,
    seconds: f64,
}

fn demos(args: &DemosArgs, seed: u64, output: Output) -> Result<()> {
    let hand = TargetHand::resolve(&args.common.hand)?;
    let options = library_options(&args.common, seed);
    let mut rows = Vec::new();
    for spec in specs(&args.common)? {
        let object = BenchObject::new(&spec)?;
        let start = Instant::now();
        let file = library::file(args.common.out.as_deref(), &spec.name)?;
        let library = Library::of(&object, &hand, &options, file.as_deref())?;
        if let Some(out) = args.common.out.as_deref().filter(|_| args.pictures > 0) {
            pictures(
                &fsutil::output_path(out, &format!("grasps/{}.png", spec.name))?,
                &object,
                &hand,
                &library,
                args.pictures,
            )?;
        }
        rows.push(row(&object, &library, start.elapsed().as_secs_f64()));
        if let Some(r) = rows.last() {
            eprintln!("{}", text(r));
        }
    }
    let lines: Vec<String> = rows.iter().map(text).collect();
    output.answer(&rows, lines.join("\n"))
}

fn row(object: &BenchObject, library: &Library, seconds: f64) -> DemosRow {
    let of = |kind: GraspOrigin| library.grasps.iter().filter(move |g| g.origin == kind);
    let mut clips: Vec<usize> = of(GraspOrigin::Retargeted).map(|g| g.source).collect();
    clips.dedup();
    let weight_n = object.object.mass_kg() * object.object.table().gravity().norm();
    let mut grip_forces: Vec<f64> =
        library.grasps.iter().map(|g| g.grip_force_n.unwrap_or(f64::INFINITY) / weight_n).collect();
    grip_forces.sort_by(f64::total_cmp);
    DemosRow {
        object: object.spec.name.clone(),
        mass_kg: object.spec.mass_kg,
        size_mm: object.size_m.map(|v| 1e3 * v),
        grasps: library.grasps.len(),
        retargeted: of(GraspOrigin::Retargeted).count(),
        clips_that_hold: clips.len(),
        wrapped: of(GraspOrigin::Power).count(),
        median_grip_force_per_weight: grip_forces[grip_forces.len() / 2],
        seconds,
    }
}

fn text(r: &DemosRow) -> String {
    let [x, y, z] = r.size_mm;
    format!(
        "{:18} {:4.0} g  {x:4.0} x {y:4.0} x {z:4.0} mm  {:4} grasps: {:3} of people ({:2} demonstrations), {:3} wrapped; grip force {:4.1} weights; {:5.1} s",
        r.object,
        1e3 * r.mass_kg,
        r.grasps,
        r.retargeted,
        r.clips_that_hold,
        r.wrapped,
        r.median_grip_force_per_weight,
        r.seconds
    )
}

/// The objects that were asked for.
fn specs(common: &Common) -> Result<Vec<ObjectSpec>> {
    let mut all = match &common.objects {
        Some(file) => objects::read(file)?,
        None if common.only.is_empty() => objects::eight()?,
        None => return common.only.iter().map(|n| objects::named(n)).collect(),
    };
    if let Some(missing) = common.only.iter().find(|n| all.iter().all(|o| o.name != **n)) {
        let names: Vec<&str> = all.iter().map(|o| o.name.as_str()).collect();
        bail!("there is no object \"{missing}\" in the list; it has {}", names.join(", "));
    }
    all.retain(|o| common.only.is_empty() || common.only.contains(&o.name));
    Ok(all)
}

fn library_options(common: &Common, seed: u64) -> LibraryOptions {
    let mut options = LibraryOptions::default();
    options.demonstrations.clips = common.clips as usize;
    options.candidates = CANDIDATES_PER_CLIP * options.demonstrations.clips;
    options.demonstrations.seed = seed;
    options
}

/// A contact sheet of grasps spread over the library.
fn pictures(file: &Path, object: &BenchObject, hand: &TargetHand, library: &Library, count: usize) -> Result<()> {
    let step = library.grasps.len().div_ceil(count).max(1);
    let posed = library.grasps.iter().enumerate().step_by(step).map(|(i, g)| Posed {
        frame: i,
        q: &g.joints_rad,
        world_from_base: object.object.world_from_object * g.object_from_base,
        world_from_object: Some(object.object.world_from_object),
    });
    let posed: Vec<Posed<'_>> = posed.collect();
    clip::write(file, &hand.robot, Some(&object.object.mesh), &posed, 1).context("cannot draw the grasps")
}

/// What `bench grasp` answers.
#[derive(Serialize)]
struct BenchAnswer<'a> {
    experiment: &'a str,
    hand: &'a str,
    judge: Engine,
    rollouts: u32,
    seed: u64,
    /// Largest torque of each joint, model order, N m.
    torque_limits_nm: Vec<f64>,
    margin: f64,
    #[serde(flatten)]
    table: &'a Table,
}

/// The same with its cost, on stdout alone: the file is the same in every run.
#[derive(Serialize)]
struct Timed<'a> {
    #[serde(flatten)]
    answer: BenchAnswer<'a>,
    /// Rollouts of the table per second of judging, plans and rehearsals with them.
    rollouts_per_s: f64,
    threads: usize,
    seconds: f64,
}

/// The table of `bench grasp`, and the hand that it is of.
fn grasp_table(args: &GraspArgs, seed: u64) -> Result<(Table, Arc<Robot>)> {
    let common = &args.common;
    let mut hand = TargetHand::resolve(&common.hand)?;
    // Before minutes of practice.
    hand.robot = with_torque_cap(hand.robot, common.torque_cap)?;
    let given = match common.objects.is_some() || !common.only.is_empty() {
        true => Some(specs(common)?),
        false => None,
    };
    let engine = Engine::from(args.engine);
    engine.check()?;
    let robot = Arc::new(hand.robot.clone());
    let mut options = TrialOptions::default();
    options.law = options.law.with_margin(args.margin);
    let mut train = TrainOptions::default().with_seed(seed).with_points(POINTS);
    train.epochs = args.epochs.unwrap_or(train.epochs);
    let bench = Bench {
        hand: &hand,
        robot: robot.clone(),
        evaluator: &|object: &BenchObject| Ok(TrialEvaluator::new(&object.object, &robot, &options, engine)?),
        rollouts: args.rollouts as usize,
        seed,
        library: library_options(common, seed),
        train,
        simulated: args.practice as usize,
        compare: args.compare,
        ablations: args.ablations,
        shake_m_s2: options.shake_m_s2,
        out: common.out.clone(),
        note: &|text| eprintln!("{text}"),
    };
    Ok((bench.run(args.experiment, given.as_deref())?, robot))
}

fn grasp(args: &GraspArgs, seed: u64, output: Output) -> Result<()> {
    let start = Instant::now();
    let experiment = args.experiment.to_possible_value().context("the experiment has no name")?;
    let (name, common) = (experiment.get_name(), &args.common);
    let (table, robot) = grasp_table(args, seed)?;
    if let Some(out) = &common.out {
        table.write(out, name)?;
    }
    let answer = BenchAnswer {
        experiment: name,
        hand: &robot.name,
        judge: args.engine.into(),
        rollouts: args.rollouts,
        seed,
        torque_limits_nm: robot.effort_limits()?,
        margin: args.margin,
        table: &table,
    };
    let seconds = start.elapsed().as_secs_f64();
    if let Some(out) = &common.out {
        fsutil::write_atomic(&out.join(format!("{name}.json")), &serde_json::to_vec_pretty(&answer)?)?;
        timings::record(out, name, Timing::of(seconds))?;
    }
    let threads = rayon::current_num_threads();
    let answer = Timed { answer, rollouts_per_s: table.rollouts_per_s(), threads, seconds };
    let speed = format!("{:.1} rollouts per second on {} threads", answer.rollouts_per_s, answer.threads);
    output.answer(&answer, format!("{}\n{speed}", table.text()))
}
