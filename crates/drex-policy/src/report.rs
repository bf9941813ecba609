//! What a training run says about itself.

use serde::{Deserialize, Serialize};

use crate::{Spread, TrainOptions};

/// Losses and errors after one epoch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EpochStats {
    /// 0-based epoch.
    pub epoch: usize,
    /// Mean over the training samples of the squared joint error of the winning mode, rad² (mean over joints).
    pub joint_loss: f64,
    /// The same of the wrist: squared translation plus squared (lever times rotation), m².
    pub wrist_loss: f64,
    /// Squared error of the logarithm of the grip force, of the modes that explain the grasp.
    pub force_loss: f64,
    /// Cross-entropy of the contacts, summed over the fingers.
    pub contact_loss: f64,
    /// Negative log-likelihood of the training grasps under the mixture, nats (wrist translation in m).
    pub nll: f64,
    /// What was minimised: likelihood, force and contact terms with their weights.
    pub total: f64,
    /// Errors on grasps never trained on; absent if none was held out.
    pub held_out: Option<GraspErrors>,
    /// Mean log-likelihood of the grasps held out, joints and wrist, nats.
    pub held_out_log_likelihood: Option<f64>,
    /// The same of the joints alone, nats.
    pub held_out_joint_log_likelihood: Option<f64>,
}

/// One round of grasps tried in rollouts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RolloutStats {
    /// 0-based round.
    pub epoch: usize,
    /// Grasps tried.
    pub tried: usize,
    /// Share of them that held the object to the end.
    pub held: f64,
    /// Mean reward, 0 .. 1: half for the end, half for the share of the time in which enough fingers held.
    pub reward: f64,
    /// Mean reward weighted by the policy's probabilities of the modes: what a grasp drawn from it would earn.
    pub policy_reward: f64,
    /// Mean |ln(target / proposed)| of the grip force, where a target was found.
    pub force_gap: f64,
    /// Mean cross-entropy of the contacts, summed over the fingers.
    pub contact_loss: f64,
    /// Root mean square over joints of how far the modes moved from what the first phase taught, rad.
    pub joint_drift_rad: f64,
    /// Mean distance of the palms from what the first phase taught, m.
    pub wrist_drift_m: f64,
}

/// How far predictions are from grasps, each compared with the prediction nearest to it; means over the grasps.
///
/// Near is measured by [`grasp_distance_m`](crate::grasp_distance_m).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct GraspErrors {
    /// The grasp distance itself, m of fingertip displacement.
    pub distance_m: f64,
    /// Root mean square over the joints, rad.
    pub joint_rms_rad: f64,
    /// Distance of the palms, m.
    pub wrist_m: f64,
    /// Angle between the palms, rad.
    pub wrist_rad: f64,
    /// |predicted / needed - 1| of the grip force.
    pub force_relative: f64,
}

/// What simple rules reach on the held-out grasps, to compare [`EpochStats::held_out`] with.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Baselines {
    /// One prediction, the mean of the training grasps, with the mean grip force whatever the mass.
    pub mean_demonstration: GraspErrors,
    /// As many training grasps as the policy has modes, drawn at random, with their grip force per weight; mean over draws.
    pub random_demonstrations: GraspErrors,
    /// All training grasps at hand: the nearest one, with its grip force per weight. It knows more grasps than the policy may keep.
    pub nearest_demonstration: GraspErrors,
}

/// One grasp the trained policy holds ready, seen from the training grasps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ModeReport {
    /// Probability that the policy gives it, mean over the training grasps.
    pub weight: f64,
    /// Root mean square joint difference to the training grasp nearest to it, rad. A mode far from every
    /// demonstration is an average of grasps and need not be one.
    pub nearest_demonstration_rad: f64,
    /// How many distinct training grasps are nearer to this mode than to any other.
    pub demonstrations: usize,
}

/// The record of a training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TrainReport {
    /// One entry per finished epoch.
    pub curve: Vec<EpochStats>,
    /// One entry per finished round of rollouts.
    pub rollouts: Vec<RolloutStats>,
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
    /// Mean log-likelihood of the finished policy on them, joints and wrist, nats over rad^J m³ rad³.
    pub held_out_log_likelihood: Option<f64>,
    /// The same of the joints alone, nats over rad^J.
    pub held_out_joint_log_likelihood: Option<f64>,
    /// How widely grasps scatter about a mode.
    pub spread: Spread,
    /// What simple rules reach on the same grasps.
    pub baselines: Option<Baselines>,
    /// Whether the caller stopped before the last epoch.
    pub stopped_early: bool,
    /// Wall time spent learning, s. The only field that differs between runs with the same data, options and seed; it is not
    /// serialised.
    #[serde(skip)]
    pub seconds: f64,
    /// The settings.
    pub options: TrainOptions,
}
