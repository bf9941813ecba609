//! What is written is read again: COLMAP models and transforms.json.

use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use drex_core::capture::{Capture, CaptureOptions, Keypoint, SparsePoint};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use crate::capture_support::{Model, grey, lens, on_disk, ring};

const FILES: [&str; 3] = ["cameras.bin", "images.bin", "points3D.bin"];

fn load(folder: &Path) -> Capture {
    Capture::load(folder, &CaptureOptions::default()).unwrap()
}

/// A capture as it was read from a model of `model`'s lens.
fn capture(model: CameraModel, views: usize) -> (tempfile::TempDir, PathBuf, Capture) {
    let (guard, folder) = on_disk(&ring(&lens(model), views, 30));
    let capture = load(&folder);
    std::fs::remove_dir_all(folder.join("sparse")).unwrap();
    (guard, folder, capture)
}

/// Writing rounds a rotation once more; nothing else may change.
fn assert_same(a: &Capture, b: &Capture) {
    assert_eq!(a.views.len(), b.views.len());
    let mut posed = a.clone();
    for (view, other) in posed.views.iter_mut().zip(&b.views) {
        let off = (view.camera_from_world.to_homogeneous() - other.camera_from_world.to_homogeneous()).abs().max();
        assert!(off < 1e-14, "{}: {off}", view.name);
        view.camera_from_world = other.camera_from_world;
    }
    assert_eq!(posed, *b);
}

#[test]
fn a_model_is_read_as_it_was_written() {
    for model in CameraModel::ALL {
        let (_guard, folder, capture) = capture(model, 5);
        let sparse = folder.join("sparse/0");
        capture.write_colmap(&sparse).unwrap();
        let again = load(&folder);
        assert_same(&capture, &again);
        let bytes = FILES.map(|name| std::fs::read(sparse.join(name)).unwrap());
        capture.write_colmap(&sparse).unwrap();
        assert_eq!(bytes, FILES.map(|name| std::fs::read(sparse.join(name)).unwrap()));
        assert_eq!(std::fs::read_dir(&sparse).unwrap().count(), 3);
    }
}

#[test]
fn the_bytes_are_those_of_colmaps_layout() {
    // Another writer, that of the tests, with the ids that are to come out, and two lenses.
    let mut model = ring(&lens(CameraModel::OpenCv), 4, 20);
    model.cameras = vec![(1, lens(CameraModel::SimpleRadial)), (2, lens(CameraModel::OpenCv))];
    for (i, image) in model.images.iter_mut().enumerate() {
        (image.id, image.camera) = (i as u32 + 1, [1, 2, 2, 1][i]);
        // Turns that nothing rounds.
        let turn = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5], [0.5, -0.5, 0.5, -0.5]][i];
        image.camera_from_world = drex_core::pose::pose_from_wxyz([0.1, -0.2, i as f64], turn).unwrap();
    }
    for (i, point) in model.points.iter_mut().enumerate() {
        let old = point.id as i64;
        point.id = i as u64 + 1;
        let seen = model.images.iter_mut().flat_map(|image| &mut image.keypoints).filter(|k| k.2 == old);
        seen.for_each(|k| k.2 = -100 - point.id as i64);
    }
    model.images.iter_mut().flat_map(|i| &mut i.keypoints).filter(|k| k.2 < -1).for_each(|k| k.2 = -100 - k.2);
    for point in &mut model.points {
        point.track.iter_mut().for_each(|(image, _)| *image = (*image - 9) / 4 + 1);
    }
    let (_guard, folder) = on_disk(&model);
    let mut capture = load(&folder);
    assert!(capture.notes.is_empty(), "{:?}", capture.notes);
    // The order of the views in memory is not that of the ids.
    capture.views.reverse();
    for point in &mut capture.points {
        point.track.clear();
    }
    let out = folder.join("again");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("rigs.bin"), b"of another model").unwrap();
    capture.write_colmap(&out).unwrap();
    for name in FILES {
        let [a, b] = ["sparse/0", "again"].map(|place| std::fs::read(folder.join(place).join(name)).unwrap());
        assert!(a == b, "{name}");
    }
    assert!(!out.join("rigs.bin").exists());
}

