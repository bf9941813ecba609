//! Photos of scenes with exactly known cameras: right poses, or a verdict with the right cause.

use std::path::Path;

use drex_core::Pose;
use drex_core::camera::Camera;
use drex_core::capture::{Capture, CaptureOptions, find_mask, photos_in};
use drex_core::pose::pose_from_wxyz;
use drex_core::stats::upper_median;
use drex_sfm::{Cause, InputPhoto, RegisterOptions, Registration, Verdict, register};
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

use crate::capture::kinds::{Kind, Size, plan};
use crate::capture::write::jpeg;

/// A capture on disk, and the true pose of each photo; of each scene where it shows several.
struct Rendered {
    folder: tempfile::TempDir,
    photos: Vec<InputPhoto>,
    truth: Vec<Vec<(String, Pose)>>,
}

fn rendered(kind: Kind, seed: u64, photos: usize, side: u32) -> Rendered {
    let size = Size { photos, width_px: side, height_px: side / 4 * 3 };
    let capture = plan(kind, seed, &size).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut truth = vec![Vec::new(); capture.scenes.len()];
    let mut inputs = Vec::new();
    for (k, (scene, shot)) in capture.shots.iter().enumerate() {
        let path = folder.path().join(&shot.name);
        let photo = capture.take(k);
        let bytes = jpeg(&photo.rgb, capture.sensor.jpeg_quality, capture.exif.as_ref()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        let mask = capture.with_masks.then(|| {
            let path = path.with_extension("mask.png");
            photo.mask.save(&path).unwrap();
            path
        });
        truth[*scene].push((shot.name.clone(), shot.camera_from_object));
        inputs.push(InputPhoto { name: shot.name.clone(), path, mask });
    }
    inputs.sort_by(|a, b| a.name.cmp(&b.name));
    Rendered { folder, photos: inputs, truth }
}

fn run(photos: &[InputPhoto]) -> Result<Registration, Verdict> {
    register(photos, &RegisterOptions::default(), &|_| {})
}

/// How far a model is from the truth.
#[derive(Debug)]
struct Errors {
    paired: usize,
    /// Degrees.
    rotation: Vec<f64>,
    /// Share of the largest distance between two true cameras.
    position: Vec<f64>,
}

impl Errors {
    fn median_rotation(&self) -> f64 {
        upper_median(self.rotation.iter().copied()).unwrap()
    }

    fn median_position(&self) -> f64 {
        upper_median(self.position.iter().copied()).unwrap()
    }

    fn worst_position(&self) -> f64 {
        self.position.iter().copied().fold(0.0, f64::max)
    }
}

/// After one similarity (Umeyama 1991) of the centres.
fn errors(model: &Capture, truth: &[(String, Pose)]) -> Errors {
    let pairs: Vec<(Pose, Pose)> = model
        .views
        .iter()
        .filter_map(|v| truth.iter().find(|(n, _)| *n == v.name).map(|(_, p)| (v.camera_from_world, *p)))
        .collect();
    let centre = |p: &Pose| p.inverse().translation.vector;
    let n = pairs.len() as f64;
    let mean = |of: &dyn Fn(&(Pose, Pose)) -> Vector3<f64>| pairs.iter().map(of).sum::<Vector3<f64>>() / n;
    let (from, to) = (mean(&|p| centre(&p.0)), mean(&|p| centre(&p.1)));
    let mut covariance = Matrix3::zeros();
    let mut variance = 0.0;
    for (a, b) in &pairs {
        covariance += (centre(b) - to) * (centre(a) - from).transpose() / n;
        variance += (centre(a) - from).norm_squared() / n;
    }
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u.unwrap(), svd.v_t.unwrap());
    let sign = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
    let turn = u * Matrix3::from_diagonal(&sign) * v_t;
    let scale = svd.singular_values.dot(&sign) / variance;
    let centres: Vec<Point3<f64>> = pairs.iter().map(|p| centre(&p.1).into()).collect();
    let extent = centres.iter().flat_map(|a| centres.iter().map(move |b| (a - b).norm())).fold(0.0, f64::max);
    let turn = Rotation3::from_matrix_unchecked(turn);
    let of = |(a, b): &(Pose, Pose)| {
        let off = a.rotation.to_rotation_matrix() * turn.inverse() * b.rotation.inverse().to_rotation_matrix();
        let place = scale * (turn * (centre(a) - from)) + to;
        (off.angle().to_degrees(), (place - centre(b)).norm() / extent)
    };
    let (rotation, position) = pairs.iter().map(of).unzip();
    Errors { paired: pairs.len(), rotation, position }
}

fn cause(result: Result<Registration, Verdict>) -> Cause {
    match result {
        Ok(done) => panic!("{} models of {:?} photos", done.models.len(), done.models.first().map(|m| m.views.len())),
        Err(verdict) => {
            eprintln!("{verdict}");
            verdict.cause
        }
    }
}

