//! The object as voxels of the box: what all photos together say is full.
//!
//! Each photo says for each voxel how likely the pixel there shows the object. A full voxel shows the object in every photo;
//! an empty one in some photos shows the background and in others the object before or behind it. So a photo against a voxel
//! counts more than one for it, and the sum over the photos decides, with a cut that prefers few faces.

use nalgebra::Point3;
use rayon::prelude::*;

use super::maxflow::FlowGraph;
use super::view::{Bounds, View};

/// Photos that vote; of more, every so many-th.
const MOST_VIEWS: usize = 96;
/// How often a pixel of a full voxel is taken for background, and a pixel at an empty voxel shows background.
const WRONG: f32 = 0.03;
const EMPTY_SHOWS_BACKGROUND: f32 = 0.1;
/// The photos count as at most this many independent ones.
const INDEPENDENT: f32 = 16.0;
/// Cost of a face between full and empty, nats.
const FACE: f32 = 1.0;

/// A lattice of voxels that fills the box.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    bounds: Bounds,
    counts: [usize; 3],
    /// Edge of a voxel, frame of the region.
    pub edge: f64,
    /// For and against, nats.
    score: Vec<f32>,
    pub full: Vec<bool>,
}

impl Grid {
    /// About `voxels` cubes.
    pub fn new(bounds: &Bounds, voxels: usize) -> Self {
        let size = bounds.size();
        let edge = (size.x * size.y * size.z / voxels as f64).cbrt().max(size.max() / 256.0);
        let counts = [size.x, size.y, size.z].map(|s| ((s / edge).ceil() as usize).max(1));
        let cells = counts.iter().product();
        Self { bounds: *bounds, counts, edge, score: vec![0.0; cells], full: vec![false; cells] }
    }

    fn centre(&self, index: usize) -> Point3<f64> {
        let [nx, ny, _] = self.counts;
        let at = [index % nx, index / nx % ny, index / nx / ny];
        let size = self.bounds.size();
        Point3::from(std::array::from_fn::<f64, 3, _>(|k| {
            self.bounds.lower[k] + size[k] * (at[k] as f64 + 0.5) / self.counts[k] as f64
        }))
    }

    /// The voxel that holds a point.
    pub fn index(&self, p: &Point3<f64>) -> Option<usize> {
        if !self.bounds.contains(p) {
            return None;
        }
        let size = self.bounds.size();
        let at: [usize; 3] = std::array::from_fn(|k| {
            (((p[k] - self.bounds.lower[k]) / size[k] * self.counts[k] as f64) as usize).min(self.counts[k] - 1)
        });
        Some((at[2] * self.counts[1] + at[1]) * self.counts[0] + at[0])
    }

    /// Lets the photos vote and cuts. `likely` holds, per view and pixel of its window, how likely it shows the object, 0 to
    /// 255; `seeds` are voxels that hold points of the object, with the weight of each, nats.
    pub fn vote(&mut self, views: &[View], likely: &[Vec<u8>], seeds: &[(usize, f32)]) {
        let step = views.len().div_ceil(MOST_VIEWS).max(1);
        let gain: Vec<f32> = (0..256)
            .map(|p| {
                let p = p as f32 / 255.0;
                let full = (1.0 - WRONG) * p + WRONG * (1.0 - p);
                let empty = (1.0 - EMPTY_SHOWS_BACKGROUND) * p + EMPTY_SHOWS_BACKGROUND * (1.0 - p);
                (full / empty).ln()
            })
            .collect();
        let this = &*self;
        let score: Vec<f32> = (0..self.score.len())
            .into_par_iter()
            .map(|index| {
                let point = this.centre(index);
                let (mut sum, mut seen) = (0.0f32, 0.0f32);
                for (view, likely) in views.iter().zip(likely).step_by(step) {
                    if let Some(at) = view.pixel_of(&point) {
                        sum += gain[usize::from(likely[at])];
                        seen += 1.0;
                    }
                }
                if seen > 0.0 { sum / seen * seen.min(INDEPENDENT) } else { -0.5 }
            })
            .collect();
        self.score = score;
        for (index, weight) in seeds {
            self.score[*index] += weight;
        }
        self.cut();
    }

