//! `drex mesh`: check, convert and look at meshes.

use anyhow::{Result, bail};
use drex_core::{Pose, fsutil};
use drex_mesh::{
    CheckOptions, DecimateOptions, RepairOptions, check_asset, check_file, decimate, read_mesh, repair, write_mesh,
};
use serde_json::json;

use crate::cli::{MeshCheckArgs, MeshCommand, MeshConvertArgs, MeshPictureArgs};
use crate::ui::Ui;
use drex_report::picture::raster::{View, render_png};
use drex_report::picture::surface::Surface;

/// Colours of the pieces in a picture, in turn.
const COLOURS: [[f64; 3]; 8] = [
    [0.30, 0.47, 0.66],
    [0.95, 0.56, 0.17],
    [0.35, 0.63, 0.31],
    [0.88, 0.34, 0.35],
    [0.46, 0.72, 0.70],
    [0.93, 0.79, 0.28],
    [0.69, 0.48, 0.63],
    [1.00, 0.62, 0.65],
];

/// Runs one of the mesh commands.
pub fn run(command: &MeshCommand, ui: &Ui) -> Result<()> {
    match command {
        MeshCommand::Check(args) => check(args, ui),
        MeshCommand::Convert(args) => convert(args, ui),
        MeshCommand::Picture(args) => picture(args, ui),
    }
}

/// The rules; fails where one is broken that `drex asset` does not mend.
fn check(args: &MeshCheckArgs, ui: &Ui) -> Result<()> {
    let mut options = CheckOptions::default();
    options.asset.unit = args.unit;
    let asset = args.file.is_dir() || args.file.extension().is_some_and(|e| e == "xml");
    let report = if asset { check_asset(&args.file, &options)? } else { check_file(&args.file, &options)? };
    ui.answer(&report, report.to_string())?;
    if !report.passed() {
        // The answer is out already; a script that asks only for the status must hear of it too.
        std::process::exit(1);
    }
    Ok(())
}

/// Reads, repairs, simplifies if asked, and writes in the format of the name.
fn convert(args: &MeshConvertArgs, ui: &Ui) -> Result<()> {
    let (mut mesh, repaired) = repair(&read_mesh(&args.input)?, &RepairOptions::default())?;
    let mut simplified = None;
    if args.faces.is_some() || args.max_error.is_some() {
        let mut options = DecimateOptions::default();
        options.target_faces = args.faces;
        options.max_error_m = args.max_error;
        let (fewer, report) = decimate(&mesh, &options)?;
        mesh = fewer;
        simplified = Some(report);
    }
    write_mesh(&args.output, &mesh)?;
    let mut text = format!(
        "{}: {} vertices, {} faces, {} open edges\n",
        args.output.display(),
        mesh.vertices.len(),
        mesh.faces.len(),
        repaired.open_edges
    );
    if let Some(r) = &simplified {
        text += &format!("  simplified from {} faces, at most {:.3e} off\n", r.faces_before, r.error_m);
        if !r.reached {
            text += "  note     fewer faces would change the topology or exceed the error\n";
        }
    }
    ui.answer(&json!({ "repair": repaired, "decimate": simplified }), text)
}

/// A PNG of the meshes, each in a colour of its own.
fn picture(args: &MeshPictureArgs, ui: &Ui) -> Result<()> {
    if !args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        bail!("--out {}: pictures are PNG; give a name that ends in .png", args.out.display());
    }
    let files: Vec<Vec<Surface>> = args.files.iter().map(|file| Surface::read(file)).collect::<Result<_, _>>()?;
    let mut parts = Vec::new();
    for (file, color) in files.iter().zip(COLOURS.iter().cycle()) {
        parts.extend(file.iter().map(|surface| surface.part(Pose::identity(), *color)));
    }
    let view = View {
        width: args.size,
        height: args.size,
        azimuth: args.azimuth.to_radians(),
        elevation: args.elevation.to_radians(),
        table_height_m: None,
    };
    fsutil::write_atomic(&args.out, &render_png(&parts, &view)?)?;
    ui.answer(&json!({ "picture": args.out }), format!("written  {}", args.out.display()))
}
