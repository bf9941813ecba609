//! Settings for a laptop, from minutes to hours.

use serde::{Deserialize, Serialize};

use crate::Kind;
use crate::train::options::{Adaptive, Coarse, Density, Mcmc, Rates, SurfaceTerms, TrainOptions};

/// How much time reconstruction may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Minutes on one core: a look at whether the scan is any good.
    Fast,
    /// Tens of minutes.
    #[default]
    Default,
    /// Hours: all pixels, as many steps as the papers.
    Best,
}

/// How Gaussians are born and removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DensityChoice {
    /// Adaptive density control.
    #[default]
    Adaptive,
    /// Markov chain Monte Carlo.
    Mcmc,
}

impl Preset {
    /// Longest side of the photos, pixels.
    pub fn max_side(self) -> usize {
        match self {
            Self::Fast => 512,
            Self::Default => 1024,
            Self::Best => 1920,
        }
    }

    /// Options of one set.
    pub fn train_options(self, kind: Kind, density: DensityChoice) -> TrainOptions {
        let (iterations, max_gaussians) = match (self, kind) {
            (Self::Fast, Kind::Ellipsoid) => (2000, 30_000),
            (Self::Fast, Kind::Surfel) => (1500, 30_000),
            (Self::Default, _) => (7000, 150_000),
            (Self::Best, _) => (30_000, 1_000_000),
        };
        let coarse = match self {
            Self::Fast => vec![Coarse { divisor: 2, until: 0.4 }],
            Self::Default => vec![Coarse { divisor: 4, until: 0.1 }, Coarse { divisor: 2, until: 0.4 }],
            Self::Best => vec![Coarse { divisor: 4, until: 0.05 }, Coarse { divisor: 2, until: 0.2 }],
        };
        let reset_every = match self {
            Self::Fast => 0,
            Self::Default | Self::Best => 3000,
        };
        let density = match density {
            DensityChoice::Adaptive => Density::Adaptive(Adaptive { reset_every, ..Adaptive::default() }),
            DensityChoice::Mcmc => Density::Mcmc(Mcmc::default()),
        };
        TrainOptions {
            kind,
            iterations,
            max_gaussians,
            coarse,
            density,
            rates: Rates::default(),
            surface: SurfaceTerms::default(),
            ..TrainOptions::default()
        }
    }
}
