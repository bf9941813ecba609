//! Which keypoints of two photos look alike: nearest descriptors, by Lowe's ratio both ways.

use openmvg_features::matching::{FilteredMatch, HnswConfig, HnswMatcher, MatchAcceptance};
use openmvg_sfm::RunSeed;
use rayon::prelude::*;

use crate::distance::{self, Descriptor, SquaredDistance};
use crate::features::Features;

/// A nearest descriptor has to be this much nearer than the second (Lowe 2004).
const RATIO: f32 = 0.8;

/// Two keypoints that look alike, by their indices, and how far apart their descriptors are. Of many photos there are millions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Match {
    first: u32,
    second: u32,
    pub(crate) distance: f32,
}

impl Match {
    /// A photo has far fewer than 2^32 keypoints.
    pub(crate) fn new([first, second]: [usize; 2], distance: f32) -> Self {
        Self { first: first as u32, second: second as u32, distance }
    }

    pub(crate) fn keypoints(&self) -> [usize; 2] {
        [self.first as usize, self.second as usize]
    }
}

/// Two photos by their indices, the smaller first, and their matches sorted by keypoint.
#[derive(Debug, Clone)]
pub(crate) struct PairMatches {
    pub(crate) views: [usize; 2],
    pub(crate) matches: Vec<Match>,
}

/// Up to so many keypoints in each photo every two are compared: of 3000 that takes as long as the search in an index, of 300 an eighth.
const COMPARE_ALL: usize = 3000;

/// The index over a photo's descriptors, where it has two or more.
type Index = Option<HnswMatcher<u8, SquaredDistance>>;

/// Descriptors of all photos, and what is searched instead of comparing all of two photos.
pub(crate) struct Matcher<'a> {
    photos: &'a [Features],
    indices: Option<Vec<Index>>,
}

impl<'a> Matcher<'a> {
    pub(crate) fn new(photos: &'a [Features], seed: u64) -> Self {
        let large = photos.iter().any(|f| f.descriptors.len() > COMPARE_ALL);
        Self { photos, indices: large.then(|| Self::indices(photos, seed)) }
    }

    fn indices(photos: &[Features], seed: u64) -> Vec<Index> {
        let index = |(i, features): (usize, &Features)| {
            let own = RunSeed::from_u64(seed).derive("drex-sfm/search", &[i as u64]);
            let mut matcher = HnswMatcher::with_config(HnswConfig::high_recall().with_seed(own));
            let built = features.descriptors.len() >= 2 && matcher.build(&slices(features)).is_ok();
            built.then_some(matcher)
        };
        photos.par_iter().enumerate().map(index).collect()
    }

    /// Matches of the pairs, in their order.
    pub(crate) fn pairs(&self, pairs: &[[usize; 2]], advance: &(dyn Fn() + Sync)) -> Vec<PairMatches> {
        let one = |&views: &[usize; 2]| {
            let matches = match &self.indices {
                Some(indices) => self.search(indices, views).unwrap_or_default(),
                None => compare(views.map(|k| self.photos[k].descriptors.as_slice())),
            };
            advance();
            PairMatches { views, matches }
        };
        pairs.par_iter().map(one).collect()
    }

    fn search(&self, indices: &[Index], [i, j]: [usize; 2]) -> Option<Vec<Match>> {
        let (first, second) = (indices[i].as_ref()?, indices[j].as_ref()?);
        let forward = second.query_batch(&slices(&self.photos[i]), 2).ok()?;
        let back = |targets: &[usize]| {
            let queries: Vec<&[u8]> = targets.iter().map(|&t| self.photos[j].descriptors[t].as_slice()).collect();
            first.query_batch(&queries, 2)
        };
        let kept = MatchAcceptance::Reciprocal.filter_squared(&forward, RATIO, back).ok()?;
        let matched = |m: &FilteredMatch| Match::new([m.query_index(), m.target_index()], m.distance());
        let mut matches: Vec<Match> = kept.iter().map(matched).collect();
        matches.sort_by_key(Match::keypoints);
        matches.dedup_by_key(|m| m.keypoints());
        Some(matches)
    }
}

