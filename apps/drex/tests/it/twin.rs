//! The path from a twin folder to its report: on the bundled data, and on real recordings where they are at hand.

use crate::common;

use std::fs;
use std::process::{Command, Stdio};
use std::time::Instant;

use crate::common::{assert_same_folder, drex, edit, keep_demonstrations, shared_data, small_twin, tin_copy};

#[test]
fn the_tin_is_weighed_lifted_and_grasped_and_the_second_run_has_nothing_to_do() {
    let (_dir, out) = tin_copy();
    // Enough for every stage to have something to do; the demo's test has the whole path at full size.
    keep_demonstrations(&out, 12);
    let run = drex(["run", "--json", out.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let answer = run.json();
    let truth: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(common::tin_data().join("truth.json")).unwrap()).unwrap();
    let truth_kg = truth["mass_kg"].as_f64().unwrap();
    assert_eq!(answer["mass"]["source"], "identified", "{answer}");
    let mass_kg = answer["mass"]["mass_kg"].as_f64().unwrap();
    assert!((mass_kg / truth_kg - 1.0).abs() < 0.05, "{mass_kg} kg, simulated with {truth_kg} kg");
    let ci = &answer["mass"]["ci95_kg"];
    assert!(ci[0].as_f64().unwrap() < mass_kg && mass_kg < ci[1].as_f64().unwrap(), "{ci}");

    // All that was learned was demonstrated; nothing was tried, so that nothing could be made of it.
    let (learned, fits) = (&answer["learned"], &answer["grasps"]["accepted"]);
    let none = serde_json::json!({ "demonstrated": fits, "refined": 0, "searched": 0 });
    assert_eq!(
        (&learned["tried"], &learned["refined"], &learned["searched"]),
        (&none, &none["refined"], &none["searched"])
    );
    assert_eq!(learned["learned"], learned["demonstrated"], "{learned}");
    assert!((1..=fits.as_u64().unwrap()).contains(&learned["learned"].as_u64().unwrap()), "{learned}");

    // What the trial says is what its rollouts are.
    let trial: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("policy/trial.json")).unwrap()).unwrap();
    let held = trial["rollouts"].as_array().unwrap().iter().filter(|r| r["verdict"] == "success").count();
    assert_eq!(answer["trial"]["held"], held, "{answer}");
    assert_eq!(answer["trial"]["n"], trial["rollouts"].as_array().unwrap().len());
    // The emulated hand either moved, and left a log of its joints, or it is said why not.
    assert_eq!(answer["execution"]["not_driven"].is_null(), out.join("policy/execution.csv").is_file(), "{answer}");

    let html = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.contains("<svg") && html.contains("data:image/png;base64,"));
    assert!(!html.contains("http://") && !html.contains("https://"), "the report must not need the network");
    assert!(html.len() < 6_000_000, "{} bytes", html.len());
    // Object: mesh and pieces; push; trial, if anything could be carried out.
    let film = usize::from(!trial["filmed"].is_null());
    assert_eq!(html.matches("<figure class=\"view\"").count(), 3 + film);
    for heading in ["Object", "Mass", "Push", "Trial: lift, hold, shake", "Hand", "How this was made"] {
        assert!(html.contains(&format!("\">{heading}</h2>")), "{heading}");
    }
    let told = common::text_of(&html);
    for word in ["NaN", "inf ", "null"] {
        assert!(!told.contains(word), "{word}");
    }
    assert!(fs::read_to_string(out.join("asset/object.xml")).unwrap().contains("<mujoco"));

    let again = drex(["run", "--json", out.to_str().unwrap()]);
    assert_eq!(again.json()["stages_run"], serde_json::json!([]), "{}", again.stderr);

    let report = drex(["report", "--json", out.to_str().unwrap()]);
    assert_eq!(report.json()["stages_run"], serde_json::json!(["report"]), "{}", report.stderr);
    assert_eq!(fs::read_to_string(out.join("report.html")).unwrap(), html, "the same inputs give the same bytes");

    // A changed input makes its stage and those that build on it again, and only those.
    edit(&out.join("twin.toml"), "prior_kg = 0.5", "weighed_kg = 0.25");
    let weighed = drex(["run", "--json", out.to_str().unwrap()]);
    let made: Vec<&str> = ["identify", "asset", "train", "evaluate", "trial", "execute", "report"].to_vec();
    assert_eq!(weighed.json()["stages_run"], serde_json::json!(made), "{}", weighed.stderr);
    assert_eq!(weighed.json()["mass"]["source"], "weighed");
}

