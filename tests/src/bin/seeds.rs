//! Lists the readers that are fed hostile input, or writes the seeds of one; called by `fuzz/all`.
//!
//! `seeds` prints the names; `seeds NAME FOLDER` writes the seeds of that reader into the folder.
#![allow(clippy::print_stdout)] // that is what it is for

use std::path::Path;
use std::process::ExitCode;

use drex_tests::targets::{TARGETS, find};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (name, folder) = match &arguments[..] {
        [] => {
            TARGETS.iter().for_each(|t| println!("{}", t.name));
            return ExitCode::SUCCESS;
        }
        [name, folder] => (name, Path::new(folder)),
        _ => {
            eprintln!("usage: seeds [NAME FOLDER]");
            return ExitCode::from(2);
        }
    };
    let Some(target) = find(name) else {
        eprintln!("{name} is no reader");
        return ExitCode::from(2);
    };
    let written = std::fs::create_dir_all(folder).and_then(|()| {
        (target.seeds)()
            .iter()
            .enumerate()
            .try_for_each(|(i, bytes)| std::fs::write(folder.join(format!("seed-{i}")), bytes))
    });
    if let Err(e) = written {
        eprintln!("{}: {e}", folder.display());
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}
