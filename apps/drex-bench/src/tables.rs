//! The tables of `benches/results`: each is a command of this program, and is written with what it takes to make it again.

use std::path::Path;
use std::process::Command as Process;

use anyhow::{Context, Result, bail};
use clap::Parser as _;
use drex_core::fsutil;
use drex_trial::Engine;
use serde::Serialize;

use crate::cli::{Cli, Command, EngineArg, Output, TablesArgs};

/// Name, command and question of each table.
const TABLES: [(&str, &str, &str); 8] = [
    (
        "mass-source",
        "grasp --experiment mass-source --rollouts 100 --clips 10 --practice 60 --epochs 60",
        "What is the mass worth, of things that bear any force and of things that do not?",
    ),
    (
        "objects",
        "grasp --experiment objects --ablations --rollouts 60 --clips 10 --practice 60 --epochs 60",
        "How often do grasps hold, and what is each step of the path worth?",
    ),
    (
        "cross-mass",
        "grasp --experiment cross-mass --rollouts 100 --clips 10 --practice 60 --epochs 60",
        "What does the force for one mass do to another?",
    ),
    (
        "baselines",
        "grasp --experiment baselines --rollouts 100 --clips 10 --practice 60 --epochs 60",
        "How do other ways do that have the same hand?",
    ),
    (
        "scaling",
        "grasp --experiment scaling --rollouts 60 --clips 46 --practice 60 --epochs 60",
        "How many demonstrations does it take?",
    ),
    (
        "transfer",
        "grasp --experiment transfer --rollouts 60 --clips 10 --practice 60 --epochs 60",
        "What is worth on a smaller object what was learned on a larger one?",
    ),
    (
        "unseen-leap",
        "unseen --hand leap --count 60 --rollouts 10",
        "How do grasps hold that a network proposes for objects of categories that it has not seen, LEAP hand?",
    ),
    (
        "unseen-allegro",
        "unseen --hand allegro --count 60 --rollouts 10",
        "How do grasps hold that a network proposes for objects of categories that it has not seen, Allegro hand?",
    ),
];

/// What became of a table.
#[derive(Debug, Serialize)]
struct Made {
    name: &'static str,
    core_minutes: Option<f64>,
}

/// The hand that a command's table is of, and the table as Markdown; of a command and a seed.
pub type Make = fn(&Command, u64) -> Result<(String, String)>;

/// Makes all tables, or those that were asked for.
///
/// # Errors
/// If there is no such table, one cannot be made, or a file cannot be written.
pub fn tables(args: &TablesArgs, seed: u64, output: Output, make: Make) -> Result<()> {
    let names = TABLES.map(|t| t.0);
    if let Some(unknown) = args.only.iter().find(|only| !names.contains(&only.as_str())) {
        bail!("there is no table \"{unknown}\"; there are {}", names.join(", "));
    }
    // Before hours of rollouts whose table has no place.
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    // Before the first table changes the checkout.
    let commit = commit();
    let mut made = Vec::new();
    for (name, command, question) in TABLES {
        if !args.only.is_empty() && !args.only.iter().any(|only| only == name) {
            continue;
        }
        eprintln!("{name}: {command}");
        let engine = if args.engine == EngineArg::Mujoco { " --judge mujoco" } else { "" };
        let line = format!("drex-bench {command}{engine} --seed {seed}");
        let start = cpu_seconds();
        let command = Cli::try_parse_from(line.split_whitespace())?.command;
        let (hand, body) = make(&command, seed).with_context(|| format!("table \"{name}\""))?;
        let core_minutes = start.and_then(|start| Some((cpu_seconds()? - start) / 60.0));
        let cost = core_minutes.map_or(String::new(), |m| format!(", {m:.1} core-minutes"));
        let engine = match Engine::from(args.engine) {
            Engine::Mujoco => "MuJoCo",
            _ => "drex-diffsim",
        };
        let text =
            format!("# {question}\n\n    {line}\n\nSeed {seed}, commit {commit}, {hand}, {engine}{cost}.\n\n{body}");
        fsutil::write_atomic(&args.out.join(format!("{name}.md")), text.as_bytes())?;
        made.push(Made { name, core_minutes });
    }
    let lines = made.iter().map(|m| format!("{}.md", args.out.join(m.name).display()));
    output.answer(&made, lines.collect::<Vec<_>>().join("\n"))
}

/// The commit that is checked out where the program is run, and whether there are changes since.
fn commit() -> String {
    let asked = Process::new("git").args(["describe", "--always", "--dirty", "--abbrev=8"]).output();
    let name = asked.ok().filter(|o| o.status.success()).and_then(|o| String::from_utf8(o.stdout).ok());
    name.map_or("unknown".to_owned(), |name| name.trim().to_owned())
}

/// Processor time of this program so far, s; `None` where the system does not tell.
fn cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string(Path::new("/proc/self/stat")).ok()?;
    // After the name, which may have anything in it: field 14 and 15 of all are ticks of a hundredth second.
    let fields: Vec<&str> = stat.rsplit(')').next()?.split_whitespace().collect();
    let ticks = |k: usize| fields.get(k)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / 100.0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn every_table_is_a_command_of_this_program() {
        for (name, command, question) in TABLES {
            let line = format!("drex-bench {command} --judge mujoco --seed 7");
            let cli = Cli::try_parse_from(line.split_whitespace()).unwrap();
            assert!(cli.seed == 7 && question.ends_with('?'), "{name}");
            assert!(matches!(cli.command, Command::Grasp(_) | Command::Unseen(_)), "{name}");
        }
    }

    #[test]
    fn an_unknown_table_is_refused_with_the_names_of_those_that_there_are() {
        let out = tempfile::tempdir().unwrap();
        let (only, out) = (vec!["masses".to_owned()], out.path().to_owned());
        let args = TablesArgs { only, engine: EngineArg::Diffsim, out };
        let error = tables(&args, 0, Output { json: false }, |_, _| unreachable!()).unwrap_err().to_string();
        assert!(error.contains("mass-source") && error.contains("unseen-leap"), "{error}");
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_refused_before_anything_is_rolled_out() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let args = TablesArgs { only: Vec::new(), engine: EngineArg::Diffsim, out: file.path().to_owned() };
        let error = tables(&args, 0, Output { json: false }, |_, _| unreachable!()).unwrap_err().to_string();
        assert!(error.contains(file.path().to_str().unwrap()), "{error}");
    }

    #[test]
    fn processor_time_is_that_of_all_threads() {
        let Some(start) = cpu_seconds() else { return eprintln!("skipped: this system does not tell") };
        let busy = || (0..200_000_000_u64).fold(0, |a, b| std::hint::black_box(a ^ b));
        std::thread::scope(|s| (0..2).for_each(|_| drop(s.spawn(busy))));
        assert!(cpu_seconds().unwrap() - start > 0.05);
    }
}
