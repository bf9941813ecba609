//! PLY: ASCII and binary (both byte orders), elements `vertex` and `face`; other elements and properties are skipped.

use std::path::Path;

use nalgebra::Point3;

use drex_core::TriMesh;
use drex_core::mesh::polygon_triangles;
use drex_core::ply::Scalar;

use crate::Result;

#[derive(Debug, Clone)]
struct Property {
    name: String,
    /// Type of the length of a list; `None` for a single value.
    length: Option<Scalar>,
    value: Scalar,
}

#[derive(Debug, Clone)]
struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// What a property is for.
#[derive(Debug, Clone, Copy)]
enum Role {
    Axis(usize),
    Channel(usize),
    Corner,
    Other,
}

impl Role {
    fn of(element: &Element, property: &Property) -> Self {
        let name = property.name.as_str();
        let find = |names: [&str; 3]| names.iter().position(|n| *n == name);
        match (element.name.as_str(), property.length) {
            ("face", Some(_)) if matches!(name, "vertex_indices" | "vertex_index") => Self::Corner,
            ("vertex", length) => match find(["x", "y", "z"]) {
                Some(k) => Self::Axis(k),
                None if length.is_some() => Self::Other,
                None => find(["red", "green", "blue"])
                    .or_else(|| find(["diffuse_red", "diffuse_green", "diffuse_blue"]))
                    .map_or(Self::Other, Self::Channel),
            },
            _ => Self::Other,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Ascii,
    Little,
    Big,
}

/// The mesh, and the colours of its vertices if it has red, green and blue.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<(TriMesh, Option<Vec<[u8; 3]>>)> {
    let (format, elements, body, line) = header(path, bytes)?;
    let mut source = match format {
        Format::Ascii => Source::Text { words: words(&bytes[body..], line + 1), line },
        _ => Source::Binary { bytes, at: body, big: format == Format::Big },
    };
    let mut mesh = TriMesh::default();
    let mut colors = Vec::new();
    let mut corners = Vec::new();
    for element in &elements {
        let roles: Vec<Role> = element.properties.iter().map(|p| Role::of(element, p)).collect();
        let count = |wanted: fn(&Role) -> bool| roles.iter().filter(|r| wanted(r)).count();
        let colored = count(|r| matches!(r, Role::Channel(_))) == 3;
        if element.name == "vertex" && count(|r| matches!(r, Role::Axis(_))) != 3 {
            return Err(bad(path, None, "the vertices have no x, y, z", "write the vertices with x, y and z"));
        }
        for row in 0..element.count {
            let mut point = Point3::origin();
            let mut color = [0; 3];
            corners.clear();
            for (property, role) in element.properties.iter().zip(&roles) {
                let n = match property.length {
                    None => 1,
                    Some(kind) => match source.number(kind) {
                        // No element can be longer than the file.
                        Some(n) if n >= 0.0 && n <= bytes.len() as f64 && n.fract() == 0.0 => n as usize,
                        Some(n) => {
                            let what = format!("{} {row} has a list of {n} values", element.name);
                            return Err(bad(path, source.line(), what, "export the file again"));
                        }
                        None => return Err(cut_off(path, &source, element, row)),
                    },
                };
                for _ in 0..n {
                    let Some(value) = source.number(property.value) else {
                        return Err(cut_off(path, &source, element, row));
                    };
                    match *role {
                        Role::Axis(k) => point[k] = value,
                        Role::Channel(k) => color[k] = byte(value, property.value),
                        Role::Corner => corners.push(value),
                        Role::Other => {}
                    }
                }
            }
            if element.name == "vertex" {
                if point.iter().any(|c| !c.is_finite()) {
                    let what = format!("vertex {row} is not finite");
                    return Err(bad(path, source.line(), what, "remove it and its faces"));
                }
                mesh.vertices.push(point);
                if colored {
                    colors.push(color);
                }
            }
            polygon(path, &source, row, &corners, &mut mesh.faces)?;
        }
    }
    if let Some(f) = mesh.faces.iter().position(|f| f.iter().any(|&v| v as usize >= mesh.vertices.len())) {
        let what = format!("triangle {f} names a vertex beyond the {} there are", mesh.vertices.len());
        return Err(bad(path, None, what, "export the file again"));
    }
    let colors = (colors.len() == mesh.vertices.len()).then_some(colors);
    Ok((mesh, colors))
}

/// A colour from a byte, from 16 bits, or from a number between 0 and 1.
fn byte(value: f64, kind: Scalar) -> u8 {
    let scaled = match kind {
        Scalar::F32 | Scalar::F64 => value * 255.0,
        Scalar::U16 => value / 257.0,
        _ => value,
    };
    scaled.round().clamp(0.0, 255.0) as u8
}

fn polygon(path: &Path, source: &Source<'_>, row: usize, corners: &[f64], faces: &mut Vec<[u32; 3]>) -> Result<()> {
    if let Some(c) = corners.iter().find(|c| !(**c >= 0.0 && **c < f64::from(u32::MAX) && c.fract() == 0.0)) {
        return Err(bad(path, source.line(), format!("face {row} names vertex {c}"), "export the file again"));
    }
    faces.extend(polygon_triangles(corners.len()).iter().map(|t| t.map(|k| corners[k] as u32)));
    Ok(())
}

/// Format, elements, offset of the body and number of header lines.
fn header(path: &Path, bytes: &[u8]) -> Result<(Format, Vec<Element>, usize, usize)> {
    let mut at = 0;
    let mut line = 0;
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let Some(end) = bytes[at..].iter().position(|&b| b == b'\n') else {
            return Err(bad(path, line + 1, "the header has no end_header", "check that this is a complete PLY file"));
        };
        line += 1;
        let text = String::from_utf8_lossy(&bytes[at..at + end]);
        at += end + 1;
        let words: Vec<&str> = text.split_whitespace().collect();
        let refuse = |what: String| Err(bad(path, line, what, "check that this is a PLY 1.0 file"));
        if line == 1 {
            if words != ["ply"] {
                return refuse("the file does not begin with \"ply\"".into());
            }
            continue;
        }
        match words[..] {
            ["format", "ascii", "1.0"] => format = Some(Format::Ascii),
            ["format", "binary_little_endian", "1.0"] => format = Some(Format::Little),
            ["format", "binary_big_endian", "1.0"] => format = Some(Format::Big),
            ["comment", ..] | ["obj_info", ..] | [] => {}
            ["element", name, count] => match count.parse() {
                Ok(count) => elements.push(Element { name: name.into(), count, properties: Vec::new() }),
                Err(_) => return refuse(format!("{count:?} is no number of elements")),
            },
            ["property", ref rest @ ..] => {
                let property = match *rest {
                    ["list", length, value, name] => Scalar::parse(length)
                        .zip(Scalar::parse(value))
                        .map(|(l, v)| Property { name: name.into(), length: Some(l), value: v }),
                    [value, name] => {
                        Scalar::parse(value).map(|value| Property { name: name.into(), length: None, value })
                    }
                    _ => None,
                };
                match (elements.last_mut(), property) {
                    (Some(element), Some(property)) => element.properties.push(property),
                    _ => return refuse(format!("{:?} is no property of an element", text.trim())),
                }
            }
            ["end_header"] => break,
            _ => return refuse(format!("{:?} is no line of a PLY header", text.trim())),
        }
    }
    // Rows without bytes could be counted forever.
    if let Some(e) = elements.iter().find(|e| e.count > bytes.len() || (e.properties.is_empty() && e.count > 0)) {
        let what = format!("{} elements \"{}\" do not fit into {} bytes", e.count, e.name, bytes.len());
        return Err(bad(path, None, what, "check that the file is complete"));
    }
    match format {
        Some(format) => Ok((format, elements, at, line)),
        None => Err(bad(path, None, "the header names no format", "check that this is a PLY 1.0 file")),
    }
}

