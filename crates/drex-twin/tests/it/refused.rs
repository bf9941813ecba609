//! Input that cannot be used: named with its place, before anything of it is written.

use std::fs;

use crate::common::{fails_with, message, weighed_twin};
use crate::support::edit;

#[test]
fn a_joint_that_the_hand_does_not_have_is_named() {
    let (_dir, twin) = weighed_twin();
    edit(&twin.join("demos/grasps.json"), "\"if_mcp\"", "\"index_knuckle\"");
    fails_with(&twin, &["stage grasps", "index_knuckle", "leap_right"]);
    assert!(!twin.join("grasps").exists());
}

#[test]
fn an_empty_demo_set_is_refused() {
    let (_dir, twin) = weighed_twin();
    let none = "{\"schema\": 1, \"joint_names\": [\"if_mcp\"], \"unit\": \"rad\", \"grasps\": []}";
    fs::write(twin.join("demos/grasps.json"), none).unwrap();
    fails_with(&twin, &["stage grasps", "grasps.json"]);
    assert!(!twin.join("grasps").exists());
}

#[test]
fn an_unknown_key_of_the_manifest_is_refused_with_its_line() {
    let (_dir, twin) = weighed_twin();
    edit(&twin.join("twin.toml"), "weighed_kg = 0.236", "weighed_g = 236");
    let Err(error) = drex_twin::Twin::open(&twin) else { panic!("weighed_g is no key") };
    let said = message(&error);
    assert!(["twin.toml", "weighed_g", "line 12"].iter().all(|word| said.contains(word)), "{said}");
}
