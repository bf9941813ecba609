//! A picture on the visual mesh of an asset.

use std::collections::BTreeMap;
use std::fmt::Write;

use drex_core::TriMesh;

use crate::io::{Model, ModelPart, Texture, obj_vertices};
use crate::{Error, Result};

/// A picture, and where on it the faces of a mesh lie.
#[derive(Debug, Clone, PartialEq)]
pub struct TextureMap {
    /// Of each face the texture coordinates of its corners: u to the right, v down, both from 0 at the upper left corner to 1.
    pub uv: Vec<[[f32; 2]; 3]>,
    /// The picture, a PNG: MuJoCo reads no other kind.
    pub picture: Texture,
}

impl TextureMap {
    /// Whether it fits a mesh.
    ///
    /// # Errors
    /// If there are not as many entries as the mesh has faces, one is not finite, or the picture is no PNG.
    pub(super) fn check(&self, mesh: &TriMesh) -> Result<()> {
        if self.uv.len() != mesh.faces.len() {
            let what = format!("{} faces with texture coordinates for {}", self.uv.len(), mesh.faces.len());
            return Err(Error::value(what, "texture the repaired mesh, Asset::visual"));
        }
        if self.uv.iter().flatten().flatten().any(|c| !c.is_finite()) {
            return Err(Error::value("a texture coordinate is not finite", "give numbers from 0 to 1"));
        }
        if self.picture.mime != "image/png" {
            return Err(Error::value(format!("a texture of type {}", self.picture.mime), "give a PNG"));
        }
        Ok(())
    }

    /// An OBJ whose faces share vertices as the mesh does, whatever their texture coordinates; its material is `name` in `name.mtl`.
    pub(super) fn obj(&self, mesh: &TriMesh, name: &str) -> String {
        let mut text = format!("mtllib {name}.mtl\n");
        obj_vertices(mesh, &mut text);
        let (corners, uv) = self.split(mesh);
        // Writing to a string cannot fail.
        for [u, v] in uv {
            let _ = writeln!(text, "vt {u} {}", 1.0 - v);
        }
        let _ = writeln!(text, "usemtl {name}");
        for (face, split) in mesh.faces.iter().zip(corners) {
            let [a, b, c] = [0, 1, 2].map(|k| format!("{}/{}", face[k] + 1, split[k] + 1));
            let _ = writeln!(text, "f {a} {b} {c}");
        }
        text
    }

    /// The material library that goes with [`TextureMap::obj`]; the picture is `name.png`.
    pub(super) fn mtl(name: &str) -> String {
        format!("newmtl {name}\nKd 1 1 1\nd 1\nmap_Kd {name}.png\n")
    }

    /// Adds the mesh with the picture on it to a model.
    pub(super) fn add_to(&self, model: &mut Model, name: &str, mesh: &TriMesh) {
        let (faces, uv) = self.split(mesh);
        let mut vertices = vec![nalgebra::Point3::origin(); uv.len()];
        for (face, split) in mesh.faces.iter().zip(&faces) {
            (0..3).for_each(|k| vertices[split[k] as usize] = mesh.vertices[face[k] as usize]);
        }
        model.parts.push(ModelPart {
            name: name.to_owned(),
            mesh: TriMesh { vertices, faces },
            uv: Some(uv),
            material: Some(model.materials.len()),
            ..ModelPart::default()
        });
        model.materials.push(crate::Material {
            name: name.to_owned(),
            texture: Some(self.picture.clone()),
            ..crate::Material::default()
        });
    }

    /// The corners of each face among all that differ in vertex or texture coordinate, and the coordinates of those.
    fn split(&self, mesh: &TriMesh) -> (Vec<[u32; 3]>, Vec<[f32; 2]>) {
        let mut known: BTreeMap<(u32, [u32; 2]), u32> = BTreeMap::new();
        let mut all = Vec::new();
        let mut corner = |v: u32, uv: [f32; 2]| {
            *known.entry((v, uv.map(f32::to_bits))).or_insert_with(|| {
                all.push(uv);
                all.len() as u32 - 1
            })
        };
        let faces =
            mesh.faces.iter().zip(&self.uv).map(|(face, uv)| [0, 1, 2].map(|k| corner(face[k], uv[k]))).collect();
        (faces, all)
    }
}
