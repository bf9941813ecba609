//! Settings of a training run.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// How a policy is trained. Start from [`TrainOptions::default`] and change what differs:
///
/// ```
/// use drex_policy::TrainOptions;
/// let options = TrainOptions::default().with_modes(4).with_epochs(100).with_seed(7);
/// assert_eq!(options.modes, 4);
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct TrainOptions {
    /// Passes over the training samples.
    pub epochs: usize,
    /// Step size of Adam at the start; it falls to zero along a cosine.
    pub learning_rate: f64,
    /// Samples per step.
    pub batch: usize,
    /// Width of the hidden layers.
    pub hidden: usize,
    /// K: how many different grasps the policy holds ready. Never more than there are distinct grasps to learn from.
    /// More modes lie nearer to single demonstrations, fewer average over more of them;
    /// [`ModeReport`](crate::ModeReport) tells which it was.
    pub modes: usize,
    /// Points of the object that enter the network. More are thinned by farthest-point sampling; fewer are refused.
    pub points: usize,
    /// Frequencies of the positional encoding: sin and cos of 2^k π x / `length_m` for k below this.
    pub frequencies: usize,
    /// Length that scales points and wrist, and the lever that turns an angle error into a displacement
    /// of a fingertip, m: the size of a hand, not of an object.
    pub length_m: f64,
    /// Standard deviation of the noise on the points while training, m. It makes the policy insensitive to how the
    /// surface was sampled.
    pub point_noise_m: f64,
    /// While training, turn object and wrist together about the vertical by up to this angle either way, rad.
    /// Zero (default) keeps the frame of the mesh; use π if the policy will see the object in any heading.
    pub yaw_range_rad: f64,
    /// Standard deviation, while training, of a lean of object and wrist together about each horizontal axis, rad; the table follows.
    pub tilt_rad: f64,
    /// Standard deviation, while training, of the error of the object's centre along each axis, m: points, wrist and
    /// table all move against it.
    pub shift_m: f64,
    /// Share of the likelihood that every mode gets, whether it explains a grasp or not, at the start; it falls to zero. With random
    /// poses 0.3 keeps modes from dividing the headings among them instead of the kinds of grasps.
    pub share: f64,
    /// Weight of the distance (over a tenth of `length_m`) of the nearest mode against the likelihood. It keeps modes near
    /// grasps that the likelihood takes for outliers.
    pub nearest_weight: f64,
    /// Weight of the grip force loss (squared error of the logarithm) against the likelihood: 1/(2 σ²) for a relative error of σ.
    pub force_weight: f64,
    /// Weight of the contact loss (cross-entropy, summed over the fingers) against the likelihood.
    pub contact_weight: f64,
    /// Every how many grasps one is kept out of training to measure on; 0 keeps none out.
    pub hold_out_every: usize,
    /// Seed of everything random: split, initial weights, order, noise, draws of the rollouts.
    pub seed: u64,
    /// The second phase, in which grasps are tried.
    pub rollouts: RolloutOptions,
}

/// How a policy learns from grasps that were tried, see [`Trainer::roll_out`](crate::Trainer::roll_out).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct RolloutOptions {
    /// Rounds of trying and learning.
    pub epochs: usize,
    /// Views of objects per round.
    pub scenes: usize,
    /// Grasps tried per view, each at a mass and a friction of its own.
    pub tries: usize,
    /// Passes over the tried grasps of a round.
    pub passes: usize,
    /// Step size of Adam, constant.
    pub learning_rate: f64,
    /// Fingers that must hold the object.
    pub min_fingers: usize,
    /// Share of the friction cone that a grasp should use: the grip force aims at it.
    pub wanted_friction_share: f64,
    /// How much a grip force is raised after enough fingers touched and the object was lost all the same, as a factor.
    pub raise: f64,
    /// Weight of the squared distance (in spreads) of joints and wrists to what the first phase taught.
    pub anchor_weight: f64,
    /// Weight of the demonstrations, each counted by the success of the modes that stand for it.
    pub demo_weight: f64,
    /// Difference of reward, in 0 .. 1, that makes a mode e times as probable as another.
    pub reward_temperature: f64,
}

impl Default for RolloutOptions {
    fn default() -> Self {
        Self {
            epochs: 30,
            scenes: 8,
            tries: 8,
            passes: 4,
            learning_rate: 1e-3,
            min_fingers: 2,
            wanted_friction_share: 0.7,
            raise: 1.3,
            anchor_weight: 1.0,
            demo_weight: 0.1,
            reward_temperature: 0.2,
        }
    }
}

impl RolloutOptions {
    /// Sets [`epochs`](Self::epochs).
    #[must_use]
    pub fn with_epochs(mut self, epochs: usize) -> Self {
        self.epochs = epochs;
        self
    }

    /// Sets [`scenes`](Self::scenes).
    #[must_use]
    pub fn with_scenes(mut self, scenes: usize) -> Self {
        self.scenes = scenes;
        self
    }

    /// Sets [`tries`](Self::tries).
    #[must_use]
    pub fn with_tries(mut self, tries: usize) -> Self {
        self.tries = tries;
        self
    }

