//! PLY files: text and binary of either byte order, any elements and properties. What is made of the numbers is up to who reads the file.

use std::path::Path;

use crate::{Error, Result};

/// Longest line of a header, bytes.
const LONGEST_LINE: usize = 4096;
/// Most lines of a header; a set of Gaussians has some seventy.
const MOST_LINES: usize = 4096;

/// Type of a number in a PLY file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// `char`, `int8`.
    I8,
    /// `uchar`, `uint8`.
    U8,
    /// `short`, `int16`.
    I16,
    /// `ushort`, `uint16`.
    U16,
    /// `int`, `int32`.
    I32,
    /// `uint`, `uint32`.
    U32,
    /// `float`, `float32`.
    F32,
    /// `double`, `float64`.
    F64,
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

    /// Bytes of a number.
    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number at the start of `bytes`; none if there are too few.
    fn read(self, bytes: &[u8], little_endian: bool) -> Option<f64> {
        let own = bytes.get(..self.size())?;
        // The bits, least significant byte first.
        let mut le = [0; 8];
        for (k, to) in le[..own.len()].iter_mut().enumerate() {
            *to = own[if little_endian { k } else { own.len() - 1 - k }];
        }
        let bits = u64::from_le_bytes(le);
        Some(match self {
            Self::I8 => f64::from(bits as i8),
            Self::U8 => f64::from(bits as u8),
            Self::I16 => f64::from(bits as i16),
            Self::U16 => f64::from(bits as u16),
            Self::I32 => f64::from(bits as i32),
            Self::U32 => f64::from(bits as u32),
            Self::F32 => f64::from(f32::from_bits(bits as u32)),
            Self::F64 => f64::from_bits(bits),
        })
    }
}

/// A property of an element: one number, or a list of numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Property {
    /// Name in the header.
    pub name: String,
    /// Type of the number, or of the numbers of the list.
    pub scalar: Scalar,
    /// Type of the length of a list; `None` for a single number.
    pub length: Option<Scalar>,
}

/// What a file has many of: vertices, faces.
#[derive(Debug, Clone, PartialEq)]
pub struct Element {
    /// Name in the header.
    pub name: String,
    /// Number of rows.
    pub count: usize,
    /// 1-based line of the header that names it.
    pub line: usize,
    /// Properties in the order of a row.
    pub properties: Vec<Property>,
}

impl Element {
    /// Position of the property with one of these names, if it is a single number.
    pub fn column(&self, names: &[&str]) -> Option<usize> {
        self.properties.iter().position(|p| p.length.is_none() && names.contains(&p.name.as_str()))
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Text,
    LittleEndian,
    BigEndian,
}

/// A file whose header is read.
#[derive(Debug)]
pub struct PlyFile<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    format: Format,
    /// Elements in the order of the file.
    pub elements: Vec<Element>,
    /// Comments of the header, without that word.
    pub comments: Vec<String>,
    /// Where the rows begin, bytes; how many lines are before that.
    body: (usize, usize),
}

/// One row of an element.
#[derive(Debug)]
pub struct Row<'a> {
    /// Number of the row, from 0.
    pub index: usize,
    /// 1-based line of the file, where it is text.
    pub line: Option<usize>,
    /// The numbers of all properties, one after the other; of an element without lists one per property.
    pub values: &'a [f64],
    ends: &'a [usize],
}

impl Row<'_> {
    /// The numbers of property number `property`.
    pub fn list(&self, property: usize) -> &[f64] {
        let start = if property == 0 { 0 } else { self.ends[property - 1] };
        &self.values[start..self.ends[property]]
    }
}

