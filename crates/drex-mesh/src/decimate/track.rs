//! How far a mesh has moved away from the one it was made of, while it is simplified.

use nalgebra::{Point3, Vector3};

use drex_core::TriMesh;
use drex_core::mesh::nearest_on_triangle;

use crate::bvh::Bvh;
use crate::topology::NONE;

/// Keeps every vertex of the original within a budget of the simplified surface, and the middles of its faces and edges within
/// the budget of the original.
pub(super) struct Tracker<'a> {
    original: &'a Bvh,
    /// The original's frame minus this is the frame of the simplified mesh.
    middle: Vector3<f64>,
    points: Vec<Point3<f64>>,
    /// First point that each face carries, and the point after each point.
    first: Vec<u32>,
    next: Vec<u32>,
    budget: f64,
    carried: Vec<u32>,
    homes: Vec<u32>,
}

impl<'a> Tracker<'a> {
    pub fn new(mesh: &TriMesh, original: &'a Bvh, middle: Vector3<f64>, budget: f64) -> Self {
        let (mut first, mut next) = (vec![NONE; mesh.faces.len()], vec![NONE; mesh.vertices.len()]);
        let mut placed = vec![false; mesh.vertices.len()];
        for (f, face) in mesh.faces.iter().enumerate() {
            for &v in face {
                if !std::mem::replace(&mut placed[v as usize], true) {
                    next[v as usize] = std::mem::replace(&mut first[f], v);
                }
            }
        }
        let points = mesh.vertices.iter().map(|v| v - middle).collect();
        Self { original, middle, points, first, next, budget, carried: Vec::new(), homes: Vec::new() }
    }

    /// Hands the points of the faces `before` on to `after`, the faces of the corners `survivors`; false, and nothing
    /// changed, if one would be farther than the budget, or one of the new faces.
    pub fn moved(
        &mut self,
        before: impl Iterator<Item = u32> + Clone,
        survivors: &[u32],
        after: &[[Point3<f64>; 3]],
    ) -> bool {
        if !after.iter().all(|t| self.stays_close(t)) {
            return false;
        }
        self.carried.clear();
        self.homes.clear();
        for f in before.clone() {
            let mut i = self.first[f as usize];
            while i != NONE {
                self.carried.push(i);
                let p = &self.points[i as usize];
                let distance = |t: &[Point3<f64>; 3]| (p - nearest_on_triangle(p, t)).norm_squared();
                let nearest = (0..after.len() as u32)
                    .map(|k| (distance(&after[k as usize]), k))
                    .min_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
                match nearest {
                    Some((d, k)) if d <= self.budget * self.budget => self.homes.push(survivors[k as usize] / 3),
                    _ => return false,
                }
                i = self.next[i as usize];
            }
        }
        before.for_each(|f| self.first[f as usize] = NONE);
        for (&i, &f) in self.carried.iter().zip(&self.homes) {
            self.next[i as usize] = std::mem::replace(&mut self.first[f as usize], i);
        }
        true
    }

    fn stays_close(&self, t: &[Point3<f64>; 3]) -> bool {
        let middle = Point3::from((t[0].coords + t[1].coords + t[2].coords) / 3.0);
        let near = |p: &Point3<f64>| self.original.nearest(&(p + self.middle), self.budget).is_some();
        near(&middle) && (0..3).all(|k| near(&t[k]) && near(&nalgebra::center(&t[k], &t[(k + 1) % 3])))
    }
}