fn slices(features: &Features) -> Vec<&[u8]> {
    features.descriptors.iter().map(Descriptor::as_slice).collect()
}

/// The nearest descriptor, its squared distance, and that of the second nearest.
#[derive(Clone, Copy)]
struct Nearest {
    index: usize,
    best: u32,
    second: u32,
}

impl Nearest {
    const NONE: Self = Self { index: usize::MAX, best: u32::MAX, second: u32::MAX };

    #[inline(always)]
    fn consider(&mut self, index: usize, distance: u32) {
        if distance < self.best {
            *self = Self { index, best: distance, second: self.best };
        } else if distance < self.second {
            self.second = distance;
        }
    }

    /// By Lowe's ratio, which needs a second.
    fn is_distinct(&self) -> bool {
        self.second != u32::MAX && f64::from(self.best) < f64::from(RATIO).powi(2) * f64::from(self.second)
    }
}

/// Compares all descriptors of two photos, each two once.
fn compare([first, second]: [&[Descriptor]; 2]) -> Vec<Match> {
    let mut forward = vec![Nearest::NONE; first.len()];
    let mut backward = vec![Nearest::NONE; second.len()];
    // Of those that are near enough to count, apart, so that many can be passed over at once: most are far.
    let mut bars = vec![u32::MAX; second.len()];
    distance::each(first, second, |[i, start], distances| {
        let mut nearest = forward[i];
        let near = |(distance, bar): (&u32, &u32)| *distance < nearest.second.max(*bar);
        if !distances.iter().zip(&bars[start..]).map(near).fold(false, |any, near| any | near) {
            return;
        }
        for ((j, reverse), distance) in (start..).zip(&mut backward[start..]).zip(distances) {
            nearest.consider(j, *distance);
            reverse.consider(i, *distance);
            bars[j] = reverse.second;
        }
        forward[i] = nearest;
    });
    let matched = |(i, nearest): (usize, &Nearest)| {
        let reverse = backward.get(nearest.index)?;
        (reverse.index == i && nearest.is_distinct() && reverse.is_distinct())
            .then_some(Match::new([i, nearest.index], nearest.best as f32))
    };
    forward.iter().enumerate().filter_map(matched).collect()
}

#[cfg(test)]
mod tests {
    use openmvg_features::matching::BruteForceMatcher;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Two photos of `n` keypoints, the first third of which both show.
    fn photos(n: usize) -> [Vec<Descriptor>; 2] {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(n as u64);
        let mut any = |_: usize| -> Descriptor { std::array::from_fn(|_| rng.random_range(0..=255)) };
        let first: Vec<_> = (0..n).map(&mut any).collect();
        let mut second: Vec<_> = (0..n).map(&mut any).collect();
        for (a, b) in first.iter().zip(&mut second).take(n / 3) {
            *b = a.map(|v| v.saturating_add(3));
        }
        second.reverse();
        [first, second]
    }

    #[test]
    fn all_are_compared_as_by_another_implementation_and_found_by_the_index() {
        for n in [0, 1, 2, 3, 300] {
            let [first, second] = photos(n);
            let same = |m: &FilteredMatch| Match::new([m.query_index(), m.target_index()], m.distance());
            let other = BruteForceMatcher::match_exact_u8(&first, &second, RATIO, MatchAcceptance::Reciprocal);
            let ours = compare([&first, &second]);
            assert_eq!(ours, other.iter().map(same).collect::<Vec<_>>(), "{n}");
            assert!(ours.len() >= if n > 2 { n / 3 } else { 0 }, "{} of {n}", ours.len());
            let photos = [first, second].map(|descriptors| Features { descriptors, ..Features::default() });
            let matcher = Matcher { photos: &photos, indices: Some(Matcher::indices(&photos, 1)) };
            let found = matcher.pairs(&[[0, 1]], &|| {});
            assert!(found[0].matches == ours, "{n}: {} instead of {}", found[0].matches.len(), ours.len());
        }
    }
}
