//! A trained policy and what it predicts.

use std::ops::ControlFlow;
use std::path::Path;

use drex_core::Pose;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::cloud::{box_centre, encode, farthest_points};
use crate::norm::{MASS_MARGIN, Normalisation, STRETCH, joint_intervals, wrist_pose};
use crate::weights::{Layout, Weights};
use crate::{Dataset, EpochStats, Error, Result, TrainOptions, TrainReport, net};

/// Objects larger than this many lengths of a hand are taken for a mistake in the units.
pub(crate) const LARGEST_OBJECT: f64 = 20.0;

/// One grasp that the policy proposes.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedGrasp {
    /// Joint angles in rad, in the order of [`GraspPolicy::joint_names`], inside the limits.
    pub joints: Vec<f64>,
    /// Where the palm goes, in the frame the object's points were given in.
    pub object_from_palm: Pose,
    /// Total squeeze, sum of normal forces, N.
    pub squeeze_n: f64,
    /// Probability of this grasp among those proposed; they sum to one.
    pub weight: f64,
}

/// What the weights mean: everything about a policy except the weights themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Card {
    pub hand: String,
    pub joint_names: Vec<String>,
    pub joint_limits_rad: Vec<(f64, f64)>,
    pub points: usize,
    pub network: Layout,
    pub normalisation: Normalisation,
    pub training: TrainOptions,
    /// Hash of the training data, so that a policy can be traced to it.
    pub dataset_sha256: String,
}

impl Card {
    pub fn new(data: &Dataset, options: &TrainOptions, network: Layout, normalisation: Normalisation) -> Self {
        Self {
            hand: data.hand.clone(),
            joint_names: data.joint_names.clone(),
            joint_limits_rad: data.joint_limits.clone(),
            points: options.points,
            network,
            normalisation,
            training: options.clone(),
            dataset_sha256: data.sha256(),
        }
    }
}

/// An object ready for the network.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    centre: Vector3<f64>,
    encoded: Vec<f32>,
}

/// A trained network with the numbers and names that give its output a meaning.
#[derive(Debug, Clone, PartialEq)]
pub struct GraspPolicy {
    pub(crate) card: Card,
    pub(crate) weights: Weights,
}

impl GraspPolicy {
    /// Learns from demonstrations. `progress` is called after each epoch and may end the training there; the policy learned so far is
    /// returned.
    ///
    /// The same data, options and seed give the same policy, byte for byte, with any number of threads on the same type of processor.
    ///
    /// # Errors
    /// [`Error::Option`] and [`Error::Dataset`] if the input cannot be used, [`Error::Diverged`] if the loss stops being a number,
    /// [`Error::NoBackend`] if the crate was built without one.
    pub fn train(
        data: &Dataset,
        options: &TrainOptions,
        progress: &mut dyn FnMut(EpochStats) -> ControlFlow<()>,
    ) -> Result<(GraspPolicy, TrainReport)> {
        crate::train::train(data, options, progress)
    }

