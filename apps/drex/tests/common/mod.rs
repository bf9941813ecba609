//! Runs the built command line.
#![allow(dead_code, clippy::unwrap_used)] // a test helper: not every test uses all of it, and a panic is the report

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// What a run of `drex` printed and how it ended.
pub struct Run {
    /// Exit status.
    pub code: i32,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

/// A heartbeat so long that a starved program keeps it.
pub const PATIENT: [&str; 2] = ["--heartbeat", "5000"];

/// Runs `drex` with these arguments.
pub fn drex<S: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = S>) -> Run {
    let output: Output =
        Command::new(env!("CARGO_BIN_EXE_drex")).args(arguments).env_remove("RUST_BACKTRACE").output().unwrap();
    Run {
        code: output.status.code().unwrap_or(-1),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

impl Run {
    /// The JSON object on stdout.
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}: {}\n{}", self.stdout, self.stderr))
    }

    /// Asserts exit status 1 and that the message holds every one of `words`.
    pub fn fails_with(&self, words: &[&str]) {
        assert_eq!(self.code, 1, "stdout: {}\nstderr: {}", self.stdout, self.stderr);
        for word in words {
            assert!(self.stderr.contains(word), "`{word}` is missing in: {}", self.stderr);
        }
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
    }
}

/// The small bundled twin.
pub fn tin_data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/tin")
}

/// A copy of it in a temporary folder.
pub fn tin_copy() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let to = dir.path().join("twin");
    copy_tree(&tin_data(), &to);
    (dir, to)
}

/// Copies a folder with all that is in it.
pub fn copy_tree(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_tree(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Every file below a folder by its name there, with its content; links are not followed.
pub fn tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn walk(folder: &Path, root: &Path, into: &mut BTreeMap<String, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let entry = entry.unwrap();
            let (path, kind) = (entry.path(), entry.file_type().unwrap());
            if kind.is_dir() {
                walk(&path, root, into);
            } else if kind.is_file() {
                into.insert(
                    path.strip_prefix(root).unwrap().to_str().unwrap().to_owned(),
                    std::fs::read(&path).unwrap(),
                );
            }
        }
    }
    let mut all = BTreeMap::new();
    walk(folder, folder, &mut all);
    all
}

/// Asserts that two folders have the same files with the same bytes, but for `timings.json`.
pub fn assert_same_folder(a: &Path, b: &Path) {
    let [a, b] = [a, b].map(|folder| {
        let mut files = tree(folder);
        files.remove("timings.json");
        files
    });
    let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&a), names(&b));
    let differ: Vec<&String> = a.keys().filter(|name| a[*name] != b[*name]).collect();
    assert!(differ.is_empty(), "these differ: {differ:?}");
}

/// Keeps the first `n` demonstrations of a twin, for tests that do not need all.
pub fn keep_demonstrations(twin: &Path, n: usize) {
    let file = twin.join("demos/grasps.json");
    let mut value: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    value["grasps"].as_array_mut().unwrap().truncate(n);
    std::fs::write(&file, value.to_string()).unwrap();
}

/// Replaces `old` by `new` in a file; `old` must be there.
pub fn edit(path: &Path, old: &str, new: &str) {
    let text = std::fs::read_to_string(path).unwrap();
    assert!(text.contains(old), "`{old}` is not in {}", path.display());
    std::fs::write(path, text.replacen(old, new, 1)).unwrap();
}

/// Reference recordings, or a printed note that `test` is skipped.
pub fn shared_data(test: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped {test}: DREX_SHARED is not set");
        return None;
    };
    Some(PathBuf::from(root).join("data"))
}

/// A page without its scripts and what is embedded in base64.
pub fn text_of(html: &str) -> String {
    let mut text = String::new();
    for (i, part) in html.split("<script").enumerate() {
        text += if i == 0 { part } else { part.split_once("</script>").map_or("", |p| p.1) };
    }
    let mut told = String::new();
    for (i, part) in text.split(";base64,").enumerate() {
        told += if i == 0 { part } else { part.split_once('"').map_or("", |p| p.1) };
    }
    told
}
