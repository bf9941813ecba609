//! How rough a finely divided surface is: what tells a scan from a drawing.

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

use super::TriMesh;
use super::weld::coincident;
use crate::stats::quantile;

/// A neighbourhood beyond this share of the box's diagonal says nothing of roughness.
const SMALL: f64 = 0.15;
/// Neighbours below which a quadric fits whatever there is.
const NEIGHBOURS: usize = 12;
/// Cosine of the angle to the normal of a neighbour beyond which there is an edge, which is no roughness: at a right one it is half as wide.
const SHARP: f64 = 0.75;
/// One neighbour in so many may be beyond it by noise alone.
const FEW: usize = 8;

impl TriMesh {
    /// Standard deviation of the vertices about the best quadric through their neighbours up to two edges away, metres: the lower quartile
    /// over the surface. Planes, cylinders and spheres have none, and fine drawings next to none; a scan has its noise. `None` if fewer
    /// than a quarter of the vertices have twelve neighbours within 0.15 of the diagonal of the box, and no sharp edge among them.
    pub fn roughness_m(&self) -> Option<f64> {
        let (lo, hi) = self.bounds()?;
        let surface = Surface::new(self);
        let reach_m = SMALL * (hi - lo).norm();
        let deviations: Vec<Option<f64>> = surface.vertices().map(|v| surface.deviation(v, reach_m)).collect();
        let told: Vec<f64> = deviations.iter().flatten().copied().collect();
        if 4 * told.len() < deviations.len() {
            return None;
        }
        quantile(told, 0.25)
    }
}

/// A mesh as its vertices see it: vertices at one place are one.
struct Surface<'a> {
    points: &'a [Point3<f64>],
    normals: Vec<Vector3<f64>>,
    neighbours: Vec<Vec<usize>>,
}

impl<'a> Surface<'a> {
    fn new(mesh: &'a TriMesh) -> Self {
        let mut places = coincident(&mesh.vertices, 0.0);
        let mut normals = vec![Vector3::zeros(); mesh.vertices.len()];
        let mut neighbours = vec![Vec::new(); mesh.vertices.len()];
        for (f, face) in mesh.faces.iter().enumerate() {
            let [a, b, c] = mesh.triangle(f);
            let normal = (b - a).cross(&(c - a));
            let face = face.map(|v| places.find(v) as usize);
            for k in 0..3 {
                normals[face[k]] += normal;
                neighbours[face[k]].extend([face[(k + 1) % 3], face[(k + 2) % 3]]);
            }
        }
        for of_one in &mut neighbours {
            of_one.sort_unstable();
            of_one.dedup();
        }
        normals.iter_mut().for_each(|n| *n = n.try_normalize(0.0).unwrap_or_default());
        Self { points: &mesh.vertices, normals, neighbours }
    }

    fn vertices(&self) -> impl Iterator<Item = usize> {
        (0..self.points.len()).filter(|&v| !self.neighbours[v].is_empty())
    }

    /// Deviation about a quadric over the tangent plane; `None` beside an edge, and where the neighbours are few or reach farther than
    /// `reach_m`.
    fn deviation(&self, vertex: usize, reach_m: f64) -> Option<f64> {
        let mut ring: Vec<usize> =
            self.neighbours[vertex].iter().flat_map(|&v| &self.neighbours[v]).copied().chain([vertex]).collect();
        ring.sort_unstable();
        ring.dedup();
        let normal = self.normals[vertex];
        let beyond = ring.iter().filter(|&&v| self.normals[v].dot(&normal) < SHARP).count();
        if FEW * beyond > ring.len() {
            return None;
        }
        let along = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
        let across = normal.cross(&along);
        let offsets: Vec<Vector3<f64>> = ring.iter().map(|&v| self.points[v] - self.points[vertex]).collect();
        let size = offsets.iter().map(Vector3::norm).fold(0.0, f64::max);
        if offsets.len() <= NEIGHBOURS || size > reach_m {
            return None;
        }
        let terms = |d: &Vector3<f64>| {
            let (x, y) = (d.dot(&along) / size, d.dot(&across) / size);
            Vector6::new(1.0, x, y, x * x, x * y, y * y)
        };
        let mut normal_matrix = Matrix6::zeros();
        let mut heights = Vector6::zeros();
        for d in &offsets {
            let t = terms(d);
            normal_matrix += t * t.transpose();
            heights += t * d.dot(&normal);
        }
        let quadric = normal_matrix.cholesky()?.solve(&heights);
        let squares: f64 = offsets.iter().map(|d| (d.dot(&normal) - terms(d).dot(&quadric)).powi(2)).sum();
        Some((squares / (offsets.len() - 6) as f64).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// A ball of 50 mm, `n` rings of `2 n` corners, its corners moved by at most `noise_m` along each axis.
    fn ball(n: usize, noise_m: f64) -> TriMesh {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut vertices = Vec::new();
        for i in 0..=n {
            for j in 0..2 * n {
                let (u, v) = (std::f64::consts::PI * i as f64 / n as f64, std::f64::consts::PI * j as f64 / n as f64);
                let at = 0.05 * Vector3::new(u.sin() * v.cos(), u.sin() * v.sin(), u.cos());
                vertices.push(Point3::from(at + Vector3::from_fn(|_, _| noise_m * rng.random_range(-1.0..=1.0))));
            }
        }
        let at = |i: usize, j: usize| (2 * n * i + j % (2 * n)) as u32;
        let faces = (0..n).flat_map(|i| (0..2 * n).map(move |j| (i, j)));
        let faces = faces.flat_map(|(i, j)| {
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        });
        TriMesh::new(vertices, faces.collect()).unwrap()
    }

    #[test]
    fn noise_of_a_ball_is_found_and_its_curve_is_not_noise() {
        assert!(ball(40, 0.0).roughness_m().unwrap() < 1e-5);
        let noisy = ball(40, 5e-4).roughness_m().unwrap();
        let sd = 5e-4 / 3f64.sqrt();
        assert!(noisy > 0.6 * sd && noisy < 1.1 * sd, "{noisy} for {sd}");
    }

    /// Sheets of 3 x 40 cells that are one angle of two planes: no vertex is far from the edge between them.
    fn angle() -> TriMesh {
        let at = |i: u32, j: u32| 41 * i + j;
        let place = |i: u32, j: u32| {
            let (along, across) = (0.002 * f64::from(j), 0.002 * (f64::from(i) - 3.0));
            if i < 3 { Point3::new(along, across, 0.0) } else { Point3::new(along, 0.0, across) }
        };
        let vertices = (0..7).flat_map(|i| (0..41).map(move |j| place(i, j))).collect();
        let faces = (0..6).flat_map(|i| (0..40).map(move |j| (i, j)));
        let faces = faces.flat_map(|(i, j)| {
            [[at(i, j), at(i, j + 1), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i + 1, j)]]
        });
        TriMesh::new(vertices, faces.collect()).unwrap()
    }

    #[test]
    fn an_edge_is_no_roughness() {
        assert!(angle().roughness_m().is_none_or(|r| r < 1e-12));
    }

    #[test]
    fn roughness_of_a_coarse_mesh_is_unknown() {
        assert_eq!(ball(4, 1e-3).roughness_m(), None);
        assert_eq!(TriMesh::default().roughness_m(), None);
        let flat = TriMesh::new(vec![Point3::origin(); 3], vec![[0, 1, 2]]).unwrap();
        assert_eq!(flat.roughness_m(), None);
    }
}
