//! What other photos confirm of a depth map.

use std::sync::Arc;

use rayon::prelude::*;

use crate::depth_map::DepthMap;
use crate::kernel::{Plane, Window, mapped};
use crate::patchmatch::Field;
use crate::picture::box_sum;
use crate::scene::View;

/// A photo confirms a depth that its own depth leads back to within this distance, pixels.
const CONFIRMS_PX: f32 = 1.0;
/// So many have to, where there are as many.
const LEAST_CONFIRMING: f32 = 2.0;
/// One of them from as far aside as this share of the angle of the one farthest aside, or of so many degrees: what shines looks as if it
/// were behind its surface, and from nearby photos agree about where.
const WIDE_SHARE: f32 = 0.7;
const WIDE_DEG: f32 = 30.0;
/// Planes that photos like less than this tell nothing, even if others agree.
const WORST_COST: f32 = 0.7;
/// A photo that is as sure as this of something farther away, so many pixels off, sees through what is claimed.
const CONTRADICTS_PX: f32 = 3.0;
const SURE_COST: f32 = 0.4;

/// Of the photos in which the place could be seen at least this share confirms it.
const LEAST_SHARE: f32 = 0.45;
/// Disparities that may be off by more than this tell no depth, pixels.
const MOST_DEVIATION_PX: f32 = 1.0;
/// What stands so far to each side of a pixel says how far it is to be trusted: where stereo works it works for most of them, and those that
/// agree by chance stand alone.
const AROUND_PX: usize = 7;
/// Surfaces that bend more than this within a window are edges, pixels in the other photos.
const EDGE_PX: f32 = 1.0;

/// What is found at one pixel.
#[derive(Debug, Clone, Copy)]
struct Found {
    depth: f32,
    normal: [f32; 3],
    /// How far it is to be trusted by itself, 0 to 1.
    trust: f32,
}

/// A pixel without a depth.
const INVALID: Found = Found { depth: 0.0, normal: [0.0; 3], trust: 0.0 };

/// The depth map of a view, without what no other photo confirms and what is trusted less than `least_confidence`. `others`: the planes of its
/// witnesses. `deviations`: how far off the disparity of each pixel may be.
pub(crate) fn confirmed<const G: usize>(
    views: &[View],
    i: usize,
    field: &Field,
    others: &[Arc<Field>],
    window: &Window<G>,
    deviations: &[f32],
    least_confidence: f32,
) -> DepthMap {
    let view = &views[i];
    let witnesses: Vec<Witness<'_>> = view
        .witnesses
        .iter()
        .zip(others)
        .map(|(n, field)| Witness {
            to: view.to(&views[n.view], 0),
            back: views[n.view].to(view, 0),
            field,
            angle_rad: n.angle_rad as f32,
        })
        .collect();
    let k = view.matrix(0).map(|v| v as f32);
    let edge = EDGE_PX / view.disparity(views, 0);
    let found: Vec<Found> = (0..field.planes.len())
        .into_par_iter()
        .map(|at| {
            let (plane, deviation) = (field.planes[at], deviations[at]);
            if !(field.costs[at] < WORST_COST && deviation < MOST_DEVIATION_PX) {
                return INVALID;
            }
            let pixel = [(at % field.width) as f32, (at / field.width) as f32];
            let Some(share) = confirming_share(&witnesses, pixel, plane.w) else { return INVALID };
            // m · ray = w for all rays of the plane; it faces away from the camera.
            let (mx, my) = (plane.a * k[(0, 0)], plane.b * k[(1, 1)]);
            let mz = plane.w - mx * (pixel[0] - k[(0, 2)]) / k[(0, 0)] - my * (pixel[1] - k[(1, 2)]) / k[(1, 1)];
            let length = -(mx * mx + my * my + mz * mz).sqrt();
            let bend = bend(field, at, window.radius as usize, edge);
            let corrected = plane.w - 0.5 * window.spread() * bend;
            // What is so far away that a pixel is all its depth has no curvature to speak of.
            let w = if corrected > 0.0 { corrected } else { plane.w };
            let trust = share / (1.0 + deviation * deviation);
            Found { depth: 1.0 / w, normal: [mx / length, my / length, mz / length], trust }
        })
        .collect();
    let around = share_around(field, &found);
    let mut map = DepthMap {
        camera: view.camera.clone(),
        corner: view.corner,
        depth: Vec::with_capacity(found.len()),
        normal: Vec::with_capacity(found.len()),
        confidence: Vec::with_capacity(found.len()),
    };
    for (found, around) in found.iter().zip(around) {
        let confidence = found.trust * around;
        let kept = if confidence > 0.0 && confidence >= least_confidence { *found } else { INVALID };
        map.depth.push(kept.depth);
        map.normal.push(kept.normal);
        map.confidence.push(if kept.depth > 0.0 { confidence } else { 0.0 });
    }
    map
}

/// Another photo, and how its pixels and those of the photo in question lead to each other.
struct Witness<'a> {
    to: ([[f32; 3]; 3], [f32; 3]),
    back: ([[f32; 3]; 3], [f32; 3]),
    field: &'a Field,
    angle_rad: f32,
}

