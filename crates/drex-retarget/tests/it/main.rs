//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

mod bundled_models;
mod cookie_demos;
mod evaluation;
mod goldens;
mod grasp;
mod hands;
#[path = "../made_hand/mod.rs"]
mod made_hand;
mod mappings;
mod retarget;
#[path = "../support/mod.rs"]
mod support;
mod wrist_fit;
