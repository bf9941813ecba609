//! Says what to trust of a capture: `capture_report FOLDER`. Where there are only photos, COLMAP finds their cameras; with
//! `capture_report FOLDER VIDEO` the photos are frames of a video first.
#![allow(clippy::print_stdout)] // the report is what it is for

use std::path::PathBuf;

use drex_splat::capture::{Capture, CaptureOptions, ColmapOptions, VideoOptions, extract_frames};

fn main() {
    if let Err(error) = report() {
        eprintln!("{error}");
        std::process::exit(1);
    }
}

fn report() -> drex_splat::Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let Some(folder) = arguments.next() else {
        eprintln!("usage: capture_report FOLDER [VIDEO]");
        std::process::exit(2);
    };
    let progress = &mut |line: &str| eprintln!("{line}");
    if let Some(video) = arguments.next() {
        let frames = extract_frames(&video, &folder, &VideoOptions::default(), progress)?;
        println!("{frames} frames.");
    }
    let capture = Capture::open(&folder, &CaptureOptions::default(), &ColmapOptions::default(), progress)?;
    print!("{}", capture.report()?);
    println!("Extent {:.3}.", capture.extent());
    Ok(())
}
