//! Gaussians that show what the photos of the scan show, born on the mesh.

use std::path::PathBuf;

use drex_splat::ReconstructOptions;

use super::scan::photos_of;
use crate::born::{VISUAL, points_on};
use crate::error::Context;
use crate::reconstruct::train_gaussians;
use crate::records::{HELD_OUT, SCAN, SPLAT_REPORT, ScanFile, read_json};
use crate::{Progress, Result, Twin};

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
    let mut options = ReconstructOptions::default();
    options.born = points_on(&twin.path(VISUAL), &made)?;
    options.preset = config.preset.of_training();
    (options.iterations, options.seed, options.hold_out) = (config.iterations, twin.seed, Some(HOLD_OUT));
    train_gaussians(&photos, &twin.root, &options, false, progress)?;
    ["splat/appearance.ply", SPLAT_REPORT, HELD_OUT].into_iter().map(|name| twin.output(name)).collect()
}
