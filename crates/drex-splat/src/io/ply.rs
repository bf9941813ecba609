//! Gaussians as PLY, in the layout that the code of Kerbl et al. 2023 introduced and every viewer reads.
//!
//! `x y z nx ny nz f_dc_0..2 f_rest_* opacity scale_0..2 rot_0..3`, all 32-bit floats: normals are zero, `f_rest` holds
//! the higher coefficients of red, then green, then blue, opacity is a logit, scales are logarithms, the quaternion is
//! w, x, y, z. Written little endian. Two additions, each only where it says something:
//! - surfels have the comment `drex kind surfel` and a small third scale, so that other viewers draw them as thin discs;
//! - labels other than background are a last property `uchar label`, which viewers skip.
//!
//! Read are all three formats of PLY, properties in any order and of any type, files with two scales (surfels of the code
//! of Huang et al. 2024), without normals or higher coefficients, and with properties that mean something to others.

use std::path::Path;

use drex_core::fsutil;

use super::{checked, content, three_log_scales};
use crate::{Gaussians, Kind, Label, Result};

/// Longest line of a header, bytes.
const LONGEST_LINE: usize = 4096;
/// What tells surfels from ellipsoids in a file with three scales.
const SURFEL_COMMENT: &str = "comment drex kind surfel";

/// Writes a set.
///
/// # Errors
/// If the set is inconsistent or the file cannot be written.
pub fn write(path: &Path, gaussians: &Gaussians) -> Result<()> {
    Ok(fsutil::write_atomic(path, &to_bytes(gaussians)?)?)
}

/// The bytes of the file.
///
/// # Errors
/// If the set is inconsistent.
pub fn to_bytes(gaussians: &Gaussians) -> Result<Vec<u8>> {
    gaussians.check()?;
    let labelled = gaussians.labels.iter().any(|&l| l != Label::BACKGROUND);
    let stride = gaussians.sh_stride();
    let mut out = header_text(gaussians, labelled).into_bytes();
    out.reserve(gaussians.len() * (4 * (14 + stride) + usize::from(labelled)));
    let mut row = Vec::with_capacity(14 + stride);
    for i in 0..gaussians.len() {
        let (dc, rest) = gaussians.sh[i * stride..(i + 1) * stride].split_at(3);
        row.clear();
        row.extend(gaussians.means[i]);
        row.extend([0.0; 3]);
        row.extend(dc);
        row.extend((0..3).flat_map(|channel| rest.iter().skip(channel).step_by(3)));
        row.push(gaussians.logit_opacities[i]);
        row.extend(three_log_scales(gaussians, i));
        row.extend(gaussians.rotations[i]);
        out.extend(row.iter().flat_map(|v: &f32| v.to_le_bytes()));
        if labelled {
            out.push(gaussians.labels[i].0);
        }
    }
    Ok(out)
}

fn header_text(gaussians: &Gaussians, labelled: bool) -> String {
    let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", gaussians.len());
    for name in
        ["x", "y", "z", "nx", "ny", "nz"].map(String::from).into_iter().chain(names(gaussians.sh_stride() - 3, 3))
    {
        text += &format!("property float {name}\n");
    }
    if labelled {
        text += "property uchar label\n";
    }
    if gaussians.kind == Kind::Surfel {
        text += SURFEL_COMMENT;
        text.push('\n');
    }
    text + "end_header\n"
}

/// The properties after position and normal, in the order of the layout.
fn names(rest: usize, scales: usize) -> impl Iterator<Item = String> {
    let numbered = |stem: &'static str, n: usize| (0..n).map(move |i| format!("{stem}_{i}"));
    numbered("f_dc", 3)
        .chain(numbered("f_rest", rest))
        .chain(["opacity".into()])
        .chain(numbered("scale", scales))
        .chain(numbered("rot", 4))
}

/// Reads a set. It consists of surfels if the file says so or has two scales, else of what `otherwise` says. A file
/// without labels is all background.
///
/// # Errors
/// If the file cannot be read, is no PLY of Gaussians, ends too early, or has a number that is not finite.
pub fn read(path: &Path, otherwise: Kind) -> Result<Gaussians> {
    parse(path, &fsutil::read_bytes(path)?, otherwise)
}

