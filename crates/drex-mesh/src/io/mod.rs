//! Mesh files in and out.

mod gltf;
mod ply;
mod write;

use std::path::Path;

use drex_core::TriMesh;
use drex_core::fsutil::read_bytes;

pub(crate) use write::obj_text;
pub use write::{write_obj, write_ply, write_stl};

use crate::{Error, Result};

/// Reads a mesh; the extension says the format (`.stl`, `.obj`, `.ply`, `.gltf`, `.glb`, in any case).
///
/// Faces with more than three corners become fans. Coordinates come as the file has them, in the file's unit and axes
/// (glTF: metres, +Y up, node transforms of the default scene applied). Normals, colours and textures are not read.
///
/// # Errors
/// If the extension is unknown, the file cannot be read, is damaged or cut off, has no triangles, or a vertex is
/// not finite; the message names the file and, in text files, the line.
pub fn read_mesh(path: &Path) -> Result<TriMesh> {
    let extension = extension(path);
    if !matches!(extension.as_str(), "stl" | "obj" | "ply" | "gltf" | "glb") {
        return Err(Error::UnknownExtension { path: path.to_path_buf(), extension });
    }
    parse_mesh(path, &read_bytes(path)?)
}

/// Reads a mesh from bytes that were in `path`; the path gives the format, the name in messages, and the folder in
/// which a `.gltf` file's buffers lie.
///
/// # Errors
/// See [`read_mesh`].
pub fn parse_mesh(path: &Path, bytes: &[u8]) -> Result<TriMesh> {
    let mesh = match extension(path).as_str() {
        "stl" => drex_core::mesh::parse_stl(path, bytes)?,
        "obj" => drex_core::mesh::parse_obj(path, bytes)?,
        "ply" => ply::parse(path, bytes)?,
        "gltf" | "glb" => gltf::parse(path, bytes)?,
        other => return Err(Error::UnknownExtension { path: path.to_path_buf(), extension: other.to_string() }),
    };
    if mesh.faces.is_empty() {
        return Err(Error::Empty { subject: path.display().to_string() });
    }
    TriMesh::new(mesh.vertices, mesh.faces).map_err(|e| Error::from(e).about(path))
}

pub(crate) fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}
