//! The still background of a turntable: what stays at its pixel while other things move.
//!
//! A camera on a tripod sees a turning object and a room that stands still. The room has more texture, says "no motion", and wins every
//! robust estimate. It gives itself away: its keypoints recur at the same pixel, with the same descriptor, in many photos, while other
//! matches of the same pairs move.

use std::collections::BTreeMap;

use drex_core::sets::DisjointSets;

use crate::features::Features;
use crate::matching::PairMatches;

/// What stays within this many pixels (of a photo of 1000 pixels) stands still; the detector's own noise is not taken for motion.
const STILL_PX: f64 = 2.0;
const LEAST_STILL_PX: f64 = 1.5;
/// What moves, moves at least so far, in the same unit.
const MOVING_PX: f64 = 8.0;
/// A pair shows both when it has at least so many matches of each kind.
const LEAST_OF_EACH: usize = 12;
/// Photos from one tripod position have at least so many matches that stay.
const LEAST_OF_SAME: usize = 40;
/// A background is taken for one when at least this share of the photos is in such a pair with this many others.
const LEAST_SHARE: f64 = 0.5;
const LEAST_PARTNERS: usize = 3;

/// Cells, per longer side, on which the photos of one tripod position vote where the background is.
const CELLS: f64 = 64.0;
/// A cell is background when at least this share of its keypoints, and of its neighbours', stands still.
const BACKGROUND_SHARE: f64 = 0.35;

/// Keypoints of each photo that belong to a background that stands still.
#[derive(Debug, Clone)]
pub(crate) struct StillBackground {
    /// By photo, one flag per keypoint.
    pub(crate) still: Vec<Vec<bool>>,
    /// Share of all keypoints.
    pub(crate) share: f64,
}

/// Looks for a background that stands still; `None` where the photos show none.
pub(crate) fn find(pairs: &[PairMatches], photos: &[Features], side_px: f64) -> Option<StillBackground> {
    let (unit, still_px) = (side_px / 1000.0, still_px(side_px));
    let moved = |pair: &PairMatches, k: usize| {
        let [first, second] = pair.matches[k].keypoints();
        let (a, b) = (&photos[pair.views[0]].keypoints[first], &photos[pair.views[1]].keypoints[second]);
        f64::from(a.x() - b.x()).hypot(f64::from(a.y() - b.y()))
    };
    let mut partners = vec![0usize; photos.len()];
    let mut beside = vec![0usize; photos.len()];
    // Pairs from one tripod position.
    let mut same = Vec::new();
    // How many photos see each keypoint stay, and how many see it move.
    let mut stays: Vec<Vec<u32>> = photos.iter().map(|p| vec![0; p.keypoints.len()]).collect();
    let mut moves = stays.clone();
    for pair in pairs {
        let distances: Vec<f64> = (0..pair.matches.len()).map(|k| moved(pair, k)).collect();
        let still = distances.iter().filter(|d| **d <= still_px).count();
        let moving = distances.iter().filter(|d| **d >= MOVING_PX * unit).count();
        if still < LEAST_OF_EACH {
            continue;
        }
        if still >= LEAST_OF_SAME {
            same.push(pair.views);
            pair.views.iter().for_each(|&v| beside[v] += 1);
        }
        if moving >= LEAST_OF_EACH {
            pair.views.iter().for_each(|&v| partners[v] += 1);
        }
        for (m, d) in pair.matches.iter().zip(&distances) {
            let of = if *d <= still_px { &mut stays } else { &mut moves };
            pair.views.iter().zip(m.keypoints()).for_each(|(&view, keypoint)| of[view][keypoint] += 1);
        }
    }
    // A small object has few points in any one pair, but the same ones move in several.
    let movers = |v: usize| stays[v].iter().zip(&moves[v]).filter(|(s, m)| **m >= 2 && m > s).count();
    let shows_both =
        |v: usize| partners[v] >= LEAST_PARTNERS || beside[v] >= LEAST_PARTNERS && movers(v) >= LEAST_OF_EACH;
    let shown = (0..photos.len()).filter(|v| shows_both(*v)).count();
    if (shown as f64) < LEAST_SHARE * photos.len() as f64 {
        return None;
    }
    let flags =
        |(s, m): (&Vec<u32>, &Vec<u32>)| -> Vec<bool> { s.iter().zip(m).map(|(s, m)| *s >= 2 && *s > *m).collect() };
    let seen: Vec<Vec<bool>> = stays.iter().zip(&moves).map(flags).collect();
    let still = fill(&seen, photos, &positions(photos.len(), &same), side_px);
    let all: usize = still.iter().map(Vec::len).sum();
    let those: usize = still.iter().flatten().filter(|s| **s).count();
    Some(StillBackground { still, share: those as f64 / all.max(1) as f64 })
}

fn still_px(side_px: f64) -> f64 {
    (STILL_PX * side_px / 1000.0).max(LEAST_STILL_PX)
}

/// Which tripod position each photo is from.
fn positions(photos: usize, same: &[[usize; 2]]) -> Vec<u32> {
    let mut sets = DisjointSets::new(photos);
    same.iter().for_each(|[i, j]| sets.join(*i as u32, *j as u32));
    sets.labels().0
}

