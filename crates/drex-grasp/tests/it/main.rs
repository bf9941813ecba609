//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

mod closed_forms;
mod closure;
mod evaluation;
mod force;
mod grip_force;
mod hand;
mod pinch;
mod rolling;
#[path = "../support/mod.rs"]
mod support;
