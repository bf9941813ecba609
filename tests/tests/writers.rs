//! Every place of the sources that writes, moves or removes files, and why none of them can be led out of its folder.
//!
//! A new writer is not in the list below and fails this test: its path is either the caller's choice, or made by
//! `drex_core::fsutil::output_path` or `OutputFolder` of whatever name the data brings.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use drex_tests::workspace_root;

/// What writes, makes, moves or removes.
const CALLS: [&str; 12] = [
    "write_atomic(",
    "fs::write(",
    "File::create",
    "OpenOptions",
    "create_dir",
    "fs::rename(",
    "rename(",
    "remove_file(",
    "remove_dir",
    "fs::copy(",
    "hard_link(",
    "write_json(",
];

/// Why the path cannot lead out.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Why {
    /// The caller names the file, and names beside it are made of that one.
    Caller,
    /// The caller names the folder; names in it are constants or made of numbers and digests.
    Constant,
    /// Names that come with the data go through `output_path`, `OutputFolder` or `Twin::output`.
    Checked,
}
use Why::{Caller, Checked, Constant};

const WRITERS: &[(&str, Why)] = &[
    ("apps/drex-bench/src/generate/file.rs", Checked),
    ("apps/drex-bench/src/library.rs", Checked),
    ("apps/drex-bench/src/many/data.rs", Caller),
    ("apps/drex-bench/src/run.rs", Checked),
    ("apps/drex-bench/src/table.rs", Constant),
    ("apps/drex-bench/src/tables.rs", Constant),
    ("apps/drex-bench/src/tin/push.rs", Constant),
    ("apps/drex-bench/src/twins/mod.rs", Constant),
    ("apps/drex/src/commands/asset.rs", Checked),
    ("apps/drex/src/commands/demo.rs", Constant),
    ("apps/drex/src/commands/doctor.rs", Constant),
    ("apps/drex/src/commands/hw/calibrate.rs", Caller),
    ("apps/drex/src/commands/hw/calibrate_zero.rs", Caller),
    ("apps/drex/src/commands/identify.rs", Caller),
    ("apps/drex/src/commands/import.rs", Checked),
    ("apps/drex/src/commands/mesh.rs", Caller),
    ("apps/drex/src/commands/plan_push.rs", Caller),
    ("apps/drex/src/commands/retarget/file.rs", Caller),
    ("apps/drex/src/commands/shell.rs", Constant),
    ("bindings/rerun/src/main.rs", Caller),
    ("crates/drex-core/src/capture/write_colmap.rs", Constant),
    ("crates/drex-core/src/capture/write_transforms.rs", Caller),
    ("crates/drex-core/src/fsutil/mod.rs", Caller),
    ("crates/drex-core/src/fsutil/output.rs", Caller),
    ("crates/drex-core/src/npy.rs", Caller),
    ("crates/drex-demo/src/detect/temporary.rs", Constant),
    ("crates/drex-demo/src/files/write.rs", Caller),
    ("crates/drex-hw/src/driver/run.rs", Caller),
    ("crates/drex-hw/src/dynamixel/serial.rs", Caller),
    ("crates/drex-hw/src/emulator/pty.rs", Caller),
    ("crates/drex-mesh/src/fusion/evidence.rs", Caller),
    ("crates/drex-mesh/src/io/glb.rs", Caller),
    ("crates/drex-mesh/src/io/obj.rs", Caller),
    ("crates/drex-mesh/src/io/write.rs", Caller),
    ("crates/drex-mesh/src/asset/write.rs", Checked),
    ("crates/drex-mvs/src/rounds.rs", Caller),
    ("crates/drex-sfm/src/result.rs", Checked),
    ("crates/drex-twin/src/scan.rs", Checked),
    ("crates/drex-policy/src/files.rs", Constant),
    ("crates/drex-policy/src/proposal/network.rs", Caller),
    ("crates/drex-policy/src/train/checkpoint.rs", Constant),
    ("crates/drex-recording/src/convert/mod.rs", Checked),
    ("crates/drex-recording/src/readers/grasps.rs", Caller),
    ("crates/drex-report/src/batch/mod.rs", Constant),
    ("crates/drex-report/src/batch/tests.rs", Constant),
    ("crates/drex-report/src/picture/clip.rs", Caller),
    ("crates/drex-report/src/report.rs", Checked),
    ("crates/drex-sfm/src/programs.rs", Checked),
    ("crates/drex-sfm/src/video.rs", Constant),
    ("crates/drex-splat/src/io/exr.rs", Caller),
    ("crates/drex-splat/src/io/picture.rs", Caller),
    ("crates/drex-splat/src/io/ply.rs", Caller),
    ("crates/drex-splat/src/io/splat.rs", Caller),
    ("crates/drex-splat/src/io/spz.rs", Caller),
    ("crates/drex-splat/src/reconstruct.rs", Checked),
    ("crates/drex-splat/src/train/checkpoint.rs", Caller),
    ("crates/drex-sysid/src/calibrate/mod.rs", Caller),
    ("crates/drex-twin/src/alone.rs", Checked),
    ("crates/drex-twin/src/batch/journal.rs", Constant),
    ("crates/drex-twin/src/batch/runner.rs", Checked),
    ("crates/drex-twin/src/batch/table.rs", Constant),
    ("crates/drex-twin/src/batch/worker.rs", Checked),
    ("crates/drex-twin/src/deploy.rs", Constant),
    ("crates/drex-twin/src/lock.rs", Checked),
    ("crates/drex-twin/src/masks.rs", Checked),
    ("crates/drex-twin/src/reconstruct.rs", Caller),
    ("crates/drex-twin/src/records.rs", Caller),
    ("crates/drex-twin/src/stages/evaluate.rs", Checked),
    ("crates/drex-twin/src/stages/execute.rs", Checked),
    ("crates/drex-twin/src/stages/grasps.rs", Checked),
    ("crates/drex-twin/src/stages/identify.rs", Checked),
    ("crates/drex-twin/src/stages/scan.rs", Checked),
    ("crates/drex-twin/src/stages/train.rs", Checked),
    ("crates/drex-twin/src/stages/trial.rs", Checked),
    ("crates/drex-twin/src/timings.rs", Checked),
];

