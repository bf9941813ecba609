//! `drex asset`: a mesh or a scan becomes a sim-ready asset.

use std::num::NonZeroUsize;
use std::path::Path;
use std::time::Instant;

use anyhow::{Result, bail};
use drex_core::fsutil;
use drex_mesh::PartConfig;
use drex_mesh::{
    Asset, AssetOptions, AssetReport, Background, FusionReport, LengthUnit, Part, PartitionOptions, RepairOptions,
    ScanEvidence, SceneOptions, SurfaceShares, articulated_asset, asset_from_mesh, build_asset, convex_parts,
    read_mesh, repair, write_evidence,
};
use drex_twin::manifest::{MANIFEST, TwinManifest};
use nalgebra::Vector3;
use serde::Serialize;

use crate::cli::AssetArgs;
use crate::ui::Ui;
use drex_twin::records::{FrameReport, GapReport, Refinement};
use drex_twin::scan::{FrameOptions, Meshed, Scanning, TextureReport};
use drex_twin::timings::{self, Timing};

/// What ffmpeg is asked to open.
const VIDEOS: [&str; 6] = ["mp4", "mov", "mkv", "avi", "webm", "m4v"];

/// The answer of `drex asset --json` for a scan; also written as `mesh/scan.json`, without the asset.
#[derive(Serialize)]
struct ScanAnswer<'a> {
    scan: &'a FrameReport,
    made_masks: bool,
    fusion: &'a FusionReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    gaps: Option<&'a GapReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    refinement: Option<&'a Refinement>,
    evidence: &'a ScanEvidence,
    #[serde(skip_serializing_if = "Option::is_none")]
    texture: Option<&'a TextureReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    asset: Option<&'a AssetReport>,
}

/// Builds the asset, writes it, answers with its report.
pub fn run(args: &AssetArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    let manifest = if args.input.is_dir() { args.input.join(MANIFEST) } else { args.input.clone() };
    if manifest.file_name().is_some_and(|name| name == MANIFEST) && manifest.is_file() {
        return from_manifest(args, &manifest, ui);
    }
    if is_scan(&args.input) {
        return from_scan(args, seed.unwrap_or(0), ui);
    }
    if args.input.extension().is_none() && !args.input.exists() {
        bail!("there is no {}; give a mesh, a folder of photos, a video or a twin", args.input.display());
    }
    let spinner = ui.spinner("asset");
    let asset = build_asset(&args.input, &options(args))?;
    write(&asset, args)?;
    spinner.finish_and_clear();
    ui.answer(&asset.report, format!("{}\n{}", args.input.display(), describe(&asset, args)))
}

/// Whether an input is photos or a video, and no mesh.
pub fn is_scan(input: &Path) -> bool {
    input.is_dir() || input.extension().is_some_and(|e| VIDEOS.iter().any(|v| e.eq_ignore_ascii_case(v)))
}

fn options(args: &AssetArgs) -> AssetOptions {
    let mut options = AssetOptions::default();
    options.unit = args.unit;
    with_arguments(options, args)
}

/// What the command line says goes before what a manifest says.
fn with_arguments(mut options: AssetOptions, args: &AssetArgs) -> AssetOptions {
    options.up_in_mesh = args.up.map(Vector3::from).or(options.up_in_mesh);
    options.friction = args.friction.unwrap_or(options.friction);
    options.mass_kg = args.mass.or(options.mass_kg);
    options.density_kg_m3 = args.density.unwrap_or(options.density_kg_m3);
    options.wall_m = args.wall;
    options.partition.most_parts = args.pieces.map_or(options.partition.most_parts, NonZeroUsize::get);
    options
}

/// Writes the asset, in a scene where one is asked for.
fn write(asset: &Asset, args: &AssetArgs) -> Result<()> {
    if args.robot.is_none() && args.background.is_none() && args.pose.is_none() {
        return Ok(asset.write(&args.out)?);
    }
    let mut scene = SceneOptions::default();
    scene.robot.clone_from(&args.robot);
    scene.world_from_object = args.pose;
    if let Some(file) = &args.background {
        let (visual, _) = repair(&read_mesh(file)?, &RepairOptions::default())?;
        // What cannot be divided, an open sheet such as a scanned table, is only looked at.
        let convex_parts = convex_parts(&visual, &PartitionOptions::default()).unwrap_or_default();
        scene.background = Some(Background { visual, convex_parts });
    }
    Ok(asset.write_with_scene(&scene, &args.out)?)
}

