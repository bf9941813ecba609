//! Which of the planes is the support: the one that something stands on where the cameras look.

use drex_core::stats::quantile;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::candidates::{Candidate, Plane, candidates, nearness, unit};
use super::{Scene, SupportOptions, thinned};
use crate::{Error, Result, TablePlane};

/// Points that are looked at for a score.
const SAMPLE: std::num::NonZeroUsize = std::num::NonZeroUsize::new(20_000).unwrap();
/// Planes closer than this at the target, in distances of the cameras, and less tilted than [`SAME_RAD`], are one.
const SAME: f64 = 0.02;
/// See [`SAME`].
const SAME_RAD: f64 = 0.06;
/// Radius round the target in which what is above and below a plane counts, in distances of the cameras.
const ROUND: f64 = 0.5;
/// Radius round the target in which things stand, in distances of the cameras.
const STANDING: f64 = 0.35;
/// A runner-up with this share of the winner's score is a doubt.
const CLOSE: f64 = 0.25;
/// A winner with a lower score is a doubt.
const WEAK: f64 = 0.02;
/// A mask's share from which a point is the object's.
const OBJECT: f64 = 0.5;
/// Directions round the target in which a support should extend.
const SECTORS: usize = 8;

/// What speaks for a plane, each from 0 to 1; their product is the score.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Scores {
    /// The point that the cameras look at is just above it.
    pub target_above: f64,
    /// The cameras are above it and look down on it.
    pub looked_down: f64,
    /// The photos are upright over it.
    pub upright: f64,
    /// Nothing is below it where the cameras look.
    pub nothing_below: f64,
    /// What is above it begins at it.
    pub touched: f64,
    /// Much of what the cameras look at stands on it.
    pub standing: f64,
    /// It surrounds what stands on it.
    pub extent: f64,
    /// It is near the target and has many points there.
    pub shown: f64,
}

impl Scores {
    /// The product.
    pub fn total(&self) -> f64 {
        self.target_above
            * self.looked_down
            * self.upright
            * self.nothing_below
            * self.touched
            * self.standing
            * self.extent
            * self.shown
    }
}

/// A plane that could be the support.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PlaneCandidate {
    /// The plane.
    pub table: TablePlane,
    /// Its score, from 0 to 1.
    pub score: f64,
    /// What the score is made of.
    pub scores: Scores,
}

/// The plane that things stand on, and what else it could have been.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SupportChoice {
    /// The support.
    pub chosen: PlaneCandidate,
    /// The other planes, best first.
    pub runners_up: Vec<PlaneCandidate>,
    /// Why the choice may be wrong, as a sentence.
    pub doubt: Option<String>,
}

/// Finds the plane that the object stands on.
///
/// Candidates are planes with four fifths of the cameras on one side (RANSAC one plane after the other, Fischler and Bolles 1981;
/// whether a point belongs to one is asked in standard deviations of its triangulation for the noise in pixels that the
/// plane's own points show). Each is scored by what stands on it and by how the cameras look at it ([`Scores`]). Points
/// that masks show as the object replace the target's surroundings as what stands.
///
/// # Errors
/// If no plane has the cameras on one side.
pub fn support_plane(scene: &Scene, options: &SupportOptions) -> Result<SupportChoice> {
    let found = candidates(scene, options);
    if found.is_empty() {
        return Err(Error::value(
            format!("of {} sparse points no plane has the cameras on one side", scene.points().len()),
            "photograph the object on a surface with texture, so that its surroundings show, or state the up direction",
        ));
    }
    let measured: Vec<Measures> = found.iter().map(|c| Measures::of(scene, c)).collect();
    let most = |f: fn(&Measures) -> f64| measured.iter().map(f).fold(0.0, f64::max);
    let (standing, near) = (most(|m| m.standing), most(|m| m.near));
    let mut ranked: Vec<PlaneCandidate> = found
        .iter()
        .zip(&measured)
        .map(|(candidate, m)| {
            let scores = m.scores(standing, near);
            PlaneCandidate { table: table_of(scene, candidate), score: scores.total(), scores }
        })
        .collect();
    ranked.sort_by(|a, b| b.score.total_cmp(&a.score));
    let chosen = ranked.remove(0);
    ranked.retain(|other| !same(scene, &chosen.table, &other.table));
    let doubt = doubt(scene, &chosen, ranked.first());
    Ok(SupportChoice { chosen, runners_up: ranked, doubt })
}

/// What is measured of a candidate; lengths in distances of the cameras, points weighted by their nearness to the target.
#[derive(Debug, Default)]
struct Measures {
    target_height: f64,
    looks_down: f64,
    above: f64,
    upright: f64,
    below_share: f64,
    gap: f64,
    standing: f64,
    sectors: f64,
    near: f64,
}

