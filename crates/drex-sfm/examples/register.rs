//! Registers a folder of photos and writes what `drex sfm` writes: `register PHOTOS OUT [MASKS]`.
#![allow(clippy::print_stdout)] // an example prints
use std::path::{Path, PathBuf};

use drex_core::capture::CaptureOptions;
use drex_sfm::{FolderOptions, PhotoFolder, Step, register_folder};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [photos, out, masks @ ..] = args.as_slice() else { return Err("give PHOTOS OUT [MASKS]".into()) };
    let mut options = CaptureOptions::default();
    options.masks = masks.first().cloned();
    let folder = PhotoFolder::read(photos, &options, out)?;
    let begun = std::time::Instant::now();
    let told = std::sync::Mutex::new("");
    let progress = |s: Step| {
        let Ok(mut last) = told.lock() else { return };
        if *last != s.stage {
            *last = s.stage;
            eprintln!("{:6.1} {} of {}", begun.elapsed().as_secs_f64(), s.stage, s.total);
        }
    };
    let done = register_folder(&folder, &FolderOptions::default(), &progress)?;
    eprintln!("{:6.1} done", begun.elapsed().as_secs_f64());
    done.write(Path::new(out))?;
    let mut report = done.report.registration;
    report.photos.clear();
    println!("{}", serde_json::to_string_pretty(&report)?);
    Ok(())
}
