//! Renders a capture with exactly known cameras: photos, masks, and the truth beside them.
//!
//! ```text
//! cargo run --release -p drex-sfm --example make_capture -- --kind orbit --seed 7 --out DIR
//!     [--photos N] [--size WxH] [--no-exif] [--masks-truth DIR]
//! ```
//! Kinds: orbit, echo, turntable, video, plain, spin, blur, few, apart, two, gloss, repeat.
//! `DIR/images` holds the photos, `DIR/masks/NAME.jpg.png` the masks that belong to a kind, `DIR/truth` (`truth_a` and
//! `truth_b` for two) the cameras in COLMAP's text layout and the solids of the object as `object.json`.
//! `--masks-truth` writes the object's exact silhouettes for every kind.
#![allow(clippy::print_stdout)] // an example talks to a person

mod capture;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use capture::Outcome;
use capture::kinds::{Capture, Kind, Size, plan};
use capture::render::Shot;
use capture::write;
use rayon::prelude::*;

struct Arguments {
    kind: Kind,
    seed: u64,
    out: PathBuf,
    size: Size,
    exif: bool,
    masks_truth: Option<PathBuf>,
}

fn main() -> Outcome<()> {
    let arguments = arguments()?;
    let start = Instant::now();
    let mut capture = plan(arguments.kind, arguments.seed, &arguments.size)?;
    if !arguments.exif {
        capture.exif = None;
    }
    println!("{} scenes painted in {:.1} s", capture.scenes.len(), start.elapsed().as_secs_f64());
    write_truth(&arguments, &capture)?;
    let images = arguments.out.join("images");
    std::fs::create_dir_all(&images)?;
    let mut mask_folders: Vec<PathBuf> = arguments.masks_truth.iter().cloned().collect();
    if capture.with_masks {
        mask_folders.push(arguments.out.join("masks"));
    }
    for folder in &mask_folders {
        std::fs::create_dir_all(folder)?;
    }
    (0..capture.shots.len()).into_par_iter().try_for_each(|i| take(&capture, i, &images, &mask_folders))?;
    println!("{} photos in {:.1} s: {}", capture.shots.len(), start.elapsed().as_secs_f64(), arguments.out.display());
    if arguments.kind == Kind::Video {
        film(&arguments.out);
    }
    Ok(())
}

fn take(capture: &Capture, i: usize, images: &Path, mask_folders: &[PathBuf]) -> Outcome<()> {
    let photo = capture.take(i);
    let name = &capture.shots[i].1.name;
    std::fs::write(images.join(name), write::jpeg(&photo.rgb, capture.sensor.jpeg_quality, capture.exif.as_ref())?)?;
    for folder in mask_folders {
        photo.mask.save(folder.join(format!("{name}.png")))?;
    }
    Ok(())
}

fn write_truth(arguments: &Arguments, capture: &Capture) -> Outcome<()> {
    let folders: &[&str] = match arguments.kind {
        Kind::Apart => &[],
        Kind::Two => &["truth_a", "truth_b"],
        _ => &["truth"],
    };
    for (scene, folder) in folders.iter().enumerate() {
        let folder = arguments.out.join(folder);
        let shots: Vec<&Shot> = capture.shots.iter().filter(|(s, _)| *s == scene).map(|(_, shot)| shot).collect();
        write::truth(&folder, &capture.lens.camera, &shots)?;
        let object = write::object(&capture.scenes[scene], capture.floor_m);
        std::fs::write(folder.join("object.json"), object.to_string())?;
    }
    if let Some(marker) = &capture.marker {
        let text = serde_json::to_string_pretty(&write::marker(marker))?;
        std::fs::write(arguments.out.join("marker.json"), text)?;
    }
    Ok(())
}

/// Makes `video.mp4` of the frames where ffmpeg is installed.
fn film(out: &Path) {
    let status = Command::new("ffmpeg")
        .args(["-loglevel", "error", "-y", "-framerate", "24", "-i"])
        .arg(out.join("images/frame_%04d.jpg"))
        .args(["-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p"])
        .arg(out.join("video.mp4"))
        .status();
    match status {
        Ok(s) if s.success() => println!("video.mp4 written"),
        Ok(s) => println!("no video.mp4: ffmpeg failed ({s})"),
        Err(e) => println!("no video.mp4: ffmpeg could not be started ({e})"),
    }
}

fn arguments() -> Outcome<Arguments> {
    const USAGE: &str =
        "usage: make_capture --kind KIND --seed N --out DIR [--photos N] [--size WxH] [--no-exif] [--masks-truth DIR]";
    let (mut kind, mut seed, mut out, mut photos, mut size) = (None, None, None, None, None);
    let (mut exif, mut masks_truth) = (true, None);
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        if word == "--no-exif" {
            exif = false;
            continue;
        }
        let value = words.next().ok_or_else(|| format!("{word} needs a value; {USAGE}"))?;
        match word.as_str() {
            "--kind" => kind = Some(value.parse::<Kind>()?),
            "--seed" => seed = Some(value.parse::<u64>()?),
            "--out" => out = Some(PathBuf::from(value)),
            "--photos" => photos = Some(value.parse::<usize>()?),
            "--size" => {
                let (w, h) = value.split_once('x').ok_or("--size takes WIDTHxHEIGHT")?;
                size = Some((w.parse::<u32>()?, h.parse::<u32>()?));
            }
            "--masks-truth" => masks_truth = Some(PathBuf::from(value)),
            _ => return Err(format!("{word} is not known; {USAGE}").into()),
        }
    }
    let (Some(kind), Some(seed), Some(out)) = (kind, seed, out) else { return Err(USAGE.into()) };
    let mut wanted = kind.size();
    wanted.photos = photos.unwrap_or(wanted.photos);
    if let Some((w, h)) = size {
        (wanted.width_px, wanted.height_px) = (w, h);
    }
    Ok(Arguments { kind, seed, out, size: wanted, exif, masks_truth })
}
