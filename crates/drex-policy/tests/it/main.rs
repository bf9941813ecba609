//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

#[path = "../common/mod.rs"]
mod common;
mod determinism;
mod learning;
mod no_backend;
mod paper;
mod real;
mod refusals;
mod resume;
mod rollouts;
mod saving;