/// Adds the keypoints that lie where the background is: a weak one may have been recognised in no other photo, and would match the same
/// background from another tripod position.
fn fill(seen: &[Vec<bool>], photos: &[Features], positions: &[u32], side_px: f64) -> Vec<Vec<bool>> {
    let cell = |photo: usize, k: usize| {
        let p = &photos[photo].keypoints[k];
        [p.x(), p.y()].map(|v| (f64::from(v) / side_px * CELLS) as i64)
    };
    let mut votes = BTreeMap::<(u32, [i64; 2]), [usize; 2]>::new();
    for (photo, flags) in seen.iter().enumerate() {
        for (k, flag) in flags.iter().enumerate() {
            let vote = votes.entry((positions[photo], cell(photo, k))).or_default();
            *vote = [vote[0] + usize::from(*flag), vote[1] + 1];
        }
    }
    let background = |position: u32, [x, y]: [i64; 2]| {
        let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| [x + dx, y + dy]));
        let [still, all] =
            near.filter_map(|c| votes.get(&(position, c))).fold([0; 2], |s, v| [s[0] + v[0], s[1] + v[1]]);
        still as f64 >= BACKGROUND_SHARE * all as f64
    };
    let of_photo = |(photo, flags): (usize, &Vec<bool>)| -> Vec<bool> {
        let place = |k| background(positions[photo], cell(photo, k));
        flags.iter().enumerate().map(|(k, flag)| *flag || place(k)).collect()
    };
    seen.iter().enumerate().map(of_photo).collect()
}

impl StillBackground {
    /// Leaves out the keypoints of the background.
    pub(crate) fn drop_from(&self, photos: &mut [Features]) {
        for (features, still) in photos.iter_mut().zip(&self.still) {
            features.retain(|k| !still[k]);
        }
    }
}

/// Leaves out matches that stay at their pixel.
pub(crate) fn drop_staying(pairs: &mut [PairMatches], photos: &[Features], side_px: f64) {
    let within = still_px(side_px);
    for pair in pairs {
        let [i, j] = pair.views;
        pair.matches.retain(|m| {
            let [first, second] = m.keypoints();
            let (a, b) = (&photos[i].keypoints[first], &photos[j].keypoints[second]);
            f64::from(a.x() - b.x()).hypot(f64::from(a.y() - b.y())) > within
        });
    }
}

#[cfg(test)]
mod tests {
    use openmvg_sfm::Keypoint;

    use super::*;
    use crate::matching::Match;

    const PHOTOS: usize = 6;

    /// Photos of one tripod position with 60 keypoints of the room and some of an object that turns by ten pixels from photo to photo.
    fn turntable(on_object: usize) -> (Vec<Features>, Vec<PairMatches>) {
        let photo = |k: usize| {
            let room = (0..60).map(|i| [10.0 * i as f32, 5.0]);
            let object = (0..on_object).map(|i| [200.0 + 15.0 * i as f32 + 10.0 * k as f32, 200.0]);
            let keypoints: Vec<Keypoint> =
                room.chain(object).map(|[x, y]| Keypoint::try_new(x, y, 2.0, 0.0).unwrap()).collect();
            Features { descriptors: vec![[0; 128]; keypoints.len()], keypoints, blurred: false }
        };
        let matches: Vec<Match> = (0..60 + on_object).map(|i| Match::new([i, i], 0.1)).collect();
        let pair = |i, j| PairMatches { views: [i, j], matches: matches.clone() };
        let pairs = (0..PHOTOS).flat_map(|i| (i + 1..PHOTOS).map(move |j| (i, j))).map(|(i, j)| pair(i, j));
        ((0..PHOTOS).map(photo).collect(), pairs.collect())
    }

    #[test]
    fn few_points_of_an_object_that_turns_suffice_if_they_move_again_and_again() {
        for on_object in [LEAST_OF_EACH, 3 * LEAST_OF_EACH] {
            let (photos, pairs) = turntable(on_object);
            let found = find(&pairs, &photos, 640.0).unwrap();
            assert!(found.still.iter().all(|flags| flags[..60].iter().all(|s| *s) && !flags[60..].contains(&true)));
        }
        // Ten of eighteen in each pair, other ones each time.
        let (photos, mut pairs) = turntable(18);
        for (k, pair) in pairs.iter_mut().enumerate() {
            pair.matches.retain(|m| m.keypoints()[0] < 60 || (m.keypoints()[0] + k) % 18 < 10);
        }
        assert!(find(&pairs, &photos, 640.0).is_some());
    }

    #[test]
    fn photos_that_were_taken_again_and_again_have_no_background() {
        let (photos, pairs) = turntable(0);
        assert!(find(&pairs, &photos, 640.0).is_none());
        // Nor do a few wrong matches make one.
        let (photos, mut pairs) = turntable(LEAST_OF_EACH);
        pairs
            .iter_mut()
            .enumerate()
            .for_each(|(k, p)| p.matches.retain(|m| m.keypoints()[0] < 60 || m.keypoints()[0] == 60 + k % 12));
        assert!(find(&pairs, &photos, 640.0).is_none());
    }
}
