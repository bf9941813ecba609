//! `drex`: from a scan, a recorded push and human grasps to a weighed digital twin and a grasp with the right force.

mod cli;
mod commands;
mod limits;
mod ui;

use std::process::ExitCode;

use clap::FromArgMatches;

use crate::cli::{Cli, Command};
use crate::ui::Ui;
use drex_twin::{Error, Stage};

/// Exit status where another process works on the folder: EX_TEMPFAIL, after which schedulers try again.
const BUSY: u8 = 75;

fn main() -> ExitCode {
    let cli = match Cli::from_arg_matches(&cli::command().get_matches()) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    let ui = Ui::new(cli.common.json, cli.common.verbose);
    match run(&cli, &ui) {
        Ok(status) => status,
        Err(error) => {
            ui.failed(&error);
            if is_busy(&error) { ExitCode::from(BUSY) } else { ExitCode::FAILURE }
        }
    }
}

fn run(cli: &Cli, ui: &Ui) -> anyhow::Result<ExitCode> {
    if let Some(threads) = cli.common.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
    }
    limits::watch(&cli.command, &cli.common, ui)?;
    let seed = cli.common.seed;
    match &cli.command {
        Command::Sfm(args) => commands::sfm::run(args, seed, ui),
        Command::Masks(args) => commands::masks::run(args, seed, ui),
        Command::Reconstruct(args) => commands::reconstruct::run(args, seed, ui),
        Command::Asset(args) => commands::asset::run(args, seed, ui),
        Command::Mesh(command) => commands::mesh::run(command, ui),
        Command::Identify(args) => commands::identify::run(args, seed, ui),
        Command::PlanPush(args) => commands::plan_push::run(args, ui),
        Command::CalibrateHand(args) => commands::calibrate_hand::run(args, ui),
        Command::Render(args) => commands::render::run(args, ui),
        Command::Hands(args) => commands::hands::run(args, ui),
        Command::Retarget(args) => commands::retarget::run(args, seed, ui),
        Command::Train(args) => commands::run::run(args, Stage::Train, false, seed, ui),
        Command::Evaluate(args) => commands::run::run(args, Stage::Evaluate, false, seed, ui),
        Command::Run(args) => commands::run::run(args, Stage::Report, false, seed, ui),
        Command::Report(args) => commands::run::run(args, Stage::Report, true, seed, ui),
        Command::Batch(args) => return commands::batch::run(args, &cli.common, ui),
        Command::Demo(args) => commands::demo::run(args, seed, ui),
        Command::Import(args) => commands::import::run(args, ui),
        Command::Grasp(args) => commands::grasp::run(args, seed, ui),
        Command::Deploy(args) => commands::deploy::run(args, seed, ui),
        Command::Hw(command) => commands::hw::run(command, ui),
        Command::Doctor => commands::doctor::run(ui),
        Command::Completions { shell } => commands::shell::completions(*shell, ui),
        Command::Man(args) => commands::shell::man(args, ui),
    }?;
    Ok(ExitCode::SUCCESS)
}

/// Whether the command failed because another process works on the folder.
fn is_busy(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        // `Error::While` keeps its cause in a box.
        let boxed = cause.downcast_ref::<Box<Error>>().map(AsRef::as_ref);
        matches!(boxed.or_else(|| cause.downcast_ref()), Some(Error::Busy { .. }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_busy_folder_is_found_whatever_was_being_done() {
        let busy = || Error::Busy { folder: "tin".into(), who: "process 1".into() };
        let inside = || Error::While { doing: "object 3".into(), source: Box::new(busy()) };
        for error in [anyhow::Error::new(busy()), anyhow::Error::new(inside()).context("the batch")] {
            assert!(is_busy(&error), "{error:?}");
        }
        assert!(!is_busy(&anyhow::Error::new(Error::Stopped).context("another drex is at work")));
    }
}
