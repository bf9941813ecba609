//! Weighs the object of one recorded push and prints the answer as JSON.
//!
//!     cargo run --release -p drex-sysid --example identify -- PUSH [--mujoco] [--free-friction] [--seed N] [--full]
//!
//! PUSH is a `push.toml` or a folder that holds one, with `--mujoco` a folder of a set of simulated pushes; its mesh must consist of
//! closed convex shells in OBJ.

use std::error::Error;
use std::io::Write;
use std::path::Path;

use drex_mesh::{AssetOptions, build_asset};
use drex_recording::PushRecording;
use drex_recording::convert::mujoco_push::{self, Inputs};
use drex_sysid::{IdentifyOptions, Knowledge, Parameter, identify};

fn main() -> Result<(), Box<dyn Error>> {
    let mut mujoco = false;
    let mut options = IdentifyOptions::default();
    let mut folder = None;
    let mut full = false;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--mujoco" => mujoco = true,
            "--free-friction" => options.parameters.set(Parameter::Friction, Knowledge::Free)?,
            "--seed" => options.seed = args.next().ok_or("--seed needs a number")?.parse()?,
            "--full" => full = true,
            _ => folder = Some(arg),
        }
    }
    let folder = folder.ok_or("name the folder of a push")?;
    let recording = match mujoco {
        true => mujoco_push::load(Path::new(&folder), Inputs::default())?,
        false => PushRecording::load(Path::new(&folder))?,
    };
    let object = build_asset(&recording.mesh, &AssetOptions::in_metres())?.to_exact_object("")?;
    let mut answer = identify(&[recording], &object, &options)?;
    if !full {
        answer.profile.clear();
        for push in &mut answer.pushes {
            push.times_s.clear();
            push.observed.clear();
            push.simulated.clear();
        }
    }
    let mut value = serde_json::to_value(&answer)?;
    value["seconds"] = answer.seconds.into();
    writeln!(std::io::stdout(), "{value}")?;
    Ok(())
}
