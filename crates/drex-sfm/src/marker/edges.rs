//! Sub-pixel corners: the homography that puts all edges between black and white cells where the photo has them.
//!
//! The four outer edges of the border alone have black inside and white outside, so that whatever moves an edge towards one
//! colour (blur before an unknown tone curve, overexposure, ink that spreads) changes the apparent size of the tag. The
//! cells inside have edges both ways: with them the shift is an unknown of its own, and size and corners are free of it.

use nalgebra::{Point2, SMatrix, SVector, Vector2};

use super::image::Grey;
use super::tag36h11::{SIDE, is_white};
use super::warp::Warp;
use drex_core::stats::median;

/// Steps of Gauss and Newton at most, and the movement in pixels that ends them.
const MAX_STEPS: usize = 12;
const SETTLED_PX: f64 = 1e-3;

/// Cells that look narrower than this, pixels, have no edges to measure.
const MIN_CELL_PX: f64 = 1.8;

/// Edges are looked for within this many pixels, and within this share of a cell.
const REACH_PX: f64 = 4.0;
const REACH_CELLS: f64 = 0.45;

/// Ends of edges that are left out, pixels.
const END_PX: f64 = 1.5;

/// Least samples of edges, and least share of all, that must agree with the tag.
const MIN_SAMPLES: usize = 24;
const MIN_AGREEING: f64 = 0.5;

/// Samples whose slope is below this share of the median are no edges.
const MIN_SLOPE: f64 = 0.3;

/// Standard deviation of the shift before anything is measured, pixels.
const SHIFT_SIGMA_PX: f64 = 0.5;

/// Tukey's constant: 95 % efficiency for normal errors (Holland and Welsch 1977).
const TUKEY: f64 = 4.685;

/// Residuals of edges are not taken for smaller than this, pixels.
const LEAST_SPREAD_PX: f64 = 0.02;

/// An edge of unit length between a black and a white cell, tag's cells.
pub(super) struct Edge {
    start: Point2<f64>,
    along: Vector2<f64>,
    to_white: Vector2<f64>,
}

/// The outer edges of the black border.
pub(super) fn border() -> Vec<Edge> {
    between(|row, column| (0..SIDE as i32).contains(&row) && (0..SIDE as i32).contains(&column))
}

/// All edges of a tag.
pub(super) fn pattern(id: usize) -> Vec<Edge> {
    between(|row, column| !is_white(id, row, column))
}

/// Edges between cells of which exactly one is black.
fn between(black: impl Fn(i32, i32) -> bool) -> Vec<Edge> {
    let mut edges = Vec::new();
    for row in -1..SIDE as i32 {
        for column in -1..SIDE as i32 {
            let here = black(row, column);
            let lower_right = Vector2::new(f64::from(column) + 1.0, f64::from(row) + 1.0);
            for (there, across, along) in [
                (black(row, column + 1), Vector2::x(), -Vector2::y()),
                (black(row + 1, column), Vector2::y(), -Vector2::x()),
            ] {
                if here != there {
                    let to_white = if here { across } else { -across };
                    edges.push(Edge { start: lower_right.into(), along, to_white });
                }
            }
        }
    }
    edges
}

/// An edge found in the photo near where the warp puts it.
struct Found {
    /// How far towards white it was found, pixels.
    offset: f64,
    /// Derivative of that by h and by the shift.
    jacobian: SVector<f64, 9>,
    /// Light per pixel.
    slope: f64,
}

/// Moves a warp so that its edges fit the photo. `None` if too few agree.
pub(super) fn fit<'a>(image: &Grey<'_>, start: &Warp<'a>, edges: &[Edge], with_shift: bool) -> Option<Warp<'a>> {
    let mut warp = start.clone();
    let mut shift = 0.0;
    for _ in 0..MAX_STEPS {
        let (found, tried) = search(image, &warp, edges);
        let (step, new_shift, agreeing) = solve(&found, shift, with_shift)?;
        if agreeing < MIN_SAMPLES || (agreeing as f64) < MIN_AGREEING * tried as f64 {
            return None;
        }
        let before = warp.corners()?;
        warp = warp.moved(&step)?;
        shift = new_shift;
        let moved = warp.corners()?.iter().zip(before).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        if moved < SETTLED_PX {
            break;
        }
    }
    Some(warp)
}

