//! Where an object is: its mesh brought onto the points that a reconstruction gives, scale included.
//!
//! Reconstructions of hand and object from pictures (MCC-HO) end in points, not in a pose, and in units of their own.
//! Iterative closest points (Besl and McKay, 1992) with a similarity, robust weights, and two kinds of residuals: each point to the
//! nearest place on the mesh, and each seen place of the mesh to the points around it. The second kind is what fixes the
//! scale of an object seen from one side: without it the corner of a larger box fits as well.

mod icp;
mod initial_guesses;
mod points;
mod sequence;

use drex_core::{Error, Pose, Result, Surface};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use serde::Serialize;

use self::icp::{Candidate, Problem};
use self::initial_guesses::{Moments, surface_samples};
pub use self::points::{parse_points, read_point_frames, read_points};
pub use self::sequence::register_sequence;

/// Options of [`register`].
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RegisterOptions {
    /// Units of the points per metre of the mesh, if known: 1 for points in metres. Solved if not.
    pub scale: Option<f64>,
    /// Where the camera was, in the frame of the points, if known. If not, it is told from the points whether only one side of
    /// the object was seen, and which.
    pub viewpoint: Option<Point3<f64>>,
    /// Number of initial orientations besides those of the principal axes.
    pub orientations: usize,
    /// Points that are used at the end; more are thinned out.
    pub max_points: usize,
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self { scale: None, viewpoint: None, orientations: 72, max_points: 1500 }
    }
}

/// A similarity `source_from_object`: x ↦ scale · R x + translation.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Placement {
    /// Units of the source per metre of the mesh.
    pub scale: f64,
    /// Rotation of the placement.
    pub rotation: UnitQuaternion<f64>,
    /// Translation of the placement, source units.
    pub translation: Vector3<f64>,
    /// What was made small, 0 for a perfect fit, at most 2; comparable between the placements of one registration only.
    pub cost: f64,
}

impl Placement {
    /// Pose of the mesh in the source frame made metric, that is, with all its coordinates divided by [`Placement::scale`].
    pub fn metric_pose(&self) -> Pose {
        Isometry3::from_parts(Translation3::from(self.translation / self.scale), self.rotation)
    }

    /// A point of the mesh in the source frame, source units.
    pub fn point(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords * self.scale + self.translation)
    }
}

/// Result of a registration.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Registration {
    /// The best placement.
    pub placement: Placement,
    /// Root mean square distance of the points that belong to the object from its surface, m (of the mesh).
    pub rms_m: f64,
    /// Share of the points that belong to the object.
    pub inlier_share: f64,
    /// Share of the surface that should be seen and has points.
    pub covered_share: f64,
    /// Placements that fit as well: the object looks the same from there. Best first.
    pub alternatives: Vec<Placement>,
}

/// One line of a report on a registration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RegistrationSummary {
    /// [`Placement::scale`].
    pub scale: f64,
    /// [`Registration::rms_m`], mm.
    pub rms_mm: f64,
    /// [`Registration::inlier_share`].
    pub inlier_share: f64,
    /// [`Registration::covered_share`].
    pub covered_share: f64,
    /// Number of [`Registration::alternatives`].
    pub alternatives: usize,
}

impl Registration {
    /// The numbers of the registration.
    pub fn summary(&self) -> RegistrationSummary {
        RegistrationSummary {
            scale: self.placement.scale,
            rms_mm: 1e3 * self.rms_m,
            inlier_share: self.inlier_share,
            covered_share: self.covered_share,
            alternatives: self.alternatives.len(),
        }
    }
}

/// Fewer points are no object.
const FEWEST_POINTS: usize = 30;
/// Points, samples of the surface, iterations and survivors of the two rough stages; iterations of the last.
const ROUGH: Stage = Stage { points: 100, samples: 80, iterations: 12, kept: 12 };
const MIDDLE: Stage = Stage { points: 300, samples: 200, iterations: 16, kept: 5 };
const FINE: Stage = Stage { points: usize::MAX, samples: 600, iterations: 60, kept: usize::MAX };
/// A look at turned placements, which need no improving to be compared.
const LOOK: Stage = Stage { points: 300, samples: 200, iterations: 0, kept: 10 };
/// A placement fits as well as the best up to this factor and this part of the largest cost.
const AS_GOOD: (f64, f64) = (1.15, 0.01);
/// Before its last steps a placement may be worse than the best by this factor and this part of the largest cost.
const PROMISING: (f64, f64) = (2.0, 0.02);
/// Turns (rad), changes of scale and shifts (of the object's size) below which two placements are one.
const SAME: (f64, f64, f64) = (0.17, 0.05, 0.05);

/// Whether placements that look the same are still to be found.
#[derive(Clone, Copy)]
enum Symmetries {
    Sought,
    Known,
}

struct Stage {
    points: usize,
    samples: usize,
    iterations: usize,
    kept: usize,
}

