//! Tests of the text that is written for MuJoCo and, with the feature `engine`, of MuJoCo's motions beside those of drex-diffsim.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

#[cfg(feature = "engine")]
mod bodies;
mod mjcf;
mod planar;
#[cfg(feature = "engine")]
mod robots;
