//! What other photos confirm of a depth map.

use rayon::prelude::*;

use crate::depth_map::DepthMap;
use crate::kernel::{Plane, Window, mapped};
use crate::patchmatch::Field;
use crate::scene::View;

/// A photo confirms a depth that its own depth leads back to within this distance, pixels.
const CONFIRMS_PX: f32 = 1.0;
/// So many have to, where there are as many.
const LEAST_CONFIRMING: usize = 2;
/// One of them from as far aside as this share of the angle of the one farthest aside, or of so many degrees: what shines looks as if it
/// were behind its surface, and from nearby photos agree about where.
const WIDE_SHARE: f32 = 0.7;
const WIDE_DEG: f32 = 30.0;
/// Planes that photos like less than this tell nothing, even if others agree.
const WORST_COST: f32 = 0.7;
/// A photo that is as sure as this of something farther away, so many pixels off, sees through what is claimed.
const CONTRADICTS_PX: f32 = 3.0;
const SURE_COST: f32 = 0.4;

/// Surfaces that bend more than this within a window are edges, pixels in the other photos.
const EDGE_PX: f32 = 1.0;

/// The depth map of a view, without what no other photo confirms.
pub(crate) fn confirmed<const G: usize>(views: &[View], fields: &[Field], i: usize, window: &Window<G>) -> DepthMap {
    let (view, field) = (&views[i], &fields[i]);
    let pairs: Vec<_> = view
        .witnesses
        .iter()
        .map(|n| (view.to(&views[n.view], 0), views[n.view].to(view, 0), &fields[n.view], n.angle_rad as f32))
        .collect();
    let least = LEAST_CONFIRMING.min(pairs.len()).max(1);
    let enough_rad = pairs.iter().map(|p| p.3).fold(0.0, f32::max).min(WIDE_DEG.to_radians()) * WIDE_SHARE;
    let k = view.matrix(0).map(|v| v as f32);
    let disparity = view.disparity(views, 0);
    let pixels: Vec<(f32, [f32; 3], f32)> = (0..field.planes.len())
        .into_par_iter()
        .map(|at| {
            let (plane, cost) = (field.planes[at], field.costs[at]);
            if !(cost < WORST_COST) {
                return (0.0, [0.0; 3], 0.0);
            }
            let pixel = [(at % field.width) as f32, (at / field.width) as f32];
            let (mut confirming, mut contradicting) = (0, 0);
            let mut widest = 0.0f32;
            for ((turn, shift), (back, back_shift), other, angle_rad) in &pairs {
                let Some([x, y]) = mapped(turn, shift, pixel, plane.w) else { continue };
                let Some((its, its_cost)) = other.at(x, y) else { continue };
                let Some([u, v]) = mapped(back, back_shift, [x, y], its.w) else { continue };
                let off_px = ((u - pixel[0]).powi(2) + (v - pixel[1]).powi(2)).sqrt();
                if off_px < CONFIRMS_PX {
                    confirming += 1;
                    widest = widest.max(*angle_rad);
                } else if off_px > CONTRADICTS_PX
                    && its.w < seen_from(turn, shift, pixel, plane.w)
                    && its_cost < SURE_COST
                {
                    contradicting += 1;
                }
            }
            if confirming < least || contradicting > confirming || widest < enough_rad {
                return (0.0, [0.0; 3], 0.0);
            }
            // m · ray = w for all rays of the plane; it faces away from the camera.
            let (mx, my) = (plane.a * k[(0, 0)], plane.b * k[(1, 1)]);
            let mz = plane.w - mx * (pixel[0] - k[(0, 2)]) / k[(0, 0)] - my * (pixel[1] - k[(1, 2)]) / k[(1, 1)];
            let length = -(mx * mx + my * my + mz * mz).sqrt();
            // The variance of a depth is that of the matching by the squared sine of the widest angle.
            let confidence = (1.0 - cost).powi(2) * widest.sin().powi(2);
            let bend = bend(field, at, window.radius as usize, EDGE_PX / disparity);
            let corrected = plane.w - 0.5 * window.spread() * bend;
            // What is so far away that a pixel is all its depth has no curvature to speak of.
            let w = if corrected > 0.0 { corrected } else { plane.w };
            (1.0 / w, [mx / length, my / length, mz / length], confidence)
        })
        .collect();
    let mut map = DepthMap {
        camera: view.camera.clone(),
        corner: view.corner,
        depth: Vec::with_capacity(pixels.len()),
        normal: Vec::with_capacity(pixels.len()),
        confidence: Vec::with_capacity(pixels.len()),
    };
    for (depth, normal, confidence) in pixels {
        map.depth.push(depth);
        map.normal.push(normal);
        map.confidence.push(confidence);
    }
    map
}

/// Inverse depth in another photo of a pixel's place.
#[inline(always)]
fn seen_from(turn: &[[f32; 3]; 3], shift: &[f32; 3], at: [f32; 2], w: f32) -> f32 {
    w / (turn[0][2] * at[0] + turn[1][2] * at[1] + turn[2][2] + shift[2] * w)
}

/// Sum of the second derivatives of inverse depth along row and column, by planes `reach` pixels away; 0 at an edge, where inverse depths
/// are more than `edge` from a straight line.
///
/// A flat window on a surface that bends finds the mean of the surface over the window, half the window's spread times this beside the
/// surface in its centre.
fn bend(field: &Field, at: usize, reach: usize, edge: f32) -> f32 {
    let (x, y) = (at % field.width, at / field.width);
    if x < reach || y < reach || x + reach >= field.width || y + reach >= field.height {
        return 0.0;
    }
    let own = field.planes[at].w;
    let along = |step: usize, slope: fn(&Plane) -> f32| {
        let (before, after) = (at - step * reach, at + step * reach);
        if !(field.costs[before] < WORST_COST && field.costs[after] < WORST_COST) {
            return None;
        }
        let (p, q) = (&field.planes[before], &field.planes[after]);
        let off = p.w + q.w - 2.0 * own;
        // Places and slopes have to tell the same.
        let by_slopes = 0.5 * reach as f32 * (slope(q) - slope(p));
        ((off - by_slopes).abs() < 0.5 * edge && off.abs() < edge).then(|| off / (reach * reach) as f32)
    };
    match (along(1, |p| p.a), along(field.width, |p| p.b)) {
        (Some(a), Some(b)) => a + b,
        _ => 0.0,
    }
}