    /// The grasps for an object of `mass_kg` whose surface has these `points` (m, any frame; the wrist comes back in the same), the most
    /// probable first.
    ///
    /// At least [`points`](Self::points) points are needed; more are thinned by farthest-point sampling.
    /// The squeeze is m g times a squeeze per weight that the network bounds by twice the range seen in training; outside the masses seen
    /// it grows in proportion to the mass.
    ///
    /// # Errors
    /// [`Error::Query`] for too few points, points that are not finite or metres apart, a mass that is not positive or is more than
    /// ten times outside [`mass_range_kg`](Self::mass_range_kg).
    pub fn predict(&self, points: &[Point3<f64>], mass_kg: f64) -> Result<Vec<PredictedGrasp>> {
        if points.len() < self.card.points {
            let what = format!("{} points, but the policy takes {}", points.len(), self.card.points);
            return Err(Error::query(what, "sample the surface more densely"));
        }
        if let Some(i) = points.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
            return Err(Error::query(format!("point {i} is not finite"), "repair the mesh or the sampling"));
        }
        check_size(points, self.card.normalisation.length_m)
            .map_err(|what| Error::query(what, "give the points in metres"))?;
        let (least, most) = self.mass_range_kg();
        // Written so that a NaN is refused as well.
        if !(mass_kg >= least / MASS_MARGIN && mass_kg <= most * MASS_MARGIN) {
            let what = format!("mass {mass_kg} kg is too far from the {least} .. {most} kg the policy was trained on");
            return Err(Error::query(what, "check the unit (kg), or train with this mass among the samples"));
        }
        let mut grasps = self.propose(&self.look(points), mass_kg)?;
        grasps.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        Ok(grasps)
    }

    /// The object as the network sees it.
    pub(crate) fn look(&self, points: &[Point3<f64>]) -> Scene {
        let centre = box_centre(points);
        let mut encoded = Vec::new();
        for p in farthest_points(points, &centre, self.card.points) {
            let frequencies = self.card.network.frequencies;
            encode(&(p.coords - centre), self.card.normalisation.length_m, frequencies, &mut encoded);
        }
        Scene { centre, encoded }
    }

    /// [`predict`](Self::predict) without checks, modes in their own order.
    pub(crate) fn propose(&self, scene: &Scene, mass_kg: f64) -> Result<Vec<PredictedGrasp>> {
        let norm = &self.card.normalisation;
        let outputs = net::outputs(&self.weights, &scene.encoded, &[norm.mass_input(mass_kg)])?;
        let joints = self.card.network.joints;
        let modes: Vec<Vec<f64>> = outputs
            .chunks_exact(self.card.network.mode_width())
            .map(|m| m.iter().map(|v| f64::from(*v)).collect())
            .collect();
        let largest = modes.iter().map(|m| m[joints + 10]).fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = modes.iter().map(|m| (m[joints + 10] - largest).exp()).sum();
        let intervals = joint_intervals(&self.card.joint_limits_rad);
        let grasp = |m: &Vec<f64>| {
            let angle = |j: usize| {
                let ((middle, half), (lower, upper)) = (intervals[j], self.card.joint_limits_rad[j]);
                (middle + half * STRETCH * m[j].tanh()).clamp(lower, upper)
            };
            let wrist: [f64; 9] = std::array::from_fn(|i| m[joints + i]);
            let mut pose = wrist_pose(&wrist, norm.length_m);
            pose.translation.vector += scene.centre;
            PredictedGrasp {
                joints: (0..joints).map(angle).collect(),
                object_from_palm: pose,
                squeeze_n: norm.squeeze_n(m[joints + 9], mass_kg),
                weight: (m[joints + 10] - largest).exp() / sum,
            }
        };
        Ok(modes.iter().map(grasp).collect())
    }

    /// Name of the hand model the grasps are for.
    pub fn hand(&self) -> &str {
        &self.card.hand
    }

    /// Names of the joints, in the order of [`PredictedGrasp::joints`].
    pub fn joint_names(&self) -> &[String] {
        &self.card.joint_names
    }

    /// Lower and upper limit of each joint, rad.
    pub fn joint_limits(&self) -> &[(f64, f64)] {
        &self.card.joint_limits_rad
    }

    /// Points of the object that enter the network.
    pub fn points(&self) -> usize {
        self.card.points
    }

    /// K: how many grasps [`predict`](Self::predict) returns.
    pub fn modes(&self) -> usize {
        self.card.network.modes
    }

    /// Lightest and heaviest object trained on, kg.
    pub fn mass_range_kg(&self) -> (f64, f64) {
        (self.card.normalisation.least_mass_kg, self.card.normalisation.most_mass_kg)
    }

    /// The settings it was trained with, the seed among them.
    pub fn training(&self) -> &TrainOptions {
        &self.card.training
    }

    /// SHA-256 of the data it was trained on, in hexadecimal.
    pub fn dataset_sha256(&self) -> &str {
        &self.card.dataset_sha256
    }

    /// Writes `policy.json` and the weights it names (safetensors) into `folder`, which is made if missing. An earlier policy there is
    /// replaced in one step: whenever the process dies, the folder holds the old policy or the new one.
    ///
    /// # Errors
    /// [`Error::Core`] if a file cannot be written.
    pub fn save(&self, folder: &Path) -> Result<()> {
        crate::files::save(self, folder)
    }

    /// Reads what [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// [`Error::Core`] if a file cannot be read, [`Error::File`] if it is damaged, of another version, or if weights and `policy.json`
    /// do not belong together. No content panics.
    pub fn load(folder: &Path) -> Result<Self> {
        crate::files::load(folder)
    }
}

/// Whether the points are close enough together to be something that a hand grasps.
pub(crate) fn check_size(points: &[Point3<f64>], length_m: f64) -> Result<(), String> {
    let centre = box_centre(points);
    let radius = points.iter().map(|p| (p.coords - centre).norm()).fold(0.0, f64::max);
    let most = LARGEST_OBJECT * length_m;
    if 2.0 * radius <= most {
        return Ok(());
    }
    Err(format!(
        "the object is {:.3} m across, more than the {most} m that a hand of {length_m} m can deal with",
        2.0 * radius
    ))
}

#[cfg(test)]
mod tests {
    #[test]
    fn policies_cross_threads() {
        fn shared<T: Send + Sync>() {}
        shared::<super::GraspPolicy>();
        shared::<super::PredictedGrasp>();
        shared::<crate::Error>();
    }
}
