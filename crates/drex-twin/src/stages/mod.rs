//! The stages: each reads files of the twin and writes others, and names what it wrote.

pub(crate) mod appearance;
pub(crate) mod asset;
pub(crate) mod evaluate;
pub(crate) mod execute;
pub(crate) mod grasps;
mod human;
pub(crate) mod identify;
pub(crate) mod scan;
mod simulated;
pub(crate) mod train;
pub(crate) mod trial;

pub use identify::recordings;
