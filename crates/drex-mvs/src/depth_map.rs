//! What is known of the depth of one photo.

use drex_core::camera::PinholeCamera;

/// Depth of what one photo shows. All arrays are [height, width] of the camera's picture, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap {
    /// The part of the straightened photo in which depth was looked for, as a camera of its own.
    pub camera: PinholeCamera,
    /// Upper left corner of that part in the straightened photo, pixels.
    pub corner: [usize; 2],
    /// z in the camera's frame, the capture's unit of length; 0 where nothing was found or no other photo confirms it.
    pub depth: Vec<f32>,
    /// Unit normal in the camera's frame (x right, y down, z forward), towards the camera; zero where there is no depth.
    pub normal: Vec<[f32; 3]>,
    /// How far the depth is to be trusted, 0 to 1: the share of the photos looking there that confirm it, times the share of the pixels
    /// round it whose depth was found too, over 1 + d² where the disparity may be off by d pixels; 0 where there is no depth.
    pub confidence: Vec<f32>,
}