/// The code of a file without its tests and comments.
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
    code.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

fn sources(folder: &Path, root: &Path, into: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, root, into);
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.insert(path.strip_prefix(root).unwrap().to_str().unwrap().replace('\\', "/"));
        }
    }
}

#[test]
fn every_writer_is_known() {
    let root = workspace_root();
    let mut files = BTreeSet::new();
    for group in ["apps", "bindings", "crates"] {
        for package in fs::read_dir(root.join(group)).unwrap() {
            let src = package.unwrap().path().join("src");
            if src.is_dir() {
                sources(&src, &root, &mut files);
            }
        }
    }
    assert!(files.len() > 300, "{} sources", files.len());
    let writes = |file: &&String| {
        let code = code(&root.join(file));
        CALLS.iter().any(|call| code.contains(call))
    };
    let found: BTreeSet<&str> = files.iter().filter(writes).map(String::as_str).collect();
    let known: BTreeSet<&str> = WRITERS.iter().map(|(file, _)| *file).collect();
    let new: Vec<_> = found.difference(&known).collect();
    assert!(new.is_empty(), "these write files: say why they cannot be led out of their folder: {new:?}");
    let gone: Vec<_> = known.difference(&found).collect();
    assert!(gone.is_empty(), "these write no files any more: {gone:?}");
    for (file, why) in WRITERS {
        let code = code(&root.join(file));
        let checks =
            ["output_path(", "OutputFolder", "twin.output(", "library::file("].iter().any(|c| code.contains(c));
        assert!(*why != Checked || checks, "{file} does not check its names");
    }
}
