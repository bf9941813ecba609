//! Meshes in PLY files: vertices with or without colours, and faces; other elements and properties are skipped.

use std::path::Path;

use nalgebra::Point3;

use drex_core::TriMesh;
use drex_core::mesh::polygon_triangles;
use drex_core::ply::{PlyFile, Scalar};

use crate::Result;

/// The mesh, and the colours of its vertices if it has red, green and blue.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<(TriMesh, Option<Vec<[u8; 3]>>)> {
    let refuse =
        |line: Option<usize>, what: String| drex_core::Error::content(path, line, what, "export the file again");
    let file = PlyFile::parse(path, bytes, "a mesh")?;
    let mut mesh = TriMesh::default();
    let mut colors = Vec::new();
    if let Some(element) = file.element("vertex") {
        let [Some(x), Some(y), Some(z)] = ["x", "y", "z"].map(|name| element.column(&[name])) else {
            return Err(refuse(Some(element.line), "the vertices have no x, y, z".into()).into());
        };
        let names = [["red", "diffuse_red"], ["green", "diffuse_green"], ["blue", "diffuse_blue"]];
        let channels = match names.map(|names| element.column(&names)) {
            [Some(r), Some(g), Some(b)] => Some([r, g, b]),
            _ => None,
        };
        file.rows::<crate::Error>(element, |row| {
            let point = Point3::from([x, y, z].map(|k| row.list(k)[0]));
            if point.iter().any(|c| !c.is_finite()) {
                return Err(refuse(row.line, format!("vertex {} is not finite", row.index)).into());
            }
            mesh.vertices.push(point);
            colors.extend(channels.map(|c| c.map(|k| byte(row.list(k)[0], element.properties[k].scalar))));
            Ok(())
        })?;
    }
    if let Some(element) = file.element("face") {
        let is_corners = |name: &str| matches!(name, "vertex_indices" | "vertex_index");
        let corners = element.properties.iter().position(|p| p.length.is_some() && is_corners(&p.name));
        file.rows::<crate::Error>(element, |row| {
            let corners = corners.map_or(&[][..], |k| row.list(k));
            if let Some(c) = corners.iter().find(|c| !(**c >= 0.0 && **c < f64::from(u32::MAX) && c.fract() == 0.0)) {
                return Err(refuse(row.line, format!("face {} names vertex {c}", row.index)).into());
            }
            mesh.faces.extend(polygon_triangles(corners.len()).iter().map(|t| t.map(|k| corners[k] as u32)));
            Ok(())
        })?;
    }
    // What is behind the faces is not used, but a file that ends within it was cut off.
    if let Some(last) = file.elements.last().filter(|e| e.name != "vertex" && e.name != "face") {
        file.rows::<crate::Error>(last, |_| Ok(()))?;
    }
    if let Some(f) = mesh.faces.iter().position(|f| f.iter().any(|&v| v as usize >= mesh.vertices.len())) {
        let what = format!("triangle {f} names a vertex beyond the {} there are", mesh.vertices.len());
        return Err(refuse(None, what).into());
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
