//! Normals that are smooth where the surface is, and not across its edges.

use drex_core::TriMesh;
use nalgebra::Vector3;

/// Faces that meet at a larger angle meet at an edge of the object; cosine of 40 degrees.
const SMOOTH: f64 = 0.766;

/// Unit normals of the corners of each face: the mean, by area, over the faces at the vertex that make a small angle with it. Zero for faces
/// without area.
pub(super) fn corner_normals(mesh: &TriMesh) -> Vec<[Vector3<f64>; 3]> {
    let normals: Vec<Vector3<f64>> = (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.triangle(f);
            (b - a).cross(&(c - a))
        })
        .collect();
    let mut corners: Vec<(u32, u32)> =
        mesh.faces.iter().enumerate().flat_map(|(f, face)| face.map(|v| (v, f as u32))).collect();
    corners.sort_unstable();
    let corner = |f: usize, v: u32| {
        let own = normals[f];
        let first = corners.partition_point(|c| c.0 < v);
        let round = corners[first..].iter().take_while(|c| c.0 == v).map(|c| normals[c.1 as usize]);
        let smooth = round.filter(|n| n.dot(&own) >= SMOOTH * n.norm() * own.norm());
        smooth.sum::<Vector3<f64>>().try_normalize(0.0).unwrap_or_default()
    };
    mesh.faces.iter().enumerate().map(|(f, face)| face.map(|v| corner(f, v))).collect()
}
