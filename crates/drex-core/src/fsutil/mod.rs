//! Reading with a message that names the file, and writing that leaves the old file or the new one, never half of one.

mod lock;
mod output;

use std::fs;
use std::io::{Read, Write};
use std::path::{Component, Path, PathBuf};

use serde::de::DeserializeOwned;

pub use self::lock::lock_holder;
pub use self::output::{OutputFolder, argument, output_path, remove_unfinished, temporary_path};
use crate::{Error, Result, budget};

/// The whole file as bytes.
///
/// # Errors
/// If it cannot be read, or is larger than [`budget::max_memory`]; a device or a pipe is read up to that limit.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    let failed = |e| Error::io("read", path, e);
    let file = fs::File::open(path).map_err(failed)?;
    let announced = file.metadata().map_err(failed)?.len();
    budget::allow(path, "the file", announced)?;
    let mut bytes = Vec::with_capacity(announced as usize);
    file.take(budget::max_memory() + 1).read_to_end(&mut bytes).map_err(failed)?;
    budget::allow(path, "the file", bytes.len() as u64)?;
    Ok(bytes)
}

/// The whole file as UTF-8 text.
///
/// # Errors
/// If it cannot be read or is not UTF-8.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read_bytes(path)?)
        .map_err(|_| Error::content(path, None, "the file is not text (UTF-8)", "check that this is the right file"))
}

/// Writes `bytes` to `path`: first to a temporary name beside it, then renamed. Missing folders are made. What is there
/// and is no file (a device, a pipe) is written to, never replaced.
///
/// # Errors
/// If the folder or the file cannot be written (no permission, disk full); the old file, if any, stays.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    if fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir()) {
        let written = fs::OpenOptions::new().write(true).open(path).and_then(|mut f| f.write_all(bytes));
        return written.map_err(|e| Error::io("write", path, e));
    }
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(folder).map_err(|e| Error::io("create", folder, e))?;
    }
    let temporary = temporary_path(path);
    let written = fs::File::create(&temporary).and_then(|mut f| f.write_all(bytes).and_then(|()| f.sync_all()));
    if let Err(e) = written.and_then(|()| fs::rename(&temporary, path)) {
        // The temporary file is ours and useless now; that it may not exist is no second error.
        let _ = fs::remove_file(&temporary);
        return Err(Error::io("write", path, e));
    }
    Ok(())
}

/// `bytes` in hexadecimal digits, as check sums are written.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

/// Most memory of a parsed text per byte of it: `1,` can become a value of 32 bytes in a list that is growing.
const TOML_BYTES: u64 = 128;
const JSON_BYTES: u64 = 16;
/// Most memory of a JSON object apart from its values.
const JSON_OBJECT_BYTES: u64 = 640;

/// A value from the TOML `text` of `path`.
///
/// # Errors
/// If the text is too large for [`budget::max_memory`], is no TOML of this shape, with line and column, or has a number that is not finite, with the entry.
pub fn from_toml<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T> {
    let refuse = |e: &toml::de::Error| {
        let (line, what) = match e.span() {
            Some(span) => {
                let before = text.get(..span.start).unwrap_or(text);
                let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
                (Some(before.matches('\n').count() + 1), format!("column {column}: {}", e.message()))
            }
            None => (None, e.message().to_owned()),
        };
        Error::content(path, line, what, "correct the entry as documented")
    };
    budget::allow(path, "its entries", text.len() as u64 * TOML_BYTES)?;
    let table: toml::Table = toml::from_str(text).map_err(|e| refuse(&e))?;
    if let Some(entry) = table.iter().find_map(|(key, value)| not_finite(key, value)) {
        return Err(Error::content(path, None, format!("{entry} is not finite"), "give a number"));
    }
    toml::from_str(text).map_err(|e| refuse(&e))
}

