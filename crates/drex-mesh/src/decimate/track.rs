//! How far a mesh has moved away from the one it was made of, while it is simplified.

use nalgebra::{Point3, Vector3};

use drex_core::TriMesh;
use drex_core::mesh::nearest_on_triangle;

use crate::bvh::{Aabb, Bvh};
use crate::topology::NONE;

/// Distance between the points at which a new face is tested, in allowed errors, and most of them along an edge.
const SPACING: f64 = 2.0;
const FINEST: f64 = 8.0;

/// A mesh and how far a simpler one may be from each of its faces.
pub(super) struct Allowance<'a> {
    pub mesh: &'a TriMesh,
    pub tree: &'a Bvh,
    /// Largest distance at each face, metres.
    pub at_face: Vec<f64>,
}

impl Allowance<'_> {
    /// Quarters what is allowed at the faces closer than `radius` to a point.
    pub fn tighten(&mut self, point: &Point3<f64>, radius: f64) {
        let Self { tree, at_face, .. } = self;
        tree.any_in(&Aabb::of(&[*point]).fattened(radius), |f, t| {
            if (point - nearest_on_triangle(point, t)).norm() <= radius {
                at_face[f as usize] *= 0.25;
            }
            false
        });
    }
}

/// Keeps the vertices and face centres of the original close to the simplified surface, and the corners, the middles and the
/// new edges' middles of that close to the original.
pub(super) struct Tracker<'a> {
    allowed: &'a Allowance<'a>,
    /// The largest of the allowed distances.
    widest: f64,
    /// The original's frame minus this is the frame of the simplified mesh.
    middle: Vector3<f64>,
    /// Points of the original and how far each may be from the simplified surface.
    points: Vec<(Point3<f64>, f64)>,
    /// First point that each face carries, and the point after each point.
    first: Vec<u32>,
    next: Vec<u32>,
    carried: Vec<u32>,
    homes: Vec<u32>,
    /// The face of the original that the last point was close to: the next one often is as well.
    last: usize,
}

impl<'a> Tracker<'a> {
    pub fn new(allowed: &'a Allowance<'a>, middle: Vector3<f64>) -> Self {
        let mesh = allowed.mesh;
        let mut at_vertex = vec![f64::INFINITY; mesh.vertices.len()];
        for (face, &most) in mesh.faces.iter().zip(&allowed.at_face) {
            face.iter().for_each(|&v| at_vertex[v as usize] = at_vertex[v as usize].min(most));
        }
        let mut points: Vec<_> = mesh.vertices.iter().map(|v| v - middle).zip(at_vertex).collect();
        let mut first = Vec::with_capacity(mesh.faces.len());
        let mut next = vec![NONE; mesh.vertices.len()];
        let mut placed = vec![false; mesh.vertices.len()];
        for (f, face) in mesh.faces.iter().enumerate() {
            let [a, b, c] = mesh.triangle(f).map(|p| p.coords);
            points.push((Point3::from((a + b + c) / 3.0 - middle), allowed.at_face[f]));
            next.push(NONE);
            let mut head = points.len() as u32 - 1;
            for &v in face {
                if !std::mem::replace(&mut placed[v as usize], true) {
                    next[v as usize] = std::mem::replace(&mut head, v);
                }
            }
            first.push(head);
        }
        let widest = allowed.at_face.iter().copied().fold(0.0, f64::max);
        Self { allowed, widest, middle, points, first, next, carried: Vec::new(), homes: Vec::new(), last: 0 }
    }

    /// Hands the points of the faces `before` on to `after`, the faces of the corners `survivors`, which meet in `x`; false,
    /// and nothing changed, if one would be too far away, or one of the new faces.
    pub fn moved(
        &mut self,
        before: impl Iterator<Item = u32> + Clone,
        survivors: &[u32],
        after: &[[Point3<f64>; 3]],
        x: &Point3<f64>,
    ) -> bool {
        self.carried.clear();
        self.homes.clear();
        for f in before.clone() {
            let mut i = self.first[f as usize];
            while i != NONE {
                let (p, most) = &self.points[i as usize];
                let distance = |t: &[Point3<f64>; 3]| (p - nearest_on_triangle(p, t)).norm_squared();
                let nearest = (0..after.len())
                    .map(|k| (distance(&after[k]), k))
                    .min_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
                match nearest {
                    Some((d, k)) if d <= most * most => {
                        self.carried.push(i);
                        self.homes.push(survivors[k] / 3);
                    }
                    _ => return false,
                }
                i = self.next[i as usize];
            }
        }
        if !self.is_close(x) || !after.iter().zip(survivors).all(|(t, c)| self.face_is_close(t, *c as usize % 3)) {
            return false;
        }
        before.for_each(|f| self.first[f as usize] = NONE);
        for (&i, &f) in self.carried.iter().zip(&self.homes) {
            self.next[i as usize] = std::mem::replace(&mut self.first[f as usize], i);
        }
        true
    }

    /// A lattice of points on a new face, whose corner `k` is the merged vertex; finer where the face is large. The vertex
    /// itself, the old edge and one of the two new ones belong to others.
    fn face_is_close(&mut self, t: &[Point3<f64>; 3], k: usize) -> bool {
        let (x, p, q) = (t[k].coords, t[(k + 1) % 3].coords, t[(k + 2) % 3].coords);
        let longest = (p - x).norm().max((q - x).norm()).max((q - p).norm());
        let n = (longest / (SPACING * self.widest)).ceil().clamp(2.0, FINEST) as u32;
        (1..n).all(|i| {
            (0..n - i).all(|j| {
                let (of_x, of_q) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                self.is_close(&Point3::from(x * of_x + q * of_q + p * (1.0 - of_x - of_q)))
            })
        })
    }

    /// Whether a point is no farther from some face of the original than is allowed there.
    fn is_close(&mut self, p: &Point3<f64>) -> bool {
        let Allowance { mesh, tree, at_face } = self.allowed;
        let p = p + self.middle;
        let near = |f: usize, t: &[Point3<f64>; 3]| (p - nearest_on_triangle(&p, t)).norm() <= at_face[f];
        if near(self.last, &mesh.triangle(self.last)) {
            return true;
        }
        let mut found = None;
        tree.any_in(&Aabb::of(&[p]).fattened(self.widest), |f, t| {
            found = near(f as usize, t).then_some(f as usize);
            found.is_some()
        });
        self.last = found.unwrap_or(self.last);
        found.is_some()
    }
}
