//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

mod adam;
#[path = "../common/mod.rs"]
mod common;
mod distribution;
mod frames;
mod hands;
mod known_force;
mod metamorphic;
mod placebo;
mod plan;
mod recordings;
mod refusals;
mod synthetic;