impl Measures {
    fn of(scene: &Scene, candidate: &Candidate) -> Self {
        let (plane, d) = (&candidate.plane, scene.distance);
        let n = scene.views().len() as f64;
        let mean = |f: &dyn Fn(&super::SceneView) -> f64| scene.views().iter().map(f).sum::<f64>() / n;
        let mut out = Self {
            target_height: plane.height(&scene.target) / d,
            looks_down: mean(&|v| -v.axis().dot(&plane.up)),
            above: mean(&|v| f64::from(u8::from(plane.height(&v.centre()) > 0.0))),
            upright: mean(&|v| (v.world_from_camera.rotation * -Vector3::y()).dot(&plane.up)),
            ..Self::default()
        };
        let masked = scene.points().iter().any(|p| p.object_share.is_some_and(|s| s > OBJECT));
        let (mut below, mut total) = (0.0, 0.0);
        let mut heights = Vec::new();
        for i in thinned(scene.points().len(), SAMPLE) {
            let p = &scene.points()[i];
            let h = plane.height(&p.position);
            let noise = 2.0 * candidate.noise_px * scene.sigma(i, &plane.up);
            let weight = nearness(scene, &p.position);
            let aside = across(plane, scene, &p.position) / d;
            let is_object = if masked { p.object_share.is_some_and(|s| s > OBJECT) } else { aside < STANDING };
            if (aside < ROUND && h.abs() < d) || (masked && is_object) {
                total += weight;
                if h < -(noise + 0.01 * d) {
                    below += weight;
                }
            }
            if is_object && h > noise && h < d {
                out.standing += weight;
                heights.push(h / d);
            }
        }
        out.below_share = if total > 0.0 { below / total } else { 1.0 };
        out.gap = quantile(heights.iter().copied(), 0.03).unwrap_or(1.0);
        let mut sectors = [0usize; SECTORS];
        let [x, y] = axes(plane);
        for &i in &candidate.inliers {
            let p = &scene.points()[i].position;
            let off = p - scene.target;
            let aside = across(plane, scene, p) / d;
            out.near += (-(off.norm() / (0.4 * d)).powi(2)).exp();
            if (0.1..1.5).contains(&aside) {
                let turn = (off.dot(&y).atan2(off.dot(&x)) / std::f64::consts::TAU + 1.0) * SECTORS as f64;
                sectors[turn as usize % SECTORS] += 1;
            }
        }
        out.sectors = sectors.iter().filter(|n| **n >= 2).count() as f64 / SECTORS as f64;
        out
    }

    fn scores(&self, most_standing: f64, most_near: f64) -> Scores {
        let share = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        Scores {
            // Things fill a photo: they are not much higher than half of the cameras' distance.
            target_above: ramp(self.target_height, -0.25, 0.0) * (1.0 - ramp(self.target_height, 0.35, 1.0)),
            looked_down: ramp(self.above, 0.75, 1.0) * ramp(self.looks_down, -0.05, 0.3).max(0.02),
            upright: 0.3 + 0.7 * ramp(self.upright, -0.3, 0.2),
            nothing_below: 1.0 / (1.0 + (self.below_share / 0.06).powi(2)),
            touched: 1.0 / (1.0 + (self.gap / 0.15).powi(2)),
            standing: share(self.standing, most_standing).powf(0.5),
            extent: 0.2 + 0.8 * self.sectors,
            shown: share(self.near, most_near).powf(0.3),
        }
    }
}

/// 0 below `lo`, 1 above `hi`, smooth between.
fn ramp(x: f64, lo: f64, hi: f64) -> f64 {
    let t = ((x - lo) / (hi - lo)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Distance from the target along the plane.
fn across(plane: &Plane, scene: &Scene, p: &Point3<f64>) -> f64 {
    let off = p - scene.target;
    (off - plane.up * off.dot(&plane.up)).norm()
}

/// Two directions along the plane.
fn axes(plane: &Plane) -> [Vector3<f64>; 2] {
    let x = plane.up.cross(&Vector3::ith(plane.up.iamin(), 1.0)).normalize();
    [x, plane.up.cross(&x)]
}

fn table_of(scene: &Scene, candidate: &Candidate) -> TablePlane {
    let plane = &candidate.plane;
    let n = candidate.inliers.len() as f64;
    let mean = |f: &dyn Fn(usize) -> f64| candidate.inliers.iter().map(|&i| f(i)).sum::<f64>() / n;
    let height = |i: usize| plane.height(&scene.points()[i].position);
    TablePlane {
        point: plane.point,
        up: unit(plane.up),
        inliers: candidate.inliers.len(),
        rms: mean(&|i| height(i).powi(2)).sqrt(),
        rms_px: mean(&|i| (height(i) / scene.sigma(i, &plane.up)).powi(2)).sqrt(),
    }
}

fn same(scene: &Scene, a: &TablePlane, b: &TablePlane) -> bool {
    let height = |t: &TablePlane| t.up.dot(&(scene.target - t.point));
    a.up.angle(&b.up) < SAME_RAD && (height(a) - height(b)).abs() < SAME * scene.distance
}

fn doubt(scene: &Scene, chosen: &PlaneCandidate, second: Option<&PlaneCandidate>) -> Option<String> {
    if chosen.score < WEAK {
        return Some(format!(
            "the plane taken for the table is a poor one (score {:.3}): photograph the object on a surface with texture, \
             state the up direction, or give masks",
            chosen.score
        ));
    }
    let second = second.filter(|s| s.score > CLOSE * chosen.score)?;
    let tilt = second.table.up.angle(&chosen.table.up).to_degrees();
    let height = |t: &TablePlane| t.up.dot(&(scene.target - t.point)) / scene.distance;
    Some(format!(
        "another plane may be the table: {tilt:.0} degrees from the one taken and {:.2} distances of the cameras lower, with \
         score {:.2} against {:.2}; state the up direction or give masks if the object does not stand upright",
        height(&second.table) - height(&chosen.table),
        second.score,
        chosen.score
    ))
}
