//! A run that is killed goes on as if nothing had happened.
#![cfg(feature = "flex")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::{small, toy};
use drex_policy::{
    Dataset, Feedback, GraspPolicy, PredictedGrasp, Result, RolloutOptions, Rollouts, TrainOptions, Trainer,
};

/// Answers that depend on every argument.
struct MadeUp;

impl Rollouts for MadeUp {
    fn rollout(&self, _: usize, grasp: &PredictedGrasp, mass_kg: f64, _: f64, seed: u64) -> Result<Feedback> {
        let luck = (seed >> 40) as f64 / (1u64 << 24) as f64;
        Ok(Feedback {
            fingers_in_contact: vec![luck > 0.2, grasp.joints[0] > 0.8],
            retained: luck,
            held: luck > 0.5,
            friction_used: Some(0.3 + 0.5 * luck),
            needed_grip_force_n: Some(20.0 * mass_kg),
        })
    }
}

const ROUNDS: usize = 4;

fn options(epochs: usize) -> TrainOptions {
    let rollouts = RolloutOptions::default().with_epochs(ROUNDS).with_scenes(2).with_tries(4);
    small().with_epochs(epochs).with_rollouts(rollouts)
}

fn data() -> Dataset {
    toy(16, &[0.1, 0.2])
}

/// Goes on to the end, saving after each epoch.
fn finish(mut trainer: Trainer<'_>, folder: &Path) -> GraspPolicy {
    while trainer.learn().unwrap().is_some() {
        trainer.save(folder).unwrap();
    }
    while trainer.roll_out(&MadeUp).unwrap().is_some() {
        trainer.save(folder).unwrap();
    }
    trainer.finish().unwrap().0
}

fn files(policy: &GraspPolicy) -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    policy.save(folder.path()).unwrap();
    let mut paths: Vec<PathBuf> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|p| fs::read(p).unwrap()).collect()
}

#[test]
fn dropped_anywhere_with_any_number_of_threads_the_bytes_are_the_same() {
    let data = data();
    let folder = tempfile::tempdir().unwrap();
    let whole = files(&finish(Trainer::new(&data, &options(6)).unwrap(), folder.path()));
    for (threads, stop) in [(1, 3), (2, 3), (2, 6), (1, 8), (2, 9)] {
        let folder = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let resumed = pool.install(|| {
            let mut trainer = Trainer::new(&data, &options(6)).unwrap();
            for step in 0..stop {
                if trainer.learn().unwrap().is_none() {
                    trainer.roll_out(&MadeUp).unwrap();
                }
                if step + 1 == stop {
                    trainer.save(folder.path()).unwrap();
                }
            }
            // What happens after the last checkpoint is lost with the process.
            let _ = trainer.learn().unwrap();
            drop(trainer);
            finish(Trainer::resume_or_new(&data, &options(6), folder.path()).unwrap(), folder.path())
        });
        assert!(files(&resumed) == whole, "{threads} threads, stopped after {stop}");
    }
}

/// Where the child of the next test saves; set, this process is the child.
const CHILD: &str = "DREX_POLICY_TEST_CHECKPOINTS";
const CHILD_EPOCHS: usize = 2000;

#[test]
fn killed_by_the_system_it_goes_on_to_the_same_bytes() {
    let data = data();
    if let Some(folder) = std::env::var_os(CHILD) {
        finish(Trainer::new(&data, &options(CHILD_EPOCHS)).unwrap(), Path::new(&folder));
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "resume::killed_by_the_system_it_goes_on_to_the_same_bytes"])
        .env(CHILD, folder.path())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let started = Instant::now();
    let epochs = |folder: &Path| Trainer::resume(&data, folder).map(|t| t.epochs().len()).unwrap_or(0);
    while epochs(folder.path()) < 3 {
        assert!(started.elapsed() < Duration::from_secs(60), "the child writes no checkpoints");
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap(); // SIGKILL
    child.wait().unwrap();
    let trainer = Trainer::resume(&data, folder.path()).unwrap();
    let reached = trainer.epochs().len();
    assert!((3..CHILD_EPOCHS).contains(&reached), "{reached}");
    // To the end of the schedule would take long; the same number of further epochs must give the same state.
    let more = |mut trainer: Trainer<'_>, until: usize| {
        while trainer.epochs().len() < until {
            trainer.learn().unwrap();
        }
        files(trainer.policy())
    };
    let uninterrupted = Trainer::new(&data, &options(CHILD_EPOCHS)).unwrap();
    assert!(more(trainer, reached + 5) == more(uninterrupted, reached + 5));
}

#[test]
fn damage_is_named() {
    let data = data();
    let folder = tempfile::tempdir().unwrap();
    let mut trainer = Trainer::new(&data, &options(2)).unwrap();
    trainer.learn().unwrap();
    trainer.save(folder.path()).unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    let whole = fs::read(&path).unwrap();
    let says = |bytes: &[u8], word: &str| {
        fs::write(&path, bytes).unwrap();
        let Err(refused) = Trainer::resume(&data, folder.path()) else { panic!("'{word}': resumed") };
        let message = refused.to_string();
        assert!(message.contains(word) && message.contains("checkpoint.safetensors"), "'{word}' not in: {message}");
    };
    says(&[], "shorter than its header");
    says(&whole[..1000], "longer than the file");
    says(&whole[..whole.len() - 400], "do not hold");
    let mut flipped = whole.clone();
    let last = flipped.len() - 2;
    flipped[last] ^= 1;
    says(&flipped, "SHA-256");
    let text = |from: &str, to: &str| {
        let start = 8 + u64::from_le_bytes(*whole.first_chunk().unwrap()) as usize;
        let header = String::from_utf8(whole[8..start].to_vec()).unwrap();
        assert!(header.contains(from), "{from}");
        let header = header.replacen(from, to, 1);
        [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &whole[start..]].concat()
    };
    says(&text("\\\"version\\\":2", "\\\"version\\\":9"), "version is 9");
    says(&text("drex-policy checkpoint", "drex-policy chequepoint"), "not a checkpoint");
    says(&text("\\\"steps\\\":", "\\\"steps\\\":1"), "SHA-256");
    says(&text("\\\"fingers\\\":2", "\\\"fingers\\\":3"), "finger");
    fs::write(&path, &whole).unwrap();
    assert!(Trainer::resume(&data, folder.path()).is_ok());
    let Err(refused) = Trainer::resume_or_new(&data, &options(3), folder.path()) else { panic!("resumed") };
    assert!(refused.to_string().contains("other options"), "{refused}");
    let empty = tempfile::tempdir().unwrap();
    assert!(Trainer::resume(&data, empty.path()).is_err());
    assert!(Trainer::resume_or_new(&data, &options(3), empty.path()).unwrap().epochs().is_empty());
}
