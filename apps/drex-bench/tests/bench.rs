//! Runs the built `drex-bench`.
#![allow(clippy::unwrap_used, missing_docs)] // tests: a panic is the report

use std::ffi::OsStr;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

/// What a run printed and how it ended.
struct Run {
    code: i32,
    stdout: String,
    stderr: String,
}

fn bench<S: AsRef<OsStr>>(arguments: impl IntoIterator<Item = S>) -> Run {
    let output = Command::new(env!("CARGO_BIN_EXE_drex-bench")).args(arguments).env_remove("RUST_BACKTRACE").output();
    let output = output.unwrap();
    Run {
        code: output.status.code().unwrap_or(-1),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

impl Run {
    fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}: {}\n{}", self.stdout, self.stderr))
    }

    fn fails_with(&self, words: &[&str]) {
        assert_eq!(self.code, 1, "stdout: {}\nstderr: {}", self.stdout, self.stderr);
        assert!(words.iter().all(|word| self.stderr.contains(word)), "{words:?}: {}", self.stderr);
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
    }
}

#[test]
fn a_small_bench_says_what_was_held_and_what_could_be() {
    let out = tempfile::tempdir().unwrap();
    let folder = out.path().to_str().unwrap();
    let arguments = |threads: &'static str| {
        let common = ["grasp", "--experiment", "objects", "--only", "cube", "--clips", "1", "--rollouts", "3"];
        common
            .into_iter()
            .chain(["--epochs", "40", "--practice", "2", "--json", "--threads", threads, "--out"])
            .chain([folder])
    };
    let run = bench(arguments("1"));
    assert_eq!(run.code, 0, "{}", run.stderr);
    let answer = run.json();
    let row = &answer["rows"][0];
    assert_eq!((row["n"].as_u64(), row["labels"]["object"].as_str()), (Some(3), Some("cube")), "{answer}");
    let sum = |of: &str| row[of].as_object().unwrap().values().map(|v| v.as_u64().unwrap()).sum::<u64>();
    assert_eq!(row["successes"].as_u64().unwrap() + sum("failures") + sum("refusals"), 3);
    // Some were carried out: rollouts that are all refused would agree with any number of threads.
    assert!(row["median_squeeze_n"].as_f64().is_some_and(|n| n > 0.0), "{answer}");
    assert!(row["interval"]["low"].as_f64() <= row["interval"]["high"].as_f64());
    for file in ["grasps/cube.json", "objects.csv", "objects.svg", "objects.txt", "objects.json"] {
        assert!(out.path().join(file).is_file(), "{file}");
    }
    // The grasps are kept, and two threads give the same.
    let made = fs::metadata(out.path().join("grasps/cube.json")).unwrap().modified().unwrap();
    let again = bench(arguments("2"));
    assert_eq!(again.json()["rows"], answer["rows"], "{}", again.stderr);
    assert_eq!(fs::metadata(out.path().join("grasps/cube.json")).unwrap().modified().unwrap(), made);
}

#[test]
fn random_objects_are_written_by_name() {
    let out = tempfile::tempdir().unwrap();
    let folder = out.path().to_str().unwrap();
    let run = bench(["objects", "--seed", "3", "--count", "4", "--mass", "off-centre", "--json", "--out", folder]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let rows = run.json();
    assert_eq!(rows.as_array().unwrap().len(), 4);
    for row in rows.as_array().unwrap() {
        let at = out.path().join(row["object"].as_str().unwrap());
        let stated: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(at.join("object.json")).unwrap()).unwrap();
        assert_eq!((&stated["mass_kg"], &stated["friction"]), (&row["mass_kg"], &row["friction"]));
        assert_eq!(stated["center_of_mass_m"], row["center_of_mass_m"]);
        assert_eq!(stated["mass_distribution"]["class"], "off_centre");
        let mesh = drex_core::TriMesh::read(&at.join("object.obj")).unwrap();
        assert!(mesh.mass_properties(1.0).unwrap().mass_kg > 0.0);
    }
}

#[test]
fn lists_of_objects_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("objects.toml");
    let list = |text: &str| fs::write(&file, text).unwrap();
    let run = || bench(["demos", "--objects", file.to_str().unwrap()]);
    for (text, words) in [
        ("object = []", vec!["lists no object"]),
        ("[[object]]\nname = \"a\"\nmesh = \"a.obj\"\nmass_kg = 0", vec!["\"a\"", "mass_kg = 0"]),
        ("[[object]]\nname = \"a/b\"\nmesh = \"a.obj\"\nmass_kg = 1", vec!["file name"]),
        ("[[object]]\nname = \"a\"\nmesh = \"a.obj\"\nmass_kg = 1", vec!["\"a\"", "a.obj"]),
        ("[[object]]\nname = \"a\"\nmesh = \"a.obj\"\nmass_kg = 1\nfriction = -1", vec!["friction = -1"]),
        ("[[object]]\nname = \"a\"\nmesh = \"a.obj\"\nmass_kg = 1\ndamaged_at_n = 0", vec!["damaged_at_n = 0"]),
        ("[[object]]\nname = \"a\"\nmesh = \"a.obj\"\nmass = 1", vec!["mass"]),
    ] {
        list(text);
        run().fails_with(&words);
    }
    bench(["demos", "--only", "teapot"]).fails_with(&["teapot", "light_bulb"]);
    bench(["demos", "--only", "cube", "--hand", "hook"]).fails_with(&["hook"]);
}