impl<'a> PlyFile<'a> {
    /// Reads the header; `what` names what the file should hold ("a mesh"), for messages.
    ///
    /// # Errors
    /// With the line, if the header does not end or has a line that is not understood.
    pub fn parse(path: &'a Path, bytes: &'a [u8], what: &str) -> Result<Self> {
        let remedy = format!("give a complete PLY file of {what}");
        let refuse = |line: usize, what: String| Error::content(path, line, what, &remedy);
        let (mut format, mut elements, mut comments): (_, Vec<Element>, _) = (None, Vec::new(), Vec::new());
        let (mut at, mut line) = (0, 0);
        loop {
            line += 1;
            if line > MOST_LINES {
                return Err(refuse(line, format!("the header has more than {MOST_LINES} lines")));
            }
            let tail = &bytes[at..];
            let end = tail[..tail.len().min(LONGEST_LINE)].iter().position(|&b| b == b'\n').ok_or_else(|| {
                let what =
                    if line == 1 { "the file does not start with `ply`" } else { "the header has no end_header" };
                refuse(line, what.into())
            })?;
            at += end + 1;
            let text = String::from_utf8_lossy(&tail[..end]);
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            if (line == 1) != (words == ["ply"]) {
                return Err(refuse(line, "the file does not start with one line `ply`".into()));
            }
            match (words.as_slice(), elements.last_mut()) {
                (["ply"] | [] | ["obj_info", ..], _) => {}
                (["comment", words @ ..], _) => comments.push(words.join(" ")),
                (["format", name, ..], _) => {
                    format = Some(match *name {
                        "ascii" => Format::Text,
                        "binary_little_endian" => Format::LittleEndian,
                        "binary_big_endian" => Format::BigEndian,
                        _ => return Err(refuse(line, format!("the format `{name}` is unknown"))),
                    });
                }
                (["element", name, count], _) => {
                    let count = count.parse().map_err(|_| refuse(line, format!("`{count}` is no count of {name}")))?;
                    elements.push(Element { name: (*name).into(), count, line, properties: Vec::new() });
                }
                (["property", of @ .., name], Some(element)) => {
                    let (length, scalar) = match of {
                        ["list", length, scalar] => (Scalar::parse(length).map(Some), Scalar::parse(scalar)),
                        [scalar] => (Some(None), Scalar::parse(scalar)),
                        _ => (None, None),
                    };
                    let (Some(length), Some(scalar)) = (length, scalar) else {
                        return Err(refuse(line, format!("the type `{}` of {name} is unknown", of.join(" "))));
                    };
                    if element.properties.iter().any(|p| p.name == *name) {
                        return Err(refuse(line, format!("the property {name} is there twice")));
                    }
                    element.properties.push(Property { name: (*name).into(), scalar, length });
                }
                (["end_header"], _) => break,
                _ => return Err(refuse(line, format!("`{}` is not understood", text.trim()))),
            }
        }
        let format = format.ok_or_else(|| refuse(line, "the header names no format".into()))?;
        Ok(Self { path, bytes, format, elements, comments, body: (at, line) })
    }

    /// The element called `name`.
    pub fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == name)
    }

    /// The vertices, if their rows are plain numbers. `remedy` says what to do where there are none.
    ///
    /// # Errors
    /// If there is no element `vertex`, or its rows have lists.
    pub fn vertices(&self, remedy: &str) -> Result<&Element> {
        let Some(element) = self.element("vertex") else {
            return Err(Error::content(self.path, None, "the header has no element vertex", remedy));
        };
        match element.properties.iter().all(|p| p.length.is_none()) {
            true => Ok(element),
            false => Err(Error::content(self.path, element.line, "the vertices have lists", remedy)),
        }
    }

    /// Reads the rows of `element`, one of [`PlyFile::elements`], in their order.
    ///
    /// # Errors
    /// If the file ends before, a number of a text is none, a list has no length; or what `each` says.
    pub fn rows<E: From<Error>>(
        &self,
        element: &Element,
        mut each: impl FnMut(Row<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        // Rows without bytes could be counted forever.
        if element.properties.is_empty() {
            return Ok(());
        }
        let mut source = Source { file: self, at: self.body.0, line: self.body.1 };
        let (mut values, mut ends) = (Vec::new(), Vec::new());
        for e in &self.elements {
            let wanted = std::ptr::eq(e, element);
            if !wanted && source.skip(e) {
                continue;
            }
            for index in 0..e.count {
                source.row(e, index, &mut values, &mut ends)?;
                if wanted {
                    let line = (self.format == Format::Text).then_some(source.line);
                    each(Row { index, line, values: &values, ends: &ends })?;
                }
            }
            if wanted {
                break;
            }
        }
        Ok(())
    }
}

/// The body of a file, read from its start.
struct Source<'a> {
    file: &'a PlyFile<'a>,
    /// Next byte.
    at: usize,
    /// 1-based line of the row that was read last, in a text.
    line: usize,
}

impl<'a> Source<'a> {
    /// Goes behind all rows of a binary element without lists; says whether it could.
    fn skip(&mut self, e: &Element) -> bool {
        if self.file.format == Format::Text || e.properties.iter().any(|p| p.length.is_some()) {
            return false;
        }
        let size: usize = e.properties.iter().map(|p| p.scalar.size()).sum();
        self.at = size
            .checked_mul(e.count)
            .and_then(|n| self.at.checked_add(n))
            .unwrap_or(usize::MAX)
            .min(self.file.bytes.len());
        true
    }

