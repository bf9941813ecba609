//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

mod finite_differences_3d;
mod golden_2d;
mod golden_3d;
#[path = "../goldens/mod.rs"]
mod goldens;
mod hostile_3d;
mod io_gaussians;
mod io_maps;
mod io_scene;
mod losses;
mod optimiser;
mod real_scans;
#[path = "../scenes/mod.rs"]
mod scenes;
#[path = "../support/mod.rs"]
mod support;
mod surfels;
mod training;
