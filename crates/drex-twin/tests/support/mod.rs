//! Twin folders for tests; those of the application use them too.
#![allow(dead_code, clippy::unwrap_used)] // a test helper: not every test uses all of it, and a panic is the report

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The small bundled twin.
pub fn tin_data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/tin")
}

/// A copy of it in a temporary folder.
pub fn tin_copy() -> (tempfile::TempDir, PathBuf) {
    copy_of(&tin_data())
}

/// A copy of a twin in a temporary folder.
pub fn copy_of(twin: &Path) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let to = dir.path().join("twin");
    copy_tree(twin, &to);
    (dir, to)
}

/// A copy of the tin with so many of its demonstrations, and little to do in every stage.
pub fn small_twin(demonstrations: usize) -> (tempfile::TempDir, PathBuf) {
    let (dir, twin) = tin_copy();
    keep_demonstrations(&twin, demonstrations);
    edit(&twin.join("twin.toml"), "hand = \"leap_right\"", "hand = \"leap_right\"\n\n[train]\nepochs = 5");
    (dir, twin)
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
