//! LEAP and Allegro hands under force control, safe by default, testable without a hand.

mod error;
pub mod law;

pub use error::{Error, Result};
