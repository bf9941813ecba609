//! What moves the parameters: Adam, and how its steps shrink.

pub mod adam;

pub use adam::{ExponentialRate, Moments, adam_step};