/// Which share of the photos that look there confirms inverse depth `w` of a pixel; `None` if they are too few, too close together, or too
/// many see through it.
fn confirming_share(witnesses: &[Witness<'_>], pixel: [f32; 2], w: f32) -> Option<f32> {
    let (mut looking, mut confirming, mut contradicting) = (0.0f32, 0.0f32, 0.0f32);
    let (mut widest, mut farthest) = (0.0f32, 0.0f32);
    for Witness { to: (turn, shift), back: (back, back_shift), field, angle_rad } in witnesses {
        farthest = farthest.max(*angle_rad);
        let Some([x, y]) = mapped(turn, shift, pixel, w) else { continue };
        let Some((its, its_cost)) = field.at(x, y) else { continue };
        let Some([u, v]) = mapped(back, back_shift, [x, y], its.w) else { continue };
        looking += 1.0;
        let off_px = ((u - pixel[0]).powi(2) + (v - pixel[1]).powi(2)).sqrt();
        if off_px < CONFIRMS_PX {
            confirming += 1.0;
            widest = widest.max(*angle_rad);
        } else if off_px > CONTRADICTS_PX && its.w < seen_from(turn, shift, pixel, w) && its_cost < SURE_COST {
            contradicting += 1.0;
        }
    }
    let least = LEAST_CONFIRMING.min(witnesses.len() as f32).max(1.0);
    let enough_rad = farthest.min(WIDE_DEG.to_radians()) * WIDE_SHARE;
    let share = confirming / looking.max(1.0);
    (confirming >= least && contradicting <= confirming && widest >= enough_rad && share >= LEAST_SHARE)
        .then_some(share)
}

/// Of the pixels round each one in which depth was looked for, the share in which it was found.
fn share_around(field: &Field, found: &[Found]) -> Vec<f32> {
    let sums = |counts: &dyn Fn(usize) -> bool| {
        let mut values: Vec<f32> = (0..found.len()).map(|at| f32::from(u8::from(counts(at)))).collect();
        box_sum(&mut values, field.width, field.height, AROUND_PX);
        values
    };
    let searched = sums(&|at| field.costs[at].is_finite());
    let there = sums(&|at| found[at].depth > 0.0);
    there.iter().zip(searched).map(|(there, searched)| there / searched.max(1.0)).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 40;
    const IDENTITY: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    /// Every pixel shows inverse depth `w` at a cost.
    fn field(w: f32, cost: f32) -> Field {
        let n = SIDE * SIDE;
        Field { width: SIDE, height: SIDE, planes: vec![Plane { w, a: 0.0, b: 0.0 }; n], costs: vec![cost; n] }
    }

    /// What photos shifted sideways by 10 pixels per unit of inverse depth, so many degrees aside, say of inverse depth 1.
    fn share(others: &[(f32, &Field)]) -> Option<f32> {
        let mut witnesses = Vec::new();
        for &(degrees, field) in others {
            let (to, back) = ((IDENTITY, [10.0, 0.0, 0.0]), (IDENTITY, [-10.0, 0.0, 0.0]));
            witnesses.push(Witness { to, back, field, angle_rad: degrees.to_radians() });
        }
        confirming_share(&witnesses, [20.0, 20.0], 1.0)
    }

    #[test]
    fn photos_confirm_what_several_show_one_of_them_from_far_aside_and_none_sees_through() {
        // 0.05 more is half a pixel off, 0.5 less five pixels.
        let (alike, behind, unsure, searched_nowhere) =
            (field(1.05, 0.1), field(0.5, 0.1), field(0.5, 0.6), field(1.0, f32::INFINITY));
        assert_eq!(share(&[(10.0, &alike), (20.0, &alike), (30.0, &alike), (40.0, &alike)]), Some(1.0));
        assert_eq!(share(&[(10.0, &alike), (30.0, &alike), (40.0, &searched_nowhere)]), Some(1.0), "two look there");
        assert_eq!(share(&[(10.0, &alike), (30.0, &searched_nowhere)]), None, "one is not enough");
        assert_eq!(share(&[(10.0, &alike)]), Some(1.0), "where there is no other, it is");
        assert_eq!(share(&[(10.0, &alike), (12.0, &alike), (40.0, &unsure)]), None, "from one side only");
        assert_eq!(share(&[(10.0, &alike), (40.0, &alike), (30.0, &unsure), (35.0, &unsure)]), Some(0.5));
        assert_eq!(share(&[(10.0, &alike), (40.0, &alike), (30.0, &unsure), (35.0, &unsure), (38.0, &unsure)]), None);
        let through = [(10.0, &alike), (40.0, &alike), (20.0, &behind), (25.0, &behind), (35.0, &behind)];
        assert_eq!(share(&through[..4]), Some(0.5), "as many see it as see through");
        assert_eq!(share(&through), None);
    }

    #[test]
    fn a_depth_is_trusted_as_far_as_those_round_it_were_found() {
        // Depth is looked for in the left half, and found in its upper half.
        let mut field = field(1.0, 0.1);
        (0..SIDE * SIDE).filter(|at| at % SIDE >= SIDE / 2).for_each(|at| field.costs[at] = f32::INFINITY);
        let of = |at: usize| match (at % SIDE < SIDE / 2, at / SIDE < SIDE / 2) {
            (true, true) => Found { depth: 1.0, ..INVALID },
            _ => INVALID,
        };
        let around = share_around(&field, &(0..SIDE * SIDE).map(of).collect::<Vec<_>>());
        let at = |x: usize, y: usize| around[y * SIDE + x];
        assert_eq!([at(5, 5), at(SIDE / 2 - 1, 5), at(0, 0)], [1.0; 3], "what nobody looks at takes nothing away");
        let rows = 2.0 * AROUND_PX as f32 + 1.0;
        assert_eq!(at(10, SIDE / 2), AROUND_PX as f32 / rows);
        assert_eq!(at(10, SIDE / 2 + AROUND_PX), 0.0);
    }
}
