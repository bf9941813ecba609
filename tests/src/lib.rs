//! What the cross-crate tests share: the workspace root, the reference data, and the built command line.

use std::path::{Path, PathBuf};

/// The root of the workspace.
pub fn workspace_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_path_buf).unwrap_or_default()
}

/// The folder of reference recordings named by `DREX_SHARED`; prints that `test` is skipped when it is not set.
pub fn shared_data(test: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped {test}: DREX_SHARED is not set");
        return None;
    };
    Some(PathBuf::from(root).join("data"))
}