/// The dotted name of a number in `value` that is not finite, if there is one.
fn not_finite(name: &str, value: &toml::Value) -> Option<String> {
    match value {
        toml::Value::Float(v) => (!v.is_finite()).then(|| name.to_owned()),
        toml::Value::Array(items) => items.iter().enumerate().find_map(|(i, v)| not_finite(&format!("{name}[{i}]"), v)),
        toml::Value::Table(table) => table.iter().find_map(|(key, v)| not_finite(&format!("{name}.{key}"), v)),
        _ => None,
    }
}

/// A value from the JSON `text` of `path`.
///
/// # Errors
/// If the text is too large for [`budget::max_memory`], or no JSON of this shape; the message gives line and column.
pub fn from_json<T: DeserializeOwned>(path: &Path, text: &str) -> Result<T> {
    let objects = text.bytes().filter(|&b| b == b'{').count() as u64;
    budget::allow(path, "its entries", text.len() as u64 * JSON_BYTES + objects * JSON_OBJECT_BYTES)?;
    serde_json::from_str(text).map_err(|e| {
        // serde_json appends " at line 3 column 7", which the error says in its own way.
        let message = e.to_string();
        let message = message.rsplit_once(" at line ").map_or(message.as_str(), |(head, _)| head);
        let what = format!("column {}: {message}", e.column());
        Error::content(path, e.line(), what, "correct the entry as documented")
    })
}

/// `path` as seen from the folder `base`, with forward slashes, for files that must survive a move of the whole folder.
/// Both are taken as they stand, after resolving `.` and `..`; a path that shares no root with `base` stays absolute.
pub fn relative_path(path: &Path, base: &Path) -> PathBuf {
    let (path, base) = (absolute(path), absolute(base));
    let shared = path.components().zip(base.components()).take_while(|(a, b)| a == b).count();
    if shared == 0 {
        return path;
    }
    let mut out = String::new();
    let ups = base.components().skip(shared).map(|_| "..".into());
    for part in ups.chain(path.components().skip(shared).map(|c| c.as_os_str().to_string_lossy())) {
        if !out.is_empty() {
            out.push('/');
        }
        out.push_str(&part);
    }
    PathBuf::from(if out.is_empty() { ".".into() } else { out })
}

/// `path` made absolute and free of `.` and `..`, without asking the file system.
pub fn absolute(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let mut out = PathBuf::new();
    for part in whole.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => {
                out.pop();
            }
            other => out.push(other),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_paths_lead_back() {
        let base = Path::new("/a/twin/push/p1");
        for (path, expected) in [
            ("/a/twin/push/p1/pose.csv", "pose.csv"),
            ("/a/twin/scan/./mesh.stl", "../../scan/mesh.stl"),
            ("/b/mesh.stl", "../../../../b/mesh.stl"),
            ("/a/twin/push/p1", "."),
        ] {
            assert_eq!(relative_path(Path::new(path), base), PathBuf::from(expected));
            assert_eq!(absolute(&base.join(expected)), absolute(Path::new(path)));
        }
    }

    #[test]
    fn a_write_that_fails_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("taken");
        fs::create_dir(&target).unwrap();
        fs::write(target.join("x"), b"1").unwrap();
        assert!(write_atomic(&target, b"new").is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        write_atomic(&folder.path().join("deep/er/file"), b"new").unwrap();
        assert_eq!(fs::read(folder.path().join("deep/er/file")).unwrap(), b"new");
    }

    #[test]
    fn messages_of_toml_and_json_carry_line_and_column() {
        #[derive(Debug, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        struct One {
            #[allow(dead_code)] // only its presence matters here
            a: f64,
        }
        let toml = from_toml::<One>(Path::new("x.toml"), "a = 1.0\n  bb = 2").unwrap_err().to_string();
        assert!(toml.contains("line 2") && toml.contains("column 3") && toml.contains("bb"), "{toml}");
        let json = from_json::<One>(Path::new("x.json"), "{\"a\": 1,\n \"bb\": 2}").unwrap_err().to_string();
        assert!(json.contains("line 2") && json.contains("column 5") && json.contains("bb"), "{json}");
    }
}
