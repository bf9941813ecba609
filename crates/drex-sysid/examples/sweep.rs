//! Weighs every recording of a folder of simulated pushes and compares with their truth afterwards.
//!
//! ```text
//! cargo run --release -p drex-sysid --example sweep -- ROOT [--poses noisy|hard|clean] [--force noisy|exact] [--encoder exact|noisy|off]
//!     [--start withheld|given] [--friction given|withheld] [--free NAME]... [--fix NAME=VALUE]... [--dt SECONDS] [--seed N] [--only TEXT]... [--verbose]
//! ```
//!
//! ROOT holds `<object>/<scenario>/meta.json` with `truth.json` beside it; the truth is read after the estimate. The object is made
//! of its mesh as `drex identify` makes it, and the start pose is withheld unless it is asked for. Where `<object>/parameters.toml` states a
//! centre of mass and an inertia (of what is hollow or off-centre), they count unless `--free` says otherwise. One line per recording:
//! verdict, error of the mass, whether the interval holds the truth, half its width, seconds; then a row per kind of push. Recordings
//! run side by side, each on one thread; the seconds are those of the processor, where the system tells them.
#![allow(clippy::print_stdout)] // a program

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use drex_core::stats::normal_pair;
use drex_mesh::{AssetOptions, build_asset};
use drex_recording::convert::mujoco_push::{self, Inputs};
use drex_recording::{Drive, PushRecording};
use drex_sysid::{Identification, IdentifyOptions, Knowledge, Parameter, Verdict, identify};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde_json::Value;

type Failure = Box<dyn Error + Send + Sync>;

struct Arguments {
    root: PathBuf,
    inputs: Inputs,
    encoder: Encoder,
    start: bool,
    friction: bool,
    options: IdentifyOptions,
    only: Vec<String>,
    verbose: bool,
}

enum Encoder {
    Exact,
    Noisy,
    Off,
}

/// What one recording gave.
struct Line {
    kind: String,
    verdict: Option<Verdict>,
    /// Error of ln m, and ends of the interval of ln m about the truth.
    error: Option<f64>,
    ends: Option<[f64; 2]>,
    seconds: f64,
}

fn main() -> Result<(), Failure> {
    let arguments = read_arguments()?;
    let mut folders = recordings(&arguments.root)?;
    folders.retain(|f| {
        let name = f.display().to_string();
        arguments.only.is_empty() || arguments.only.iter().any(|o| name.contains(o))
    });
    if folders.is_empty() {
        return Err(format!("{} holds no such recording", arguments.root.display()).into());
    }
    let lines = folders.par_iter().map(|f| weigh_alone(f, &arguments)).collect::<Result<Vec<_>, _>>()?;
    table(&lines);
    Ok(())
}

fn weigh_alone(folder: &Path, arguments: &Arguments) -> Result<Line, Failure> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| weigh(folder, arguments))
}

fn weigh(folder: &Path, arguments: &Arguments) -> Result<Line, Failure> {
    let mut recording = mujoco_push::load(folder, arguments.inputs)?;
    match arguments.encoder {
        Encoder::Exact => {}
        Encoder::Noisy => add_encoder_noise(&mut recording, &arguments.options),
        Encoder::Off => recording = recording.without_encoder(),
    }
    if !arguments.start {
        recording.initial_pose = None;
    }
    if !arguments.friction {
        recording.support.friction = None;
    }
    let asset = build_asset(&recording.mesh, &AssetOptions::in_metres())?;
    let object = asset.to_exact_object("")?;
    let mut options = arguments.options.clone();
    for (parameter, value) in stated(&folder.join("../parameters.toml"))? {
        if options.parameters.get(parameter).is_none() {
            options.parameters.set(parameter, Knowledge::Fixed(value))?;
        }
    }
    let begin = cpu_seconds();
    let answer = identify(&[recording], &object, &options);
    let seconds = begin.zip(cpu_seconds()).map_or(0.0, |(a, b)| b - a);
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("truth.json"))?)?;
    let mass = truth["mass"].as_f64().ok_or("truth.json has no mass")?;
    let name = folder.strip_prefix(&arguments.root)?.display().to_string();
    let kind = name.rsplit('/').next().unwrap_or_default().to_owned();
    let answer = match answer {
        Ok(answer) => answer,
        Err(e) => {
            println!("{name:<26} refused: {e}");
            return Ok(Line { kind, verdict: None, error: None, ends: None, seconds });
        }
    };
    let about = |m: f64| (m / mass).ln();
    let error = answer.mass_kg.map(about);
    let ends = answer.ci95_kg.map(|ci| ci.map(about));
    let percent = |x: Option<f64>| x.map_or("-".into(), |x| format!("{:+.2}", 100.0 * x));
    println!(
        "{name:<26} {:<16} error {:>7} % {:<3} half {:>6} % {:.2} s {} simulations{}",
        format!("{:?}", answer.verdict),
        percent(error.map(f64::exp_m1)),
        ends.map_or("", |e| if holds(&e) { "in" } else { "OUT" }),
        percent(ends.map(half)),
        seconds,
        answer.simulations,
        if arguments.verbose { details(&answer) } else { String::new() },
    );
    Ok(Line { kind, verdict: Some(answer.verdict), error, ends, seconds })
}

