//! `drex identify`: weigh an object from recorded pushes, or say why they cannot.

use anyhow::{Context, Result};
use drex_core::fsutil;
use drex_core::push::{InputChoice, PushRecording};
use drex_sysid::{IdentifyOptions, identify};

use crate::cli::{IdentifyArgs, OnOff};
use crate::object::object_model;
use crate::report::verdict_text;
use crate::ui::Ui;

/// Loads the pushes, builds the object from their mesh, identifies, answers.
pub fn run(args: &IdentifyArgs, ui: &Ui) -> Result<()> {
    let choice = InputChoice { poses: args.poses, force: args.force, encoder: args.encoder == OnOff::On };
    let recordings: Vec<PushRecording> =
        args.pushes.iter().map(|path| PushRecording::load(path, &choice)).collect::<Result<_, _>>()?;
    for (path, recording) in args.pushes.iter().zip(&recordings) {
        ui.note(format!("{}:", path.display()));
        for line in &recording.notes {
            ui.note(format!("  {line}"));
        }
    }
    let mesh = &recordings[0].mesh;
    let (object, _) = object_model(mesh).with_context(|| format!("the object of {}", args.pushes[0].display()))?;
    let spinner = ui.spinner("identify");
    let result = identify(&recordings, &object, &IdentifyOptions::default().with_free_friction(args.free_friction))?;
    spinner.finish_and_clear();
    if let Some(out) = &args.out {
        fsutil::write_atomic(out, serde_json::to_string_pretty(&result)?.as_bytes())?;
    }
    ui.answer(&result, verdict_text(&result))
}
