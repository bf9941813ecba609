//! Mesh files out, each written under a temporary name and then renamed.

use std::fmt::Write;
use std::path::Path;

use drex_core::TriMesh;
use drex_core::fsutil::write_atomic;

use super::{Model, extension, write_glb};
use crate::{Error, Result};

/// Writes a mesh in the format that the name ends in: `.obj`, `.stl` (binary), `.ply` (binary) or `.glb`.
///
/// # Errors
/// If the ending is another or the file cannot be written; an old one stays.
pub fn write_mesh(path: &Path, mesh: &TriMesh) -> Result<()> {
    match extension(path).as_str() {
        "obj" => write_obj(path, mesh),
        "stl" => write_stl(path, mesh),
        "ply" => write_ply(path, mesh),
        "glb" => write_glb(path, &Model::plain(mesh.clone())),
        other => Err(Error::UnknownExtension { path: path.to_path_buf(), extension: other.to_string() }),
    }
}

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

/// Writes a text STL; the numbers read back to the same bits, but corners are not shared.
///
/// # Errors
/// If the file cannot be written; an old one stays.
pub fn write_stl_text(path: &Path, mesh: &TriMesh) -> Result<()> {
    let mut text = String::from("solid mesh\n");
    // Writing to a string cannot fail.
    for f in 0..mesh.faces.len() {
        let [a, b, c] = mesh.triangle(f);
        let n = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
        let _ = writeln!(text, "facet normal {} {} {}\n outer loop", n.x, n.y, n.z);
        for v in [a, b, c] {
            let _ = writeln!(text, "  vertex {} {} {}", v.x, v.y, v.z);
        }
        text += " endloop\nendfacet\n";
    }
    text += "endsolid mesh\n";
    Ok(write_atomic(path, text.as_bytes())?)
}

/// How the numbers of a PLY file are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlyFormat {
    /// As text, in the shortest form that reads back to the same bits.
    Text,
    /// Binary, least significant byte first.
    #[default]
    Little,
    /// Binary, most significant byte first.
    Big,
}

/// Writes a binary little-endian PLY with double-precision vertices.
///
/// # Errors
/// If the file cannot be written; an old one stays.
pub fn write_ply(path: &Path, mesh: &TriMesh) -> Result<()> {
    write_ply_as(path, mesh, None, PlyFormat::Little)
}

/// Writes a PLY with double-precision vertices and, where given, a colour per vertex.
///
/// # Errors
/// If there is not one colour per vertex, or the file cannot be written; an old one stays.
pub fn write_ply_as(path: &Path, mesh: &TriMesh, colors: Option<&[[u8; 3]]>, format: PlyFormat) -> Result<()> {
    if let Some(colors) = colors.filter(|c| c.len() != mesh.vertices.len()) {
        let what = format!("{} colours for {} vertices", colors.len(), mesh.vertices.len());
        return Err(Error::value(what, "give one colour per vertex"));
    }
    let name = match format {
        PlyFormat::Text => "ascii",
        PlyFormat::Little => "binary_little_endian",
        PlyFormat::Big => "binary_big_endian",
    };
    let channels = colors.map_or("", |_| "property uchar red\nproperty uchar green\nproperty uchar blue\n");
    let mut bytes = format!(
        "ply\nformat {name} 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n{channels}\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.faces.len()
    )
    .into_bytes();
    for (i, v) in mesh.vertices.iter().enumerate() {
        let color = colors.map_or(&[][..], |c| &c[i][..]);
        match format {
            PlyFormat::Text => {
                let channels: String = color.iter().map(|c| format!(" {c}")).collect();
                bytes.extend(format!("{} {} {}{channels}\n", v.x, v.y, v.z).bytes());
            }
            PlyFormat::Little => v.iter().for_each(|c| bytes.extend(c.to_le_bytes())),
            PlyFormat::Big => v.iter().for_each(|c| bytes.extend(c.to_be_bytes())),
        }
        if format != PlyFormat::Text {
            bytes.extend(color);
        }
    }
    for f in &mesh.faces {
        match format {
            PlyFormat::Text => bytes.extend(format!("3 {} {} {}\n", f[0], f[1], f[2]).bytes()),
            PlyFormat::Little => bytes.extend(std::iter::once(3).chain(f.iter().flat_map(|v| v.to_le_bytes()))),
            PlyFormat::Big => bytes.extend(std::iter::once(3).chain(f.iter().flat_map(|v| v.to_be_bytes()))),
        }
    }
    Ok(write_atomic(path, &bytes)?)
}

/// The lines of an OBJ with the vertices of a mesh.
pub(crate) fn obj_vertices(mesh: &TriMesh, text: &mut String) {
    // Writing to a string cannot fail.
    for v in &mesh.vertices {
        let _ = writeln!(text, "v {} {} {}", v.x, v.y, v.z);
    }
}

pub(crate) fn obj_text(mesh: &TriMesh) -> String {
    let mut text = String::with_capacity(48 * (mesh.vertices.len() + mesh.faces.len()));
    obj_vertices(mesh, &mut text);
    for [a, b, c] in &mesh.faces {
        let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
    }
    text
}
