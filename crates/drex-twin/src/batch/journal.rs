//! `journal.jsonl`: what has become of which item, a line for each time that one ended. Lines are only ever added, so a run that is killed
//! loses nothing but the line that it was writing.

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::row::{Row, RunRecord};
use crate::alone::Alone;
use crate::error::Context;
use crate::{Error, Result};

/// Name of the file in the folder of a batch or of a shard.
pub(super) const JOURNAL: &str = "journal.jsonl";

/// One end of one item.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// What was found.
    pub row: Row,
    /// What it took.
    pub run: RunRecord,
}

/// A journal that is being written, by nobody else.
#[derive(Debug)]
pub(super) struct Journal {
    file: Mutex<File>,
    _alone: Alone,
}

impl Journal {
    /// Opens the journal of `folder`, or begins both. A line that a run did not end is cut off.
    pub(super) fn open(folder: &Path) -> Result<Self> {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let path = folder.join(JOURNAL);
        let doing = || format!("cannot write {}", path.display());
        let mut file = OpenOptions::new().read(true).append(true).create(true).open(&path).with_context(doing)?;
        let alone = Alone::take(&path, folder)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).with_context(doing)?;
        let whole = bytes.iter().rposition(|b| *b == b'\n').map_or(0, |last| last + 1);
        if whole < bytes.len() {
            file.set_len(whole as u64).with_context(doing)?;
            file.seek(SeekFrom::End(0)).with_context(doing)?;
        }
        Ok(Self { file: Mutex::new(file), _alone: alone })
    }

    /// Adds a line for each entry; they are on the disk when this returns.
    pub(super) fn append(&self, entries: &[Entry]) -> Result<()> {
        let mut lines = Vec::new();
        for entry in entries {
            serde_json::to_writer(&mut lines, entry).map_err(Error::json)?;
            lines.push(b'\n');
        }
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(&lines).and_then(|()| file.sync_data()).context("cannot write the journal of the batch")
    }
}

/// Gives each entry of the journal at `path` to `each`, in the order in which they were written; none where there is no journal. A line that
/// cannot be read is left out: that item is done again.
pub(super) fn read(path: &Path, mut each: impl FnMut(Entry)) -> Result<()> {
    let doing = || format!("cannot read {}", path.display());
    let mut file = match File::open(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        file => BufReader::new(file.with_context(doing)?),
    };
    // Line by line: a journal may be larger than what is kept of it.
    let mut line = Vec::new();
    while file.read_until(b'\n', &mut line).with_context(doing)? > 0 {
        if let Ok(entry) = serde_json::from_slice(&line) {
            each(entry);
        }
        line.clear();
    }
    Ok(())
}
