//! Reading with a message that names the file, and writing that leaves the old file or the new one, never half of one.

use std::fs;
use std::io::Write;
use std::path::Path;

use crate::{Error, Result};

/// The whole file as bytes.
///
/// # Errors
/// If it cannot be read.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(|e| Error::io("read", path, e))
}

/// The whole file as UTF-8 text.
///
/// # Errors
/// If it cannot be read or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read_bytes(path)?)
        .map_err(|_| Error::content(path, None, "the file is not text (UTF-8)", "check that this is the right file"))
}

/// Writes `bytes` to `path`: first to a temporary name beside it, then renamed. Missing folders are made.
///
/// # Errors
/// If the folder or the file cannot be written (no permission, disk full); the old file, if any, stays.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(|e| Error::io("create", folder, e))?;
    }
    let mut name = path.file_name().map(|n| n.to_os_string()).unwrap_or_default();
    name.push(format!(".{}.tmp", std::process::id()));
    let temporary = path.with_file_name(name);
    let written = fs::File::create(&temporary).and_then(|mut f| f.write_all(bytes).and_then(|()| f.sync_all()));
    if let Err(e) = written.and_then(|()| fs::rename(&temporary, path)) {
        // The temporary file is ours and useless now; that it may not exist is no second error.
        let _ = fs::remove_file(&temporary);
        return Err(Error::io("write", path, e));
    }
    Ok(())
}