/// As [`read`], from memory.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, bytes: &[u8], otherwise: Kind) -> Result<Gaussians> {
    let header = Header::parse(path, bytes)?;
    let vertices = &header.elements[header.vertices];
    let has = |name: &str| vertices.properties.iter().any(|p| p.name == name);
    let rest = vertices.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
    let sh_degree = match rest {
        0 => 0,
        9 => 1,
        24 => 2,
        45 => 3,
        n => {
            let what = format!("{n} properties f_rest, which is no degree of spherical harmonics from 0 to 3");
            return Err(content(path, vertices.line, what, "write it again with 0, 9, 24 or 45 of them"));
        }
    };
    let scales = if has("scale_2") { 3 } else { 2 };
    let labelled = vertices.properties.iter().any(|p| p.name == "label" && p.scalar == Some(Scalar::U8));
    let kind = if header.surfels || scales == 2 { Kind::Surfel } else { otherwise };
    let columns = ["x", "y", "z"]
        .map(String::from)
        .into_iter()
        .chain(names(rest, scales))
        .chain(labelled.then(|| "label".into()))
        .map(|name| {
            vertices.properties.iter().position(|p| p.name == name).ok_or_else(|| {
                let what = format!("the vertices have no property {name}");
                content(path, vertices.line, what, "give a file of Gaussians; this may be a mesh or a point cloud")
            })
        })
        .collect::<Result<Vec<_>>>()?;

    let mut gaussians = Gaussians::new(kind, sh_degree);
    let mut push = |row: &[f32]| {
        let (geometry, row) = row.split_at(3);
        let (colour, row) = row.split_at(3 + rest);
        let (shape, row) = row.split_at(1 + scales);
        gaussians.means.push([geometry[0], geometry[1], geometry[2]]);
        gaussians.sh.extend(&colour[..3]);
        let channel = rest / 3;
        gaussians.sh.extend((0..channel).flat_map(|k| (0..3).map(move |c| colour[3 + c * channel + k])));
        gaussians.logit_opacities.push(shape[0]);
        // The third of two scales is never used; a surfel's thickness reads as zero.
        gaussians.log_scales.push([shape[1], shape[2], shape.get(3).copied().unwrap_or(f32::NEG_INFINITY)]);
        gaussians.rotations.push([row[0], row[1], row[2], row[3]]);
        gaussians.labels.push(Label(row.get(4).map_or(0, |&l| l as u8)));
    };
    match header.format {
        Format::Ascii => header.each_text_row(path, bytes, &columns, &mut push)?,
        Format::LittleEndian => header.each_binary_row(path, bytes, &columns, true, &mut push)?,
        Format::BigEndian => header.each_binary_row(path, bytes, &columns, false, &mut push)?,
    }
    checked(path, gaussians)
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

/// A property; `scalar` is `None` for a list.
#[derive(Debug)]
struct Property {
    name: String,
    scalar: Option<Scalar>,
}

#[derive(Debug)]
struct Element {
    name: String,
    count: usize,
    /// 1-based line of the header that names it.
    line: usize,
    properties: Vec<Property>,
}

#[derive(Debug)]
struct Header {
    format: Format,
    elements: Vec<Element>,
    /// Which element the vertices are.
    vertices: usize,
    /// Whether the comment of surfels is there.
    surfels: bool,
    /// Lines and bytes of the header.
    lines: usize,
    bytes: usize,
}

