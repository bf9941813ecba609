//! glTF 2.0 and GLB: the triangles of the default scene, node transforms applied, with their looks.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use base64::Engine;
use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::Source;
use nalgebra::{Matrix4, Point3};

use drex_core::budget;
use drex_core::fsutil::read_bytes;

use super::glb::srgb;
use super::model::{Material, Model, ModelPart, Texture, beside, picture};
use crate::{Error, Result};

/// Nodes nested deeper than this are refused: a scene does not need it, the stack would end.
const DEEPEST: usize = 128;
/// Memory of one JSON object (a node, an accessor, a material), bytes; the largest are a little smaller.
const OBJECT_BYTES: u64 = 512;
/// Memory of one number of an accessor, bytes: as read, in a part of the model, and in the mesh made of all parts.
const NUMBER_BYTES: u64 = 24;

pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Model> {
    // A GLB header whose lengths contradict the file would make the parser subtract below zero.
    let word = |at: usize| bytes.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    if bytes.starts_with(b"glTF") && (word(8) > bytes.len() || word(8) < 20 || word(12) > word(8) - 20) {
        return Err(bad(path, "the binary header names more bytes than there are", "check that the file is complete"));
    }
    let json = if bytes.starts_with(b"glTF") { bytes.get(20..20 + word(12)).unwrap_or_default() } else { bytes };
    let objects = json.iter().filter(|&&b| b == b'{').count() as u64;
    budget::allow(path, format_args!("{objects} objects"), objects * OBJECT_BYTES)?;
    let remedy = "check it with the glTF validator or export it again";
    let invalid = |e: gltf::Error| bad(path, format!("no valid glTF: {e}"), remedy);
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice_without_validation(bytes).map_err(invalid)?;
    let root = document.into_json();
    // The library's validation takes it for granted that the accessors of attributes are there, and its images that they say
    // where they are.
    for (i, mesh) in root.meshes.iter().enumerate() {
        let accessors = mesh.primitives.iter().flat_map(|p| p.attributes.values());
        if let Some(wrong) = accessors.map(|a| a.value()).find(|&a| a >= root.accessors.len()) {
            let what = format!("mesh {i} refers to accessor {wrong}, there are {}", root.accessors.len());
            return Err(bad(path, what, remedy));
        }
    }
    let placed = |i: &gltf::json::Image| if i.buffer_view.is_some() { i.mime_type.is_some() } else { i.uri.is_some() };
    if let Some(i) = root.images.iter().position(|image| !placed(image)) {
        return Err(bad(path, format!("image {i} has neither a file nor bytes with their type"), remedy));
    }
    let document = gltf::Document::from_json(root).map_err(invalid)?;
    let file = gltf::Gltf { document, blob };
    let mut reader = Reader {
        path,
        buffers: Vec::new(),
        images: BTreeMap::new(),
        visited: vec![false; file.nodes().len()],
        taken: 0,
        model: Model::default(),
    };
    for buffer in file.buffers() {
        let data = reader.buffer(&buffer, file.blob.as_deref())?;
        reader.buffers.push(data);
    }
    reader.model.materials = file.materials().map(|m| reader.material(&m)).collect::<Result<_>>()?;
    let scene = file.default_scene().or_else(|| file.scenes().next());
    match scene {
        Some(scene) => scene.nodes().try_for_each(|n| reader.node(&n, &Matrix4::identity(), 0))?,
        None => file.meshes().try_for_each(|m| reader.primitives(&m, m.name(), &Matrix4::identity()))?,
    }
    Ok(reader.model)
}

/// The bytes of a `data:` URI.
fn embedded(uri: &str) -> Option<Result<Vec<u8>, base64::DecodeError>> {
    let text = uri.strip_prefix("data:")?.split_once(";base64,").map_or("", |(_, t)| t);
    Some(base64::engine::general_purpose::STANDARD.decode(text))
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
    buffers: Vec<Cow<'a, [u8]>>,
    /// Pictures by their position in the file; materials share them.
    images: BTreeMap<usize, Option<Texture>>,
    /// Nodes already met: in a tree each has one parent.
    visited: Vec<bool>,
    /// Memory taken so far, bytes: a few bytes can name the same buffer over and over.
    taken: u64,
    model: Model,
}

impl<'a> Reader<'a> {
    /// Counts memory that is about to be taken.
    fn take(&mut self, what: &str, bytes: u64) -> Result<()> {
        self.taken = self.taken.saturating_add(bytes);
        Ok(budget::allow(self.path, format_args!("what the scene has up to {what}"), self.taken)?)
    }

