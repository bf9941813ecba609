//! Depth of surfaces that are known exactly.
#![allow(clippy::unwrap_used)] // a failed unwrap is a failed test

mod refinement;
mod scene;
mod surfaces;
