//! `drex sfm`: photos of the demo become cameras, odd folders a clear sentence.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{Run, drex, tree};
use drex_core::capture::{Capture, CaptureOptions};
use drex_core::{Pose, PoseRecord};
use drex_mesh::Similarity;
use image::{DynamicImage, ImageBuffer, Rgb};
use nalgebra::Point3;

/// The photo of this number of the demo; 0 to 17 are one round, 18 to 31 another.
pub fn demo_photo(i: usize) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/demo/scan/images/{i:02}.jpg"))
}

/// Where the demo's photos were taken from, metres, z up from the table.
pub fn true_cameras() -> Vec<Pose> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/demo/truth/world_from_camera.json");
    let poses: Vec<PoseRecord> = serde_json::from_slice(&fs::read(file).unwrap()).unwrap();
    poses.iter().map(|p| p.to_pose().unwrap()).collect()
}

/// A folder with the demo's photos of these numbers.
pub fn photos(numbers: impl IntoIterator<Item = usize>) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("photos")).unwrap();
    for i in numbers {
        fs::copy(demo_photo(i), dir.path().join(format!("photos/{i:02}.jpg"))).unwrap();
    }
    dir
}

fn sfm(dir: &Path, options: &[&str]) -> Run {
    let (photos, out) = (dir.join("photos"), dir.join("out"));
    let mut arguments = vec!["sfm", photos.to_str().unwrap(), "--out", out.to_str().unwrap(), "--json"];
    arguments.extend(options);
    drex(arguments)
}

/// Names of the photos that a report says are in no model, with the reason.
fn left_out(report: &serde_json::Value) -> Vec<(String, String)> {
    let of = |p: &serde_json::Value| {
        let text = |key: &str| p[key].as_str().unwrap_or_default().to_owned();
        p["model"].is_null().then(|| (text("name"), text("why_not")))
    };
    report["photos"].as_array().unwrap().iter().filter_map(of).collect()
}

