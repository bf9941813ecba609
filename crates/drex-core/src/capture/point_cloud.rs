//! Points with colours from a PLY file.

use std::path::Path;

use super::SparsePoint;
use crate::fsutil::read_bytes;
use crate::ply::{PlyFile, Scalar};
use crate::{Error, Result};

/// Reads x, y, z and red, green, blue of the vertices; grey where there is no colour. Colours may be bytes, or numbers
/// from 0 to 1.
pub(super) fn load(path: &Path) -> Result<Vec<SparsePoint>> {
    let bytes = read_bytes(path)?;
    let file = PlyFile::parse(path, &bytes, "points")?;
    let vertices = file.vertices("give a file of points")?;
    let refuse = |line: Option<usize>, what: String| {
        let remedy = "write the points again as a PLY with x, y, z, red, green, blue";
        Error::content(path, line, what, remedy)
    };
    let [Some(x), Some(y), Some(z)] = [["x"], ["y"], ["z"]].map(|names| vertices.column(&names)) else {
        return Err(refuse(vertices.line.into(), "vertices have not x, y and z".into()));
    };
    let names = [["red", "diffuse_red", "r"], ["green", "diffuse_green", "g"], ["blue", "diffuse_blue", "b"]];
    let colour = names.map(|names| vertices.column(&names));
    let is_share = |c: usize| matches!(vertices.properties[c].scalar, Scalar::F32 | Scalar::F64);
    let mut points = Vec::new();
    file.rows(vertices, |row| -> Result<()> {
        let channel = |c: usize| {
            if is_share(c) { (row.values[c] * 255.0).round() as u8 } else { row.values[c] as u8 }
        };
        let rgb = colour.map(|column| column.map_or(128, channel));
        points.push(SparsePoint { position: [x, y, z].map(|c| row.values[c]), rgb, error_px: 0.0, track: Vec::new() });
        Ok(())
    })?;
    match points.iter().position(|p| p.position.iter().any(|v| !v.is_finite())) {
        Some(i) => Err(refuse(None, format!("the position of vertex {i} is not finite"))),
        None => Ok(points),
    }
}
