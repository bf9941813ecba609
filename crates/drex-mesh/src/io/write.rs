//! Mesh files out, each written under a temporary name and then renamed.

use std::fmt::Write;
use std::path::Path;

use drex_core::TriMesh;
use drex_core::fsutil::write_atomic;

use crate::Result;

/// Writes a Wavefront OBJ with vertices and faces only; the numbers read back to the same bits.
///
/// # Errors
/// If the file cannot be written; an old one stays.
pub fn write_obj(path: &Path, mesh: &TriMesh) -> Result<()> {
    Ok(write_atomic(path, obj_text(mesh).as_bytes())?)
}

/// Writes a binary STL. Its numbers have single precision and its corners are not shared.
///
/// # Errors
/// If the file cannot be written; an old one stays.
pub fn write_stl(path: &Path, mesh: &TriMesh) -> Result<()> {
    let mut bytes = b"binary STL, metres".to_vec();
    bytes.resize(80, 0);
    bytes.extend((mesh.faces.len() as u32).to_le_bytes());
    for f in 0..mesh.faces.len() {
        let [a, b, c] = mesh.triangle(f);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
        for number in [normal, a.coords, b.coords, c.coords].iter().flatten() {
            bytes.extend((*number as f32).to_le_bytes());
        }
        bytes.extend([0, 0]);
    }
    Ok(write_atomic(path, &bytes)?)
}

/// Writes a binary little-endian PLY with double-precision vertices.
///
/// # Errors
/// If the file cannot be written; an old one stays.
pub fn write_ply(path: &Path, mesh: &TriMesh) -> Result<()> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
         property double z\nelement face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.faces.len()
    )
    .into_bytes();
    for number in mesh.vertices.iter().flat_map(|v| v.iter()) {
        bytes.extend(number.to_le_bytes());
    }
    for f in &mesh.faces {
        bytes.push(3);
        f.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    Ok(write_atomic(path, &bytes)?)
}

pub(crate) fn obj_text(mesh: &TriMesh) -> String {
    let mut text = String::with_capacity(48 * (mesh.vertices.len() + mesh.faces.len()));
    // Writing to a string cannot fail.
    for v in &mesh.vertices {
        let _ = writeln!(text, "v {} {} {}", v.x, v.y, v.z);
    }
    for [a, b, c] in &mesh.faces {
        let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
    }
    text
}
