//! Photos to Gaussians on any computer: 3D for looks, 2D for geometry.
//!
//! # Conventions
//!
//! Cameras have OpenCV axes (x right, y down, z forward); the centre of the first pixel is (0.5, 0.5). Quaternions are
//! w, x, y, z. Scenes are in single precision, cameras and poses in double.

pub mod camera;
pub mod capture;
pub mod error;
pub mod gaussians;
pub mod io;
pub mod loss;
pub mod metrics;
pub mod optim;
pub mod orbit;
pub mod raster;
pub mod reconstruct;
pub mod scene;
mod simd;
pub mod train;
pub mod transform;
pub mod usage;

pub use camera::PinholeCamera;
pub use capture::{Capture, CaptureOptions, Photo, PhotoOptions, Photos};
pub use error::{Error, Result};
pub use gaussians::{Gaussians, Kind, Label};
pub use orbit::Orbit;
pub use raster::{Cpu, CpuSaved, GaussianGradients, Rasterizer, Render, RenderGradients, RenderOptions};
pub use reconstruct::{ReconstructOptions, Reconstruction, reconstruct};
pub use scene::{Bound, Scene};
pub use train::{TrainOptions, Trainer};

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
