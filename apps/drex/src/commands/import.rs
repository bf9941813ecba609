//! `drex import`: pushes and twin folders from recordings in other layouts.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use drex_core::fsutil::{self, OutputFolder, output_path};
use drex_mesh::{AssetOptions, build_asset};
use drex_recording::convert::{allegro_run, mujoco_push, write_push};
use drex_recording::{PushConfig, PushRecording, TrackFrame};
use drex_robot::joint_order::ALLEGRO_ROS;
use drex_sysid::frames::{self, FrameOptions, Standing};
use drex_twin::manifest::TwinManifest;
use nalgebra::Vector3;
use serde::Serialize;

use crate::cli::{ImportArgs, ImportSource};
use crate::ui::Ui;

/// The named order of the joint columns in the authors' grasp files.
const GRASP_ORDER: &str = "leap_sdk";

/// What was made of one object.
#[derive(Debug, Serialize)]
struct Imported {
    object: String,
    twin: PathBuf,
    pushes: usize,
    grasps: bool,
}

/// Writes the push, or the twin of every object found.
pub fn run(args: &ImportArgs, ui: &Ui) -> Result<()> {
    match &args.source {
        ImportSource::DRex { dir, out, object } => twins(dir, out, object.as_deref(), ui),
        ImportSource::AllegroRun { run, out } => push(&allegro_run::push_config(run, &ALLEGRO_ROS)?, run, out, ui),
        ImportSource::MujocoPush { scenario, poses, force, out } => {
            let inputs = mujoco_push::Inputs { poses: *poses, force: *force };
            push(&mujoco_push::push_config(scenario, inputs)?, scenario, out, ui)
        }
    }
}

/// Writes the push of `config`, whose paths start at `from`, to `out`.
fn push(config: &PushConfig, from: &Path, out: &Path, ui: &Ui) -> Result<()> {
    let file = write_push(config, from, out, None)?;
    let text = format!("{}\n  drex identify {}", file.display(), out.display());
    ui.answer(&serde_json::json!({ "push": file }), text)
}

/// Makes a twin of every object, or of the one named `object`, in the recordings `dir`.
fn twins(dir: &Path, out: &Path, object: Option<&str>, ui: &Ui) -> Result<()> {
    let runs = find_runs(dir)?;
    let mut by_object: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for run in runs {
        by_object.entry(object_of(&run)?).or_default().push(run);
    }
    if let Some(wanted) = object {
        by_object.retain(|name, _| name == wanted);
        if by_object.is_empty() {
            bail!("no run of an object named `{wanted}` in {}", dir.display());
        }
    }
    let (mut imported, mut twins) = (Vec::new(), OutputFolder::new(out));
    for (name, runs) in by_object {
        // The name becomes that of a folder.
        let root = twins.file(&name).with_context(|| format!("importing {name}"))?;
        imported.push(import_object(&name, &runs, dir, &root).with_context(|| format!("importing {name}"))?);
    }
    let lines: Vec<String> = imported
        .iter()
        .map(|i| {
            let grasps = if i.grasps { ", with grasps" } else { "" };
            format!("{}: {} push(es){grasps}\n  drex run {}", i.object, i.pushes, i.twin.display())
        })
        .collect();
    ui.answer(&serde_json::json!({ "imported": imported }), lines.join("\n"))
}

/// Folders with a run.json, below `dir/runs` or below `dir`.
fn find_runs(dir: &Path) -> Result<Vec<PathBuf>> {
    let folder = if dir.join("runs").is_dir() { dir.join("runs") } else { dir.to_path_buf() };
    let entries = std::fs::read_dir(&folder).map_err(|e| drex_core::Error::io("list", &folder, e))?;
    let mut runs: Vec<PathBuf> =
        entries.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.join("run.json").is_file()).collect();
    runs.sort();
    if runs.is_empty() {
        bail!("no run.json in a folder below {}; give the folder that holds runs/ and objects/", folder.display());
    }
    Ok(runs)
}

fn object_of(run: &Path) -> Result<String> {
    let file = run.join("run.json");
    let value: serde_json::Value = serde_json::from_slice(&fsutil::read_bytes(&file)?)
        .with_context(|| format!("{} is no JSON", file.display()))?;
    match value.get("object").and_then(|v| v.as_str()) {
        Some(name) if !name.contains(['/', '\\']) => Ok(name.to_owned()),
        _ => bail!("{} does not name its object; add \"object\": \"NAME\"", file.display()),
    }
}

