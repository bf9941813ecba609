//! Triangle meshes from STL and OBJ files: positions and faces, nothing else.

use std::collections::HashMap;
use std::path::Path;

use drex_core::TriMesh;
use drex_core::mesh::polygon_triangles;
use nalgebra::{Point3, Vector3};

use crate::{Error, Result};

/// Reads a mesh in the units and the frame of its file.
pub(crate) fn read_mesh(path: &Path) -> Result<TriMesh> {
    let bytes = drex_core::fsutil::read_bytes(path)?;
    let extension = path.extension().map(|e| e.to_ascii_lowercase()).unwrap_or_default();
    let mesh = match extension.to_str() {
        Some("stl") => read_stl(&bytes, path)?,
        Some("obj") => read_obj(&bytes, path)?,
        _ => return Err(Error::mesh(path, "only STL and OBJ meshes are read", "convert the mesh to one of them")),
    };
    if mesh.faces.is_empty() {
        return Err(Error::mesh(path, "the mesh has no faces", "check that this is the right file"));
    }
    TriMesh::new(mesh.vertices, mesh.faces).map_err(|e| Error::mesh(path, e.to_string(), "export the mesh again"))
}

fn read_stl(bytes: &[u8], path: &Path) -> Result<TriMesh> {
    let binary_faces = bytes.get(80..84).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let corners = match binary_faces {
        Some(n) if n.checked_mul(50).and_then(|s| s.checked_add(84)) == Some(bytes.len()) => binary_stl_corners(bytes),
        _ if bytes.trim_ascii_start().starts_with(b"solid") => ascii_stl_corners(bytes, path)?,
        _ => {
            return Err(Error::mesh(
                path,
                "neither a binary STL of the length it announces nor a text STL",
                "export the mesh again",
            ));
        }
    };
    // STL repeats every corner: equal positions become one vertex.
    let mut mesh = TriMesh::default();
    let mut index: HashMap<[u64; 3], u32> = HashMap::new();
    for triangle in corners.chunks_exact(3) {
        let face = [0, 1, 2].map(|k| {
            let p = triangle[k];
            // Adding zero turns -0.0 into 0.0, so that the two weld.
            *index.entry([p.x, p.y, p.z].map(|c| (c + 0.0).to_bits())).or_insert_with(|| {
                mesh.vertices.push(p);
                mesh.vertices.len() as u32 - 1
            })
        });
        if face[0] != face[1] && face[1] != face[2] && face[2] != face[0] {
            mesh.faces.push(face);
        }
    }
    Ok(mesh)
}

fn binary_stl_corners(bytes: &[u8]) -> Vec<Point3<f64>> {
    let mut corners = Vec::with_capacity((bytes.len() - 84) / 50 * 3);
    for record in bytes[84..].chunks_exact(50) {
        for corner in record[12..48].chunks_exact(12) {
            let c = |k: usize| f64::from(f32::from_le_bytes([corner[k], corner[k + 1], corner[k + 2], corner[k + 3]]));
            corners.push(Point3::new(c(0), c(4), c(8)));
        }
    }
    corners
}

fn ascii_stl_corners(bytes: &[u8], path: &Path) -> Result<Vec<Point3<f64>>> {
    let text = String::from_utf8_lossy(bytes);
    let mut corners = Vec::new();
    for (i, line) in text.lines().enumerate() {
        if let Some(rest) = line.trim_start().strip_prefix("vertex") {
            corners.push(point(rest, path, i)?);
        }
    }
    if corners.len() % 3 != 0 {
        return Err(Error::mesh(
            path,
            format!("{} corners do not make triangles", corners.len()),
            "export the mesh again",
        ));
    }
    Ok(corners)
}

