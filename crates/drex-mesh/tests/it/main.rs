//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

mod articulated;
mod asset;
mod check;
mod contradictions;
mod decimate;
mod fusion;
mod models;
mod mujoco;
mod partition;
mod properties;
mod readers;
mod real_data;
mod rest;
mod scale;
mod scene;
mod soups;
#[path = "../support/mod.rs"]
mod support;