/// Copies the object's mesh, runs and grasps into `root` and writes its manifest last.
fn import_object(name: &str, runs: &[PathBuf], dir: &Path, root: &Path) -> Result<Imported> {
    let mut files = OutputFolder::new(root);
    let mut mesh = None;
    let mut up_in_mesh = None;
    let mut pushes = Vec::new();
    for run in runs {
        // Loading checks the run as a whole before anything is copied.
        let config = allegro_run::push_config(run, &ALLEGRO_ROS)?;
        let recording = config.load(run)?;
        if up_in_mesh.is_none() {
            // The first run decides. Rounded, so that an axis reads as one.
            up_in_mesh = up_of(&recording)?.map(|up| [up.x, up.y, up.z].map(|c| (c * 1e6).round() / 1e6));
        }
        let mesh = mesh.get_or_insert_with(|| recording.mesh.clone());
        let place = format!("push/{}", run_name(run));
        write_push(&config, run, &output_path(root, &place)?, Some(&root.join(scan_name(mesh))))?;
        pushes.push(place);
    }
    let (Some(mesh), Some(up_in_mesh)) = (mesh, up_in_mesh) else {
        bail!("the runs of {name} do not say which way is up");
    };
    copy(&mesh, &files.file(&scan_name(&mesh))?)?;
    let grasps = grasp_file(name, dir, runs);
    if let Some(file) = &grasps {
        copy(file, &files.file(&format!("demos/{}", file_name(file)))?)?;
        // A JSON file may only describe the array beside it.
        let array = file.with_extension("npy");
        if array.is_file() {
            copy(&array, &files.file(&format!("demos/{}", file_name(&array)))?)?;
        }
    }
    let manifest = manifest(name, &mesh, up_in_mesh, &pushes, grasps.as_deref())?;
    let twin = files.file("twin.toml")?;
    fsutil::write_atomic(&twin, manifest.as_bytes())?;
    TwinManifest::load(&twin)?;
    Ok(Imported { object: name.to_owned(), twin, pushes: pushes.len(), grasps: grasps.is_some() })
}

/// Up of the resting object in its mesh frame: as stated, or as the track shows it.
fn up_of(recording: &PushRecording) -> Result<Option<Vector3<f64>>> {
    Ok(match &recording.track_frame {
        TrackFrame::Camera { of_mesh: true, up: Some(up), .. } => Some(*up),
        TrackFrame::Camera { .. } => {
            let object = build_asset(&recording.mesh, &AssetOptions::in_metres())?.to_exact_object("")?;
            Some(frames::find(&recording.track, &Standing::of(&object)?, &FrameOptions::of(recording))?.up_in_mesh)
        }
        _ => None,
    })
}

/// The manifest as a person would write it.
fn manifest(name: &str, mesh: &Path, up: [f64; 3], pushes: &[String], grasps: Option<&Path>) -> Result<String> {
    let text = |s: &str| toml::Value::String(s.to_owned()).to_string();
    let list: Vec<String> = pushes.iter().map(|p| text(p)).collect();
    let mut out = format!(
        "schema = 1\nname = {}\n\n[object]\nmesh = {}\nup_in_mesh = [{}, {}, {}]\n\n[mass]\nidentify = [{}]\n",
        text(name),
        text(&scan_name(mesh)),
        up[0],
        up[1],
        up[2],
        list.join(", ")
    );
    if let Some(file) = grasps {
        let file = text(&format!("demos/{}", file_name(file)));
        out += &format!("\n[grasps]\nfile = {file}\nhand = \"leap_right\"\njoint_order = \"{GRASP_ORDER}\"\n");
    }
    Ok(out)
}

/// `demos/<object>_*.json` beside the runs, if there is one.
fn grasp_file(object: &str, dir: &Path, runs: &[PathBuf]) -> Option<PathBuf> {
    let beside_runs = runs.first().and_then(|r| r.parent()?.parent()).map(|p| p.join("demos"));
    let folders = [Some(dir.join("demos")), beside_runs];
    let mut found: Vec<PathBuf> = folders
        .into_iter()
        .flatten()
        .filter_map(|f| std::fs::read_dir(f).ok())
        .flatten()
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "json"))
        .filter(|p| file_name(p).starts_with(&format!("{object}_")))
        .collect();
    found.sort();
    found.into_iter().next()
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    Ok(fsutil::write_atomic(to, &fsutil::read_bytes(from)?)?)
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn run_name(run: &Path) -> String {
    std::fs::canonicalize(run).ok().map(|p| file_name(&p)).unwrap_or_else(|| file_name(run))
}

fn scan_name(mesh: &Path) -> String {
    format!("scan/{}", file_name(mesh))
}