impl Header {
    fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let refuse = |line: usize, what: String| content(path, line, what, "give a PLY file of Gaussians");
        let (mut format, mut elements, mut surfels): (_, Vec<Element>, _) = (None, Vec::new(), false);
        let (mut at, mut line) = (0, 0);
        loop {
            line += 1;
            let tail = &bytes[at..];
            let text = tail[..tail.len().min(LONGEST_LINE)]
                .iter()
                .position(|&b| b == b'\n')
                .and_then(|end| std::str::from_utf8(&tail[..end]).ok().inspect(|_| at += end + 1))
                .ok_or_else(|| refuse(line, "the header of a PLY file is no text or does not end".into()))?
                .trim_end();
            if line == 1 && text != "ply" {
                return Err(refuse(1, "the file does not start with `ply`".into()));
            }
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match (words.as_slice(), elements.last_mut()) {
                (["ply"], _) if line == 1 => {}
                ([] | ["comment" | "obj_info", ..], _) => surfels |= text == SURFEL_COMMENT,
                (["format", name, ..], _) => {
                    format = Some(
                        Format::parse(name).ok_or_else(|| refuse(line, format!("the format `{name}` is unknown")))?,
                    )
                }
                (["element", name, count], _) => {
                    let count = count.parse().map_err(|_| refuse(line, format!("`{count}` is no count of {name}")))?;
                    elements.push(Element { name: (*name).into(), count, line, properties: Vec::new() });
                }
                (["property", "list", _, _, name], Some(element)) => {
                    element.properties.push(Property { name: (*name).into(), scalar: None });
                }
                (["property", scalar, name], Some(element)) => {
                    let scalar = Scalar::parse(scalar)
                        .ok_or_else(|| refuse(line, format!("the type `{scalar}` of {name} is unknown")))?;
                    if element.properties.iter().any(|p| p.name == *name) {
                        return Err(refuse(line, format!("the property {name} is there twice")));
                    }
                    element.properties.push(Property { name: (*name).into(), scalar: Some(scalar) });
                }
                (["end_header"], _) => break,
                _ => return Err(refuse(line, format!("`{text}` is not understood"))),
            }
        }
        let format = format.ok_or_else(|| refuse(line, "the header names no format".into()))?;
        let vertices = elements
            .iter()
            .position(|e| e.name == "vertex")
            .ok_or_else(|| refuse(line, "the header has no element vertex".into()))?;
        if let Some(element) = elements[..=vertices].iter().find(|e| e.properties.iter().any(|p| p.scalar.is_none())) {
            return Err(refuse(element.line, format!("the element {} has lists", element.name)));
        }
        Ok(Self { format, elements, vertices, surfels, lines: line, bytes: at })
    }

    /// Calls `push` with the values of `columns` of every vertex.
    fn each_binary_row(
        &self,
        path: &Path,
        bytes: &[u8],
        columns: &[usize],
        little_endian: bool,
        push: &mut impl FnMut(&[f32]),
    ) -> Result<()> {
        let widths = |e: &Element| e.properties.iter().map(|p| p.scalar.map_or(0, Scalar::width)).collect::<Vec<_>>();
        let vertices = &self.elements[self.vertices];
        let widths_of_vertex = widths(vertices);
        let stride: usize = widths_of_vertex.iter().sum();
        let before = self.elements[..self.vertices].iter().try_fold(self.bytes, |sum, e| {
            widths(e).iter().sum::<usize>().checked_mul(e.count).and_then(|size| sum.checked_add(size))
        });
        let body = before
            .and_then(|start| Some(start..start.checked_add(stride.checked_mul(vertices.count)?)?))
            .and_then(|range| bytes.get(range))
            .ok_or_else(|| {
                let what =
                    format!("{} vertices of {stride} bytes are announced, but the file ends before", vertices.count);
                content(path, vertices.line, what, "fetch the file again: it was cut off")
            })?;
        let mut offset = 0;
        let offsets: Vec<usize> = widths_of_vertex
            .iter()
            .map(|w| {
                let at = offset;
                offset += w;
                at
            })
            .collect();
        let readers: Vec<(usize, Scalar)> =
            columns.iter().filter_map(|&c| Some((offsets[c], vertices.properties[c].scalar?))).collect();
        let mut row = vec![0.0; columns.len()];
        for bytes in body.chunks_exact(stride) {
            for (value, &(offset, scalar)) in row.iter_mut().zip(&readers) {
                *value = scalar.read(&bytes[offset..offset + scalar.width()], little_endian);
            }
            push(&row);
        }
        Ok(())
    }

    /// Calls `push` with the values of `columns` of every vertex; one vertex a line.
    fn each_text_row(&self, path: &Path, bytes: &[u8], columns: &[usize], push: &mut impl FnMut(&[f32])) -> Result<()> {
        let vertices = &self.elements[self.vertices];
        let short = || {
            let what = format!("{} vertices are announced, but the file ends before", vertices.count);
            content(path, vertices.line, what, "fetch the file again: it was cut off")
        };
        let skipped = self.elements[..self.vertices]
            .iter()
            .try_fold(0usize, |sum, e| sum.checked_add(e.count))
            .ok_or_else(short)?;
        let mut lines = bytes[self.bytes..].split(|&b| b == b'\n').enumerate().skip(skipped);
        let mut row = vec![0.0; columns.len()];
        for _ in 0..vertices.count {
            let (number, line) = lines.next().ok_or_else(short)?;
            let number = self.lines + 1 + number;
            let words: Vec<&str> = std::str::from_utf8(line).unwrap_or_default().split_ascii_whitespace().collect();
            for (value, &column) in row.iter_mut().zip(columns) {
                let name = &vertices.properties[column].name;
                *value = words.get(column).and_then(|w| w.parse().ok()).ok_or_else(|| {
                    content(
                        path,
                        number,
                        format!("no number for the property {name}"),
                        "repair the line or fetch the file again",
                    )
                })?;
            }
            push(&row);
        }
        Ok(())
    }
}

impl Format {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "ascii" => Self::Ascii,
            "binary_little_endian" => Self::LittleEndian,
            "binary_big_endian" => Self::BigEndian,
            _ => return None,
        })
    }
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn width(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number in the first [`Scalar::width`] of `bytes`.
    fn read(self, bytes: &[u8], little_endian: bool) -> f32 {
        // The bits, least significant byte first.
        let mut le = [0; 8];
        for (k, to) in le[..self.width()].iter_mut().enumerate() {
            *to = bytes[if little_endian { k } else { self.width() - 1 - k }];
        }
        let bits = u64::from_le_bytes(le);
        match self {
            Self::I8 => f32::from(bits as i8),
            Self::U8 => f32::from(bits as u8),
            Self::I16 => f32::from(bits as i16),
            Self::U16 => f32::from(bits as u16),
            Self::I32 => bits as i32 as f32,
            Self::U32 => bits as u32 as f32,
            Self::F32 => f32::from_bits(bits as u32),
            Self::F64 => f64::from_bits(bits) as f32,
        }
    }
}
