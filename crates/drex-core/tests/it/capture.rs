//! Captures from COLMAP models: layouts, odd folders, and the real ones.

use std::path::Path;

use drex_core::camera::CameraModel;
use drex_core::capture::{Capture, CaptureOptions};
use nalgebra::Point3;

use crate::capture_support::{Model, grey, lens, on_disk, ring};

fn load(folder: &Path) -> drex_core::Result<Capture> {
    Capture::load(folder, &CaptureOptions::default())
}

fn refusal(folder: &Path) -> String {
    load(folder).unwrap_err().to_string()
}

fn simple() -> Model {
    ring(&lens(CameraModel::SimpleRadial), 6, 40)
}

#[test]
fn binary_and_text_say_the_same() {
    for model in CameraModel::ALL {
        let model = ring(&lens(model), 4, 20);
        let (_guard, folder) = on_disk(&model);
        let binary = load(&folder).unwrap();
        std::fs::remove_dir_all(folder.join("sparse/0")).unwrap();
        model.write_txt(&folder.join("sparse/0"));
        let text = load(&folder).unwrap();
        assert_eq!(binary, text);
        assert_eq!((binary.views.len(), binary.points.len()), (4, 20));
        assert_eq!(binary.notes, [""; 0]);
        for (view, image) in binary.views.iter().zip(&model.images) {
            assert_eq!(view.name, image.name);
            assert!((view.camera_from_world.inverse() * image.camera_from_world).translation.vector.norm() < 1e-12);
            assert_eq!(view.lens, model.cameras[0].1);
            assert_eq!(view.keypoints[0].point, None);
        }
        // Tracks and keypoints name each other, and the cameras see the points where the keypoints are.
        for (i, point) in binary.points.iter().enumerate() {
            assert!(!point.track.is_empty());
            for (view, k) in &point.track {
                let view = &binary.views[*view];
                let keypoint = view.keypoints[*k];
                assert_eq!(keypoint.point, Some(i));
                let pixel = view.lens.project(&(view.camera_from_world * Point3::from(point.position))).unwrap();
                assert!((pixel - Point3::new(keypoint.x, keypoint.y, 0.0).xy()).norm() < 1e-9);
            }
        }
        assert!(binary.report().unwrap().reprojection.unwrap().mean_px < 1e-9);
    }
}

#[test]
fn text_with_empty_second_lines() {
    let mut model = simple();
    model.images.iter_mut().for_each(|i| i.keypoints.clear());
    let (_guard, folder) = on_disk(&model);
    std::fs::remove_dir_all(folder.join("sparse/0")).unwrap();
    model.write_txt(&folder.join("sparse/0"));
    let text = std::fs::read_to_string(folder.join("sparse/0/images.txt")).unwrap();
    // The last empty line may be missing altogether.
    std::fs::write(folder.join("sparse/0/images.txt"), text.trim_end()).unwrap();
    let capture = load(&folder).unwrap();
    assert_eq!(capture.views.len(), 6);
    assert!(capture.views.iter().all(|v| v.keypoints.is_empty()));
    assert!(capture.points.iter().all(|p| p.track.is_empty()));
    // Each sighting that a track names and no keypoint confirms is said.
    assert!(capture.notes.iter().any(|n| n.contains("name a keypoint that sees another point")), "{:?}", capture.notes);
}

#[test]
fn files_and_images_that_do_not_match_are_named() {
    let mut model = simple();
    for (i, image) in model.images.iter_mut().enumerate() {
        image.name = format!("{}/{}", ["left", "right"][i % 2], image.name);
    }
    let (_guard, folder) = on_disk(&model);
    std::fs::remove_file(folder.join("images/right/view 03.png")).unwrap();
    grey(&folder.join("images/left/extra.jpg"), 160, 120);
    let capture = load(&folder).unwrap();
    let names: Vec<_> = capture.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(
        names,
        ["left/view 00.png", "left/view 02.png", "left/view 04.png", "right/view 01.png", "right/view 05.png"]
    );
    assert_eq!(capture.unregistered, ["left/extra.jpg"]);
    assert!(capture.notes[0].contains("1 image of the model") && capture.notes[0].contains("right/view 03.png"));
    assert!(capture.points.iter().all(|p| p.track.iter().all(|(v, k)| capture.views[*v].keypoints.len() > *k)));
    let report = capture.report().unwrap().to_string();
    assert!(report.starts_with("5 of 6 photos have a camera.\nWithout a camera: left/extra.jpg."), "{report}");

    std::fs::remove_dir_all(folder.join("images")).unwrap();
    let message = refusal(&folder);
    assert!(message.contains("none of the 6 photos") && message.contains("folder images"), "{message}");
}