#[test]
fn what_makes_no_model_is_refused() {
    let (_guard, folder, sound) = capture(CameraModel::OpenCv, 3);
    let out = folder.join("sparse/0");
    let refusal = |edit: &dyn Fn(&mut Capture)| {
        let mut capture = sound.clone();
        edit(&mut capture);
        [capture.write_colmap(&out), capture.write_transforms(&folder.join("transforms.json"))]
            .map(|r| r.err().map(|e| e.to_string()).unwrap_or_default())
    };
    let refuse = |edit: &dyn Fn(&mut Capture), reasons: [&str; 2]| {
        let messages = refusal(edit);
        for (message, reason) in messages.iter().zip(reasons) {
            assert!(message.contains(reason) && message.is_empty() == reason.is_empty(), "{message}");
        }
    };
    refuse(&|c| c.views.clear(), ["no view"; 2]);
    refuse(&|c| c.views[1].name = c.views[0].name.clone(), ["two cameras are of the same photo, view 00.png", ""]);
    refuse(&|c| c.views[1].name = "a\0b".into(), ["is no name", ""]);
    refuse(&|c| c.views[2].keypoints[1].point = Some(30), ["keypoint 1 of view 02.png sees point 30 of 30", ""]);
    refuse(&|c| c.views[2].keypoints[0].x = f64::NAN, ["keypoint of view 02.png is not finite", ""]);
    refuse(&|c| c.views[2].camera_from_world.translation.x = f64::INFINITY, ["not finite"; 2]);
    refuse(&|c| c.points[4].position[1] = f64::NAN, ["point 4"; 2]);
    refuse(&|c| c.views[1].lens = lens(CameraModel::Fov), ["", "the FOV lens of view 01.png has no form"]);
    let before = std::fs::read(out.join("images.bin")).unwrap();
    refuse(&|c| c.points[4].error_px = f64::NAN, ["point 4", ""]);
    assert_eq!(before, std::fs::read(out.join("images.bin")).unwrap());
    // A file is where the folder should be.
    std::fs::write(folder.join("taken"), b"").unwrap();
    assert!(sound.write_colmap(&folder.join("taken")).unwrap_err().to_string().contains("taken"));
}

/// The parameters of OpenCV's lens, or of its fisheye, that say the same as the lens of each model.
fn as_opencv(lens: &Camera) -> Option<Camera> {
    let (f, c, p) = (lens.focal_px(), lens.principal_point_px(), lens.params());
    let bent = |model, bent: &[f64]| Some((model, [&[f.x, f.y, c.x, c.y], bent].concat()));
    let (model, params) = match lens.model() {
        CameraModel::SimplePinhole | CameraModel::Pinhole => bent(CameraModel::OpenCv, &[0.0; 4])?,
        CameraModel::SimpleRadial => bent(CameraModel::OpenCv, &[p[3], 0.0, 0.0, 0.0])?,
        CameraModel::Radial => bent(CameraModel::OpenCv, &[p[3], p[4], 0.0, 0.0])?,
        CameraModel::OpenCv | CameraModel::OpenCvFisheye => (lens.model(), p.to_vec()),
        CameraModel::SimpleRadialFisheye => bent(CameraModel::OpenCvFisheye, &[p[3], 0.0, 0.0, 0.0])?,
        CameraModel::RadialFisheye => bent(CameraModel::OpenCvFisheye, &[p[3], p[4], 0.0, 0.0])?,
        _ => return None,
    };
    Some(Camera::new(model, lens.width_px(), lens.height_px(), &params).unwrap())
}

