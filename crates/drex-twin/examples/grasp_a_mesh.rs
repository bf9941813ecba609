//! A mesh and a mass in; a grasp, its grip force and what became of it in simulation out.
//!
//!     cargo run --release -p drex-twin --example grasp_a_mesh -- MESH.obj 0.2
#![allow(clippy::print_stdout)] // an example talks to a person

use drex_mesh::{AssetOptions, build_asset};
use drex_robot::Robot;
use drex_trial::{FindOptions, find_grasp};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mesh = arguments.next().ok_or("give a mesh and a mass in kg")?;
    let mass_kg: f64 = arguments.next().ok_or("give the mass in kg")?.parse()?;

    let object = build_asset(mesh.as_ref(), &AssetOptions::default())?.to_object("object")?.with_mass(mass_kg);
    let hand = Robot::bundled("leap_right")?;
    let Some(found) = find_grasp(&object, &hand, &FindOptions::default())? else {
        println!("the hand finds no grasp that holds it");
        return Ok(());
    };

    for (joint, angle) in hand.joint_names().iter().zip(&found.grasp.joints_rad) {
        println!("{joint:>8} {angle:7.3} rad");
    }
    println!("object_from_base: {}", found.grasp.object_from_base);
    println!("grip force: {:.1} N", found.grip_force_n);
    println!("held in {} of {} trials: {:?}", found.held, found.verdicts.len(), found.verdicts);
    Ok(())
}
