//! Weighs every recording of a folder of simulated pushes and compares with their truth afterwards.
//!
//! ```text
//! cargo run --release -p drex-sysid --example sweep -- ROOT [--poses noisy|hard|clean] [--force noisy|exact] [--encoder on|off]
//!     [--free NAME]... [--fix NAME=VALUE]... [--dt SECONDS] [--only TEXT]... [--verbose]
//! ```
//!
//! ROOT holds `<object>/<scenario>/meta.json` with `truth.json` beside it; the truth is read after the estimate. One line
//! per recording: verdict, error of the mass, whether the interval holds the truth, half its width, the bound on that, seconds; then
//! a summary. Runs on one thread; the seconds are those of the processor, where the system tells them.
#![allow(clippy::print_stdout)] // a program

use std::error::Error;
use std::path::{Path, PathBuf};

use drex_core::TriMesh;
use drex_recording::convert::mujoco_push::{self, Inputs, PoseQuality};
use drex_sysid::{Identification, IdentifyOptions, Knowledge, ObjectModel, Parameter, Verdict, identify};
use serde_json::Value;

type Failure = Box<dyn Error + Send + Sync>;

struct Arguments {
    root: PathBuf,
    inputs: Inputs,
    encoder: bool,
    options: IdentifyOptions,
    only: Vec<String>,
    verbose: bool,
}

/// What one recording gave.
struct Line {
    identified: bool,
    /// Whether a number that was given is covered by its interval.
    covered: Option<bool>,
    error: Option<f64>,
    /// What the recording was expected to show, and whether it did.
    good: bool,
    narrow: bool,
    seconds: f64,
    scenario: String,
}

fn main() -> Result<(), Failure> {
    let arguments = read_arguments()?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut lines = Vec::new();
    for folder in recordings(&arguments.root)? {
        let name = folder.strip_prefix(&arguments.root)?.display().to_string();
        if !arguments.only.is_empty() && !arguments.only.iter().any(|o| name.contains(o)) {
            continue;
        }
        lines.push(pool.install(|| weigh(&folder, &name, &arguments))?);
    }
    summary(&lines);
    Ok(())
}

fn weigh(folder: &Path, name: &str, arguments: &Arguments) -> Result<Line, Failure> {
    let recording = mujoco_push::load(folder, arguments.inputs)?;
    let recording = if arguments.encoder { recording } else { recording.without_encoder() };
    let object = ObjectModel::from_mesh(&TriMesh::read(&recording.mesh)?)?;
    let begin = cpu_seconds();
    let answer = identify(&[recording], &object, &arguments.options)?;
    let seconds = begin.zip(cpu_seconds()).map_or(answer.seconds, |(a, b)| b - a);
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("truth.json"))?)?;
    let number = |key: &str| truth[key].as_f64();
    let mass = number("mass").ok_or("truth.json has no mass")?;
    let mu = number("mu").ok_or("truth.json has no mu")?;
    let scenario = name.rsplit('/').next().unwrap_or_default().to_owned();
    let finger = scenario.starts_with("finger");
    let with_encoder = finger && arguments.encoder;
    let expect = truth[if with_encoder { "expect_encoder" } else { "expect" }].as_str().unwrap_or_default().to_owned();
    let friction = if arguments.options.parameters.get(Parameter::Friction).is_some() { "free" } else { "known" };
    let crb = number(&format!("crb_rel_sd_mass_{}mu_{friction}", if with_encoder { "encoder_" } else { "" }));

    let error = answer.mass_kg.map(|m| m / mass - 1.0);
    let holds = answer.ci95_kg.map(|ci| ci[0] <= mass && mass <= ci[1]);
    let half = answer.ci95_kg.zip(answer.mass_kg).map(|(ci, m)| 0.5 * (ci[1] - ci[0]) / m);
    let allowed = allowed_error(&scenario, arguments);
    let widest = (8.0 * crb.unwrap_or(f64::INFINITY)).max(allowed.unwrap_or(0.0));
    let spans = answer.ci95_kg.map(|ci| ci[1] / ci[0]);
    let product = answer.mu_m_kg.map(|p| p / (mu * mass) - 1.0);
    let identified = answer.verdict == Verdict::Identified;
    let honest = holds == Some(true);
    let good = match (expect.as_str(), answer.verdict) {
        ("none", Verdict::NotIdentifiable) => true,
        ("none", Verdict::Identified) => honest && spans.is_some_and(|s| s >= 1.5),
        ("mu*m", Verdict::OnlyMuM) => product.is_some_and(|p| p.abs() <= 0.05),
        (_, Verdict::Identified) => match (allowed, error) {
            (Some(allowed), Some(error)) => error.abs() <= allowed,
            _ => honest,
        },
        // A weak recording may be called too weak.
        ("m_weak" | "mu*m", Verdict::NotIdentifiable | Verdict::OnlyMuM) => true,
        _ => false,
    };
    let percent = |x: Option<f64>| x.map_or("-".into(), |x| format!("{:+.2}", 100.0 * x));
    println!(
        "{name:<26} {expect:<7} {:<16} error {:>7} % {:<3} half {:>6} of {:>6} %{} {} {:.2} s{}",
        format!("{:?}", answer.verdict),
        percent(error),
        holds.map_or("", |h| if h { "in" } else { "OUT" }),
        half.map_or("-".into(), |h| format!("{:.2}", 100.0 * h)),
        format!("{:.2}", 100.0 * widest),
        product.map_or(String::new(), |p| format!(" mu*m {:+.2} %", 100.0 * p)),
        if good { "good" } else { "BAD" },
        seconds,
        if arguments.verbose { details(&answer) } else { String::new() },
    );
    let narrow = half.is_none_or(|h| h <= widest);
    Ok(Line { identified, covered: holds, error, good, narrow, seconds, scenario })
}

