//! Where output goes: below its folder whatever names the data brings, and never half of a file that looks whole.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Device names of Windows, which opens the device for a file of that name with any ending, in any folder.
const DEVICES: [&str; 4] = ["CON", "PRN", "AUX", "NUL"];

/// Path of the output file `name` below `folder`, for a name that came with the data: a photo's in a COLMAP model, a
/// mesh's in a manifest. `/` and `\` both separate folders.
///
/// # Errors
/// If the name is empty, absolute, starts with a drive (`C:`), has a part `..`, a control character or the name of a
/// Windows device, or if a part of the path below `folder` is a link, which could lead elsewhere.
pub fn output_path(folder: &Path, name: &str) -> Result<PathBuf> {
    let mut path = folder.to_path_buf();
    for part in parts_of(name)? {
        path.push(part);
        if fs::symlink_metadata(&path).is_ok_and(|m| m.file_type().is_symlink()) {
            return Err(Error::content(
                &path,
                None,
                "this is a link, and what is written through it could land outside of the output folder",
                "remove the link, or put what it leads to in its place",
            ));
        }
    }
    Ok(path)
}

/// The folders and the file that a name is made of.
fn parts_of(name: &str) -> Result<Vec<&str>> {
    let refuse = |why: &str| {
        let what = format!("the name {name:?} {why}, so that its file could lie outside of the output folder");
        Err(Error::value(what, "give it a relative name without .., such as photos/a.png"))
    };
    if name.chars().any(char::is_control) {
        return refuse("has a control character");
    }
    if name.starts_with(['/', '\\']) {
        return refuse("is absolute");
    }
    if let [letter, b':', ..] = name.as_bytes()
        && letter.is_ascii_alphabetic()
    {
        return refuse("starts with a drive");
    }
    let parts: Vec<&str> = name.split(['/', '\\']).filter(|part| !part.is_empty() && *part != ".").collect();
    if parts.contains(&"..") {
        return refuse("leads upwards");
    }
    if parts.is_empty() {
        return refuse("names no file");
    }
    if parts.iter().any(|part| is_device(part)) {
        return refuse("is that of a device on Windows");
    }
    Ok(parts)
}

fn is_device(part: &str) -> bool {
    let stem = part.split('.').next().unwrap_or(part).trim_end().to_ascii_uppercase();
    let port = stem.strip_prefix("COM").or(stem.strip_prefix("LPT"));
    DEVICES.contains(&stem.as_str()) || port.is_some_and(|n| matches!(n.as_bytes(), [b'1'..=b'9']))
}

/// Output files of one folder of which no two are the same, not even where `A` and `a` are.
#[derive(Debug)]
pub struct OutputFolder {
    folder: PathBuf,
    /// Names as a file system that ignores case and trailing dots compares them, and as they were given.
    taken: BTreeMap<String, String>,
}

impl OutputFolder {
    /// None so far; the folder need not be there.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), taken: BTreeMap::new() }
    }

    /// Path of the file `name`, as [`output_path`] gives it, and no other file's from now on.
    ///
    /// # Errors
    /// As [`output_path`], and if an earlier name led to the same file.
    pub fn file(&mut self, name: &str) -> Result<PathBuf> {
        let path = output_path(&self.folder, name)?;
        let plain = |part: &str| part.trim_end_matches(['.', ' ']).to_lowercase();
        let key: Vec<String> = parts_of(name)?.into_iter().map(plain).collect();
        match self.taken.insert(key.join("/"), name.to_owned()) {
            None => Ok(path),
            Some(other) => {
                let what = format!("{other:?} and {name:?} would be one file, {}", path.display());
                Err(Error::value(what, "rename one of the two that they were made from"))
            }
        }
    }
}

/// `path` as an argument for another program: absolute, so that no name is taken for an option.
pub fn argument(path: &Path) -> PathBuf {
    // It fails for an empty path and where the working folder is gone: a prefix serves as well there.
    std::path::absolute(path).unwrap_or_else(|_| Path::new(".").join(path))
}

/// The name under which a file or folder is written until it is whole.
pub fn temporary_path(path: &Path) -> PathBuf {
    let mut name = path.file_name().map(|n| n.to_os_string()).unwrap_or_default();
    name.push(format!(".{}.tmp", std::process::id()));
    path.with_file_name(name)
}

/// Removes from `folder`, and from the folders in it if `recursive`, what programs that were killed, or found the disk
/// full, left of files that were not whole yet: what [`temporary_path`] names, and logs named `*.csv.part`. Returns what
/// was there, sorted. No program may be writing there.
///
/// # Errors
/// If a folder cannot be listed or a file not removed. A folder that is not there is no error, and no link is followed.
pub fn remove_unfinished(folder: &Path, recursive: bool) -> Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(e) if matches!(e.kind(), std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory) => {
            return Ok(Vec::new());
        }
        Err(e) => return Err(Error::io("list", folder, e)),
    };
    let mut removed = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|e| Error::io("list", folder, e))?;
        let path = entry.path();
        let is_folder = entry.file_type().is_ok_and(|t| t.is_dir());
        if is_unfinished(&entry.file_name().to_string_lossy()) {
            let gone = if is_folder { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
            gone.map_err(|e| Error::io("remove", &path, e))?;
            removed.push(path);
        } else if is_folder && recursive {
            removed.extend(remove_unfinished(&path, true)?);
        }
    }
    removed.sort();
    Ok(removed)
}

