//! GLB out.

use std::path::Path;

use drex_core::fsutil::write_atomic;
use serde_json::{Value, json};

use super::model::{Model, ModelPart};
use crate::{Error, Result};

/// Writes a binary glTF 2.0 file: one node, mesh and primitive per part, positions and indices, TEXCOORD_0 and COLOR_0 where there
/// are any, base colours and their pictures inside the file.
///
/// Coordinates go in as they are, in single precision. Viewers take +Y as up and metres as unit.
///
/// # Errors
/// If the model is not consistent ([`Model::check`]), is larger than the 4 GiB of the format, or the file cannot be written.
pub fn write_glb(path: &Path, model: &Model) -> Result<()> {
    Ok(write_atomic(path, &glb_bytes(model)?)?)
}

pub(crate) fn glb_bytes(model: &Model) -> Result<Vec<u8>> {
    model.check()?;
    let mut out = Buffer::default();
    let (mut meshes, mut nodes) = (Vec::new(), Vec::new());
    for part in model.parts.iter().filter(|p| !p.mesh.faces.is_empty()) {
        let mut node = json!({ "mesh": meshes.len() });
        let mut mesh = json!({ "primitives": [primitive(&mut out, part)] });
        if !part.name.is_empty() {
            node["name"] = json!(part.name);
            mesh["name"] = json!(part.name);
        }
        nodes.push(node);
        meshes.push(mesh);
    }
    let (mut materials, mut textures, mut images) = (Vec::new(), Vec::new(), Vec::new());
    for m in &model.materials {
        let mut surface = json!({ "baseColorFactor": m.base_color.map(|c| c.clamp(0.0, 1.0)), "metallicFactor": 0.0 });
        if let Some(texture) = &m.texture {
            surface["baseColorTexture"] = json!({ "index": textures.len() });
            textures.push(json!({ "source": images.len() }));
            images.push(json!({ "bufferView": out.view(&texture.bytes, None), "mimeType": texture.mime }));
        }
        let mode = if m.base_color[3] < 1.0 { "BLEND" } else { "OPAQUE" };
        materials.push(json!({ "name": m.name, "pbrMetallicRoughness": surface, "alphaMode": mode }));
    }
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "drex-mesh" },
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": meshes,
        "accessors": out.accessors,
        "bufferViews": out.views,
        "buffers": [{ "byteLength": out.bytes.len() }],
    });
    // glTF allows no empty lists.
    for (key, list) in [("materials", materials), ("textures", textures), ("images", images)] {
        if !list.is_empty() {
            root[key] = Value::Array(list);
        }
    }
    framed(&root, &out.bytes)
}

#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

const ARRAY: u32 = 34962;
const INDICES: u32 = 34963;

impl Buffer {
    /// Appends bytes; the position of their view.
    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], target: u32, count: usize, mut about: Value) -> usize {
        about["bufferView"] = json!(self.view(bytes, Some(target)));
        about["count"] = json!(count);
        self.accessors.push(about);
        self.accessors.len() - 1
    }
}

fn primitive(out: &mut Buffer, part: &ModelPart) -> Value {
    const FLOAT: u32 = 5126;
    let n = part.mesh.vertices.len();
    let points: Vec<[f32; 3]> = part.mesh.vertices.iter().map(|v| [v.x as f32, v.y as f32, v.z as f32]).collect();
    let bound = |k: usize, pick: fn(f32, f32) -> f32| points.iter().map(|p| p[k]).reduce(pick).unwrap_or(0.0);
    let (lo, hi) = ([0, 1, 2].map(|k| bound(k, f32::min)), [0, 1, 2].map(|k| bound(k, f32::max)));
    let about = json!({ "componentType": FLOAT, "type": "VEC3", "min": lo, "max": hi });
    let floats = |values: &mut dyn Iterator<Item = f32>| values.flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    let position = out.accessor(&floats(&mut points.iter().flatten().copied()), ARRAY, n, about);
    let mut attributes = json!({ "POSITION": position });
    if let Some(uv) = &part.uv {
        let about = json!({ "componentType": FLOAT, "type": "VEC2" });
        attributes["TEXCOORD_0"] = json!(out.accessor(&floats(&mut uv.iter().flatten().copied()), ARRAY, n, about));
    }
    if let Some(colors) = &part.colors {
        // Vertex colours of glTF are linear; bytes would lose the dark ones, and some readers cut 16 bits short.
        let mut values = colors.iter().flatten().map(|&c| linear(f32::from(c) / 255.0));
        let about = json!({ "componentType": FLOAT, "type": "VEC3" });
        attributes["COLOR_0"] = json!(out.accessor(&floats(&mut values), ARRAY, n, about));
    }
    let indices: Vec<u8> = part.mesh.faces.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let about = json!({ "componentType": 5125, "type": "SCALAR" });
    let indices = out.accessor(&indices, INDICES, 3 * part.mesh.faces.len(), about);
    let mut primitive = json!({ "attributes": attributes, "indices": indices });
    if let Some(m) = part.material {
        primitive["material"] = json!(m);
    }
    primitive
}

/// sRGB to linear (IEC 61966-2-1).
fn linear(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Linear to sRGB.
pub(super) fn srgb(c: f32) -> f32 {
    if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

/// Header and two chunks.
fn framed(root: &Value, binary: &[u8]) -> Result<Vec<u8>> {
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let Ok(length) = u32::try_from(total) else {
        return Err(Error::value(format!("{total} bytes are too many for a GLB"), "decimate the mesh first"));
    };
    let mut out = Vec::with_capacity(total);
    out.extend(b"glTF");
    for word in [2, length, text.len() as u32] {
        out.extend(word.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(text);
    out.extend((binary.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(binary);
    Ok(out)
}
