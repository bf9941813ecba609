//! Hands that are not there: for tests, practice and demonstrations.

pub mod allegro;
#[cfg(unix)]
pub mod pty;
