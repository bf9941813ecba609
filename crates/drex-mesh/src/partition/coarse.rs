//! A coarse stand-in for a fine surface: the search for cuts needs no detail.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};

use drex_core::TriMesh;

/// Faces per vertex that are kept where a surface is folded over itself; a closed surface has 6 at a vertex on average.
const FACES_AT_VERTEX: u8 = 6;

/// The surface with at most `most` vertices: those in one cell of a grid that look in about the same direction become the
/// one that sticks out farthest in it (after Rossignac and Borrel, "Multi-resolution 3D approximations for rendering
/// complex scenes", 1993). The two sides of a wall thinner than a cell stay apart. Ragged scans have layers of faces between
/// the same vertices: then the shortest are kept.
pub(super) fn coarse(surface: &TriMesh, most: usize) -> TriMesh {
    let Some((lo, hi)) = surface.bounds() else { return TriMesh::default() };
    let normals = vertex_normals(surface);
    let mut cell = (hi - lo).norm() / 200.0;
    let mut out = surface.clone();
    while out.vertices.len() > most {
        out = cluster(surface, &normals, &lo, cell);
        cell *= 1.25;
    }
    if out.faces.len() > 3 * out.vertices.len() {
        out.faces = shortest(&out);
    }
    out
}

/// Faces with a corner at which not enough shorter ones meet.
fn shortest(mesh: &TriMesh) -> Vec<[u32; 3]> {
    let longest = |f: usize| {
        let [a, b, c] = mesh.triangle(f);
        (b - a).norm().max((c - b).norm()).max((a - c).norm())
    };
    let mut order: Vec<(f64, usize)> = (0..mesh.faces.len()).map(|f| (longest(f), f)).collect();
    order.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
    let mut met = vec![0u8; mesh.vertices.len()];
    let mut kept = Vec::new();
    for (_, f) in order {
        let face = mesh.faces[f];
        if face.iter().any(|&v| met[v as usize] < FACES_AT_VERTEX) {
            face.iter().for_each(|&v| met[v as usize] = met[v as usize].saturating_add(1));
            kept.push(face);
        }
    }
    kept
}

/// Sums of the faces' vector areas at each vertex, of unit length.
fn vertex_normals(mesh: &TriMesh) -> Vec<Vector3<f64>> {
    let mut normals = vec![Vector3::zeros(); mesh.vertices.len()];
    for (f, face) in mesh.faces.iter().enumerate() {
        let [a, b, c] = mesh.triangle(f);
        let n = (b - a).cross(&(c - a));
        face.iter().for_each(|&v| normals[v as usize] += n);
    }
    normals.iter().map(|n: &Vector3<f64>| n.try_normalize(0.0).unwrap_or_default()).collect()
}

fn cluster(mesh: &TriMesh, normals: &[Vector3<f64>], lo: &Point3<f64>, cell: f64) -> TriMesh {
    // One of 26 directions: a component counts from 22.5 degrees on.
    let direction = |n: &Vector3<f64>| [0, 1, 2].map(|k| i8::from(n[k] > 0.38) - i8::from(n[k] < -0.38));
    let key = |v: usize| ([0, 1, 2].map(|k| ((mesh.vertices[v][k] - lo[k]) / cell) as u32), direction(&normals[v]));
    let mut members: BTreeMap<_, Vec<usize>> = BTreeMap::new();
    for v in 0..mesh.vertices.len() {
        members.entry(key(v)).or_default().push(v);
    }
    let mut number = vec![0; mesh.vertices.len()];
    let mut out = TriMesh::default();
    for group in members.values() {
        let normal: Vector3<f64> = group.iter().map(|&v| normals[v]).sum();
        let height = |v: usize| normal.dot(&mesh.vertices[v].coords);
        let farthest = group.iter().fold(group[0], |best, &v| if height(v) > height(best) { v } else { best });
        group.iter().for_each(|&v| number[v] = out.vertices.len() as u32);
        out.vertices.push(mesh.vertices[farthest]);
    }
    let faces = mesh.faces.iter().map(|f| f.map(|v| number[v as usize]));
    out.faces = faces.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    // Where many thin faces became one, which way it is wound does not matter here.
    out.faces.iter_mut().for_each(|f| f.sort_unstable());
    out.faces.sort_unstable();
    out.faces.dedup();
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{flipped, joined, sphere};

    #[test]
    fn both_sides_of_a_thin_wall_stay_where_they_are() {
        let (outer, inner) = (sphere(0.05, 5), flipped(&sphere(0.048, 5)));
        let few = coarse(&joined(&[outer, inner]), 1000);
        assert!(few.vertices.len() <= 1000 && few.faces.len() > 1000, "{} {}", few.vertices.len(), few.faces.len());
        let out = few.vertices.iter().filter(|p| p.coords.norm() > 0.0499).count();
        let inside = few.vertices.iter().filter(|p| p.coords.norm() < 0.0481).count();
        assert_eq!(out + inside, few.vertices.len());
        assert!(out > few.vertices.len() / 3 && inside > few.vertices.len() / 3);
    }
}
