//! Registers a folder of photos and writes COLMAP models: `register PHOTOS OUT [MASKS]`.
#![allow(clippy::print_stdout)] // an example prints
use std::path::{Path, PathBuf};

use drex_core::capture::{CaptureOptions, find_mask, photos_in};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let folder = Path::new(&args[1]);
    let mut options = CaptureOptions::default();
    options.masks = args.get(3).map(PathBuf::from);
    let (_, files) = photos_in(folder, &options).ok_or("no photos")?;
    let photo = |p: drex_core::capture::PhotoFile| drex_sfm::InputPhoto {
        mask: args.get(3).and_then(|_| find_mask(folder, &p.name, &options)),
        name: p.name,
        path: p.path,
    };
    let photos: Vec<_> = files.into_iter().map(photo).collect();
    let begun = std::time::Instant::now();
    let told = std::sync::Mutex::new("");
    let progress = |s: drex_sfm::Step| {
        let Ok(mut last) = told.lock() else { return };
        if *last != s.stage {
            *last = s.stage;
            eprintln!("{:6.1} {} of {}", begun.elapsed().as_secs_f64(), s.stage, s.total);
        }
    };
    let done = drex_sfm::register(&photos, &drex_sfm::RegisterOptions::default(), &progress)?;
    eprintln!("{:6.1} done", begun.elapsed().as_secs_f64());
    for (k, model) in done.models.iter().enumerate() {
        model.write_colmap(&Path::new(&args[2]).join(format!("sparse/{k}")))?;
    }
    let mut report = done.report;
    std::fs::write(Path::new(&args[2]).join("report.json"), serde_json::to_string_pretty(&report)?)?;
    report.photos.clear();
    println!("{}", serde_json::to_string_pretty(&report)?);
    Ok(())
}
