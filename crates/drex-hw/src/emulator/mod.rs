//! Hands that are not there: for tests, practice and demonstrations.

pub mod leap;
