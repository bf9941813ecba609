//! Gaussians as `.splat`, the 32 bytes a Gaussian of web viewers: small and exact in position and scale, coarse in
//! opacity, colour and rotation, without the higher spherical harmonics, labels and the kind.
//!
//! Little endian: position (3 x f32), standard deviations (3 x f32), red, green, blue and opacity (u8, 255 is one),
//! quaternion w, x, y, z (u8, 128 is zero, 0 is minus one).

use std::path::Path;

use drex_core::fsutil;

use super::{SH_C0, byte, checked, content, logit, three_log_scales, unit_quaternion};
use crate::{Gaussians, Kind, Label, Result};

/// Bytes of one Gaussian.
const SIZE: usize = 32;

/// Writes a set. Of its colours it keeps the constant part.
///
/// # Errors
/// If the set is inconsistent, a quaternion is zero, or the file cannot be written.
pub fn write(path: &Path, gaussians: &Gaussians) -> Result<()> {
    Ok(fsutil::write_atomic(path, &to_bytes(gaussians)?)?)
}

/// The bytes of the file.
///
/// # Errors
/// If the set is inconsistent or a quaternion is zero.
pub fn to_bytes(gaussians: &Gaussians) -> Result<Vec<u8>> {
    gaussians.check()?;
    let stride = gaussians.sh_stride();
    let mut out = Vec::with_capacity(gaussians.len() * SIZE);
    for i in 0..gaussians.len() {
        let scales = three_log_scales(gaussians, i).map(f32::exp);
        out.extend(gaussians.means[i].iter().chain(&scales).flat_map(|v| v.to_le_bytes()));
        out.extend(gaussians.sh[i * stride..i * stride + 3].iter().map(|c| byte(255.0 * (0.5 + SH_C0 * c))));
        out.push(byte(255.0 * gaussians.opacity(i)));
        out.extend(unit_quaternion(gaussians, i)?.map(|q| byte(128.0 * (q + 1.0))));
    }
    Ok(out)
}

/// Reads a set of degree 0, all background; the file does not tell of which `kind`.
///
/// # Errors
/// If the file cannot be read, its length is no multiple of 32 bytes, or a number is not finite.
pub fn read(path: &Path, kind: Kind) -> Result<Gaussians> {
    parse(path, &fsutil::read_bytes(path)?, kind)
}

/// As [`read`], from memory.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, bytes: &[u8], kind: Kind) -> Result<Gaussians> {
    if !bytes.len().is_multiple_of(SIZE) {
        let what = format!("{} bytes, which is no multiple of {SIZE}", bytes.len());
        return Err(content(path, None, what, "check that this is a .splat file and fetch it again"));
    }
    let mut out = Gaussians::new(kind, 0);
    for row in bytes.chunks_exact(SIZE) {
        let float = |k: usize| f32::from_le_bytes([row[4 * k], row[4 * k + 1], row[4 * k + 2], row[4 * k + 3]]);
        out.means.push([float(0), float(1), float(2)]);
        out.log_scales.push([float(3), float(4), float(5)].map(f32::ln));
        out.sh.extend(row[24..27].iter().map(|&c| (f32::from(c) / 255.0 - 0.5) / SH_C0));
        out.logit_opacities.push(logit(row[27]));
        out.rotations.push([row[28], row[29], row[30], row[31]].map(|q| (f32::from(q) - 128.0) / 128.0));
        out.labels.push(Label::BACKGROUND);
    }
    checked(path, out)
}
