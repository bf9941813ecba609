//! Depth of surfaces that are known exactly.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // a test may panic, and prints what it measured

mod refinement;
mod scene;
mod surfaces;
mod texture;
