//! Points with colours from a PLY file.

use std::path::Path;

use drex_core::fsutil::read_bytes;
use drex_core::ply::Scalar;

use super::SparsePoint;
use crate::Result;
use crate::io::ply_table::Header;

/// Reads x, y, z and red, green, blue of the vertices; grey where there is no colour. Colours may be bytes, or numbers
/// from 0 to 1.
pub(super) fn load(path: &Path) -> Result<Vec<SparsePoint>> {
    let bytes = read_bytes(path)?;
    let header = Header::parse(path, &bytes, "points")?;
    let vertices = header.vertices();
    let refuse = |line: Option<usize>, what: String| {
        let remedy = "write the points again as a PLY with x, y, z, red, green, blue";
        drex_core::Error::content(path, line, what, remedy)
    };
    let [Some(x), Some(y), Some(z)] = [["x"], ["y"], ["z"]].map(|names| vertices.column(&names)) else {
        return Err(refuse(vertices.line.into(), "vertices have not x, y and z".into()).into());
    };
    let names = [["red", "diffuse_red", "r"], ["green", "diffuse_green", "g"], ["blue", "diffuse_blue", "b"]];
    let colour = names.map(|names| vertices.column(&names));
    let columns: Vec<usize> = [x, y, z].into_iter().chain(colour.into_iter().flatten()).collect();
    let is_share = |c: usize| matches!(vertices.properties[c].scalar, Some(Scalar::F32 | Scalar::F64));
    let mut points = Vec::new();
    header.each_row(path, &bytes, &columns, &mut |row| {
        let mut channels = row[3..].iter();
        let rgb = colour.map(|column| {
            let Some((c, &value)) = column.and_then(|c| Some((c, channels.next()?))) else { return 128 };
            if is_share(c) { (value * 255.0).round() as u8 } else { value as u8 }
        });
        points.push(SparsePoint { position: [row[0], row[1], row[2]], rgb, error_px: 0.0, track: Vec::new() });
    })?;
    match points.iter().position(|p| p.position.iter().any(|v| !v.is_finite())) {
        Some(i) => Err(refuse(None, format!("the position of vertex {i} is not finite")).into()),
        None => Ok(points),
    }
}