fn is_unfinished(name: &str) -> bool {
    let process = name.strip_suffix(".tmp").and_then(|n| n.rsplit_once('.')).map(|(_, process)| process);
    process.is_some_and(|p| !p.is_empty() && p.bytes().all(|b| b.is_ascii_digit())) || name.ends_with(".csv.part")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_lead_out_are_refused_and_others_lie_below() {
        let folder = Path::new("out");
        for (name, expected) in [
            ("a.png", "out/a.png"),
            ("left/./0001.jpg", "out/left/0001.jpg"),
            ("left\\0001.jpg", "out/left/0001.jpg"),
            ("..a/b..", "out/..a/b.."),
            ("12:30:00.png", "out/12:30:00.png"),
            ("console.png", "out/console.png"),
        ] {
            assert_eq!(output_path(folder, name).unwrap(), Path::new(expected));
        }
        let hostile = [
            "",
            ".",
            "/",
            "//",
            "./.",
            "/etc/passwd",
            "\\\\host\\share",
            "..",
            "../a",
            "a/../../b",
            "a\\..\\..\\b",
            "C:\\a",
            "c:a",
            "a\0.png",
            "a\n.png",
            "NUL",
            "x/aux.png",
            "com1.npy",
        ];
        for name in hostile {
            let message = output_path(folder, name).unwrap_err().to_string();
            assert!(message.contains("output folder") && message.contains("give it"), "{name:?}: {message}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn no_link_on_the_way_is_followed() {
        let dir = tempfile::tempdir().unwrap();
        let (out, elsewhere) = (dir.path().join("out"), dir.path().join("elsewhere"));
        fs::create_dir_all(out.join("real")).unwrap();
        fs::create_dir_all(&elsewhere).unwrap();
        std::os::unix::fs::symlink(&elsewhere, out.join("linked")).unwrap();
        std::os::unix::fs::symlink(elsewhere.join("none"), out.join("real/dangling.png")).unwrap();
        for name in ["linked/a.png", "real/../linked/a.png", "linked", "real/dangling.png"] {
            assert!(output_path(&out, name).is_err(), "{name}");
        }
        assert_eq!(output_path(&out, "real/a.png").unwrap(), out.join("real/a.png"));
        // The folder itself is the user's choice.
        assert!(output_path(&out.join("linked"), "a.png").is_ok());
    }

    #[test]
    fn two_names_of_one_file_are_refused() {
        let mut folder = OutputFolder::new("out");
        folder.file("a/x.png").unwrap();
        folder.file("b/x.png").unwrap();
        for name in ["a/x.png", "a//x.png", "A\\X.png", "a./x.PNG", "./a/x.png "] {
            let message = folder.file(name).unwrap_err().to_string();
            assert!(message.contains("one file"), "{name}: {message}");
        }
    }

    #[test]
    fn what_a_killed_program_left_is_removed_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir_all(at("policy/network")).unwrap();
        fs::create_dir_all(at(".asset.77.tmp/mesh")).unwrap();
        let left = ["mass.json.4711.tmp", "policy/network/policy.json.12.tmp", "policy/execution.csv.part"];
        let kept = ["mass.json", "notes.tmp", "a.b.tmp", "policy/curve.csv", "x.part"];
        for name in left.iter().chain(&kept).chain(&[".asset.77.tmp/mesh/visual.obj"]) {
            fs::write(at(name), b"1").unwrap();
        }
        let mut expected: Vec<PathBuf> = left.iter().chain(&[".asset.77.tmp"]).map(|n| at(n)).collect();
        expected.sort();
        assert_eq!(remove_unfinished(dir.path(), true).unwrap(), expected);
        assert!(kept.iter().all(|name| at(name).is_file()) && expected.iter().all(|path| !path.exists()));
        fs::write(at("policy/execution.csv.part"), b"1").unwrap();
        for (folder, recursive) in [(dir.path(), false), (&at("not there"), true)] {
            assert_eq!(remove_unfinished(folder, recursive).unwrap(), Vec::<PathBuf>::new());
        }
    }

    #[test]
    fn no_argument_is_taken_for_an_option() {
        for name in ["-i", "--help", "a/-b", ""] {
            assert!(!argument(Path::new(name)).to_string_lossy().starts_with('-'), "{name}");
        }
        assert!(argument(Path::new("-i")).ends_with("-i"));
    }
}
