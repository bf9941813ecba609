//! What the workspace-wide tests share; and the readers of all crates as targets for hostile input, with seeds, mutations and
//! adversarial files that this crate makes itself.

use std::path::{Path, PathBuf};

pub mod bytes;
pub mod hostile;
pub mod mutate;
pub mod seeds;
pub mod targets;

/// The root of the workspace.
pub fn workspace_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_path_buf).unwrap_or_default()
}
