//! Points with colours from a PLY file, ascii or binary.

use std::path::Path;

use drex_core::fsutil::read_bytes;

use super::SparsePoint;
use crate::Result;

#[derive(Clone, Copy, PartialEq)]
enum Layout {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy)]
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

/// Reads x, y, z and red, green, blue of the vertices; grey where there is no colour. Colours may be bytes, or numbers
/// from 0 to 1.
pub(super) fn load(path: &Path) -> Result<Vec<SparsePoint>> {
    let bytes = read_bytes(path)?;
    match parse(&bytes) {
        Ok(points) => Ok(points),
        Err(what) => {
            let remedy = "write the points again as a PLY with x, y, z, red, green, blue, vertices first";
            Err(drex_core::Error::content(path, None, what, remedy).into())
        }
    }
}

fn parse(bytes: &[u8]) -> std::result::Result<Vec<SparsePoint>, String> {
    const END: &[u8] = b"end_header";
    let end = bytes.windows(END.len()).position(|w| w == END).ok_or("no end_header of a PLY file")?;
    let newline = bytes[end..].iter().position(|b| *b == b'\n').ok_or("no line end after end_header")?;
    let body = &bytes[end + newline + 1..];
    let header = std::str::from_utf8(&bytes[..end]).map_err(|_| "the PLY header is not text")?;
    let (mut layout, mut elements) = (None, 0);
    let mut count = None;
    let mut properties = Vec::new();
    for line in header.lines() {
        match line.split_whitespace().collect::<Vec<_>>().as_slice() {
            ["format", "ascii", _] => layout = Some(Layout::Ascii),
            ["format", "binary_little_endian", _] => layout = Some(Layout::Little),
            ["format", "binary_big_endian", _] => layout = Some(Layout::Big),
            ["element", name, n] => {
                elements += 1;
                if elements == 1 && *name != "vertex" {
                    return Err(format!("the first element is {name}, not vertex"));
                }
                count = count.or(n.parse::<usize>().ok());
            }
            ["property", kind, name] if elements == 1 => {
                let kind = scalar(kind).ok_or_else(|| format!("property {name} has the unknown type {kind}"))?;
                properties.push((kind, (*name).to_owned()));
            }
            ["property", "list", ..] if elements == 1 => return Err("a vertex has a list".into()),
            _ => {}
        }
    }
    let (Some(layout), Some(count)) = (layout, count) else { return Err("no format or no number of vertices".into()) };
    let find = |names: &[&str]| properties.iter().position(|(_, p)| names.contains(&p.as_str()));
    let [Some(x), Some(y), Some(z)] = [find(&["x"]), find(&["y"]), find(&["z"])] else {
        return Err("vertices have not x, y and z".into());
    };
    let colour = [["red", "diffuse_red", "r"], ["green", "diffuse_green", "g"], ["blue", "diffuse_blue", "b"]];
    let colour = colour.map(|names| find(&names));
    let channel = |row: &[f64], column: Option<usize>| match column {
        Some(c) if matches!(properties[c].0, Scalar::F32 | Scalar::F64) => (row[c] * 255.0).round() as u8,
        Some(c) => row[c] as u8,
        None => 128,
    };
    let mut points = Vec::new();
    let mut push = |row: &[f64]| {
        let position = [row[x], row[y], row[z]];
        if !position.iter().all(|v| v.is_finite()) {
            return Err(format!("the position of vertex {} is not finite", points.len()));
        }
        points.push(SparsePoint { position, rgb: colour.map(|c| channel(row, c)), error_px: 0.0, track: Vec::new() });
        Ok(())
    };
    let short = |n: usize| format!("the file ends after {n} of {count} vertices");
    if layout == Layout::Ascii {
        let text = std::str::from_utf8(body).map_err(|_| "the vertices are not text")?;
        let mut lines = text.lines().filter(|l| !l.trim().is_empty());
        for n in 0..count {
            let line = lines.next().ok_or_else(|| short(n))?;
            let row: Option<Vec<f64>> = line.split_whitespace().map(|w| w.parse().ok()).collect();
            let row = row.filter(|row| row.len() >= properties.len());
            push(&row.ok_or_else(|| format!("vertex {n} is not {} numbers", properties.len()))?)?;
        }
    } else {
        let stride: usize = properties.iter().map(|(kind, _)| kind.bytes()).sum();
        let mut rows = body.chunks_exact(stride);
        let mut row = Vec::with_capacity(properties.len());
        for n in 0..count {
            let mut left = rows.next().ok_or_else(|| short(n))?;
            row.clear();
            for (kind, _) in &properties {
                let (value, rest) = left.split_at(kind.bytes());
                row.push(kind.value(value, layout == Layout::Big));
                left = rest;
            }
            push(&row)?;
        }
    }
    Ok(points)
}

fn scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

impl Scalar {
    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value of as many bytes as the type has.
    fn value(self, bytes: &[u8], big: bool) -> f64 {
        let mut little = [0; 8];
        little[..bytes.len()].copy_from_slice(bytes);
        if big {
            little[..bytes.len()].reverse();
        }
        let [a, b, c, d, ..] = little;
        match self {
            Self::I8 => f64::from(a as i8),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(little),
        }
    }
}
