//! The stages: each reads files of the twin and writes others, and names what it wrote.

pub(crate) mod appearance;
pub(crate) mod asset;
pub(crate) mod evaluate;
pub(crate) mod execute;
pub(crate) mod grasps;
mod human;
pub(crate) mod identify;
mod practice;
pub(crate) mod scan;
pub(crate) mod train;
pub(crate) mod trial;

pub use identify::recordings;
