//! `drex render`: Gaussians become pictures.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use drex_core::camera::PinholeCamera;
use drex_core::capture::{Capture, CaptureOptions};
use drex_core::fsutil::OutputFolder;
use drex_core::npy::write_npy;
use drex_recording::readers::read_pose_csv;
use drex_splat::io::{exr, picture, read_gaussians};
use drex_splat::{Attachment, Cpu, Gaussians, Kind, Orbit, Rasterizer, Render, RenderOptions, Scene};
use nalgebra::{Similarity3, Vector3};
use serde::Serialize;

use crate::cli::{MapFormat, RenderArgs};
use crate::ui::Ui;

/// Cameras on an orbit round a scene that does not move.
const STILL_ORBIT: usize = 60;
/// Size of pictures on an orbit, pixels.
const ORBIT_SIZE: [usize; 2] = [640, 480];
/// Most pictures of one run: a trajectory may be hours long.
const MOST_FRAMES: usize = 100_000;

/// The answer of `drex render --json`.
#[derive(Debug, Serialize)]
struct Summary {
    gaussians: usize,
    kind: Kind,
    frames: Vec<Frame>,
}

/// One picture and what goes with it.
#[derive(Debug, Serialize)]
struct Frame {
    picture: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    normal: Option<PathBuf>,
    width: usize,
    height: usize,
    /// Time of the trajectory, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    time_s: Option<f64>,
}

/// Where a picture is taken from, and when.
struct Shot {
    name: String,
    camera: PinholeCamera,
    time_s: Option<f64>,
}