/// An encoder as noisy as the options say, with velocities that are the differences of what it reads; every recording has its own noise.
fn add_encoder_noise(recording: &mut PushRecording, options: &IdentifyOptions) {
    let seed = recording.name.bytes().fold(options.seed, |s, b| s.wrapping_mul(31).wrapping_add(u64::from(b)));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let Drive::Finger(push) = &mut recording.drive else { return };
    let Some(track) = &mut push.encoder else { return };
    for position in &mut track.positions {
        for x in position.iter_mut() {
            *x += options.encoder_m * normal_pair(random.random(), std::f64::consts::TAU * random.random::<f64>())[0];
        }
    }
    let last = track.positions.len().saturating_sub(1);
    for (k, velocity) in track.velocities.iter_mut().enumerate() {
        let (before, after) = (k.saturating_sub(1), (k + 1).min(last));
        let seconds = track.times_s[after] - track.times_s[before];
        *velocity = (track.positions[after] - track.positions[before]) / seconds;
    }
}

/// The lines `name = value` of a file, if there is one.
fn stated(path: &Path) -> Result<Vec<(Parameter, f64)>, Failure> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = std::fs::read_to_string(path)?;
    let pairs = text.lines().filter(|l| !l.starts_with('#')).filter_map(|l| l.split_once('='));
    pairs.map(|(name, value)| Ok((name.trim().parse()?, value.trim().parse()?))).collect()
}

fn holds([low, high]: &[f64; 2]) -> bool {
    *low <= 0.0 && *high >= 0.0
}

fn half([low, high]: [f64; 2]) -> f64 {
    0.5 * (high - low)
}

/// Seconds that this thread has computed, where the system tells (other programs may share the core).
fn cpu_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

fn details(answer: &Identification) -> String {
    let budget = answer.error_budget.map_or(String::new(), |b| format!("{b:?}"));
    let push = answer.pushes.first();
    let fit = push.map_or(String::new(), |p| {
        format!(
            "rms {:?} mm {:?} rad, encoder {:?} mm, clock {:?}, bias {:?}, outliers {}",
            p.rms_position_m.map(|x| 1e3 * x),
            p.rms_rotation_rad,
            p.rms_encoder_m.map(|x| 1e3 * x),
            p.clock_offset_s,
            p.position_bias_m,
            p.outliers
        )
    });
    let sensitive: Vec<String> =
        answer.sensitivities.iter().map(|s| format!("{} {:+.2}", s.parameter.as_str(), s.log_mass)).collect();
    let estimates: Vec<String> =
        answer.estimates.iter().map(|e| format!("{} {:.4} (sd {:.4})", e.parameter.as_str(), e.value, e.sd)).collect();
    format!(
        "\n    {budget} friction {:?}\n    {fit}\n    {}\n    {}\n    {}",
        answer.friction,
        sensitive.join(", "),
        estimates.join(", "),
        answer.reason
    )
}

