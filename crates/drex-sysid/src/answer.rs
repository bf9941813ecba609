//! The answer: a mass with an interval, or why there is none.

use serde::de::IgnoredAny;
use serde::{Deserialize, Deserializer, Serialize};

use crate::MassDistribution;
use crate::bound::Bound;
use crate::frames::{FoundFrames, HandPlacement};

/// What the recordings can tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The mass.
    Identified,
    /// Only the product of friction coefficient and mass.
    OnlyMuM,
    /// A mass was fitted to them ([`crate::Method::Adam`]), without an interval: whether they tell one was not asked.
    Fitted,
    /// Neither.
    NotIdentifiable,
}

/// The result of [`crate::identify`]. Its first fields are what `--json` prints; absent values are null.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Identification {
    /// Estimated mass, kg; only with [`Verdict::Identified`] and [`Verdict::Fitted`].
    pub mass_kg: Option<f64>,
    /// 95 % interval of the mass, kg; absent with [`crate::Method::Adam`], which has none. Pushes of a hand give one even where it
    /// is too wide for a verdict.
    pub ci95_kg: Option<[f64; 2]>,
    /// What the recordings can tell.
    pub verdict: Verdict,
    /// Friction times mass, kg, where only that is known.
    pub mu_m_kg: Option<f64>,
    /// The verdict in words.
    pub reason: String,
    /// Wall time, seconds; not in the serialised answer, which is the same in every run.
    #[serde(skip)]
    pub seconds: f64,
    /// Simulated pushes, those with derivatives included.
    pub simulations: usize,
    /// A first guess that came with the recordings, kg. It took no part in this: [`crate::MassPosterior`] is where the two meet.
    pub prior_kg: Option<f64>,
    /// Friction of the support that was estimated along with the mass, if it was.
    pub friction: Option<f64>,
    /// Standard deviation of the logarithm of the mass, all sources of error together; absent when it is infinite.
    pub sd_log_mass: Option<f64>,
    /// Its parts, of the simulated pushes.
    #[serde(default, deserialize_with = "budget")]
    pub error_budget: Option<ErrorBudget>,
    /// What else was estimated.
    #[serde(default)]
    pub estimates: Vec<ParameterEstimate>,
    /// What errors in what was taken for granted do to the mass.
    pub sensitivities: Vec<Sensitivity>,
    /// What was taken for granted.
    pub assumptions: Vec<String>,
    /// Mass (kg) and minus the logarithm of the density of ln m, up to a constant, by mass, where there is an interval; elsewhere the
    /// costs of the scan (half the robust sum of squares, errors of the track fitted).
    #[serde(deserialize_with = "costs")]
    pub profile: Vec<(f64, f64)>,
    /// One per push.
    pub pushes: Vec<PushReport>,
}

/// Reads masses and costs: a cost that is not finite, of a mass that could not be simulated, is null in JSON.
fn costs<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(f64, f64)>, D::Error> {
    let pairs: Vec<(f64, Option<f64>)> = Vec::deserialize(deserializer)?;
    Ok(pairs.into_iter().map(|(mass, cost)| (mass, cost.unwrap_or(f64::INFINITY))).collect())
}

/// Reads the budget: none where a former version divided the error otherwise.
fn budget<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<ErrorBudget>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Budget {
        Present(ErrorBudget),
        Former(IgnoredAny),
    }
    Ok(match Option::<Budget>::deserialize(deserializer)? {
        Some(Budget::Present(budget)) => Some(budget),
        Some(Budget::Former(_)) | None => None,
    })
}

impl Identification {
    /// What the pushes alone say of the mass, as a distribution; absent where no interval is stated, since they say nothing then.
    ///
    /// It is that of [`Identification::profile`]. A bound from one side lacks one of its [bounds](MassDistribution::bounds_kg).
    pub fn likelihood(&self) -> Option<MassDistribution> {
        self.ci95_kg?;
        MassDistribution::from_costs(&self.profile).ok()
    }
}

/// Standard deviations of the logarithm of the mass by source, at the likeliest mode; their squares add up to its variance
/// (the part `force_factor` is counted in `force`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ErrorBudget {
    /// Noise of the poses; where the simulation misses them by more than their noise, what it misses by, with its correlation in time.
    pub poses: f64,
    /// The same of a finger's encoder.
    pub encoder: f64,
    /// Noise of the recorded force.
    pub force: f64,
    /// The part of that which no pose can tell. Force and mass times one factor move everything alike, and noise of deviation s on
    /// the samples u of a force is such a factor of deviation s / |u|: no estimate from this record has a smaller deviation,
    /// however good the poses.
    pub force_factor: f64,
    /// Contact that decides by chance (chatter, sticking or slipping), and the time step of the simulator.
    pub contact: f64,
    /// What is known beforehand only so well: start, clock and bias of the track, and whatever was stated with a deviation.
    pub stated: f64,
    /// How far two correct simulators differ about the mass from such a push.
    pub simulator: f64,
}

