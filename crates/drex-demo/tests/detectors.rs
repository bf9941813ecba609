//! Detectors: small shell scripts stand in for them, MediaPipe is used where it is.
#![cfg(feature = "files")]
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)] // a test: a panic is the report, a line that it was skipped
#![cfg(unix)]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use drex_demo::{ExternalDetector, HAMER_SCRIPT, HandDetector, LoadOptions, MEDIAPIPE_SCRIPT, MediaPipe, Side};

/// A video of nothing in a new folder, if this machine has a shell.
fn video() -> Option<(tempfile::TempDir, PathBuf)> {
    if !Path::new("/bin/sh").exists() {
        println!("skipped: there is no /bin/sh");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let video = folder.path().join("a video.mp4");
    std::fs::write(&video, b"no video").unwrap();
    Some((folder, video))
}

/// A detector that is a line of shell: $0 is the video, $1 the file to write.
fn shell(script: &str) -> ExternalDetector {
    ExternalDetector::new("fake", "/bin/sh", &["-c", script, "{video}", "{out}"])
}

fn refused(detector: &dyn HandDetector, video: &Path) -> String {
    detector.detect(video, &LoadOptions::default()).unwrap_err().to_string()
}

#[test]
fn what_a_command_writes_is_read() {
    let Some((_folder, video)) = video() else { return };
    let points = "[0,0,0],".repeat(4) + &"[0.01,0.09,0],".repeat(16) + "[0,0.1,0]";
    let json = format!(r#"{{"hand":"left","fps":10,"frames":[{{"keypoints":[]}},{{"keypoints":[{points}]}}]}}"#);
    let demo =
        shell(&format!("test -f \"$0\" && echo '{json}' > \"$1\"")).detect(&video, &LoadOptions::default()).unwrap();
    assert_eq!((demo.frames.len(), demo.side), (2, Side::Left));
    assert!(demo.source.starts_with("fake of ") && demo.frames[1].points[5].is_some());
}

#[test]
fn failures_say_what_happened() {
    let Some((folder, video)) = video() else { return };
    let said = refused(&shell("echo model not found >&2; exit 7"), &video);
    assert!(said.contains("fake") && said.contains("status 7") && said.contains("model not found"), "{said}");
    let said = refused(&shell("true"), &video);
    assert!(said.contains("wrote no"), "{said}");
    let said = refused(&shell("echo nonsense > \"$1\""), &video);
    assert!(said.contains("cannot be used") && said.contains("no JSON object"), "{said}");
    let said = refused(&shell("echo '{\"frames\":[{\"keypoints\":[]},{\"keypoints\":[]}]}' > \"$1\""), &video);
    assert!(said.contains("no hand found in 2 frames"), "{said}");
    let said = refused(&ExternalDetector::new("none", "/no/such/program", &[]), &video);
    assert!(said.contains("/no/such/program is not there") && said.contains("install"), "{said}");
    let said = refused(&shell("true"), &folder.path().join("none.mp4"));
    assert!(said.contains("is no file"), "{said}");
}

#[test]
fn a_command_that_does_not_end_is_ended() {
    let Some((_folder, video)) = video() else { return };
    // The second holds the pipe of messages open after it is gone.
    for script in ["exec sleep 60", "sleep 5 & sleep 60"] {
        let mut slow = shell(script);
        slow.timeout = Duration::from_millis(200);
        let started = Instant::now();
        let said = refused(&slow, &video);
        assert!(said.contains("no end after"), "{said}");
        assert!(started.elapsed() < Duration::from_secs(4));
    }
    // More messages than a pipe holds do not stop a command.
    let mut loud = shell(
        "i=0; while [ $i -lt 3000 ]; do echo 'a line of forty characters, more or less..' >&2; i=$((i+1)); done; exit 9",
    );
    loud.timeout = Duration::from_secs(30);
    let said = refused(&loud, &video);
    assert!(said.contains("status 9") && said.len() < 2000, "{said}");
}

#[test]
fn a_missing_python_or_package_is_named() {
    let Some((folder, video)) = video() else { return };
    let mut detector = MediaPipe::default();
    detector.python = "/no/such/python3".into();
    let said = refused(&detector, &video);
    assert!(said.contains("/no/such/python3 is not there") && said.contains("mediapipe==0.10.14"), "{said}");
    // A Python that is there, without the packages: what our script says comes through.
    let fake = folder.path().join("python3");
    std::fs::write(&fake, "#!/bin/sh\ncat > /dev/null\necho 'noise' >&2\necho 'the package mediapipe is missing; pip install it' >&2\nexit 3\n").unwrap();
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(&fake, std::fs::Permissions::from_mode(0o755)).unwrap();
    detector.python = fake.into();
    assert_eq!(refused(&detector, &video), "mediapipe: the package mediapipe is missing; pip install it");
    detector.confidence = 2.0;
    assert!(refused(&detector, &video).contains("confidence"));
}

#[test]
fn the_scripts_are_python() {
    let Some(python) = ["python3", "python"]
        .into_iter()
        .find(|p| std::process::Command::new(p).arg("--version").output().is_ok_and(|o| o.status.success()))
    else {
        println!("skipped: there is no Python");
        return;
    };
    for script in [MEDIAPIPE_SCRIPT, HAMER_SCRIPT] {
        let check = "import ast, sys; ast.parse(sys.argv[1])";
        assert!(std::process::Command::new(python).args(["-c", check, script]).status().unwrap().success());
    }
}

/// With DREX_MEDIAPIPE_PYTHON, a Python that has mediapipe 0.10.14: a file that is no video, for real.
#[test]
fn mediapipe_answers() {
    let Some(python) = std::env::var_os("DREX_MEDIAPIPE_PYTHON") else {
        println!("skipped: DREX_MEDIAPIPE_PYTHON is not set");
        return;
    };
    let Some((_folder, video)) = video() else { return };
    let mut detector = MediaPipe::default();
    detector.python = python;
    let said = refused(&detector, &video);
    assert!(said.contains("cannot be opened as a video"), "{said}");
}
