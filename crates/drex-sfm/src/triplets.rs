//! Pairs that contradict the others: around three photos the rotations must come back to where they began.
//!
//! Two walls with the same picture, or two sides of a carton, match perfectly and wrongly. Whoever adds photos one by one believes
//! them; a loop over a third photo does not (Zach et al. 2010).

use std::collections::BTreeMap;

use nalgebra::Rotation3;

use crate::verify::Pair;

/// A loop that comes back within this is closed, radians.
const CLOSED_RAD: f64 = 0.15;
/// A pair is judged by at least so many loops, and goes when fewer than this share of them, by weight, are closed.
const LEAST_LOOPS: usize = 3;
const LEAST_CLOSED: f64 = 0.35;

/// Which pairs may stay.
pub(crate) fn consistent(pairs: &[Pair], photos: usize) -> Vec<bool> {
    let mut rotations: BTreeMap<[usize; 2], (usize, Rotation3<f64>)> = BTreeMap::new();
    for (k, pair) in pairs.iter().enumerate() {
        if let Some(rotation) = pair.rotation() {
            rotations.insert(pair.views, (k, rotation));
        }
    }
    let mut neighbours = vec![Vec::new(); photos];
    for [i, j] in rotations.keys() {
        neighbours[*i].push(*j);
    }
    // Loops weigh as the weakest of their pairs.
    let (mut closed, mut all, mut loops) = (vec![0.0; pairs.len()], vec![0.0; pairs.len()], vec![0usize; pairs.len()]);
    for (i, after) in neighbours.iter().enumerate() {
        for (at, j) in after.iter().enumerate() {
            for k in &after[at + 1..] {
                let (Some(a), Some(b), Some(c)) =
                    (rotations.get(&[i, *j]), rotations.get(&[*j, *k]), rotations.get(&[i, *k]))
                else {
                    continue;
                };
                let off = (c.1.inverse() * b.1 * a.1).angle();
                let weight = [a, b, c].iter().map(|e| pairs[e.0].inlier_count()).min().unwrap_or(0) as f64;
                for edge in [a, b, c] {
                    all[edge.0] += weight;
                    loops[edge.0] += 1;
                    closed[edge.0] += if off <= CLOSED_RAD { weight } else { 0.0 };
                }
            }
        }
    }
    (0..pairs.len()).map(|k| loops[k] < LEAST_LOOPS || closed[k] >= LEAST_CLOSED * all[k]).collect()
}
