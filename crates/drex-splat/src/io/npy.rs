//! Arrays as NumPy's `.npy`: depth and normal maps, bit for bit.

use std::path::Path;

use drex_core::fsutil;

use super::content;
use crate::{Error, Result};

const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// An array in C order (last index fastest).
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Its size along every axis: `[height, width]` for a map, `[height, width, 3]` for a map of vectors.
    pub shape: Vec<usize>,
    /// Its values, as single precision whatever the file holds.
    pub values: Vec<f32>,
}

/// Writes `values` of this `shape` in single precision.
///
/// # Errors
/// If the shape has another number of values, or the file cannot be written.
pub fn write(path: &Path, shape: &[usize], values: &[f32]) -> Result<()> {
    Ok(fsutil::write_atomic(path, &to_bytes(shape, values)?)?)
}

/// The bytes of the file.
///
/// # Errors
/// If the shape has another number of values.
pub fn to_bytes(shape: &[usize], values: &[f32]) -> Result<Vec<u8>> {
    if product(shape) != Some(values.len()) {
        return Err(Error::Option {
            what: format!("an array of shape {shape:?} is to hold {} values", values.len()),
            remedy: "give as many values as the shape has".into(),
        });
    }
    let sizes: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}", sizes.trim_end_matches(' '));
    // Magic, version and length are 10 bytes; the data starts at a multiple of 64, after a line feed.
    let length = (10 + header.len() + 1).next_multiple_of(64) - 10;
    let length_bytes = u16::try_from(length).map_err(|_| Error::Option {
        what: format!("an array has {} axes", shape.len()),
        remedy: "give a map or a map of vectors".into(),
    })?;
    let mut out = Vec::with_capacity(10 + length + 4 * values.len());
    out.extend(MAGIC);
    out.extend([1, 0]);
    out.extend(length_bytes.to_le_bytes());
    out.extend(format!("{header:<width$}\n", width = length - 1).into_bytes());
    out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    Ok(out)
}

/// Reads an array of f2, f4, f8, u1, u2, i4, i8 or bool, little endian, in C order.
///
/// # Errors
/// If the file cannot be read, is no `.npy`, holds something else, or ends too early.
pub fn read(path: &Path) -> Result<Array> {
    parse(path, &fsutil::read_bytes(path)?)
}

/// As [`read`], from memory.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Array> {
    let refuse = |what: String| content(path, None, what, "save it with numpy.save, as float32 in C order");
    let (header, data) = split(bytes).ok_or_else(|| refuse("no .npy file".into()))?;
    let entry = |key: &str| header.split_once(&format!("'{key}':")).map(|(_, tail)| tail.trim_start());
    let kind = entry("descr").and_then(|t| t.strip_prefix('\'')?.split('\'').next()).unwrap_or("of several fields");
    if !entry("fortran_order").is_some_and(|t| t.starts_with("False")) {
        return Err(refuse("the array is not in C order".into()));
    }
    let sizes = entry("shape").and_then(|t| t.strip_prefix('(')?.split(')').next());
    let shape: Vec<usize> = sizes
        .and_then(|s| s.split(',').map(str::trim).filter(|s| !s.is_empty()).map(|s| s.parse().ok()).collect())
        .ok_or_else(|| refuse("the header gives no shape".into()))?;
    let (width, number): (usize, fn(&[u8]) -> f32) = match kind {
        "|u1" | "|b1" => (1, |b| f32::from(b[0])),
        "<u2" => (2, |b| f32::from(u16::from_le_bytes([b[0], b[1]]))),
        "<f2" => (2, |b| half(u16::from_le_bytes([b[0], b[1]]))),
        "<f4" => (4, |b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        "<i4" => (4, |b| i32::from_le_bytes([b[0], b[1], b[2], b[3]]) as f32),
        "<i8" => (8, |b| i64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]) as f32),
        "<f8" => (8, |b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]) as f32),
        other => return Err(refuse(format!("the numbers are of type {other}"))),
    };
    let Some(data) = product(&shape).and_then(|n| data.get(..n.checked_mul(width)?)) else {
        let what = format!("an array of shape {shape:?} is announced, but the file ends before");
        return Err(content(path, None, what, "fetch the file again: it was cut off"));
    };
    Ok(Array { shape, values: data.chunks_exact(width).map(number).collect() })
}

/// Header and data; `None` if the start is not that of a `.npy`.
fn split(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let tail = bytes.strip_prefix(MAGIC)?;
    let (length, start) = match *tail.first()? {
        1 => (usize::from(u16::from_le_bytes([*tail.get(2)?, *tail.get(3)?])), 4),
        2 | 3 => (u32::from_le_bytes(tail.get(2..6)?.try_into().ok()?) as usize, 6),
        _ => return None,
    };
    let (header, data) = tail.get(start..)?.split_at_checked(length)?;
    Some((std::str::from_utf8(header).ok()?, data))
}

fn product(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1usize, |n, &size| n.checked_mul(size))
}

/// The value of 16 bits of IEEE half precision.
fn half(bits: u16) -> f32 {
    let sign = if bits >> 15 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f32::from(bits & 1023) / 1024.0);
    sign * match exponent {
        0 => fraction * 2f32.powi(-14),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1.0 + fraction) * 2f32.powi(exponent - 15),
    }
}
