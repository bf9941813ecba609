#![doc = include_str!("../README.md")]

mod articulation;
#[cfg(feature = "engine")]
mod engine;
mod error;
mod geoms;
#[cfg(feature = "engine")]
mod layout;
mod mjcf;
mod options;
mod sections;
mod text;

#[cfg(feature = "engine")]
pub use engine::{MujocoEngine, rollout};
pub use error::{Error, Result};
pub use mjcf::to_mjcf;
pub use options::{Integrator, MjcfOptions};
