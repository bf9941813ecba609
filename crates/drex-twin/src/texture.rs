//! The picture on the mesh of a scan.

use drex_core::TriMesh;
use drex_core::capture::{Capture, ViewReport};
use drex_mesh::{Similarity, Texture, TextureMap};
use drex_mvs::{TextureOptions, TextureReport, texture};

use crate::stereo::shown;
use crate::{Progress, Result};

/// Colours a mesh by the photos of its scan. `mesh_from_scan` maps the frame of `cameras` to that of the mesh; the report's texel is in metres.
///
/// Photos whose camera or mask is wrong have no say, nor have those without a mask where others have one.
///
/// # Errors
/// If a photo cannot be read, or none shows the mesh.
pub(crate) fn textured(
    mesh: &TriMesh,
    cameras: &Capture,
    mesh_from_scan: &Similarity,
    progress: &dyn Progress,
) -> Result<(TextureMap, TextureReport)> {
    let mut photos = cameras.clone();
    let masked = cameras.views.iter().any(|v| v.mask.is_some());
    let report = cameras.report()?;
    let misplaced = |v: &ViewReport| v.far || v.mask.as_ref().is_some_and(|m| m.misplaced);
    let mut good = report.views.iter().map(|v| !misplaced(v));
    photos.views.retain(|v| good.next().unwrap_or(true) && (!masked || v.mask.is_some()));
    let in_scan = mesh_from_scan.inverse().mesh(mesh);
    let made = texture(&in_scan, &photos, &TextureOptions::default(), &shown(progress))?;
    progress.end();
    let mut report = made.report;
    report.texel *= mesh_from_scan.scale;
    Ok((TextureMap { uv: made.uv, picture: Texture::new(made.png) }, report))
}