fn read_obj(bytes: &[u8], path: &Path) -> Result<TriMesh> {
    let text = String::from_utf8_lossy(bytes);
    let mut mesh = TriMesh::default();
    for (i, line) in text.lines().enumerate() {
        let Some((tag, rest)) = line.trim_start().split_once(|c: char| c.is_ascii_whitespace()) else { continue };
        match tag {
            "v" => mesh.vertices.push(point(rest, path, i)?),
            "f" => {
                let corners = rest
                    .split_ascii_whitespace()
                    .map(|word| corner(word, mesh.vertices.len()).ok_or(word))
                    .collect::<Result<Vec<u32>, _>>()
                    .map_err(|word| {
                        Error::mesh(
                            path,
                            format!("line {}: \"{word}\" names no vertex before it", i + 1),
                            "export the mesh again",
                        )
                    })?;
                mesh.faces.extend(polygon_triangles(corners.len()).iter().map(|t| t.map(|k| corners[k])));
            }
            _ => {}
        }
    }
    Ok(mesh)
}

/// Zero-based vertex of a face corner such as `7`, `7/1/2` or `-1` (counted from the end).
fn corner(word: &str, vertices: usize) -> Option<u32> {
    let number: i64 = word.split('/').next()?.parse().ok()?;
    let index = if number < 0 { number.checked_add(i64::try_from(vertices).ok()?)? } else { number - 1 };
    (index >= 0 && (index as usize) < vertices).then(|| u32::try_from(index).ok())?
}

fn point(words: &str, path: &Path, line: usize) -> Result<Point3<f64>> {
    let mut numbers = words.split_ascii_whitespace().map(str::parse::<f64>);
    match (numbers.next(), numbers.next(), numbers.next()) {
        (Some(Ok(x)), Some(Ok(y)), Some(Ok(z))) => Ok(Point3::new(x, y, z)),
        _ => {
            Err(Error::mesh(path, format!("line {}: a vertex is not three numbers", line + 1), "export the mesh again"))
        }
    }
}

/// The mesh with every vertex multiplied by `scale`; a mirroring scale turns the faces around so that they stay outward.
pub(crate) fn scaled(mut mesh: TriMesh, scale: &Vector3<f64>) -> TriMesh {
    for v in &mut mesh.vertices {
        v.coords.component_mul_assign(scale);
    }
    if scale.product() < 0.0 {
        for f in &mut mesh.faces {
            f.swap(1, 2);
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn obj_polygons_negative_indices_and_texture_corners() {
        let text = "v 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 1 1 0\nv 0 1 0\nf 1/1 2/2/2 3//3 -1\n";
        let mesh = read_obj(text.as_bytes(), Path::new("a.obj")).unwrap();
        assert_eq!(mesh.faces, vec![[0, 1, 2], [0, 2, 3]]);
        for bad in ["v 0 0\n", "v 0 0 0\nf 1 2 3\n", "f 0 0 0\n", "v 0 0 0\nf 1 1 -9223372036854775808\n"] {
            assert!(read_obj(bad.as_bytes(), Path::new("a.obj")).is_err(), "{bad}");
        }
    }

    #[test]
    fn text_and_binary_stl_weld_to_the_same_mesh() {
        let corners =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0f32]];
        let mut text = String::from("solid a\n");
        let mut binary = vec![0u8; 80];
        binary.extend(2u32.to_le_bytes());
        for t in corners.chunks(3) {
            binary.extend([0; 12]);
            for c in t {
                text += &format!("  vertex {} {} {}\n", c[0], c[1], c[2]);
                c.iter().for_each(|v| binary.extend(v.to_le_bytes()));
            }
            binary.extend([0; 2]);
        }
        let a = read_stl(text.as_bytes(), Path::new("a.stl")).unwrap();
        let b = read_stl(&binary, Path::new("a.stl")).unwrap();
        assert_eq!(a, b);
        assert_eq!((a.vertices.len(), a.faces.len()), (4, 2));
        assert!(read_stl(&binary[..100], Path::new("a.stl")).is_err());
    }

    #[test]
    fn mirroring_keeps_the_volume_positive() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
        let mesh = read_obj(text.as_bytes(), Path::new("a.obj")).unwrap();
        let mirrored = scaled(mesh, &Vector3::new(-2.0, 1.0, 1.0));
        let volume = mirrored.mass_properties(1.0).unwrap().mass_kg;
        assert!((volume - 2.0 / 6.0).abs() < 1e-12);
    }
}
