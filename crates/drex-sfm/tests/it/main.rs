//! The tests of this crate in one binary, which is built and linked once.
#![allow(clippy::unwrap_used, clippy::print_stderr, missing_docs)] // a test may panic, and says why it skips

#[path = "../../examples/make_capture/capture/mod.rs"]
mod capture;
#[path = "../../../drex-core/tests/capture_support/mod.rs"]
mod capture_support;
mod folder;
mod make_capture;
mod marker_detect;
mod marker_metric;
mod marker_photos;
mod programs;
mod register;
mod tag_renderer;
mod video;
