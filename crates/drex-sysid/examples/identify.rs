//! Weighs the object of one recorded push and prints the answer as JSON.
//!
//!     cargo run --release -p drex-sysid --example identify -- FOLDER [--poses KIND] [--force KIND] [--free-friction] [--full]
//!
//! The folder is a push as `drex_recording::PushRecording::load` reads it; its mesh must consist of closed convex shells in OBJ.

use std::error::Error;
use std::io::Write;
use std::path::Path;

use drex_core::TriMesh;
use drex_recording::{InputChoice, PushRecording};
use drex_sysid::{IdentifyOptions, Knowledge, ObjectModel, Parameter, identify};

fn main() -> Result<(), Box<dyn Error>> {
    let mut choice = InputChoice::default();
    let mut options = IdentifyOptions::default();
    let mut folder = None;
    let mut full = false;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or_else(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--poses" => choice.poses = value()?.parse()?,
            "--force" => choice.force = value()?.parse()?,
            "--free-friction" => options.parameters.set(Parameter::Friction, Knowledge::Free)?,
            "--full" => full = true,
            _ => folder = Some(arg),
        }
    }
    let folder = folder.ok_or("name the folder of a push")?;
    let recording = PushRecording::load(Path::new(&folder), &choice)?;
    let object = ObjectModel::from_mesh(&TriMesh::read(&recording.mesh)?)?;
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
