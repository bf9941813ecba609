//! Hands that are not there: for tests, practice and demonstrations.

pub mod allegro;
pub mod leap;
#[cfg(unix)]
pub mod pty;
