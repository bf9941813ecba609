//! Mesh files in and out.

mod glb;
mod gltf;
mod model;
mod obj;
mod ply;
mod write;

use std::path::Path;

use drex_core::TriMesh;
use drex_core::fsutil::read_bytes;

pub(crate) use glb::glb_bytes;
pub use glb::write_glb;
pub use model::{Material, Model, ModelPart, Texture};
pub use obj::write_obj_model;
pub use write::{PlyFormat, write_mesh, write_obj, write_ply, write_ply_as, write_stl, write_stl_text};
pub(crate) use write::{obj_text, obj_vertices};

use crate::{Error, Result};

/// Reads a mesh; the extension says the format (`.stl`, `.obj`, `.ply`, `.gltf`, `.glb`, in any case).
///
/// Faces with more corners become triangles ([`drex_core::mesh::polygon_triangles`]). Coordinates come as the file has them, in the file's unit and axes
/// (glTF: metres, +Y up, node transforms of the default scene applied). Looks are left
/// to [`read_model`].
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
        "stl" => {
            refuse_cut_text(path, bytes)?;
            drex_core::mesh::parse_stl(path, bytes)?
        }
        "obj" => drex_core::mesh::parse_obj(path, bytes)?,
        "ply" => ply::parse(path, bytes)?.0,
        "gltf" | "glb" => gltf::parse(path, bytes)?.mesh(),
        other => return Err(Error::UnknownExtension { path: path.to_path_buf(), extension: other.to_string() }),
    };
    if mesh.faces.is_empty() {
        return Err(Error::Empty { subject: path.display().to_string() });
    }
    TriMesh::new(mesh.vertices, mesh.faces).map_err(|e| Error::from(e).about(path))
}

/// Reads a file with its looks: OBJ (mtllib, usemtl, vt, colours behind the vertices), glTF and GLB (TEXCOORD_0, COLOR_0, base
/// colour and its texture), PLY (vertex colours), STL (none). Coordinates are as in [`read_mesh`].
///
/// A material library or picture that is not there is left out with a warning in the log: the shape is still good.
///
/// # Errors
/// As [`read_mesh`]; if the file names another file outside its own folder.
pub fn read_model(path: &Path) -> Result<Model> {
    let extension = extension(path);
    let model = match extension.as_str() {
        "obj" => obj::parse(path, &read_bytes(path)?)?,
        "ply" => {
            let (mesh, colors) = ply::parse(path, &read_bytes(path)?)?;
            Model { parts: vec![ModelPart { mesh, colors, ..ModelPart::default() }], materials: Vec::new() }
        }
        "gltf" | "glb" => gltf::parse(path, &read_bytes(path)?)?,
        "stl" => Model::plain(parse_mesh(path, &read_bytes(path)?)?),
        _ => return Err(Error::UnknownExtension { path: path.to_path_buf(), extension }),
    };
    model.check().map_err(|e| e.about(path))?;
    Ok(model)
}

/// A text STL that stops between two triangles can be told by its missing last line alone.
fn refuse_cut_text(path: &Path, bytes: &[u8]) -> Result<()> {
    let count = bytes.get(80..84).and_then(|b| b.try_into().ok()).map_or(0, u32::from_le_bytes);
    let binary = bytes.len() as u64 == 84 + 50 * u64::from(count);
    let text = !binary && bytes.trim_ascii_start().starts_with(b"solid") && bytes.is_ascii();
    let tail = &bytes[bytes.len().saturating_sub(1024)..];
    if text && !tail.windows(8).any(|w| w.eq_ignore_ascii_case(b"endsolid")) {
        let line = bytes.iter().filter(|&&b| b == b'\n').count() + 1;
        let what = "the file ends without \"endsolid\"";
        return Err(drex_core::Error::content(path, line, what, "check that the file is complete").into());
    }
    Ok(())
}

pub(crate) fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}
