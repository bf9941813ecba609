//! `timings.json`: what differs from run to run and from folder to folder, apart from the results, which do not.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::Result;
use drex_core::fsutil;
use serde::{Deserialize, Serialize};

use crate::records::write_json;

/// Name of the file in a twin folder or an output folder.
pub const FILE: &str = "timings.json";

/// What the last run of each stage or command took.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Timings {
    /// Layout: 1.
    schema: u32,
    /// By the name of the stage or command.
    #[serde(default)]
    took: BTreeMap<String, Timing>,
}

/// What a stage or command took.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Wall time, s.
    pub seconds: f64,
    /// Processor time of all threads, s, where the system tells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub core_seconds: Option<f64>,
    /// Most memory that the process held until then, bytes, where the system tells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peak_memory_bytes: Option<u64>,
    /// Worker threads.
    #[serde(default)]
    pub threads: usize,
    /// The input as it was given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input: Option<PathBuf>,
    /// Wall time of parts of it, s.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub parts: BTreeMap<String, f64>,
}

impl Timing {
    /// So many seconds until now, with what the system says of this process.
    pub fn of(seconds: f64) -> Self {
        Self {
            seconds,
            peak_memory_bytes: drex_splat::usage::peak_memory_bytes(),
            threads: rayon::current_num_threads(),
            ..Self::default()
        }
    }
}

/// Writes what `name` took into the folder's `timings.json`, beside what others took. One that cannot be read is replaced:
/// nothing depends on it.
///
/// # Errors
/// If the file cannot be written.
pub fn record(folder: &Path, name: &str, timing: Timing) -> Result<()> {
    let path = fsutil::output_path(folder, FILE)?;
    let stored = std::fs::read(&path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let mut timings: Timings = stored.unwrap_or_default();
    timings.schema = 1;
    timings.took.insert(name.to_owned(), timing);
    write_json(&path, &timings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_name_keeps_its_last_time() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(FILE), "damaged").unwrap();
        for (name, seconds) in [("scan", 3.0), ("identify", 1.0), ("scan", 2.0)] {
            record(dir.path(), name, Timing::of(seconds)).unwrap();
        }
        let stored: Timings = serde_json::from_slice(&std::fs::read(dir.path().join(FILE)).unwrap()).unwrap();
        let seconds: Vec<_> = stored.took.iter().map(|(name, t)| (name.as_str(), t.seconds)).collect();
        assert_eq!(seconds, [("identify", 1.0), ("scan", 2.0)]);
    }
}
