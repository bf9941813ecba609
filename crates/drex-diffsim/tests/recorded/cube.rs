//! Tosses of a real cube, tracked at 148 Hz: the state of each at a chosen time, from what was seen until then.

use std::path::Path;
use std::sync::Arc;

use drex_core::pose::pose_from_wxyz;
use drex_core::{MassProperties, Pose};
use drex_diffsim::{Collider, Geom, Shape};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

use super::engine::Start;

/// Half an edge, metres.
pub const HALF_M: f64 = 0.0524;
/// Seconds of track before the start that its state is fitted to.
pub const WINDOW_S: f64 = 0.1;
/// A corner below this height may touch, metres.
const NEAR_M: f64 = 0.002;
/// Fewest frames that a state is fitted to.
const LEAST_FRAMES: usize = 4;
const G: f64 = 9.81;

/// A tracked toss.
pub struct Toss {
    pub number: u32,
    pub times_s: Vec<f64>,
    pub poses: Vec<Pose>,
}

/// The cube: mass and inertia as its authors give them.
pub fn cube() -> (MassProperties, Arc<Collider>) {
    let inertia = Matrix3::identity() * 8.1e-4;
    let shape = Arc::new(Collider::new(&[Geom::new(Shape::Box { half_m: Vector3::repeat(HALF_M) })]).unwrap());
    (MassProperties { mass_kg: 0.37, center_of_mass: Point3::origin(), inertia }, shape)
}

/// Height of the lowest corner, metres.
fn lowest(pose: &Pose) -> f64 {
    corners().iter().map(|c| (pose * c).z).fold(f64::MAX, f64::min)
}

fn corners() -> Vec<Point3<f64>> {
    (0..8).map(|i| Point3::from(Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -HALF_M } else { HALF_M }))).collect()
}

/// All tosses by number. Heights are measured from the table: `table_m` is where the tracker sees it.
pub fn tosses(shared: &Path, table_m: f64) -> Vec<Toss> {
    let folder = shared.join("data/push_real/contactnets_cube_toss/tosses");
    let mut all: Vec<Toss> = std::fs::read_dir(folder)
        .unwrap()
        .map(|file| {
            let path = file.unwrap().path();
            let number = path.file_stem().unwrap().to_str().unwrap().parse().unwrap();
            let (mut times_s, mut poses) = (Vec::new(), Vec::new());
            for line in std::fs::read_to_string(&path).unwrap().lines().skip(1) {
                let x: Vec<f64> = line.split(',').map(|w| w.parse().unwrap()).collect();
                times_s.push(x[0]);
                poses.push(pose_from_wxyz([x[1], x[2], x[3] - table_m], [x[4], x[5], x[6], x[7]]).unwrap());
            }
            Toss { number, times_s, poses }
        })
        .collect();
    all.sort_by_key(|t| t.number);
    all
}

impl Toss {
    /// The state at `t` from the frames in the window before it. A cube's inertia is the same about every axis, so
    /// between two contacts its spin is constant: position is fitted by a parabola of known gravity, rotation by a
    /// constant spin. Where a corner was on the table within the window, the fit starts after that, but keeps at least
    /// four frames.
    pub fn state_at(&self, t: f64) -> Start {
        self.fit(t, &self.window(t))
    }

    /// The frames that the state at `t` is fitted to.
    pub fn window(&self, t: f64) -> Vec<usize> {
        let last = self.times_s.partition_point(|s| *s <= t + 1e-9);
        let first = self.times_s.partition_point(|s| *s < t - WINDOW_S - 1e-9);
        let touched = (first..last).rev().find(|&k| self.lowest(k) < NEAR_M).map_or(first, |k| k + 1);
        (touched.min(last.saturating_sub(LEAST_FRAMES))..last).collect()
    }

    /// Frames in that window, touching or not.
    pub fn window_length(&self, t: f64) -> usize {
        self.times_s.iter().filter(|s| **s <= t + 1e-9 && **s >= t - WINDOW_S - 1e-9).count()
    }

    /// Lowest height of a corner between two times, metres.
    pub fn lowest_between(&self, from: f64, to: f64) -> f64 {
        let frames = (0..self.times_s.len()).filter(|&k| self.times_s[k] >= from && self.times_s[k] <= to);
        frames.map(|k| self.lowest(k)).fold(f64::MAX, f64::min)
    }

    /// The state at `t` from chosen frames.
    pub fn fit(&self, t: f64, chosen: &[usize]) -> Start {
        let frames = chosen.iter().copied();
        let n = frames.len() as f64;
        let mean = frames.clone().map(|k| self.times_s[k] - t).sum::<f64>() / n;
        let spread = frames.clone().map(|k| (self.times_s[k] - t - mean).powi(2)).sum::<f64>();
        let line = |y: &dyn Fn(usize) -> Vector3<f64>| {
            let y0 = frames.clone().map(y).sum::<Vector3<f64>>() / n;
            let slope = frames.clone().map(|k| y(k) * (self.times_s[k] - t - mean)).sum::<Vector3<f64>>() / spread;
            (y0 - slope * mean, slope)
        };
        let fall = |k: usize| Vector3::z() * (0.5 * G * (self.times_s[k] - t).powi(2));
        let (position, velocity) = line(&|k| self.poses[k].translation.vector + fall(k));
        // Rotation vectors about the middle frame; two rounds make them small.
        let mut rotation = self.poses[chosen[chosen.len() / 2]].rotation;
        let mut spin = Vector3::zeros();
        for _ in 0..4 {
            let predicted = |k: usize| UnitQuaternion::from_scaled_axis(spin * (self.times_s[k] - t)) * rotation;
            let (offset, slope) = line(&|k| (self.poses[k].rotation * predicted(k).inverse()).scaled_axis());
            rotation = UnitQuaternion::from_scaled_axis(offset) * rotation;
            spin += slope;
        }
        let mut pose = Pose::from_parts(position.into(), rotation);
        // The tracker errs by millimetres: no corner starts inside the table.
        pose.translation.vector.z += (-lowest(&pose)).max(0.0);
        Start { pose, velocity, spin }
    }

    /// Height of the lowest corner, metres.
    fn lowest(&self, k: usize) -> f64 {
        lowest(&self.poses[k])
    }

    /// The pose at `t`, between frames.
    pub fn at(&self, t: f64) -> Pose {
        let k = self.times_s.partition_point(|s| *s <= t).clamp(1, self.times_s.len() - 1);
        let s = (t - self.times_s[k - 1]) / (self.times_s[k] - self.times_s[k - 1]);
        drex_core::pose::interpolate(&self.poses[k - 1], &self.poses[k], s.clamp(0.0, 1.0))
    }
}

/// Which of the six faces looks up most.
pub fn face_up(pose: &Pose) -> usize {
    let up = pose.rotation.inverse() * Vector3::z();
    let k = up.iamax();
    2 * k + usize::from(up[k] < 0.0)
}

/// Median of numbers.
pub fn median(mut x: Vec<f64>) -> f64 {
    x.sort_by(f64::total_cmp);
    if x.is_empty() { f64::NAN } else { (x[(x.len() - 1) / 2] + x[x.len() / 2]) / 2.0 }
}
