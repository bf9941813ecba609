//! A folder of rendered photos with a printed tag: models in metres, written, found again and replaced.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::capture::kinds::{Kind, Size, plan};
use crate::capture::write::jpeg;
use drex_core::capture::{Capture, CaptureOptions};
use drex_sfm::marker::{Family, Marker};
use drex_sfm::{FolderOptions, FolderRegistration, PhotoFolder, StoredReport, check_output, register_folder, remove};
use nalgebra::{Point3, Vector3};

const SIZE: Size = Size { photos: 16, width_px: 480, height_px: 360 };

/// Photos, where they were taken from, and the tag in them, centre and top of the sheet.
struct Rendered {
    folder: tempfile::TempDir,
    eyes: Vec<Point3<f64>>,
    marker: Marker,
    centre: Point3<f64>,
    yaw_rad: f64,
}

fn rendered() -> &'static Rendered {
    static RENDERED: OnceLock<Rendered> = OnceLock::new();
    RENDERED.get_or_init(|| {
        let planned = plan(Kind::Plain, 31, &SIZE).unwrap();
        let folder = tempfile::tempdir().unwrap();
        for (i, (_, shot)) in planned.shots.iter().enumerate() {
            let bytes = jpeg(&planned.take(i).rgb, planned.sensor.jpeg_quality, planned.exif.as_ref()).unwrap();
            std::fs::write(folder.path().join(&shot.name), bytes).unwrap();
        }
        let tag = planned.marker.as_ref().unwrap();
        let mut by_name: Vec<_> = planned.shots.iter().map(|(_, s)| (s.name.clone(), s.camera_from_object)).collect();
        by_name.sort_by(|a, b| a.0.cmp(&b.0));
        Rendered {
            folder,
            eyes: by_name.iter().map(|(_, pose)| pose.inverse().translation.vector.into()).collect(),
            marker: Marker::new(Family::Tag36h11, tag.id, tag.side_m).unwrap(),
            centre: tag.centre_m.into(),
            yaw_rad: tag.yaw_rad,
        }
    })
}

fn register(options: &FolderOptions) -> (PhotoFolder, FolderRegistration) {
    let folder = rendered().folder.path();
    let photos = PhotoFolder::read(folder, &CaptureOptions::default(), Path::new("nowhere")).unwrap();
    let registered = register_folder(&photos, options, &|_| ()).unwrap();
    (photos, registered)
}

#[test]
fn a_tag_gives_metres_up_and_origin_and_the_result_is_found_again() {
    let truth = rendered();
    let mut options = FolderOptions::default();
    options.marker = Some(truth.marker);
    let (photos, registered) = register(&options);
    let model = &registered.models[0];
    assert!(model.views.len() + 2 >= SIZE.photos, "{:?}", registered.report.registration.notes);
    let marker = registered.report.marker.as_ref().unwrap();
    assert!(marker.used >= 10 && marker.used <= marker.seen_in, "{marker:?}");
    // Where the cameras stand, seen from the tag: metres, z up, x to the right of the upright tag.
    let (sin, cos) = truth.yaw_rad.sin_cos();
    let all = &registered.report.registration.photos;
    let eye = |name: &str| &truth.eyes[all.iter().position(|p| p.name == name).unwrap()];
    for (found, eye) in model.centres().iter().zip(model.views.iter().map(|v| eye(&v.name))) {
        let d = eye - truth.centre;
        let expected = Vector3::new(cos * d.x + sin * d.y, -sin * d.x + cos * d.y, d.z);
        let off = (found.coords - expected).norm() / expected.norm();
        assert!(off < 0.01, "a camera is {:.2} % of its distance off: {found} for {expected}", 100.0 * off);
    }
    // A camera's sigma is in metres as well: a small part of its distance, not of the model's own unit.
    let sds: Vec<f64> = registered.report.registration.photos.iter().filter_map(|p| p.centre_sd).collect();
    assert!(sds.len() == model.views.len() && sds.iter().all(|sd| (1e-6..3e-3).contains(sd)), "{sds:?}");

    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    check_output(&out).unwrap();
    registered.write(&out).unwrap();
    let mut within = CaptureOptions::default();
    within.images = Some(photos.root.clone());
    let again = Capture::load_model(&out, &out.join("sparse"), &within).unwrap().unwrap();
    assert_eq!(again.points.len(), model.points.len());
    for (a, b) in again.views.iter().zip(&model.views) {
        assert!(a.name == b.name && (a.camera_from_world.inverse() * b.camera_from_world).rotation.angle() < 1e-7);
    }
    let stored = StoredReport::read(&out).unwrap().unwrap();
    assert!(stored.is_of(&photos, &options) && stored.marker.as_ref() == Some(marker));
    options.marker = None;
    assert!(stored.is_of(&photos, &options), "the cameras do not depend on the marker");
    options.register.seed = 5;
    assert!(!stored.is_of(&photos, &options));

    remove(&out).unwrap();
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0);
    remove(&out).unwrap();
    std::fs::create_dir_all(out.join("sparse/0")).unwrap();
    for refused in [check_output(&out), remove(&out), registered.write(&out)] {
        assert!(refused.unwrap_err().to_string().contains("did not write"));
    }
}

#[test]
fn a_wrong_id_says_which_tag_is_there() {
    let truth = rendered();
    let mut options = FolderOptions::default();
    options.marker = Some(Marker::new(Family::Tag36h11, (truth.marker.id + 1) % 587, 0.06).unwrap());
    let (_, registered) = register(&options);
    assert!(registered.report.marker.is_none());
    let notes = registered.report.registration.notes.join("\n");
    let shown = format!("they show tag {} (", truth.marker.id);
    for word in ["The model has no scale", "0 photos see it", &shown] {
        assert!(notes.contains(word), "`{word}` is missing in {notes}");
    }
}

#[test]
fn a_changed_photo_or_name_is_another_folder() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, value: u8| {
        image::GrayImage::from_pixel(40, 30, image::Luma([value])).save(dir.path().join(name)).unwrap();
    };
    write("a.png", 1);
    write("b.png", 2);
    let sum = || PhotoFolder::read(dir.path(), &CaptureOptions::default(), &PathBuf::from("out")).unwrap().sha256;
    let before = sum();
    assert_eq!(sum(), before);
    write("b.png", 3);
    let changed = sum();
    assert_ne!(changed, before);
    std::fs::rename(dir.path().join("b.png"), dir.path().join("c.png")).unwrap();
    assert_ne!(sum(), changed);
}