/// The object of a twin: parts and joints, or one mesh.
fn from_manifest(args: &AssetArgs, manifest: &Path, ui: &Ui) -> Result<()> {
    let twin = TwinManifest::load(manifest)?;
    let folder = manifest.parent().unwrap_or(Path::new(""));
    let mesh = folder.join(&twin.object.mesh);
    if twin.scan.is_some() && !mesh.exists() {
        bail!("{} is made from the [scan], which has not run yet: drex run {}", mesh.display(), manifest.display());
    }
    let mut options = twin.object.asset_options(twin.friction().0);
    options.mass_kg = twin.mass.weighed_kg;
    let options = with_arguments(options, args);
    let spinner = ui.spinner("asset");
    if twin.object.parts.is_empty() {
        let asset = build_asset(&mesh, &options)?;
        write(&asset, args)?;
        spinner.finish_and_clear();
        return ui.answer(&asset.report, format!("{}\n{}", args.input.display(), describe(&asset, args)));
    }
    let part = |p: &PartConfig| -> Result<Part> {
        Ok(Part { name: p.name.clone(), mesh: read_mesh(&folder.join(&p.mesh))?, mass_kg: p.mass_kg })
    };
    let parts = twin.object.parts.iter().map(part).collect::<Result<Vec<_>>>()?;
    let asset = articulated_asset(&parts, &twin.object.joints, &options)?;
    asset.write(&args.out)?;
    spinner.finish_and_clear();
    let r = &asset.report;
    let mut text = format!("{}\n  mass     {:.1} g\n", args.input.display(), 1e3 * r.mass_kg);
    for (name, part) in &r.parts {
        text += &format!(
            "  {name}: {:.1} g, {:.2} cm3, {} convex pieces\n",
            1e3 * part.mass_kg,
            1e6 * part.volume_m3,
            part.pieces
        );
    }
    for joint in &r.joints {
        text += &format!("  {}: {} to {}\n", joint.name, joint.parent, joint.child);
    }
    ui.answer(r, text + &written(args))
}

/// Photos to depth maps, or depth maps as they are, to a closed mesh to an asset.
fn from_scan(args: &AssetArgs, seed: u64, ui: &Ui) -> Result<()> {
    let frame = FrameOptions {
        scale: args.scan.scale,
        distances: args.scan.distance.clone(),
        marks: args.scan.marks.clone(),
        up: args.up.map(Vector3::from),
        region: args.scan.region,
        object: args.scan.object.clone(),
        seed,
    };
    let scanning = Scanning {
        input: &args.input,
        out: &args.out,
        masks: args.scan.masks.clone(),
        poses: args.scan.poses.clone(),
        frame,
        voxel_m: args.scan.voxel,
        marker: args.scan.marker,
        colmap: args.scan.colmap.clone(),
        preset: args.scan.preset.into(),
        on_gpu: args.scan.gpu,
        seed,
        tool_limit: args.scan.tools.limit(),
    };
    let begun = Instant::now();
    let meshed = scanning.mesh(ui)?;
    let Meshed { scan, fused, gaps, refinement, mesh, evidence, .. } = &meshed;
    let fusion = &fused.report;

    let spinner = ui.spinner("asset");
    let mut options = options(args);
    options.unit = LengthUnit::Metre;
    options.up_in_mesh = Some(scan.frame.up_in_mesh.into());
    options.scale_source = Some(scan.frame.scale_from.clone());
    let mut asset = asset_from_mesh(mesh, &options)?;
    asset.report.warnings.extend(scan.frame.doubts.iter().cloned());
    spinner.finish_and_clear();
    let of_vertices = fused.evidence_of(&asset.visual);
    asset.report.surface = Some(SurfaceShares::of(&asset.visual, &of_vertices));
    let (texture, texture_report) = meshed.textured(&asset.visual, ui).unzip();
    asset.texture = texture;
    write(&asset, args)?;
    write_evidence(&fsutil::output_path(&args.out, "mesh/evidence.ply")?, &asset.visual, &of_vertices)?;
    let mut answer = ScanAnswer {
        scan: &scan.frame,
        made_masks: meshed.masks.is_some(),
        fusion,
        gaps: gaps.as_ref(),
        refinement: refinement.as_ref(),
        evidence,
        texture: texture_report.as_ref(),
        asset: None,
    };
    let text = serde_json::to_string_pretty(&answer)? + "\n";
    fsutil::write_atomic(&fsutil::output_path(&args.out, "mesh/scan.json")?, text.as_bytes())?;
    let input = Some(args.input.clone());
    timings::record(&args.out, "asset", Timing { input, ..Timing::of(begun.elapsed().as_secs_f64()) })?;
    answer.asset = Some(&asset.report);
    ui.answer(
        &answer,
        describe_scan(&scan.frame, fusion)
            + &texture_report.as_ref().map(describe_texture).unwrap_or_default()
            + &describe(&asset, args),
    )
}

