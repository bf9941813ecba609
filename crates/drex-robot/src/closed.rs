//! Closedness of a mesh: what decides which solid a mesh stands for.

use std::collections::{BTreeSet, HashMap};
use std::f64::consts::PI;

use drex_core::TriMesh;
use drex_core::mesh::coincident;
use nalgebra::Point3;

/// Vertices nearer than this fraction of the mesh's extent are one point: files round, and split vertices at seams.
const SAME_POINT: f64 = 1e-6;
/// A mesh whose openings could hide at most this share of its volume counts as closed.
const HIDDEN_VOLUME: f64 = 0.01;

/// Whether the mesh bounds a solid: every edge is used as often in one direction as in the other, but for openings so
/// small that the volume behind them does not matter. An opening of rim length L has at most area L²/4π, and
/// closing it changes the volume by at most a third of that times the extent.
pub(crate) fn is_closed(mesh: &TriMesh) -> bool {
    let Some((lo, hi)) = mesh.bounds() else { return false };
    let extent = (hi - lo).norm();
    let rim = open_rim(mesh, SAME_POINT * extent);
    rim * rim * extent / (12.0 * PI) <= HIDDEN_VOLUME * volume(mesh, &nalgebra::center(&lo, &hi)).abs()
}

fn volume(mesh: &TriMesh, reference: &Point3<f64>) -> f64 {
    (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.triangle(f).map(|p| p - reference);
            a.dot(&b.cross(&c)) / 6.0
        })
        .sum()
}

/// Total length of the edges that are not used equally often both ways.
fn open_rim(mesh: &TriMesh, tolerance: f64) -> f64 {
    let mut places = coincident(&mesh.vertices, tolerance);
    let mut balance: HashMap<(u32, u32), i32> = HashMap::with_capacity(mesh.faces.len() * 2);
    for face in &mesh.faces {
        let f = face.map(|v| places.find(v));
        for (a, b) in [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])] {
            if a != b {
                *balance.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
    }
    // Sorted, so that the sum does not depend on the map's order.
    let open: BTreeSet<(u32, u32)> = balance.into_iter().filter(|(_, n)| *n != 0).map(|(edge, _)| edge).collect();
    open.iter().map(|&(a, b)| (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm()).sum()
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// A spiral on the unit ball: no two points alike.
    fn ball(n: usize) -> Vec<Point3<f64>> {
        let point = |k: usize| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / n as f64;
            let (sin, cos) = (2.4 * k as f64).sin_cos();
            Point3::from(Vector3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z))
        };
        (0..n).map(point).collect()
    }

    #[test]
    fn cracks_from_rounding_do_not_open_a_mesh_but_holes_do() {
        let hull = drex_core::mesh::convex_hull(&ball(200)).unwrap();
        // Every face with vertices of its own, rounded apart.
        let mut cracked = TriMesh::default();
        for f in 0..hull.faces.len() {
            for (k, p) in hull.triangle(f).iter().enumerate() {
                cracked.vertices.push(p + Vector3::new(1e-8, -1e-8, 1e-8) * (((f + k) % 5) as f64));
            }
            let n = cracked.vertices.len() as u32;
            cracked.faces.push([n - 3, n - 2, n - 1]);
        }
        assert!(is_closed(&cracked));
        let mut holed = hull.clone();
        holed.faces.truncate(hull.faces.len() - 40);
        assert!(!is_closed(&holed));
        // A pipe: its openings cancel in the sum of area vectors, but it is open.
        let ring =
            |z: f64| (0..32).map(move |k| (k as f64 * PI / 16.0).sin_cos()).map(move |(s, c)| Point3::new(c, s, z));
        let pipe = TriMesh {
            vertices: ring(0.0).chain(ring(3.0)).collect(),
            faces: (0..32u32)
                .flat_map(|k| [[k, (k + 1) % 32, 32 + (k + 1) % 32], [k, 32 + (k + 1) % 32, 32 + k]])
                .collect(),
        };
        assert!(!is_closed(&pipe));
    }
}
