//! Wavefront OBJ with materials, texture coordinates and vertex colours.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

use nalgebra::Point3;

use drex_core::fsutil::{read_bytes, write_atomic};
use drex_core::mesh::polygon_triangles;

use super::model::{Material, Model, ModelPart, Texture, beside, picture};
use crate::{Error, Result};

/// Parses an OBJ; parts are the runs of faces between `o`, `g` and `usemtl`, equal ones joined.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Model> {
    let mut reader = Reader::new(path);
    for (i, line) in bytes.split(|b| *b == b'\n').enumerate() {
        reader.line(i + 1, &String::from_utf8_lossy(line))?;
    }
    if reader.parts.iter().all(|p| p.faces.is_empty()) {
        return Err(Error::Empty { subject: path.display().to_string() });
    }
    let mut out = Model { parts: Vec::new(), materials: reader.materials };
    for building in reader.parts.into_iter().filter(|p| !p.faces.is_empty()) {
        out.parts.push(building.finish(&reader.vertices, &reader.colors, &reader.uv));
    }
    Ok(out)
}

struct Reader<'a> {
    path: &'a Path,
    vertices: Vec<Point3<f64>>,
    /// One per vertex, or none at all.
    colors: Vec<[f64; 3]>,
    uv: Vec<[f32; 2]>,
    materials: Vec<Material>,
    /// Materials by name; of several with one name the first.
    named: BTreeMap<String, usize>,
    /// Libraries and pictures, each read once however often it is named.
    libraries: BTreeSet<String>,
    pictures: BTreeMap<String, Option<Texture>>,
    parts: Vec<Building>,
    /// Parts by name and material.
    known: BTreeMap<(String, Option<usize>), usize>,
    /// The part that faces go to, until a line names another.
    part: Option<usize>,
    name: String,
    material: Option<usize>,
}

/// A part whose corners still name vertex and texture coordinate apart.
#[derive(Default)]
struct Building {
    name: String,
    material: Option<usize>,
    corners: BTreeMap<(u32, Option<u32>), u32>,
    order: Vec<(u32, Option<u32>)>,
    faces: Vec<[u32; 3]>,
}

impl<'a> Reader<'a> {
    fn new(path: &'a Path) -> Self {
        Self {
            path,
            vertices: Vec::new(),
            colors: Vec::new(),
            uv: Vec::new(),
            materials: Vec::new(),
            named: BTreeMap::new(),
            libraries: BTreeSet::new(),
            pictures: BTreeMap::new(),
            parts: Vec::new(),
            known: BTreeMap::new(),
            part: None,
            name: String::new(),
            material: None,
        }
    }

