//! Clouds of points from files.

use std::path::Path;

use drex_core::npy::{NpyValues, parse_npy};
use drex_core::ply::PlyFile;
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

/// The vertices of a PLY file.
fn ply_points(path: &Path, bytes: &[u8]) -> Result<Vec<Point3<f64>>> {
    let refuse = |what: &str| Error::content(path, None, what, "export the points again as PLY");
    let file = PlyFile::parse(path, bytes, "points")?;
    let element = file.element("vertex").ok_or_else(|| refuse("the file has no element vertex"))?;
    let [Some(x), Some(y), Some(z)] = ["x", "y", "z"].map(|name| element.column(&[name])) else {
        return Err(refuse("vertices without x, y and z"));
    };
    let mut out = Vec::new();
    file.rows::<Error>(element, |row| {
        out.push(Point3::from([x, y, z].map(|k| row.list(k)[0])));
        Ok(())
    })?;
    Ok(out)
}
