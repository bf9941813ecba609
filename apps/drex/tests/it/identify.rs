//! What can be said on the command line about a push, and what comes back.

use crate::common::{drex, tin_copy, tin_data};

fn tilt() -> String {
    tin_data().join("push/tilt").to_str().unwrap().to_owned()
}

/// The mass that the demo's push was simulated with.
fn truth() -> f64 {
    let text = std::fs::read_to_string(tin_data().join("truth.json")).unwrap();
    serde_json::from_str::<serde_json::Value>(&text).unwrap()["mass_kg"].as_f64().unwrap()
}

#[test]
fn the_demo_push_is_weighed_and_the_guess_takes_no_part() {
    let answers: Vec<serde_json::Value> =
        ["0.02", "wood"].iter().map(|guess| drex(["identify", "--json", "--guess", guess, &tilt()]).json()).collect();
    for a in &answers {
        assert_eq!(a["verdict"], "identified");
        let ci: Vec<f64> = a["ci95_kg"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        assert!(ci[0] < truth() && truth() < ci[1], "{ci:?}");
        assert_eq!(a["mass_kg"], answers[0]["mass_kg"]);
    }
    assert_eq!(answers[0]["prior_kg"], 0.02);
    assert!(answers[1]["prior_kg"].as_f64().unwrap() > 0.1, "{}", answers[1]["prior_kg"]);
}

#[test]
fn what_is_stated_is_assumed_and_said() {
    let run = drex(["identify", &tilt(), "--fix", "friction=0.6", "--prior", "contact_height=0,0.001"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stdout.contains("friction is 0.6") && run.stdout.contains("contact_height"), "{}", run.stdout);
    let fixed = drex(["identify", "--json", "--fix", "mass=0.2", &tilt()]).json();
    assert_eq!(fixed["verdict"], "not_identifiable");
    assert!(fixed["reason"].as_str().unwrap().contains("fixed to 200.0 g"), "{}", fixed["reason"]);
    // push.toml may say it too.
    let (_dir, twin) = tin_copy();
    let toml = twin.join("push/tilt/push.toml");
    let text = std::fs::read_to_string(&toml).unwrap();
    std::fs::write(&toml, format!("{text}\n[parameters]\nmass = 0.2\n")).unwrap();
    let said = drex(["identify", "--json", toml.to_str().unwrap()]).json();
    assert!(said["reason"].as_str().unwrap().contains("fixed to 200.0 g"), "{}", said["reason"]);
}

#[test]
fn nonsense_is_named() {
    let refused = |extra: &[&str]| {
        let run =
            drex(["identify", &tilt()].into_iter().map(str::to_owned).chain(extra.iter().map(|s| (*s).to_owned())));
        (run.code, run.stderr)
    };
    for (extra, code, word) in [
        (["--free", "weight"], 2, "mass, friction"),
        (["--fix", "friction"], 2, "NAME=VALUE"),
        (["--fix", "friction=-1"], 1, "friction cannot be -1"),
        (["--prior", "mass=0.2"], 2, "MEAN,SD"),
        (["--guess", "unobtainium"], 1, "hardwood"),
    ] {
        let (found, text) = refused(&extra);
        assert!(found == code && text.contains(word), "{extra:?}: {found} {text}");
    }
    let (code, text) = refused(&["--free", "friction", "--fix", "friction=0.5"]);
    assert!(code == 1 && text.contains("stated twice"), "{text}");
}
