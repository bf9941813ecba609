//! `twin.lock`: which stage was made from which inputs. It lets `drex run` skip what is up to date and go on after a kill.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::error::Context;
use crate::{Error, Result};
use drex_core::fsutil;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// The record of a twin folder.
#[derive(Debug, Default, Serialize)]
pub struct Lock {
    #[serde(skip)]
    root: PathBuf,
    #[serde(skip)]
    damage: Vec<String>,
    #[serde(rename = "stage")]
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
        self.0.update(serde_json::to_vec(value).map_err(Error::json)?);
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
        fsutil::hex(&self.0.finalize())
    }
}

impl Lock {
    /// The lock of the twin folder `root`; empty when there is none. Of a lock that is damaged the stages that can be read
    /// are kept, and [`Lock::damage`] tells of the others.
    pub fn open(root: &Path) -> Self {
        let mut lock = Self { root: root.to_path_buf(), ..Self::default() };
        let path = root.join(FILE);
        if std::fs::symlink_metadata(&path).is_err() {
            return lock;
        }
        let all =
            |why: String| format!("{why}: it does not say any more what is up to date, so every stage is made again");
        let table = fsutil::read_text(&path).and_then(|text| fsutil::from_toml::<toml::Table>(&path, &text));
        let stages = match table.map(|mut table| table.remove("stage")) {
            Ok(Some(toml::Value::Table(stages))) => stages,
            Ok(_) => {
                lock.damage.push(all(format!("{} has no table [stage]", path.display())));
                return lock;
            }
            Err(drex_core::Error::Content { line, what, .. }) => {
                let line = line.map_or(String::new(), |line| format!(", line {line}"));
                lock.damage.push(all(format!("{}{line} is damaged ({what})", path.display())));
                return lock;
            }
            Err(e) => {
                lock.damage.push(all(e.to_string()));
                return lock;
            }
        };
        for (name, value) in stages {
            match value.try_into::<StageRecord>() {
                Ok(record) => drop(lock.stages.insert(name, record)),
                Err(e) => {
                    let why = e.message();
                    lock.damage.push(format!(
                        "{} is damaged at [stage.{name}] ({why}): that stage is made again",
                        path.display()
                    ));
                }
            }
        }
        lock
    }

    /// What was wrong with the file, one sentence each, with what is made again.
    pub fn damage(&self) -> &[String] {
        &self.damage
    }

    /// Whether `stage` was made from exactly these inputs and its files are still as they were written.
    pub fn is_current(&self, stage: &str, inputs_sha256: &str) -> bool {
        self.altered(stage, inputs_sha256).is_some_and(|files| files.is_empty())
    }

    /// Names of the files that `stage` made from exactly these inputs and that were edited, damaged or removed since; `None` if it was made
    /// from other inputs, or never.
    pub fn altered(&self, stage: &str, inputs_sha256: &str) -> Option<Vec<String>> {
        let record = self.stages.get(stage).filter(|record| record.inputs_sha256 == inputs_sha256)?;
        let is_as_made = |file: &str, digest: &str| {
            std::fs::read(self.root.join(file)).is_ok_and(|bytes| digest_of(&bytes) == digest)
        };
        Some(record.outputs_sha256.iter().filter(|(f, d)| !is_as_made(f, d)).map(|(file, _)| file.clone()).collect())
    }

