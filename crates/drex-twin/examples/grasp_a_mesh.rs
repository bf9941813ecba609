//! A mesh and a mass in; a grasp, its grip force and what became of it in simulation out.
//!
//!     cargo run --release -p drex-twin --example grasp_a_mesh [-- MESH.obj KG [SIMULATED]]
//!
//! Without arguments it grasps the tin of the repository. SIMULATED is how many grasps are simulated before one is chosen. `bindings/python/examples/grasp_a_mesh.py` is the same in Python.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::ops::ControlFlow;

use drex_core::pose::to_wxyz;
use drex_mesh::{AssetOptions, build_asset};
use drex_robot::Robot;
use drex_trial::FindOptions;
use drex_twin::propose::find_grasp;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mesh = arguments.next().unwrap_or("data/tin/scan/tin.obj".into());
    let mass_kg: f64 = arguments.next().unwrap_or("0.236".into()).parse()?;
    let mut options = FindOptions::default();
    options.simulated = arguments.next().map_or(Ok(options.simulated), |n| n.parse())?;

    let object = build_asset(mesh.as_ref(), &AssetOptions::default())?.to_object("object")?.with_mass(mass_kg);
    let hand = Robot::bundled("leap_right")?;
    let Some(found) = find_grasp(&object, &hand, &options, &|_| ControlFlow::Continue(()))? else {
        println!("the hand finds no grasp that holds it");
        return Ok(());
    };

    for (joint, angle) in found.grasp.joint_names.iter().zip(&found.grasp.joints_rad) {
        println!("{joint:>8} {angle:7.3} rad");
    }
    let ([x, y, z], [qw, qx, qy, qz]) = to_wxyz(&found.grasp.object_from_base);
    println!("object_from_base: {x:.4} {y:.4} {z:.4} m, quaternion {qw:.4} {qx:.4} {qy:.4} {qz:.4}");
    println!("grip force: {:.1} N", found.grip_force_n);
    let verdicts: Vec<String> = found.verdicts.iter().map(ToString::to_string).collect();
    println!("held in {} of {} trials: {}", found.held, verdicts.len(), verdicts.join(", "));
    Ok(())
}
