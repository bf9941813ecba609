//! Assets as binary glTF 2.0, for viewers.

use drex_core::{Pose, TriMesh};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::json;

/// A GLB with one node per mesh under a root that turns the world's +z to glTF's +y and carries `world_from_mesh`.
/// Positions are single precision; normals are the area-weighted means at the vertices.
pub(crate) fn glb(meshes: &[(&str, &TriMesh)], world_from_mesh: &Pose) -> Vec<u8> {
    let gltf_from_world = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let turned = gltf_from_world * world_from_mesh;
    let q = turned.rotation;
    let mut out = Builder::default();
    for (name, mesh) in meshes {
        out.add(name, mesh);
    }
    let children: Vec<usize> = (1..=meshes.len()).collect();
    let mut nodes = vec![json!({
        "name": "object",
        "rotation": [q.i, q.j, q.k, q.w],
        "translation": <[f64; 3]>::from(turned.translation.vector),
        "children": children,
    })];
    nodes.extend(meshes.iter().enumerate().map(|(i, (name, _))| json!({ "name": name, "mesh": i })));
    let header = json!({
        "asset": { "version": "2.0", "generator": "drex-mesh" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": nodes,
        "meshes": out.meshes,
        "materials": [{ "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.8, 0.8, 1.0], "metallicFactor": 0.0 } }],
        "accessors": out.accessors,
        "bufferViews": out.views,
        "buffers": [{ "byteLength": out.bytes.len() }],
    });
    framed(header.to_string().into_bytes(), out.bytes)
}

#[derive(Default)]
struct Builder {
    bytes: Vec<u8>,
    views: Vec<serde_json::Value>,
    accessors: Vec<serde_json::Value>,
    meshes: Vec<serde_json::Value>,
}

impl Builder {
    fn add(&mut self, name: &str, mesh: &TriMesh) {
        let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(|v| [v.x as f32, v.y as f32, v.z as f32]).collect();
        let bound = |pick: fn(f32, f32) -> f32| {
            positions.iter().copied().reduce(|a, b| [0, 1, 2].map(|k| pick(a[k], b[k]))).unwrap_or_default()
        };
        let (lo, hi) = (bound(f32::min), bound(f32::max));
        let position = self.vectors(&positions, json!({ "min": lo, "max": hi }));
        let normal = self.vectors(&normals(mesh), json!({}));
        let start = self.bytes.len();
        mesh.faces.iter().flatten().for_each(|v| self.bytes.extend(v.to_le_bytes()));
        let indices = self.accessor(start, 34963, 5125, 3 * mesh.faces.len(), "SCALAR", json!({}));
        self.meshes.push(json!({ "name": name, "primitives": [{
            "attributes": { "POSITION": position, "NORMAL": normal }, "indices": indices, "material": 0
        }] }));
    }

    fn vectors(&mut self, values: &[[f32; 3]], extra: serde_json::Value) -> usize {
        let start = self.bytes.len();
        values.iter().flatten().for_each(|v| self.bytes.extend(v.to_le_bytes()));
        self.accessor(start, 34962, 5126, values.len(), "VEC3", extra)
    }

    /// What has been written since `start` as a view and an accessor of its own; gives the accessor's number.
    fn accessor(
        &mut self,
        start: usize,
        target: u32,
        component: u32,
        count: usize,
        kind: &str,
        mut accessor: serde_json::Value,
    ) -> usize {
        self.views.push(json!({
            "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start, "target": target
        }));
        accessor["bufferView"] = (self.views.len() - 1).into();
        accessor["componentType"] = component.into();
        accessor["count"] = count.into();
        accessor["type"] = kind.into();
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

fn normals(mesh: &TriMesh) -> Vec<[f32; 3]> {
    let mut sums = vec![Vector3::zeros(); mesh.vertices.len()];
    for (f, corners) in mesh.faces.iter().enumerate() {
        let [a, b, c] = mesh.triangle(f);
        let area = (b - a).cross(&(c - a));
        corners.iter().for_each(|&v| sums[v as usize] += area);
    }
    sums.iter()
        .map(|n| n.try_normalize(0.0).unwrap_or_else(Vector3::z))
        .map(|n| [n.x as f32, n.y as f32, n.z as f32])
        .collect()
}

/// Header and chunks of a GLB, each padded to four bytes.
fn framed(mut json: Vec<u8>, mut bytes: Vec<u8>) -> Vec<u8> {
    json.resize(json.len().next_multiple_of(4), b' ');
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    let mut out = Vec::with_capacity(28 + json.len() + bytes.len());
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend((28 + json.len() as u32 + bytes.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", bytes)] {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    out
}
