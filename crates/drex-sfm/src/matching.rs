//! Which keypoints of two photos look alike: nearest descriptors, by Lowe's ratio both ways.

use openmvg_features::matching::{HnswConfig, HnswMatcher, MatchAcceptance};
use openmvg_sfm::RunSeed;
use rayon::prelude::*;

use crate::distance::SquaredDistance;
use crate::features::Features;

/// A nearest descriptor has to be this much nearer than the second (Lowe 2004).
const RATIO: f32 = 0.8;

/// Two keypoints that look alike, and how far apart their descriptors are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Match {
    pub(crate) first: usize,
    pub(crate) second: usize,
    pub(crate) distance: f32,
}

/// Two photos by their indices, the smaller first, and their matches sorted by keypoint.
#[derive(Debug, Clone)]
pub(crate) struct PairMatches {
    pub(crate) views: [usize; 2],
    pub(crate) matches: Vec<Match>,
}

/// Descriptors of a photo, and the index over them.
type Indexed<'a> = (Vec<&'a [u8]>, Option<HnswMatcher<u8, SquaredDistance>>);

/// Search indices of all photos.
pub(crate) struct Matcher<'a> {
    photos: Vec<Indexed<'a>>,
}

impl<'a> Matcher<'a> {
    pub(crate) fn new(photos: &'a [Features], seed: u64) -> Self {
        let index = |(i, features): (usize, &'a Features)| {
            let descriptors: Vec<&[u8]> = features.descriptors.iter().map(<[u8; 128]>::as_slice).collect();
            let own = RunSeed::from_u64(seed).derive("drex-sfm/search", &[i as u64]);
            let mut matcher = HnswMatcher::with_config(HnswConfig::high_recall().with_seed(own));
            let built = descriptors.len() >= 2 && matcher.build(&descriptors).is_ok();
            (descriptors, built.then_some(matcher))
        };
        Self { photos: photos.par_iter().enumerate().map(index).collect() }
    }

    /// Matches of the pairs, in their order.
    pub(crate) fn pairs(&self, pairs: &[[usize; 2]], advance: &(dyn Fn() + Sync)) -> Vec<PairMatches> {
        let one = |&views: &[usize; 2]| {
            let matches = self.pair(views).unwrap_or_default();
            advance();
            PairMatches { views, matches }
        };
        pairs.par_iter().map(one).collect()
    }

    fn pair(&self, [i, j]: [usize; 2]) -> Option<Vec<Match>> {
        let (of_first, first) = &self.photos[i];
        let (of_second, second) = &self.photos[j];
        let (first, second) = (first.as_ref()?, second.as_ref()?);
        let forward = second.query_batch(of_first, 2).ok()?;
        let back = |targets: &[usize]| {
            let queries: Vec<&[u8]> = targets.iter().map(|&t| of_second[t]).collect();
            first.query_batch(&queries, 2)
        };
        let kept = MatchAcceptance::Reciprocal.filter_squared(&forward, RATIO, back).ok()?;
        let matched = |m: &openmvg_features::matching::FilteredMatch| Match {
            first: m.query_index(),
            second: m.target_index(),
            distance: m.distance(),
        };
        let mut matches: Vec<Match> = kept.iter().map(matched).collect();
        matches.sort_by_key(|m| (m.first, m.second));
        matches.dedup_by_key(|m| (m.first, m.second));
        Some(matches)
    }
}
