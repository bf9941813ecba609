//! Records that are damaged: the message names the file and what to do, and no damage is a panic.

use std::fs;
use std::path::Path;

use drex_twin::records::{
    EVALUATION, Evaluation, FITS, FitFile, MASS, MassFile, TRAINING, Training, read_json, read_json_if_there,
};
use drex_twin::{PredictOptions, Predictor};

use crate::common::{made, message, template};
use crate::support::tree;

/// Reads a record, and gives the message if it cannot be read.
type Read = fn(&Path) -> Option<String>;

fn read<T: serde::de::DeserializeOwned>(file: &Path) -> Option<String> {
    read_json::<T>(file).err().map(|e| message(&e))
}

const RECORDS: [(&str, Read); 4] =
    [(MASS, read::<MassFile>), (FITS, read::<FitFile>), (TRAINING, read::<Training>), (EVALUATION, read::<Evaluation>)];

#[test]
fn a_record_that_is_cut_or_garbled_is_named_with_what_to_do() {
    let (_dir, twin) = made();
    for (name, read) in RECORDS {
        let file = twin.join(name);
        let whole = fs::read(&file).unwrap();
        assert_eq!(read(&file), None, "{name} as it was made");
        // Without the newline at its end it is still whole.
        let cuts = (0..whole.len() - 1).step_by(whole.len() / 40);
        let garbled = [b"\xff\xfe".to_vec(), b"[]".to_vec(), b"null".to_vec(), b"{}".to_vec()];
        for bytes in cuts.map(|cut| whole[..cut].to_vec()).chain(garbled) {
            fs::write(&file, &bytes).unwrap();
            let said = read(&file).unwrap_or_else(|| panic!("{name}: {} bytes of it are read", bytes.len()));
            for word in [file.to_str().unwrap(), "is not what drex wrote there", "delete it and run again"] {
                assert!(said.contains(word), "{name}: `{word}` is missing in: {said}");
            }
        }
        // Any one byte may be another: an error or other numbers, and no panic.
        for at in (0..whole.len()).step_by(whole.len() / 200 + 1) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x15;
            fs::write(&file, bytes).unwrap();
            read(&file);
        }
    }
}

#[test]
fn what_the_mass_is_likely_to_be_is_spread_as_its_posterior_is() {
    let (_dir, twin) = made();
    let mass: MassFile = read_json(&twin.join(MASS)).unwrap();
    let likely = mass.likely_kg();
    assert!(likely.windows(2).all(|m| m[0] < m[1]), "{likely:?}");
    let below = |kg: f64| likely.iter().filter(|m| **m < kg).count() as f64 / likely.len() as f64;
    let [low, high] = mass.ci95_kg;
    for (kg, share) in [(low, 0.025), (mass.mass_kg, 0.5), (high, 0.975)] {
        assert!((below(kg) - share).abs() < 0.01, "{} of the masses are below {kg} kg", below(kg));
    }
}

#[test]
fn a_record_that_is_not_there_is_none_or_an_error_with_its_name() {
    let (_dir, twin) = made();
    let file = twin.join("policy/trial.json");
    assert!(read_json_if_there::<Training>(&file).unwrap().is_none());
    assert!(read::<Training>(&file).unwrap().contains("policy/trial.json"));
}

#[test]
fn a_prediction_from_a_damaged_twin_names_the_file_and_writes_nothing() {
    let whole = Predictor::open(template(), None, &PredictOptions::default(), None).map(|_| ());
    assert!(whole.is_ok(), "{whole:?}");
    for (name, words) in
        [(MASS, ["mass.json", "delete it and run again"]), ("policy/network/policy.json", ["policy.json", "train"])]
    {
        let (_dir, twin) = made();
        let bytes = fs::read(twin.join(name)).unwrap();
        fs::write(twin.join(name), &bytes[..bytes.len() / 2]).unwrap();
        let before = tree(&twin);
        let Err(error) = Predictor::open(&twin, None, &PredictOptions::default(), None) else {
            panic!("{name}: half of it is enough")
        };
        let said = message(&error);
        assert!(words.iter().all(|word| said.contains(word)), "{name}: {words:?}: {said}");
        assert_eq!(tree(&twin), before, "{name}");
    }
}