#[test]
fn an_orbit_is_found_and_the_same_bytes_come_from_one_thread() {
    let set = rendered(Kind::Orbit, 31, 24, 560);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&set.photos)).unwrap()
    };
    let done = with(2);
    let off = errors(&done.models[0], &set.truth[0]);
    eprintln!("{} of 24, {:.4} deg, {:.5} of the extent", off.paired, off.median_rotation(), off.median_position());
    assert!(off.paired >= 23, "{off:?}");
    assert!(off.median_rotation() < 0.2 && off.median_position() < 0.003 && off.worst_position() < 0.01, "{off:?}");
    assert!(done.report.photos.iter().filter(|p| p.rotation_sd_deg.is_some_and(|s| s > 0.0 && s < 0.5)).count() >= 23);
    // Written, the models have the same bytes.
    let bytes = |done: &Registration| {
        let out = tempfile::tempdir().unwrap();
        done.models[0].write_colmap(out.path()).unwrap();
        ["cameras.bin", "images.bin", "points3D.bin"].map(|f| std::fs::read(out.path().join(f)).unwrap())
    };
    assert!(bytes(&done) == bytes(&with(1)), "one thread gives other bytes");
}

#[test]
#[ignore = "not yet: errors are 8 times the formal deviation where 19 small photos tell the principal point badly"]
fn the_stated_deviations_cover_the_errors() {
    let set = rendered(Kind::Orbit, 32, 24, 400);
    let done = run(&set.photos).unwrap();
    let off = errors(&done.models[0], &set.truth[0]);
    // A rotation error has three axes. Views and photos are both sorted by name, and what was left out has no deviation.
    let stated: Vec<f64> = done.report.photos.iter().filter_map(|p| p.rotation_sd_deg).collect();
    assert_eq!(stated.len(), off.paired);
    let ratios: Vec<f64> = off.rotation.iter().zip(&stated).map(|(e, s)| e / (3f64.sqrt() * s)).collect();
    let typical = upper_median(ratios.iter().copied()).unwrap();
    eprintln!("error over stated deviation: {typical:.2}, {ratios:.2?}");
    assert!((0.1..6.0).contains(&typical), "{ratios:?}");
}

#[test]
fn a_background_that_stands_still_is_left_out() {
    let mut set = rendered(Kind::Turntable, 133, 36, 640);
    set.photos.iter_mut().for_each(|p| p.mask = None);
    let done = run(&set.photos).unwrap();
    let share = done.report.still_background.expect("a background stands still");
    assert!(share > 0.4, "{share}");
    let off = errors(&done.models[0], &set.truth[0]);
    eprintln!("{} of 36, {:.3} deg, {:.4} of the extent", off.paired, off.median_rotation(), off.median_position());
    // The poses are those of the disc, not of the room, in which nothing moves.
    assert!(off.paired >= 33 && off.median_position() < 0.003 && off.worst_position() < 0.03, "{off:?}");
    assert!(done.report.notes.iter().any(|n| n.contains("relative to what turns")), "{:?}", done.report.notes);
}

#[test]
fn the_room_behind_a_turntable_is_no_model_of_the_object() {
    let set = rendered(Kind::Turntable, 37, 18, 400);
    // What is masked is not searched for a background that stands still; these show nothing else.
    for photo in &set.photos {
        let path = photo.mask.as_ref().unwrap();
        let mut mask = image::open(path).unwrap().into_luma8();
        image::imageops::invert(&mut mask);
        mask.save(path).unwrap();
    }
    let refused = run(&set.photos).unwrap_err();
    assert!(refused.cause == Cause::Inconsistent && refused.to_string().contains("stands still"), "{refused}");
}

#[test]
fn two_scenes_are_two_models() {
    let set = rendered(Kind::Two, 34, 24, 640);
    let done = run(&set.photos).unwrap();
    assert_eq!(done.models.len(), 2, "{:?}", done.report.notes);
    for model in &done.models {
        let scenes: Vec<usize> = set
            .truth
            .iter()
            .map(|t| model.views.iter().filter(|v| t.iter().any(|(n, _)| *n == v.name)).count())
            .collect();
        assert!(scenes.contains(&0) && model.views.len() >= 10, "a model has {scenes:?} photos of the two scenes");
    }
}

#[test]
fn causes_are_told_apart() {
    assert_eq!(cause(run(&[])), Cause::TooFewPhotos);
    assert_eq!(cause(run(&rendered(Kind::Few, 35, 2, 320).photos)), Cause::TooFewPhotos);
    assert_eq!(cause(run(&rendered(Kind::Apart, 35, 8, 400).photos)), Cause::NoOverlap);
    assert_eq!(cause(run(&rendered(Kind::Spin, 35, 16, 480).photos)), Cause::OnlyTurned);
    assert_eq!(cause(run(&rendered(Kind::Blur, 35, 12, 480).photos)), Cause::Blur);
    assert_eq!(cause(run(&rendered(Kind::Gloss, 35, 12, 480).photos)), Cause::TooFewPoints);
}

