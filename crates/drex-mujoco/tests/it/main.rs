//! Tests of the text that is written for MuJoCo and, with the feature `engine`, of MuJoCo's motions beside those of drex-diffsim.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)] // a test may panic, and shows what it measured

#[cfg(feature = "engine")]
mod bodies;
mod mjcf;
mod planar;
#[cfg(feature = "engine")]
mod robots;