/// What transforms.json keeps of a capture.
fn assert_kept(a: &Capture, b: &Capture) {
    assert_eq!(a.views.len(), b.views.len());
    for (a, b) in a.views.iter().zip(&b.views) {
        assert_eq!((&a.name, &a.photo, &a.mask), (&b.name, &b.photo, &b.mask));
        assert_eq!((&a.depth, &a.confidence), (&b.depth, &b.confidence));
        assert_eq!(as_opencv(&a.lens), Some(b.lens.clone()), "{}", a.name);
        let pixel = |lens: &Camera| lens.project(&Point3::new(0.1, -0.2, 1.0)).unwrap();
        assert!((pixel(&a.lens) - pixel(&b.lens)).norm() < 1e-9);
        let off = (a.camera_from_world.to_homogeneous() - b.camera_from_world.to_homogeneous()).abs().max();
        assert!(off < 1e-12, "{}: {off}", a.name);
    }
    let sparse = |c: &Capture| c.points.iter().map(|p| (p.position, p.rgb)).collect::<Vec<_>>();
    assert_eq!(sparse(a), sparse(b));
}

#[test]
fn transforms_are_read_as_they_were_written() {
    for model in CameraModel::ALL {
        let (_guard, folder, mut capture) = capture(model, 4);
        let file = folder.join("transforms.json");
        if as_opencv(&capture.views[0].lens).is_none() {
            let message = capture.write_transforms(&file).unwrap_err().to_string();
            assert!(message.contains(model.name()), "{message}");
            continue;
        }
        let of_first = ["masks/view 00.png", "elsewhere/depth/view 00.png", "elsewhere/confidence 00.png"];
        let [mask, depth, confidence] = of_first.map(|name| folder.join(name));
        [&mask, &depth, &confidence].iter().for_each(|path| grey(path, 160, 120));
        let first = &mut capture.views[0];
        (first.mask, first.depth, first.confidence) = (Some(mask), Some(depth), Some(confidence));
        capture.write_transforms(&file).unwrap();
        assert_kept(&capture, &load(&folder));
        let text = std::fs::read_to_string(&file).unwrap();
        // One lens is said once, and every path starts at the file.
        assert_eq!(text.matches("fl_x").count(), 1, "{text}");
        assert!(text.contains("\"file_path\": \"images/view 00.png\"") && !text.contains(folder.to_str().unwrap()));
        let points = std::fs::read(folder.join("sparse_pc.ply")).unwrap();
        capture.write_transforms(&file).unwrap();
        assert_eq!(text, std::fs::read_to_string(&file).unwrap());
        assert_eq!(points, std::fs::read(folder.join("sparse_pc.ply")).unwrap());
        // A lens and a model of its own for one view; no points.
        capture.points.clear();
        capture.views[2].lens = lens(CameraModel::OpenCvFisheye);
        capture.views[3].lens = lens(CameraModel::Radial).clone();
        capture.write_transforms(&file).unwrap();
        assert_kept(&capture, &load(&folder));
    }
}

#[test]
fn a_file_elsewhere_finds_its_photos() {
    let (_guard, folder, capture) = capture(CameraModel::OpenCv, 3);
    capture.write_transforms(&folder.join("out/deep/transforms.json")).unwrap();
    let mut options = CaptureOptions::default();
    let found = Capture::load(&folder.join("out/deep"), &options).unwrap();
    assert_eq!(
        found.views.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(),
        ["view 00.png", "view 01.png", "view 02.png"]
    );
    let again = [&found.views[1].photo, &capture.views[1].photo].map(|p| p.canonicalize().unwrap());
    assert_eq!(again[0], again[1]);
    options.images = Some(folder.join("images"));
    capture.write_colmap(&folder.join("out/model")).unwrap();
    assert_eq!(Capture::load(&folder.join("out/model"), &options).unwrap().views, capture.views);
}

