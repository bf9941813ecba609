//! A real depth camera: frames of an RGB-D recording become a mesh.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

use std::path::PathBuf;

use drex_core::capture::{Capture, CaptureOptions, PhotoOptions, Photos};
use drex_core::mesh::sample_surface;
use drex_core::{Surface, SurfacePoint};
use drex_mesh::{DepthCamera, DepthMap, FusionOptions, MeshSdf, Support, cast_depth, fuse, read_mesh};
use nalgebra::{Point3, Unit, Vector3};

/// Where its views saw it, the reference mesh of the recorded dragon lies within 2 mm of the mesh fused from the frames.
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
        DepthMap { camera, world_from_camera: c.camera_from_world.inverse(), depth_m, mask: None, trust: None }
    };
    let views: Vec<DepthMap> = (0..photos.len()).map(view).collect();

    let dragon = read_mesh(&folder.join("mesh/dragon.obj")).unwrap();
    let (lo, hi) = dragon.bounds().unwrap();
    let margin = Vector3::repeat(0.005);
    let mut fusion = FusionOptions::default();
    fusion.region = Some((lo - margin, hi + margin));
    // It stands on a table, its y pointing up.
    fusion.support = Some(Support { point: Point3::new(0.0, lo.y, 0.0), up: Unit::new_unchecked(Vector3::y()) });
    let fused = fuse(&views, &fusion).unwrap();

    // The part of the reference that at least five views saw, at a slant of 60 degrees or less, clear of the table.
    let casts: Vec<DepthMap> = views.iter().map(|v| cast_depth(&dragon, &v.camera, &v.world_from_camera)).collect();
    let shows = |cast: &DepthMap, s: &SurfacePoint| {
        let p = cast.world_from_camera.inverse() * s.point;
        let facing = -(cast.world_from_camera.inverse() * s.normal).dot(&p.coords.normalize());
        let c = &cast.camera;
        let (u, v) = (c.fx_px * p.x / p.z + c.cx_px, c.fy_px * p.y / p.z + c.cy_px);
        let inside = u >= 0.0 && v >= 0.0 && u < f64::from(c.width_px) && v < f64::from(c.height_px);
        let depth = if inside { cast.depth_m[v as usize * c.width_px as usize + u as usize] } else { 0.0 };
        facing > 0.5 && (f64::from(depth) - p.z).abs() < 2e-3
    };
    let fused_surface = MeshSdf::new(&fused.mesh).unwrap();
    let mut distances: Vec<f64> = sample_surface(&dragon, 20_000, 1)
        .iter()
        .filter(|s| s.point.y > lo.y + 0.005 && casts.iter().filter(|cast| shows(cast, s)).count() >= 5)
        .map(|s| (fused_surface.nearest(&s.point).point - s.point).norm())
        .collect();
    distances.sort_by(f64::total_cmp);
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    eprintln!(
        "{} of 20000 points seen, off by {:.2} mm in the mean, {:.2} in the median, {:.2} at the 95th percentile; voxel {:.2} mm",
        distances.len(),
        1e3 * mean,
        1e3 * distances[distances.len() / 2],
        1e3 * distances[distances.len() * 95 / 100],
        1e3 * fused.report.voxel_m
    );
    assert!(distances.len() > 2000 && mean < 2e-3, "{mean}");
}