    fn validate(&self) -> Result<()> {
        let counts = [
            ("rollouts.epochs", self.epochs, 0, 100_000),
            ("rollouts.scenes", self.scenes, 1, 10_000),
            ("rollouts.tries", self.tries, 1, 10_000),
            ("rollouts.passes", self.passes, 1, 1000),
            ("rollouts.min_fingers", self.min_fingers, 1, 100),
        ];
        counts.into_iter().try_for_each(|(option, value, least, most)| count_within(option, value, least, most))?;
        let reals = [
            ("rollouts.learning_rate", self.learning_rate, 1e-8, 1.0),
            ("rollouts.wanted_friction_share", self.wanted_friction_share, 0.05, 1.0),
            ("rollouts.raise", self.raise, 1.0, 10.0),
            ("rollouts.anchor_weight", self.anchor_weight, 0.0, 1e6),
            ("rollouts.demo_weight", self.demo_weight, 0.0, 1e3),
            ("rollouts.reward_temperature", self.reward_temperature, 1e-3, 1e3),
        ];
        reals.into_iter().try_for_each(|(option, value, least, most)| real_within(option, value, least, most))
    }
}

fn count_within(option: &'static str, value: usize, least: usize, most: usize) -> Result<()> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(Error::Option { option, what: format!("{value} is outside {least} .. {most}") })
}

fn real_within(option: &'static str, value: f64, least: f64, most: f64) -> Result<()> {
    // Written so that a NaN is refused as well.
    if value >= least && value <= most {
        return Ok(());
    }
    Err(Error::Option { option, what: format!("{value} is outside {least} .. {most}") })
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            epochs: 200,
            learning_rate: 2e-3,
            batch: 64,
            hidden: 128,
            modes: 16,
            points: 512,
            frequencies: 6,
            length_m: 0.1,
            point_noise_m: 0.001,
            yaw_range_rad: 0.0,
            tilt_rad: 0.0,
            shift_m: 0.0,
            share: 0.05,
            nearest_weight: 10.0,
            force_weight: 100.0,
            contact_weight: 1.0,
            hold_out_every: 8,
            seed: 0,
            rollouts: RolloutOptions::default(),
        }
    }
}

impl TrainOptions {
    /// Sets [`epochs`](Self::epochs).
    #[must_use]
    pub fn with_epochs(mut self, epochs: usize) -> Self {
        self.epochs = epochs;
        self
    }

    /// Sets [`learning_rate`](Self::learning_rate).
    #[must_use]
    pub fn with_learning_rate(mut self, learning_rate: f64) -> Self {
        self.learning_rate = learning_rate;
        self
    }

    /// Sets [`batch`](Self::batch).
    #[must_use]
    pub fn with_batch(mut self, batch: usize) -> Self {
        self.batch = batch;
        self
    }

    /// Sets [`hidden`](Self::hidden).
    #[must_use]
    pub fn with_hidden(mut self, hidden: usize) -> Self {
        self.hidden = hidden;
        self
    }

    /// Sets [`modes`](Self::modes).
    #[must_use]
    pub fn with_modes(mut self, modes: usize) -> Self {
        self.modes = modes;
        self
    }

    /// Sets [`points`](Self::points).
    #[must_use]
    pub fn with_points(mut self, points: usize) -> Self {
        self.points = points;
        self
    }

    /// Sets [`hold_out_every`](Self::hold_out_every).
    #[must_use]
    pub fn with_hold_out_every(mut self, hold_out_every: usize) -> Self {
        self.hold_out_every = hold_out_every;
        self
    }

    /// Sets [`seed`](Self::seed).
    #[must_use]
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.seed = seed;
        self
    }

    /// Sets [`rollouts`](Self::rollouts).
    #[must_use]
    pub fn with_rollouts(mut self, rollouts: RolloutOptions) -> Self {
        self.rollouts = rollouts;
        self
    }

    /// Whether every option is inside its range. Sizes are bounded so that a wrong settings file cannot ask for more memory than there is.
    ///
    /// # Errors
    /// [`Error::Option`] with the name of the field.
    pub fn validate(&self) -> Result<()> {
        let counts = [
            ("epochs", self.epochs, 1, 1_000_000),
            ("batch", self.batch, 1, 65_536),
            ("hidden", self.hidden, 2, 2048),
            ("modes", self.modes, 1, 256),
            ("points", self.points, 4, 16_384),
            ("frequencies", self.frequencies, 0, 10),
            ("hold_out_every", self.hold_out_every, 0, usize::MAX),
        ];
        counts.into_iter().try_for_each(|(option, value, least, most)| count_within(option, value, least, most))?;
        if self.hold_out_every == 1 {
            return Err(Error::Option {
                option: "hold_out_every",
                what: "1 would keep every grasp out of training; use 0 or at least 2".into(),
            });
        }
        let reals = [
            ("learning_rate", self.learning_rate, 1e-8, 1.0),
            ("length_m", self.length_m, 1e-3, 10.0),
            ("point_noise_m", self.point_noise_m, 0.0, 0.1),
            ("yaw_range_rad", self.yaw_range_rad, 0.0, std::f64::consts::PI),
            ("share", self.share, 0.0, 0.5),
            ("tilt_rad", self.tilt_rad, 0.0, 0.5),
            ("shift_m", self.shift_m, 0.0, 0.1),
            ("nearest_weight", self.nearest_weight, 0.0, 1e3),
            ("force_weight", self.force_weight, 0.0, 1e5),
            ("contact_weight", self.contact_weight, 0.0, 1e3),
        ];
        reals.into_iter().try_for_each(|(option, value, least, most)| real_within(option, value, least, most))?;
        self.rollouts.validate()
    }
}
