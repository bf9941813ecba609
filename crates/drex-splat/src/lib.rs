//! Photos to Gaussians on any computer: 3D for looks, 2D for geometry.
//!
//! From photos to Gaussians: [`Capture`](drex_core::capture::Capture) reads what was photographed from where, [`reconstruct()`]
//! trains an ellipsoid set for looks and a surfel set for geometry and writes them with depth maps. Each part also stands alone: a rasteriser with an
//! analytic derivative ([`raster`]), losses ([`loss`]), a training loop over any photos ([`Trainer`]), files ([`io`]), and
//! sets that move with rigid bodies ([`Scene`]).
//!
//! ```
//! use drex_splat::{Cpu, Gaussians, Kind, Orbit, Rasterizer, RenderGradients, RenderOptions, train::from_points};
//! use nalgebra::Vector3;
//!
//! // Three grey Gaussians, seen from an orbit; how does the mean brightness change with each?
//! let set = from_points(&[[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]], &[[128; 3]; 3], Kind::Ellipsoid, 0, 0.8);
//! let camera = &Orbit::round(&set, Vector3::z(), 0.4, 0.9, 64, 48)?.cameras(1)?[0];
//! let mut options = RenderOptions::default();
//! options.sh_degree = 0;
//! let (render, saved) = Cpu.forward(&set, camera, &options)?;
//! let pixels = render.rgb.len() as f32;
//! let by_picture = RenderGradients { rgb: vec![[1.0 / pixels; 3]; render.rgb.len()], ..Default::default() };
//! let by_set = Cpu.backward(&set, camera, &options, &render, &saved, &by_picture)?;
//! assert!(by_set.logit_opacities.iter().all(|&g| g > 0.0)); // more opaque is brighter on black
//! # Ok::<(), drex_splat::Error>(())
//! ```
//!
//! # Conventions
//!
//! Cameras have OpenCV axes (x right, y down, z forward); the centre of the first pixel is (0.5, 0.5). Quaternions are
//! w, x, y, z. Scenes are in single precision, cameras and poses in double.

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
pub mod train;
pub mod transform;
pub mod usage;

pub use error::{Error, Result};
pub use gaussians::{Gaussians, Kind, Label};
pub use orbit::Orbit;
pub use raster::{Cpu, CpuSaved, GaussianGradients, Rasterizer, Render, RenderGradients, RenderOptions};
pub use reconstruct::{ReconstructOptions, Reconstruction, reconstruct, train_surfels};
pub use scene::{Attachment, Scene};
pub use train::{TrainOptions, Trainer};

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