/// Brings the object onto `points`.
///
/// Deterministic, with any number of threads.
///
/// # Errors
/// If there are fewer than 30 finite points, they or the surface have no extent, or an option makes no sense.
pub fn register(points: &[Point3<f64>], surface: &dyn Surface, options: &RegisterOptions) -> Result<Registration> {
    let problem = Problem::new(points, surface, options)?;
    let rotations = initial_guesses::rotations(&problem.points_moments, &problem.surface_moments, options.orientations);
    let starts: Vec<Candidate> = rotations.into_iter().map(|r| problem.start(r)).collect();
    let found = problem.refined(&problem.refined(&starts, &ROUGH), &MIDDLE);
    problem.registration(problem.finished(found), Symmetries::Sought)
}

impl<'a> Problem<'a> {
    fn new(points: &[Point3<f64>], surface: &'a dyn Surface, options: &'a RegisterOptions) -> Result<Self> {
        let refuse = |what: String, remedy| Err(Error::value(what, remedy));
        if options.scale.is_some_and(|s| !(s > 0.0 && s.is_finite())) {
            return refuse("the scale is not positive".into(), "give units of the points per metre, or none");
        }
        let finite = |p: &&Point3<f64>| p.iter().all(|v| v.is_finite() && v.abs() < 1e12);
        let points: Vec<Point3<f64>> = points.iter().filter(finite).copied().collect();
        if points.len() < FEWEST_POINTS {
            let what = format!("{} finite points are too few to place an object", points.len());
            return refuse(what, "give at least 30, all over the object");
        }
        let samples = surface_samples(surface, FINE.samples);
        if samples.len() < FEWEST_POINTS {
            return refuse("the object's surface has no extent".into(), "give a closed mesh");
        }
        let points = initial_guesses::shuffled(points, options.max_points.max(FEWEST_POINTS));
        let points_moments = Moments::of(&points);
        let surface_moments = Moments::of(&samples.iter().map(|s| s.point).collect::<Vec<_>>());
        if !(points_moments.radius > 0.0 && surface_moments.radius > 0.0) {
            return refuse("all points are in one place".into(), "check the reconstruction");
        }
        Ok(Self { points, samples, surface, options, points_moments, surface_moments })
    }

    /// Runs a stage from each of `starts` and keeps its best, different ones, best first.
    fn refined(&self, starts: &[Candidate], stage: &Stage) -> Vec<Candidate> {
        let mut ends: Vec<Candidate> =
            starts.par_iter().map(|start| self.refine(start, stage.points, stage.samples, stage.iterations)).collect();
        ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let mut kept: Vec<Candidate> = Vec::new();
        for end in ends.into_iter().filter(|e| e.cost.is_finite()) {
            if kept.len() < stage.kept && !kept.iter().any(|k| self.same(k, &end)) {
                kept.push(end);
            }
        }
        kept
    }

    fn same(&self, a: &Candidate, b: &Candidate) -> bool {
        let size = self.points_moments.radius;
        let middle = |f: &Candidate| f.point(&self.surface_moments.mean);
        a.rotation.angle_to(&b.rotation) < SAME.0
            && (a.scale / b.scale).ln().abs() < SAME.1
            && (middle(a) - middle(b)).norm() < SAME.2 * size
    }

    /// The last stage, for those that may still turn out as good as the best.
    fn finished(&self, mut fits: Vec<Candidate>) -> Vec<Candidate> {
        let least = fits.first().map_or(0.0, |f| f.cost);
        fits.retain(|f| f.cost <= PROMISING.0 * least + PROMISING.1);
        self.refined(&fits, &FINE)
    }

    /// The best of `fits` and what is as good, if sought also among turns of the best by quarters about the object's axes.
    fn registration(&self, fits: Vec<Candidate>, symmetries: Symmetries) -> Result<Registration> {
        let Some(best) = fits.first().copied() else {
            return Err(Error::value("no placement of the object fits the points", "check the points and the mesh"));
        };
        let turns = match symmetries {
            Symmetries::Sought => initial_guesses::quarter_turns(&self.surface_moments),
            Symmetries::Known => Vec::new(),
        };
        let turned: Vec<Candidate> =
            turns.into_iter().map(|turn| best.turned(&turn, &self.surface_moments.mean)).collect();
        let mut turned = self.refined(&self.refined(&turned, &LOOK), &MIDDLE);
        turned.retain(|t| !fits.iter().any(|f| self.same(f, t)) && t.cost <= PROMISING.0 * best.cost + PROMISING.1);
        let mut all = fits;
        for fit in self.refined(&turned, &FINE) {
            if !all.iter().any(|f| self.same(f, &fit)) {
                all.push(fit);
            }
        }
        all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let best = all[0];
        let limit = best.cost * AS_GOOD.0 + AS_GOOD.1;
        let report = self.report(&best);
        Ok(Registration {
            placement: best.placement(),
            rms_m: report.rms / best.scale,
            inlier_share: report.inlier_share,
            covered_share: report.covered_share,
            alternatives: all[1..].iter().filter(|f| f.cost <= limit).map(Candidate::placement).collect(),
        })
    }
}
