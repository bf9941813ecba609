//! LEAP and Allegro hands under force control, safe by default, testable without a hand.

pub mod can;
mod error;
pub mod law;

pub use error::{Error, Result};
