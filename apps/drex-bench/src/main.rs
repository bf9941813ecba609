//! `drex-bench`: objects, synthetic demonstrations and experiments that say how well drex grasps.
#![allow(missing_docs)] // a program has no public items

mod cell;
mod cli;
mod configurations;
mod demonstrations;
mod experiments;
#[cfg(test)]
#[path = "../../../crates/drex-trial/tests/doubles/formula.rs"]
mod formula;
mod library;
mod many;
mod object;
mod objects;
mod run;
mod shapes;
mod table;
mod tables;

use std::process::ExitCode;

use clap::Parser as _;
use tracing_subscriber::filter::LevelFilter;

use crate::cli::{Cli, Output};

fn main() -> ExitCode {
    let cli = Cli::parse();
    let level = if cli.verbose { LevelFilter::INFO } else { LevelFilter::WARN };
    tracing_subscriber::fmt()
        .with_max_level(level)
        .with_target(false)
        .without_time()
        .with_writer(std::io::stderr)
        .init();
    let threads = cli.threads.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().map_err(anyhow::Error::from);
    match pool.and_then(|()| run::run(&cli.command, cli.seed, Output { json: cli.json })) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
