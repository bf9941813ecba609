//! Grasps drawn from the density of a policy.

use drex_core::stats::normal_pair;
use std::f64::consts::PI;

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::density::TAIL;
use crate::split::{Stream, random};
use crate::{GraspPolicy, PredictedGrasp, Query, Result};

impl GraspPolicy {
    /// `count` grasps drawn from the policy's density: a mode by its probability, then joints and wrist about it by Student's t.
    /// Joints are kept inside their limits. The same seed draws the same grasps.
    ///
    /// # Errors
    /// As [`predict`](Self::predict).
    pub fn sample(&self, query: &Query<'_>, count: usize, seed: u64) -> Result<Vec<PredictedGrasp>> {
        let grasps = self.predict(query)?;
        let mut random = random(seed, Stream::Sample);
        let spread = self.spread();
        let mut drawn = Vec::with_capacity(count);
        while drawn.len() < count {
            let mut rest = random.random_range(0.0..1.0);
            let mode = grasps.iter().find(|g| {
                rest -= g.weight;
                rest < 0.0
            });
            // Rounding may leave a rest: the last one stands in.
            let Some(mut grasp) = mode.or(grasps.last()).cloned() else { break };
            // Student's t is a normal vector over the square root of χ²/ν, one for all coordinates.
            let normals: Vec<f64> = (0..TAIL as usize).map(|_| normal(&mut random)).collect();
            let stretch = (TAIL / normals.iter().map(|n| n * n).sum::<f64>()).sqrt();
            for (j, q) in grasp.joints.iter_mut().enumerate() {
                let (lower, upper) = self.joint_limits()[j];
                *q = (*q + stretch * spread.joints_rad[j] * normal(&mut random)).clamp(lower, upper);
            }
            let shift = normal_vector(&mut random) * (stretch * spread.wrist_m);
            let turn = normal_vector(&mut random) * (stretch * spread.wrist_rad);
            let pose = &mut grasp.object_from_base;
            pose.translation = Translation3::from(pose.translation.vector + shift);
            pose.rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
            drawn.push(grasp);
        }
        Ok(drawn)
    }
}

/// A standard normal number.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    normal_pair(random.random_range(0.0..1.0), random.random_range(0.0..2.0 * PI))[0]
}

/// Three independent standard normal numbers.
pub(crate) fn normal_vector(random: &mut ChaCha8Rng) -> Vector3<f64> {
    let mut pair = || normal_pair(random.random_range(0.0..1.0), random.random_range(0.0..2.0 * PI));
    let ([x, y], [z, _]) = (pair(), pair());
    Vector3::new(x, y, z)
}
