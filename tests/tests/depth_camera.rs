//! A real depth camera: frames of an RGB-D recording become a mesh.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

use std::path::PathBuf;

use drex_core::Surface;
use drex_mesh::{DepthCamera, DepthMap, EvidenceKind, FusionOptions, MeshSdf, Support, fuse, read_mesh};
use drex_splat::capture::{Capture, CaptureOptions, PhotoOptions, Photos};
use nalgebra::{Point3, Unit, Vector3};

/// The dragon of the recording, fused from its frames, lies within 2 mm of its reference mesh where it was seen.
#[test]
fn a_dragon_is_within_two_millimetres_of_its_reference() {
    let Some(shared) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: DREX_SHARED is not set");
        return;
    };
    let folder = PathBuf::from(shared).join("data/tracks/visp_dragon");
    let mut options = CaptureOptions::default();
    options.poses = Some(folder.join("ref_in_cam"));
    let capture = Capture::load(&folder, &options).unwrap();
    let mut one_at_a_time = PhotoOptions::default();
    one_at_a_time.memory_bytes = 0;
    let photos = Photos::new(&capture, one_at_a_time).unwrap();
    let view = |i: usize| {
        let photo = photos.get(i).unwrap();
        let c = &photo.camera;
        let camera = DepthCamera {
            width_px: c.width as u32,
            height_px: c.height as u32,
            fx_px: c.fx,
            fy_px: c.fy,
            cx_px: c.cx,
            cy_px: c.cy,
        };
        let depth_m = photo.depth.clone().unwrap();
        DepthMap { camera, world_from_camera: c.camera_from_world.inverse(), depth_m, mask: None }
    };
    let views: Vec<DepthMap> = (0..photos.len()).map(view).collect();

    let reference = MeshSdf::new(&read_mesh(&folder.join("mesh/dragon.obj")).unwrap()).unwrap();
    let (lo, hi) = reference.bounds();
    let margin = Vector3::repeat(0.005);
    let mut fusion = FusionOptions::default();
    fusion.region = Some((lo - margin, hi + margin));
    // It stands on a table, its y pointing up.
    fusion.support = Some(Support { point: Point3::new(0.0, lo.y, 0.0), up: Unit::new_unchecked(Vector3::y()) });
    let fused = fuse(&views, &fusion).unwrap();

    let seen = fused.mesh.vertices.iter().zip(&fused.evidence).filter(|(p, e)| {
        // Nearer to the table than the noise it is the table.
        e.kind == EvidenceKind::Seen && e.views >= 5 && e.best_cosine > 0.5 && p.y > lo.y + 0.008
    });
    let mut distances: Vec<f64> = seen.map(|(p, _)| (reference.nearest(p).point - p).norm()).collect();
    distances.sort_by(f64::total_cmp);
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    eprintln!(
        "{} vertices seen, off by {:.2} mm in the mean, {:.2} in the median, {:.2} at the 95th percentile; voxel {:.2} mm",
        distances.len(),
        1e3 * mean,
        1e3 * distances[distances.len() / 2],
        1e3 * distances[distances.len() * 95 / 100],
        1e3 * fused.report.voxel_m
    );
    assert!(distances.len() > 500 && mean < 2e-3, "{mean}");
}
