//! Renders as PNG: colours, opacity, depth as a colour map, normals.

use std::io::Cursor;
use std::path::Path;

use drex_core::fsutil;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

use super::byte;
use crate::{Error, Render, Result};

/// Colours from near to far: viridis (van der Walt and Smith, CC0) at nine even steps, reversed so that near is bright.
const NEAR_TO_FAR: [[u8; 3]; 9] = [
    [253, 231, 37],
    [173, 220, 48],
    [94, 201, 98],
    [40, 174, 128],
    [33, 145, 140],
    [44, 114, 142],
    [59, 82, 139],
    [71, 45, 123],
    [68, 1, 84],
];

/// Writes colours, 0 to 1, row by row from the upper left.
///
/// # Errors
/// If there are not `width` x `height` pixels, or the file cannot be written.
pub fn write_rgb(path: &Path, width: usize, height: usize, rgb: &[[f32; 3]]) -> Result<()> {
    let bytes: Vec<u8> = rgb.as_flattened().iter().map(|v| byte(255.0 * v)).collect();
    write(path, width, height, &bytes, ExtendedColorType::Rgb8)
}

/// Writes colours with their opacity; `rgb` is as drawn before black, so multiplied by it.
///
/// # Errors
/// As [`write_rgb`].
pub fn write_rgba(path: &Path, width: usize, height: usize, rgb: &[[f32; 3]], alpha: &[f32]) -> Result<()> {
    let bytes: Vec<u8> = rgb
        .iter()
        .zip(alpha)
        .flat_map(|(c, &a)| [c[0], c[1], c[2], a * a].map(|v| byte(255.0 * v / a.max(1e-6))))
        .collect();
    write(path, width, height, &bytes, ExtendedColorType::Rgba8)
}

/// Writes opacity, 0 (black) to 1 (white).
///
/// # Errors
/// As [`write_rgb`].
pub fn write_alpha(path: &Path, width: usize, height: usize, alpha: &[f32]) -> Result<()> {
    let bytes: Vec<u8> = alpha.iter().map(|v| byte(255.0 * v)).collect();
    write(path, width, height, &bytes, ExtendedColorType::L8)
}

/// Writes depth as colours from `range[0]` (bright) to `range[1]` (dark); black where there is none (0 or not finite).
///
/// # Errors
/// As [`write_rgb`].
pub fn write_depth(path: &Path, width: usize, height: usize, depth: &[f32], range: [f32; 2]) -> Result<()> {
    let span = (range[1] - range[0]).max(f32::MIN_POSITIVE);
    let bytes: Vec<u8> =
        depth.iter().flat_map(|&z| if is_depth(z) { colour((z - range[0]) / span) } else { [0; 3] }).collect();
    write(path, width, height, &bytes, ExtendedColorType::Rgb8)
}

/// A range that shows a depth map well: from its 2nd to its 98th percentile. `None` if nothing is seen.
pub fn depth_range(depth: &[f32]) -> Option<[f32; 2]> {
    let mut seen: Vec<f32> = depth.iter().copied().filter(|&z| is_depth(z)).collect();
    seen.sort_unstable_by(f32::total_cmp);
    let at = |part: f32| seen.get(((seen.len() as f32 - 1.0) * part).round() as usize).copied();
    Some([at(0.02)?, at(0.98)?])
}

/// Writes normals (camera frame: x right, y down, z forward; of any length) in the usual colours: red right, green up,
/// blue towards the camera; black where there is none.
///
/// # Errors
/// As [`write_rgb`].
pub fn write_normals(path: &Path, width: usize, height: usize, normals: &[[f32; 3]]) -> Result<()> {
    let bytes: Vec<u8> = normals
        .iter()
        .flat_map(|&n| unit(n).map_or([0; 3], |[x, y, z]| [x, -y, -z].map(|v| byte(127.5 * (1.0 + v)))))
        .collect();
    write(path, width, height, &bytes, ExtendedColorType::Rgb8)
}

impl Render {
    /// Σ w z / Σ w, scene units; 0 where nothing is seen.
    pub fn expected_depth(&self) -> Vec<f32> {
        self.depth.iter().zip(&self.alpha).map(|(&d, &a)| if a > 0.0 { d / a } else { 0.0 }).collect()
    }

    /// The normals at unit length, camera frame; 0 where nothing is seen.
    pub fn unit_normals(&self) -> Vec<[f32; 3]> {
        self.normal.iter().map(|&n| unit(n).unwrap_or_default()).collect()
    }
}

fn unit([x, y, z]: [f32; 3]) -> Option<[f32; 3]> {
    let length = (x * x + y * y + z * z).sqrt();
    (length > 0.0).then(|| [x / length, y / length, z / length])
}

fn is_depth(z: f32) -> bool {
    z > 0.0 && z.is_finite()
}

/// The colour of the map at `t`, 0 to 1.
fn colour(t: f32) -> [u8; 3] {
    let t = t.clamp(0.0, 1.0) * (NEAR_TO_FAR.len() - 1) as f32;
    let k = (t as usize).min(NEAR_TO_FAR.len() - 2);
    let (a, b, s) = (NEAR_TO_FAR[k], NEAR_TO_FAR[k + 1], t - k as f32);
    [0, 1, 2].map(|c| byte(f32::from(a[c]) * (1.0 - s) + f32::from(b[c]) * s))
}

fn write(path: &Path, width: usize, height: usize, bytes: &[u8], kind: ExtendedColorType) -> Result<()> {
    let channels = usize::from(kind.channel_count());
    let pixels = width.checked_mul(height).filter(|&n| n > 0 && n.checked_mul(channels) == Some(bytes.len()));
    let (Some(_), Ok(w), Ok(h)) = (pixels, u32::try_from(width), u32::try_from(height)) else {
        return Err(Error::Option {
            what: format!("a picture of {width} x {height} pixels is to hold {} of them", bytes.len() / channels),
            remedy: "give as many pixels as the picture has".into(),
        });
    };
    let mut png = Cursor::new(Vec::new());
    PngEncoder::new(&mut png).write_image(bytes, w, h, kind).map_err(|source| drex_core::Error::Picture {
        action: "write",
        path: path.to_path_buf(),
        source: source.into(),
    })?;
    Ok(fsutil::write_atomic(path, png.get_ref())?)
}