    fn line(&mut self, number: usize, text: &str) -> Result<()> {
        let path = self.path;
        let refuse = |what: &str| -> Error {
            let what = format!("`{}`: {what}", text.trim().chars().take(60).collect::<String>());
            drex_core::Error::content(path, number, what, "export the model again").into()
        };
        let text = text.split('#').next().unwrap_or_default().trim();
        let (key, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        let numbers = || rest.split_ascii_whitespace().map_while(|w| w.parse::<f64>().ok()).collect::<Vec<_>>();
        match key {
            "v" => {
                let n = numbers();
                let Some(&[x, y, z]) = n.first_chunk::<3>() else { return Err(refuse("a vertex needs three numbers")) };
                if ![x, y, z].iter().all(|c| c.is_finite()) {
                    return Err(refuse("the vertex is not finite"));
                }
                // Six numbers are place and colour; four are place and weight.
                if let &[_, _, _, r, g, b] = &n[..]
                    && self.colors.len() == self.vertices.len()
                {
                    self.colors.push([r, g, b]);
                }
                self.vertices.push(Point3::new(x, y, z));
            }
            "vt" => {
                let &[u, v, ..] = &numbers()[..] else { return Err(refuse("a texture coordinate needs two numbers")) };
                if !(u.is_finite() && v.is_finite()) {
                    return Err(refuse("the texture coordinate is not finite"));
                }
                self.uv.push([u as f32, 1.0 - v as f32]);
            }
            "f" => {
                let corners = rest
                    .split_ascii_whitespace()
                    .map(|word| self.corner(word).ok_or_else(|| refuse("a corner names no vertex above it")))
                    .collect::<Result<Vec<_>>>()?;
                if corners.len() < 3 {
                    return Err(refuse("a face needs three corners"));
                }
                let part = self.part();
                let corners: Vec<u32> = corners.into_iter().map(|c| part.corner(c)).collect();
                part.faces.extend(polygon_triangles(corners.len()).iter().map(|t| t.map(|k| corners[k])));
            }
            "o" | "g" => {
                self.name = rest.trim().to_string();
                self.part = None;
            }
            "usemtl" => {
                let name = rest.trim();
                let found = self.named.get(name).copied();
                self.material = Some(found.unwrap_or_else(|| self.add_material(name)));
                self.part = None;
            }
            "mtllib" if self.libraries.insert(rest.trim().to_owned()) => self.library(rest)?,
            _ => {}
        }
        Ok(())
    }

    /// Vertex and texture coordinate of a corner `v`, `v/vt`, `v//vn` or `v/vt/vn`.
    fn corner(&self, word: &str) -> Option<(u32, Option<u32>)> {
        let index = |text: &str, count: usize| {
            let i: i64 = text.parse().ok()?;
            let count = i64::try_from(count).ok()?;
            let zero_based = if i > 0 { i - 1 } else { count.checked_add(i)? };
            (i != 0 && (0..count).contains(&zero_based)).then(|| u32::try_from(zero_based).ok())?
        };
        let mut words = word.split('/');
        let v = index(words.next()?, self.vertices.len())?;
        match words.next() {
            None | Some("") => Some((v, None)),
            Some(text) => Some((v, Some(index(text, self.uv.len())?))),
        }
    }

    fn part(&mut self) -> &mut Building {
        let k = self.part.unwrap_or_else(|| {
            *self.known.entry((self.name.clone(), self.material)).or_insert_with(|| {
                self.parts.push(Building { name: self.name.clone(), material: self.material, ..Building::default() });
                self.parts.len() - 1
            })
        });
        self.part = Some(k);
        &mut self.parts[k]
    }

    /// A material without looks; its position.
    fn add_material(&mut self, name: &str) -> usize {
        let k = self.materials.len();
        self.materials.push(Material { name: name.into(), ..Material::default() });
        self.named.entry(name.to_owned()).or_insert(k);
        k
    }

    fn library(&mut self, name: &str) -> Result<()> {
        let path = beside(self.path, name)?;
        let bytes = match read_bytes(&path) {
            Ok(bytes) => bytes,
            Err(e) => {
                tracing::warn!("{}: its materials are left out: {e}", self.path.display());
                return Ok(());
            }
        };
        for (i, line) in String::from_utf8_lossy(&bytes).lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            if key == "newmtl" {
                self.add_material(rest.trim());
                continue;
            }
            let Some(material) = self.materials.last_mut() else { continue };
            let numbers: Vec<f32> = rest.split_ascii_whitespace().map_while(|w| w.parse().ok()).collect();
            let bad = || drex_core::Error::content(&path, i + 1, format!("`{line}` has no numbers"), "export it again");
            match key {
                "Kd" => {
                    let color =
                        numbers.first_chunk::<3>().filter(|c| c.iter().all(|x| x.is_finite())).ok_or_else(bad)?;
                    material.base_color[..3].copy_from_slice(color);
                }
                "d" => material.base_color[3] = *numbers.first().filter(|d| d.is_finite()).ok_or_else(bad)?,
                "Tr" => material.base_color[3] = 1.0 - numbers.first().filter(|d| d.is_finite()).ok_or_else(bad)?,
                "map_Kd" => {
                    // Options come before the name; a name without options may hold spaces.
                    let name = if rest.trim_start().starts_with('-') {
                        rest.split_whitespace().last().unwrap_or_default()
                    } else {
                        rest
                    };
                    material.texture = match self.pictures.get(name) {
                        Some(known) => known.clone(),
                        None => self.pictures.entry(name.to_owned()).or_insert(picture(&path, name)?).clone(),
                    };
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl Building {
    fn corner(&mut self, c: (u32, Option<u32>)) -> u32 {
        *self.corners.entry(c).or_insert_with(|| {
            self.order.push(c);
            self.order.len() as u32 - 1
        })
    }

    fn finish(self, vertices: &[Point3<f64>], colors: &[[f64; 3]], uv: &[[f32; 2]]) -> ModelPart {
        // Some exporters write 0 to 255.
        let scale = if colors.iter().flatten().any(|&c| c > 1.0) { 1.0 } else { 255.0 };
        let byte = |c: f64| (c * scale).round().clamp(0.0, 255.0) as u8;
        let mut part = ModelPart { name: self.name, material: self.material, ..ModelPart::default() };
        part.mesh.vertices = self.order.iter().map(|c| vertices[c.0 as usize]).collect();
        part.mesh.faces = self.faces;
        if colors.len() == vertices.len() {
            part.colors = Some(self.order.iter().map(|c| colors[c.0 as usize].map(byte)).collect());
        }
        if self.order.iter().any(|c| c.1.is_some()) {
            part.uv = Some(self.order.iter().map(|c| c.1.map_or([0.0; 2], |t| uv[t as usize])).collect());
        }
        part
    }
}

/// Writes an OBJ with its materials: `NAME.obj`, `NAME.mtl` and `NAME_K.png` (or `.jpg`) beside each other, the OBJ last.
///
/// Names are written with `_` for what OBJ cannot hold.
///
/// # Errors
/// If the model is not consistent ([`Model::check`]) or a file cannot be written.
pub fn write_obj_model(path: &Path, model: &Model) -> Result<()> {
    model.check()?;
    let stem = path.file_stem().map(|s| word(&s.to_string_lossy())).unwrap_or_else(|| "model".into());
    let names = material_names(model);
    let mut text = String::new();
    // Writing to a string cannot fail.
    if !model.materials.is_empty() {
        let mut library = String::new();
        for (k, m) in model.materials.iter().enumerate() {
            let [r, g, b, a] = m.base_color;
            let _ = writeln!(library, "newmtl {}\nKd {r} {g} {b}\nd {a}", names[k]);
            if let Some(texture) = &m.texture {
                let name = format!("{stem}_{k}.{}", texture.extension());
                write_atomic(&path.with_file_name(&name), &texture.bytes)?;
                let _ = writeln!(library, "map_Kd {name}");
            }
        }
        write_atomic(&path.with_file_name(format!("{stem}.mtl")), library.as_bytes())?;
        let _ = writeln!(text, "mtllib {stem}.mtl");
    }
    let (mut vertices, mut coordinates) = (0, 0);
    for part in &model.parts {
        if !part.name.is_empty() {
            let _ = writeln!(text, "o {}", word(&part.name));
        }
        for (i, v) in part.mesh.vertices.iter().enumerate() {
            let _ = write!(text, "v {} {} {}", v.x, v.y, v.z);
            if let Some(colors) = &part.colors {
                let [r, g, b] = colors[i].map(|c| f64::from(c) / 255.0);
                let _ = write!(text, " {r} {g} {b}");
            }
            text.push('\n');
        }
        for [u, v] in part.uv.iter().flatten() {
            let _ = writeln!(text, "vt {u} {}", 1.0 - v);
        }
        if let Some(k) = part.material {
            let _ = writeln!(text, "usemtl {}", names[k]);
        }
        for f in &part.mesh.faces {
            text.push('f');
            for &c in f {
                let c = c as usize;
                let _ = match part.uv {
                    Some(_) => write!(text, " {}/{}", vertices + c + 1, coordinates + c + 1),
                    None => write!(text, " {}", vertices + c + 1),
                };
            }
            text.push('\n');
        }
        vertices += part.mesh.vertices.len();
        coordinates += part.uv.as_ref().map_or(0, Vec::len);
    }
    Ok(write_atomic(path, text.as_bytes())?)
}

/// The names of the materials, those that are empty or there twice made unique by their number.
fn material_names(model: &Model) -> Vec<String> {
    let names: Vec<String> = model.materials.iter().map(|m| word(&m.name)).collect();
    let mut uses: BTreeMap<&str, usize> = BTreeMap::new();
    names.iter().for_each(|n| *uses.entry(n).or_default() += 1);
    let unique = |n: &String| !n.is_empty() && uses[n.as_str()] == 1;
    names.iter().enumerate().map(|(k, n)| if unique(n) { n.clone() } else { format!("{n}_{k}") }).collect()
}

/// A name without spaces, separators and control characters.
fn word(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || "._-+".contains(c) { c } else { '_' }).collect()
}