#[test]
fn the_biggest_model_of_all_places() {
    let model = simple();
    for place in ["", "sparse", "sparse/0", "colmap/sparse/0"] {
        let (_guard, folder) = on_disk(&model);
        std::fs::remove_dir_all(folder.join("sparse")).unwrap();
        model.write_bin(&folder.join(place));
        assert_eq!(load(&folder).unwrap().views.len(), 6, "in `{place}`");
    }
    let (_guard, folder) = on_disk(&model);
    let mut small = model.clone();
    small.images.truncate(2);
    small.write_bin(&folder.join("sparse/0"));
    model.write_bin(&folder.join("sparse/1"));
    let capture = load(&folder).unwrap();
    assert_eq!(capture.views.len(), 6);
    assert!(capture.notes[0].contains("sparse/1 was used"), "{:?}", capture.notes);
}

#[test]
fn a_folder_without_cameras_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    grey(&folder.path().join("images/a.jpg"), 8, 8);
    let message = refusal(folder.path());
    assert!(
        message.contains("no COLMAP model, no transforms.json and no cam_K.txt") && message.contains("sparse/0"),
        "{message}"
    );
}

#[test]
fn photos_of_another_size_scale_their_camera() {
    let (_guard, folder) = on_disk(&simple());
    let before = load(&folder).unwrap();
    grey(&folder.join("images/view 02.png"), 80, 60);
    let capture = load(&folder).unwrap();
    let (small, large) = (&capture.views[2], &before.views[2]);
    assert_eq!(small.lens, large.lens.resized(80, 60).unwrap());
    assert_eq!((small.keypoints[3].x, small.keypoints[3].y), (large.keypoints[3].x / 2.0, large.keypoints[3].y / 2.0));
    assert!(capture.notes[0].contains("view 02.png"), "{:?}", capture.notes);
    assert!(capture.report().unwrap().reprojection.unwrap().mean_px < 1e-9);

    grey(&folder.join("images/view 02.png"), 160, 90);
    let message = refusal(&folder);
    assert!(message.contains("view 02.png has 160 x 90 pixels, its camera 160 x 120"), "{message}");
    grey(&folder.join("images/view 02.png"), 120, 160);
    assert!(refusal(&folder).contains("turned"));
}

#[test]
fn masks_are_found_and_checked() {
    let (_guard, folder) = on_disk(&simple());
    grey(&folder.join("masks/view 00.png"), 160, 120);
    grey(&folder.join("masks/view 01.jpg"), 80, 60);
    grey(&folder.join("masks/view 02.png.png"), 160, 120);
    let capture = load(&folder).unwrap();
    let has: Vec<_> = capture.views.iter().map(|v| v.mask.is_some()).collect();
    assert_eq!(has, [true, true, true, false, false, false]);
    assert!(capture.notes[0].starts_with("3 photos without a mask: view 03.png"), "{:?}", capture.notes);
    grey(&folder.join("masks/view 01.jpg"), 80, 80);
    let message = refusal(&folder);
    assert!(message.contains("the mask of view 01.png has 80 x 80 pixels, the photo 160 x 120"), "{message}");
}

