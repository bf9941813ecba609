//! How photos differ in exposure, and which of them show something else than the others.

use drex_core::stats::median;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Colours outside this range are noise or cut off, linear light.
const USABLE: [f32; 2] = [0.004, 0.9];
/// Photos that share fewer cells are not compared.
const LEAST_SHARED: usize = 8;
/// Sparse points that two photos share, from which on they are compared by these.
const ENOUGH_POINTS: usize = 30;
/// Cells that are compared at most: more tell nothing new.
const MOST_CELLS: usize = 3000;
/// How much every photo holds on to a gain of 1, as a share of what other photos say.
const HOLD: f64 = 1e-3;
/// Standard deviation that colours of one place have at least, square root of linear light.
const LEAST_DEVIATION: f64 = 0.02;
/// Deviations from which a photo is doubted, and from which it is left out.
const OUTLIER: [f64; 2] = [2.5, 5.0];

/// Mean colour of a cell in a photo, linear light, and the weight of what was seen; weight 0: nothing.
pub(super) type CellColour = [f32; 4];

/// What each photo's colours are multiplied by in it, per channel, linear light; their geometric mean is 1. Of each photo `scene` has the colours round
/// sparse points and `cells` those of the object's cells.
///
/// Least squares for the logarithms, of the medians of what two photos differ by: single highlights and things in the way do not count. Where two photos
/// share enough sparse points, these speak: a highlight all over a side of the object brightens that side alone, an exposure the table as well.
pub(super) fn gains(scene: &[Vec<CellColour>], cells: &[Vec<CellColour>]) -> Vec<[f64; 3]> {
    let views = cells.len();
    let some = |of: &[Vec<CellColour>]| -> Vec<usize> {
        let count = of.first().map_or(0, Vec::len);
        let seen: Vec<usize> = (0..count).filter(|&c| of.iter().filter(|v| v[c][3] > 0.0).count() > 1).collect();
        seen.iter().copied().step_by(seen.len().div_ceil(MOST_CELLS).max(1)).collect()
    };
    let usable = |c: &CellColour| c[3] > 0.0 && c[..3].iter().all(|v| (USABLE[0]..USABLE[1]).contains(v));
    let ratio = |of: &[Vec<CellColour>], compared: &[usize], least: usize, i: usize, j: usize| {
        let (one, other) = (&of[i], &of[j]);
        let shared: Vec<usize> = compared.iter().copied().filter(|&c| usable(&one[c]) && usable(&other[c])).collect();
        let differ = |k: usize| median(shared.iter().map(|&c| f64::from(one[c][k] / other[c][k]).ln())).unwrap_or(0.0);
        (shared.len() >= least).then(|| (shared.len() as f64, [differ(0), differ(1), differ(2)]))
    };
    let (points, places) = (some(scene), some(cells));
    let ratio = |i: usize, j: usize| {
        ratio(scene, &points, ENOUGH_POINTS, i, j).or_else(|| ratio(cells, &places, LEAST_SHARED, i, j))
    };
    let pairs: Vec<(usize, usize)> = (0..views).flat_map(|i| (i + 1..views).map(move |j| (i, j))).collect();
    let ratios: Vec<_> = pairs.par_iter().map(|&(i, j)| ratio(i, j)).collect();
    let mut matrix = DMatrix::<f64>::zeros(views, views);
    let mut right: [DVector<f64>; 3] = std::array::from_fn(|_| DVector::zeros(views));
    for (&(i, j), ratio) in pairs.iter().zip(&ratios) {
        let Some((weight, differ)) = ratio else { continue };
        (matrix[(i, i)], matrix[(j, j)]) = (matrix[(i, i)] + weight, matrix[(j, j)] + weight);
        (matrix[(i, j)], matrix[(j, i)]) = (-weight, -weight);
        for k in 0..3 {
            right[k][i] += weight * differ[k];
            right[k][j] -= weight * differ[k];
        }
    }
    let hold = HOLD * (matrix.trace() / views.max(1) as f64).max(1.0);
    (0..views).for_each(|i| matrix[(i, i)] += hold);
    let Some(solver) = matrix.cholesky() else { return vec![[1.0; 3]; views] };
    let logs = right.map(|r| solver.solve(&r));
    (0..views).map(|i| [0, 1, 2].map(|k| (logs[k][i] - logs[k].mean()).exp())).collect()
}

/// How far each photo agrees with the others about each cell, from 0 to 1; one row of photos per cell.
pub(super) fn agreement(cells: &[Vec<CellColour>], gains: &[[f64; 3]]) -> Vec<Vec<f32>> {
    let count = cells.first().map_or(0, Vec::len);
    let of = |c: usize| {
        let seen: Vec<usize> = (0..cells.len()).filter(|&v| cells[v][c][3] > 0.0).collect();
        let mut out = vec![1.0; cells.len()];
        // Of two nobody can say which one is wrong.
        if seen.len() < 3 {
            return out;
        }
        let colour = |v: usize| [0, 1, 2].map(|k| (f64::from(cells[v][c][k]) / gains[v][k]).max(0.0).sqrt());
        let middle = [0, 1, 2].map(|k| median(seen.iter().map(|&v| colour(v)[k])).unwrap_or(0.0));
        let off = |v: usize| {
            let colour = colour(v);
            (0..3).map(|k| (colour[k] - middle[k]).powi(2) / 3.0).sum::<f64>().sqrt()
        };
        // 1.4826 makes a standard deviation of the median of deviations.
        let deviation = (1.4826 * median(seen.iter().map(|&v| off(v))).unwrap_or(0.0)).max(LEAST_DEVIATION);
        for v in seen {
            let doubt = ((off(v) / deviation - OUTLIER[0]) / (OUTLIER[1] - OUTLIER[0])).clamp(0.0, 1.0);
            out[v] = (1.0 - doubt) as f32;
        }
        out
    };
    (0..count).into_par_iter().map(of).collect()
}
