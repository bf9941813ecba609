//! What a training run says about itself.

use serde::{Deserialize, Serialize};

use crate::TrainOptions;

/// Losses and errors after one epoch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EpochStats {
    /// 0-based epoch.
    pub epoch: usize,
    /// Mean over the training samples of the squared joint error of the winning mode, rad² (mean over joints).
    pub joint_loss: f64,
    /// The same of the wrist: squared translation plus squared (lever times rotation), m².
    pub wrist_loss: f64,
    /// Squared error of the logarithm of the squeeze of the winning mode.
    pub force_loss: f64,
    /// Cross-entropy of the mode probabilities with the mode that won.
    pub mode_loss: f64,
    /// What was minimised: grasp, force and mode terms with their weights.
    pub total: f64,
    /// Errors on grasps never trained on; absent if none was held out.
    pub held_out: Option<GraspErrors>,
}

/// How far predictions are from grasps, each compared with the prediction nearest to it; means over the grasps.
///
/// Near is measured by [`grasp_distance_m`](crate::grasp_distance_m).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GraspErrors {
    /// The grasp distance itself, m of fingertip displacement.
    pub distance_m: f64,
    /// Root mean square over the joints, rad.
    pub joint_rms_rad: f64,
    /// Distance of the palms, m.
    pub wrist_m: f64,
    /// Angle between the palms, rad.
    pub wrist_rad: f64,
    /// |predicted / needed - 1| of the squeeze.
    pub force_relative: f64,
}

/// What simple rules reach on the held-out grasps, to compare [`EpochStats::held_out`] with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Baselines {
    /// One prediction, the mean of the training grasps, with the mean squeeze whatever the mass.
    pub mean_demonstration: GraspErrors,
    /// As many training grasps as the policy has modes, drawn at random, with their squeeze per weight; mean over draws.
    pub random_demonstrations: GraspErrors,
    /// All training grasps at hand: the nearest one, with its squeeze per weight. It knows more grasps than the policy may keep.
    pub nearest_demonstration: GraspErrors,
}

/// One grasp the trained policy holds ready, for the median mass of the training data.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ModeReport {
    /// Probability that the policy gives it.
    pub weight: f64,
    /// Root mean square joint difference to the training grasp nearest to it, rad. A mode far from every
    /// demonstration is an average of grasps and need not be one.
    pub nearest_demonstration_rad: f64,
    /// How many distinct training grasps are nearer to this mode than to any other.
    pub demonstrations: usize,
}

/// The record of a training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainReport {
    /// One entry per finished epoch.
    pub curve: Vec<EpochStats>,
    /// Samples trained on (a grasp counts once per mass).
    pub train_samples: usize,
    /// Samples held out.
    pub held_out_samples: usize,
    /// Distinct grasps trained on.
    pub train_grasps: usize,
    /// Distinct grasps held out: no mass of such a grasp is in the training samples.
    pub held_out_grasps: usize,
    /// Numbers the network learned.
    pub parameters: usize,
    /// The policy's modes, most probable first.
    pub modes: Vec<ModeReport>,
    /// Errors of the finished policy on the grasps held out.
    pub held_out: Option<GraspErrors>,
    /// What simple rules reach on the same grasps.
    pub baselines: Option<Baselines>,
    /// Whether the caller stopped before the last epoch.
    pub stopped_early: bool,
    /// Wall time, s. The only field that differs between runs with the same data, options and seed.
    pub seconds: f64,
    /// The settings.
    pub options: TrainOptions,
}
