//! RGB-D recordings with poses of the object.

use std::path::Path;

use drex_core::capture::{Capture, CaptureOptions, PhotoOptions, Photos};
use image::{GrayImage, ImageBuffer, Luma, RgbImage};

const K: &str = "600 0 15.5\n0 610 11.5\n0 0 1\n";

/// Two frames of 32 x 24 pixels; the object is 0.4 m before the camera in both, turned in the second.
fn recording(folder: &Path) {
    for dir in ["rgb", "depth", "masks", "ob_in_cam"] {
        std::fs::create_dir(folder.join(dir)).unwrap();
    }
    std::fs::write(folder.join("cam_K.txt"), K).unwrap();
    let poses = ["1 0 0 0.01\n0 1 0 0\n0 0 1 0.4\n0 0 0 1", "0 0 1 0\n0 1 0 0\n-1 0 0 0.4\n0 0 0 1"];
    for (i, pose) in poses.iter().enumerate() {
        let at = |dir: &str, ending: &str| folder.join(format!("{dir}/00000{i}.{ending}"));
        std::fs::write(at("ob_in_cam", "txt"), pose).unwrap();
        RgbImage::from_pixel(32, 24, image::Rgb([90, 80, 70])).save(at("rgb", "png")).unwrap();
        ImageBuffer::<Luma<u16>, _>::from_pixel(32, 24, Luma([400 + i as u16])).save(at("depth", "png")).unwrap();
        GrayImage::from_pixel(32, 24, Luma([255])).save(at("masks", "png")).unwrap();
    }
}

fn load(folder: &Path) -> drex_core::Result<Capture> {
    Capture::load(folder, &CaptureOptions::default())
}

#[test]
fn frames_have_the_pose_of_the_object_and_depth_in_metres() {
    let guard = tempfile::tempdir().unwrap();
    recording(guard.path());
    let capture = load(guard.path()).unwrap();
    assert_eq!(capture.views.len(), 2);
    let centre = nalgebra::Point3::new(0.0, 0.0, 0.0);
    assert!((capture.views[0].camera_from_world * centre - nalgebra::Point3::new(0.01, 0.0, 0.4)).norm() < 1e-12);
    // K counts from the middle of the first pixel.
    assert_eq!(capture.views[1].lens.principal_point_px(), nalgebra::Vector2::new(16.0, 12.0));
    let photos = Photos::new(&capture, PhotoOptions::default()).unwrap();
    let photo = photos.get(1).unwrap();
    assert!(photo.depth.as_ref().unwrap().iter().all(|&z| (z - 0.401).abs() < 1e-6));
    assert!(photo.mask.as_ref().unwrap().iter().all(|&m| m == 255));

    std::fs::remove_file(guard.path().join("ob_in_cam/000000.txt")).unwrap();
    let capture = load(guard.path()).unwrap();
    assert_eq!((capture.views.len(), capture.unregistered), (1, vec!["000000.png".to_string()]));
}

#[test]
fn what_is_missing_or_damaged_is_named() {
    let guard = tempfile::tempdir().unwrap();
    recording(guard.path());
    let said = |name: &str| load(guard.path()).map(|c| c.views.len()).unwrap_err().to_string().contains(name);
    std::fs::write(guard.path().join("cam_K.txt"), "600 0 15.5\n0 610").unwrap();
    assert!(said("camera matrix"));
    std::fs::write(guard.path().join("cam_K.txt"), K).unwrap();
    std::fs::write(guard.path().join("ob_in_cam/000001.txt"), "1 0 0 0\n0 1 0 x").unwrap();
    assert!(said("000001.txt") && said("`x` is not"));
    for i in 0..2 {
        std::fs::remove_file(guard.path().join(format!("ob_in_cam/00000{i}.txt"))).unwrap();
    }
    assert!(said("none of 2 frames has a pose"));
    std::fs::remove_dir(guard.path().join("ob_in_cam")).unwrap();
    assert!(said("no poses of the object"));
}

#[test]
fn the_real_recording_is_read() {
    let Some(tracks) = crate::shared("tracks") else { return };
    let mut options = CaptureOptions::default();
    let folder = tracks.join("visp_dragon");
    options.poses = Some(folder.join("ref_in_cam"));
    let capture = Capture::load(&folder, &options).unwrap();
    assert_eq!(capture.views.len(), 99);
    let photos = Photos::new(&capture, PhotoOptions::default()).unwrap();
    let depth = photos.get(50).unwrap().depth.clone().unwrap();
    let near = depth.iter().filter(|&&z| z > 0.3 && z < 1.5).count();
    assert!(near > depth.len() / 2, "{near}");
}
