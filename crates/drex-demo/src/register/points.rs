//! Clouds of points from files.

use std::path::Path;

use drex_core::npy::{NpyValues, parse_npy};
use drex_core::{Error, Result, fsutil};
use nalgebra::Point3;

/// Reads the points of `.obj` (lines `v x y z`, colours behind them are passed over), `.ply` (text, or binary of either byte order), `.npy`
/// (n x 3 and wider) or `.xyz`/`.txt` (one point per line). Units are the file's; points that are not finite are left out.
///
/// # Errors
/// If the file cannot be read, is of another kind or malformed, or holds no points.
pub fn read_points(path: &Path) -> Result<Vec<Point3<f64>>> {
    parse_points(path, &fsutil::read_bytes(path)?)
}

/// Reads a folder of such files, one per frame: the frame is the last number in the file's name (`output_012.obj` is frame 12). Other files are
/// passed over. In the order of the frames.
///
/// # Errors
/// If the folder cannot be read, holds no file of points, two files have the same number, or one has none or is malformed.
pub fn read_point_frames(folder: &Path) -> Result<Vec<(usize, Vec<Point3<f64>>)>> {
    let entries = std::fs::read_dir(folder).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let mut files = Vec::new();
    for entry in entries.map_err(|e| Error::io("read", folder, e))? {
        let path = entry.path();
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        if !matches!(extension.as_str(), "obj" | "ply" | "npy" | "xyz" | "txt") {
            continue;
        }
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let head = stem.trim_end_matches(|c: char| !c.is_ascii_digit());
        let digits = &head[head.trim_end_matches(|c: char| c.is_ascii_digit()).len()..];
        let number: usize = digits
            .parse()
            .map_err(|_| Error::content(&path, None, "the name has no frame number", "name it like points_012.obj"))?;
        files.push((number, path));
    }
    files.sort();
    if let Some(pair) = files.windows(2).find(|w| w[0].0 == w[1].0) {
        let what = format!("two files of frame {}: also {}", pair[0].0, pair[0].1.display());
        return Err(Error::content(&pair[1].1, None, what, "keep the object's points only"));
    }
    if files.is_empty() {
        return Err(Error::content(folder, None, "no file of points", "give one .obj or .ply per frame"));
    }
    files.into_iter().map(|(number, path)| Ok((number, read_points(&path)?))).collect()
}

/// As [`read_points`], from memory.
///
/// # Errors
/// As [`read_points`].
pub fn parse_points(path: &Path, bytes: &[u8]) -> Result<Vec<Point3<f64>>> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let mut points = match extension.as_str() {
        "obj" => text_points(path, bytes, Some("v"))?,
        "xyz" | "txt" => text_points(path, bytes, None)?,
        "ply" => ply_points(path, bytes)?,
        "npy" => npy_points(path, bytes)?,
        _ => {
            let what = format!("points are not read from .{extension}");
            return Err(Error::content(path, None, what, "give .obj, .ply, .npy or .xyz"));
        }
    };
    points.retain(|p| p.iter().all(|v| v.is_finite()));
    if points.is_empty() {
        return Err(Error::content(path, None, "the file holds no points", "check the reconstruction"));
    }
    Ok(points)
}

/// The first three numbers of each line, or of each line that starts with `word`.
fn text_points(path: &Path, bytes: &[u8], word: Option<&str>) -> Result<Vec<Point3<f64>>> {
    let mut out = Vec::new();
    for (i, line) in bytes.split(|b| *b == b'\n').enumerate() {
        let text = String::from_utf8_lossy(line);
        let mut words = text.split(|c: char| c.is_ascii_whitespace() || c == ',').filter(|w| !w.is_empty()).peekable();
        match (word, words.peek()) {
            (_, None) => continue,
            (None, Some(first)) if first.starts_with('#') => continue,
            (Some(word), Some(first)) if *first != word => continue,
            (Some(_), _) => {
                words.next();
            }
            (None, _) => {}
        }
        let numbers: Vec<f64> = words.map_while(|w| w.parse().ok()).take(3).collect();
        let &[x, y, z] = numbers.as_slice() else {
            return Err(Error::content(path, i + 1, "a point needs three numbers", "export the points again"));
        };
        out.push(Point3::new(x, y, z));
    }
    Ok(out)
}

fn npy_points(path: &Path, bytes: &[u8]) -> Result<Vec<Point3<f64>>> {
    let array = parse_npy(path, bytes)?;
    match (&array.values, array.shape.as_slice()) {
        (NpyValues::Numbers(numbers), &[_, columns]) if columns >= 3 => {
            Ok(numbers.chunks_exact(columns).map(|row| Point3::new(row[0], row[1], row[2])).collect())
        }
        _ => Err(Error::content(path, None, "the array is not n x 3", "save one point per row")),
    }
}