fn describe_texture(t: &TextureReport) -> String {
    let [width, height] = t.size_px;
    let gains = || t.photos.iter().flat_map(|p| p.gain);
    let differ = gains().fold(1.0, f64::max) / gains().fold(1.0, f64::min);
    format!(
        "  texture  {width} x {height} texels of {:.2} mm, {:.1} MB, {:.0} % of them seen in {} photos, whose exposures differ by a factor of up to {:.2}\n",
        1e3 * t.texel,
        1e-6 * t.bytes as f64,
        100.0 * t.seen_share,
        t.photos.len(),
        differ
    )
}

fn describe_scan(frame: &FrameReport, fusion: &FusionReport) -> String {
    let mut text =
        format!("{}\n  scale    {:.6} m per unit, from {}", frame.scan, frame.metres_per_unit, frame.scale_from);
    text += &match &frame.marker {
        Some(m) => format!(" {} in {} photos, +- {:.2} %\n", m.marker, m.used, 100.0 * m.relative_sigma),
        None => "\n".to_owned(),
    };
    text += &frame.marker.iter().flat_map(|m| &m.warning).map(|w| format!("  note     {w}\n")).collect::<String>();
    for d in frame.distances.iter().flat_map(|fit| &fit.distances) {
        text += &format!(
            "           {} to {}: {:.2} mm given, {:.2} mm in the scan\n",
            d.from,
            d.to,
            1e3 * d.given_m,
            1e3 * d.model_m
        );
    }
    text += &match frame.table_rms_m {
        Some(rms) => {
            let px = frame.table_rms_px.map_or(String::new(), |px| format!(", {px:.2} px"));
            format!("  table    {} points, {:.2} mm{px} off a plane\n", frame.table_points.unwrap_or(0), 1e3 * rms)
        }
        None => format!("  up       {}\n", frame.up_from),
    };
    if let Some([lo, hi]) = frame.region_m {
        let size = [0, 1, 2].map(|k| format!("{:.0}", 1e3 * (hi[k] - lo[k]))).join(" x ");
        text += &format!("  object   in a box of {size} mm, from {}", frame.object_from);
        text += &match frame.others_on_table {
            0 => "\n".to_owned(),
            n => format!("; {n} more on the table\n"),
        };
    }
    text + &format!("  fusion   {} views, voxels of {:.2} mm\n", fusion.views, 1e3 * fusion.voxel_m)
}

fn describe(asset: &Asset, args: &AssetArgs) -> String {
    let r = &asset.report;
    let p = &asset.properties;
    let mut text = format!(
        "  volume   {:.2} cm3 ({})\n  mass     {:.1} g{}\n  centre   {:.2}, {:.2}, {:.2} mm\n  pieces   {} convex\n",
        1e6 * r.volume_m3,
        drex_report::closing_text(r),
        1e3 * p.mass_kg,
        match (args.mass, args.density) {
            (None, None) => " at 1000 kg/m3: give --mass for the real one",
            _ => "",
        },
        1e3 * p.center_of_mass.x,
        1e3 * p.center_of_mass.y,
        1e3 * p.center_of_mass.z,
        asset.convex_parts.len()
    );
    for warning in &r.warnings {
        text += &format!("  note     {warning}\n");
    }
    text + &written(args)
}

fn written(args: &AssetArgs) -> String {
    format!("  written  {}", args.out.join("asset").join("object.xml").display())
}
