//! What a renderer needs of a file: parts with texture coordinates and colours, materials, textures.

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use drex_core::TriMesh;
use drex_core::fsutil::read_bytes;

use crate::{Error, Result};

/// Surfaces with their looks.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Model {
    /// The surfaces; one material each.
    pub parts: Vec<ModelPart>,
    /// The materials that the parts name by position.
    pub materials: Vec<Material>,
}

/// One surface of a [`Model`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ModelPart {
    /// Name of the object or group, empty if the file has none.
    pub name: String,
    /// The surface in the frame of the file. Corners that differ in texture coordinate are separate vertices.
    pub mesh: TriMesh,
    /// Texture coordinate per vertex: u to the right, v down from the upper left corner of the picture (as in glTF; OBJ counts
    /// v upwards and is turned round when read and written).
    pub uv: Option<Vec<[f32; 2]>>,
    /// Colour per vertex, sRGB.
    pub colors: Option<Vec<[u8; 3]>>,
    /// Position in [`Model::materials`].
    pub material: Option<usize>,
}

/// How a surface looks.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Its name in the file.
    pub name: String,
    /// Red, green, blue and opacity, 0 to 1; multiplies the texture.
    pub base_color: [f32; 4],
    /// The picture on it.
    pub texture: Option<Texture>,
}

impl Default for Material {
    fn default() -> Self {
        Self { name: String::new(), base_color: [1.0; 4], texture: None }
    }
}

/// A picture file in memory, not decoded.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// The bytes of the file; materials with the same picture share them.
    pub bytes: Arc<[u8]>,
    /// `image/png`, `image/jpeg` or what the file calls it.
    pub mime: String,
}

impl Texture {
    /// A picture whose type is told by its first bytes.
    pub fn new(bytes: impl Into<Arc<[u8]>>) -> Self {
        let bytes = bytes.into();
        let mime = match &bytes[..] {
            [0x89, b'P', b'N', b'G', ..] => "image/png",
            [0xff, 0xd8, 0xff, ..] => "image/jpeg",
            [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => "image/webp",
            _ => "application/octet-stream",
        };
        Self { bytes, mime: mime.into() }
    }

    /// The ending of a file with this picture.
    pub(super) fn extension(&self) -> &'static str {
        match self.mime.as_str() {
            "image/png" => "png",
            "image/jpeg" => "jpg",
            "image/webp" => "webp",
            _ => "bin",
        }
    }
}

impl Model {
    /// A surface without looks.
    pub fn plain(mesh: TriMesh) -> Self {
        Self { parts: vec![ModelPart { mesh, ..ModelPart::default() }], materials: Vec::new() }
    }

    /// All parts as one mesh; vertices are not merged.
    pub fn mesh(&self) -> TriMesh {
        let mut out = TriMesh::default();
        for part in &self.parts {
            out.append(&part.mesh);
        }
        out
    }

    /// Checks what a writer relies on.
    ///
    /// # Errors
    /// If there is no triangle, a face or a material is out of range, a coordinate is not finite, or a list does not have an
    /// entry per vertex.
    pub fn check(&self) -> Result<()> {
        if self.parts.iter().all(|p| p.mesh.faces.is_empty()) {
            return Err(Error::Empty { subject: "the model".into() });
        }
        for (i, part) in self.parts.iter().enumerate() {
            let refuse = |what: String| {
                Err(Error::value(format!("part {i} ({:?}): {what}", part.name), "give one entry per vertex"))
            };
            TriMesh::new(part.mesh.vertices.clone(), part.mesh.faces.clone())?;
            let n = part.mesh.vertices.len();
            match (&part.uv, &part.colors) {
                (Some(uv), _) if uv.len() != n => {
                    return refuse(format!("{} texture coordinates for {n} vertices", uv.len()));
                }
                (Some(uv), _) if uv.iter().flatten().any(|c| !c.is_finite()) => {
                    return refuse("a texture coordinate is not finite".into());
                }
                (_, Some(colors)) if colors.len() != n => {
                    return refuse(format!("{} colours for {n} vertices", colors.len()));
                }
                _ => {}
            }
            if part.material.is_some_and(|m| m >= self.materials.len()) {
                return refuse(format!("its material is not one of the {} there are", self.materials.len()));
            }
        }
        Ok(())
    }
}

/// The place of a file that `path` refers to by `name`.
///
/// # Errors
/// If that would be outside the folder of `path`.
pub(super) fn beside(path: &Path, name: &str) -> Result<PathBuf> {
    // Files from Windows have its separators.
    let name = name.trim().replace('\\', "/");
    let relative = Path::new(&name);
    let inside = relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    // A drive letter is an ordinary name elsewhere.
    if !inside || name.contains(':') || name.is_empty() {
        let what = format!("it refers to {name:?}, which is not inside its folder");
        return Err(drex_core::Error::content(path, None, what, "copy that file beside it and name it alone").into());
    }
    Ok(path.parent().unwrap_or_else(|| Path::new("")).join(relative))
}

/// A picture beside `path`, or a warning.
pub(super) fn picture(path: &Path, name: &str) -> Result<Option<Texture>> {
    match read_bytes(&beside(path, name)?) {
        Ok(bytes) => Ok(Some(Texture::new(bytes))),
        Err(e) => {
            tracing::warn!("{}: the picture {name:?} is left out: {e}", path.display());
            Ok(None)
        }
    }
}
