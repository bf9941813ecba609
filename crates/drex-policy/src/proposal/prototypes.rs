//! Grasps that stand for the many that are near to each other.

use drex_core::Pose;
use nalgebra::Vector3;
use rand::{Rng, RngExt};
use rayon::prelude::*;

/// Lloyd's iterations.
const ITERATIONS: usize = 12;

/// What is proposed at a place before it is changed.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Prototype {
    /// Joint angles, rad.
    pub joints: Vec<f64>,
    /// The hand's base in the frame of the place.
    pub anchor_from_base: Pose,
    /// Grip force times friction over weight: the median of those that it stands for.
    pub force_ratio: f64,
}

/// A change of a prototype: shift of the base in the frame of the place over [`SHIFT_M`], turn about its own axes over [`TURN_RAD`], joints over
/// [`JOINT_RAD`].
pub(crate) const SHIFT_M: f64 = 0.02;
pub(crate) const TURN_RAD: f64 = 0.2;
pub(crate) const JOINT_RAD: f64 = 0.2;

impl Prototype {
    /// What has to be changed to come to a grasp.
    pub fn change_to(&self, joints: &[f32], anchor_from_base: &Pose) -> Vec<f32> {
        let shift = anchor_from_base.translation.vector - self.anchor_from_base.translation.vector;
        let turn = (self.anchor_from_base.rotation.inverse() * anchor_from_base.rotation).scaled_axis();
        let joints = joints.iter().zip(&self.joints).map(|(a, b)| ((f64::from(*a) - b) / JOINT_RAD) as f32);
        shift
            .iter()
            .map(|v| (v / SHIFT_M) as f32)
            .chain(turn.iter().map(|v| (v / TURN_RAD) as f32))
            .chain(joints)
            .collect()
    }

    /// The grasp that a change leads to: joints, and the base in the frame of the place.
    pub fn changed(&self, change: impl Iterator<Item = f32>) -> (Vec<f64>, Pose) {
        let change: Vec<f64> = change.map(f64::from).collect();
        let shift = Vector3::from_column_slice(&change[..3]) * SHIFT_M;
        let turn = Pose::rotation(Vector3::from_column_slice(&change[3..6]) * TURN_RAD);
        let joints = self.joints.iter().zip(&change[6..]).map(|(q, c)| q + c * JOINT_RAD).collect();
        let moved =
            Pose::from_parts((self.anchor_from_base.translation.vector + shift).into(), self.anchor_from_base.rotation);
        (joints, moved * turn)
    }
}

/// The middle of `count` clusters of points of a space (k-means++, Arthur and Vassilvitskii 2007, then Lloyd's iterations), each as the number of
/// the point that is nearest to it; fewer if there are fewer points. The same for any number of threads.
pub(crate) fn medoids(points: &[Vec<f32>], count: usize, random: &mut impl Rng) -> Vec<usize> {
    if points.is_empty() || count == 0 {
        return Vec::new();
    }
    let mut centres = vec![points[random.random_range(0..points.len())].clone()];
    let mut gaps: Vec<f32> = points.iter().map(|p| gap(p, &centres[0])).collect();
    while centres.len() < count {
        let total: f64 = gaps.iter().map(|g| f64::from(*g)).sum();
        if !(total > 0.0) {
            break;
        }
        let mut left = random.random_range(0.0..total);
        let next = gaps.iter().position(|g| {
            left -= f64::from(*g);
            left < 0.0
        });
        let centre = points[next.unwrap_or(points.len() - 1)].clone();
        gaps.par_iter_mut().zip(points).for_each(|(g, p)| *g = g.min(gap(p, &centre)));
        centres.push(centre);
    }
    for _ in 0..ITERATIONS {
        let of: Vec<usize> = points.par_iter().map(|p| nearest(p, &centres)).collect();
        let mut sums = vec![(vec![0.0_f64; points[0].len()], 0_usize); centres.len()];
        for (p, k) in points.iter().zip(of) {
            sums[k].0.iter_mut().zip(p).for_each(|(s, v)| *s += f64::from(*v));
            sums[k].1 += 1;
        }
        for (centre, (sum, n)) in centres.iter_mut().zip(sums).filter(|(_, s)| s.1 > 0) {
            centre.iter_mut().zip(sum).for_each(|(c, s)| *c = (s / n as f64) as f32);
        }
    }
    let mut found: Vec<usize> = centres.par_iter().map(|c| nearest(c, points)).collect();
    found.sort_unstable();
    found.dedup();
    found
}

/// The number of the nearest, the first of equals.
pub(crate) fn nearest(point: &[f32], among: &[Vec<f32>]) -> usize {
    let mut best = (0, f32::INFINITY);
    for (i, other) in among.iter().enumerate() {
        let d = gap(point, other);
        if d < best.1 {
            best = (i, d);
        }
    }
    best.0
}

fn gap(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(x, y)| (x - y) * (x - y)).sum()
}
