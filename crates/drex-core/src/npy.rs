//! Arrays of NumPy (`.npy`, NEP 1): numbers of any width and byte order, either memory order, and short texts.

use std::path::Path;

use crate::{Error, Result, budget, fsutil};

/// An array as it stood in the file, in C order (the last index runs fastest).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct NpyArray {
    /// Length of each dimension; none for a single value.
    pub shape: Vec<usize>,
    /// NumPy's name of the type, as `<f8`.
    pub descr: String,
    /// The content.
    pub values: NpyValues,
}

/// What an array holds.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum NpyValues {
    /// Floats, integers and truth values (0 and 1), as `f64`.
    Numbers(Vec<f64>),
    /// Texts (`U` and `S`), without the padding.
    Texts(Vec<String>),
}

impl NpyArray {
    /// The numbers in C order; `None` for texts.
    pub fn numbers(&self) -> Option<&[f64]> {
        match &self.values {
            NpyValues::Numbers(v) => Some(v),
            NpyValues::Texts(_) => None,
        }
    }

    /// The first text; `None` for numbers.
    pub fn text(&self) -> Option<&str> {
        match &self.values {
            NpyValues::Texts(v) => v.first().map(String::as_str),
            NpyValues::Numbers(_) => None,
        }
    }
}

/// Reads an array from the bytes of `path`. What a shape announces is never allocated unless the bytes are there. Complex numbers, records and
/// pickled objects are refused.
///
/// # Errors
/// If the bytes are no npy array, its type is not known, or there are more or fewer bytes than its shape says.
pub fn parse_npy(path: &Path, bytes: &[u8]) -> Result<NpyArray> {
    let refuse = |what: String| Error::content(path, None, what, "save a plain array with numpy.save");
    let (header, data) = split_npy(bytes).ok_or_else(|| refuse("the file is no npy array".into()))?;
    let descr = field(header, "descr").map(|d| d.trim_matches(|c| matches!(c, '\'' | '"'))).unwrap_or("unknown");
    if descr.ends_with('O') {
        return Err(Error::content(
            path,
            None,
            "the array holds pickled Python objects, which are never unpacked",
            "save it as numbers: numpy.save(FILE, numpy.asarray(the_array.tolist(), dtype=float))",
        ));
    }
    let kind =
        Kind::parse(descr).ok_or_else(|| refuse(format!("the numbers are of type {descr}, which is not read")))?;
    let shape: Vec<usize> = field(header, "shape")
        .and_then(|s| {
            let inner = s.strip_prefix('(')?.strip_suffix(')')?;
            inner.split(',').map(str::trim).filter(|n| !n.is_empty()).map(|n| n.parse().ok()).collect()
        })
        .ok_or_else(|| refuse("the array has no readable shape".into()))?;
    let count = shape.iter().try_fold(1_usize, |n, &d| n.checked_mul(d));
    if count.and_then(|n| n.checked_mul(kind.size)) != Some(data.len()) {
        let lengths = shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ");
        return Err(refuse(format!("{} bytes of data do not make {lengths} numbers", data.len())));
    }
    let fortran = match field(header, "fortran_order") {
        Some("True") => true,
        Some("False") => false,
        _ => return Err(refuse("the memory order of the array is not stated".into())),
    };
    // As read, and once more where the order of memory is turned; a text has a list of its own.
    let each = if matches!(kind.class, b'U' | b'S') { 56 } else { 16 };
    budget::allow(
        path,
        format_args!("{} items", data.len() / kind.size.max(1)),
        (data.len() / kind.size.max(1)) as u64 * each,
    )?;
    // Items without bytes (empty texts) would have any number of items in no data.
    let items = data.chunks_exact(kind.size.max(1));
    let values = match kind.class {
        b'U' | b'S' => NpyValues::Texts(in_c_order(items.map(|b| kind.text(b)).collect(), &shape, fortran)),
        _ => NpyValues::Numbers(in_c_order(items.map(|b| kind.number(b)).collect(), &shape, fortran)),
    };
    Ok(NpyArray { shape, descr: descr.to_owned(), values })
}

/// Writes `values` of this `shape` in single precision.
///
/// # Errors
/// If the shape has another number of values, or the file cannot be written.
pub fn write_npy(path: &Path, shape: &[usize], values: &[f32]) -> Result<()> {
    fsutil::write_atomic(path, &npy_bytes(shape, values)?)
}

/// As [`write_npy`], into memory.
///
/// # Errors
/// If the shape has another number of values, or thousands of axes.
pub fn npy_bytes(shape: &[usize], values: &[f32]) -> Result<Vec<u8>> {
    if shape.iter().try_fold(1usize, |n, &size| n.checked_mul(size)) != Some(values.len()) {
        let what = format!("an array of shape {shape:?} is to hold {} values", values.len());
        return Err(Error::value(what, "give as many values as the shape has"));
    }
    let sizes: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}", sizes.trim_end_matches(' '));
    // Magic, version and length are 10 bytes; the data starts at a multiple of 64, after a line feed.
    let length = (10 + header.len() + 1).next_multiple_of(64) - 10;
    let length_bytes = u16::try_from(length)
        .map_err(|_| Error::value(format!("an array has {} axes", shape.len()), "give an array of fewer axes"))?;
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend(length_bytes.to_le_bytes());
    out.extend(format!("{header:<width$}\n", width = length - 1).into_bytes());
    out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    Ok(out)
}

