//! Friction and rebound of the real cube, fitted on some tosses and judged on others.

use drex_core::Pose;
use nalgebra::Vector3;

use super::cube::{HALF_M, Toss, cube, face_up, median};
use super::engine::{self, Constants, Start};

/// The state is taken from the track here, seconds after release.
pub const FROM_S: f64 = 0.1;
/// Position is judged this much later.
pub const AHEAD_S: f64 = 0.2;
/// Everything has come to rest by then.
pub const REST_S: f64 = 3.0;

/// What is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    pub friction: f64,
    /// Damping ratio of the normal spring: 1 rebounds with 0.135 of the speed, more with less.
    pub damping_ratio: f64,
}

/// How a set of tosses is predicted.
pub struct Errors {
    /// Distance at the end of the interval, millimetres, one per toss.
    pub mm: Vec<f64>,
    /// Angle there, degrees.
    pub deg: Vec<f64>,
    /// Whether the face that ends up is the right one.
    pub face: Vec<bool>,
}

impl Errors {
    pub fn face_percent(&self) -> f64 {
        100.0 * self.face.iter().filter(|f| **f).count() as f64 / self.face.len() as f64
    }
    pub fn mean_mm(&self) -> f64 {
        self.mm.iter().sum::<f64>() / self.mm.len() as f64
    }
}

/// Height of the table in the frame of the tracker: what the resting cubes of `tosses` stand on.
pub fn table_height(tosses: &[Toss]) -> f64 {
    median(tosses.iter().map(|t| t.poses[t.poses.len() - 1].translation.vector.z - HALF_M).collect())
}

/// Grid of friction and damping ratio.
pub fn grid() -> Vec<Parameters> {
    let frictions = (0..9).map(|k| 0.10 + 0.02 * f64::from(k));
    frictions
        .flat_map(|friction| [0.3, 0.5, 0.7, 1.0, 1.5].map(|damping_ratio| Parameters { friction, damping_ratio }))
        .collect()
}

/// Prediction from the given states; the resting face costs a long rollout and is only found `to_rest`.
pub fn predict(tosses: &[&Toss], starts: &[Start], p: &Parameters, to_rest: bool) -> Errors {
    let (properties, shape) = cube();
    let constants = Constants::damped(p.damping_ratio);
    let mut out = Errors { mm: Vec::new(), deg: Vec::new(), face: Vec::new() };
    for (toss, start) in tosses.iter().zip(starts) {
        let times = if to_rest { vec![AHEAD_S, REST_S] } else { vec![AHEAD_S] };
        let end = engine::toss(&properties, &shape, p.friction, start, &times, &constants).unwrap();
        let truth = toss.at(FROM_S + AHEAD_S);
        out.mm.push((end[0].translation.vector - truth.translation.vector).norm() * 1e3);
        out.deg.push(end[0].rotation.angle_to(&truth.rotation).to_degrees());
        if to_rest {
            out.face.push(face_up(&end[1]) == face_up(&toss.poses[toss.poses.len() - 1]));
        }
    }
    out
}

/// States of all tosses from what was seen until [`FROM_S`].
pub fn starts(tosses: &[&Toss]) -> Vec<Start> {
    tosses.iter().map(|t| t.state_at(FROM_S)).collect()
}

/// The parameters with the smallest mean distance, and that distance in millimetres.
pub fn fit(tosses: &[&Toss]) -> (Parameters, f64) {
    let starts = starts(tosses);
    let scored = grid().into_iter().map(|p| (p, predict(tosses, &starts, &p, false).mean_mm()));
    scored.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
}

/// Two predictions without contact: a parabola whose height stays on the table, and one that stops where it lands.
pub fn ballistic(tosses: &[&Toss], starts: &[Start]) -> (f64, f64) {
    let end = |s: &Start, stops: bool| -> Vector3<f64> {
        let at = |t: f64| s.pose.translation.vector + s.velocity * t - Vector3::z() * (0.5 * 9.81 * t * t);
        let landed = (0..=200).map(|k| f64::from(k) * AHEAD_S / 200.0).find(|t| at(*t).z < HALF_M);
        let mut x = at(if stops { landed.unwrap_or(AHEAD_S) } else { AHEAD_S });
        x.z = x.z.max(HALF_M);
        x
    };
    let error = |stops: bool| {
        let far = |(t, s): (&&Toss, &Start)| (end(s, stops) - t.at(FROM_S + AHEAD_S).translation.vector).norm() * 1e3;
        median(tosses.iter().zip(starts).map(far).collect())
    };
    (error(false), error(true))
}

/// Share of tosses, percent, that end on the face they had down at the start.
pub fn kept_face(tosses: &[&Toss]) -> f64 {
    let last = |t: &Toss| -> Pose { t.poses[t.poses.len() - 1] };
    let kept = tosses.iter().filter(|t| face_up(&t.at(FROM_S)) == face_up(&last(t))).count();
    100.0 * kept as f64 / tosses.len() as f64
}
