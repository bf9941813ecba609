//! Says what to trust of a capture: `capture_report FOLDER`. Where there are only photos, COLMAP finds their cameras.
#![allow(clippy::print_stdout)] // the report is what it is for

use std::path::PathBuf;

use drex_splat::capture::{Capture, CaptureOptions, ColmapOptions};

fn main() -> Result<(), drex_splat::Error> {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        eprintln!("usage: capture_report FOLDER");
        std::process::exit(2);
    };
    let capture =
        Capture::open(&folder, &CaptureOptions::default(), &ColmapOptions::default(), &mut |line| eprintln!("{line}"))?;
    print!("{}", capture.report()?);
    println!("extent {:.3}", capture.extent());
    Ok(())
}
