//! STL, binary and text.

use std::path::Path;

use nalgebra::Point3;

use super::{TriMesh, coincident};
use crate::{Error, Result, fsutil};

const HEADER: usize = 84;
const RECORD: usize = 50;

/// Reads an STL file, binary or text. Corners with the same coordinates become one vertex; the stored normals are ignored.
///
/// # Errors
/// If it cannot be read, is cut off, holds no triangles or a coordinate that is not finite.
pub fn read_stl(path: &Path) -> Result<TriMesh> {
    parse_stl(path, &fsutil::read_bytes(path)?)
}

/// As [`read_stl`], from memory.
///
/// # Errors
/// As [`read_stl`].
pub fn parse_stl(path: &Path, bytes: &[u8]) -> Result<TriMesh> {
    // Binary files may begin with "solid" too, so the length decides.
    let count = bytes.get(80..HEADER).and_then(|b| b.try_into().ok()).map(|b| u32::from_le_bytes(b) as usize);
    let binary = count.is_some_and(|n| n.checked_mul(RECORD).and_then(|n| n.checked_add(HEADER)) == Some(bytes.len()));
    let corners = if binary {
        bytes[HEADER..].chunks_exact(RECORD).flat_map(binary_corners).collect()
    } else if bytes.trim_ascii_start().starts_with(b"solid")
        && (bytes.is_ascii() || bytes.windows(5).any(|w| w == b"facet"))
    {
        text_corners(path, bytes)?
    } else {
        let what = match count {
            Some(n) => {
                format!("{} bytes, but {n} triangles need {}", bytes.len(), (n as u64) * RECORD as u64 + HEADER as u64)
            }
            None => format!("{} bytes are no STL", bytes.len()),
        };
        return Err(Error::content(path, None, what, "export the mesh again"));
    };
    weld(path, &corners)
}

/// Three corners of one binary record: 12 bytes of normal, 3 x 12 bytes of corners, 2 unused.
fn binary_corners(record: &[u8]) -> [Point3<f64>; 3] {
    let number = |i: usize| match record.get(12 + 4 * i..16 + 4 * i).and_then(|b| b.try_into().ok()) {
        Some(b) => f64::from(f32::from_le_bytes(b)),
        None => f64::NAN,
    };
    [0, 3, 6].map(|i| Point3::new(number(i), number(i + 1), number(i + 2)))
}

fn text_corners(path: &Path, bytes: &[u8]) -> Result<Vec<Point3<f64>>> {
    let mut corners = Vec::new();
    for (i, line) in bytes.split(|b| *b == b'\n').enumerate() {
        let text = std::str::from_utf8(line).unwrap_or_default();
        let mut words = text.split_ascii_whitespace();
        if words.next().is_some_and(|w| w.eq_ignore_ascii_case("vertex")) {
            let numbers: Vec<f64> = words.map_while(|w| w.parse().ok()).collect();
            let &[x, y, z] = numbers.as_slice() else {
                let what = format!("`{}` is no vertex with three numbers", text.trim());
                return Err(Error::content(path, i + 1, what, "export the mesh again"));
            };
            corners.push(Point3::new(x, y, z));
        }
    }
    Ok(corners)
}

/// An indexed mesh from corners in threes; vertices are numbered in the order of their first use.
fn weld(path: &Path, corners: &[Point3<f64>]) -> Result<TriMesh> {
    if corners.is_empty() || !corners.len().is_multiple_of(3) {
        let what = format!("{} corners do not make triangles", corners.len());
        return Err(Error::content(path, None, what, "export the mesh again"));
    }
    let mut places = coincident(corners, 0.0);
    let faces = (0..corners.len() as u32).step_by(3).map(|i| [i, i + 1, i + 2].map(|v| places.find(v)));
    let TriMesh { vertices, faces } = TriMesh::of_faces(corners, faces);
    TriMesh::new(vertices, faces).map_err(|e| Error::at(path, None, e))
}
