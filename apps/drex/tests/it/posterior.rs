//! One posterior of the mass: what the push says is never overruled by a guess without a word, and grasps are made for both together.

use std::fs;
use std::path::Path;

use crate::common::{Run, drex, edit, keep_demonstrations, shared_data, text_of, tin_copy};
use serde_json::Value;

const GUESS: &str = "prior_kg = 0.5";

fn read(file: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Both ends of the pushes' own interval, kg.
fn push_alone(mass: &Value) -> [f64; 2] {
    [0, 1].map(|i| number(&mass["push_ci95_kg"][i]))
}

/// What a run on a terminal says, by the labels of its lines.
fn line<'a>(run: &'a Run, label: &str) -> &'a str {
    run.stdout.lines().find(|l| l.starts_with(label)).unwrap_or_else(|| panic!("no `{label}` in: {}", run.stdout))
}

/// The twin without grasps.
fn without_grasps(twin: &Path) {
    let manifest = twin.join("twin.toml");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.split("[grasps]").next().unwrap()).unwrap();
}

/// Asserts that a guess of 500 g and a push that leaves an interval below it meet inside the interval, and that force, trial and page
/// are made with the outcome.
fn is_used(twin: &Path, run: &Run) {
    let mass = read(&twin.join("mass.json"));
    let [low, high] = push_alone(&mass);
    let (mass_kg, grip_kg) = (number(&mass["mass_kg"]), number(&mass["grip_kg"]));
    assert!(high < 0.5, "the push excludes the guess: {high}");
    assert!(low < mass_kg && mass_kg < grip_kg && grip_kg < high, "{low} < {mass_kg} < {grip_kg} < {high}");
    assert!(
        (number(&mass["prior"]["sd_log"]) - 2.0_f64.ln()).abs() < 1e-12 && number(&mass["prior"]["mass_kg"]) == 0.5
    );

    // The grasp is for it, and not for the guess.
    let grasp = drex(["grasp", "--json", twin.to_str().unwrap()]).json();
    let guessed = drex(["grasp", "--json", "--mass", "0.5", twin.to_str().unwrap()]).json();
    assert_eq!(grasp["mass_kg"], mass["grip_kg"]);
    if let (Some(needed), Some(for_guess)) = (grasp["needed_squeeze_n"].as_f64(), guessed["needed_squeeze_n"].as_f64())
    {
        assert!(needed < for_guess, "{needed} N at {grip_kg} kg, {for_guess} N at 0.5 kg");
    }

    // True masses are drawn from the posterior.
    let trial = read(&twin.join("policy/trial.json"));
    assert_eq!(trial["mass_kg"], mass["grip_kg"]);
    assert!(trial["mass_sd_kg"] == mass["sd_kg"] && number(&mass["sd_kg"]) > 0.01, "{}", mass["sd_kg"]);
    let mut drawn: Vec<f64> = trial["rollouts"].as_array().unwrap().iter().map(|r| number(&r["mass_kg"])).collect();
    drawn.sort_by(f64::total_cmp);
    let [first, middle, last] = [0, drawn.len() / 2, drawn.len() - 1].map(|i| drawn[i]);
    assert!(last / first > 1.5, "{drawn:?}");
    assert!((middle / mass_kg).ln().abs() < 0.35, "half of {drawn:?} is not about {mass_kg}");

    // Terminal and page say all three.
    let (posterior, alone) = (line(run, "  mass "), line(run, "  push alone "));
    let grams = |kg: f64| format!("{:.1}", 1e3 * kg);
    assert!(
        posterior.contains(&grams(mass_kg)) && posterior.contains(&grams(number(&mass["ci95_kg"][1]))),
        "{posterior}"
    );
    assert!(alone.contains(&format!("{} to {} g", grams(low), grams(high))), "{alone}");
    assert!(line(run, "  prior ").contains("500.0 g") && line(run, "  grip ").contains(&grams(grip_kg)));
    let page = text_of(&fs::read_to_string(twin.join("report.html")).unwrap());
    for words in [
        grams(mass_kg),
        format!("<b>{} to {} g</b><span>mass by the push alone", grams(low), grams(high)),
        "Before the push: 500.0 g".to_owned(),
        format!("The hand takes the object for {} g", grams(grip_kg)),
        "drawn from the posterior of the mass".to_owned(),
    ] {
        assert!(page.contains(&words), "the page does not say `{words}`");
    }
    assert!(!page.contains("standard deviation of 0.0 g") && !page.contains("standard deviation 0.0 g"));
}

