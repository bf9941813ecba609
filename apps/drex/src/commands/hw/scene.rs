//! Where the joints of an emulated hand are, and what is in their way.

use drex_hw::allegro::WIRE_JOINTS;
use drex_hw::emulator::allegro::AllegroEmulator;
use drex_hw::emulator::leap::LeapEmulator;
use drex_hw::leap::{LeapOptions, table};

/// Places joints of the model at angles, rad, and lets each of `walls` stay between two angles.
pub fn leap_scene(hand: &LeapEmulator, start: &[(&str, f64)], walls: &[(&str, f64, f64)]) {
    let options = LeapOptions::right();
    let motor = |name: &str| options.joints.iter().find(|j| j.name == name);
    for (name, rad) in start {
        if let Some(j) = motor(name) {
            hand.place(j.id, f64::from(j.zero_ticks) + rad / table::RAD_PER_TICK);
        }
    }
    for (name, low, high) in walls {
        if let Some(j) = motor(name) {
            let ticks = |rad: f64| f64::from(j.zero_ticks) + rad / table::RAD_PER_TICK;
            hand.set_wall(j.id, ticks(*low), ticks(*high));
        }
    }
}

/// The same for Allegro.
pub fn allegro_scene(hand: &AllegroEmulator, start: &[(&str, f64)], walls: &[(&str, f64, f64)]) {
    let wire = |name: &str| WIRE_JOINTS.iter().position(|n| *n == name);
    for (name, rad) in start {
        if let Some(j) = wire(name) {
            hand.place(j, *rad);
        }
    }
    for (name, low, high) in walls {
        if let Some(j) = wire(name) {
            hand.set_wall(j, *low, *high);
        }
    }
}
