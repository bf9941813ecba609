//! Photos of a painted scene with exactly known cameras, from a seed.
//!
//! ```text
//! kinds   (kind, seed, size) -> Capture: scene, lens, shots
//! objects solids that make the thing on the table      path   where the camera goes
//! paint   pictures for every surface                   tag    a printed AprilTag
//! scene   solids in a room, rays against them          render rays -> photo and silhouette
//! write   JPEG with EXIF, masks, truth in COLMAP's text layout
//! ```
//! Units are metres, the world's z points up, the table top is z = 0. Camera axes are OpenCV's, the centre of the first
//! pixel is (0.5, 0.5). A capture depends on its seed alone, not on the number of threads.
#![allow(dead_code)] // tests include this folder and use a part of it

pub mod desk;
pub mod kinds;
pub mod objects;
pub mod paint;
pub mod path;
pub mod render;
pub mod scene;
pub mod tag;
pub mod write;

/// Errors of the example: text for a person.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// A number in [0, 1) from a key; neighbouring keys give unrelated numbers (finaliser of SplitMix64).
#[must_use]
pub fn hash(key: u64) -> u64 {
    let mut z = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A number in [0, 1) from a key.
#[must_use]
pub fn hash01(key: u64) -> f32 {
    (hash(key) >> 40) as f32 / (1u64 << 24) as f32
}
