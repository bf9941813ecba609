//! Photos to the object's mesh and Gaussians on it.

use std::path::PathBuf;

use crate::Result;
use crate::error::Context;
use crate::reconstruct::train_gaussians;
use drex_core::capture::{Capture, SparsePoint};
use drex_mesh::{KnownDistance, write_mesh};
use drex_splat::ReconstructOptions;
use drex_splat::reconstruct::Reconstruction;
use nalgebra::Point3;

use crate::Progress;
use crate::Twin;
use crate::masks::MASKS;
use crate::records::{SCAN, ScanFile, write_json};
use crate::scan::{FrameOptions, Meshed, Scanning, remove_depth_maps};

/// Gaussians that are born on the mesh.
const BORN: usize = 4000;
/// Every so many photos one is not trained on but measured against.
const HOLD_OUT: usize = 8;

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let config = twin.manifest.scan.as_ref().context("the manifest has no [scan]")?;
    // Before hours of work; the manifest may name a place outside.
    let file = twin.output(&twin.manifest.object.mesh).with_context(|| {
        format!("{}: mesh under [object], to which the scan is written", twin.path("twin.toml").display())
    })?;
    // Depth maps that an earlier run made of other photos must not be taken for these; a folder of somebody else's stays.
    let (depth, splat, sfm) = (twin.output("depth")?, twin.output("splat")?, twin.output("sfm")?);
    if !twin.path(&config.photos).starts_with(&depth) {
        remove_depth_maps(&twin.root)?;
    }
    let known =
        |(from, to, distance_m): (&str, &str, f64)| KnownDistance { from: from.into(), to: to.into(), distance_m };
    let input = twin.path(&config.photos);
    let scanning = Scanning {
        input: &input,
        out: &twin.root,
        masks: config.masks.as_ref().map(|masks| twin.path(masks)),
        poses: None,
        frame: FrameOptions {
            scale: config.scale,
            distances: config.distances().map(known).collect(),
            region: config.region.map(|corners| corners.map(Point3::from)),
            object: config.object.clone(),
            seed: twin.seed,
            ..FrameOptions::default()
        },
        voxel_m: None,
        marker: config.marker(),
        colmap: None,
        preset: config.preset,
        seed: twin.seed,
        tool_limit: twin.tool_limit,
    };
    let Meshed { scan, fused, mesh, evidence, cameras, masks } = scanning.mesh(progress)?;
    let fusion = fused.report;
    write_mesh(&file, &mesh)?;
    let photos = cameras.views.iter().any(|v| v.depth.is_none());
    let on_mesh = photos.then(|| scan.points_on(&mesh, BORN, twin.seed, fusion.truncation_m)).transpose()?;
    write_json(&twin.output(SCAN)?, &ScanFile { scan: scan.frame, fusion, evidence: Some(evidence) })?;
    if let Some(on_mesh) = on_mesh {
        let made = appearance(twin, &cameras, on_mesh, progress)?;
        twin.took("appearance", made.appearance.seconds);
    }
    let masks = masks.map(|_| twin.output(MASKS)).transpose()?;
    Ok([sfm, splat, depth, file].into_iter().chain(masks).filter(|f| f.exists()).collect())
}

/// Trains Gaussians that show what the photos show, born on the sparse points and on these.
fn appearance(
    twin: &Twin,
    cameras: &Capture,
    on_mesh: Vec<SparsePoint>,
    progress: &dyn Progress,
) -> Result<Reconstruction> {
    let config = twin.manifest.scan.as_ref().context("the manifest has no [scan]")?;
    let mut options = ReconstructOptions::default();
    options.preset = config.preset.of_training();
    (options.iterations, options.seed, options.surface) = (config.iterations, twin.seed, false);
    options.hold_out = Some(HOLD_OUT);
    let mut born = cameras.clone();
    born.points.extend(on_mesh);
    Ok(train_gaussians(&born, &twin.root, &options, false, progress)?.1)
}
