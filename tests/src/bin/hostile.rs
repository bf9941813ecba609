//! Writes one of the hostile files, or says how many there are; called by `tests/budgets`.
//!
//! `hostile` prints the number of cases; `hostile N FOLDER` writes case N into the folder and prints its size in bytes, its name and
//! the arguments of `drex`, divided by tabs.
#![allow(clippy::print_stdout)] // that is what it is for

use std::path::Path;
use std::process::ExitCode;

use drex_tests::hostile::{cases, write};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let cases = cases();
    let case = match &arguments[..] {
        [] => {
            println!("{}", cases.len());
            return ExitCode::SUCCESS;
        }
        [number, folder] => number.parse().ok().and_then(|n: usize| cases.get(n)).map(|make| (make(), folder)),
        _ => None,
    };
    let Some((case, folder)) = case else {
        eprintln!("usage: hostile [N FOLDER], with N from 0 to {}", cases.len() - 1);
        return ExitCode::from(2);
    };
    match write(&case, Path::new(folder)) {
        Ok(bytes) => {
            println!("{bytes}\t{}\t{}", case.name, case.command);
            ExitCode::SUCCESS
        }
        Err(e) => {
            eprintln!("{folder}: {e}");
            ExitCode::FAILURE
        }
    }
}
