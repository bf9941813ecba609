//! What moves the parameters: Adam.

pub mod adam;

pub use adam::{Moments, adam_step};
