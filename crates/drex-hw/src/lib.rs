//! LEAP and Allegro hands under force control, safe by default, testable without a hand.

mod error;

pub use error::{Error, Result};
