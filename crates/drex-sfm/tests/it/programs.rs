//! COLMAP, played by small shell scripts.
#![cfg(unix)]

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use crate::capture_support::{Model, grey, lens, ring};
use drex_core::camera::CameraModel;
use drex_core::capture::{Capture, CaptureOptions};
use drex_sfm::programs::{ColmapOptions, find_cameras};

/// A script that one test writes while another starts a program may be held open by the latter: one test at a time.
pub(crate) fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

pub(crate) fn script(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, format!("#!/bin/sh\n{text}")).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path
}

/// Ten photos, two of them turned, and a COLMAP that knows the options `known`, notes how it is called, and finds the
/// cameras of `model`.
fn folder_with_colmap(model: &Model, known: &str) -> (tempfile::TempDir, PathBuf, ColmapOptions) {
    let guard = tempfile::tempdir().unwrap();
    let folder = guard.path().join("scan");
    for i in 0..10 {
        let turned = i >= 8;
        grey(
            &folder.join(format!("images/view {i:02}.png")),
            if turned { 120 } else { 160 },
            if turned { 160 } else { 120 },
        );
    }
    let prepared = guard.path().join("prepared");
    model.write_bin(&prepared);
    let (calls, prepared) = (guard.path().join("calls"), prepared.display());
    let text = format!(
        "if [ \"$2\" = --help ]; then printf '%s\\n' {known}; exit 0; fi\n\
         echo \"$@\" >> '{}'\n\
         echo working on $1\n\
         if [ $1 = mapper ]; then while [ $# -gt 0 ]; do [ \"$1\" = --output_path ] && out=$2; shift; done\n\
         mkdir \"$out/0\"; cp '{prepared}'/*.bin \"$out/0\"; fi\n",
        calls.display()
    );
    let mut options = ColmapOptions::default();
    options.program = script(guard.path(), "colmap", &text);
    (guard, folder, options)
}

/// Where COLMAP works: beside the photos' folder, in which nothing is written.
fn work(folder: &Path) -> PathBuf {
    folder.with_file_name("work")
}

fn run(folder: &Path, options: &ColmapOptions) -> (Result<Capture, String>, Vec<String>) {
    let mut lines = Vec::new();
    let result = find_cameras(folder, &work(folder), &CaptureOptions::default(), options, &mut |line| {
        lines.push(line.to_owned())
    });
    (result.map_err(|e| e.to_string()), lines)
}

const OLD: &str = "'--SiftExtraction.use_gpu arg (=1)' '--SiftMatching.use_gpu arg (=1)' '--Mapper.num_threads arg'";
const NEW: &str =
    "'--FeatureExtraction.use_gpu arg (=1)' '--FeatureMatching.use_gpu arg (=1)' '--ImageReader.single_camera arg'";

#[test]
fn photos_alone_go_through_colmap() {
    let _turn = alone();
    let mut model = ring(&lens(CameraModel::SimpleRadial), 10, 120);
    model.images.truncate(8);
    for (known, gpu) in [(OLD, "--SiftExtraction.use_gpu 0"), (NEW, "--FeatureExtraction.use_gpu 0")] {
        let (guard, folder, options) = folder_with_colmap(&model, known);
        let (capture, lines) = run(&folder, &options);
        let capture = capture.unwrap();
        assert_eq!(capture.views.len(), 8);
        assert_eq!(capture.unregistered, ["view 08.png", "view 09.png"]);
        let note = capture.notes.last().unwrap();
        assert!(note.contains("8 of 10 photos; without: view 08.png, view 09.png"), "{note}");
        assert!(lines.iter().any(|l| l == "working on mapper"), "{lines:?}");
        let calls = std::fs::read_to_string(guard.path().join("calls")).unwrap();
        let steps: Vec<_> = calls.lines().map(|l| l.split(' ').next().unwrap()).collect();
        // Photos of two sizes are two groups.
        assert_eq!(steps, ["feature_extractor", "feature_extractor", "exhaustive_matcher", "mapper"], "{calls}");
        assert!(calls.contains(gpu) && calls.contains("Matching.use_gpu 0"), "{calls}");
        assert_eq!(calls.contains("--Mapper.num_threads -1"), known == OLD, "{calls}");
        assert_eq!(calls.contains("--ImageReader.single_camera 1"), known == NEW, "{calls}");
        let again = Capture::load_model(&folder, &work(&folder).join("sparse"), &CaptureOptions::default());
        assert_eq!(again.unwrap().unwrap().views, capture.views);
        assert!(!Capture::is_in(&folder), "nothing is written beside the photos");
    }
}

#[test]
fn too_few_cameras_are_refused() {
    let _turn = alone();
    let mut model = ring(&lens(CameraModel::SimpleRadial), 10, 120);
    model.images.truncate(5);
    let (_guard, folder, mut options) = folder_with_colmap(&model, OLD);
    let (result, _) = run(&folder, &options);
    let message = result.unwrap_err();
    assert!(message.contains("5 of 10 photos; without: view 05.png, view 06.png"), "{message}");
    assert!(message.contains("60 % are needed"), "{message}");
    // What was refused is not taken for a model of the folder the next time.
    assert!(!work(&folder).join("sparse").exists() && !Capture::is_in(&folder));
    assert!(run(&folder, &options).0.is_err());
    options.least_registered = 0.5;
    assert_eq!(
        find_cameras(&folder, &work(&folder), &CaptureOptions::default(), &options, &mut |_| ()).unwrap().views.len(),
        5
    );

    // Six are enough, but not when one of them stands somewhere else.
    let mut model = ring(&lens(CameraModel::SimpleRadial), 10, 120);
    model.images.truncate(6);
    model.images[2].camera_from_world.translation.vector *= 100.0;
    let (_guard, folder, options) = folder_with_colmap(&model, OLD);
    let message = run(&folder, &options).0.unwrap_err();
    assert!(message.contains("likely wrong: view 02.png"), "{message}");
}

#[test]
fn a_colmap_that_is_missing_or_fails_is_named() {
    let _turn = alone();
    let (guard, folder, mut options) = folder_with_colmap(&ring(&lens(CameraModel::Pinhole), 10, 50), OLD);
    options.program = "/nowhere/colmap".into();
    let message = run(&folder, &options).0.unwrap_err();
    assert!(message.contains("/nowhere/colmap was not found") && message.contains("apt install colmap"), "{message}");
    options.program = script(guard.path(), "broken", "[ \"$2\" = --help ] && exit 0; echo all is lost >&2; exit 3\n");
    let (result, lines) = run(&folder, &options);
    let message = result.unwrap_err();
    assert!(message.contains("feature_extractor failed") && message.contains("all is lost"), "{message}");
    assert!(lines.iter().any(|l| l == "all is lost"));
    options.program = script(guard.path(), "empty", "exit 0\n");
    assert!(run(&folder, &options).0.unwrap_err().contains("found no cameras for the 10 photos"));
    let nothing = tempfile::tempdir().unwrap();
    assert!(run(nothing.path(), &options).0.unwrap_err().contains("has no photos"));
    grey(&nothing.path().join("one.jpg"), 8, 8);
    assert!(run(nothing.path(), &options).0.unwrap_err().contains("has only 1 photo"));
}
