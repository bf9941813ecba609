//! glTF 2.0 and GLB: the triangles of the default scene, node transforms applied.

use std::path::Path;

use base64::Engine;
use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::Source;
use nalgebra::{Matrix4, Point3};

use drex_core::TriMesh;
use drex_core::fsutil::read_bytes;

use crate::{Error, Result};

/// Nodes nested deeper than this are a loop.
const DEEPEST: usize = 128;

pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<TriMesh> {
    // The validation of the glTF library indexes out of bounds on some damaged files.
    std::panic::catch_unwind(|| read(path, bytes)).unwrap_or_else(|_| {
        Err(bad(
            path,
            "the glTF refers to something that is not there",
            "check it with the glTF validator or export it again",
        ))
    })
}

fn read(path: &Path, bytes: &[u8]) -> Result<TriMesh> {
    // A GLB header whose lengths contradict the file would make the parser subtract below zero.
    let word = |at: usize| bytes.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    if bytes.starts_with(b"glTF") && (word(8) > bytes.len() || word(8) < 20 || word(12) > word(8) - 20) {
        return Err(bad(path, "the binary header names more bytes than there are", "check that the file is complete"));
    }
    let file = gltf::Gltf::from_slice(bytes)
        .map_err(|e| bad(path, format!("no valid glTF: {e}"), "check it with the glTF validator or export it again"))?;
    let mut reader = Reader { path, buffers: buffers(path, &file)?, mesh: TriMesh::default() };
    let scene = file.default_scene().or_else(|| file.scenes().next());
    match scene {
        Some(scene) => scene.nodes().try_for_each(|n| reader.node(&n, &Matrix4::identity(), 0))?,
        None => file.meshes().try_for_each(|m| reader.primitives(&m, &Matrix4::identity()))?,
    }
    Ok(reader.mesh)
}

fn buffers(path: &Path, file: &gltf::Gltf) -> Result<Vec<Vec<u8>>> {
    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    file.buffers()
        .map(|buffer| {
            let data = match buffer.source() {
                Source::Bin => file.blob.clone().unwrap_or_default(),
                Source::Uri(uri) => match uri.strip_prefix("data:") {
                    Some(data) => {
                        let text = data.split_once(";base64,").map_or("", |(_, t)| t);
                        base64::engine::general_purpose::STANDARD.decode(text).map_err(|e| {
                            bad(path, format!("buffer {}: no base64 ({e})", buffer.index()), "export it again")
                        })?
                    }
                    None => read_bytes(&folder.join(percent_decoded(uri)))?,
                },
            };
            if data.len() < buffer.length() {
                let what = format!("buffer {} has {} bytes, not {}", buffer.index(), data.len(), buffer.length());
                return Err(bad(path, what, "check that the file and its buffers are complete"));
            }
            Ok(data)
        })
        .collect()
}

