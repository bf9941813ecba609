//! Trains one set on a capture and prints the scores on the photos held out, with what it cost:
//! `train FOLDER [--side N] [--iterations N] [--hold-out N] [--mcmc] [--surfels] [--masks] [--max N] [--set JSON] [--out PLY]`.
//! `--set` changes training options: `--set '{"rates":{"opacity":0.1}}'`.
#![allow(clippy::print_stdout)]

use std::path::{Path, PathBuf};

use drex_core::capture::{Capture, CaptureOptions, PhotoOptions, Photos};
use drex_splat::io::ply;
use drex_splat::loss::MaskMode;
use drex_splat::metrics::{Table, similarity};
use drex_splat::raster::Cpu;
use drex_splat::train::{DensityChoice, Preset, TrainOptions, Trainer, from_points};
use drex_splat::{Kind, usage};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| arguments.iter().position(|a| a == name).and_then(|i| arguments.get(i + 1));
    let flag = |name: &str| arguments.iter().any(|a| a == name);
    let folder = arguments.first().ok_or("give a capture's folder")?;

    let capture = Capture::load(Path::new(folder), &CaptureOptions::default())?;
    let mut photo_options = PhotoOptions::default();
    photo_options.max_side = value("--side").map(|v| v.parse()).transpose()?;
    let photos = Photos::new(&capture, photo_options)?;
    let kind = if flag("--surfels") { Kind::Surfel } else { Kind::Ellipsoid };
    let density = if flag("--mcmc") { DensityChoice::Mcmc } else { DensityChoice::Adaptive };
    let mut options = Preset::Fast.train_options(kind, density, capture.points.len());
    if let Some(n) = value("--iterations") {
        options.iterations = n.parse()?;
    }
    if let Some(n) = value("--max") {
        options.max_gaussians = n.parse()?;
    }
    if flag("--masks") {
        options.masks = MaskMode::Transparent;
        options.background = None;
    }
    if let Some(changes) = value("--set") {
        let mut whole = serde_json::to_value(&options)?;
        merge(&mut whole, &serde_json::from_str(changes)?);
        options = serde_json::from_value::<TrainOptions>(whole)?;
    }

    let hold_out: usize = value("--hold-out").map_or(Ok(8), |v| v.parse())?;
    let (held_out, trained): (Vec<usize>, Vec<usize>) = (0..photos.len()).partition(|i| i % hold_out == 0);
    let (points, colours): (Vec<_>, Vec<_>) = capture.points.iter().map(|p| (p.position, p.rgb)).unzip();
    let opacity = if flag("--mcmc") { 0.5 } else { 0.1 };
    let first = from_points(&points, &colours, kind, options.sh_degree, opacity);
    // Photos are read before the clock starts: the figures are those of training.
    for i in 0..photos.len() {
        photos.get(i)?;
    }
    let start = usage::core_seconds().unwrap_or(f64::NAN);
    let masked = options.masks != MaskMode::Off;
    let mut trainer = Trainer::new(&photos, trained, Cpu, first, capture.extent(), options)?;
    let score = |trainer: &Trainer<'_, Photos, Cpu>| -> drex_splat::Result<Table> {
        let mut table = Table::default();
        for &i in &held_out {
            let photo = photos.get(i)?;
            let render = trainer.render(&photo.camera, [0.0; 3])?;
            let mask = photo.mask.as_deref().filter(|_| masked);
            table.push(
                &capture.views[i].name,
                similarity(&render.rgb, &photo.rgb, mask, render.width, render.height)?,
                0,
            );
        }
        Ok(table)
    };
    let mut measuring = 0.0;
    let mut psnr = 0.0;
    while !trainer.is_done() {
        let progress = trainer.step()?;
        psnr += progress.psnr;
        let every = (trainer.options().iterations / 8).max(1);
        if progress.step % every == 0 {
            let now = usage::core_seconds().unwrap_or(f64::NAN);
            let mean = score(&trainer)?.mean().map(|m| m.similarity);
            let (held, ssim) = mean.map_or((f64::NAN, f64::NAN), |m| (m.psnr, m.ssim));
            let cost = now - start - measuring;
            measuring += usage::core_seconds().unwrap_or(f64::NAN) - now;
            println!(
                "step {:6}  {cost:7.1} core s  {:5.1} it/s  {:7} Gaussians  trained {:5.2} dB  held out {held:5.2} dB, SSIM {ssim:.4}",
                progress.step,
                f64::from(progress.step) / cost,
                progress.gaussians,
                psnr / f64::from(every),
            );
            psnr = 0.0;
        }
    }
    println!("{}", score(&trainer)?);
    if let Some(path) = value("--out") {
        ply::write(&PathBuf::from(path), trainer.gaussians())?;
    }
    Ok(())
}

/// Writes the entries of `changes` over those of `whole`.
fn merge(whole: &mut serde_json::Value, changes: &serde_json::Value) {
    match (whole, changes) {
        (serde_json::Value::Object(whole), serde_json::Value::Object(changes)) => {
            for (key, value) in changes {
                merge(whole.entry(key.clone()).or_insert(serde_json::Value::Null), value);
            }
        }
        (whole, changes) => *whole = changes.clone(),
    }
}
