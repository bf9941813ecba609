//! Where the joints of an emulated hand are, and what is in their way.

use crate::allegro::AllegroOptions;
use crate::emulator::allegro::AllegroEmulator;
use crate::emulator::leap::LeapEmulator;
use crate::leap::{LeapOptions, table};

/// Places joints of the model at angles, rad, and lets each of `walls` stay between two angles.
pub fn leap_scene(hand: &LeapEmulator, options: &LeapOptions, start: &[(&str, f64)], walls: &[(&str, f64, f64)]) {
    let motor = |name: &str| {
        let joint = options.joints.iter().find(|j| j.name == name)?;
        let per_rad = if joint.reversed { -1.0 } else { 1.0 } / table::RAD_PER_TICK;
        Some((joint.id, f64::from(joint.zero_ticks), per_rad))
    };
    for (name, rad) in start {
        if let Some((id, zero, per_rad)) = motor(name) {
            hand.place(id, zero + rad * per_rad);
        }
    }
    for (name, low, high) in walls {
        if let Some((id, zero, per_rad)) = motor(name) {
            let (a, b) = (zero + low * per_rad, zero + high * per_rad);
            hand.set_wall(id, a.min(b), a.max(b));
        }
    }
}

/// The same for Allegro.
pub fn allegro_scene(
    hand: &AllegroEmulator,
    options: &AllegroOptions,
    start: &[(&str, f64)],
    walls: &[(&str, f64, f64)],
) {
    let wire = |name: &str| options.names.iter().position(|n| n == name);
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
