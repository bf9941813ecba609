//! Pushes to a mass.

use std::path::PathBuf;

use crate::Result;
use crate::error::{Context, refuse};
use drex_core::fsutil;
use drex_recording::{PushRecording, StatedParameter, mesh_sd_m};
use drex_sysid::{IdentifyOptions, MassPosterior, MassPrior, Parameter, identify_watched};

use crate::Progress;
use crate::Twin;
use crate::records::MassFile;
use crate::records::{MASS, write_json};

/// Steps in which progress is reported.
const PARTS: u64 = 100;

/// Identifies and multiplies with the prior.
pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let mut recordings = recordings(twin)?;
    // A push may name another copy of the mesh than the twin.
    let of_twin = mesh_sd_m(&twin.path(&twin.manifest.object.mesh))?;
    recordings.iter_mut().for_each(|r| r.mesh_sd_m = r.mesh_sd_m.or(of_twin));
    let prior = prior(twin, &recordings)?;
    if prior.is_some() {
        stated_once(&recordings)?;
    }
    let identification = if recordings.is_empty() {
        None
    } else {
        progress.begin("identify", Some(PARTS));
        let mut options = IdentifyOptions::default();
        options.seed = twin.seed;
        let object = twin.object()?;
        let result =
            identify_watched(&recordings, &object, &options, &|part| progress.at((PARTS as f64 * part) as u64, ""))?;
        progress.end();
        twin.took("identification", result.seconds);
        Some(result)
    };
    let posterior = MassPosterior::of(prior, identification.as_ref())
        .with_context(|| format!("[mass] of {}", twin.path("twin.toml").display()))?;
    write_json(&twin.output(MASS)?, &MassFile::new(posterior, identification))?;
    Ok(vec![twin.path(MASS)])
}

/// What the estimate has taken for granted is no evidence beside the same prior of the twin.
fn stated_once(recordings: &[PushRecording]) -> Result<()> {
    let mass = Parameter::Mass.as_str();
    let stated = |r: &&PushRecording| !matches!(r.parameters.get(mass), None | Some(StatedParameter::Free(_)));
    if let Some(push) = recordings.iter().find(stated) {
        refuse!(
            "the mass is stated twice, by [mass] in twin.toml and by [parameters] of the push {}, and would count twice: keep the one in twin.toml",
            push.name
        );
    }
    Ok(())
}

/// The manifest's pushes, loaded.
pub fn recordings(twin: &Twin) -> Result<Vec<PushRecording>> {
    Ok(twin
        .manifest
        .mass
        .identify
        .iter()
        .map(|push| PushRecording::load(&twin.path(push)))
        .collect::<Result<_, _>>()?)
}

/// What is known before the pushes: the scale's number, else the manifest's first guess, else one that came with a push.
fn prior(twin: &Twin, recordings: &[PushRecording]) -> Result<Option<MassPrior>> {
    let config = &twin.manifest.mass;
    if let Some(kg) = config.weighed_kg {
        return Ok(Some(MassPrior::from_scale(kg)?));
    }
    let volume_m3 = twin.asset()?.report.volume_m3;
    let guess = match (config.prior_kg, &config.prior_material, &config.prior_file) {
        (Some(kg), ..) => Some(MassPrior::from_number(kg)?),
        (_, Some(material), _) => Some(MassPrior::from_material(material, volume_m3)?),
        (.., Some(file)) => {
            let path = twin.path(file);
            let read = MassPrior::from_json(&fsutil::read_text(&path)?, Some(volume_m3));
            Some(read.with_context(|| path.display().to_string())?)
        }
        _ => recordings.iter().find_map(|r| r.mass_prior_kg).map(MassPrior::from_number).transpose()?,
    };
    Ok(match (guess, config.prior_sd_log) {
        (Some(guess), Some(sd_log)) => Some(guess.with_sd_log(sd_log)?),
        (guess, _) => guess,
    })
}
