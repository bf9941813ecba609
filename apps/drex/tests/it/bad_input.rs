//! What the command line says to wrong input: exit status 1, a message with file, place and remedy, nothing half-written.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{drex, edit, shared_data, tin_copy, tin_data};

/// The names of everything below a folder.
fn listing(folder: &Path) -> Vec<PathBuf> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            all.extend(listing(&path));
        }
        all.push(path);
    }
    all.sort();
    all
}

#[test]
fn missing_files_are_named() {
    drex(["identify", "no/such/push.toml"]).fails_with(&["no/such/push.toml"]);
    drex(["asset", "no/such.stl", "--out", "unused"]).fails_with(&["no/such.stl"]);
    drex(["run", "no/such/twin.toml"]).fails_with(&["no/such/twin.toml"]);
    assert!(!Path::new("unused").exists());
}

#[test]
fn a_failure_is_json_too_when_asked_for() {
    let run = drex(["identify", "no/such/push.toml", "--json"]);
    assert_eq!(run.code, 1);
    assert!(run.json()["error"].as_str().unwrap().contains("no/such/push.toml"));
}

#[test]
fn wrong_usage_exits_with_2() {
    assert_eq!(drex(["weigh"]).code, 2);
    assert_eq!(drex(["identify"]).code, 2);
    assert_eq!(drex(["identify", "x", "--method", "magic"]).code, 2);
    assert_eq!(drex(["asset", "m.stl", "--out", "o", "--mass", "-1"]).code, 2);
}

#[test]
fn a_wrong_column_is_named_with_those_there_are() {
    let (_dir, twin) = tin_copy();
    edit(&twin.join("push/tilt/poses.csv"), "t,x,y,z,qw", "t,x,y,height,qw");
    drex(["identify", twin.join("push/tilt").to_str().unwrap()]).fails_with(&[
        "poses.csv",
        "line 1",
        "no column z",
        "height",
    ]);
}

#[test]
fn millimetres_are_not_taken_for_metres() {
    let (_dir, twin) = tin_copy();
    let file = twin.join("push/tilt/poses.csv");
    let text = fs::read_to_string(&file).unwrap();
    let scaled: Vec<String> = text
        .lines()
        .enumerate()
        .map(|(i, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if i > 0 {
                for cell in &mut cells[1..4] {
                    *cell = (1000.0 * (cell.parse::<f64>().unwrap() + 0.5)).to_string();
                }
            }
            cells.join(",")
        })
        .collect();
    fs::write(&file, scaled.join("\n")).unwrap();
    drex(["identify", twin.join("push/tilt").to_str().unwrap()]).fails_with(&["poses.csv", "line 2", "millimetres"]);
}

#[test]
fn a_number_that_is_none_is_refused_with_its_line() {
    let (_dir, twin) = tin_copy();
    let file = twin.join("push/tilt/poses.csv");
    let text = fs::read_to_string(&file).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let mut cells: Vec<&str> = lines[5].split(',').collect();
    cells[2] = "NaN";
    lines[5] = cells.join(",");
    fs::write(&file, lines.join("\n")).unwrap();
    drex(["identify", twin.join("push/tilt").to_str().unwrap()]).fails_with(&["poses.csv", "line 6"]);
}

#[test]
fn a_quaternion_that_is_no_rotation_is_refused_with_its_line() {
    let (_dir, twin) = tin_copy();
    let file = twin.join("push/tilt/poses.csv");
    let text = fs::read_to_string(&file).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let mut cells: Vec<&str> = lines[9].split(',').collect();
    cells[4] = "0.5";
    lines[9] = cells.join(",");
    fs::write(&file, lines.join("\n")).unwrap();
    drex(["identify", twin.join("push/tilt").to_str().unwrap()]).fails_with(&["poses.csv", "line 10", "w, x, y, z"]);
}

#[test]
fn a_mesh_without_volume_is_refused_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = dir.path().join("sheet.obj");
    fs::write(&mesh, "v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0\nv 0 0.1 0\nf 1 2 3\nf 1 3 4\n").unwrap();
    let out = dir.path().join("out");
    let run = drex(["asset", mesh.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    run.fails_with(&["sheet.obj", "volume"]);
    assert!(!out.exists(), "{:?}", listing(&out));
}

#[test]
fn an_unknown_key_is_refused_with_line_and_column() {
    let (_dir, twin) = tin_copy();
    edit(&twin.join("push/tilt/push.toml"), "mass_prior_kg", "mass_prior");
    drex(["identify", twin.join("push/tilt").to_str().unwrap()]).fails_with(&["push.toml", "mass_prior", "line"]);
}

#[test]
fn a_pose_track_and_a_force_that_do_not_overlap_are_refused() {
    let (_dir, twin) = tin_copy();
    let file = twin.join("push/tilt/push.toml");
    let text = fs::read_to_string(&file).unwrap();
    let shifted =
        text.replace("[force.clock]\nkind = \"relative\"", "[force.clock]\nkind = \"relative\"\noffset_s = 500.0");
    assert_ne!(text, shifted);
    fs::write(&file, shifted).unwrap();
    drex(["identify", twin.join("push/tilt").to_str().unwrap()]).fails_with(&["overlap"]);
}

#[test]
fn the_joint_log_of_another_run_is_refused() {
    let Some(data) = shared_data("the_joint_log_of_another_run_is_refused") else { return };
    let dir = tempfile::tempdir().unwrap();
    let runs = data.join("drex_real/runs");
    let swapped = dir.path().join("runs/ketchup1");
    fs::create_dir_all(&swapped).unwrap();
    for (from, name) in [("ketchup1", "run.json"), ("ketchup1", "object_poses.txt"), ("cookie1", "joint_states.csv")] {
        fs::copy(runs.join(from).join(name), swapped.join(name)).unwrap();
    }
    let out = dir.path().join("push");
    let import = ["import", "allegro-run", swapped.to_str().unwrap(), "--out", out.to_str().unwrap()];
    drex(import).fails_with(&["overlap", "joint_states.csv", "pose track"]);
    assert!(!out.exists());
}

#[test]
fn an_output_that_cannot_be_written_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("a_file");
    fs::write(&file, "in the way").unwrap();
    let below = file.join("out");
    let mesh = tin_data().join("scan/tin.obj");
    drex(["asset", mesh.to_str().unwrap(), "--out", below.to_str().unwrap()]).fails_with(&["a_file"]);
    drex(["demo", "--out", below.to_str().unwrap()]).fails_with(&["a_file"]);
    assert_eq!(fs::read_to_string(&file).unwrap(), "in the way");
}

#[test]
fn a_full_disk_is_an_error_and_leaves_the_old_file() {
    // A device that is always full; it must be written to, not replaced.
    let full = Path::new("/dev/full");
    if !full.exists() {
        eprintln!("skipped a_full_disk_is_an_error_and_leaves_the_old_file: there is no /dev/full here");
        return;
    }
    let push = tin_data().join("push/tilt");
    drex(["identify", push.to_str().unwrap(), "--out", "/dev/full"]).fails_with(&["/dev/full", "space"]);
    assert!(!fs::metadata(full).unwrap().is_file());
}