/// Where the numbers come from.
enum Source<'a> {
    Text { words: Words<'a>, line: usize },
    Binary { bytes: &'a [u8], at: usize, big: bool },
}

type Words<'a> = Box<dyn Iterator<Item = (usize, &'a [u8])> + 'a>;

/// The words of the body, each with its line in the file.
fn words(bytes: &[u8], first_line: usize) -> Words<'_> {
    Box::new(bytes.split(|&b| b == b'\n').zip(first_line..).flat_map(|(text, line)| {
        text.split(|b| b.is_ascii_whitespace()).filter(|w| !w.is_empty()).map(move |w| (line, w))
    }))
}

impl Source<'_> {
    fn number(&mut self, kind: Scalar) -> Option<f64> {
        match self {
            Self::Text { words, line } => {
                let (at, word) = words.next()?;
                *line = at;
                std::str::from_utf8(word).ok()?.parse().ok()
            }
            Self::Binary { bytes, at, big } => {
                let value = kind.read(bytes.get(*at..)?, !*big)?;
                *at += kind.size();
                Some(value)
            }
        }
    }

    fn line(&self) -> Option<usize> {
        match self {
            Self::Text { line, .. } => Some(*line),
            Self::Binary { .. } => None,
        }
    }
}

fn cut_off(path: &Path, source: &Source<'_>, element: &Element, row: usize) -> crate::Error {
    let place = match source {
        Source::Text { .. } => String::new(),
        Source::Binary { at, .. } => format!(" at byte {at}"),
    };
    let what = format!("{} {row} of {} is cut off or no number{place}", element.name, element.count);
    bad(path, source.line(), what, "check that the file is complete")
}

fn bad(
    path: &Path,
    line: impl Into<Option<usize>>,
    what: impl Into<String>,
    remedy: impl Into<String>,
) -> crate::Error {
    drex_core::Error::content(path, line, what, remedy).into()
}
