//! A trained policy: what it predicts.

use std::ops::ControlFlow;
use std::path::Path;

use drex_core::Pose;
use nalgebra::Point3;

use crate::{Dataset, EpochStats, Result, TrainOptions, TrainReport};

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

/// A trained network with the numbers and names that give its output a meaning.
#[derive(Debug, Clone, PartialEq)]
pub struct GraspPolicy {}

impl GraspPolicy {
    /// Trains.
    ///
    /// # Errors
    /// If it cannot.
    pub fn train(
        data: &Dataset,
        options: &TrainOptions,
        progress: &mut dyn FnMut(EpochStats) -> ControlFlow<()>,
    ) -> Result<(GraspPolicy, TrainReport)> {
        let _ = (data, options, progress);
        Err(crate::Error::NoBackend)
    }

    /// Predicts.
    ///
    /// # Errors
    /// If it cannot.
    pub fn predict(&self, points: &[Point3<f64>], mass_kg: f64) -> Result<Vec<PredictedGrasp>> {
        let _ = (points, mass_kg);
        Err(crate::Error::NoBackend)
    }

    /// Names of the joints.
    pub fn joint_names(&self) -> &[String] {
        &[]
    }

    /// Saves.
    ///
    /// # Errors
    /// If it cannot.
    pub fn save(&self, folder: &Path) -> Result<()> {
        let _ = folder;
        Err(crate::Error::NoBackend)
    }

    /// Loads.
    ///
    /// # Errors
    /// If it cannot.
    pub fn load(folder: &Path) -> Result<Self> {
        let _ = folder;
        Err(crate::Error::NoBackend)
    }
}
