//! What came out of `drex demo`: the folder that DREX_DEMO names, since a run takes minutes.
#![allow(clippy::unwrap_used)] // tests: a panic is the report

use std::fs;
use std::path::PathBuf;

use drex_core::Surface;
use drex_core::mesh::sample_surface;
use drex_mesh::MeshSdf;
use serde_json::Value;

#[test]
fn the_demo_weighs_what_it_saw_and_holds_it() {
    let Some(demo) = std::env::var_os("DREX_DEMO").map(PathBuf::from) else {
        eprintln!("skipped the_demo_weighs_what_it_saw_and_holds_it: DREX_DEMO names no folder of a demo that has run");
        return;
    };
    let read = |file: PathBuf| -> Value { serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap() };
    let truth = read(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("data/demo/truth.json"));
    let number = |v: &Value| v.as_f64().unwrap();

    let mass = read(demo.join("mass.json"));
    assert_eq!(mass["source"], "identified", "{}", mass["source"]);
    let ([low, high], truth_kg) = ([0, 1].map(|i| number(&mass["ci95_kg"][i])), number(&truth["mass_kg"]));
    assert!(low < truth_kg && truth_kg < high, "{truth_kg} kg were simulated, {low} to {high} found");
    assert!(high / low < 1.5, "{low} to {high} kg says little");
    // Every mass of the interval was fitted, so that none is excluded between two that the push leaves; at 95 %, by half a chi-square.
    const EXCLUDES: f64 = 1.92;
    let mass_kg = number(&mass["mass_kg"]);
    let profile: Vec<(f64, f64)> = serde_json::from_value(mass["identification"]["profile"].clone()).unwrap();
    let inside: Vec<&(f64, f64)> = profile.iter().filter(|p| low < p.0 && p.0 < high).collect();
    let (below, above) = inside.split_at(inside.partition_point(|p| p.0 <= mass_kg));
    assert!(below.len() > 2 && above.len() > 1, "{profile:?}");
    let least = inside.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let left = |p: &&(f64, f64)| p.1 < least + EXCLUDES;
    assert!(left(&below[below.len() - 1]) && left(&above[0]), "{profile:?}");
    let pieces = inside.chunk_by(|p, q| left(p) == left(q)).filter(|piece| left(&piece[0]));
    assert_eq!(pieces.count(), 1, "{profile:?}");

    // What the documents say that it answers, within a fifth of the interval.
    let numbers = [low, mass_kg, high].map(|kg| 1e3 * kg);
    for (file, before) in [("README.md", "It answers "), ("docs/mass-identification.md", "`drex demo` prints ")] {
        let told = said(file, before);
        let near = numbers.iter().zip(told).all(|(n, t)| (n - t).abs() < 0.2 * (numbers[2] - numbers[0]));
        assert!(near, "{file} says {told:?} g and the demo {numbers:?} g: lower end, mass, upper end");
    }

    let volume_cm3 = 1e6 * number(&read(demo.join("mesh/report.json"))["volume_m3"]);
    let share = volume_cm3 / number(&truth["volume_cm3"]);
    assert!((0.98..1.02).contains(&share), "the mesh has {volume_cm3} cm3, {share} of the truth");
    let truth = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("data/demo/truth/tin.obj");
    let [made, truth] = [demo.join("mesh/visual.obj"), truth].map(|file| drex_mesh::read_mesh(&file).unwrap());
    let (points, truth) = (sample_surface(&made, 20_000, 0), MeshSdf::new(&truth).unwrap());
    let squares: f64 = points.iter().map(|p| (truth.nearest(&p.point).point - p.point).norm_squared()).sum();
    let rms_mm = 1e3 * (squares / points.len() as f64).sqrt();
    eprintln!("volume {share:.4} of the truth, {rms_mm:.3} mm rms from it");
    assert!(rms_mm < 0.5, "the mesh is {rms_mm} mm rms from the truth");
    assert!(fs::metadata(demo.join("picture.png")).unwrap().len() > 10_000);

    let training = read(demo.join("policy/training.json"));
    let count = |of: &str| ["demonstrated", "refined", "searched"].map(|k| training[of][k].as_u64().unwrap());
    let ([shown, _, searched], learned) = (count("tried"), count("learned"));
    assert!(shown > 0 && searched > 0 && learned.iter().sum::<u64>() > 0, "{training}");
    let page = fs::read_to_string(demo.join("report.html")).unwrap();
    assert_eq!(page.contains("None of the grasps that the network learned was demonstrated"), learned[0] == 0);

    let trial = read(demo.join("policy/trial.json"));
    let (held, n) = (trial["held"].as_u64().unwrap(), trial["n"].as_u64().unwrap());
    assert!(4 * held >= 3 * n, "{held} of {n} rollouts held");
    let execution = read(demo.join("policy/execution.json"));
    assert_eq!(execution["held"], true, "the emulated hand: {execution}");
    assert!(page.contains("Trial: lift, hold, shake"));
}

/// Lower end, mass and upper end in grams, as a document says them after `before`: "166 g (95 % interval 156 to 176 g)".
fn said(file: &str, before: &str) -> [f64; 3] {
    let text = fs::read_to_string(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..").join(file)).unwrap();
    let (_, after) = text.split_once(before).unwrap_or_else(|| panic!("{file} does not say `{before}`"));
    let (sentence, _) = after.split_once("g)").unwrap();
    let sentence = sentence.replace("95 % interval", "");
    let numbers: Vec<f64> = sentence.split([' ', '(', '\n']).filter_map(|word| word.parse().ok()).collect();
    let [mass, low, high] = numbers[..] else { panic!("{file} after `{before}`: {numbers:?}") };
    [low, mass, high]
}
