//! Files out and in: sets of Gaussians (ply, spz, splat), arrays (exr) and pictures (png).
//!
//! Each `read` and `write` takes a path; each `parse` and `to_bytes` works in memory, its path is for messages only.
//! Readers refuse what they cannot understand, say where it is, and never allocate more than the file can fill.

pub mod exr;
pub mod picture;
pub mod ply;
pub mod splat;
pub mod spz;

use std::path::Path;

use crate::{Error, Gaussians, Kind, Result};

/// Reads Gaussians from a `.ply`, `.spz` or `.splat` file, told by the name. `otherwise` is what they are if the file
/// does not tell.
///
/// # Errors
/// If the name has another ending, or the file cannot be read or understood.
pub fn read_gaussians(path: &Path, otherwise: Kind) -> Result<Gaussians> {
    match extension(path).as_str() {
        "ply" => ply::read(path, otherwise),
        "spz" => spz::read(path, otherwise),
        "splat" => splat::read(path, otherwise),
        _ => Err(unknown(path)),
    }
}

/// Writes Gaussians to a `.ply`, `.spz` or `.splat` file, told by the name.
///
/// # Errors
/// If the name has another ending, the set is inconsistent, or the file cannot be written.
pub fn write_gaussians(path: &Path, gaussians: &Gaussians) -> Result<()> {
    match extension(path).as_str() {
        "ply" => ply::write(path, gaussians),
        "spz" => spz::write(path, gaussians, spz::Version::default()),
        "splat" => splat::write(path, gaussians),
        _ => Err(unknown(path)),
    }
}

/// Constant band of the spherical harmonics, 1 / (2 √π).
const SH_C0: f32 = 0.282_094_79;

fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

fn unknown(path: &Path) -> Error {
    content(path, None, "the file's ending names no format of Gaussians", "use .ply, .spz or .splat")
}

/// An error about the content of a file.
fn content(path: &Path, line: impl Into<Option<usize>>, what: impl Into<String>, remedy: impl Into<String>) -> Error {
    drex_core::Error::content(path, line, what, remedy).into()
}

/// Refuses a set that was read and cannot be drawn, naming the file.
fn checked(path: &Path, gaussians: Gaussians) -> Result<Gaussians> {
    match gaussians.check() {
        Err(Error::Gaussians { what, remedy }) => Err(content(path, None, what, remedy)),
        Err(other) => Err(other),
        Ok(()) => Ok(gaussians),
    }
}

/// Logarithms of three scales for formats that know ellipsoids only: a surfel gets a hundredth of its smaller scale as
/// thickness, which viewers of ellipsoids draw as a disc.
fn three_log_scales(gaussians: &Gaussians, i: usize) -> [f32; 3] {
    const THIN: f32 = -4.605_170_2; // ln 0.01
    let [u, v, w] = gaussians.log_scales[i];
    match gaussians.kind {
        Kind::Ellipsoid => [u, v, w],
        Kind::Surfel => [u, v, u.min(v) + THIN],
    }
}

/// The quaternion of one Gaussian, of unit length.
fn unit_quaternion(gaussians: &Gaussians, i: usize) -> Result<[f32; 4]> {
    let q = gaussians.rotations[i].map(f64::from);
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !(norm > 0.0) {
        return Err(Error::Gaussians {
            what: format!("Gaussian {i} of {} has a quaternion of length zero", gaussians.len()),
            remedy: "remove it or give it a rotation".into(),
        });
    }
    Ok(q.map(|v| (v / norm) as f32))
}

/// Logit of an opacity stored in a byte; the extremes stay finite, half a step inside.
fn logit(byte: u8) -> f32 {
    let o = f32::from(byte).clamp(0.5, 254.5) / 255.0;
    (o / (1.0 - o)).ln()
}

/// Rounded into a byte.
fn byte(v: f32) -> u8 {
    v.round().clamp(0.0, 255.0) as u8
}
