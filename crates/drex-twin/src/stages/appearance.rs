//! Gaussians that show what the photos of the scan show, born on the mesh.

use std::path::{Path, PathBuf};

use drex_core::capture::read_rgb;
use drex_mesh::{ModelPart, Similarity, read_model};
use drex_mvs::textured_points;
use drex_splat::ReconstructOptions;
use drex_splat::train::SurfacePoint;
use nalgebra::Matrix4;

use super::scan::photos_of;
use crate::error::Context;
use crate::reconstruct::train_gaussians;
use crate::records::{HELD_OUT, SCAN, SPLAT_REPORT, ScanFile, read_json};
use crate::surfels::born_at;
use crate::{Progress, Result, Twin};

/// Gaussians that are born on the mesh.
const BORN: usize = 30_000;
/// Every so many photos one is not trained on but measured against.
const HOLD_OUT: usize = 8;

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let config = twin.manifest.scan.as_ref().context("the manifest has no [scan]")?;
    let made: ScanFile = read_json(&twin.path(SCAN))?;
    let photos = photos_of(twin, &made)?;
    if photos.views.iter().all(|v| v.depth.is_some()) {
        // The frames of a depth camera: nothing is trained on them.
        return Ok(Vec::new());
    }
    let mesh_from_scan = Similarity::from_matrix(&Matrix4::from_fn(|r, c| made.scan.mesh_from_scan[r][c]))?;
    let mut options = ReconstructOptions::default();
    options.born = points_on(&twin.path("mesh/visual.obj"), &mesh_from_scan)?;
    options.preset = config.preset.of_training();
    (options.iterations, options.seed, options.surface) = (config.iterations, twin.seed, false);
    options.hold_out = Some(HOLD_OUT);
    train_gaussians(&photos, &twin.root, &options, false, progress)?;
    ["splat/appearance.ply", SPLAT_REPORT, HELD_OUT].into_iter().map(|name| twin.output(name)).collect()
}

/// Points spread over a mesh in the colours of the picture on it, in the frame and unit of the scan; none if there is no picture.
fn points_on(file: &Path, mesh_from_scan: &Similarity) -> Result<Vec<SurfacePoint>> {
    let picture = file.with_extension("png");
    if !picture.is_file() {
        return Ok(Vec::new());
    }
    let (size, rgb) = read_rgb(&picture)?;
    let scan_from_mesh = mesh_from_scan.inverse();
    let mut out = Vec::with_capacity(BORN);
    for ModelPart { mesh, uv, .. } in read_model(file)?.parts {
        let Some(uv) = uv else { continue };
        let uv: Vec<_> = mesh.faces.iter().map(|face| face.map(|v| uv[v as usize])).collect();
        let points = textured_points(&scan_from_mesh.mesh(&mesh), &uv, (size, &rgb), BORN);
        out.extend(points.iter().map(born_at));
    }
    Ok(out)
}