#[test]
fn what_cannot_be_read_is_left_out_by_name() {
    let mut set = rendered(Kind::Orbit, 36, 24, 400);
    let add = |photos: &mut Vec<InputPhoto>, name: &str, bytes: &[u8]| {
        let path = set.folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        photos.push(InputPhoto { name: name.into(), path, mask: None });
    };
    let whole = std::fs::read(&set.photos[0].path).unwrap();
    let mut photos = std::mem::take(&mut set.photos);
    add(&mut photos, "cut off.JPG", &whole[..whole.len() / 3]);
    add(&mut photos, "no picture.png", b"nothing of the kind");
    add(&mut photos, "empty.jpg", b"");
    let small = set.folder.path().join("mask.png");
    image::GrayImage::new(100, 10).save(&small).unwrap();
    photos[1].mask = Some(small);
    let done = run(&photos).unwrap();
    for name in ["no picture.png", "empty.jpg"] {
        let entry = done.report.photos.iter().find(|p| p.name == name).unwrap();
        assert!(
            entry.model.is_none() && entry.why_not.as_ref().is_some_and(|w| w.contains("cannot be read")),
            "{entry:?}"
        );
    }
    let masked = &done.report.photos[1];
    assert!(masked.why_not.as_ref().is_some_and(|w| w.contains("aspect")), "{masked:?}");
    assert!(done.models[0].views.len() >= 15);
}

/// Photos and true poses.
type Shared = (Vec<InputPhoto>, Vec<(String, Pose)>);

/// Photos of a shared set, and its true poses; `None`, with a word, without shared data.
fn shared(set: &str, truth: &str) -> Option<Shared> {
    let Some(shared) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: DREX_SHARED does not name the folder of shared data");
        return None;
    };
    let folder = Path::new(&shared).join("data/sfm").join(set);
    let options = CaptureOptions::default();
    let Some((_, files)) = photos_in(&folder, &options) else {
        eprintln!("skipped: {} is not there", folder.display());
        return None;
    };
    let photo = |f: drex_core::capture::PhotoFile| InputPhoto {
        mask: find_mask(&folder, &f.name, &options),
        name: f.name,
        path: f.path,
    };
    let text = std::fs::read_to_string(folder.join(truth).join("images.txt")).unwrap_or_default();
    let pose = |line: &str| {
        let f: Vec<&str> = line.split_whitespace().collect();
        let v: Vec<f64> = f.get(1..8)?.iter().filter_map(|v| v.parse().ok()).collect();
        let pose = pose_from_wxyz(v[4..].try_into().ok()?, v[..4].try_into().ok()?);
        Some(((*f.get(9)?).to_owned(), pose.ok()?))
    };
    Some((
        files.into_iter().map(photo).collect(),
        text.lines().filter(|l| !l.starts_with('#')).filter_map(pose).collect(),
    ))
}

#[test]
fn a_shared_set_of_another_renderer() {
    let Some((photos, truth)) = shared("plain50", "truth") else { return };
    let photos: Vec<InputPhoto> = photos.into_iter().step_by(2).collect();
    let done = run(&photos).unwrap();
    let off = errors(&done.models[0], &truth);
    eprintln!("{} of 25, {:.4} deg, {:.5}", off.paired, off.median_rotation(), off.median_position());
    assert!(
        off.paired >= 24 && off.median_rotation() < 0.05 && off.median_position() < 5e-4 && off.worst_position() < 5e-3
    );
    // A given calibration is kept as it is.
    let camera =
        Camera::from_colmap_name("OPENCV", 800, 600, &[640.0, 640.0, 400.0, 300.0, -0.06, 0.01, 0.0, 0.0]).unwrap();
    let mut options = RegisterOptions::default();
    options.calibration = Some(camera.clone());
    let given = register(&photos[..12], &options, &|_| {}).unwrap();
    assert!(given.models[0].views.iter().all(|v| (v.lens.focal_px() - camera.focal_px()).norm() < 1e-9));
}

#[test]
fn shared_sets_that_have_no_cameras() {
    for (set, expected) in [
        ("few2", Cause::TooFewPhotos),
        ("apart12", Cause::NoOverlap),
        ("spin16", Cause::OnlyTurned),
        ("blur20", Cause::Blur),
    ] {
        let Some((photos, _)) = shared(set, "truth") else { return };
        assert_eq!(cause(run(&photos)), expected, "{set}");
    }
}
