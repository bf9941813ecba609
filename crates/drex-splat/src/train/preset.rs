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
    Adaptive,
    /// Markov chain Monte Carlo: of the two the one that fogs photos held out less.
    #[default]
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

    /// Most Gaussians of one set of a capture with `sparse_points` triangulated points. Feature points measure how much
    /// there is to see: where they are few, more Gaussians learn the photos by heart and fog all other views.
    pub fn max_gaussians(self, sparse_points: usize) -> usize {
        let (a_point, most) = match self {
            Self::Fast => (2, 30_000),
            Self::Default => (6, 150_000),
            Self::Best => (20, 1_000_000),
        };
        sparse_points.saturating_mul(a_point).clamp(5000, most)
    }

    /// Options of one set of a capture with `sparse_points` triangulated points.
    pub fn train_options(self, kind: Kind, density: DensityChoice, sparse_points: usize) -> TrainOptions {
        let iterations = match self {
            Self::Fast => 2500,
            Self::Default => 7000,
            Self::Best => 30_000,
        };
        let max_gaussians = self.max_gaussians(sparse_points);
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