#[test]
fn a_hand_whose_model_names_no_torques_is_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("quiet.xml");
    let text = drex_robot::Robot::bundled_mjcf("leap_right").unwrap();
    let text = text.replace(" forcerange=\"-0.95 0.95\"", "").replace(" actuatorfrcrange=\"-0.29 0.29\"", "");
    fs::write(&file, text.replace("model=\"leap_right\"", "model=\"quiet_hand\"")).unwrap();
    let hand = file.to_str().unwrap();
    let arguments = ["grasp", "--experiment", "scaling", "--only", "screwdriver", "--clips", "1", "--hand", hand];
    bench(arguments).fails_with(&["\"quiet_hand\"", "if_rot", "--torque-cap", "torque_cap_nm"]);
    // With a cap the bench goes on to what it lacks next.
    bench(arguments.into_iter().chain(["--torque-cap", "0.3"])).fails_with(&["none of the 1", "screwdriver"]);
}

#[test]
fn demonstrations_without_a_grasp_are_an_error_with_a_remedy() {
    let arguments = ["grasp", "--experiment", "scaling", "--only", "screwdriver", "--clips", "1"];
    bench(arguments.into_iter().chain(["--rollouts", "1"])).fails_with(&["none of the 1", "screwdriver", "--clips"]);
}

#[test]
fn grasps_of_an_object_from_a_file() {
    let Some(shared) = shared_data("grasps_of_an_object_from_a_file") else { return };
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("objects.toml");
    let mesh = shared.join("objects/010_potted_meat_can.obj");
    let text = format!("[[object]]\nname = \"can\"\nmesh = \"{}\"\nmass_kg = 0.37\nfriction = 0.5", mesh.display());
    fs::write(&file, text).unwrap();
    let run = bench(["demos", "--json", "--clips", "1", "--objects", file.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.json()[0]["grasps"].as_u64().unwrap() >= 5, "{}", run.stdout);
}

/// Reference data, or a printed note that `test` is skipped.
fn shared_data(test: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped {test}: DREX_SHARED is not set");
        return None;
    };
    Some(PathBuf::from(root).join("data"))
}

#[test]
fn a_network_is_trained_on_some_objects_and_tried_on_others() {
    let out = tempfile::tempdir().unwrap();
    let folder = out.path().to_str().unwrap();
    let data = |threads: &str, to: &str| {
        let effort = ["--pinches", "1500", "--powers", "4", "--closed", "12", "--climbed", "1", "--simulated", "1"];
        let which = ["--seed", "1", "--first", "15", "--count", "2", "--threads", threads, "--json"];
        let to = format!("{folder}/{to}");
        let run = bench(["grasp-data", "--out", &to].into_iter().chain(effort).chain(which));
        assert_eq!(run.code, 0, "{}", run.stderr);
        run.json()
    };
    let rows = data("1", "one");
    assert!(rows[0]["grasps"].as_u64().is_some_and(|n| n > 0), "{rows}");
    data("2", "two");
    for row in rows.as_array().unwrap() {
        let file = format!("{}.json", row["object"].as_str().unwrap());
        let [one, two] = ["one", "two"].map(|f| fs::read(out.path().join(f).join(&file)).unwrap());
        assert!(one == two, "{file} depends on the number of threads");
    }
    let network = format!("{folder}/network.safetensors");
    let run = bench([
        "grasp-train",
        "--data",
        &format!("{folder}/one"),
        "--steps",
        "2",
        "--prototypes",
        "8",
        "--out",
        &network,
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let run = bench(["unseen", "--network", &network, "--count", "1", "--rollouts", "1", "--search", "400", "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let rows = run.json();
    assert_eq!(rows.as_array().map(Vec::len), Some(11), "{rows}");
    assert!(rows.as_array().unwrap().iter().all(|r| r["n"] == 1), "{rows}");
    bench(["unseen", "--network", &format!("{folder}/none.safetensors")]).fails_with(&["none.safetensors"]);
    for none in ["--count", "--rollouts"] {
        let refused = bench(["unseen", "--network", &network, none, "0"]);
        assert!(refused.code != 0 && refused.stderr.contains(none), "{}", refused.stderr);
    }
    bench(["unseen", "--network", &network, "--hand", "allegro", "--count", "1"]).fails_with(&["leap"]);
}
