//! A mesh as an elastic skin.

use drex_core::TriMesh;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Where a vertex is this far from the middle of its neighbours, as a share of its edges, the surface is bent for a reason.
const CREASE: f64 = 0.2;
/// Most steps of conjugate gradients: what is not solved then is in the next pass.
const MOST_STEPS: usize = 40;

/// Faces, and the neighbours of each vertex.
pub(super) struct Skin<'a> {
    pub faces: &'a [[u32; 3]],
    /// Where the neighbours of each vertex begin, and the end of the last.
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl<'a> Skin<'a> {
    pub fn new(mesh: &'a TriMesh) -> Self {
        // Each edge of a closed mesh is met twice, once in each direction.
        let mut edges: Vec<(u32, u32)> =
            mesh.faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)]).collect();
        edges.par_sort_unstable();
        edges.dedup();
        let mut starts = vec![0u32; mesh.vertices.len() + 1];
        edges.iter().for_each(|(from, _)| starts[*from as usize + 1] += 1);
        for v in 1..starts.len() {
            starts[v] += starts[v - 1];
        }
        Self { faces: &mesh.faces, starts, neighbours: edges.into_iter().map(|(_, to)| to).collect() }
    }

    fn of(&self, v: usize) -> &[u32] {
        &self.neighbours[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    /// Unit normals of the vertices, by the areas of their faces; zero where these have none.
    pub fn normals(&self, vertices: &[Point3<f64>]) -> Vec<Vector3<f64>> {
        let mut normals = vec![Vector3::zeros(); vertices.len()];
        for face in self.faces {
            let [a, b, c] = face.map(|v| vertices[v as usize]);
            let area = (b - a).cross(&(c - a));
            face.iter().for_each(|v| normals[*v as usize] += area);
        }
        normals.iter_mut().for_each(|n| *n = n.try_normalize(0.0).unwrap_or_default());
        normals
    }

    /// From each vertex to the middle of its neighbours.
    pub fn inwards(&self, places: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let way = |v: usize| match self.of(v) {
            [] => Vector3::zeros(),
            near => near.iter().map(|u| places[*u as usize]).sum::<Vector3<f64>>() / near.len() as f64 - places[v],
        };
        (0..places.len()).into_par_iter().map(way).collect()
    }

    /// The transpose of [`Skin::inwards`].
    fn outwards(&self, ways: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let share = |u: u32| ways[u as usize] / self.of(u as usize).len().max(1) as f64;
        let sum = |v: usize| match self.of(v) {
            [] => Vector3::zeros(),
            near => near.iter().map(|u| share(*u)).sum::<Vector3<f64>>() - ways[v],
        };
        (0..ways.len()).into_par_iter().map(sum).collect()
    }

    /// How much each vertex resists: less where it lies on a crease. A crease goes on at two neighbours or more; a vertex that sticks out alone
    /// is a thorn.
    fn weights(&self, places: &[Vector3<f64>], ways: &[Vector3<f64>]) -> Vec<f64> {
        let bend = |v: usize| {
            let near = self.of(v);
            let edges = near.iter().map(|u| (places[*u as usize] - places[v]).norm()).sum::<f64>();
            ways[v].norm() / (CREASE * edges / near.len().max(1) as f64).max(f64::MIN_POSITIVE)
        };
        let bends: Vec<f64> = (0..ways.len()).into_par_iter().map(bend).collect();
        let weight = |v: usize| {
            let most = self
                .of(v)
                .iter()
                .map(|u| bends[*u as usize])
                .fold([0.0; 2], |[first, second]: [f64; 2], bend| [first.max(bend), second.max(bend.min(first))]);
            1.0 / (1.0 + bends[v].min(most[1]).powi(2))
        };
        (0..ways.len()).into_par_iter().map(weight).collect()
    }

    /// The steps x along the normals n that solve (H + s nᵀ Lᵀ W L n) x = f - s nᵀ Lᵀ W L p, by conjugate gradients: the least of
    /// Σ H (x - f / H)² + s |L (p + n x)|²_W, where L goes from each vertex to the middle of its neighbours and W makes creases give way.
    pub fn steps(&self, pull: &Pull<'_>, vertices: &[Point3<f64>], normals: &[Vector3<f64>]) -> Vec<f64> {
        let places: Vec<Vector3<f64>> = vertices.iter().map(|p| p.coords).collect();
        let ways = self.inwards(&places);
        let weights = self.weights(&places, &ways);
        let bent = |ways: Vec<Vector3<f64>>| -> Vec<f64> {
            let weighed: Vec<Vector3<f64>> = ways.iter().zip(&weights).map(|(way, weight)| way * *weight).collect();
            self.outwards(&weighed).iter().zip(normals).map(|(b, n)| pull.stiffness * b.dot(n)).collect()
        };
        let held = |v: usize, value: f64| if pull.fixed[v] { 0.0 } else { value };
        let times = |x: &[f64]| -> Vec<f64> {
            let moved: Vec<Vector3<f64>> = normals.iter().zip(x).map(|(n, x)| n * *x).collect();
            let bent = bent(self.inwards(&moved));
            (0..x.len()).map(|v| held(v, pull.each[v][1] * x[v] + bent[v])).collect()
        };
        let diagonal = |v: usize| pull.each[v][1] + pull.stiffness * weights[v] + f64::MIN_POSITIVE;
        let mut residual: Vec<f64> = bent(ways).iter().enumerate().map(|(v, b)| held(v, pull.each[v][0] - b)).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut x = vec![0.0; vertices.len()];
        let mut z: Vec<f64> = residual.iter().enumerate().map(|(v, r)| r / diagonal(v)).collect();
        let mut direction = z.clone();
        let mut before = dot(&residual, &z);
        let first = before;
        for _ in 0..MOST_STEPS {
            if !(before > 1e-6 * first) {
                break;
            }
            let image = times(&direction);
            let length = before / dot(&direction, &image);
            for v in 0..x.len() {
                x[v] += length * direction[v];
                residual[v] -= length * image[v];
                z[v] = residual[v] / diagonal(v);
            }
            let now = dot(&residual, &z);
            for v in 0..x.len() {
                direction[v] = z[v] + now / before * direction[v];
            }
            before = now;
        }
        x
    }
}

/// What pulls at a skin.
pub(super) struct Pull<'a> {
    /// Per vertex, force and its derivative.
    pub each: &'a [[f64; 2]],
    pub stiffness: f64,
    /// Vertices that stay.
    pub fixed: &'a [bool],
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of unit squares, cut into triangles, `height` telling how far each vertex stands out.
    fn sheet(height: impl Fn(usize, usize) -> f64) -> TriMesh {
        const SIDE: usize = 21;
        let vertices = (0..SIDE * SIDE).map(|v| (v % SIDE, v / SIDE));
        let vertices = vertices.map(|(x, y)| Point3::new(x as f64, y as f64, height(x, y))).collect();
        let at = |x: usize, y: usize| (y * SIDE + x) as u32;
        let squares = (0..SIDE - 1).flat_map(|y| (0..SIDE - 1).map(move |x| (x, y)));
        let faces = squares.flat_map(|(x, y)| {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            [[a, b, c], [a, c, d]]
        });
        TriMesh { vertices, faces: faces.collect() }
    }

    /// Heights after ten passes in which photos say that all is where it began, beside a prior `stiffness` times as strong.
    fn heights(mesh: &TriMesh, stiffness: f64) -> Vec<f64> {
        let skin = Skin::new(mesh);
        let start: Vec<f64> = mesh.vertices.iter().map(|p| p.z).collect();
        let mut vertices = mesh.vertices.clone();
        let fixed: Vec<bool> = vertices.iter().map(|p| p.x < 2.0 || p.x > 18.0 || p.y < 2.0 || p.y > 18.0).collect();
        for _ in 0..10 {
            let each: Vec<[f64; 2]> = vertices.iter().zip(&start).map(|(p, z)| [z - p.z, 1.0]).collect();
            let up = vec![Vector3::z(); vertices.len()];
            let steps = skin.steps(&Pull { each: &each, stiffness, fixed: &fixed }, &vertices, &up);
            vertices.iter_mut().zip(steps).for_each(|(p, step)| p.z += step);
        }
        vertices.iter().map(|p| p.z).collect()
    }

    #[test]
    fn a_thorn_gives_way_and_a_crease_stays() {
        let thorn = heights(&sheet(|x, y| if (x, y) == (10, 10) { 3.0 } else { 0.0 }), 20.0);
        let highest = thorn.iter().copied().fold(0.0, f64::max);
        assert!(highest < 0.5, "{highest}");
        let roof = |x: usize, _: usize| 8.0 - (x as f64 - 10.0).abs().min(8.0);
        let ridge = heights(&sheet(roof), 20.0)[10 * 21 + 10];
        assert!(ridge > 7.5, "{ridge}");
    }
}
