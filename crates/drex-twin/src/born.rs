//! Where the Gaussians of a scan are born that has a mesh.

use std::path::Path;

use drex_core::capture::{Capture, PhotoOptions, Photos, read_rgb};
use drex_mesh::{ModelPart, read_model};
use drex_mvs::textured_points;
use drex_splat::train::SurfacePoint;
use nalgebra::Point3;

use crate::masks::MASKS;
use crate::records::{ScanFile, read_json};
use crate::surfels::born_at;
use crate::{Progress, Result};

/// The mesh of an asset, below its folder.
pub(crate) const VISUAL: &str = "mesh/visual.obj";
/// Gaussians that are born on a mesh.
const BORN: usize = 30_000;
/// Cameras are the same where they stand this near to each other, as a share of the extent of all.
const SAME_PLACE: f64 = 1e-4;

/// Points on the textured mesh that `drex asset` made in `out` of the scan `capture`, in the frame of the scan; the views get the masks that were made for
/// it. None if there is no such mesh, or no mask cuts the object out; nor, and then a note says so, if it is of other cameras.
///
/// # Errors
/// If a file is damaged.
pub fn points_on_asset(out: &Path, capture: &mut Capture, progress: &dyn Progress) -> Result<Vec<SurfacePoint>> {
    let record = out.join("mesh/scan.json");
    if !record.is_file() {
        return Ok(Vec::new());
    }
    let made: ScanFile = read_json(&record)?;
    if !is_of(&made, capture)? {
        progress.note(&format!(
            "Gaussians are not born on the mesh in {}: it was made with other cameras; run drex asset again, or give another --out",
            out.join("mesh").display()
        ));
        return Ok(Vec::new());
    }
    if made.made_masks {
        for view in capture.views.iter_mut().filter(|v| v.mask.is_none()) {
            // Photos that were added since have none.
            view.mask = Some(out.join(MASKS).join(format!("{}.png", view.name))).filter(|m| m.is_file());
        }
    }
    // Photos may be transparent beside the object instead.
    let masked = capture.views.iter().any(|v| v.mask.is_some())
        || Photos::new(capture, PhotoOptions::default())?.get(0)?.mask.is_some();
    if masked { points_on(&out.join(VISUAL), &made) } else { Ok(Vec::new()) }
}

/// Whether the mesh was held against cameras of the capture, and no others.
fn is_of(made: &ScanFile, capture: &Capture) -> Result<bool> {
    let Some(evidence) = made.evidence.as_ref().filter(|e| !e.cameras.is_empty()) else { return Ok(false) };
    let mesh_from_scan = made.mesh_from_scan()?;
    let centres: Vec<Point3<f64>> = capture.centres().iter().map(|c| mesh_from_scan.point(c)).collect();
    let near = SAME_PLACE * mesh_from_scan.scale * capture.extent();
    let mut poses = evidence.cameras.iter().map(|c| c.world_from_camera.translation_m);
    Ok(poses.all(|p| centres.iter().any(|c| (c - Point3::from(p)).norm() <= near)))
}

/// Points spread over a mesh in the colours of the picture on it, in the frame and unit of the scan; none if there is no picture.
pub(crate) fn points_on(mesh: &Path, made: &ScanFile) -> Result<Vec<SurfacePoint>> {
    let picture = mesh.with_extension("png");
    if !picture.is_file() {
        return Ok(Vec::new());
    }
    let (size, rgb) = read_rgb(&picture)?;
    let scan_from_mesh = made.mesh_from_scan()?.inverse();
    let mut out = Vec::with_capacity(BORN);
    for ModelPart { mesh, uv, .. } in read_model(mesh)?.parts {
        let Some(uv) = uv else { continue };
        let uv: Vec<_> = mesh.faces.iter().map(|face| face.map(|v| uv[v as usize])).collect();
        let points = textured_points(&scan_from_mesh.mesh(&mesh), &uv, (size, &rgb), BORN);
        out.extend(points.iter().map(born_at));
    }
    Ok(out)
}
