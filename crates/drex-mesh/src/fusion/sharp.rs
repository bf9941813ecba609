//! Edges and corners that marching cubes cut off: vertices near them move onto the intersection of the planes around.

use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

use drex_core::TriMesh;

/// Normals of neighbouring vertices of a flat piece of surface differ by less than this (cosine of 20 degrees).
const FLAT: f64 = 0.94;
/// How far around a vertex its planes are looked for, in edges of the mesh and in voxels.
const RINGS: usize = 4;
const REACH: f64 = 3.0;
/// Samples of planes that are enough.
const ENOUGH: usize = 8;
/// Shares of the normals (eigenvalues) that make another direction: two planes at 40 degrees have 0.12.
const ANOTHER: f64 = 0.1;
/// Largest distance of the samples from their planes (root of the mean square) and largest move, in voxels.
const RESIDUAL: f64 = 0.15;
const FARTHEST: f64 = 0.75;
/// A move must leave every face this area (in squares of the voxel) and this cosine with what it was.
const LEAST_AREA: f64 = 1e-3;
const LEAST_TURN: f64 = 0.2;

/// Moves vertices near edges onto the point that is nearest to the planes of the flat pieces around (the quadric error
/// function of Kobbelt et al., "Feature Sensitive Surface Extraction", 2001). Returns how many were moved.
pub(super) fn snap_edges(mesh: &mut TriMesh, voxel_m: f64) -> usize {
    let around = Around::new(mesh);
    let normals: Vec<Vector3<f64>> = (0..mesh.vertices.len()).into_par_iter().map(|v| around.normal(mesh, v)).collect();
    let flat: Vec<bool> = (0..mesh.vertices.len())
        .into_par_iter()
        .map(|v| around.neighbours(mesh, v).all(|n| normals[n].dot(&normals[v]) > FLAT))
        .collect();
    let targets: Vec<(usize, Point3<f64>)> = (0..mesh.vertices.len())
        .into_par_iter()
        .filter(|&v| !flat[v])
        .filter_map(|v| Some((v, target(mesh, &around, &normals, &flat, v, voxel_m)?)))
        .collect();
    // One after the other, for a move changes what its neighbours may do.
    let before: Vec<Point3<f64>> = mesh.vertices.clone();
    targets.into_iter().filter(|(v, to)| try_move(mesh, &before, around.faces(*v), *v, to, voxel_m)).count()
}

/// The faces at each vertex.
struct Around {
    first: Vec<u32>,
    faces: Vec<u32>,
}

impl Around {
    fn new(mesh: &TriMesh) -> Self {
        let mut first = vec![0u32; mesh.vertices.len() + 1];
        mesh.faces.iter().flatten().for_each(|&v| first[v as usize + 1] += 1);
        for v in 0..mesh.vertices.len() {
            first[v + 1] += first[v];
        }
        let (mut next, mut faces) = (first.clone(), vec![0; 3 * mesh.faces.len()]);
        for (f, face) in mesh.faces.iter().enumerate() {
            for &v in face {
                faces[next[v as usize] as usize] = f as u32;
                next[v as usize] += 1;
            }
        }
        Self { first, faces }
    }

    fn faces(&self, v: usize) -> &[u32] {
        &self.faces[self.first[v] as usize..self.first[v + 1] as usize]
    }

    /// The vertices that share a face with `v`, each twice.
    fn neighbours<'a>(&'a self, mesh: &'a TriMesh, v: usize) -> impl Iterator<Item = usize> + 'a {
        let others = move |&f: &u32| mesh.faces[f as usize].into_iter().map(|n| n as usize).filter(move |&n| n != v);
        self.faces(v).iter().flat_map(others)
    }

    /// Normal by area.
    fn normal(&self, mesh: &TriMesh, v: usize) -> Vector3<f64> {
        let of = |f: &u32| area_vector(&mesh.triangle(*f as usize));
        self.faces(v).iter().map(of).sum::<Vector3<f64>>().try_normalize(0.0).unwrap_or_else(Vector3::zeros)
    }
}

/// Normal times twice the area.
fn area_vector([a, b, c]: &[Point3<f64>; 3]) -> Vector3<f64> {
    (b - a).cross(&(c - a))
}

/// Where the flat pieces around a vertex meet, if they do and it is near.
fn target(
    mesh: &TriMesh,
    around: &Around,
    normals: &[Vector3<f64>],
    flat: &[bool],
    v: usize,
    voxel_m: f64,
) -> Option<Point3<f64>> {
    let here = mesh.vertices[v];
    let mut ring = vec![v];
    let mut start = 0;
    for _ in 0..RINGS {
        let end = ring.len();
        for i in start..end {
            for n in around.neighbours(mesh, ring[i]) {
                if (mesh.vertices[n] - here).norm() < REACH * voxel_m && !ring.contains(&n) {
                    ring.push(n);
                }
            }
        }
        start = end;
    }
    let planes: Vec<usize> = ring.into_iter().filter(|&n| flat[n]).collect();
    if planes.len() < ENOUGH {
        return None;
    }
    let share = 1.0 / planes.len() as f64;
    let offset = |n: usize| (mesh.vertices[n] - here).dot(&normals[n]);
    let spread: Matrix3<f64> = planes.iter().map(|&n| normals[n] * normals[n].transpose() * share).sum();
    let pull: Vector3<f64> = planes.iter().map(|&n| normals[n] * (offset(n) * share)).sum();
    let eigen = spread.symmetric_eigen();
    let directions = (0..3).filter(|&k| eigen.eigenvalues[k] > ANOTHER);
    let (mut shift, mut rank) = (Vector3::zeros(), 0);
    for k in directions {
        let axis = eigen.eigenvectors.column(k);
        shift += axis * (axis.dot(&pull) / eigen.eigenvalues[k]);
        rank += 1;
    }
    let residual = planes.iter().map(|&n| (offset(n) - shift.dot(&normals[n])).powi(2) * share).sum::<f64>().sqrt();
    (rank > 1 && shift.norm() < FARTHEST * voxel_m && residual < RESIDUAL * voxel_m).then(|| here + shift)
}

/// Moves a vertex unless a face at it would vanish or turn over.
fn try_move(
    mesh: &mut TriMesh,
    before: &[Point3<f64>],
    faces: &[u32],
    v: usize,
    to: &Point3<f64>,
    voxel_m: f64,
) -> bool {
    let from = std::mem::replace(&mut mesh.vertices[v], *to);
    let stands = faces.iter().all(|&f| {
        let was = area_vector(&mesh.faces[f as usize].map(|n| before[n as usize]));
        let is = area_vector(&mesh.triangle(f as usize));
        is.norm() > 2.0 * LEAST_AREA * voxel_m * voxel_m && is.dot(&was) > LEAST_TURN * is.norm() * was.norm()
    });
    if !stands {
        mesh.vertices[v] = from;
    }
    stands
}
