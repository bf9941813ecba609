//! Where on the object the fingers of a held frame belong: on both ends of a line through it, as the human hand lies.

use drex_core::SignedDistance;
use nalgebra::{Point3, Vector3};

/// The human middle between thumb and fingers is moved into the object by this much, m.
const INSIDE_M: f64 = 0.02;
/// Fingers should press at least this far from an edge, m; a finger this far beyond it lets go.
const EDGE_M: f64 = 0.006;
const SHORT_M: f64 = 0.004;
/// Times that the middle is moved for it.
const CENTRED: usize = 4;
/// How far to look for the surface along the line, m, and in how many steps.
const LONGEST_M: f64 = 0.25;
const STEPS: usize = 40;
/// Turns of the line that are tried to each side, their step, rad, and what a turn of one radian costs.
const TURNS: (i32, i32) = (4, 3);
const TURN_RAD: f64 = 0.17;
const TURN_COST: f64 = 0.1;
/// More upright than this is no better.
const UPRIGHT: f64 = 0.97;

/// A point inside the object near `point`.
fn inside(object: &dyn SignedDistance, mut point: Point3<f64>) -> Point3<f64> {
    for _ in 0..12 {
        let s = object.signed_distance(&point);
        if s.distance_m <= -INSIDE_M {
            break;
        }
        point -= s.gradient * (0.5 * (s.distance_m + INSIDE_M)).max(0.001);
    }
    point
}

/// Where the fingers belong.
pub(crate) struct Goals {
    /// The middle between them.
    pub(crate) middle: Point3<f64>,
    /// On the surface, per finger.
    pub(crate) points: Vec<Point3<f64>>,
    /// Whether there is object for the finger to press on.
    pub(crate) reached: Vec<bool>,
    /// Least cosine between the line and the normals at its ends, of the fingers' the mean.
    pub(crate) upright: f64,
}

/// Goals for a hand whose middle between thumb and fingers is at `center`. Of `tips`, the robot's tips as the human hand would have
/// them, only the direction from the thumb to the others and the spread of the others is used.
///
/// Of the lines within [`TURNS`] of the human, the one whose ends stand most upright on the surface wins, less a penalty for the
/// turn: fingers that press along it do not slip.
pub(crate) fn goals(object: &dyn SignedDistance, center: Point3<f64>, tips: &[Point3<f64>], thumb: usize) -> Goals {
    let others = || tips.iter().enumerate().filter(|(f, _)| *f != thumb).map(|(_, p)| p.coords);
    let fingers = others().sum::<Vector3<f64>>() / (tips.len() - 1).max(1) as f64;
    let thumb_to_fingers = (fingers - tips[thumb].coords).try_normalize(1e-6).unwrap_or_else(Vector3::x);
    // The direction in which the fingers are side by side.
    let side = others()
        .map(|p| p - fingers)
        .fold(Vector3::zeros(), |m: Vector3<f64>, d| if d.norm() > m.norm() { d } else { m });
    let side = (side - thumb_to_fingers * thumb_to_fingers.dot(&side))
        .try_normalize(1e-6)
        .unwrap_or_else(|| thumb_to_fingers.cross(&Vector3::ith(thumb_to_fingers.iamin(), 1.0)));
    let spread: Vec<Vector3<f64>> =
        tips.iter().enumerate().map(|(f, p)| if f == thumb { Vector3::zeros() } else { p.coords - fingers }).collect();
    let place = |axis: &Vector3<f64>| along(object, inside(object, center), axis, &spread, thumb);
    let mut axis = thumb_to_fingers;
    let mut best = place(&axis);
    // Around the direction in which the fingers are side by side, then across it.
    for (about, most) in [(side, TURNS.0), (thumb_to_fingers.cross(&side), TURNS.1)] {
        let from = axis;
        let mut highest = best.upright.min(UPRIGHT);
        for k in (-most..=most).filter(|k| *k != 0) {
            let angle = f64::from(k) * TURN_RAD;
            let turned = nalgebra::Rotation3::new(about * angle) * from;
            let goals = place(&turned);
            let score = goals.upright.min(UPRIGHT) - TURN_COST * angle * angle;
            if score > highest + 1e-9 {
                (highest, axis, best) = (score, turned, goals);
            }
        }
    }
    best
}

/// Goals on the ends of lines along `axis`.
fn along(
    object: &dyn SignedDistance,
    mut middle: Point3<f64>,
    axis: &Vector3<f64>,
    spread: &[Vector3<f64>],
    thumb: usize,
) -> Goals {
    let from = |f: usize, middle: &Point3<f64>| middle + (spread[f] - axis * axis.dot(&spread[f]));
    let count = spread.len();
    // The spread fingers should all find the object.
    for _ in 0..CENTRED {
        let push: Vector3<f64> = (0..count)
            .map(|f| object.signed_distance(&from(f, &middle)))
            .map(|s| s.gradient * (s.distance_m + EDGE_M).clamp(0.0, EDGE_M + SHORT_M))
            .sum();
        if push.norm() < 1e-4 {
            break;
        }
        middle -= push * 0.5;
    }
    let points: Vec<Point3<f64>> =
        (0..count).map(|f| surface(object, from(f, &middle), &if f == thumb { -axis } else { *axis })).collect();
    let reached: Vec<bool> =
        (0..count).map(|f| object.signed_distance(&from(f, &middle)).distance_m < SHORT_M).collect();
    let cosine = |f: usize| object.signed_distance(&points[f]).gradient.dot(axis) * if f == thumb { -1.0 } else { 1.0 };
    let on: Vec<f64> = (0..count).filter(|&f| f != thumb && reached[f]).map(cosine).collect();
    let mean = if on.is_empty() { -1.0 } else { on.iter().sum::<f64>() / on.len() as f64 };
    let upright = mean.min(cosine(thumb));
    Goals { middle, points, reached, upright }
}

/// The surface along `axis` from a point; the nearest surface for a point that is outside.
fn surface(object: &dyn SignedDistance, from: Point3<f64>, axis: &Vector3<f64>) -> Point3<f64> {
    let mut at = from;
    let start = object.signed_distance(&at);
    if start.distance_m >= 0.0 {
        return at - start.gradient * start.distance_m;
    }
    let mut travelled = 0.0;
    for _ in 0..STEPS {
        let d = -object.signed_distance(&at).distance_m;
        if d < 2e-4 || travelled > LONGEST_M {
            break;
        }
        at += axis * d;
        travelled += d;
    }
    at
}
