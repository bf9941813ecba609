//! The still background of a turntable: what stays at its pixel while other things move.
//!
//! A camera on a tripod sees a turning object and a room that stands still. The room has more texture, says "no motion", and wins every
//! robust estimate. It gives itself away: its keypoints recur at the same pixel, with the same descriptor, in many photos, while other
//! matches of the same pairs move.

use crate::features::Features;
use crate::matching::PairMatches;

/// What stays within this many pixels (of a photo of 1000 pixels) stands still.
const STILL_PX: f64 = 2.0;
/// What moves, moves at least so far, in the same unit.
const MOVING_PX: f64 = 8.0;
/// A pair shows both when it has at least so many matches of each kind.
const LEAST_OF_EACH: usize = 12;
/// A background is taken for one when at least this share of the photos is in such a pair with this many others.
const LEAST_SHARE: f64 = 0.5;
const LEAST_PARTNERS: usize = 3;

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
    let unit = side_px / 1000.0;
    let moved = |pair: &PairMatches, k: usize| {
        let m = &pair.matches[k];
        let (a, b) = (&photos[pair.views[0]].keypoints[m.first], &photos[pair.views[1]].keypoints[m.second]);
        f64::from(a.x() - b.x()).hypot(f64::from(a.y() - b.y()))
    };
    let mut partners = vec![0usize; photos.len()];
    // How many photos see each keypoint stay, and how many see it move.
    let mut stays: Vec<Vec<u32>> = photos.iter().map(|p| vec![0; p.keypoints.len()]).collect();
    let mut moves = stays.clone();
    for pair in pairs {
        let distances: Vec<f64> = (0..pair.matches.len()).map(|k| moved(pair, k)).collect();
        let still = distances.iter().filter(|d| **d <= STILL_PX * unit).count();
        let moving = distances.iter().filter(|d| **d >= MOVING_PX * unit).count();
        if still < LEAST_OF_EACH {
            continue;
        }
        if moving >= LEAST_OF_EACH {
            pair.views.iter().for_each(|&v| partners[v] += 1);
        }
        for (m, d) in pair.matches.iter().zip(&distances) {
            let of = if *d <= STILL_PX * unit { &mut stays } else { &mut moves };
            of[pair.views[0]][m.first] += 1;
            of[pair.views[1]][m.second] += 1;
        }
    }
    let shown = partners.iter().filter(|p| **p >= LEAST_PARTNERS).count();
    if (shown as f64) < LEAST_SHARE * photos.len() as f64 {
        return None;
    }
    let flags = |(s, m): (&Vec<u32>, &Vec<u32>)| -> Vec<bool> {
        s.iter().zip(m).map(|(s, m)| *s >= 2 && *s > *m).collect()
    };
    let still: Vec<Vec<bool>> = stays.iter().zip(&moves).map(flags).collect();
    let all: usize = still.iter().map(Vec::len).sum();
    let those: usize = still.iter().flatten().filter(|s| **s).count();
    Some(StillBackground { still, share: those as f64 / all.max(1) as f64 })
}

impl StillBackground {
    /// Leaves out the matches of the background: of keypoints that stand still, and those that stay at their pixel.
    pub(crate) fn drop_from(&self, pairs: &mut [PairMatches], photos: &[Features], side_px: f64) {
        let within = STILL_PX * side_px / 1000.0;
        for pair in pairs {
            let [i, j] = pair.views;
            pair.matches.retain(|m| {
                let (a, b) = (&photos[i].keypoints[m.first], &photos[j].keypoints[m.second]);
                let stays = f64::from(a.x() - b.x()).hypot(f64::from(a.y() - b.y())) <= within;
                !(stays || self.still[i][m.first] || self.still[j][m.second])
            });
        }
    }
}