    fn buffer(&mut self, buffer: &gltf::Buffer<'_>, blob: Option<&'a [u8]>) -> Result<Cow<'a, [u8]>> {
        let (path, place) = (self.path, format!("buffer {}", buffer.index()));
        let data = match buffer.source() {
            Source::Bin => Cow::Borrowed(blob.unwrap_or_default()),
            Source::Uri(uri) => {
                let data = match embedded(uri) {
                    Some(data) => {
                        data.map_err(|e| bad(path, format!("{place}: no base64 ({e})"), "export it again"))?
                    }
                    None => read_bytes(&beside(path, &percent_decoded(uri))?)?,
                };
                self.take(&place, data.len() as u64)?;
                Cow::Owned(data)
            }
        };
        if data.len() < buffer.length() {
            let what = format!("{place} has {} bytes, not {}", data.len(), buffer.length());
            return Err(bad(path, what, "check that the file and its buffers are complete"));
        }
        Ok(data)
    }

    fn node(&mut self, node: &gltf::Node<'_>, scene_from_parent: &Matrix4<f64>, depth: usize) -> Result<()> {
        let seen = self.visited.get_mut(node.index()).is_none_or(|v| std::mem::replace(v, true));
        if seen || depth > DEEPEST {
            let what = format!("node {} is nested in itself, twice in the scene or too deep", node.index());
            return Err(bad(self.path, what, "export the file again"));
        }
        let scene_from_node = scene_from_parent * local_transform(node);
        if let Some(mesh) = node.mesh() {
            self.primitives(&mesh, node.name().or(mesh.name()), &scene_from_node)?;
        }
        node.children().try_for_each(|child| self.node(&child, &scene_from_node, depth + 1))
    }

    fn primitives(&mut self, mesh: &gltf::Mesh<'_>, name: Option<&str>, scene_from_node: &Matrix4<f64>) -> Result<()> {
        // A mirror turns the winding round.
        let mirrored = scene_from_node.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
        for primitive in mesh.primitives() {
            let place = format!("mesh {}, primitive {}", mesh.index(), primitive.index());
            let Some(positions) = primitive.get(&gltf::Semantic::Positions) else { continue };
            let name = name.unwrap_or_default();
            self.take(&place, (size_of::<ModelPart>() + name.len()) as u64)?;
            let mut part = ModelPart { name: name.into(), ..ModelPart::default() };
            for row in self.rows(&positions, &place, &[3])?.chunks_exact(3) {
                let p = scene_from_node.transform_point(&Point3::new(row[0], row[1], row[2]));
                if p.iter().any(|c| !c.is_finite()) {
                    let n = part.mesh.vertices.len();
                    return Err(bad(self.path, format!("{place}: vertex {n} is not finite"), "export the file again"));
                }
                part.mesh.vertices.push(p);
            }
            let count = part.mesh.vertices.len() as u32;
            let indices: Vec<u32> = match primitive.indices() {
                Some(accessor) => self.rows(&accessor, &place, &[1])?.iter().map(|&i| i as u32).collect(),
                None => (0..count).collect(),
            };
            if let Some(i) = indices.iter().find(|&&i| i >= count) {
                let what = format!("{place}: index {i} is beyond its {count} vertices");
                return Err(bad(self.path, what, "export the file again"));
            }
            let order = if mirrored { [0, 2, 1] } else { [0, 1, 2] };
            part.mesh.faces = triangles(primitive.mode(), &indices).into_iter().map(|f| order.map(|k| f[k])).collect();
            if !part.mesh.faces.is_empty() {
                self.appearance(&primitive, &place, &mut part)?;
                self.model.parts.push(part);
            }
        }
        Ok(())
    }

    /// Texture coordinates, colours and material of a primitive.
    fn appearance(&mut self, primitive: &gltf::Primitive<'_>, place: &str, part: &mut ModelPart) -> Result<()> {
        part.material = primitive.material().index();
        let texture = primitive.material().pbr_metallic_roughness().base_color_texture();
        let set = texture.map_or(0, |t| t.tex_coord());
        let n = part.mesh.vertices.len();
        if let Some(accessor) = primitive.get(&gltf::Semantic::TexCoords(set)) {
            let rows = self.rows(&accessor, place, &[2])?;
            part.uv = Some(rows.chunks_exact(2).map(|r| [r[0] as f32, r[1] as f32]).collect());
        }
        if let Some(accessor) = primitive.get(&gltf::Semantic::Colors(0)) {
            let rows = self.rows(&accessor, place, &[3, 4])?;
            let columns = accessor.dimensions().multiplicity();
            let byte = |c: f64| (srgb(c.clamp(0.0, 1.0) as f32) * 255.0).round() as u8;
            part.colors = Some(rows.chunks_exact(columns).map(|r| [byte(r[0]), byte(r[1]), byte(r[2])]).collect());
        }
        let lists = [part.uv.as_ref().map(Vec::len), part.colors.as_ref().map(Vec::len)];
        if let Some(length) = lists.into_iter().flatten().find(|&l| l != n) {
            let what = format!("{place}: {length} texture coordinates or colours for {n} vertices");
            return Err(bad(self.path, what, "export the file again"));
        }
        Ok(())
    }

    fn material(&mut self, material: &gltf::Material<'_>) -> Result<Material> {
        let surface = material.pbr_metallic_roughness();
        let texture = match surface.base_color_texture() {
            Some(info) => self.image(&info.texture().source())?,
            None => None,
        };
        Ok(Material {
            name: material.name().unwrap_or_default().into(),
            base_color: surface.base_color_factor(),
            texture,
        })
    }

    /// A picture, read once however many materials show it.
    fn image(&mut self, image: &gltf::Image<'_>) -> Result<Option<Texture>> {
        if let Some(known) = self.images.get(&image.index()) {
            return Ok(known.clone());
        }
        let place = format!("image {}", image.index());
        let texture = match image.source() {
            gltf::image::Source::View { view, mime_type } => {
                let end = view.offset().checked_add(view.length());
                let bytes = self.buffers.get(view.buffer().index()).zip(end).and_then(|(b, e)| b.get(view.offset()..e));
                let Some(bytes) = bytes else {
                    let what = format!("{place} reaches beyond its buffer");
                    return Err(bad(self.path, what, "export the file again"));
                };
                Some(Texture { bytes: bytes.into(), mime: mime_type.into() })
            }
            gltf::image::Source::Uri { uri, .. } => match embedded(uri) {
                Some(bytes) => Some(Texture::new(
                    bytes.map_err(|e| bad(self.path, format!("{place}: no base64 ({e})"), "export it again"))?,
                )),
                None => picture(self.path, &percent_decoded(uri))?,
            },
        };
        self.take(&place, texture.as_ref().map_or(0, |t| t.bytes.len() as u64))?;
        self.images.insert(image.index(), texture.clone());
        Ok(texture)
    }

    /// All numbers of an accessor with one of these numbers of columns, row after row; integers that stand for 0 to 1 as such.
    fn rows(&mut self, accessor: &gltf::Accessor<'_>, place: &str, columns: &[usize]) -> Result<Vec<f64>> {
        let path = self.path;
        let refuse = |what: &str| {
            let what = format!("{place}: accessor {} {what}", accessor.index());
            Err(bad(path, what, "export the file again without compression or sparse data"))
        };
        let n = accessor.dimensions().multiplicity();
        if !columns.contains(&n) || matches!(accessor.dimensions(), Dimensions::Mat2) {
            return refuse("has the wrong number of columns");
        }
        let (size, scale) = match (accessor.data_type(), accessor.normalized()) {
            (DataType::F32, _) => (4, 1.0),
            (DataType::U8, true) => (1, 1.0 / 255.0),
            (DataType::U16, true) => (2, 1.0 / 65535.0),
            // Plain integers are indices.
            (DataType::U8, _) if n == 1 => (1, 1.0),
            (DataType::U16, _) if n == 1 => (2, 1.0),
            (DataType::U32, _) if n == 1 => (4, 1.0),
            _ => return refuse("is compressed to integers"),
        };
        let Some(view) = accessor.view().filter(|_| accessor.sparse().is_none()) else {
            return refuse("is sparse or has no data");
        };
        let row = n * size;
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
        if stride < row {
            return refuse("overlaps itself");
        }
        let count = accessor.count();
        self.taken = self.taken.saturating_add((count * n) as u64 * NUMBER_BYTES);
        budget::allow(path, format_args!("what the scene has up to {place}"), self.taken)?;
        let mut out = Vec::with_capacity(count * n);
        for i in 0..count {
            for k in 0..n {
                let at = i * stride + k * size;
                let b = &data[at..at + size];
                out.push(match accessor.data_type() {
                    DataType::U8 => f64::from(b[0]) * scale,
                    DataType::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])) * scale,
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
