//! Depth of surfaces that are known exactly.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // a test may panic, and prints what it measured

mod refinement;
mod scene;
mod surfaces;
mod texture;

/// The suite of surfaces runs on the processor here, and on a GPU in `gpu.rs`.
fn on_gpu() -> bool {
    false
}