    fn cut(&mut self) {
        let scale = |nats: f32| (nats * 1000.0).clamp(0.0, 1e6) as i32;
        let [nx, ny, nz] = self.counts;
        let cells = nx * ny * nz;
        let mut graph = FlowGraph::new(cells, 3 * cells);
        for (index, score) in self.score.iter().enumerate() {
            graph.add_terminal(index, scale(*score), scale(-score));
        }
        let face = scale(FACE);
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    let at = (z * ny + y) * nx + x;
                    if x + 1 < nx {
                        graph.add_edge(at, at + 1, face, face);
                    }
                    if y + 1 < ny {
                        graph.add_edge(at, at + nx, face, face);
                    }
                    if z + 1 < nz {
                        graph.add_edge(at, at + nx * ny, face, face);
                    }
                }
            }
        }
        graph.solve();
        for index in 0..cells {
            self.full[index] = graph.with_source(index);
        }
    }

    /// Whether a voxel has an empty neighbour or lies at the border of the box.
    fn at_surface(&self, index: usize) -> bool {
        let [nx, ny, nz] = self.counts;
        let (x, y, z) = (index % nx, index / nx % ny, index / nx / ny);
        if x == 0 || y == 0 || z == 0 || x + 1 == nx || y + 1 == ny || z + 1 == nz {
            return true;
        }
        [index - 1, index + 1, index - nx, index + nx, index - nx * ny, index + nx * ny].iter().any(|n| !self.full[*n])
    }

    /// Per view, per pixel of its window: whether a full voxel lies on its ray.
    pub fn silhouettes(&self, views: &[View]) -> Vec<Vec<bool>> {
        let shell: Vec<Point3<f64>> =
            (0..self.full.len()).filter(|i| self.full[*i] && self.at_surface(*i)).map(|i| self.centre(i)).collect();
        views
            .par_iter()
            .map(|view| {
                let window = view.window;
                let mut seen = vec![false; window.len()];
                for point in &shell {
                    let Some(pixel) = view.project(point) else { continue };
                    let radius = 0.55 * self.edge * view.eye.focal_px() / (view.eye.depth(point) * view.shrink as f64);
                    let clip = |v: f64, low: usize, high: usize| v.clamp(low as f64, high as f64) as usize;
                    let x0 = clip((pixel.x - radius).round(), window.x0, window.x1);
                    let x1 = clip((pixel.x + radius).round().max(x0 as f64 + 1.0), window.x0, window.x1);
                    let y0 = clip((pixel.y - radius).round(), window.y0, window.y1);
                    let y1 = clip((pixel.y + radius).round().max(y0 as f64 + 1.0), window.y0, window.y1);
                    for y in y0..y1 {
                        let row = (y - window.y0) * window.width();
                        seen[row + x0 - window.x0..row + x1.max(x0) - window.x0].fill(true);
                    }
                }
                let mut seen = without_pinholes(&seen, window.width());
                seen.iter_mut().zip(&view.inside).for_each(|(s, inside)| *s &= inside);
                seen
            })
            .collect()
    }
}

/// Fills pixels between pixels: a dilation and an erosion by 3 x 3.
fn without_pinholes(mask: &[bool], width: usize) -> Vec<bool> {
    let height = mask.len() / width.max(1);
    let around = |of: &[bool], value: bool| -> Vec<bool> {
        (0..of.len())
            .map(|at| {
                let (x, y) = (at % width, at / width);
                let rows = y.saturating_sub(1)..(y + 2).min(height);
                let found =
                    |y: usize| of[y * width + x.saturating_sub(1)..y * width + (x + 2).min(width)].contains(&value);
                if rows.into_iter().any(found) { value } else { !value }
            })
            .collect()
    };
    around(&around(mask, true), false)
}
