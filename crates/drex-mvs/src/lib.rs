//! Depth maps from photos with known cameras, by PatchMatch stereo on the processor, or on a GPU with the feature `wgpu`; meshes refined on the photos, and their textures.
//!
//! ```text
//! photos, cameras, masks, region ─► scene (cut, grey, sizes; which photos are compared) ─► patchmatch (planes per pixel, by kernel's costs)
//!                     depth, normal, confidence per photo ◄─ consistency (what other photos confirm) ◄─ from small to full size ◄─┘
//! ```
//! [`DepthMaps::estimate`] does it all. What is fused of the maps elsewhere, [`refine()`] moves to where the photos agree about it, and
//! [`texture()`] gives it their colours.

mod consistency;
mod depth_map;
#[cfg(test)]
mod devices;
#[cfg(feature = "wgpu")]
mod gpu;
#[cfg(not(feature = "wgpu"))]
#[path = "no_gpu.rs"]
mod gpu;
mod kernel;
mod maps;
mod options;
mod patchmatch;
mod picture;
mod refine;
mod rounds;
mod scene;
mod specks;
mod texture;

pub use depth_map::DepthMap;
pub use maps::{DepthMaps, Step};
pub use options::{MvsOptions, Preset, Region};
pub use refine::{Hold, RefineOptions, RefineReport, refine};
pub use rounds::remove_work;
pub use texture::{
    PhotoGain, Prediction, Texture, TextureOptions, TextureReport, TexturedPoint, prediction, texture, textured_points,
};

/// Runs the examples of the README as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
