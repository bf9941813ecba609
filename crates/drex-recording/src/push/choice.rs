//! Which of several recorded inputs to use.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

use drex_core::{Error, Result};

/// Inputs of a push that comes in several qualities, as in a simulated set. Other pushes only heed `encoder`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InputChoice {
    /// Which pose track.
    pub poses: PoseChoice,
    /// Which force record.
    pub force: ForceChoice,
    /// Whether a fingertip encoder is used where there is one.
    pub encoder: bool,
}

impl Default for InputChoice {
    fn default() -> Self {
        Self { poses: PoseChoice::default(), force: ForceChoice::default(), encoder: true }
    }
}

/// Quality of the pose track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PoseChoice {
    /// White noise of known size.
    #[default]
    Noisy,
    /// Noise, bias, clock offset, gaps, outliers.
    Hard,
    /// Exact.
    Clean,
}

/// Quality of the force record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ForceChoice {
    /// As a sensor would give it.
    #[default]
    Noisy,
    /// As it was applied.
    Exact,
}

impl PoseChoice {
    /// Its name on the command line and in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Noisy => "noisy",
            Self::Hard => "hard",
            Self::Clean => "clean",
        }
    }
}

impl ForceChoice {
    /// Its name on the command line and in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Noisy => "noisy",
            Self::Exact => "exact",
        }
    }
}

impl FromStr for PoseChoice {
    type Err = Error;

    fn from_str(s: &str) -> Result<Self> {
        [Self::Noisy, Self::Hard, Self::Clean]
            .into_iter()
            .find(|c| c.as_str() == s)
            .ok_or_else(|| Error::value(format!("`{s}` is no kind of pose track"), "choose noisy, hard or clean"))
    }
}

impl FromStr for ForceChoice {
    type Err = Error;

    fn from_str(s: &str) -> Result<Self> {
        [Self::Noisy, Self::Exact]
            .into_iter()
            .find(|c| c.as_str() == s)
            .ok_or_else(|| Error::value(format!("`{s}` is no kind of force record"), "choose noisy or exact"))
    }
}
