//! Shapes with known answers, for the tests of the mesh kit.

use std::collections::{BTreeMap, BTreeSet};

use drex_core::TriMesh;
use nalgebra::Point3;

/// Every face divided into four.
pub fn divided(mesh: &TriMesh) -> TriMesh {
    let mut out = TriMesh { vertices: mesh.vertices.clone(), faces: Vec::new() };
    let mut middles = BTreeMap::new();
    for &[a, b, c] in &mesh.faces {
        let mut middle = |i: u32, j: u32| {
            *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                out.vertices.push(nalgebra::center(&mesh.vertices[i as usize], &mesh.vertices[j as usize]));
                out.vertices.len() as u32 - 1
            })
        };
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        out.faces.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
    }
    out
}

/// Octahedron divided `level` times, around the origin.
pub fn sphere(radius: f64, level: usize) -> TriMesh {
    let p = |x: f64, y: f64, z: f64| Point3::new(x, y, z);
    let mut mesh = TriMesh {
        vertices: vec![p(1., 0., 0.), p(-1., 0., 0.), p(0., 1., 0.), p(0., -1., 0.), p(0., 0., 1.), p(0., 0., -1.)],
        faces: vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]],
    };
    for _ in 0..level {
        mesh = divided(&mesh);
        mesh.vertices.iter_mut().for_each(|v| *v = Point3::from(v.coords.normalize()));
    }
    mesh.vertices.iter_mut().for_each(|v| v.coords *= radius);
    mesh
}

/// A ring around z.
pub fn torus(radius: f64, tube: f64, around: u32, across: u32) -> TriMesh {
    let mut mesh = TriMesh::default();
    for i in 0..around {
        for j in 0..across {
            let (u, v) = (f64::from(i) / f64::from(around), f64::from(j) / f64::from(across));
            let (u, v) = (u * std::f64::consts::TAU, v * std::f64::consts::TAU);
            let r = radius + tube * v.cos();
            mesh.vertices.push(Point3::new(r * u.cos(), r * u.sin(), tube * v.sin()));
            let at = |i: u32, j: u32| (i % around) * across + j % across;
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

pub fn flipped(mesh: &TriMesh) -> TriMesh {
    TriMesh { vertices: mesh.vertices.clone(), faces: mesh.faces.iter().map(|&[a, b, c]| [a, c, b]).collect() }
}

/// Every face with corners of its own.
pub fn soup(mesh: &TriMesh) -> TriMesh {
    let vertices = (0..mesh.faces.len()).flat_map(|f| mesh.triangle(f)).collect();
    TriMesh { vertices, faces: (0..mesh.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect() }
}

/// Genus of a closed connected manifold, from its Euler number; panics if an edge has other than two faces.
pub fn genus_of(mesh: &TriMesh) -> i64 {
    let mut edges: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    for f in &mesh.faces {
        for k in 0..3 {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            *edges.entry((a.min(b), a.max(b))).or_default() += 1;
        }
    }
    assert!(edges.values().all(|&n| n == 2), "not a closed manifold");
    let used: BTreeSet<u32> = mesh.faces.iter().flatten().copied().collect();
    let euler = used.len() as i64 - edges.len() as i64 + mesh.faces.len() as i64;
    (2 - euler) / 2
}
