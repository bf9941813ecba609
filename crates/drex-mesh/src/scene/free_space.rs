//! How far an object with little texture may reach beyond its points: where no ray of sight passes.

use drex_core::stats::median;
use nalgebra::{Point3, Vector3};

use super::Scene;
use crate::Similarity;

/// A cell is free if this many rays pass through it: a stray point must not empty a solid.
const RAYS: u16 = 2;
/// The same as a share of what passes through a typical cell that any ray passes.
const SHARE: f64 = 0.1;
/// Rays end this many cells before their point.
const SHORT: f64 = 2.0;
/// Rays are looked at up to this many.
const MOST_RAYS: usize = 150_000;

/// Cells of a box in the table's frame, each free or not.
pub(super) struct FreeSpace {
    lo: Point3<f64>,
    side: f64,
    n: [usize; 3],
    rays: Vec<u16>,
    /// Rays from which a cell is free.
    least: u16,
}

impl FreeSpace {
    /// Counts the rays from cameras to the points they see through the cells of a box.
    pub fn new(scene: &Scene, table_from_scan: &Similarity, lo: Point3<f64>, hi: Point3<f64>, side: f64) -> Self {
        let n = [0, 1, 2].map(|k| ((hi[k] - lo[k]) / side).ceil().clamp(1.0, 200.0) as usize);
        let mut out = Self { lo, side, n, rays: vec![0; n[0] * n[1] * n[2]], least: RAYS };
        let eyes: Vec<Point3<f64>> = scene.views().iter().map(|v| table_from_scan.point(&v.centre())).collect();
        let total: usize = scene.points().iter().map(|p| p.views.len()).sum();
        let step = total.div_ceil(MOST_RAYS).max(1);
        let sightings = scene.points().iter().flat_map(|p| p.views.iter().map(move |&v| (v, &p.position)));
        for (view, position) in sightings.step_by(step) {
            out.cross(&eyes[view], &table_from_scan.point(position));
        }
        let typical = median(out.rays.iter().filter(|r| **r > 0).map(|r| f64::from(*r))).unwrap_or(0.0);
        out.least = RAYS.max((SHARE * typical) as u16);
        out
    }

    /// Steps of half a cell along the part of the ray in the box.
    fn cross(&mut self, eye: &Point3<f64>, end: &Point3<f64>) {
        let along = end - eye;
        let length = along.norm() - SHORT * self.side;
        let Some(d) = along.try_normalize(0.0) else { return };
        let (mut from, mut to) = (0.0f64, length);
        for k in 0..3 {
            let (a, b) = (self.lo[k] - eye[k], self.lo[k] + self.side * self.n[k] as f64 - eye[k]);
            if d[k].abs() < 1e-12 {
                if a > 0.0 || b < 0.0 {
                    return;
                }
                continue;
            }
            let (a, b) = (a / d[k], b / d[k]);
            (from, to) = (from.max(a.min(b)), to.min(a.max(b)));
        }
        let mut last = usize::MAX;
        let mut t = from;
        while t < to {
            if let Some(c) = self.cell(&(eye + d * t))
                && c != last
            {
                last = c;
                self.rays[c] = self.rays[c].saturating_add(1);
            }
            t += 0.5 * self.side;
        }
    }

    fn cell(&self, p: &Point3<f64>) -> Option<usize> {
        let at = (p - self.lo) / self.side;
        let inside = (0..3).all(|k| at[k] >= 0.0 && at[k] < self.n[k] as f64);
        inside.then(|| self.index([0, 1, 2].map(|k| at[k] as usize)))
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.n[1] + y) * self.n[0] + x
    }

    /// Closes the cells of points that are something else's.
    pub fn block(&mut self, others: impl Iterator<Item = Point3<f64>>) {
        for p in others {
            if let Some(c) = self.cell(&p) {
                self.rays[c] = u16::MAX;
            }
        }
    }

    /// Lower and upper corner of the cells that are not free and connected to those of the points, with the
    /// points themselves; and for each side (lower x, y, z, upper x, y, z) whether they reach the end of the box there.
    pub fn around(&self, points: &[Point3<f64>]) -> Option<(Point3<f64>, Point3<f64>, [bool; 6])> {
        let mut reached = vec![false; self.rays.len()];
        let mut queue: Vec<usize> = points.iter().filter_map(|p| self.cell(p)).collect();
        queue.iter().for_each(|&c| reached[c] = true);
        let (mut lo, mut hi) = (self.n, [0; 3]);
        while let Some(c) = queue.pop() {
            let at = [c % self.n[0], c / self.n[0] % self.n[1], c / self.n[0] / self.n[1]];
            for k in 0..3 {
                (lo[k], hi[k]) = (lo[k].min(at[k]), hi[k].max(at[k]));
            }
            // A thin neck is a cell wide: corners connect as well.
            for n in 0..27 {
                let next = [0, 1, 2].map(|k| (at[k] + n / [1, 3, 9][k] % 3).wrapping_sub(1));
                if (0..3).any(|k| next[k] >= self.n[k]) {
                    continue;
                }
                let i = self.index(next);
                if !reached[i] && self.rays[i] < self.least {
                    reached[i] = true;
                    queue.push(i);
                }
            }
        }
        if lo[0] > hi[0] {
            return None;
        }
        let corner = |at: [usize; 3], by: f64| self.lo + Vector3::from(at.map(|c| (c as f64 + by) * self.side));
        let ends = [0, 1, 2, 3, 4, 5].map(|i| if i < 3 { lo[i] == 0 } else { hi[i - 3] + 1 == self.n[i - 3] });
        Some((corner(lo, 0.0), corner(hi, 1.0), ends))
    }
}