/// A parameter that was estimated along with the mass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterEstimate {
    /// The parameter.
    pub parameter: crate::Parameter,
    /// The push whose parameter it is; absent for one that all pushes share.
    pub push: Option<String>,
    /// Its value.
    pub value: f64,
    /// Standard deviation from the noise of the observations; of the value itself.
    pub sd: f64,
}

/// What an error in a parameter that was taken as stated does to the mass, to first order.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// The parameter.
    pub parameter: crate::Parameter,
    /// Change of the logarithm of the estimated mass per change of the parameter; per change of its logarithm where it is
    /// positive by nature (0.5: friction 10 % higher, mass 5 % higher).
    pub log_mass: f64,
}

/// How one push was reproduced.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PushReport {
    /// Name of the push.
    pub name: String,
    /// Standard deviation taken for positions, metres.
    pub position_sd_m: f64,
    /// Standard deviation taken for rotations, radians per axis.
    pub rotation_sd_rad: f64,
    /// Root mean square of the position residual, metres (three axes).
    pub rms_position_m: Option<f64>,
    /// Root mean square of the rotation residual, radians (three axes).
    pub rms_rotation_rad: Option<f64>,
    /// Frames that count less than half (outliers).
    pub outliers: usize,
    /// Offset of the track's clock that was estimated, seconds.
    pub clock_offset_s: Option<f64>,
    /// Root mean square distance of the simulated from the measured fingertip along the push, metres; with an encoder.
    pub rms_encoder_m: Option<f64>,
    /// Constant error of the tracked position that was estimated, metres.
    pub position_bias_m: Option<[f64; 3]>,
    /// What each pose tells about the mass, as a share of what all observations of all pushes tell; empty if nothing was estimated.
    #[serde(default)]
    pub information: Vec<f64>,
    /// Times of the poses, seconds.
    pub times_s: Vec<f64>,
    /// Tracked poses: x, y, z (m), then w, x, y, z of the quaternion.
    pub observed: Vec<[f64; 7]>,
    /// The simulated poses at the estimate, same layout; empty if nothing was simulated.
    pub simulated: Vec<[f64; 7]>,
    /// What was found in the recording.
    pub notes: Vec<String>,
    /// Frames, clocks and forces of a push by a hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hand: Option<HandReport>,
}

/// What was found about a push by a hand. Pairs are value and standard deviation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct HandReport {
    /// Up while the object rests, unit vector in the tracked frame.
    pub up_in_tracked: [f64; 3],
    /// Horizontal direction to where it topples, unit vector in the tracked frame; absent if it does not tilt.
    pub topples_towards_in_tracked: Option<[f64; 3]>,
    /// Odds of the next best up direction against this one.
    pub runner_up_odds: f64,
    /// When the object begins to move, seconds of the track.
    pub motion_start_s: [f64; 2],
    /// Until when the track agrees with a rigid object on a table, seconds.
    pub trusted_until_s: f64,
    /// Delay of the tracker against the joint log, seconds; absent where the hand could not be placed.
    pub clock_offset_s: Option<[f64; 2]>,
    /// How much higher over the table the hand is than stated, metres.
    pub height_offset_m: Option<[f64; 2]>,
    /// Fingers that push.
    pub fingers: Vec<String>,
    /// First and last touch, seconds of the joint log.
    pub touch_s: Option<[f64; 2]>,
    /// Moment of the fingertips about the edge of the foot, over the touch, N m s.
    pub impulse_nms: Option<f64>,
    /// What each uncertain quantity costs: square root of the variance of log mass that knowing it would save; largest first.
    pub budget: Vec<(String, f64)>,
}

impl HandReport {
    pub(crate) fn of(found: &FoundFrames) -> Self {
        Self {
            up_in_tracked: found.up_in_tracked.into(),
            topples_towards_in_tracked: found.topples_towards_in_tracked.map(Into::into),
            runner_up_odds: found.runner_up_odds,
            motion_start_s: [found.motion_start_s, found.motion_start_sd_s],
            trusted_until_s: found.trusted_until_s,
            clock_offset_s: None,
            height_offset_m: None,
            fingers: Vec::new(),
            touch_s: None,
            impulse_nms: None,
            budget: Vec::new(),
        }
    }

    pub(crate) fn place(&mut self, placement: Option<&HandPlacement>) {
        self.clock_offset_s = placement.map(|p| p.clock_offset_s);
        self.height_offset_m = placement.map(|p| p.height_offset_m);
    }

    pub(crate) fn fill(&mut self, bound: &Bound) {
        self.fingers.clone_from(&bound.fingers);
        self.touch_s = bound.seen.then_some(bound.from_to_s);
        self.impulse_nms = bound.seen.then_some(bound.impulse_nms);
        if bound.seen {
            self.budget = bound.budget.iter().map(|(n, sd)| (n.clone(), sd / bound.per_kg.abs())).collect();
        }
    }
}
