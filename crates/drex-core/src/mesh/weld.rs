//! Vertices at one place.

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::TriMesh;
use crate::sets::DisjointSets;

impl TriMesh {
    /// The mesh of `faces` over `vertices` with those vertices alone that a face names, numbered in the order of their first use.
    /// Every face names vertices that there are.
    pub fn of_faces(vertices: &[Point3<f64>], faces: impl IntoIterator<Item = [u32; 3]>) -> Self {
        let mut number = BTreeMap::new();
        let mut mesh = Self::default();
        for face in faces {
            mesh.faces.push(face.map(|v| {
                *number.entry(v).or_insert_with(|| {
                    mesh.vertices.push(vertices[v as usize]);
                    mesh.vertices.len() as u32 - 1
                })
            }));
        }
        mesh
    }

    /// Adds the vertices and faces of `other`.
    pub fn append(&mut self, other: &Self) {
        let base = self.vertices.len() as u32;
        self.vertices.extend(&other.vertices);
        self.faces.extend(other.faces.iter().map(|f| f.map(|v| v + base)));
    }
}

/// Sets of `points` that lie within `tolerance_m` of each other, directly or through others; with 0 those of the same coordinates.
pub fn coincident(points: &[Point3<f64>], tolerance_m: f64) -> DisjointSets {
    // Adding zero makes one of the two zeros.
    let key = |i: u32| points[i as usize].coords.map(|c| c + 0.0);
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_unstable_by(|&i, &j| {
        let (p, q) = (key(i), key(j));
        p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)).then(i.cmp(&j))
    });
    let mut sets = DisjointSets::new(points.len());
    // Exact twins first: they are the bulk of a triangle soup and sit side by side.
    for w in order.windows(2) {
        if key(w[0]) == key(w[1]) {
            sets.join(w[0], w[1]);
        }
    }
    if tolerance_m > 0.0 {
        order.retain(|&i| sets.find(i) == i);
        join_neighbours(points, &order, tolerance_m, &mut sets);
    }
    sets
}

/// Joins all pairs of `some` points that are within a tolerance, by a grid of cells twice as wide.
fn join_neighbours(points: &[Point3<f64>], some: &[u32], tolerance_m: f64, sets: &mut DisjointSets) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twins_of_either_zero_and_chains_of_neighbours_are_one() {
        let x = [0.0, 1.0, -0.0, 0.3, 0.2, 1.0].map(|x| Point3::new(x, 0.0, 2.0));
        assert_eq!(coincident(&x, 0.0).labels().0, [0, 1, 0, 2, 3, 1]);
        assert_eq!(coincident(&x, 0.21).labels().0, [0, 1, 0, 0, 0, 1]);
    }
}
