//! Photos of a painted scene with exactly known cameras, from a seed.
//!
//! ```text
//! kinds   (kind, seed, size) -> Capture: scene, lens, shots
//! desk    a desk from a seed: sizes, paints, lamp      shots  the photos of each kind, along a path
//! objects solids that make the thing on the table      tag    a printed AprilTag
//! paint   pictures (canvas: how, styles: what)         scene  solids in a room, rays against them
//! render  rays -> photo and silhouette                 write  JPEG with EXIF, masks, truth as COLMAP's text
//! ```
//! Units are metres, the world's z points up, the table top is z = 0. Camera axes are OpenCV's, the centre of the first
//! pixel is (0.5, 0.5). A capture depends on its seed alone, not on the number of threads.
#![allow(dead_code)] // tests include this folder and use a part of it

pub mod canvas;
pub mod desk;
pub mod kinds;
pub mod objects;
pub mod paint;
pub mod path;
pub mod render;
pub mod scene;
pub mod shots;
pub mod styles;
pub mod tag;
pub mod write;

/// Errors of the example: text for a person.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// 64 bits from a key; neighbouring keys give unrelated bits (finaliser of SplitMix64).
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
