//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)] // a test may panic, and says why it skips

mod camera;
#[cfg(feature = "capture")]
mod capture;
#[cfg(feature = "capture")]
mod capture_hostile;
#[cfg(feature = "capture")]
mod capture_masks;
#[cfg(feature = "capture")]
mod capture_photos;
#[cfg(feature = "capture")]
mod capture_rgbd;
#[cfg(feature = "capture")]
#[path = "../capture_support/mod.rs"]
mod capture_support;
#[cfg(feature = "capture")]
mod capture_transforms;
#[cfg(feature = "capture")]
mod capture_write;
mod meshes;
mod properties;

/// The shared folder of reference data; prints why and gives `None` where there is none.
fn shared(folder: &str) -> Option<std::path::PathBuf> {
    let Some(root) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: DREX_SHARED is not set");
        return None;
    };
    Some(std::path::Path::new(&root).join("data").join(folder))
}