/// `%20` and the like in the name of a file.
fn percent_decoded(uri: &str) -> String {
    let mut out = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let Some((&first, tail)) = rest.split_first() {
        let code = tail.get(..2).and_then(|h| std::str::from_utf8(h).ok()).and_then(|h| u8::from_str_radix(h, 16).ok());
        match (first, code) {
            (b'%', Some(byte)) => {
                out.push(byte);
                rest = &tail[2..];
            }
            _ => {
                out.push(first);
                rest = tail;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

struct Reader<'a> {
    path: &'a Path,
    buffers: Vec<Vec<u8>>,
    mesh: TriMesh,
}

impl Reader<'_> {
    fn node(&mut self, node: &gltf::Node<'_>, scene_from_parent: &Matrix4<f64>, depth: usize) -> Result<()> {
        if depth > DEEPEST {
            return Err(bad(self.path, format!("node {} is nested in itself", node.index()), "export the file again"));
        }
        let scene_from_node = scene_from_parent * local_transform(node);
        if let Some(mesh) = node.mesh() {
            self.primitives(&mesh, &scene_from_node)?;
        }
        node.children().try_for_each(|child| self.node(&child, &scene_from_node, depth + 1))
    }

    fn primitives(&mut self, mesh: &gltf::Mesh<'_>, scene_from_node: &Matrix4<f64>) -> Result<()> {
        // A mirror turns the winding round.
        let mirrored = scene_from_node.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
        for primitive in mesh.primitives() {
            let place = format!("mesh {}, primitive {}", mesh.index(), primitive.index());
            let Some(positions) = primitive.get(&gltf::Semantic::Positions) else { continue };
            let base = self.mesh.vertices.len() as u32;
            let rows = self.rows(&positions, &place)?;
            for row in rows.chunks_exact(3) {
                let p = scene_from_node.transform_point(&Point3::new(row[0], row[1], row[2]));
                if p.iter().any(|c| !c.is_finite()) {
                    let n = self.mesh.vertices.len() as u32 - base;
                    return Err(bad(self.path, format!("{place}: vertex {n} is not finite"), "export the file again"));
                }
                self.mesh.vertices.push(p);
            }
            let count = self.mesh.vertices.len() as u32 - base;
            let indices: Vec<u32> = match primitive.indices() {
                Some(accessor) => self.rows(&accessor, &place)?.iter().map(|&i| i as u32).collect(),
                None => (0..count).collect(),
            };
            if let Some(i) = indices.iter().find(|&&i| i >= count) {
                let what = format!("{place}: index {i} is beyond its {count} vertices");
                return Err(bad(self.path, what, "export the file again"));
            }
            for [a, b, c] in triangles(primitive.mode(), &indices) {
                let f = if mirrored { [a, c, b] } else { [a, b, c] };
                self.mesh.faces.push(f.map(|v| base + v));
            }
        }
        Ok(())
    }

    /// All numbers of an accessor, row after row.
    fn rows(&self, accessor: &gltf::Accessor<'_>, place: &str) -> Result<Vec<f64>> {
        let refuse = |what: &str| {
            let what = format!("{place}: accessor {} {what}", accessor.index());
            Err(bad(self.path, what, "export the file again without compression or sparse data"))
        };
        let columns = match accessor.dimensions() {
            Dimensions::Scalar => 1,
            Dimensions::Vec3 => 3,
            _ => return refuse("is neither a list of indices nor of points"),
        };
        let (size, signed_integer) = match accessor.data_type() {
            DataType::F32 => (4, false),
            DataType::U8 => (1, false),
            DataType::U16 => (2, false),
            DataType::U32 => (4, false),
            DataType::I8 => (1, true),
            DataType::I16 => (2, true),
        };
        let Some(view) = accessor.view().filter(|_| accessor.sparse().is_none()) else {
            return refuse("is sparse or has no data");
        };
        if signed_integer || (columns == 3 && accessor.data_type() != DataType::F32) {
            return refuse("is compressed to integers");
        }
        let row = columns * size;
        let stride = view.stride().unwrap_or(row);
        let start = view.offset().checked_add(accessor.offset());
        let end = accessor
            .count()
            .checked_sub(1)
            .map_or(Some(0), |n| n.checked_mul(stride).and_then(|n| n.checked_add(row)))
            .zip(start)
            .and_then(|(length, start)| start.checked_add(length));
        let (Some(start), Some(end)) = (start, end) else { return refuse("reaches beyond its buffer") };
        let Some(data) = self.buffers.get(view.buffer().index()).and_then(|b| b.get(start..end)) else {
            return refuse("reaches beyond its buffer");
        };
        let mut out = Vec::with_capacity(accessor.count() * columns);
        for i in 0..accessor.count() {
            for k in 0..columns {
                let at = i * stride + k * size;
                let b = &data[at..at + size];
                out.push(match accessor.data_type() {
                    DataType::U8 => f64::from(b[0]),
                    DataType::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
                    DataType::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                    _ => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                });
            }
        }
        Ok(out)
    }
}

fn local_transform(node: &gltf::Node<'_>) -> Matrix4<f64> {
    match node.transform() {
        // Columns, as glTF stores them.
        gltf::scene::Transform::Matrix { matrix } => {
            Matrix4::from_iterator(matrix.iter().flatten().map(|&c| f64::from(c)))
        }
        gltf::scene::Transform::Decomposed { translation, rotation, scale } => {
            let [x, y, z, w] = rotation.map(f64::from);
            let q = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
            Matrix4::new_translation(&translation.map(f64::from).into())
                * q.to_homogeneous()
                * Matrix4::new_nonuniform_scaling(&scale.map(f64::from).into())
        }
    }
}

fn triangles(mode: gltf::mesh::Mode, i: &[u32]) -> Vec<[u32; 3]> {
    use gltf::mesh::Mode;
    match mode {
        Mode::Triangles => i.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        Mode::TriangleStrip => i
            .windows(3)
            .enumerate()
            .map(|(k, t)| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] })
            .collect(),
        Mode::TriangleFan => i.windows(2).skip(1).map(|t| [i[0], t[0], t[1]]).collect(),
        // Points and lines bound nothing.
        _ => Vec::new(),
    }
}

fn bad(path: &Path, what: impl Into<String>, remedy: impl Into<String>) -> Error {
    drex_core::Error::content(path, None, what, remedy).into()
}
