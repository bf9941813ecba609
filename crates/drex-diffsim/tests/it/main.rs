//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr, missing_docs, dead_code)] // a test may panic, and prints what it measured

mod analytic;
#[path = "../common/mod.rs"]
mod common;
mod cube_tosses;
mod derivatives;
mod events;
mod mesh_resolution;
mod passive;
mod push_mujoco;
#[path = "../recorded/mod.rs"]
mod recorded;
mod refusals;
mod shapes;
mod soft_contact;
mod state;