/// Edges that the photo shows, and how many samples were tried.
fn search(image: &Grey<'_>, warp: &Warp<'_>, edges: &[Edge]) -> (Vec<Found>, usize) {
    let (mut found, mut tried) = (Vec::new(), 0);
    for edge in edges {
        let Some(middle) = warp.image(edge.start + edge.along * 0.5) else { continue };
        let length = (middle.by_tag * edge.along).norm();
        let samples = length.round().clamp(2.0, 16.0) as usize;
        // Blur rounds the corners of cells, unevenly where they are skew: the ends of an edge are left out.
        let end = (END_PX / length).clamp(0.1, 0.4);
        for i in 0..samples {
            tried += 1;
            let t = end + (1.0 - 2.0 * end) * (i as f64 + 0.5) / samples as f64;
            found.extend(sample(image, warp, edge, t));
        }
    }
    let Some(usual) = median(found.iter().map(|f| f.slope)) else { return (found, tried) };
    found.retain(|f| f.slope >= MIN_SLOPE * usual);
    (found, tried)
}

/// The steepest place along the normal of an edge: the extremum of the light's derivative, smoothed by a Gaussian (Canny 1986),
/// by a parabola between samples.
fn sample(image: &Grey<'_>, warp: &Warp<'_>, edge: &Edge, t: f64) -> Option<Found> {
    let at = warp.image(edge.start + edge.along * t)?;
    let direction = at.by_tag * edge.along;
    let across = at.by_tag * edge.to_white;
    let normal = Vector2::new(-direction.y, direction.x).try_normalize(1e-9)?;
    let normal = normal * normal.dot(&across).signum();
    let cell = normal.dot(&across);
    if !(cell > MIN_CELL_PX) {
        return None;
    }
    let sigma = (cell / 8.0).clamp(0.6, 2.0);
    let reach = (REACH_CELLS * cell).min(REACH_PX);
    // Half a sigma between samples; the filter reaches two sigmas to either side.
    let step = 0.5 * sigma;
    const TAPS: usize = 4;
    let side = (reach / step).floor() as usize + 1;
    let count = 2 * (side + TAPS) + 1;
    let mut light = [0.0; 64];
    let light = light.get_mut(..count)?;
    for (k, value) in light.iter_mut().enumerate() {
        *value = image.light(at.pixel + normal * ((k as f64 - (side + TAPS) as f64) * step))?;
    }
    let weight = |j: usize| j as f64 * (-0.125 * (j * j) as f64).exp();
    let norm: f64 = 2.0 * (1..=TAPS).map(|j| weight(j) * j as f64).sum::<f64>() * step;
    let slope = |k: usize| (1..=TAPS).map(|j| weight(j) * (light[k + j] - light[k - j])).sum::<f64>() / norm;
    let slopes: Vec<f64> = (TAPS..count - TAPS).map(slope).collect();
    let (k, &top) = slopes.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let (&before, &after) = (slopes.get(k.wrapping_sub(1))?, slopes.get(k + 1)?);
    let bend = before - 2.0 * top + after;
    if !(top > 0.0 && bend < 0.0) {
        return None;
    }
    let offset = (k as f64 - side as f64 + 0.5 * (before - after) / bend) * step;
    let mut jacobian = SVector::<f64, 9>::repeat(1.0);
    jacobian.fixed_rows_mut::<8>(0).copy_from(&(at.by_h.transpose() * normal));
    Some(Found { offset, jacobian, slope: top })
}

/// The step of h, the shift, and how many samples agree, by least squares with Tukey's weights. `None` if the edges do not
/// determine the warp.
fn solve(found: &[Found], shift: f64, with_shift: bool) -> Option<(SVector<f64, 8>, f64, usize)> {
    let mut x = SVector::<f64, 9>::zeros();
    x[8] = shift;
    let mut spread = f64::INFINITY;
    for _ in 0..5 {
        let residual = |f: &Found| f.offset - f.jacobian.dot(&x);
        spread = spread.min(1.4826 * median(found.iter().map(|f| residual(f).abs()))?).max(LEAST_SPREAD_PX);
        let (mut m, mut y) = (SMatrix::<f64, 9, 9>::zeros(), SVector::<f64, 9>::zeros());
        for f in found {
            let weight = (1.0 - (residual(f) / (TUKEY * spread)).powi(2)).max(0.0).powi(2);
            m += f.jacobian * f.jacobian.transpose() * weight;
            y += f.jacobian * f.offset * weight;
        }
        // A shift without prior spread stays at zero.
        m[(8, 8)] += if with_shift { (spread / SHIFT_SIGMA_PX).powi(2) } else { 1e12 };
        x = m.cholesky()?.solve(&y);
    }
    let agreeing = found.iter().filter(|f| (f.offset - f.jacobian.dot(&x)).abs() < TUKEY * spread).count();
    Some((x.fixed_rows::<8>(0).into(), x[8], agreeing))
}
