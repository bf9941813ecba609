//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

mod asset;
mod bad_input;
mod batch;
#[path = "../common/mod.rs"]
mod common;
mod errors;
mod grasp;
mod hw;
mod hw_state;
mod identify;
mod masks;
mod outside;
mod posterior;
mod reconstruct;
mod render;
mod retarget;
mod sfm;
mod tools;
mod twin;
