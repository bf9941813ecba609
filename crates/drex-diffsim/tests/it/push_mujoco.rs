//! Pushes simulated by MuJoCo, replayed here with the true parameters and one set of contact constants: those that the
//! recordings say they were made with.
//!
//! The bar is 1 mm and 1 degree (fingers: 2, until the object leaves the finger), or twice what MuJoCo itself shows
//! between its own step sizes and contact softnesses, whichever is larger. `DREX_PUSH_SET` names another folder of the
//! same layout; with `DREX_PUSH_MESH` the objects are the convex parts of their meshes, not the primitives of the scene.

use crate::recorded::{Push, engine, sensitivity, shared};

const OBJECTS: [&str; 7] = ["letter_t", "letter_l", "letter_l_rho1", "letter_l_rho3", "brick", "can", "bottle"];
const FREE: [&str; 5] = ["lift_force", "slide_force", "tilt_force", "overhang_press", "toss"];
const FINGER: [&str; 4] = ["finger_fast", "finger_slow", "finger_rigid", "finger_tilt"];

/// Prints a line per recording; the names of those outside the bar.
fn compare(scenarios: &[&str], floor: f64, constants: &engine::Constants) -> Option<Vec<String>> {
    let root = match std::env::var_os("DREX_PUSH_SET") {
        Some(folder) => folder.into(),
        None => shared()?.join("data/push_mujoco"),
    };
    let as_mesh = std::env::var_os("DREX_PUSH_MESH").is_some();
    let mut failures = Vec::new();
    println!("{:<15}{:<15}{:>8}{:>9}{:>8}{:>9}  frames", "scenario", "object", "mm", "allowed", "deg", "allowed");
    for scenario in scenarios {
        for object in OBJECTS {
            let Some(push) = Push::load(&root, object, scenario) else { continue };
            let own = sensitivity(&root, object, scenario);
            let (allow_mm, allow_deg) = (floor.max(2.0 * own.0), floor.max(2.0 * own.1));
            let frames = push.frames_touched();
            let shapes = if as_mesh { &push.pieces } else { &push.shapes };
            let (mm, deg) = match engine::replay(&push, shapes, constants) {
                Ok(poses) => push.rms(&poses, frames),
                Err(e) => {
                    println!("{scenario}/{object}: {e}");
                    (f64::NAN, f64::NAN)
                }
            };
            let good = mm <= allow_mm && deg <= allow_deg;
            println!(
                "{scenario:<15}{object:<15}{mm:>8.3}{allow_mm:>9.2}{deg:>8.3}{allow_deg:>9.2}  {frames}/{}{}",
                push.times_s.len(),
                if good { "" } else { "  OUTSIDE" }
            );
            if !good {
                failures.push(format!("{object}/{scenario}"));
            }
        }
    }
    Some(failures)
}

#[test]
fn known_forces_and_tosses_move_as_in_mujoco() {
    let Some(failures) = compare(&FREE, 1.0, &engine::Constants::mujoco()) else { return };
    assert!(failures.is_empty(), "{} outside: {}", failures.len(), failures.join(", "));
}

#[test]
fn fingers_push_as_in_mujoco() {
    let Some(failures) = compare(&FINGER, 2.0, &engine::Constants::mujoco()) else { return };
    assert!(failures.is_empty(), "{} outside: {}", failures.len(), failures.join(", "));
}

/// Hard contact is another model of the same bodies: it agrees where nothing slides fast or rebounds.
#[test]
fn hard_contact_moves_alike_where_nothing_rebounds() {
    let Some(outside) = compare(&FREE, 1.0, &engine::Constants::default()) else { return };
    let same = ["lift_force", "overhang_press"];
    let failures: Vec<_> = outside.iter().filter(|name| same.iter().any(|s| name.ends_with(s))).collect();
    assert!(failures.is_empty(), "{failures:?}");
    let Some(failures) = compare(&FINGER, 2.0, &engine::Constants::default()) else { return };
    assert!(failures.is_empty(), "{failures:?}");
}
