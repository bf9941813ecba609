//! `drex-rerun TWIN`: every stage of a finished twin folder as one recording for the Rerun viewer.
//!
//! Nothing is simulated or estimated here: what the stages of `drex run` wrote is read and placed in one world. World z is up, the
//! table is z = 0, lengths are metres. README.md lists the entities, their units and their timelines.

mod demos;
mod execution;
mod grasps;
mod hand;
mod object;
mod push;
mod recorder;
mod scan;
mod trial;
mod twin;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;
use drex_core::fsutil;

use crate::recorder::Recorder;
use crate::twin::Twin;

/// A twin folder of drex as a recording for the Rerun viewer.
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// The twin folder, or its twin.toml; `drex run` writes what is recorded.
    twin: PathBuf,
    /// Where the recording goes; TWIN/twin.rrd if left out.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<()> {
    let mut twin = Twin::open(&args.twin)?;
    let recorder = Recorder::new(&twin.folder.manifest.name)?;
    scan::record(&recorder, &mut twin)?;
    object::record(&recorder, &twin)?;
    push::record(&recorder, &mut twin)?;
    demos::record(&recorder, &mut twin)?;
    if let Some(hand) = hand::Hand::of(&mut twin)? {
        grasps::record(&recorder, &mut twin, &hand)?;
        trial::record(&recorder, &mut twin, &hand)?;
    }
    execution::record(&recorder, &mut twin)?;
    for remark in &twin.missing {
        eprintln!("not recorded: {remark}");
    }
    let bytes = recorder.finish()?;
    let out = args.out.clone().unwrap_or_else(|| twin.folder.path("twin.rrd"));
    fsutil::write_atomic(&out, &bytes)?;
    writeln!(std::io::stdout(), "{} ({:.1} MB)", out.display(), 1e-6 * bytes.len() as f64).context("standard output")
}
