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
    /// While training, turn object and wrist together about the object's z axis by up to this angle either way, rad.
    /// Zero (default) keeps the frame of the mesh; use π if the policy will see the object in any heading.
    pub yaw_range_rad: f64,
    /// Share of the loss that goes to the modes that did not win, at the start; it falls to zero.
    pub share: f64,
    /// Weight of the squeeze loss (squared error of the logarithm) against the grasp loss. At 10, a squeeze wrong by a tenth counts as
    /// much as a grasp off by three hundredths of `length_m`.
    pub force_weight: f64,
    /// Weight of the loss of the mode probabilities against the grasp loss.
    pub mode_weight: f64,
    /// Every how many grasps one is kept out of training to measure on; 0 keeps none out.
    pub hold_out_every: usize,
    /// Seed of everything random: split, initial weights, order, noise.
    pub seed: u64,
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
            share: 0.05,
            force_weight: 10.0,
            mode_weight: 0.1,
            hold_out_every: 8,
            seed: 0,
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
        for (option, value, least, most) in counts {
            if !(least..=most).contains(&value) {
                return Err(Error::Option { option, what: format!("{value} is outside {least} .. {most}") });
            }
        }
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
            ("force_weight", self.force_weight, 0.0, 1e3),
            ("mode_weight", self.mode_weight, 0.0, 1e3),
        ];
        for (option, value, least, most) in reals {
            // Written so that a NaN is refused as well.
            if !(value >= least && value <= most) {
                return Err(Error::Option { option, what: format!("{value} is outside {least} .. {most}") });
            }
        }
        Ok(())
    }
}
