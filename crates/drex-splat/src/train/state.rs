//! What a training run carries from step to step.

use super::density::Statistics;
use super::model::Model;
use crate::loss::Exposure;
use crate::optim::Moments;

/// Everything that changes from step to step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct State {
    pub step: u32,
    /// How often opacities have been reset.
    pub resets: u32,
    pub model: Model,
    pub statistics: Statistics,
    /// Affine colours, one for each photo trained on.
    pub exposures: Vec<Exposure>,
    pub exposure_moments: Vec<Moments>,
    /// Corrections of the poses, one for each photo trained on: quaternion w, x, y, z and translation.
    pub poses: Vec<[f64; 7]>,
    pub pose_moments: Vec<Moments>,
}

impl State {
    pub fn new(model: Model, photos: usize) -> Self {
        let n = model.len();
        Self {
            step: 0,
            resets: 0,
            model,
            statistics: Statistics::new(n),
            exposures: vec![Exposure::default(); photos],
            exposure_moments: vec![Moments::new(12, 1); photos],
            poses: vec![[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]; photos],
            pose_moments: vec![Moments::new(6, 1); photos],
        }
    }
}