/// The type of the items.
struct Kind {
    class: u8,
    size: usize,
    big_endian: bool,
}

impl Kind {
    fn parse(descr: &str) -> Option<Self> {
        let (order, rest) = match descr.as_bytes().first()? {
            b'<' | b'|' | b'=' => (false, &descr[1..]),
            b'>' => (true, &descr[1..]),
            _ => (false, descr),
        };
        let class = *rest.as_bytes().first()?;
        let width: usize = rest.get(1..)?.parse().ok()?;
        let size = match (class, width) {
            (b'f', 2 | 4 | 8) | (b'i' | b'u', 1 | 2 | 4 | 8) | (b'b', 1) => width,
            (b'S', 1..) => width,
            (b'U', 1..) => width.checked_mul(4)?,
            _ => return None,
        };
        Some(Self { class, size, big_endian: order })
    }

    fn number(&self, bytes: &[u8]) -> f64 {
        let mut b = [0_u8; 8];
        for (i, slot) in b.iter_mut().take(bytes.len()).enumerate() {
            *slot = if self.big_endian { bytes[bytes.len() - 1 - i] } else { bytes[i] };
        }
        let bits = u64::from_le_bytes(b);
        match (self.class, self.size) {
            (b'f', 8) => f64::from_bits(bits),
            (b'f', 4) => f64::from(f32::from_bits(bits as u32)),
            (b'f', _) => half(bits as u16),
            (b'i', size) => {
                let unused = 64 - 8 * size as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
            (b'b', _) => f64::from(u8::from(bits != 0)),
            _ => bits as f64,
        }
    }

    fn text(&self, bytes: &[u8]) -> String {
        let text: String = if self.class == b'S' {
            String::from_utf8_lossy(bytes).into_owned()
        } else {
            let scalar = |c: &[u8]| char::from_u32(Self { class: b'u', size: 4, ..*self }.number(c) as u32);
            bytes.chunks_exact(4).map(|c| scalar(c).unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
        };
        text.trim_end_matches('\0').to_owned()
    }
}

/// IEEE 754 binary16.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f64::from(bits & 1023));
    sign * match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        e => (1.0 + fraction / 1024.0) * 2f64.powi(e - 15),
    }
}

/// Items of an array in Fortran order (the first index runs fastest) put into C order.
fn in_c_order<T: Clone>(items: Vec<T>, shape: &[usize], fortran: bool) -> Vec<T> {
    if !fortran || shape.len() < 2 || items.is_empty() {
        return items;
    }
    let mut index = vec![0_usize; shape.len()];
    let strides: Vec<usize> = shape
        .iter()
        .scan(1_usize, |stride, &d| {
            let this = *stride;
            *stride *= d;
            Some(this)
        })
        .collect();
    let mut out = Vec::with_capacity(items.len());
    for _ in 0..items.len() {
        out.push(items[index.iter().zip(&strides).map(|(i, s)| i * s).sum::<usize>()].clone());
        for d in (0..shape.len()).rev() {
            index[d] += 1;
            if index[d] < shape[d] {
                break;
            }
            index[d] = 0;
        }
    }
    out
}

/// Header text and data of an npy file.
fn split_npy(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let rest = bytes.strip_prefix(b"\x93NUMPY")?;
    let (version, rest) = rest.split_at_checked(2)?;
    let (length, rest) = match version[0] {
        1 => {
            let (n, rest) = rest.split_at_checked(2)?;
            (usize::from(u16::from_le_bytes(n.try_into().ok()?)), rest)
        }
        2 | 3 => {
            let (n, rest) = rest.split_at_checked(4)?;
            (u32::from_le_bytes(n.try_into().ok()?) as usize, rest)
        }
        _ => return None,
    };
    let (header, data) = rest.split_at_checked(length)?;
    Some((std::str::from_utf8(header).ok()?, data))
}

