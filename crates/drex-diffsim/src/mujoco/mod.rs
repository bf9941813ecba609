//! The same model and scene in MuJoCo: a second engine to compare with and to judge grasps by.
//!
//! [`to_mjcf`] writes a model, a scene and a state as MJCF text; it is always there and needs nothing. With the feature
//! `mujoco`, `MujocoEngine` compiles that text and steps it, and `mujoco::rollout` returns the [`Record`](crate::Record)
//! that [`crate::rollout`] returns.
#![doc = include_str!("../docs/mujoco.md")]

mod arm;
#[cfg(feature = "mujoco")]
mod engine;
mod geoms;
#[cfg(feature = "mujoco")]
mod layout;
mod mjcf;
mod options;
mod text;

#[cfg(feature = "mujoco")]
pub use engine::{MujocoEngine, rollout};
pub use mjcf::to_mjcf;
pub use options::{Integrator, MjcfOptions};
