//! `twin.lock`: which stage was made from which inputs. It lets `drex run` skip what is up to date and go on after a kill.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use drex_core::fsutil;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// The record of a twin folder.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Lock {
    #[serde(skip)]
    root: PathBuf,
    #[serde(default, rename = "stage")]
    stages: BTreeMap<String, StageRecord>,
}

/// How one stage was made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// Digest of settings, input files and program version.
    pub inputs_sha256: String,
    /// The program that made it.
    pub made_by: String,
    /// Seed it was made with.
    pub seed: u64,
    /// Wall time, seconds.
    pub seconds: f64,
    /// Files made, relative to the twin folder, with their content digests.
    pub outputs_sha256: BTreeMap<String, String>,
}

/// Collects what a stage depends on into one digest.
pub struct Inputs(Sha256);

impl Inputs {
    /// Starts with the program's version and the seed: another version may give another answer.
    pub fn new(seed: u64) -> Self {
        let mut hasher = Sha256::new();
        hasher.update(made_by());
        hasher.update(seed.to_le_bytes());
        Self(hasher)
    }

    /// Adds settings.
    pub fn setting(mut self, name: &str, value: &impl Serialize) -> Result<Self> {
        self.0.update(name);
        self.0.update(serde_json::to_vec(value)?);
        Ok(self)
    }

    /// Adds the content of a file, or of every file below a folder in name order.
    pub fn file(mut self, path: &Path) -> Result<Self> {
        if path.is_dir() {
            let mut entries: Vec<PathBuf> = std::fs::read_dir(path)
                .and_then(|d| d.map(|e| e.map(|e| e.path())).collect())
                .with_context(|| format!("cannot list {}", path.display()))?;
            entries.sort();
            return entries.iter().try_fold(self, |inputs, entry| inputs.file(entry));
        }
        self.0.update(path.file_name().unwrap_or_default().as_encoded_bytes());
        self.0.update(digest_of(&fsutil::read_bytes(path)?));
        Ok(self)
    }

    /// The digest.
    pub fn digest(self) -> String {
        hex(&self.0.finalize())
    }
}

impl Lock {
    /// The lock of the twin folder `root`; empty when there is none. A lock that cannot be read makes every stage run again.
    pub fn open(root: &Path) -> Self {
        let stored = std::fs::read_to_string(root.join(FILE)).ok().and_then(|text| toml::from_str::<Self>(&text).ok());
        Self { root: root.to_path_buf(), stages: stored.unwrap_or_default().stages }
    }

    /// Whether `stage` was made from exactly these inputs and its files are still as they were written.
    pub fn is_current(&self, stage: &str, inputs_sha256: &str) -> bool {
        self.stages.get(stage).is_some_and(|record| {
            record.inputs_sha256 == inputs_sha256
                && record
                    .outputs_sha256
                    .iter()
                    .all(|(file, digest)| std::fs::read(self.root.join(file)).is_ok_and(|b| digest_of(&b) == *digest))
        })
    }

    /// Records a finished stage and writes the lock. `outputs` are files or folders below the root.
    pub fn record(
        &mut self,
        stage: &str,
        inputs_sha256: String,
        seed: u64,
        seconds: f64,
        outputs: &[PathBuf],
    ) -> Result<()> {
        let mut outputs_sha256 = BTreeMap::new();
        for path in outputs {
            self.digest_outputs(path, &mut outputs_sha256)?;
        }
        self.stages
            .insert(stage.to_owned(), StageRecord { inputs_sha256, made_by: made_by(), seed, seconds, outputs_sha256 });
        let text = format!(
            "# Written by drex: how each stage was made. Delete it to make everything again.\n{}",
            toml::to_string(self)?
        );
        fsutil::write_atomic(&self.root.join(FILE), text.as_bytes())?;
        Ok(())
    }

    /// The records by stage name.
    pub fn stages(&self) -> &BTreeMap<String, StageRecord> {
        &self.stages
    }

    fn digest_outputs(&self, path: &Path, into: &mut BTreeMap<String, String>) -> Result<()> {
        if path.is_dir() {
            for entry in std::fs::read_dir(path).with_context(|| format!("cannot list {}", path.display()))? {
                self.digest_outputs(&entry?.path(), into)?;
            }
            return Ok(());
        }
        let name = path.strip_prefix(&self.root).unwrap_or(path).to_string_lossy().replace('\\', "/");
        into.insert(name, digest_of(&fsutil::read_bytes(path)?));
        Ok(())
    }
}

const FILE: &str = "twin.lock";

/// Name and version of the program, as records carry it.
pub fn made_by() -> String {
    concat!("drex ", env!("CARGO_PKG_VERSION")).to_owned()
}

/// SHA-256 in hexadecimal digits.
pub fn digest_of(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inputs(file: &Path) -> String {
        Inputs::new(7).setting("k", &1).unwrap().file(file).unwrap().digest()
    }

    #[test]
    fn a_stage_is_current_until_an_input_or_an_output_changes() {
        let dir = tempfile::tempdir().unwrap();
        let (input, output) = (dir.path().join("in.txt"), dir.path().join("out.txt"));
        std::fs::write(&input, "a").unwrap();
        std::fs::write(&output, "made").unwrap();
        let mut lock = Lock::open(dir.path());
        assert!(!lock.is_current("s", &inputs(&input)));
        lock.record("s", inputs(&input), 7, 0.1, std::slice::from_ref(&output)).unwrap();

        let reopened = Lock::open(dir.path());
        assert!(reopened.is_current("s", &inputs(&input)));
        std::fs::write(&output, "edited").unwrap();
        assert!(!reopened.is_current("s", &inputs(&input)), "an edited output must be made again");
        std::fs::write(&output, "made").unwrap();
        std::fs::write(&input, "b").unwrap();
        assert!(!reopened.is_current("s", &inputs(&input)), "a changed input must be used");
    }

    #[test]
    fn a_damaged_lock_makes_everything_run_again() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(FILE), "not toml [").unwrap();
        assert!(Lock::open(dir.path()).stages().is_empty());
    }
}