/// The value of `key` in a flat Python dict literal, as text.
fn field<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let after =
        [format!("'{key}'"), format!("\"{key}\"")].iter().find_map(|k| Some(&header[header.find(k)? + k.len()..]))?;
    let value = after.trim_start().strip_prefix(':')?.trim_start();
    let end = if value.starts_with('(') { value.find(')')? + 1 } else { value.find([',', '}'])? };
    Some(value[..end].trim())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn npy(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let mut header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
        while !(10 + header.len() + 1).is_multiple_of(64) {
            header.push(' ');
        }
        header.push('\n');
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn read(bytes: &[u8]) -> Result<NpyArray> {
        parse_npy(Path::new("a.npy"), bytes)
    }

    #[test]
    fn every_width_and_byte_order_gives_the_same_numbers() {
        let numbers = [1.0, -2.0, 0.5];
        let f8: Vec<u8> = numbers.iter().flat_map(|v: &f64| v.to_be_bytes()).collect();
        let f4: Vec<u8> = numbers.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect();
        let f2: Vec<u8> = [0x3C00_u16, 0xC000, 0x3800].iter().flat_map(|v| v.to_le_bytes()).collect();
        for (descr, data) in [(">f8", f8), ("<f4", f4), ("<f2", f2)] {
            assert_eq!(read(&npy(descr, false, "(3,)", &data)).unwrap().numbers().unwrap(), numbers, "{descr}");
        }
        assert_eq!(read(&npy("|i1", false, "(2,)", &[255, 3])).unwrap().numbers().unwrap(), [-1.0, 3.0]);
        assert_eq!(read(&npy("|u1", false, "(2,)", &[255, 3])).unwrap().numbers().unwrap(), [255.0, 3.0]);
        assert_eq!(read(&npy("|b1", false, "()", &[1])).unwrap().numbers().unwrap(), [1.0]);
        assert_eq!(read(&npy(">i2", false, "(1,)", &[0xFF, 0xFE])).unwrap().numbers().unwrap(), [-2.0]);
    }

    #[test]
    fn half_precision_has_all_its_values() {
        let half = [0x3c00u16, 0xc100, 0x0001, 0x7c00, 0x7bff].map(u16::to_le_bytes);
        let array = read(&npy("<f2", false, "(5,)", half.as_flattened())).unwrap();
        assert_eq!(array.numbers().unwrap(), [1.0, -2.5, 2f64.powi(-24), f64::INFINITY, 65504.0]);
        assert_eq!(read(&npy("|u1", false, "(2, 0)", &[])).unwrap().shape, [2, 0]);
    }

    #[test]
    fn what_is_written_is_read_and_starts_as_numpy_wants() {
        let values: Vec<f32> = (0..24).map(|i| i as f32 * 0.1 - 1.0).collect();
        for shape in [vec![4, 6], vec![2, 4, 3], vec![24], vec![24, 1, 1]] {
            let bytes = npy_bytes(&shape, &values).unwrap();
            assert_eq!((bytes.len() - 96) % 64, 0);
            let array = read(&bytes).unwrap();
            assert_eq!(array.shape, shape);
            assert!(array.numbers().unwrap().iter().zip(&values).all(|(a, b)| *a as f32 == *b));
        }
        let header = b"\x93NUMPY\x01\0v\0{'descr': '<f4', 'fortran_order': False, 'shape': (24,), }";
        assert!(npy_bytes(&[24], &values).unwrap().starts_with(header));
        assert!(npy_bytes(&[], &values[..1]).unwrap().windows(11).any(|w| w == b"'shape': ()"));
        assert!(npy_bytes(&[5, 5], &values).is_err() && npy_bytes(&[usize::MAX, 2], &values).is_err());
    }

    #[test]
    fn fortran_order_is_turned_into_c_order() {
        // a[i, j, k] = 100 i + 10 j + k of shape (2, 3, 2), first index fastest.
        let mut data = Vec::new();
        for k in 0..2 {
            for j in 0..3 {
                for i in 0..2 {
                    data.extend((100.0 * f64::from(i) + 10.0 * f64::from(j) + f64::from(k)).to_le_bytes());
                }
            }
        }
        let array = read(&npy("<f8", true, "(2, 3, 2)", &data)).unwrap();
        assert_eq!(
            array.numbers().unwrap(),
            [0.0, 1.0, 10.0, 11.0, 20.0, 21.0, 100.0, 101.0, 110.0, 111.0, 120.0, 121.0]
        );
    }

    #[test]
    fn texts_lose_their_padding() {
        let data: Vec<u8> = "left\0".chars().flat_map(|c| (c as u32).to_le_bytes()).collect();
        assert_eq!(read(&npy("<U5", false, "()", &data)).unwrap().text(), Some("left"));
        assert_eq!(read(&npy("|S5", false, "(1,)", b"left\0")).unwrap().text(), Some("left"));
    }

    #[test]
    fn what_is_no_plain_array_is_refused() {
        let refused = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
        assert!(refused(b"not an array").contains("no npy array"));
        assert!(refused(&npy("|O", false, "(1,)", &[0; 8])).contains("pickled"));
        assert!(refused(&npy("<c16", false, "(1,)", &[0; 16])).contains("<c16"));
        assert!(refused(&npy("<f8", false, "(9223372036854775807, 21, 3)", &[0; 32])).contains("32 bytes"));
        assert!(refused(&npy("<U0", false, "(1000000000000,)", &[])).contains("<U0"));
        assert!(refused(&npy("<f8", false, "(2,)", &[0; 15])).contains("15 bytes"));
        assert!(refused(&npy("<f8", false, "(-1,)", &[])).contains("shape"));
    }
}