/// Reads the Gaussians, places the cameras, draws, answers.
pub fn run(args: &RenderArgs, ui: &Ui) -> Result<()> {
    let scene = scene(args)?;
    let kind = scene.background.kind;
    if args.normal.is_some() && kind == Kind::Ellipsoid {
        bail!("--normal needs surfels, {} holds ellipsoids; give a surface, or --surfels", args.splat.display());
    }
    let shots = shots(args, &scene)?;
    let files = files(args, &shots)?;
    let mut options = RenderOptions::default();
    options.background = args.background.map(|c| c as f32);
    options.antialias = args.antialias;
    options.geometry = args.normal.is_some();
    let bar = ui.bar("render", shots.len() as u64);
    let (mut frames, mut drawing, mut gaussians) = (Vec::with_capacity(shots.len()), Duration::ZERO, 0);
    for (shot, files) in shots.iter().zip(files) {
        let begin = Instant::now();
        let posed;
        let all = match shot.time_s {
            Some(t_s) => {
                posed = scene.posed(t_s)?;
                &posed
            }
            None => &scene.background,
        };
        options.sh_degree = all.sh_degree;
        gaussians = all.len();
        let (render, _) = Cpu.forward(all, &shot.camera, &options)?;
        drawing += begin.elapsed();
        frames.push(write(args, files, shot.time_s, &render)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let summary = Summary { gaussians, kind, frames };
    let text = text(args, &summary, drawing);
    ui.answer(&summary, text)
}

/// The Gaussians that stand still and those that move.
fn scene(args: &RenderArgs) -> Result<Scene> {
    let otherwise = if args.surfels { Kind::Surfel } else { Kind::Ellipsoid };
    let read = |path: &Path, placed: &Option<Similarity3<f64>>| -> Result<Gaussians> {
        let gaussians = read_gaussians(path, otherwise)?;
        Ok(match placed {
            Some(a_from_splat) => gaussians.transformed(a_from_splat)?,
            None => gaussians,
        })
    };
    let background = read(&args.splat, &args.scene_from_splat)?;
    let objects = match (&args.object, &args.trajectory) {
        (Some(object), Some(poses)) => {
            let object = read(object, &args.object_from_splat)?;
            vec![Attachment::new(&object, &Similarity3::identity(), read_pose_csv(poses)?)?]
        }
        _ => Vec::new(),
    };
    Ok(Scene { background, objects })
}

/// Without a trajectory, one picture a camera; with one, pictures at a steady rate that go through the cameras in order.
fn shots(args: &RenderArgs, scene: &Scene) -> Result<Vec<Shot>> {
    let times: Vec<f64> = match scene.span_s() {
        Some((first, last)) => {
            let count = ((last - first) * args.fps).floor() + 1.0;
            if count > MOST_FRAMES as f64 {
                bail!("the trajectory would give {count:.0} pictures, more than {MOST_FRAMES}; lower --fps");
            }
            (0..count as usize).map(|k| (first + k as f64 / args.fps).min(last)).collect()
        }
        None => Vec::new(),
    };
    let cameras = match &args.cameras {
        Some(scan) => cameras_of(args, scan)?,
        None => orbit(args, scene, if times.is_empty() { STILL_ORBIT } else { times.len() })?,
    };
    if times.is_empty() {
        return Ok(cameras.into_iter().map(|(name, camera)| Shot { name, camera, time_s: None }).collect());
    }
    let n = times.len();
    let shot = |(k, t): (usize, f64)| Shot {
        name: frame_name(k),
        camera: cameras[k * cameras.len() / n].1.clone(),
        time_s: Some(t),
    };
    Ok(times.into_iter().enumerate().map(shot).collect())
}

/// Name and camera of the views of a scan.
fn cameras_of(args: &RenderArgs, scan: &Path) -> Result<Vec<(String, PinholeCamera)>> {
    let capture = Capture::load(scan, &CaptureOptions::default())?;
    let mut cameras = Vec::new();
    for (i, view) in capture.views.iter().enumerate() {
        if args.view.as_ref().is_some_and(|name| *name != view.name) {
            continue;
        }
        let mut camera = capture.pinhole(i, None)?;
        if let Some([width, height]) = args.size {
            camera = camera.resized(width, height);
        }
        // A name may have folders in it; pictures lie in one.
        let stem = Path::new(&view.name).with_extension("");
        cameras.push((stem.to_string_lossy().replace(['/', '\\'], "_"), camera));
    }
    if cameras.is_empty() {
        let names: Vec<&str> = capture.views.iter().take(3).map(|v| v.name.as_str()).collect();
        let wanted = args.view.as_deref().unwrap_or_default();
        bail!(
            "{} has no view `{wanted}`; give one of its {}, such as {}",
            scan.display(),
            capture.views.len(),
            names.join(", ")
        );
    }
    Ok(cameras)
}

/// `count` cameras round the scene, or as many as were asked for.
fn orbit(args: &RenderArgs, scene: &Scene, count: usize) -> Result<Vec<(String, PinholeCamera)>> {
    let [width, height] = args.size.unwrap_or(ORBIT_SIZE);
    let (elevation, fov) = (args.elevation.to_radians(), args.fov.to_radians());
    let start = scene.span_s().map_or(Ok(scene.background.clone()), |(first, _)| scene.posed(first))?;
    let mut orbit = Orbit::round(&start, Vector3::from(args.up), elevation, fov, width, height)?;
    orbit.centre = args.center.map_or(orbit.centre, Into::into);
    orbit.radius = args.radius.unwrap_or(orbit.radius);
    let cameras = orbit.cameras(args.orbit.map_or(count, |n| n.get().min(MOST_FRAMES)))?;
    Ok(cameras.into_iter().enumerate().map(|(k, camera)| (frame_name(k), camera)).collect())
}

fn frame_name(k: usize) -> String {
    format!("frame_{k:04}")
}

/// Where a shot is written.
struct ShotFiles {
    picture: PathBuf,
    depth: Option<PathBuf>,
    normal: Option<PathBuf>,
}

/// The files of all shots, before any is drawn: names of views come with the scan.
fn files(args: &RenderArgs, shots: &[Shot]) -> Result<Vec<ShotFiles>> {
    let mut out = OutputFolder::new(&args.out);
    let map = |out: &mut OutputFolder, folder: &str, name: &str, format: Option<MapFormat>| {
        let ending = if format? == MapFormat::Npy { "npy" } else { "exr" };
        Some(out.file(&format!("{folder}/{name}.{ending}")))
    };
    let files = shots.iter().map(|Shot { name, .. }| {
        Ok(ShotFiles {
            picture: out.file(&format!("{name}.png"))?,
            depth: map(&mut out, "depth", name, args.depth).transpose()?,
            normal: map(&mut out, "normal", name, args.normal).transpose()?,
        })
    });
    files.collect()
}

/// Writes what was drawn and says where.
fn write(args: &RenderArgs, files: ShotFiles, time_s: Option<f64>, render: &Render) -> Result<Frame> {
    let (width, height) = (render.width, render.height);
    let ShotFiles { picture, depth, normal } = files;
    picture::write_rgb(&picture, width, height, &render.rgb)?;
    if let Some(path) = &depth {
        let values = render.expected_depth();
        match args.depth {
            Some(MapFormat::Exr) => exr::write_depth(path, width, height, &values)?,
            _ => write_npy(path, &[height, width], &values)?,
        }
    }
    if let Some(path) = &normal {
        let values = render.unit_normals();
        match args.normal {
            Some(MapFormat::Exr) => exr::write_vectors(path, width, height, &values)?,
            _ => write_npy(path, &[height, width, 3], values.as_flattened())?,
        }
    }
    Ok(Frame { picture, depth, normal, width, height, time_s })
}

fn text(args: &RenderArgs, summary: &Summary, drawing: Duration) -> String {
    let n = summary.frames.len();
    let kind = if summary.kind == Kind::Surfel { "surfels" } else { "ellipsoids" };
    let mut out = format!(
        "{}\n  drawn    {} {kind}, {n} pictures, {:.1} a second\n  written  {}\n",
        args.splat.display(),
        summary.gaussians,
        n as f64 / drawing.as_secs_f64().max(1e-9),
        args.out.display()
    );
    let named = summary.frames.first().is_some_and(|f| f.picture.ends_with("frame_0000.png"));
    if named && n > 1 && has_ffmpeg() {
        let out_dir = args.out.display();
        out += &format!(
            "  video    ffmpeg -framerate {} -i {out_dir}/frame_%04d.png -pix_fmt yuv420p {out_dir}/video.mp4\n",
            args.fps
        );
    }
    out
}

fn has_ffmpeg() -> bool {
    let name = format!("ffmpeg{}", std::env::consts::EXE_SUFFIX);
    std::env::var_os("PATH").is_some_and(|path| std::env::split_paths(&path).any(|folder| folder.join(&name).is_file()))
}