#[test]
fn the_same_seed_gives_the_same_folder_with_any_threads_from_anywhere() {
    let ((_a, one), (_b, two)) = (small_twin(6), small_twin(6));
    let run = drex(["run", "--threads", "1", one.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    // The other lies elsewhere, under another name, and is named from beside it.
    let other = two.with_file_name("another name");
    fs::rename(&two, &other).unwrap();
    let run = Command::new(env!("CARGO_BIN_EXE_drex"))
        .args(["run", "--threads", "2", "./another name/../another name"])
        .current_dir(other.parent().unwrap())
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    assert_same_folder(&one, &other);
    let files = common::tree(&one);
    for word in [one.to_str().unwrap(), "another name", "/tmp"] {
        for (name, bytes) in files.iter().filter(|(name, _)| *name != "timings.json") {
            assert!(!String::from_utf8_lossy(bytes).contains(word), "{name} holds the path {word}");
        }
    }
    let timings: serde_json::Value = serde_json::from_slice(&files["timings.json"]).unwrap();
    for stage in ["identify", "asset", "grasps", "train", "evaluate", "trial", "execute", "report"] {
        assert!(timings["took"][stage]["seconds"].as_f64().unwrap() > 0.0, "{stage}: {timings}");
    }
}

#[test]
fn runs_killed_at_any_moment_end_in_the_same_folder() {
    let ((_a, killed), (_b, whole)) = (small_twin(6), small_twin(6));
    let begun = Instant::now();
    assert_eq!(drex(["run", whole.to_str().unwrap()]).code, 0);
    let took = begun.elapsed();
    // Moments spread by the golden ratio over the first third; each run begins where the one before was killed.
    let mut kills = 0;
    for k in 1..=4 {
        let mut run = Command::new(env!("CARGO_BIN_EXE_drex"))
            .arg("run")
            .arg(&killed)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(took.mul_f64((0.618 * f64::from(k)).fract() / 3.0));
        run.kill().unwrap();
        kills += usize::from(run.wait().unwrap().code().is_none());
    }
    assert!(kills > 0, "every run ended before it was killed");
    let last = drex(["run", killed.to_str().unwrap()]);
    assert_eq!(last.code, 0, "{}", last.stderr);
    assert_same_folder(&killed, &whole);
}

#[test]
fn a_folder_at_which_another_is_at_work_is_for_later() {
    let (_dir, twin) = small_twin(2);
    let held = fs::File::open(twin.join("twin.toml")).unwrap();
    held.lock().unwrap();
    for command in ["run", "train", "report"] {
        let run = drex([command, "--json", twin.to_str().unwrap()]);
        assert_eq!(run.code, 75, "{}", run.stderr);
        let message = run.json()["error"].as_str().unwrap().to_owned();
        assert_eq!(run.stderr.trim(), format!("error: {message}"));
        for words in ["another drex is at work on", twin.to_str().unwrap(), "wait until it is done"] {
            assert!(message.contains(words), "`{words}` is missing in: {message}");
        }
        if cfg!(target_os = "linux") {
            assert!(message.contains(&format!("process {}", std::process::id())), "{message}");
        }
    }
}

#[test]
fn the_doctor_finds_what_the_demo_needs() {
    let run = drex(["doctor", "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let answer = run.json();
    assert_eq!(answer["ready"], true, "{answer}");
    let checks = answer["checks"].as_array().unwrap();
    for check in checks {
        let remedy = check["remedy"].as_str().unwrap();
        assert_eq!(check["found"].as_bool().unwrap(), remedy.is_empty(), "what is missing has a remedy: {check}");
    }
    assert!(checks.iter().any(|c| c["name"] == "LEAP hand model" && c["found"] == true));
}

#[test]
fn what_weighs_nothing_is_said_and_exits_with_0() {
    let Some(data) = shared_data("what_weighs_nothing_is_said_and_exits_with_0") else { return };
    // The efforts of a hand bound the mass even where they do not weigh it.
    let dir = tempfile::tempdir().unwrap();
    for (layout, recording, absent) in [
        ("mujoco-push", "push_mujoco/brick/toss", ["mass_kg", "ci95_kg", "mu_m_kg"].as_slice()),
        ("allegro-run", "drex_real/runs/domino2", &["mass_kg", "mu_m_kg"]),
    ] {
        let push = dir.path().join(layout);
        let source = data.join(recording);
        let import = ["import", layout, source.to_str().unwrap(), "--out", push.to_str().unwrap()];
        assert_eq!(drex(import).code, 0);
        let run = drex(["identify", "--json", push.to_str().unwrap()]);
        assert_eq!(run.code, 0, "{recording}: {}", run.stderr);
        let answer = run.json();
        assert_eq!(answer["verdict"], "not_identifiable", "{recording}: {answer}");
        for key in absent {
            assert!(answer.as_object().unwrap().contains_key(*key) && answer[*key].is_null(), "{recording}: {key}");
        }
        assert!(!answer["reason"].as_str().unwrap().is_empty() && answer.get("seconds").is_none());
    }
}

#[test]
fn a_known_force_weighs_the_object() {
    let Some(data) = shared_data("a_known_force_weighs_the_object") else { return };
    let dir = tempfile::tempdir().unwrap();
    for (object, scenario) in [("brick", "lift_force"), ("can", "tilt_force"), ("letter_l", "slide_force")] {
        let folder = data.join("push_mujoco").join(object).join(scenario);
        let push = dir.path().join(object);
        let import = ["import", "mujoco-push", folder.to_str().unwrap(), "--out", push.to_str().unwrap()];
        let run = drex(import.into_iter().chain(["--poses", "clean", "--force", "exact"]));
        assert_eq!(run.code, 0, "{}", run.stderr);
        let run = drex(["identify", "--json", push.to_str().unwrap()]);
        let truth: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(folder.join("truth.json")).unwrap()).unwrap();
        let (found, truth) = (run.json()["mass_kg"].as_f64().unwrap(), truth["mass"].as_f64().unwrap());
        assert!((found / truth - 1.0).abs() < 0.05, "{object}/{scenario}: {found} for {truth} kg");
    }
}

#[test]
fn real_recordings_become_twins_with_a_report() {
    let Some(data) = shared_data("real_recordings_become_twins_with_a_report") else { return };
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("twins");
    let source = data.join("drex_real");
    for (object, from, words) in [("ketchup", "identified", "efforts"), ("domino", "bounded", "mass by the push alone")]
    {
        let into = ["--out", out.to_str().unwrap(), "--object", object];
        let run = drex(["import", "d-rex", source.to_str().unwrap()].into_iter().chain(into));
        assert_eq!(run.code, 0, "{}", run.stderr);
        let twin = out.join(object);
        let run = drex(["run", "--json", twin.to_str().unwrap()]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let answer = run.json();
        assert_eq!(answer["mass"]["source"], from, "{object}: {answer}");
        let html = fs::read_to_string(twin.join("report.html")).unwrap();
        assert!(html.contains(words), "{object}: the report does not say `{words}`");
    }
}