#[test]
fn an_outlier_does_not_blow_the_extent() {
    let (_guard, folder) = on_disk(&ring(&lens(CameraModel::Pinhole), 12, 100));
    let mut capture = load(&folder).unwrap();
    assert!((capture.extent() - 1.1 * 4.0).abs() < 1e-9);
    let before = capture.extent();
    capture.views[3].camera_from_world.translation.vector *= 50.0;
    assert!((capture.extent() / before - 1.0).abs() < 0.12, "{}", capture.extent());
    let report = capture.report().unwrap();
    assert_eq!(report.outlier_cameras(), ["view 03.png"]);
    assert!(report.to_string().contains("view 03.png stands"), "{report}");
    capture.drop_views(&report.outlier_cameras());
    assert_eq!(capture.views.len(), 11);
    let sightings: usize = capture.points.iter().map(|p| p.track.len()).sum();
    for (i, point) in capture.points.iter().enumerate() {
        assert!(point.track.iter().all(|(view, k)| capture.views[*view].keypoints[*k].point == Some(i)));
    }
    assert_eq!(sightings, capture.views.iter().map(|v| v.keypoints.len() - 1).sum::<usize>());
    assert!(capture.report().unwrap().reprojection.unwrap().mean_px < 1e-9);
    // One camera alone: the scale of the scene is that of its points.
    capture.views.truncate(1);
    assert!((3.0..6.0).contains(&capture.extent()), "{}", capture.extent());
}

#[test]
fn the_report_knows_from_where_the_ring_looks() {
    let (_guard, folder) = on_disk(&ring(&lens(CameraModel::Pinhole), 12, 100));
    let mut capture = load(&folder).unwrap();
    let coverage = capture.report().unwrap().coverage.unwrap();
    assert!(Point3::from(coverage.centre).coords.norm() < 1e-6, "{coverage:?}");
    assert!((coverage.up[2] - 1.0).abs() < 1e-9);
    let elevation = 0.25f64.atan().to_degrees();
    assert!(
        (coverage.elevation_deg[0] - elevation).abs() < 1e-6 && (coverage.elevation_deg[1] - elevation).abs() < 1e-6
    );
    assert!((coverage.azimuth_gap_deg[1] - coverage.azimuth_gap_deg[0] - 30.0).abs() < 1e-6);
    assert!((coverage.emptiest_distance_deg - 90.0 - elevation).abs() < 3.0, "{coverage:?}");
    // A third of the ring is gone: views 1 to 4 at 30° to 120°.
    capture.views.drain(1..5);
    let gap = capture.report().unwrap().coverage.unwrap().azimuth_gap_deg;
    // Up is the mean of the cameras' own, so that a ring with a gap tilts it a little.
    assert!((gap[1] - gap[0] - 150.0).abs() < 5.0 && (gap[0] + 180.0).rem_euclid(360.0) - 180.0 < 5.0, "{gap:?}");
}

#[test]
fn real_captures_load() {
    let Some(scans) = crate::shared("scans") else { return };
    for (name, views, points, error) in
        [("alexander54", 54, 12161, 0.95), ("mouse56", 56, 4443, 0.40), ("flowerpot", 80, 16734, 0.60)]
    {
        let capture = load(&scans.join(name)).unwrap();
        assert_eq!((capture.views.len(), capture.points.len()), (views, points), "{name}");
        assert_eq!(capture.unregistered, [""; 0], "{name}");
        assert_eq!(capture.notes, [""; 0], "{name}");
        let report = capture.report().unwrap();
        let reprojection = report.reprojection.unwrap();
        assert!(reprojection.mean_px < error, "{name}: {reprojection:?}");
        assert!(report.views.iter().all(|v| !v.far), "{name}");
        let (few, lens): (Vec<_>, Vec<_>) = (
            report.views.iter().filter(|v| v.few_points).map(|v| v.name.as_str()).collect(),
            report.views.iter().filter(|v| v.other_lens).collect(),
        );
        match name {
            "alexander54" => assert_eq!((few, lens.len()), (vec!["DSC05103.jpg"], 0)),
            "mouse56" => assert_eq!((few.len(), lens.len()), (1, 3)), // focal lengths 452, 943 and 528 among 650 to 730
            _ => assert_eq!((few.len(), lens.len()), (0, 0)),
        }
    }
}
