//! Poses, trajectories, cameras, meshes, objects and files: what every drex crate shares.
//!
//! Meshes know what the solid weighs and how it turns:
//!
//! ```
//! let tetrahedron = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";
//! let mesh = drex_core::mesh::parse_obj("t.obj".as_ref(), tetrahedron.as_bytes())?;
//! let solid = mesh.mass_properties(1000.0)?; // density, kg/m³
//! assert!((solid.mass_kg - 1.0 / 6.0).abs() < 1e-12);
//! assert!((solid.center_of_mass.x - 0.025).abs() < 1e-12);
//! # Ok::<(), drex_core::Error>(())
//! ```
//!
//! # Conventions
//!
//! The whole workspace keeps them: SI units; world z up, gravity (0, 0, -9.81) m/s²; cameras have OpenCV axes (x right,
//! y down, z forward); `a_from_b` maps coordinates in frame b to coordinates in frame a; quaternions are w, x, y, z on
//! disk; joint values are keyed by joint name; time stamps are seconds of one clock.
//!
//! Errors ([`Error`]) say what was wrong, in which file and line, and what to do. No input makes the crate panic.

pub mod budget;
pub mod camera;
#[cfg(feature = "capture")]
pub mod capture;
pub mod error;
pub mod fsutil;
#[cfg(feature = "wgpu")]
pub mod gpu;
pub mod mesh;
pub mod npy;
pub mod object;
pub mod part;
pub mod ply;
pub mod pose;
pub mod program;
pub mod sets;
#[cfg(feature = "simd")]
pub mod simd;
pub mod stats;
pub mod surface;
pub mod trajectory;

pub use error::{Error, Result};
pub use mesh::{MassProperties, TriMesh};
pub use object::{ASSUMED_FRICTION, Object, SolidGeometry, TablePlane};
pub use part::{ConvexPart, Primitive, PrimitiveRecord, PrimitiveShape};
pub use pose::{Pose, PoseRecord, Real};
pub use surface::{SdfSample, SignedDistance, Surface, SurfacePoint};
pub use trajectory::Trajectory;

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
