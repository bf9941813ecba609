//! Says what to trust of a capture: `capture_report FOLDER`.
#![allow(clippy::print_stdout)] // the report is what it is for

use std::path::PathBuf;

use drex_core::capture::{Capture, CaptureOptions};

fn main() {
    if let Err(error) = report() {
        eprintln!("{error}");
        std::process::exit(1);
    }
}

fn report() -> drex_core::Result<()> {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        eprintln!("usage: capture_report FOLDER");
        std::process::exit(2);
    };
    let capture = Capture::load(&folder, &CaptureOptions::default())?;
    print!("{}", capture.report()?);
    println!("Extent {:.3}.", capture.extent());
    Ok(())
}
