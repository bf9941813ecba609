//! `drex identify`: weigh an object from recorded pushes, or say why they cannot; the posterior where a prior is stated.

use std::path::Path;

use anyhow::{Context, Result, bail};
use drex_core::fsutil;
use drex_mesh::{AssetOptions, build_asset};
use drex_recording::PushRecording;
use drex_sysid::calibrate::HandCalibration;
use drex_sysid::{
    Identification, IdentifyOptions, Knowledge, MassPosterior, MassPrior, Method, Parameter, ParameterSet,
    identify_watched,
};
use drex_twin::manifest::MANIFEST;
use serde_json::{Value, json};

use crate::cli::{IdentifyArgs, MethodArg, OnOff, ToolArgs, TwinArgs};
use crate::ui::Ui;
use drex_report::{contradiction_text, posterior_text, prior_text, verdict_text};
use drex_twin::Stage;
use drex_twin::records::MassFile;

/// Loads the pushes, builds the object from their mesh, identifies, answers. For a twin it is the stage of that name.
pub fn run(args: &IdentifyArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    if let [twin] = &args.pushes[..]
        && (twin.join(MANIFEST).is_file() || twin.file_name().is_some_and(|n| n == MANIFEST))
    {
        if args.states_something() {
            bail!(
                "{} is a twin, whose pushes are identified with what twin.toml and each push.toml say; name one of its pushes to try options",
                twin.display()
            );
        }
        let args = TwinArgs { twin: twin.clone(), tools: ToolArgs::default() };
        return super::run::run(&args, Stage::Identify, false, seed, ui);
    }
    let mut recordings: Vec<PushRecording> =
        args.pushes.iter().map(|path| PushRecording::load(path)).collect::<Result<_, _>>()?;
    if args.encoder == OnOff::Off {
        recordings = recordings.into_iter().map(PushRecording::without_encoder).collect();
    }
    for (path, recording) in args.pushes.iter().zip(&recordings) {
        ui.note(format!("{}:", path.display()));
        for line in &recording.notes {
            ui.note(format!("  {line}"));
        }
    }
    let Some(first) = recordings.first() else { bail!("no push was given") };
    let mesh = fsutil::read_bytes(&first.mesh)?;
    for other in &recordings {
        if fsutil::read_bytes(&other.mesh)? == mesh {
            continue;
        }
        bail!(
            "{} pushes {} and {} pushes {}; several pushes at once must be of one object",
            first.name,
            first.mesh.display(),
            other.name,
            other.mesh.display()
        );
    }
    let asset = build_asset(&first.mesh, &AssetOptions::in_metres())?;
    let object = asset.to_exact_object("")?;
    let prior = match &args.guess {
        Some(guess) => Some(guessed(guess, asset.report.volume_m3)?),
        None => recordings.iter().find_map(|r| r.mass_prior_kg).map(MassPrior::from_number).transpose()?,
    };
    if let Some(prior) = &prior {
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
    let mut answer = without_series(&result)?;
    let mut text = verdict_text(&result);
    // A prior that took part in the estimate does not count twice, and Adam gives nothing that could be multiplied.
    let counted = recordings.iter().any(|r| r.parameters.contains_key(Parameter::Mass.as_str()))
        || options.parameters.get(Parameter::Mass).is_some();
    if let Some(prior) = prior.filter(|_| !counted && options.method == Method::Lm) {
        let mass = MassFile::new(MassPosterior::of(Some(prior.clone()), Some(&result))?, None);
        answer["posterior"] = json!({ "mass_kg": mass.mass_kg, "ci95_kg": mass.ci95_kg, "sd_kg": mass.sd_kg, "source": mass.source,
                                      "prior": mass.prior, "contradiction_sd": mass.contradiction_sd });
        text = match mass.push_ci95_kg {
            Some(_) => format!("{text}\nwith the prior of {}: {}", prior_text(&prior), posterior_text(&mass)),
            None => format!("{text}\nthe prior stays as it is: {}", prior_text(&prior)),
        };
        if let Some(contradiction) = contradiction_text(&mass) {
            text = format!("warning: {contradiction}\n{text}");
        }
    }
    ui.answer(&answer, text)
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

/// The result without the long series (law of the mass, trajectories), which `--out` keeps.
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
