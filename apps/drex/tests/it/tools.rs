//! COLMAP, ffmpeg and detectors, played by small shell scripts: whatever they do, and whatever files are called.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use drex_splat::io::picture;

/// Runs `drex` in `folder`, with the scripts of `folder/bin` before all other programs.
fn drex(folder: &Path, arguments: &[&str]) -> (Output, String) {
    let path = format!("{}:{}", folder.join("bin").display(), std::env::var("PATH").unwrap());
    let output = Command::new(env!("CARGO_BIN_EXE_drex"))
        .args(arguments)
        .current_dir(folder)
        .env("PATH", path)
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!message.contains("panicked"), "{message}");
    (output, message)
}

/// A folder with a program of this name that notes its arguments, one a line, and does the rest.
fn with_program(name: &str, rest: &str) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let program = dir.path().join("bin").join(name);
    fs::create_dir(dir.path().join("bin")).unwrap();
    let note = format!("printf '%s\\n' \"$@\" >> '{}'", dir.path().join("calls").display());
    fs::write(&program, format!("#!/bin/sh\n{note}\n{rest}\n")).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    dir
}

fn photos(folder: &Path) {
    for i in 0..3 {
        picture::write_rgb(&folder.join(format!("images/{i}.png")), 16, 12, &[[0.5; 3]; 16 * 12]).unwrap();
    }
}

/// The arguments of all calls, none of which may be a bare name.
fn calls(folder: &Path, name: &str) -> Vec<String> {
    let calls: Vec<String> = fs::read_to_string(folder.join("calls")).unwrap().lines().map(str::to_owned).collect();
    assert!(calls.iter().any(|c| c.contains(&format!("/{name}"))), "{name}: {calls:?}");
    calls
}

#[test]
fn no_name_is_taken_for_an_option() {
    for name in ["-i", "--help", "-y.mp4"] {
        let dir = with_program("ffmpeg", "exit 1");
        fs::write(dir.path().join(name), b"film\0").unwrap();
        let (run, _) = drex(dir.path(), &["reconstruct", "--out", "out", "--", name]);
        assert_eq!(run.status.code(), Some(1));
        let film = fs::canonicalize(dir.path()).unwrap().join(name);
        let given = calls(dir.path(), name);
        let input = given.iter().position(|a| a == "-i").unwrap() + 1;
        assert_eq!(given[input], format!("file:{}", film.display()), "{given:?}");
        assert_eq!(given.iter().filter(|a| *a == name).count(), usize::from(name == "-i"), "{given:?}");

        let dir = with_program("colmap", "exit 0");
        photos(&dir.path().join(name));
        let (run, message) = drex(dir.path(), &["reconstruct", "--out", "out", "--colmap", "--", name]);
        assert_eq!(run.status.code(), Some(1), "{message}");
        assert!(message.contains("found no cameras"), "{message}");
        let given = calls(dir.path(), name);
        // Each step asks for its help once, and that is all that a bare name would look like.
        assert!(name == "--help" || !given.iter().any(|a| a == name), "{given:?}");
        let roots: Vec<&String> = given.windows(2).filter(|w| w[0] == "--image_path").map(|w| &w[1]).collect();
        assert!(!roots.is_empty() && roots.iter().all(|r| r.starts_with('/')), "{roots:?}");

        let dir = with_program("detect", "exit 9");
        fs::write(dir.path().join(name), "film").unwrap();
        let video = format!("./{name}");
        let command =
            ["hands", &video, "--out", "points.json", "--detector", "command", "--", "detect", "{video}", "{out}"];
        assert_eq!(drex(dir.path(), &command).0.status.code(), Some(1));
        assert!(calls(dir.path(), name).iter().all(|a| a.starts_with('/')));
    }
}

#[test]
fn what_does_not_end_is_stopped_at_its_limit() {
    for hang in ["exec sleep 600", "while :; do echo working; done", "sleep 30; exit 0"] {
        let begun = Instant::now();
        let dir = with_program("colmap", hang);
        photos(&dir.path().join("scan"));
        let (run, message) =
            drex(dir.path(), &["reconstruct", "scan", "--out", "out", "--colmap", "--tool-limit", "0.01"]);
        assert_eq!(run.status.code(), Some(1), "{message}");
        for word in ["COLMAP's feature_extractor had not ended after 0.01 minutes", "--tool-limit"] {
            assert!(message.contains(word), "{hang}: {message}");
        }
        let dir = with_program("ffmpeg", hang);
        fs::write(dir.path().join("film.mp4"), b"film\0").unwrap();
        let (run, message) = drex(dir.path(), &["reconstruct", "film.mp4", "--out", "out", "--tool-limit", "0.01"]);
        assert_eq!(run.status.code(), Some(1), "{message}");
        assert!(message.contains("ffmpeg had not ended") && message.contains("--tool-limit"), "{hang}: {message}");
        assert!(!dir.path().join("out").exists(), "half of a film's frames are no scan");
        let dir = with_program("detect", hang);
        fs::write(dir.path().join("film.mp4"), "film").unwrap();
        let command =
            ["hands", "film.mp4", "--out", "points.json", "--timeout", "0.5", "--detector", "command", "--", "detect"];
        let (run, message) = drex(dir.path(), &command);
        assert_eq!(run.status.code(), Some(1), "{message}");
        assert!(message.contains("no end after") && !dir.path().join("points.json").exists(), "{hang}: {message}");
        assert!(begun.elapsed() < Duration::from_secs(60), "{hang}");
    }
}
