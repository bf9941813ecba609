//! Vertices at one place become one; faces that repeat others go.

use nalgebra::Point3;

use drex_core::TriMesh;

use crate::topology::{NONE, Sets};

/// One vertex for all that lie within `tolerance_m` of each other (directly or through others); drops faces that
/// lose a corner or have none. Returns the mesh and how many faces were dropped.
pub(crate) fn weld(mesh: &TriMesh, tolerance_m: f64) -> (TriMesh, usize) {
    let n = mesh.vertices.len();
    let mut order: Vec<u32> = (0..n as u32).collect();
    let key = |i: u32| mesh.vertices[i as usize];
    order.sort_unstable_by(|&i, &j| {
        let (p, q) = (key(i), key(j));
        p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)).then(i.cmp(&j))
    });
    let mut sets = Sets::new(n);
    // Exact twins first: they are the bulk of a triangle soup and sit side by side.
    for w in order.windows(2) {
        if key(w[0]) == key(w[1]) {
            sets.join(w[0], w[1]);
        }
    }
    order.retain(|&i| sets.find(i) == i);
    join_neighbours(&mesh.vertices, &order, tolerance_m, &mut sets);
    let mut number = vec![NONE; n];
    let mut vertices = Vec::new();
    let mut faces = Vec::with_capacity(mesh.faces.len());
    for f in &mesh.faces {
        let roots = f.map(|v| sets.find(v));
        let [a, b, c] = roots.map(|v| mesh.vertices[v as usize]);
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        let height = (b - a).cross(&(c - a)).norm() / longest;
        if roots[0] == roots[1] || roots[1] == roots[2] || roots[2] == roots[0] || !(height > 0.0) {
            continue;
        }
        faces.push(roots.map(|r| {
            if number[r as usize] == NONE {
                number[r as usize] = vertices.len() as u32;
                vertices.push(mesh.vertices[r as usize]);
            }
            number[r as usize]
        }));
    }
    let dropped = mesh.faces.len() - faces.len();
    (TriMesh { vertices, faces }, dropped)
}

/// Joins all pairs of `some` points that are within a tolerance, by a grid of cells twice as wide.
fn join_neighbours(points: &[Point3<f64>], some: &[u32], tolerance_m: f64, sets: &mut Sets) {
    if !(tolerance_m > 0.0) {
        return;
    }
    let cell = |p: &Point3<f64>, shift: [f64; 3]| {
        // Minus zero is another cell than zero.
        [0, 1, 2].map(|k| (((p[k] + shift[k] * tolerance_m) / (2.0 * tolerance_m)).floor() + 0.0).to_bits())
    };
    let mut cells: Vec<([u64; 3], u32)> = some.iter().map(|&i| (cell(&points[i as usize], [0.0; 3]), i)).collect();
    cells.sort_unstable();
    for &i in some {
        let p = &points[i as usize];
        // Only cells that a ball of the tolerance reaches: at most two along each axis.
        let mut near: [[u64; 3]; 8] =
            std::array::from_fn(|c| cell(p, [0, 1, 2].map(|k| if c >> k & 1 == 1 { 1.0 } else { -1.0 })));
        near.sort_unstable();
        for (k, c) in near.iter().enumerate() {
            if k > 0 && near[k - 1] == *c {
                continue;
            }
            let first = cells.partition_point(|e| e.0 < *c);
            for &(_, j) in cells[first..].iter().take_while(|e| e.0 == *c) {
                if j < i && (p - points[j as usize]).norm() <= tolerance_m {
                    sets.join(i, j);
                }
            }
        }
    }
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
    let mut number = vec![NONE; mesh.vertices.len()];
    let mut vertices = Vec::new();
    for v in mesh.faces.iter_mut().flatten() {
        if number[*v as usize] == NONE {
            number[*v as usize] = vertices.len() as u32;
            vertices.push(mesh.vertices[*v as usize]);
        }
        *v = number[*v as usize];
    }
    mesh.vertices = vertices;
}
