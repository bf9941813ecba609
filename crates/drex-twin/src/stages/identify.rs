//! Pushes to a mass.

use std::path::PathBuf;

use crate::Result;
use crate::error::{Context, refuse};
use drex_core::fsutil;
use drex_recording::{Drive, PushRecording, StatedParameter};
use drex_sysid::{IdentifyOptions, MassPosterior, MassPrior, Parameter, identify_watched};

use crate::Progress;
use crate::Twin;
use crate::records::MassFile;
use crate::records::{MASS, SCAN, ScanFile, read_json, write_json};

/// What a push takes from the object's shape: where its weight acts, where it stands, how high the push acts; metres.
const OF_THE_SHAPE: [Parameter; 7] = [
    Parameter::CenterX,
    Parameter::CenterY,
    Parameter::CenterZ,
    Parameter::StartX,
    Parameter::StartY,
    Parameter::StartZ,
    Parameter::ContactHeight,
];

/// Steps in which progress is told.
const PARTS: u64 = 100;

/// Identifies and multiplies with the prior.
pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let mut recordings = recordings(twin)?;
    if twin.manifest.scan.is_some() {
        // To a tenth of a millimetre, as it is printed.
        let sd = (1e4 * read_json::<ScanFile>(&twin.path(SCAN))?.fusion.voxel_m).round() / 1e4;
        recordings.iter_mut().for_each(|r| as_scanned(r, sd));
    }
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

/// A mesh that was made of photos is known to a voxel, `sd_m`, and an interval that takes it for exact is too narrow: what the push
/// asks of the shape is expected within that of the mesh, where the recording does not say otherwise.
fn as_scanned(recording: &mut PushRecording, sd_m: f64) {
    if !matches!(recording.drive, Drive::Force(_) | Drive::Finger(_)) {
        return;
    }
    for parameter in OF_THE_SHAPE {
        let expected = StatedParameter::Expected { mean: 0.0, sd: sd_m };
        recording.parameters.entry(parameter.as_str().to_owned()).or_insert(expected);
    }
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

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_scanned_shape_is_expected_where_the_recording_does_not_say_otherwise() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/tin/push/tilt");
        let mut recording = PushRecording::load(&folder).unwrap();
        let stated = StatedParameter::Value(0.001);
        recording.parameters.insert("center_z".into(), stated);
        let mut nothing = recording.clone();
        nothing.drive = Drive::Nothing;

        as_scanned(&mut recording, 0.002);
        assert_eq!(recording.parameters["center_z"], stated);
        let expected = StatedParameter::Expected { mean: 0.0, sd: 0.002 };
        assert_eq!(recording.parameters.values().filter(|p| **p == expected).count(), OF_THE_SHAPE.len() - 1);
        // The names are those that the estimate knows.
        drex_sysid::ParameterSet::of_recording(&recording).unwrap();

        as_scanned(&mut nothing, 0.002);
        assert_eq!(nothing.parameters.len(), 1, "what nobody pushed has no height of the push");
    }
}