/// Seconds that this thread has computed, where the system tells (other programs may share the core).
fn cpu_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

/// The largest error of a mass that counts as weighed, by the kind of push and the quality of its inputs.
fn allowed_error(scenario: &str, arguments: &Arguments) -> Option<f64> {
    let hard = arguments.inputs.poses == PoseQuality::Hard;
    match scenario {
        "lift_force" | "tilt_force" | "overhang_press" => Some(if hard { 0.04 } else { 0.02 }),
        "slide_force" => Some(0.05),
        "finger_fast" | "finger_tilt" if arguments.encoder => Some(0.05),
        _ => None,
    }
}

fn details(answer: &Identification) -> String {
    let budget = answer.error_budget.map_or(String::new(), |b| format!("{b:?}"));
    let push = answer.pushes.first();
    let fit = push.map_or(String::new(), |p| {
        format!(
            "closed form {:?}; rms {:?} mm {:?} rad, encoder {:?} mm, clock {:?}, bias {:?}, outliers {}",
            p.closed_form.map(|c| (c.kind, c.mass_kg, c.sd_log_mass)),
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
    format!(
        "\n    {budget} friction {:?}\n    {fit}\n    {}\n    {}",
        answer.friction,
        sensitive.join(", "),
        answer.reason
    )
}

fn summary(lines: &[Line]) {
    let mut seconds: Vec<f64> = lines.iter().map(|l| l.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    let (median, slowest) = (seconds.get(seconds.len() / 2), seconds.last());
    let identified: Vec<&Line> = lines.iter().filter(|l| l.identified).collect();
    let covered = identified.iter().filter(|l| l.covered == Some(true)).count();
    println!(
        "{} recordings, {} as expected; {} identified, interval holds the truth in {covered}, too wide in {}; seconds: median {:.2}, largest {:.2}",
        lines.len(),
        lines.iter().filter(|l| l.good).count(),
        identified.len(),
        lines.iter().filter(|l| !l.narrow).count(),
        median.copied().unwrap_or(0.0),
        slowest.copied().unwrap_or(0.0),
    );
    let mut scenarios: Vec<&str> = lines.iter().map(|l| l.scenario.as_str()).collect();
    scenarios.sort_unstable();
    scenarios.dedup();
    for scenario in scenarios {
        let of: Vec<&&Line> = identified.iter().filter(|l| l.scenario == scenario).collect();
        let all: Vec<&Line> = lines.iter().filter(|l| l.scenario == scenario).collect();
        let worst = of.iter().filter_map(|l| l.error).fold(0.0_f64, |a, e| if e.abs() > a.abs() { e } else { a });
        let covered = of.iter().filter(|l| l.covered == Some(true)).count();
        println!(
            "  {scenario:<15} {} of {} as expected, {} identified, worst error {:+.2} %, covered {covered}, mean {:.2} s",
            all.iter().filter(|l| l.good).count(),
            all.len(),
            of.len(),
            100.0 * worst,
            all.iter().map(|l| l.seconds).sum::<f64>() / all.len() as f64,
        );
    }
}

fn read_arguments() -> Result<Arguments, Failure> {
    let mut out = Arguments {
        root: PathBuf::new(),
        inputs: Inputs::default(),
        encoder: true,
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
            "--encoder" => out.encoder = value()? == "on",
            "--free" => out.options.parameters.set(value()?.parse()?, Knowledge::Free)?,
            "--fix" => {
                let text = value()?;
                let (name, number) = text.split_once('=').ok_or("--fix needs NAME=VALUE")?;
                out.options.parameters.set(name.parse()?, Knowledge::Fixed(number.parse()?))?;
            }
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

/// Folders two levels down that hold a `meta.json`, by name.
fn recordings(root: &Path) -> Result<Vec<PathBuf>, Failure> {
    let mut out = Vec::new();
    for object in std::fs::read_dir(root)?.collect::<Result<Vec<_>, _>>()? {
        if object.path().is_dir() {
            for scenario in std::fs::read_dir(object.path())?.collect::<Result<Vec<_>, _>>()? {
                out.extend(Some(scenario.path()).filter(|p| p.join("meta.json").is_file()));
            }
        }
    }
    out.sort();
    Ok(out)
}
