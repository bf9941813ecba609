//! Vertices at one place become one; faces that repeat others go.

use drex_core::TriMesh;
use drex_core::mesh::coincident;

/// One vertex for all that lie within `tolerance_m` of each other (directly or through others); drops faces that
/// lose a corner or have none. Returns the mesh and how many faces were dropped.
pub(crate) fn weld(mesh: &TriMesh, tolerance_m: f64) -> (TriMesh, usize) {
    let mut places = coincident(&mesh.vertices, tolerance_m);
    let faces = mesh.faces.iter().map(|f| f.map(|v| places.find(v))).filter(|roots| {
        let [a, b, c] = roots.map(|v| mesh.vertices[v as usize]);
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        let height = (b - a).cross(&(c - a)).norm() / longest;
        roots[0] != roots[1] && roots[1] != roots[2] && roots[2] != roots[0] && height > 0.0
    });
    let welded = TriMesh::of_faces(&mesh.vertices, faces);
    let dropped = mesh.faces.len() - welded.faces.len();
    (welded, dropped)
}

/// Drops faces that repeat another one; where most of the mesh is there facing both ways, also the second sides.
pub(crate) fn drop_duplicates(mesh: &mut TriMesh) -> usize {
    let before = mesh.faces.len();
    let canonical = |f: &[u32; 3]| {
        let k = (0..3).min_by_key(|&k| f[k]).unwrap_or(0);
        [f[k], f[(k + 1) % 3], f[(k + 2) % 3]]
    };
    keep_first_of_each(mesh, canonical);
    let mut known: Vec<[u32; 3]> = mesh.faces.iter().map(canonical).collect();
    known.sort_unstable();
    let (mut total, mut doubled) = (0.0, 0.0);
    for (i, f) in mesh.faces.iter().enumerate() {
        let [a, b, c] = mesh.triangle(i);
        let area = (b - a).cross(&(c - a)).norm();
        total += area;
        if known.binary_search(&canonical(&[f[0], f[2], f[1]])).is_ok() {
            doubled += area;
        }
    }
    if doubled > 0.5 * total {
        keep_first_of_each(mesh, |f| {
            let mut key = *f;
            key.sort_unstable();
            key
        });
    }
    before - mesh.faces.len()
}

/// Keeps the first face of those with equal keys.
fn keep_first_of_each(mesh: &mut TriMesh, key: impl Fn(&[u32; 3]) -> [u32; 3]) {
    let mut keyed: Vec<([u32; 3], u32)> = mesh.faces.iter().map(key).zip(0..).collect();
    keyed.sort_unstable();
    let mut keep = vec![true; mesh.faces.len()];
    keyed.windows(2).filter(|w| w[0].0 == w[1].0).for_each(|w| keep[w[1].1 as usize] = false);
    let mut kept = keep.iter();
    mesh.faces.retain(|_| kept.next().is_some_and(|k| *k));
}

/// Forgets vertices that no face uses.
pub(crate) fn compact(mesh: &mut TriMesh) {
    *mesh = TriMesh::of_faces(&mesh.vertices, std::mem::take(&mut mesh.faces));
}
