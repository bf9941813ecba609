//! The vertices of a PLY file as a table: any format, any order of properties.

use std::path::Path;

use drex_core::ply::Scalar;

use crate::Result;
use crate::io::content;

/// Longest line of a header, bytes.
const LONGEST_LINE: usize = 4096;
/// Most lines of a header; a set of Gaussians has some seventy.
const MOST_LINES: usize = 4096;

/// How the rows are stored.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A property; `scalar` is `None` for a list.
#[derive(Debug)]
pub(crate) struct Property {
    pub name: String,
    pub scalar: Option<Scalar>,
}

#[derive(Debug)]
pub(crate) struct Element {
    pub name: String,
    pub count: usize,
    /// 1-based line of the header that names it.
    pub line: usize,
    pub properties: Vec<Property>,
}

#[derive(Debug)]
pub(crate) struct Header {
    format: Format,
    elements: Vec<Element>,
    /// Which element the vertices are.
    vertices: usize,
    /// Its comments, without the word.
    pub comments: Vec<String>,
    /// Lines and bytes of the header.
    lines: usize,
    bytes: usize,
}

impl Header {
    /// Reads the header; `what` names what the file should hold, for messages.
    pub fn parse(path: &Path, bytes: &[u8], what: &str) -> Result<Self> {
        let remedy = format!("give a PLY file of {what}");
        let refuse = |line: usize, what: String| content(path, line, what, &remedy);
        let (mut format, mut elements, mut comments): (_, Vec<Element>, _) = (None, Vec::new(), Vec::new());
        let (mut at, mut line) = (0, 0);
        loop {
            line += 1;
            if line > MOST_LINES {
                return Err(refuse(line, format!("the header has more than {MOST_LINES} lines")));
            }
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
                ([] | ["obj_info", ..], _) => {}
                (["comment", words @ ..], _) => comments.push(words.join(" ")),
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
        Ok(Self { format, elements, vertices, comments, lines: line, bytes: at })
    }

    /// The element of the vertices.
    pub fn vertices(&self) -> &Element {
        &self.elements[self.vertices]
    }

    /// Calls `push` with the values of `columns`, indices of properties, of every vertex.
    pub fn each_row(&self, path: &Path, bytes: &[u8], columns: &[usize], push: &mut impl FnMut(&[f64])) -> Result<()> {
        match self.format {
            Format::Ascii => self.each_text_row(path, bytes, columns, push),
            Format::LittleEndian => self.each_binary_row(path, bytes, columns, true, push),
            Format::BigEndian => self.each_binary_row(path, bytes, columns, false, push),
        }
    }

    fn each_binary_row(
        &self,
        path: &Path,
        bytes: &[u8],
        columns: &[usize],
        little_endian: bool,
        push: &mut impl FnMut(&[f64]),
    ) -> Result<()> {
        let widths = |e: &Element| e.properties.iter().map(|p| p.scalar.map_or(0, Scalar::size)).collect::<Vec<_>>();
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
                // Every row has the bytes of all its columns.
                *value = scalar.read(&bytes[offset..], little_endian).unwrap_or(f64::NAN);
            }
            push(&row);
        }
        Ok(())
    }

    /// One vertex a line.
    fn each_text_row(&self, path: &Path, bytes: &[u8], columns: &[usize], push: &mut impl FnMut(&[f64])) -> Result<()> {
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

impl Element {
    /// Index of the property with one of these names.
    pub fn column(&self, names: &[&str]) -> Option<usize> {
        self.properties.iter().position(|p| names.contains(&p.name.as_str()))
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