/// A row per kind of push, and one of all together.
fn table(lines: &[Line]) {
    let mut kinds: BTreeMap<&str, Vec<&Line>> = BTreeMap::new();
    for line in lines {
        kinds.entry(&line.kind).or_default().push(line);
        kinds.entry("together").or_default().push(line);
    }
    println!(
        "{:<15} {:>6} {:>10} {:>4} {:>14} {:>7} {:>10} {:>9} {:>8} {:>7}",
        "push", "number", "identified", "mu*m", "truth inside", "rms z", "median err", "worst err", "half", "s"
    );
    for (kind, lines) in kinds {
        let weighed: Vec<(f64, [f64; 2])> = lines
            .iter()
            .filter(|l| l.verdict == Some(Verdict::Identified))
            .filter_map(|l| l.error.zip(l.ends))
            .collect();
        let inside = weighed.iter().filter(|(_, ends)| holds(ends)).count();
        let n = weighed.len().max(1) as f64;
        let z = |(error, ends): &(f64, [f64; 2])| (error / (half(*ends) / 1.96)).powi(2);
        println!(
            "{kind:<15} {:>6} {:>10} {:>4} {:>6} {:>5.1} % {:>7.2} {:>8.2} % {:>7.2} % {:>6.2} % {:>7.2}",
            lines.len(),
            weighed.len(),
            lines.iter().filter(|l| l.verdict == Some(Verdict::OnlyMuM)).count(),
            inside,
            100.0 * inside as f64 / n,
            (weighed.iter().map(z).sum::<f64>() / n).sqrt(),
            100.0 * median(weighed.iter().map(|w| w.0.abs())),
            100.0 * weighed.iter().map(|w| w.0.abs()).fold(0.0, f64::max),
            100.0 * median(weighed.iter().map(|w| half(w.1))),
            median(lines.iter().map(|l| l.seconds)),
        );
    }
}

fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = numbers.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

fn read_arguments() -> Result<Arguments, Failure> {
    let mut out = Arguments {
        root: PathBuf::new(),
        inputs: Inputs::default(),
        encoder: Encoder::Exact,
        start: false,
        friction: true,
        options: IdentifyOptions::default(),
        only: Vec::new(),
        verbose: false,
    };
    let mut root = None;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or_else(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--poses" => out.inputs.poses = value()?.parse()?,
            "--force" => out.inputs.force = value()?.parse()?,
            "--encoder" => {
                out.encoder = match value()?.as_str() {
                    "exact" => Encoder::Exact,
                    "noisy" => Encoder::Noisy,
                    "off" => Encoder::Off,
                    other => return Err(format!("--encoder {other} is not understood").into()),
                }
            }
            "--start" => out.start = is_given(&arg, &value()?)?,
            "--friction" => out.friction = is_given(&arg, &value()?)?,
            "--free" => out.options.parameters.set(value()?.parse()?, Knowledge::Free)?,
            "--fix" => {
                let text = value()?;
                let (name, number) = text.split_once('=').ok_or("--fix needs NAME=VALUE")?;
                out.options.parameters.set(name.parse()?, Knowledge::Fixed(number.parse()?))?;
            }
            "--seed" => out.options.seed = value()?.parse()?,
            "--dt" => out.options.dt_s = value()?.parse()?,
            "--only" => out.only.push(value()?),
            "--verbose" => out.verbose = true,
            _ if arg.starts_with("--") => return Err(format!("{arg} is not understood").into()),
            _ => root = Some(PathBuf::from(arg)),
        }
    }
    out.root = root.ok_or("name a folder of recordings")?;
    Ok(out)
}

fn is_given(option: &str, word: &str) -> Result<bool, Failure> {
    match word {
        "given" => Ok(true),
        "withheld" => Ok(false),
        other => Err(format!("{option} {other} is not understood: given or withheld").into()),
    }
}

/// Folders two levels down that hold a `meta.json`, by name.
fn recordings(root: &Path) -> Result<Vec<PathBuf>, Failure> {
    let mut out = Vec::new();
    let objects = std::fs::read_dir(root).map_err(|e| format!("{}: {e}", root.display()))?;
    for object in objects.collect::<Result<Vec<_>, _>>()? {
        if object.path().is_dir() {
            for scenario in std::fs::read_dir(object.path())?.collect::<Result<Vec<_>, _>>()? {
                out.extend(Some(scenario.path()).filter(|p| p.join("meta.json").is_file()));
            }
        }
    }
    out.sort();
    Ok(out)
}