/// How the numbers of a PLY file are written.
#[derive(Clone, Copy, PartialEq)]
enum Form {
    Text,
    Little,
    Big,
}

/// The vertices of a PLY file. They must come first, as they do in every file of points.
fn ply_points(path: &Path, bytes: &[u8]) -> Result<Vec<Point3<f64>>> {
    let refuse = |what: String| Error::content(path, None, what, "export the points again as PLY");
    let end = b"end_header";
    let header_end = bytes.windows(end.len()).position(|w| w == end);
    let Some((header, rest)) = header_end.filter(|_| bytes.starts_with(b"ply")).map(|i| bytes.split_at(i)) else {
        return Err(refuse("the file has no PLY header".into()));
    };
    let body = rest.iter().position(|b| *b == b'\n').map_or(&[][..], |i| &rest[i + 1..]);
    let header = String::from_utf8_lossy(header);
    let (mut form, mut count, mut elements) = (None, 0, 0);
    // Byte width of each property of a vertex, and whether it is a float; its place.
    let mut widths: Vec<(usize, bool)> = Vec::new();
    let mut axes = [None; 3];
    for line in header.lines() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["format", "ascii", ..] => form = Some(Form::Text),
            ["format", "binary_little_endian", ..] => form = Some(Form::Little),
            ["format", "binary_big_endian", ..] => form = Some(Form::Big),
            ["element", name, n] => {
                elements += 1;
                if *name == "vertex" && elements == 1 {
                    count = n.parse().map_err(|_| refuse(format!("`{line}` is no count")))?;
                } else if elements == 1 {
                    return Err(refuse("the vertices do not come first".into()));
                }
            }
            ["property", "list", ..] if elements == 1 => return Err(refuse("vertices with lists".into())),
            ["property", kind, name] if elements == 1 => {
                if let Some(axis) = ["x", "y", "z"].iter().position(|a| a == name) {
                    axes[axis] = Some(widths.len());
                }
                widths.push(width_of(kind).ok_or_else(|| refuse(format!("the type {kind} is not known")))?);
            }
            _ => {}
        }
    }
    let (Some(form), [Some(x), Some(y), Some(z)]) = (form, axes) else {
        return Err(refuse("no format, or vertices without x, y and z".into()));
    };
    let mut out = Vec::new();
    if form == Form::Text {
        let text = String::from_utf8_lossy(body);
        for line in text.lines().filter(|l| !l.trim().is_empty()).take(count) {
            let numbers: Vec<Option<f64>> = line.split_ascii_whitespace().map(|w| w.parse().ok()).collect();
            let at = |i: usize| numbers.get(i).copied().flatten();
            let (Some(x), Some(y), Some(z)) = (at(x), at(y), at(z)) else {
                return Err(refuse(format!("`{}` is no vertex", line.chars().take(60).collect::<String>())));
            };
            out.push(Point3::new(x, y, z));
        }
    } else {
        let row: usize = widths.iter().map(|(w, _)| w).sum();
        let offset = |i: usize| widths[..i].iter().map(|(w, _)| w).sum::<usize>();
        if ![x, y, z].iter().all(|&i| widths[i].1) {
            return Err(refuse("x, y and z are not floats".into()));
        }
        let number = |row: &[u8], i: usize| {
            let bytes = &row[offset(i)..offset(i) + widths[i].0];
            match (<[u8; 8]>::try_from(bytes), <[u8; 4]>::try_from(bytes)) {
                (Ok(b), _) => {
                    if form == Form::Big {
                        f64::from_be_bytes(b)
                    } else {
                        f64::from_le_bytes(b)
                    }
                }
                (_, Ok(b)) => f64::from(if form == Form::Big { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) }),
                _ => f64::NAN,
            }
        };
        out.extend(body.chunks_exact(row).take(count).map(|r| Point3::new(number(r, x), number(r, y), number(r, z))));
    }
    if out.len() != count {
        return Err(refuse(format!("{} vertices where the header says {count}", out.len())));
    }
    Ok(out)
}

/// Width in bytes of a PLY type, and whether it is a float.
fn width_of(kind: &str) -> Option<(usize, bool)> {
    Some(match kind {
        "char" | "int8" | "uchar" | "uint8" => (1, false),
        "short" | "int16" | "ushort" | "uint16" => (2, false),
        "int" | "int32" | "uint" | "uint32" => (4, false),
        "float" | "float32" => (4, true),
        "double" | "float64" => (8, true),
        _ => return None,
    })
}
