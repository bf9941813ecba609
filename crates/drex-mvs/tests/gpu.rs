//! Depth of surfaces that are known exactly, on a GPU: the suite of the processor.
#![cfg(feature = "wgpu")]
#![allow(clippy::unwrap_used)] // a test may panic

use std::sync::OnceLock;

#[path = "it/scene.rs"]
mod scene;
#[path = "it/surfaces.rs"]
mod surfaces;

/// Whether there is a GPU; if not, prints why, and the suite runs on the processor once more, unless DREX_REQUIRE_GPU is set.
fn on_gpu() -> bool {
    static GPU: OnceLock<bool> = OnceLock::new();
    *GPU.get_or_init(|| match drex_core::gpu::Device::new() {
        Ok(gpu) => {
            eprintln!("comparing photos with {}", gpu.name());
            true
        }
        Err(e) => {
            assert!(std::env::var_os("DREX_REQUIRE_GPU").is_none(), "{e}");
            eprintln!("skipped: {e}");
            false
        }
    })
}