/// Any capture that holds together, over photos that are there.
fn captures(folder: PathBuf) -> impl Strategy<Value = Capture> {
    let pose = (prop::array::uniform3(-9.0..9.0f64), prop::array::uniform3(-3.0..3.0f64));
    let keypoint = (-20.0..200.0f64, -20.0..200.0f64, prop::option::of(0..12usize));
    let view = (pose, 0..3usize, prop::collection::vec(keypoint, 0..20));
    let point = (prop::array::uniform3(-5.0..5.0f64), any::<[u8; 3]>(), 0.0..9.0f64);
    let parts = (prop::collection::vec(view, 1..5), prop::collection::vec(point, 12));
    let lenses = [CameraModel::SimpleRadial, CameraModel::OpenCv, CameraModel::OpenCvFisheye].map(lens);
    parts.prop_map(move |(views, points)| {
        let mut capture = load(&folder);
        capture.views.truncate(views.len());
        let of = |(position, rgb, error_px)| SparsePoint { position, rgb, error_px, track: Vec::new() };
        capture.points = points.into_iter().map(of).collect();
        for (i, ((t, r), lens, keypoints)) in views.into_iter().enumerate() {
            let view = &mut capture.views[i];
            view.camera_from_world =
                Pose::from_parts(Vector3::from(t).into(), UnitQuaternion::from_scaled_axis(Vector3::from(r)));
            view.lens = lenses[lens].clone();
            view.keypoints = keypoints.into_iter().map(|(x, y, point)| Keypoint { x, y, point }).collect();
            for (k, keypoint) in view.keypoints.iter().enumerate() {
                if let Some(point) = keypoint.point {
                    capture.points[point].track.push((i, k));
                }
            }
        }
        let names: Vec<_> = load(&folder).views.into_iter().skip(capture.views.len()).map(|v| v.name).collect();
        capture.unregistered = names;
        capture
    })
}

#[test]
fn any_capture_comes_back() {
    let four: Model = ring(&lens(CameraModel::OpenCv), 4, 0);
    let (_guard, folder) = on_disk(&four);
    let model = folder.join("sparse/0");
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig::with_cases(64));
    let strategy = captures(folder.clone());
    runner
        .run(&strategy, |capture| {
            let kept = FILES.map(|name| std::fs::read(model.join(name)).unwrap());
            capture.write_colmap(&model).unwrap();
            assert_same(&capture, &load(&folder));
            // transforms.json beside a model is not read: in a folder of its own.
            let file = folder.join("other/transforms.json");
            capture.write_transforms(&file).unwrap();
            let found = load(&folder.join("other"));
            assert_eq!(found.views.len(), capture.views.len());
            for (a, b) in capture.views.iter().zip(&found.views) {
                let off = (a.camera_from_world.to_homogeneous() - b.camera_from_world.to_homogeneous()).abs().max();
                assert!(off < 1e-12, "{off}");
                assert_eq!(as_opencv(&a.lens), Some(b.lens.clone()));
            }
            assert_eq!(found.points.len(), 12);
            FILES.iter().zip(kept).for_each(|(name, bytes)| std::fs::write(model.join(name), bytes).unwrap());
            Ok(())
        })
        .unwrap();
}

#[test]
fn a_real_model_comes_back() {
    let Some(scans) = crate::shared("scans") else { return };
    for name in ["mouse56", "flowerpot"] {
        let folder = scans.join(name);
        let capture = load(&folder);
        let out = tempfile::tempdir().unwrap();
        capture.write_colmap(out.path()).unwrap();
        let mut options = CaptureOptions::default();
        options.images = Some(folder.join("images"));
        let mut again = Capture::load(out.path(), &options).unwrap();
        // Masks and maps were looked up beside the model.
        again.folder.clone_from(&capture.folder);
        for (a, b) in again.views.iter_mut().zip(&capture.views) {
            a.mask.clone_from(&b.mask);
        }
        again.notes.clone_from(&capture.notes);
        assert_same(&capture, &again);
    }
}
