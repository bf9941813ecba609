//! The report of a twin: one page with plots, pictures and a viewer, and the same findings for a terminal.
//!
//! [`write()`] is the last stage of a pipeline, [`findings`] what a run found in words and as JSON, [`write_batch`] the page of many
//! objects. [`picture`] draws meshes, hands and plots without a GPU, fonts or a network.

mod batch;
mod error;
mod grasps;
mod hand;
mod learned;
mod mass;
mod object;
mod page;
mod people;
pub mod picture;
mod push;
mod replay;
mod report;
mod scan;
mod summary;
mod trial;
mod viewer;

pub use batch::write_batch;
pub use error::{Error, Result};
pub use mass::{contradiction_text, posterior_text, prior_text};
pub use object::{closing_text, pieces_text};
pub use push::verdict_text;
pub use report::{page, write, write_picture};
pub use summary::{Findings, findings};

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
