//! Shapes with known answers, for tests.

use nalgebra::{Point3, Vector3};

use drex_core::TriMesh;

/// Axis-aligned box between two corners.
pub(crate) fn cuboid(lo: [f64; 3], hi: [f64; 3]) -> TriMesh {
    let vertices = (0..8)
        .map(|i| Point3::new([lo[0], hi[0]][i & 1], [lo[1], hi[1]][i >> 1 & 1], [lo[2], hi[2]][i >> 2]))
        .collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces = quads.iter().flat_map(|&[a, b, c, d]: &[u32; 4]| [[a, b, c], [a, c, d]]).collect();
    TriMesh { vertices, faces }
}

/// Octahedron refined `level` times and pushed out to `radius`, around the origin.
pub(crate) fn sphere(radius: f64, level: usize) -> TriMesh {
    let mut vertices: Vec<Vector3<f64>> =
        vec![Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y(), Vector3::z(), -Vector3::z()];
    let mut faces: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..level {
        let mut middle = std::collections::BTreeMap::new();
        let mut next = Vec::new();
        for [a, b, c] in faces {
            let mut mid = |i: u32, j: u32| {
                *middle.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    vertices.push((vertices[i as usize] + vertices[j as usize]).normalize());
                    vertices.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (mid(a, b), mid(b, c), mid(c, a));
            next.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        faces = next;
    }
    TriMesh { vertices: vertices.into_iter().map(|v| (v * radius).into()).collect(), faces }
}

/// Several meshes as one.
pub(crate) fn joined(parts: &[TriMesh]) -> TriMesh {
    let mut out = TriMesh::default();
    parts.iter().for_each(|part| out.append(part));
    out
}

/// The same mesh wound the other way round.
pub(crate) fn flipped(mesh: &TriMesh) -> TriMesh {
    TriMesh { vertices: mesh.vertices.clone(), faces: mesh.faces.iter().map(|&[a, b, c]| [a, c, b]).collect() }
}

/// Point `i` of an additive sequence that fills the unit cube evenly.
pub(crate) fn low_discrepancy(i: usize) -> [f64; 3] {
    crate::sequence::unit_cube_point(i)
}