#[test]
fn a_wide_push_and_a_guess_give_one_grasp_for_both_together() {
    let (_dir, twin) = tin_copy();
    keep_demonstrations(&twin, 6);
    edit(&twin.join("twin.toml"), "hand = \"leap_right\"", "hand = \"leap_right\"\n\n[train]\nepochs = 5");
    // A force sensor that is right to 25 % leaves masses from about 140 to 380 g.
    let push = twin.join("push/tilt/push.toml");
    let text = fs::read_to_string(&push).unwrap();
    fs::write(&push, format!("{text}\n[parameters]\nforce_gain = {{ mean = 1.0, sd = 0.25 }}\n")).unwrap();
    let run = drex(["run", twin.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    is_used(&twin, &run);
}

#[test]
fn the_cookie_tin_is_grasped_for_what_its_push_leaves_of_the_guess() {
    let Some(data) = shared_data("the_cookie_tin_is_grasped_for_what_its_push_leaves_of_the_guess") else { return };
    let dir = tempfile::tempdir().unwrap();
    let (source, out) = (data.join("drex_real"), dir.path().join("twins"));
    let into = ["--out", out.to_str().unwrap(), "--object", "cookie"];
    let imported = drex(["import", "d-rex", source.to_str().unwrap()].into_iter().chain(into));
    assert_eq!(imported.code, 0, "{}", imported.stderr);
    let twin = out.join("cookie");
    first_rows(&twin.join("demos/cookie_leap_grasps.npy"), 132, 8);
    let order = "joint_order = \"leap_sdk\"";
    edit(&twin.join("twin.toml"), order, &format!("{order}\n\n[train]\nepochs = 5"));
    let run = drex(["run", twin.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let mass = read(&twin.join("mass.json"));
    assert_eq!((&mass["source"], &mass["identification"]["verdict"]), (&"bounded".into(), &"not_identifiable".into()));
    let [low, high] = push_alone(&mass);
    assert!((0.05..0.08).contains(&low) && (0.3..0.38).contains(&high), "{low} to {high} kg by the push alone");
    is_used(&twin, &run);
}

/// Leaves the first `keep` of `rows` rows of an array in a file of NumPy's.
fn first_rows(file: &Path, rows: usize, keep: usize) {
    let mut bytes = fs::read(file).unwrap();
    let header = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let text = String::from_utf8(bytes[10..header].to_vec()).unwrap();
    let (old, new) = (format!("({rows},"), format!("({keep},"));
    assert!(text.contains(&old), "{text}");
    let text = text.replace(&old, &format!("{new:>width$}", width = old.len()));
    bytes.splice(10..header, text.into_bytes());
    let all = bytes.len() - header;
    bytes.truncate(header + all / rows * keep);
    fs::write(file, bytes).unwrap();
}

#[test]
fn a_contradiction_is_said_first_with_what_to_do() {
    let (_dir, twin) = tin_copy();
    without_grasps(&twin);
    for (stated, what, remedy) in [
        ("prior_kg = 3.0\nprior_sd_log = 0.3", "the prior", "weighed_kg"),
        ("weighed_kg = 0.5", "the scale", "weigh the object again"),
    ] {
        let manifest = twin.join("twin.toml");
        let text = fs::read_to_string(&manifest).unwrap();
        let before = text.split("[mass]").next().unwrap();
        fs::write(&manifest, format!("{before}[mass]\nidentify = [\"push/tilt\"]\n{stated}\n")).unwrap();
        let run = drex(["run", twin.to_str().unwrap()]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let second = run.stdout.lines().nth(1).unwrap();
        assert!(
            second.starts_with(&format!("  warning    {what} and the push contradict each other by")),
            "{}",
            run.stdout
        );
        assert!(second.contains(remedy), "{second}");
        let page = fs::read_to_string(twin.join("report.html")).unwrap();
        let (warned, figures) = (page.find("class=\"warning\"").unwrap(), page.find("class=\"figures\"").unwrap());
        assert!(warned < figures && text_of(&page).contains("contradict each other by"));
        let answer = drex(["identify", "--json", twin.to_str().unwrap()]).json();
        assert!(
            number(&answer["mass"]["contradiction_sd"]) > 1.96 && answer["mass"]["contradiction"].is_string(),
            "{answer}"
        );
    }
    // The same of a push with a guess on the command line.
    let push = twin.join("push/tilt");
    let run = drex(["identify", "--guess", "30", push.to_str().unwrap()]);
    assert!(run.stdout.starts_with("warning: the prior and the push contradict each other by"), "{}", run.stdout);
    let agrees = drex(["identify", push.to_str().unwrap()]);
    assert!(
        agrees.stdout.starts_with("identified: ") && agrees.stdout.contains("\nwith the prior of 500.0 g"),
        "{}",
        agrees.stdout
    );
}

#[test]
fn a_mass_that_is_stated_twice_does_not_count_twice() {
    let (_dir, twin) = tin_copy();
    let push = twin.join("push/tilt/push.toml");
    let text = fs::read_to_string(&push).unwrap();
    fs::write(&push, format!("{text}\n[parameters]\nmass = {{ mean = 0.5, sd = 0.3 }}\n")).unwrap();
    drex(["run", twin.to_str().unwrap()]).fails_with(&["stated twice", "[parameters]", "keep the one in twin.toml"]);
}

#[test]
fn a_push_that_says_nothing_leaves_the_prior_and_that_is_said() {
    let (_dir, twin) = tin_copy();
    without_grasps(&twin);
    let push = twin.join("push/tilt/push.toml");
    let text = fs::read_to_string(&push).unwrap();
    // Poses in the frame of a camera that nobody calibrated.
    fs::write(&push, text.replace("frame = \"world\"", "frame = \"camera\"")).unwrap();
    let run = drex(["run", twin.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let mass = read(&twin.join("mass.json"));
    assert!(mass["source"] == "prior" && mass["push_ci95_kg"].is_null() && mass["contradiction_sd"].is_null());
    assert!((number(&mass["mass_kg"]) / 0.5 - 1.0).abs() < 1e-9 && number(&mass["sd_kg"]) > 0.3);
    assert!(line(&run, "  mass ").contains("(95 %: 128."), "{}", run.stdout);
    assert!(line(&run, "  push alone ").contains("the prior stays as it is"), "{}", run.stdout);
    let page = text_of(&fs::read_to_string(twin.join("report.html")).unwrap());
    assert!(page.contains("not confirmed by any recording"));
    // Without a guess there is no mass, and the message says what to do.
    edit(&twin.join("twin.toml"), GUESS, "");
    edit(&push, "mass_prior_kg = 0.5", "");
    drex(["run", twin.to_str().unwrap()]).fails_with(&["nobody guessed one", "weigh the object", "twin.toml"]);
}
