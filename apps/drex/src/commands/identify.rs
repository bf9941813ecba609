//! `drex identify`: weigh an object from recorded pushes, or say why they cannot.

use std::path::Path;

use anyhow::{Context, Result, bail};
use drex_core::fsutil;
use drex_core::push::{InputChoice, PushRecording};
use drex_mesh::{AssetOptions, LengthUnit, build_asset};
use drex_sysid::calibrate::HandCalibration;
use drex_sysid::{Identification, IdentifyOptions, Knowledge, MassPrior, Method, ParameterSet, identify_watched};
use serde_json::Value;

use crate::cli::{IdentifyArgs, MethodArg, OnOff};
use crate::object::model_of;
use crate::report::verdict_text;
use crate::ui::Ui;

/// Loads the pushes, builds the object from their mesh, identifies, answers.
pub fn run(args: &IdentifyArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    let choice = InputChoice { poses: args.poses, force: args.force, encoder: args.encoder == OnOff::On };
    let mut recordings: Vec<PushRecording> =
        args.pushes.iter().map(|path| PushRecording::load(path, &choice)).collect::<Result<_, _>>()?;
    for (path, recording) in args.pushes.iter().zip(&recordings) {
        ui.note(format!("{}:", path.display()));
        for line in &recording.notes {
            ui.note(format!("  {line}"));
        }
    }
    let Some(first) = recordings.first() else { bail!("no push was given") };
    if let Some(other) = recordings.iter().find(|r| !same_file(&r.mesh, &first.mesh)) {
        bail!(
            "{} pushes {} and {} pushes {}; several pushes at once must be of one object",
            first.name,
            first.mesh.display(),
            other.name,
            other.mesh.display()
        );
    }
    let mut metres = AssetOptions::default();
    metres.unit = LengthUnit::Metre;
    let asset = build_asset(&first.mesh, &metres)?;
    let object = model_of(&asset);
    if let Some(guess) = &args.guess {
        let prior = guessed(guess, asset.report.volume_m3)?;
        ui.note(format!(
            "first guess: {:.1} g ({}); it takes no part in the answer",
            1e3 * prior.mass_kg,
            prior.source
        ));
        recordings.iter_mut().for_each(|r| r.mass_prior_kg = Some(prior.mass_kg));
    }
    let mut options = IdentifyOptions::default();
    options.parameters = parameters(args)?;
    options.method = match args.method {
        MethodArg::Lm => Method::Lm,
        MethodArg::Adam => Method::Adam,
    };
    options.hand = args.hand.as_deref().map(HandCalibration::load).transpose()?;
    options.seed = seed.unwrap_or(options.seed);
    let bar = ui.slow_bar("identify");
    let result = identify_watched(&recordings, &object, &options, &|part| bar.show(part))?;
    bar.clear();
    if let Some(out) = &args.out {
        fsutil::write_atomic(out, serde_json::to_string_pretty(&result)?.as_bytes())?;
    }
    ui.answer(&without_series(&result)?, verdict_text(&result))
}

/// A guess as the command line gives it.
fn guessed(text: &str, volume_m3: f64) -> Result<MassPrior> {
    Ok(match text.parse::<f64>() {
        Ok(kg) => MassPrior::from_number(kg)?,
        Err(_) if text.ends_with(".json") => {
            let file = Path::new(text);
            MassPrior::from_json(&fsutil::read_text(file)?, Some(volume_m3)).with_context(|| text.to_owned())?
        }
        Err(_) => MassPrior::from_material(text, volume_m3)?,
    })
}

/// What the command line states about parameters.
fn parameters(args: &IdentifyArgs) -> Result<ParameterSet> {
    let mut out = ParameterSet::default();
    let free = args.free.iter().map(|p| (*p, Knowledge::Free));
    let fixed = args.fix.iter().map(|(p, value)| (*p, Knowledge::Fixed(*value)));
    let prior = args.prior.iter().map(|(p, [mean, sd])| (*p, Knowledge::Prior { mean: *mean, sd: *sd }));
    for (parameter, knowledge) in free.chain(fixed).chain(prior) {
        if out.get(parameter).is_some() {
            bail!("{} is stated twice; say once what is known about it", parameter.as_str());
        }
        out.set(parameter, knowledge)?;
    }
    Ok(out)
}

/// The result without the long series (likelihood profile, trajectories), which `--out` keeps.
fn without_series(result: &Identification) -> Result<Value> {
    let mut value = serde_json::to_value(result)?;
    if let Some(object) = value.as_object_mut() {
        object.remove("profile");
    }
    for push in value["pushes"].as_array_mut().into_iter().flatten().filter_map(Value::as_object_mut) {
        for series in ["times_s", "observed", "simulated"] {
            push.remove(series);
        }
    }
    Ok(value)
}

fn same_file(a: &Path, b: &Path) -> bool {
    matches!((std::fs::canonicalize(a), std::fs::canonicalize(b)), (Ok(a), Ok(b)) if a == b)
}