fn notes(report: &serde_json::Value) -> String {
    report["notes"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect::<Vec<_>>().join("\n")
}

#[test]
fn masks_that_are_given_and_are_none_of_the_photos_are_named() {
    let dir = photos(0..4);
    let [photos, masks, out] = ["photos", "cut out", "out"].map(|name| dir.path().join(name));
    let asset = || {
        let [photos, masks, out] = [&photos, &masks, &out].map(|p| p.to_str().unwrap());
        drex(["asset", photos, "--masks", masks, "--out", out, "--scale", "1"])
    };
    asset().fails_with(&["there is no folder", "cut out"]);
    fs::create_dir(&masks).unwrap();
    fs::copy(demo_photo(0), masks.join("another.png")).unwrap();
    asset().fails_with(&["no mask of any photo", "cut out", "named like its photo"]);
    assert!(!out.exists());
}

#[test]
fn photos_alone_become_cameras_points_and_a_picture() {
    let dir = photos((0..18).step_by(1));
    let before = tree(&dir.path().join("photos"));
    let run = sfm(dir.path(), &["--threads", "1"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let (report, out) = (run.json(), dir.path().join("out"));
    assert!(left_out(&report).is_empty(), "{:?}", left_out(&report));
    let lens = &report["models"][0]["lenses"][0];
    // The demo's photos are rendered with 600 px and say nothing of it.
    assert!((lens["focal_px"].as_f64().unwrap() - 600.0).abs() < 4.0, "{lens}");
    assert!(report["models"][0]["median_error_px"].as_f64().unwrap() < 0.5, "{report}");
    let written: serde_json::Value = serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(written["models"], report["models"]);

    let mut within = CaptureOptions::default();
    within.images = Some(dir.path().join("photos"));
    let model = Capture::load_model(&out, &out.join("sparse"), &within).unwrap().unwrap();
    assert_eq!(model.views.len(), 18);
    // From photo to photo the cameras turn, and stand round the tin, as they were rendered.
    let truth = true_cameras();
    for i in 0..17 {
        let turn = |from: &Pose, to: &Pose| from.rotation.rotation_to(&to.rotation).angle().to_degrees();
        let [a, b] = [i, i + 1].map(|k| model.views[k].camera_from_world.inverse());
        let (found, expected) = (turn(&a, &b), turn(&truth[i], &truth[i + 1]));
        assert!((found - expected).abs() < 0.1, "{i}: {found} instead of {expected} degrees");
    }
    let centres = |poses: &mut dyn Iterator<Item = Pose>| -> Vec<Point3<f64>> {
        poses.map(|p| Point3::from(p.translation.vector)).collect()
    };
    let found = centres(&mut model.views.iter().map(|v| v.camera_from_world.inverse()));
    let (_, rms_m) = Similarity::between(&found, &centres(&mut truth[..18].iter().copied())).unwrap();
    assert!(rms_m < 0.3e-3, "{:.3} mm off in a circle of 274 mm", 1e3 * rms_m);
    let transforms = Capture::load(&out, &CaptureOptions::default());
    // The model in sparse/ goes first; without it the same cameras come from transforms.json.
    assert!(transforms.is_err() || transforms.unwrap().views.len() == 18);
    let picture = image::open(out.join("cameras.png")).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (1600, 800));
    let orange = |x0: u32| {
        picture.enumerate_pixels().filter(|(x, _, p)| x0 <= *x && *x < x0 + 800 && p.0 == [255, 160, 40]).count()
    };
    assert!(orange(0) > 18 * 40 && orange(800) > 18 * 40, "{} and {} pixels of cameras", orange(0), orange(800));
    assert_eq!(tree(&dir.path().join("photos")), before, "nothing is written beside the photos");

    // The same bytes on two threads, in a folder where a result lies already.
    let first = tree(&out);
    assert_eq!(sfm(dir.path(), &["--threads", "2"]).code, 0);
    assert!(tree(&out) == first, "the number of threads shows");

    let text = drex(["sfm", dir.path().join("photos").to_str().unwrap(), "--out", out.to_str().unwrap()]);
    for word in ["18 of 18 photos registered", "focal", "median error", "first from", "sparse/0", "cameras.png"] {
        assert!(text.stdout.contains(word), "`{word}` is missing in {}", text.stdout);
    }
    assert!(tree(&out) == first, "a second run");
}

#[test]
fn odd_photos_are_used_or_named() {
    let dir = photos(0..13);
    let folder = dir.path().join("photos");
    fs::rename(folder.join("00.jpg"), folder.join("IMG 00.JPG")).unwrap();
    fs::rename(folder.join("01.jpg"), folder.join("IMG 01.Jpeg")).unwrap();
    fs::copy(folder.join("02.jpg"), folder.join("02 copy.jpg")).unwrap();
    // 16 bits a channel.
    let deep = image::open(folder.join("03.jpg")).unwrap().into_rgb16();
    fs::remove_file(folder.join("03.jpg")).unwrap();
    deep.save(folder.join("03.PNG")).unwrap();
    // Another size, and upright ones.
    for i in [4, 6, 8] {
        let file = folder.join(format!("{i:02}.jpg"));
        image::open(&file)
            .unwrap()
            .resize_exact(512, 384, image::imageops::FilterType::CatmullRom)
            .save(&file)
            .unwrap();
    }
    for i in [5, 7, 9] {
        let file = folder.join(format!("{i:02}.jpg"));
        image::open(&file).unwrap().rotate90().save(&file).unwrap();
    }
    let half = fs::read(folder.join("12.jpg")).unwrap();
    fs::write(folder.join("12.jpg"), &half[..half.len() / 2]).unwrap();
    fs::write(folder.join("13.jpg"), &half[..40]).unwrap();
    fs::write(folder.join("14.jpg"), "no picture").unwrap();
    fs::write(folder.join("IMG_15.HEIC"), "heic").unwrap();
    fs::write(folder.join("IMG_16.DNG"), "raw").unwrap();

    let run = sfm(dir.path(), &[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report = run.json();
    let names: Vec<&str> = report["photos"].as_array().unwrap().iter().map(|p| p["name"].as_str().unwrap()).collect();
    for name in ["IMG 00.JPG", "IMG 01.Jpeg", "03.PNG", "12.jpg", "13.jpg"] {
        assert!(names.contains(&name), "{names:?}");
    }
    let out = left_out(&report);
    for (name, why) in &out {
        assert!(["12.jpg", "13.jpg", "14.jpg"].contains(&name.as_str()), "{name}: {why}\n{}", run.stdout);
        assert!(why.contains("cannot be read") && why.contains(name), "{name}: {why}");
    }
    assert_eq!(out.len(), 3, "{out:?}");
    let notes = notes(&report);
    let twice = if names.contains(&"02.jpg") { "02 copy.jpg (as 02.jpg)" } else { "02.jpg (as 02 copy.jpg)" };
    for word in [twice, "IMG_15.HEIC", "heif-convert", "IMG_16.DNG", "export them as JPEG"] {
        assert!(notes.contains(word), "`{word}` is missing in {notes}");
    }
    let sizes: Vec<&serde_json::Value> =
        report["models"][0]["lenses"].as_array().unwrap().iter().map(|l| &l["size_px"]).collect();
    assert_eq!(sizes.len(), 3, "{sizes:?}");
}

#[test]
fn a_mask_of_another_shape_leaves_its_photo_out() {
    let dir = photos(0..12);
    let masks = dir.path().join("masks");
    fs::create_dir(&masks).unwrap();
    for i in 0..11 {
        // Half the size is the photo scaled as a whole.
        let (w, h) = match i {
            3 => (480, 480),
            5 => (320, 240),
            _ => (640, 480),
        };
        ImageBuffer::from_pixel(w, h, image::Luma([255_u8])).save(masks.join(format!("{i:02}.png"))).unwrap();
    }
    let run = sfm(dir.path(), &["--masks", masks.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report = run.json();
    let out = left_out(&report);
    assert_eq!(out.len(), 1, "{out:?}");
    assert!(out[0].0 == "03.jpg" && out[0].1.contains("480 x 480") && out[0].1.contains("640 x 480"), "{out:?}");
    assert!(notes(&report).contains("1 photo without a mask, used as a whole: 11.jpg."), "{}", notes(&report));
    let empty = dir.path().join("empty");
    fs::create_dir(&empty).unwrap();
    sfm(dir.path(), &["--masks", empty.to_str().unwrap()]).fails_with(&["no mask for any photo", "--masks"]);
}

#[test]
fn a_verdict_is_one_sentence_and_no_model() {
    let dir = photos(0..12);
    assert_eq!(sfm(dir.path(), &[]).code, 0);
    assert!(dir.path().join("out/sparse/0/images.bin").is_file());
    // Of what is left no model can be made: that of the others must not stay.
    (2..12).for_each(|i| fs::remove_file(dir.path().join(format!("photos/{i:02}.jpg"))).unwrap());
    let run = sfm(dir.path(), &[]);
    run.fails_with(&["too few photos: 2 photos", "take 20 to 80 photos"]);
    assert_eq!(run.stderr.trim_end().lines().count(), 1, "{}", run.stderr);
    assert!(run.json()["error"].as_str().unwrap().contains("too few photos"));
    assert!(tree(&dir.path().join("out")).is_empty());

    // Different scenes: grain that no two photos share.
    let dir = photos([]);
    for seed in 0..5_u32 {
        let noise = |x: u32, y: u32| {
            let cell = ((x / 5) * 7919 + (y / 5) * 104_729 + seed * 15_485_863).wrapping_mul(2_654_435_761);
            Rgb([(cell >> 24) as u8, (cell >> 16) as u8, (cell >> 8) as u8])
        };
        DynamicImage::from(ImageBuffer::from_fn(320, 240, noise))
            .save(dir.path().join(format!("photos/{seed}.png")))
            .unwrap();
    }
    let run = sfm(dir.path(), &[]);
    run.fails_with(&["overlap"]);
    assert!(!dir.path().join("out").exists());
}

#[test]
fn what_holds_no_photos_is_said() {
    let dir = photos([]);
    sfm(dir.path(), &[]).fails_with(&["photos has no photos", "20 to 80 photos"]);
    fs::write(dir.path().join("photos/IMG_1.heic"), "heic").unwrap();
    sfm(dir.path(), &[]).fails_with(&["has no photos", "1 file is HEIC", "heif-convert", "Most Compatible"]);
    let run = |input: &Path| drex(["sfm", input.to_str().unwrap(), "--out", dir.path().join("out").to_str().unwrap()]);
    run(&dir.path().join("nowhere")).fails_with(&["there is no", "nowhere"]);
    run(&demo_photo(3)).fails_with(&["is one file", "folder"]);
    // Text is no video, and no reason to ask for ffmpeg.
    let notes = dir.path().join("notes");
    fs::write(&notes, "How the photos were taken: é".repeat(40)).unwrap();
    run(&notes).fails_with(&["notes is one file", "folder"]);
    assert!(!dir.path().join("out").exists());
}

/// ffmpeg is played by a script: one that makes no frames, and one that makes those of the demo.
#[cfg(unix)]
#[test]
fn a_video_is_its_frames() {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().unwrap();
    let film = dir.path().join("film.mp4");
    fs::write(&film, b"film\0").unwrap();
    let script = dir.path().join("ffmpeg");
    let out = dir.path().join("out");
    let play = |text: &str| {
        fs::write(&script, format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
        let words = [film.as_path(), Path::new("--out"), &out, Path::new("--ffmpeg"), &script];
        drex([Path::new("sfm")].into_iter().chain(words))
    };
    play("exit 0").fails_with(&["found no frames", "film.mp4", "give another video"]);
    assert!(!out.exists());
    // It prints the demo's first photos as grey frames, and writes those that it is asked for.
    let mut bytes = b"YUV4MPEG2 W640 H480 F25:1 Ip A1:1 Cmono\n".to_vec();
    for i in 0..10 {
        bytes.extend_from_slice(b"FRAME\n");
        bytes.extend(image::open(demo_photo(i)).unwrap().into_luma8().into_raw());
    }
    let grey = dir.path().join("film.y4m");
    fs::write(&grey, bytes).unwrap();
    let frames = format!(
        "case \"$*\" in *yuv4mpegpipe*) cat '{}'; exit;; esac\nfor last; do :; done\n\
         n=$(echo \"$*\" | grep -o 'eq(n' | wc -l); i=0\n\
         while [ $i -lt $n ]; do cp '{}'/0$i.jpg \"$(dirname \"$last\")/part_0000$i.jpg\"; i=$((i+1)); done",
        grey.display(),
        demo_photo(0).parent().unwrap().display()
    );
    let run = play(&frames);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let chosen = fs::read_dir(out.join("images")).unwrap().count();
    assert!((5..=10).contains(&chosen), "{chosen} of 10 frames");
    assert!(run.stdout.contains(&format!("{chosen} of {chosen} photos registered")), "{}", run.stdout);
    // The frames lie beside the model: a capture as it is.
    assert_eq!(Capture::load(&out, &CaptureOptions::default()).unwrap().views.len(), chosen);
    assert!(play("exit 1").stderr.contains("going on with the frames"), "they are not taken twice");
}

#[test]
fn a_calibration_is_kept_or_says_what_is_wrong() {
    let dir = photos(0..12);
    let file = dir.path().join("K.txt");
    let with = |text: &str| {
        fs::write(&file, text).unwrap();
        sfm(dir.path(), &["--camera", file.to_str().unwrap()])
    };
    for (text, words) in [
        ("", ["K.txt", "0 numbers are no calibration", "fx fy cx cy k1 k2 p1 p2"]),
        ("600 0 319.5 0 600 239.5 0 0", ["K.txt", "600 and 0 are not positive", "3 x 3"]),
        ("600 0 319.5 1 600 239.5 0 0 1", ["K.txt", "no camera matrix", "3 x 3"]),
        ("600 600 320 centre", ["K.txt", "`centre` is no number", "3 x 3"]),
        ("1720 0 800 0 1720 600 0 0 1", ["K.txt", "not of photos of 640 x 480", "pixels of the photos"]),
    ] {
        with(text).fails_with(&words);
    }
    sfm(dir.path(), &["--camera", "nowhere.txt"]).fails_with(&["nowhere.txt"]);
    for text in ["600 0 319.5\n0 600 239.5\n0 0 1\n", "600, 600, 319.5, 239.5, 0, 0, 0, 0  # from a board"] {
        let run = with(text);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let lens = run.json()["models"][0]["lenses"][0].clone();
        assert_eq!(lens["focal_from"], "calibration", "{lens}");
        let params: Vec<f64> = lens["params"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert!(params[0] == 600.0 && params.contains(&320.0) && params.contains(&240.0), "{lens}");
    }
}

#[test]
fn a_marker_that_is_not_there_leaves_the_model_without_scale() {
    let dir = photos(0..12);
    let run = sfm(dir.path(), &["--marker", "tag36h11:11:0.06"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report = run.json();
    assert!(report["marker"].is_null() && dir.path().join("out/sparse/0/images.bin").is_file());
    for word in ["The model has no scale", "tag36h11:11:0.06", "0 photos see it, 3 are needed"] {
        assert!(notes(&report).contains(word), "{}", notes(&report));
    }
    let wrong = sfm(dir.path(), &["--marker", "tag36h11:11:60"]);
    assert!(wrong.code == 2 && wrong.stderr.contains("0.06 for 60 mm"), "{}", wrong.stderr);
}

#[test]
fn only_what_it_wrote_is_replaced() {
    let dir = photos(0..12);
    let out = dir.path().join("out");
    fs::create_dir_all(out.join("sparse/0")).unwrap();
    fs::write(out.join("sparse/0/cameras.bin"), "mine").unwrap();
    let before = tree(&out);
    sfm(dir.path(), &[]).fails_with(&["out/sparse", "did not write", "another folder"]);
    assert_eq!(tree(&out), before);

    // The result within the photos' folder: its picture is no photo.
    let photos = dir.path().join("photos");
    let out = photos.join("out");
    for _ in 0..2 {
        let run = drex(["sfm", photos.to_str().unwrap(), "--out", out.to_str().unwrap(), "--json"]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert_eq!(run.json()["photos"].as_array().unwrap().len(), 12);
    }
    // And a folder with photos and a model beside them goes through `drex asset` and others as it is.
    let whole = dir.path().join("whole");
    fs::create_dir_all(whole.join("images")).unwrap();
    (0..12).for_each(|i| {
        fs::copy(demo_photo(i), whole.join(format!("images/{i:02}.jpg"))).unwrap();
    });
    let run = drex(["sfm", whole.to_str().unwrap(), "--out", whole.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(Capture::load(&whole, &CaptureOptions::default()).unwrap().views.len(), 12);
}

#[test]
fn a_scan_needs_no_cameras_and_stays_as_it_is() {
    let dir = photos(0..12);
    let (scan, out) = (dir.path().join("photos"), dir.path().join("twin"));
    let before = tree(&scan);
    let reconstruct = || {
        let [scan, out] = [&scan, &out].map(|p| p.to_str().unwrap());
        drex(["reconstruct", scan, "--out", out, "--preset", "fast", "--iterations", "2", "--max-side", "40"])
    };
    let run = reconstruct();
    assert_eq!(run.code, 0, "{}", run.stderr);
    for word in ["cameras of 12 of 12 photos", "12 of 12 photos have a camera"] {
        assert!(run.stderr.contains(word), "`{word}` is missing in {}", run.stderr);
    }
    assert_eq!(tree(&scan), before, "nothing is written beside the photos");
    let found = tree(&out.join("sfm"));
    assert!(["sparse/0/images.bin", "report.json", "cameras.png"].iter().all(|f| found.contains_key(*f)));

    // Another command goes on with them, and so does one of another machine: no path is kept but those of the photos.
    let asset = |options: &[&str]| {
        let [scan, out] = [&scan, &out].map(|p| p.to_str().unwrap());
        drex(["asset", scan, "--out", out].iter().chain(options))
    };
    asset(&[]).fails_with(&["has no scale", "--marker tag36h11:ID:SIDE_M", "--distance"]);
    let run = asset(&["--marker", "tag36h11:11:0.06"]);
    run.fails_with(&["going on with the cameras in", "tag36h11:11:0.06", "0 photos see it, 3 are needed"]);
    assert_eq!(tree(&out.join("sfm")), found);
    let both = asset(&["--marker", "tag36h11:11:0.06", "--scale", "0.3"]);
    assert!(both.code == 2 && both.stderr.contains("cannot be used with"), "{}", both.stderr);

    // Other photos: their cameras are found again, and that is said.
    fs::remove_file(scan.join("11.jpg")).unwrap();
    let run = reconstruct();
    assert_eq!(run.code, 0, "{}", run.stderr);
    for word in ["is of other photos or options", "cameras of 11 of 11 photos"] {
        assert!(run.stderr.contains(word), "`{word}` is missing in {}", run.stderr);
    }
    // Of too few there is a verdict, and no model of the others stays.
    (2..11).for_each(|i| fs::remove_file(scan.join(format!("{i:02}.jpg"))).unwrap());
    reconstruct().fails_with(&["too few photos: 2 photos"]);
    assert!(!out.join("sfm/sparse").exists());
}
