//! Meshes and materials that geoms refer to by name.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use drex_core::TriMesh;
use drex_core::mesh::convex_hull;
use nalgebra::{Point3, Quaternion, Unit, UnitQuaternion, Vector3};

use crate::model::Shape;
use crate::unsupported::Unsupported;
use crate::xml::Node;
use crate::{Result, meshfile};

use super::compiler::Compiler;
use super::defaults::Defaults;

/// How a mesh's mass is spread.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Solid {
    /// Over the solid that it bounds.
    Bounded,
    /// Over its convex hull.
    Hull,
}

#[derive(Debug)]
struct MeshAsset {
    node: Node,
    source: Source,
    scale: Vector3<f64>,
    reference: (Vector3<f64>, UnitQuaternion<f64>),
    solid: Solid,
    loaded: Option<Arc<TriMesh>>,
}

#[derive(Debug)]
enum Source {
    File(PathBuf),
    Inline(TriMesh),
    Missing(String),
}

/// Everything that geoms can name.
#[derive(Debug, Default)]
pub(super) struct Assets {
    meshes: BTreeMap<String, MeshAsset>,
    materials: BTreeMap<String, [f32; 4]>,
}

impl Assets {
    pub fn read(
        root: &Node,
        defaults: &Defaults,
        compiler: &Compiler,
        folder: Option<&Path>,
        unsupported: &mut Unsupported,
    ) -> Result<Self> {
        let mut assets = Self::default();
        for node in root.children_called("asset").flat_map(|a| &a.children) {
            match node.tag.as_str() {
                "mesh" => assets.read_mesh(node, defaults, compiler, folder)?,
                "material" => {
                    let a = defaults.resolve(node, None)?;
                    let name = node.require("name")?.to_owned();
                    if let Some(c) = a.numbers("rgba", 4..=4)? {
                        assets.materials.insert(name, [0, 1, 2, 3].map(|k| c[k] as f32));
                    }
                }
                "texture" => {}
                _ => unsupported.element(node),
            }
        }
        Ok(assets)
    }

    fn read_mesh(
        &mut self,
        node: &Node,
        defaults: &Defaults,
        compiler: &Compiler,
        folder: Option<&Path>,
    ) -> Result<()> {
        let a = defaults.resolve(node, None)?;
        let source = if let Some(file) = node.get("file") {
            let file = Path::new(file);
            let file = if compiler.strip_path { file.file_name().map_or(file, Path::new) } else { file };
            match folder {
                Some(folder) => Source::File(folder.join(&compiler.mesh_folder).join(file)),
                None => Source::Missing("text that came without a folder cannot name mesh files".into()),
            }
        } else if node.get("vertex").is_some() {
            inline_mesh(node)?
                .map_or_else(|| Source::Missing("a mesh of bare vertices has no volume".into()), Source::Inline)
        } else {
            Source::Missing("the mesh has neither file nor vertices".into())
        };
        let stem = || node.get("file").and_then(|f| Path::new(f).file_stem()).map(|s| s.to_string_lossy().into_owned());
        let Some(name) = node.get("name").map(str::to_owned).or_else(stem) else {
            return Err(node.error("the mesh has neither name nor file", "name it"));
        };
        if self.meshes.contains_key(&name) {
            return Err(node.error(format!("there are two meshes \"{name}\""), "names of meshes are unique"));
        }
        let reference_rotation = match a.numbers("refquat", 4..=4)? {
            Some(q) => Unit::try_new(Quaternion::new(q[0], q[1], q[2], q[3]), 1e-12)
                .ok_or_else(|| a.fault("refquat", "a quaternion of length zero", "give a unit quaternion"))?,
            None => UnitQuaternion::identity(),
        };
        let asset = MeshAsset {
            source,
            scale: a.vector("scale")?.unwrap_or_else(|| Vector3::repeat(1.0)),
            reference: (a.vector("refpos")?.unwrap_or_default(), reference_rotation),
            solid: if a.get("inertia") == Some("convex") { Solid::Hull } else { Solid::Bounded },
            loaded: None,
            node: node.clone(),
        };
        self.meshes.insert(name, asset);
        Ok(())
    }

    /// Colour of a material.
    pub fn material(&self, name: &str) -> Option<[f32; 4]> {
        self.materials.get(name).copied()
    }

    /// The mesh called `name`: in its file's frame, moved to its reference pose, scaled. Read once.
    pub fn mesh(&mut self, geom: &Node, name: &str) -> Result<Arc<TriMesh>> {
        let Some(asset) = self.meshes.get_mut(name) else {
            return Err(geom.fault("mesh", format!("there is no mesh \"{name}\""), "add it to <asset>"));
        };
        if let Some(mesh) = &asset.loaded {
            return Ok(mesh.clone());
        }
        let mesh = match &asset.source {
            Source::Missing(why) => {
                return Err(asset.node.error(why.clone(), "load the model from a file, or use a primitive shape"));
            }
            Source::Inline(mesh) => mesh.clone(),
            Source::File(path) => TriMesh::read(path)
                .map_err(|e| asset.node.fault("file", e.to_string(), "repair or replace the file"))?,
        };
        let (shift, rotation) = asset.reference;
        let moved = TriMesh {
            vertices: mesh
                .vertices
                .iter()
                .map(|v| Point3::from(rotation.inverse_transform_vector(&(v.coords - shift))))
                .collect(),
            faces: mesh.faces,
        };
        let mesh = meshfile::scaled(moved, &asset.scale);
        if mesh.vertices.iter().any(|v| v.iter().any(|c| !c.is_finite())) {
            return Err(asset.node.error("the scaled mesh is not finite", "repair the scale"));
        }
        let mesh = Arc::new(mesh);
        asset.loaded = Some(mesh.clone());
        Ok(mesh)
    }

    /// The shape whose mass properties the mesh called `name` has.
    pub fn solid_of(&self, name: &str, shape: &Shape) -> Shape {
        let wants_hull = self.meshes.get(name).is_some_and(|m| m.solid == Solid::Hull);
        match shape {
            Shape::Mesh(mesh) if wants_hull => {
                convex_hull(&mesh.vertices).map_or_else(|_| shape.clone(), |h| Shape::Mesh(Arc::new(h)))
            }
            _ => shape.clone(),
        }
    }
}

/// A mesh written into the file itself; without faces its convex hull, `None` if that is flat.
fn inline_mesh(node: &Node) -> Result<Option<TriMesh>> {
    let a = node.with_defaults(None);
    let v = a.numbers("vertex", 0..=usize::MAX)?.unwrap_or_default();
    let f = a.numbers("face", 0..=usize::MAX)?.unwrap_or_default();
    if v.len() % 3 != 0 {
        return Err(node.fault("vertex", "the numbers do not make triples", "give three numbers per vertex"));
    }
    if f.len() % 3 != 0 || f.iter().any(|i| *i < 0.0 || i.fract() != 0.0 || *i >= (v.len() / 3) as f64) {
        return Err(node.fault("face", "not triples of vertex numbers", "count vertices from 0"));
    }
    let vertices = v.chunks_exact(3).map(|c| Point3::new(c[0], c[1], c[2])).collect();
    let faces: Vec<[u32; 3]> = f.chunks_exact(3).map(|c| [c[0] as u32, c[1] as u32, c[2] as u32]).collect();
    let mesh = TriMesh { vertices, faces };
    Ok(if mesh.faces.is_empty() { convex_hull(&mesh.vertices).ok() } else { Some(mesh) })
}
