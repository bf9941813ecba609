//! Wavefront OBJ: vertices and faces. Normals, texture coordinates, groups and materials are not read.

use std::path::Path;

use nalgebra::Point3;

use super::{TriMesh, polygon_triangles};
use crate::{Error, Result, fsutil};

/// Reads the vertices (in full f64 precision) and faces of an OBJ file. Polygons become triangles as by
/// [`polygon_triangles`], which is right for convex ones; objects and groups become one mesh.
///
/// # Errors
/// If it cannot be read; with the line if a vertex or face is malformed, not finite, or names a vertex that is not there;
/// if there are no faces.
pub fn read_obj(path: &Path) -> Result<TriMesh> {
    parse_obj(path, &fsutil::read_bytes(path)?)
}

/// As [`read_obj`], from memory.
///
/// # Errors
/// As [`read_obj`].
pub fn parse_obj(path: &Path, bytes: &[u8]) -> Result<TriMesh> {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for (i, line) in bytes.split(|b| *b == b'\n').enumerate() {
        // Names may be in any encoding; what matters here is ASCII.
        let text = String::from_utf8_lossy(line);
        let mut words = text.split_ascii_whitespace();
        let refuse = |what: &str| {
            let what = format!("`{}`: {what}", text.trim().chars().take(60).collect::<String>());
            Error::content(path, i + 1, what, "export the mesh again")
        };
        match words.next() {
            Some("v") => {
                let numbers: Vec<f64> = words.map_while(|w| w.parse().ok()).collect();
                // Some exporters add a weight or a colour.
                let Some(&[x, y, z]) = numbers.first_chunk::<3>() else {
                    return Err(refuse("a vertex needs three numbers"));
                };
                if ![x, y, z].iter().all(|c| c.is_finite()) {
                    return Err(refuse("the vertex is not finite"));
                }
                vertices.push(Point3::new(x, y, z));
            }
            Some("f") => {
                let corners = words
                    .take_while(|w| !w.starts_with('#'))
                    .map(|word| corner(word, vertices.len()).ok_or_else(|| refuse("a corner names no vertex above it")))
                    .collect::<Result<Vec<u32>>>()?;
                if corners.len() < 3 {
                    return Err(refuse("a face needs three corners"));
                }
                faces.extend(polygon_triangles(corners.len()).iter().map(|t| t.map(|k| corners[k])));
            }
            _ => {}
        }
    }
    if faces.is_empty() {
        return Err(Error::content(path, None, "no faces", "give a mesh of a surface, not a point cloud"));
    }
    TriMesh::new(vertices, faces).map_err(|e| Error::at(path, None, e))
}

/// Zero-based vertex of a face corner `v`, `v/vt`, `v//vn` or `v/vt/vn`; v counts from 1, or back from the last if negative.
fn corner(word: &str, vertices: usize) -> Option<u32> {
    let index: i64 = word.split('/').next()?.parse().ok()?;
    let count = i64::try_from(vertices).ok()?;
    let zero_based = if index > 0 { index - 1 } else { count.checked_add(index)? };
    if index == 0 || !(0..count).contains(&zero_based) {
        return None;
    }
    u32::try_from(zero_based).ok()
}