    /// The numbers of the next row, and where those of each property end.
    fn row(&mut self, e: &Element, index: usize, values: &mut Vec<f64>, ends: &mut Vec<usize>) -> Result<()> {
        values.clear();
        ends.clear();
        let file = self.file;
        let text = file.format == Format::Text;
        let mut words = if text { self.next_line(e, index)? } else { "" }.split_ascii_whitespace();
        let (line, little) = (self.line, file.format == Format::LittleEndian);
        for p in &e.properties {
            let mut number = |scalar: Scalar| {
                if text {
                    return words.next().and_then(|w| w.parse().ok()).ok_or_else(|| {
                        let what = format!("{} {index} has no number for the property {}", e.name, p.name);
                        Error::content(file.path, line, what, "repair the line or fetch the file again")
                    });
                }
                let value = file.bytes.get(self.at..).and_then(|b| scalar.read(b, little));
                self.at += scalar.size();
                value.ok_or_else(|| self.cut_off(e, index))
            };
            let count = match p.length {
                None => 1,
                Some(length) => match number(length)? {
                    // No row can be longer than the file.
                    n if n >= 0.0 && n <= file.bytes.len() as f64 && n.fract() == 0.0 => n as usize,
                    n => {
                        let line = text.then_some(line);
                        let what = format!("{} {index} has a list of {n} values", e.name);
                        return Err(Error::content(file.path, line, what, "export the file again"));
                    }
                },
            };
            for _ in 0..count {
                values.push(number(p.scalar)?);
            }
            ends.push(values.len());
        }
        Ok(())
    }

    fn cut_off(&self, e: &Element, index: usize) -> Error {
        let what = format!("{} rows of {} are announced, but the file ends before number {index}", e.count, e.name);
        let line = if self.file.format == Format::Text { self.line + 1 } else { e.line };
        Error::content(self.file.path, line, what, "fetch the file again: it was cut off")
    }

    /// The next line that is not empty.
    fn next_line(&mut self, e: &Element, index: usize) -> Result<&'a str> {
        loop {
            let tail =
                self.file.bytes.get(self.at..).filter(|t| !t.is_empty()).ok_or_else(|| self.cut_off(e, index))?;
            let line = tail.split(|&b| b == b'\n').next().unwrap_or_default();
            self.at += line.len() + 1;
            self.line += 1;
            if !line.trim_ascii().is_empty() {
                return Ok(std::str::from_utf8(line).unwrap_or_default());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_either_byte_order_are_read() {
        let read = |name: &str, bytes: &[u8], little| Scalar::parse(name).and_then(|s| s.read(bytes, little));
        assert_eq!(read("short", &[0xfe, 0xff], true), Some(-2.0));
        assert_eq!(read("uint16", &[1, 2, 9], false), Some(258.0));
        assert_eq!(read("float", &1.5f32.to_be_bytes(), false), Some(1.5));
        assert_eq!(read("double", &(-0.1f64).to_le_bytes(), true), Some(-0.1));
        assert_eq!(read("int", &[0, 0, 0], true), None, "cut off");
        assert_eq!(read("uchar", &[], true), None);
        assert_eq!(Scalar::parse("half"), None);
    }

    #[test]
    fn rows_behind_lists_are_found_in_text_and_in_bytes() {
        let header = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\ncomment by hand\nelement face 2\nproperty list uchar short corners\nproperty uchar tag\n\
                 element vertex 1\nproperty float x\nend_header\n"
            )
        };
        let text = header("ascii") + "2 4 5 7\n\n0 8\r\n0.5\n";
        let mut binary = header("binary_big_endian").into_bytes();
        binary.extend([2, 0, 4, 0, 5, 7, 0, 8]);
        binary.extend(0.5f32.to_be_bytes());
        for bytes in [text.as_bytes(), &binary] {
            let file = PlyFile::parse(Path::new("a.ply"), bytes, "a mesh").unwrap();
            assert_eq!((file.comments.as_slice(), file.element("edge")), (&["by hand".to_string()][..], None));
            let mut seen = Vec::new();
            for e in &file.elements {
                file.rows::<Error>(e, |row| {
                    seen.push((0..e.properties.len()).map(|k| row.list(k).to_vec()).collect::<Vec<_>>());
                    Ok(())
                })
                .unwrap();
            }
            assert_eq!(seen, [vec![vec![4.0, 5.0], vec![7.0]], vec![vec![], vec![8.0]], vec![vec![0.5]]]);
            let cut = PlyFile::parse(Path::new("a.ply"), &bytes[..bytes.len() - 5], "a mesh").unwrap();
            let message = cut.rows::<Error>(&cut.elements[1], |_| Ok(())).unwrap_err().to_string();
            assert!(message.starts_with("a.ply, line ") && message.contains("cut off"), "{message}");
        }
    }
}
