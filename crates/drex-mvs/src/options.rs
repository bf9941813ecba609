//! What is asked for.

use std::path::PathBuf;

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
    /// Whether photos are compared on the GPU, which takes the feature `wgpu` and gives other numbers of the same quality.
    pub on_gpu: bool,
    /// Folder for what is found on the way: with one, memory holds the planes of a few photos at a time, and a run of the same photos and options
    /// that was interrupted is gone on with. [`remove_work`](crate::remove_work) removes
    /// what is in it when there is no need of it any more.
    pub work: Option<PathBuf>,
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
            on_gpu: false,
            work: None,
        }
    }
}

/// What is done with each photo before the next thing is done with any.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Round {
    /// The pictures are halved so many times.
    pub halvings: usize,
    /// Passes in which photos alone decide; if there are none, the other photos' depth counts as well, in one pass.
    pub alone: usize,
    /// Of that pass at this size.
    pub number: u64,
    /// Whether it is the last one of all.
    pub last: bool,
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

    /// From small pictures to large ones.
    pub(crate) fn rounds(self) -> Vec<Round> {
        // Halvings, passes of photos alone, and passes in which depth counts.
        let sizes = match self {
            Self::Fast => [[2, 4, 0], [1, 2, 1], [0, 0, 1]],
            Self::Default => [[2, 4, 0], [1, 3, 1], [0, 1, 2]],
            Self::Best => [[2, 6, 0], [1, 4, 1], [0, 2, 3]],
        };
        let mut rounds = Vec::new();
        for [halvings, alone, together] in sizes {
            let round = Round { halvings, alone, number: 0, last: false };
            rounds.extend((alone > 0).then_some(round));
            rounds.extend((0..together).map(|k| Round { alone: 0, number: (alone + k) as u64, ..round }));
        }
        rounds.iter_mut().last().into_iter().for_each(|round| round.last = true);
        rounds
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
