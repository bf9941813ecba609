//! Photos to Gaussians and the object's mesh.

use std::path::PathBuf;

use crate::Result;
use crate::error::Context;
use crate::manifest::ScanPreset;
use drex_mesh::{KnownDistance, write_mesh};
use drex_splat::ReconstructOptions;
use drex_splat::train::Preset;
use nalgebra::Point3;

use crate::Progress;
use crate::Twin;
use crate::masks::MASKS;
use crate::records::{SCAN, ScanFile, write_json};
use crate::scan::{FrameOptions, Meshed, Scanning, remove_depth_maps};

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
    let mut reconstruct = ReconstructOptions::default();
    reconstruct.preset = match config.preset {
        ScanPreset::Fast => Preset::Fast,
        ScanPreset::Default => Preset::Default,
        ScanPreset::Best => Preset::Best,
    };
    (reconstruct.iterations, reconstruct.seed) = (config.iterations, twin.seed);
    reconstruct.hold_out = Some(HOLD_OUT);
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
        reconstruct,
        tool_limit: twin.tool_limit,
    };
    let Meshed { scan, fusion, mesh, evidence, made, masks } = scanning.mesh(progress)?;
    for (part, set) in made.iter().flat_map(|made| [("appearance", &made.appearance), ("surface", &made.surface)]) {
        twin.took(part, set.seconds);
    }
    write_mesh(&file, &mesh)?;
    write_json(&twin.output(SCAN)?, &ScanFile { scan: scan.frame, fusion, evidence: Some(evidence) })?;
    let masks = masks.map(|_| twin.output(MASKS)).transpose()?;
    Ok([sfm, splat, depth, file].into_iter().chain(masks).filter(|f| f.exists()).collect())
}
