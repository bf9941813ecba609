//! The picture on the mesh of a scan.

use drex_core::TriMesh;
use drex_core::capture::{Capture, ViewReport};
use drex_mesh::{Similarity, Texture, TextureMap};
use drex_mvs::{TextureOptions, TextureReport, texture};

use crate::stereo::shown;
use crate::{Progress, Result};

/// Colours a mesh by the photos of its scan. `mesh_from_scan` maps the frame of `cameras` to that of the mesh; the report's texel is in metres.
///
/// Photos whose camera or mask is wrong have no say, nor have those without a mask where others have one. Where it fails a note says why, and there
/// is none: mesh and mass do not depend on it.
pub(crate) fn textured(
    mesh: &TriMesh,
    cameras: &Capture,
    mesh_from_scan: &Similarity,
    progress: &dyn Progress,
) -> Option<(TextureMap, TextureReport)> {
    let made = made(mesh, cameras, mesh_from_scan, progress);
    made.inspect_err(|e| progress.note(&format!("the asset has no texture: {e}"))).ok()
}

fn made(
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

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    struct Notes(Mutex<Vec<String>>);

    impl Progress for Notes {
        fn note(&self, text: &str) {
            self.0.lock().unwrap().push(text.to_owned());
        }
    }

    #[test]
    fn an_asset_goes_without_a_texture_that_cannot_be_made_and_a_note_says_why() {
        let corners = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
        let mesh = drex_core::mesh::convex_hull(&corners.map(nalgebra::Point3::from)).unwrap();
        let nobody = Capture {
            folder: "photos".into(),
            views: Vec::new(),
            points: Vec::new(),
            unregistered: Vec::new(),
            notes: Vec::new(),
        };
        let same = Similarity::from_matrix(&nalgebra::Matrix4::identity()).unwrap();
        let notes = Notes(Mutex::default());
        assert!(textured(&mesh, &nobody, &same, &notes).is_none());
        let notes = notes.0.into_inner().unwrap();
        assert!(notes.len() == 1 && notes[0].starts_with("the asset has no texture: "), "{notes:?}");
    }
}
