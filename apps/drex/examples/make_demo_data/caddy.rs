//! The tin of the demo: a square tea caddy with round corners and a round lid.

use std::f64::consts::{FRAC_PI_2, TAU};

use anyhow::Result;
use drex_core::TriMesh;
use drex_core::mesh::convex_hull;
use nalgebra::Point3;

/// Distance between opposite sides of the body, radius of its corners, and its height, metres.
pub const WIDTH_M: f64 = 0.062;
pub const CORNER_M: f64 = 0.009;
pub const HEIGHT_M: f64 = 0.070;
/// Radius of the lid without its collar, and height of its top over the table, metres.
pub const LID_RADIUS_M: f64 = 0.0225;
pub const TOP_M: f64 = 0.083;
/// Top of the collar, metres.
pub const COLLAR_M: f64 = 0.074;
/// Radii of the roundings of the shoulder and of the lid, metres.
const SHOULDER_M: f64 = 0.004;
const LID_EDGE_M: f64 = 0.003;
/// Steps of an arc of a quarter turn.
const STEPS: u32 = 8;

/// A cross-section: half the width of a square, the radius of its corners, and its height over the table, metres.
struct Ring(f64, f64, f64);

/// Body, collar and lid, each convex, each standing on the one before.
pub fn shells() -> Result<[TriMesh; 3]> {
    let half = WIDTH_M / 2.0;
    let mut body = vec![Ring(half, CORNER_M, 0.0)];
    body.extend(rounded(half, CORNER_M, HEIGHT_M, SHOULDER_M));
    let collar = [Ring(0.025, 0.025, HEIGHT_M), Ring(0.025, 0.025, COLLAR_M - 0.0006), Ring(0.0244, 0.0244, COLLAR_M)];
    let mut lid = vec![Ring(LID_RADIUS_M, LID_RADIUS_M, COLLAR_M)];
    lid.extend(rounded(LID_RADIUS_M, LID_RADIUS_M, TOP_M, LID_EDGE_M));
    Ok([lofted(&body)?, lofted(&collar)?, lofted(&lid)?])
}

/// The upper end of a prism whose edge is rounded by `radius`.
fn rounded(half: f64, corner: f64, top: f64, radius: f64) -> impl Iterator<Item = Ring> {
    (0..=STEPS).map(move |k| {
        let (s, c) = (FRAC_PI_2 * f64::from(k) / f64::from(STEPS)).sin_cos();
        let inwards = radius * (1.0 - c);
        Ring(half - inwards, corner - inwards, top - radius * (1.0 - s))
    })
}

/// The convex solid between the rings.
fn lofted(rings: &[Ring]) -> Result<TriMesh> {
    let points: Vec<Point3<f64>> = rings
        .iter()
        .flat_map(|&Ring(half, corner, z)| {
            (0..4 * (STEPS + 1)).map(move |i| {
                let (quarter, step) = (i / (STEPS + 1), i % (STEPS + 1));
                let angle = TAU / 4.0 * (f64::from(quarter) + f64::from(step) / f64::from(STEPS));
                let middle = |sign: bool| if sign { half - corner } else { corner - half };
                let x = middle(matches!(quarter, 0 | 3)) + corner * angle.cos();
                let y = middle(matches!(quarter, 0 | 1)) + corner * angle.sin();
                // Corners that should be one are one.
                Point3::new((x * 1e9).round() / 1e9, (y * 1e9).round() / 1e9, z)
            })
        })
        .collect();
    Ok(convex_hull(&points)?)
}