    /// Records a finished stage and writes the lock. `outputs` are files or folders below the root. Files that the stage had
    /// made before and has not made this time are removed if they are still as they were made; their names are returned.
    pub fn record(
        &mut self,
        stage: &str,
        inputs_sha256: String,
        seed: u64,
        outputs: &[PathBuf],
    ) -> Result<Vec<String>> {
        let mut outputs_sha256 = BTreeMap::new();
        for path in outputs {
            self.digest_outputs(path, &mut outputs_sha256)?;
        }
        let record = StageRecord { inputs_sha256, made_by: made_by(), seed, outputs_sha256 };
        let before = self.stages.insert(stage.to_owned(), record).map_or_else(BTreeMap::new, |r| r.outputs_sha256);
        let made = |file: &String| self.stages.values().any(|r| r.outputs_sha256.contains_key(file));
        let mut removed = Vec::new();
        for (file, digest) in before.into_iter().filter(|(file, _)| !made(file)) {
            // A name out of a file may not lead out of the folder.
            let Ok(path) = fsutil::output_path(&self.root, &file) else { continue };
            if std::fs::read(&path).is_ok_and(|bytes| digest_of(&bytes) == digest) {
                std::fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))?;
                removed.push(file);
            }
        }
        // After the removal: a run that is killed in between makes the stage again.
        let text = format!(
            "# Written by drex: how each stage was made. Delete it to make everything again.\n{}",
            toml::to_string(self).map_err(|e| Error::Refused(format!("twin.lock cannot be written: {e}")))?
        );
        fsutil::write_atomic(&fsutil::output_path(&self.root, FILE)?, text.as_bytes())?;
        Ok(removed)
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
    fsutil::hex(&Sha256::digest(bytes))
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
        lock.record("s", inputs(&input), 7, std::slice::from_ref(&output)).unwrap();

        let reopened = Lock::open(dir.path());
        assert!(reopened.is_current("s", &inputs(&input)));
        std::fs::write(&output, "edited").unwrap();
        assert!(!reopened.is_current("s", &inputs(&input)), "an edited output must be made again");
        std::fs::write(&output, "made").unwrap();
        std::fs::write(&input, "b").unwrap();
        assert!(!reopened.is_current("s", &inputs(&input)), "a changed input must be used");
    }

    #[test]
    fn what_a_stage_no_longer_makes_is_removed_unless_it_was_edited() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("twin");
        std::fs::create_dir(&root).unwrap();
        let file = |name: &str| root.join(name);
        let write = |name: &str| std::fs::write(file(name), name).unwrap();
        ["kept", "gone", "edited", "shared", "../outside"].into_iter().for_each(write);
        let mut lock = Lock::open(&root);
        let mut record = |stage: &str, names: &[&str]| {
            let outputs: Vec<PathBuf> = names.iter().map(|name| file(name)).collect();
            lock.record(stage, "inputs".into(), 7, &outputs).unwrap()
        };
        assert!(record("other", &["shared"]).is_empty());
        assert!(record("stage", &["kept", "gone", "edited", "shared"]).is_empty());
        std::fs::write(file("edited"), "by hand").unwrap();
        assert_eq!(record("stage", &["kept"]), ["gone"]);
        assert_eq!(["kept", "gone", "edited", "shared"].map(|name| file(name).exists()), [true, false, true, true]);

        let digest = digest_of(b"../outside");
        let text = std::fs::read_to_string(file(FILE)).unwrap().replacen("kept = ", "\"../outside\" = ", 1);
        let own = digest_of(b"kept");
        std::fs::write(file(FILE), text.replace(&own, &digest)).unwrap();
        let mut lock = Lock::open(&root);
        assert!(lock.damage().is_empty() && lock.is_current("stage", "inputs"));
        assert!(lock.record("stage", "inputs".into(), 7, &[]).unwrap().is_empty());
        assert!(dir.path().join("outside").exists(), "a lock does not remove what lies outside of its folder");
    }

    #[test]
    fn a_damaged_lock_says_what_is_made_again() {
        let dir = tempfile::tempdir().unwrap();
        assert!(Lock::open(dir.path()).damage().is_empty(), "none is no damage");
        let record = "inputs_sha256 = \"1\"\nmade_by = \"drex\"\nseed = 1\noutputs_sha256 = {}\n";
        let whole = format!("[stage.asset]\n{record}\n[stage.trial]\n{record}");
        let cut = &whole[..whole.len() - 5];
        let unlike = whole.replacen("seed = 1", "seed = \"one\"", 1);
        for (text, kept, words) in [
            (whole.as_bytes(), vec!["asset", "trial"], vec![]),
            (b"not toml [", vec![], vec!["line 1", "every stage is made again"]),
            (cut.as_bytes(), vec![], vec!["line 11", "every stage is made again"]),
            (b"", vec![], vec!["no table [stage]", "every stage is made again"]),
            (b"\xff\xfe", vec![], vec!["not text", "every stage is made again"]),
            (unlike.as_bytes(), vec!["trial"], vec!["[stage.asset]", "that stage is made again"]),
        ] {
            std::fs::write(dir.path().join(FILE), text).unwrap();
            let lock = Lock::open(dir.path());
            assert_eq!(lock.stages().keys().collect::<Vec<_>>(), kept);
            let damage = lock.damage().join("\n");
            assert_eq!(damage.is_empty(), words.is_empty(), "{damage}");
            assert!(words.iter().all(|word| damage.contains(word)), "{words:?}: {damage}");
        }
        std::fs::remove_file(dir.path().join(FILE)).unwrap();
        std::fs::create_dir(dir.path().join(FILE)).unwrap();
        assert!(Lock::open(dir.path()).damage()[0].contains("every stage is made again"));
    }
}
