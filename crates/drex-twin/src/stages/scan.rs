//! Photos to the object's mesh.

use std::path::PathBuf;

use crate::Result;
use crate::cameras::cameras_within;
use crate::error::Context;
use drex_core::capture::{Capture, CaptureOptions};
use drex_mesh::{KnownDistance, write_evidence, write_mesh};
use nalgebra::Point3;

use crate::Progress;
use crate::Twin;
use crate::masks::MASKS;
use crate::records::{SCAN, ScanFile, write_json};
use crate::scan::{FrameOptions, Meshed, Scanning, remove_depth_maps};

/// The mesh with what is known of each vertex.
const EVIDENCE: &str = "splat/evidence.ply";

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let config = twin.manifest.scan.as_ref().context("the manifest has no [scan]")?;
    // Before hours of work; the manifest may name a place outside.
    let file = twin.output(&twin.manifest.object.mesh).with_context(|| {
        format!("{}: mesh under [object], to which the scan is written", twin.path("twin.toml").display())
    })?;
    // Depth maps that an earlier run made of other photos must not be taken for these; a folder of somebody else's stays.
    let (depth, sfm) = (twin.output("depth")?, twin.output("sfm")?);
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
        on_gpu: false,
        seed: twin.seed,
        tool_limit: twin.tool_limit,
    };
    let Meshed { scan, fused, gaps, refinement, mesh, evidence, masks, .. } = scanning.mesh(progress)?;
    write_mesh(&file, &mesh)?;
    let of_vertices = twin.output(EVIDENCE)?;
    write_evidence(&of_vertices, &mesh, &fused.evidence_of(&mesh))?;
    let made_masks = masks.is_some();
    let found =
        ScanFile { scan: scan.frame, made_masks, fusion: fused.report, gaps, refinement, evidence: Some(evidence) };
    let record = twin.output(SCAN)?;
    write_json(&record, &found)?;
    let masks = masks.map(|_| twin.output(MASKS)).transpose()?;
    Ok([sfm, record, of_vertices, depth, file].into_iter().chain(masks).filter(|f| f.exists()).collect())
}

/// The photos of a twin's scan with their cameras and the masks that its mesh was made with.
///
/// # Errors
/// If the scan was not made, or a file is damaged.
pub(crate) fn photos_of(twin: &Twin, made: &ScanFile) -> Result<Capture> {
    let config = twin.manifest.scan.as_ref().context("the manifest has no [scan]")?;
    let mut within = CaptureOptions::default();
    within.masks = config.masks.as_ref().map(|masks| twin.path(masks));
    let mut photos = cameras_within(&twin.path(&config.photos), &twin.root, &within)?;
    if made.made_masks {
        for view in &mut photos.views {
            view.mask = Some(twin.path(MASKS).join(format!("{}.png", view.name)));
        }
    }
    Ok(photos)
}
