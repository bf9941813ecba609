//! Where the Gaussians of a scan are born that has a mesh.

use std::path::Path;

use drex_core::capture::{Capture, PhotoOptions, Photos, read_rgb};
use drex_mesh::{ModelPart, Similarity, read_model};
use drex_mvs::textured_points;
use drex_splat::train::SurfacePoint;
use nalgebra::Matrix4;

use crate::Result;
use crate::masks::MASKS;
use crate::records::{ScanFile, read_json};
use crate::scan::MUCH;
use crate::surfels::born_at;

/// The mesh of an asset, below its folder.
pub(crate) const VISUAL: &str = "mesh/visual.obj";
/// Gaussians that are born on a mesh.
const BORN: usize = 30_000;

/// Points on the textured mesh that `drex asset` made in `out` of the scan `capture`, in the frame of the scan; the views get the masks that were made for
/// it. None if there is no such mesh, much of it was not measured, or no mask cuts the object out.
///
/// # Errors
/// If a file is damaged.
pub fn points_on_asset(out: &Path, capture: &mut Capture) -> Result<Vec<SurfacePoint>> {
    let record = out.join("mesh/scan.json");
    if !record.is_file() {
        return Ok(Vec::new());
    }
    let made: ScanFile = read_json(&record)?;
    // Gaussians that stay where they are born show photos worse there than those that seek their place.
    if 1.0 - made.fusion.seen_share - made.fusion.support_share > MUCH {
        return Ok(Vec::new());
    }
    if made.made_masks {
        for view in &mut capture.views {
            view.mask.get_or_insert_with(|| out.join(MASKS).join(format!("{}.png", view.name)));
        }
    }
    // Photos may be transparent beside the object instead.
    let masked = capture.views.iter().any(|v| v.mask.is_some())
        || Photos::new(capture, PhotoOptions::default())?.get(0)?.mask.is_some();
    if masked { points_on(&out.join(VISUAL), &made) } else { Ok(Vec::new()) }
}

/// Points spread over a mesh in the colours of the picture on it, in the frame and unit of the scan; none if there is no picture.
pub(crate) fn points_on(mesh: &Path, made: &ScanFile) -> Result<Vec<SurfacePoint>> {
    let picture = mesh.with_extension("png");
    if !picture.is_file() {
        return Ok(Vec::new());
    }
    let (size, rgb) = read_rgb(&picture)?;
    let mesh_from_scan = Similarity::from_matrix(&Matrix4::from_fn(|r, c| made.scan.mesh_from_scan[r][c]))?;
    let scan_from_mesh = mesh_from_scan.inverse();
    let mut out = Vec::with_capacity(BORN);
    for ModelPart { mesh, uv, .. } in read_model(mesh)?.parts {
        let Some(uv) = uv else { continue };
        let uv: Vec<_> = mesh.faces.iter().map(|face| face.map(|v| uv[v as usize])).collect();
        let points = textured_points(&scan_from_mesh.mesh(&mesh), &uv, (size, &rgb), BORN);
        out.extend(points.iter().map(born_at));
    }
    Ok(out)
}
