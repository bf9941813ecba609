//! What is asked for.

use drex_core::{Error, Pose, Result};
use nalgebra::Point3;

/// How much work is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Preset {
    /// Windows of 25 samples, five other photos, one round of consistency at full size. Has time for 0.3 megapixels of a photo.
    Fast,
    /// Windows of 36 samples, six other photos, two rounds of consistency at full size. Has time for a megapixel.
    #[default]
    Default,
    /// As the default with eight other photos and more rounds, and time for whatever there is.
    Best,
}

/// The space in which surfaces are looked for: a box in a frame of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// Maps points of the capture's world to the frame of the box, in the capture's unit of length.
    pub box_from_world: Pose,
    /// Lower and upper corner, frame of the box.
    pub corners: [Point3<f64>; 2],
}

/// How depth is estimated.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MvsOptions {
    /// How much work is done.
    pub preset: Preset,
    /// Where surfaces are looked for. If it is `None`: about the sparse points that masks show; without masks in the range of all sparse points
    /// of each photo, which takes several times as long.
    pub region: Option<Region>,
    /// Longest side of the pictures that are compared, pixels; larger photos are scaled down.
    pub max_side: Option<usize>,
    /// Pixels beyond a mask's rim in which depth is looked for as well.
    pub mask_margin_px: usize,
    /// Depths with less confidence are left out, see [`DepthMap::confidence`](crate::DepthMap::confidence); from 0 to 1.
    pub least_confidence: f32,
    /// Of the random planes that are tried.
    pub seed: u64,
}

impl Default for MvsOptions {
    fn default() -> Self {
        Self {
            preset: Preset::Default,
            region: None,
            max_side: Some(2000),
            mask_margin_px: 2,
            least_confidence: 0.2,
            seed: 0,
        }
    }
}

/// What is done at one size of the pictures.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Level {
    /// The pictures are halved so many times.
    pub halvings: usize,
    /// Passes in which photos alone decide.
    pub photometric: usize,
    /// Passes in which the other photos' depth counts as well.
    pub geometric: usize,
}

impl Preset {
    /// Pixels of a photo in which there is time to look for depth.
    pub(crate) fn pixels(self) -> f64 {
        match self {
            Self::Fast => 0.3e6,
            Self::Default => 1e6,
            Self::Best => f64::INFINITY,
        }
    }

    /// Other photos that each one is compared with.
    pub(crate) fn sources(self) -> usize {
        match self {
            Self::Fast => 5,
            Self::Default => 6,
            Self::Best => 8,
        }
    }

    pub(crate) fn levels(self) -> [Level; 3] {
        let level = |halvings, photometric, geometric| Level { halvings, photometric, geometric };
        match self {
            Self::Fast => [level(2, 4, 0), level(1, 2, 1), level(0, 0, 1)],
            Self::Default => [level(2, 4, 0), level(1, 3, 1), level(0, 1, 2)],
            Self::Best => [level(2, 6, 0), level(1, 4, 1), level(0, 2, 3)],
        }
    }
}

impl Region {
    /// # Errors
    /// If a number is not finite or a corner is not below the other.
    pub(crate) fn check(&self) -> Result<()> {
        let [lo, hi] = &self.corners;
        if (0..3).all(|k| lo[k] < hi[k] && (hi[k] - lo[k]).is_finite())
            && self.box_from_world.to_homogeneous().iter().all(|v| v.is_finite())
        {
            return Ok(());
        }
        Err(Error::value(format!("a region from {lo} to {hi}"), "give a box of finite size, its lower corner first"))
    }

    /// Its middle, world frame.
    pub(crate) fn centre(&self) -> Point3<f64> {
        self.box_from_world.inverse_transform_point(&nalgebra::center(&self.corners[0], &self.corners[1]))
    }

    /// Its corners, world frame.
    pub(crate) fn corners_world(&self) -> [Point3<f64>; 8] {
        let pick = |i: usize| Point3::from([0, 1, 2].map(|k| self.corners[i >> k & 1][k]));
        std::array::from_fn(|i| self.box_from_world.inverse_transform_point(&pick(i)))
    }
}
