//! Poses, trajectories, clocks, cameras, meshes and the twin folder: what every drex crate shares.
//!
//! Conventions (the whole workspace keeps them):
//! SI units; world z up, gravity (0, 0, -9.81) m/s²; cameras have OpenCV axes (x right, y down, z forward);
//! `a_from_b` maps coordinates in frame b to coordinates in frame a; quaternions are w, x, y, z on disk;
//! joint values are keyed by joint name; time stamps are seconds of one clock.

pub mod camera;
pub mod clock;
pub mod error;
pub mod fsutil;
pub mod joints;
pub mod mesh;
pub mod pose;
pub mod push;
pub mod readers;
pub mod surface;
pub mod trajectory;
pub mod twin;

pub use error::{Error, Result};
pub use mesh::{MassProperties, TriMesh};
pub use pose::{Pose, Real};
pub use surface::{SdfSample, SignedDistance, Surface, SurfacePoint};
pub use trajectory::Trajectory;
