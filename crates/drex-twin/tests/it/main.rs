//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

mod changed;
mod common;
mod edited;
mod interrupted;
mod locked;
mod manifest;
mod old;
mod propose;
mod records;
mod refused;
#[path = "../support/mod.rs"]
mod support;
