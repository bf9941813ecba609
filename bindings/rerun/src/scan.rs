//! The scan: cameras with their photos, the points that they were found with, the Gaussians.

use anyhow::{Context, Result};
use drex_core::Pose;
use drex_core::capture::{Capture, Photo, PhotoOptions, Photos};
use drex_splat::Kind;
use drex_splat::io::read_gaussians;
use drex_twin::cameras::cameras_of;
use drex_twin::records::{SCAN, ScanFile};
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use nalgebra::{Point3, Similarity3, Translation3};
use re_sdk_types::archetypes::{EncodedImage, Pinhole, Points3D};
use re_sdk_types::components::MediaType;

use crate::recorder::{Recorder, point, transform};
use crate::twin::Twin;

/// Longest side of a photo, pixels.
const PHOTO_SIDE: usize = 800;
const JPEG_QUALITY: u8 = 90;
/// A camera's picture is drawn this far from it, as a share of the reach of all cameras.
const PICTURE_AT: f64 = 0.1;
/// Size of a sparse point, metres.
const POINT_M: f32 = 0.0005;
/// Gaussians that let more light through are left out: as points they would hide what is behind them.
const LEAST_OPACITY: f32 = 0.1;
/// Degree 0 of the spherical harmonics, 1 / (2 √π).
const SH_C0: f32 = 0.282_094_79;

/// Records what the manifest's `[scan]` led to.
pub fn record(recorder: &Recorder, twin: &mut Twin) -> Result<()> {
    let Some(config) = twin.folder.manifest.scan.clone() else {
        twin.missing.push("cameras and Gaussians: the manifest has no [scan], the mesh was given".into());
        return Ok(());
    };
    let placed = "cameras and Gaussians have no place in the world";
    let Some(file) = twin.record::<ScanFile>(SCAN, placed)? else { return Ok(()) };
    let s = file.mesh_from_scan().with_context(|| format!("{}: mesh_from_scan", twin.folder.path(SCAN).display()))?;
    let mesh_from_scan = Similarity3::from_parts(Translation3::from(s.translation), s.rotation, s.scale);
    let world_from_scan = twin.world_from_mesh * mesh_from_scan;
    match cameras_of(&twin.folder.path(&config.photos), &twin.folder.root) {
        Ok(capture) => {
            cameras(recorder, &capture, &world_from_scan)?;
            points(recorder, &capture, &world_from_scan)?;
        }
        Err(e) => twin.missing.push(format!("cameras: {e}")),
    }
    let Some(ply) = twin.made("splat/appearance.ply", "the Gaussians are not shown") else { return Ok(()) };
    let gaussians = read_gaussians(&ply, Kind::Ellipsoid)?.transformed(&world_from_scan)?;
    let gaussians = gaussians.filtered(|i| gaussians.opacity(i) >= LEAST_OPACITY);
    let colors = gaussians.sh.chunks_exact(gaussians.sh_stride()).map(|sh| {
        // A cast of a float saturates.
        [0, 1, 2].map(|k| (255.0 * (0.5 + SH_C0 * sh[k])).round() as u8)
    });
    // The radius of the ball that is as large as the ellipsoid of one standard deviation.
    let radii = gaussians.log_scales.iter().map(|s| (s.iter().sum::<f32>() / 3.0).exp());
    let splat = Points3D::new(gaussians.means.iter().copied()).with_colors(colors).with_radii(radii);
    recorder.fixed(&["world", "splat"], &splat)
}

/// Straightened photos at their cameras, numbered in the order of the photos' names.
fn cameras(recorder: &Recorder, capture: &Capture, world_from_scan: &Similarity3<f64>) -> Result<()> {
    let mut options = PhotoOptions::default();
    (options.max_side, options.memory_bytes) = (Some(PHOTO_SIDE), 0);
    let photos = Photos::new(capture, options)?;
    let picture_at_m = PICTURE_AT * capture.extent() * world_from_scan.scaling();
    let digits = photos.len().saturating_sub(1).to_string().len().max(2);
    for i in 0..photos.len() {
        let photo = photos.get(i)?;
        let number = format!("{i:0digits$}");
        let camera = &photo.camera;
        // Maps camera to world coordinates, the camera's own unit of length dropped.
        let world_from_camera: Pose = (world_from_scan * camera.camera_from_world.inverse()).isometry;
        recorder.fixed(&["world", "scan", "cameras", &number], &transform(&world_from_camera))?;
        let k =
            [[camera.fx as f32, 0.0, 0.0], [0.0, camera.fy as f32, 0.0], [camera.cx as f32, camera.cy as f32, 1.0_f32]];
        let pinhole = Pinhole::new(k)
            .with_resolution([camera.width as f32, camera.height as f32])
            .with_image_plane_distance(picture_at_m as f32);
        let entity = ["world", "scan", "cameras", number.as_str(), "photo"];
        recorder.fixed(&entity, &pinhole)?;
        let jpeg = jpeg(&photo).with_context(|| format!("photo {}", photos.name(i)))?;
        recorder.fixed(&entity, &EncodedImage::new(jpeg).with_media_type(MediaType::JPEG))?;
    }
    Ok(())
}

fn jpeg(photo: &Photo) -> Result<Vec<u8>> {
    let (width, height) = (u32::try_from(photo.camera.width)?, u32::try_from(photo.camera.height)?);
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY);
    encoder.encode(photo.rgb.as_flattened(), width, height, ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

fn points(recorder: &Recorder, capture: &Capture, world_from_scan: &Similarity3<f64>) -> Result<()> {
    let sparse = &capture.points;
    let points = Points3D::new(sparse.iter().map(|p| point(&(world_from_scan * Point3::from(p.position)))))
        .with_colors(sparse.iter().map(|p| p.rgb))
        .with_radii([POINT_M]);
    recorder.fixed(&["world", "scan", "points"], &points)
}
