//! Moves a mesh until the photos that see it agree about it.
//!
//! The sum over pairs of photos of 1 - correlation of the windows of one with the other, warped through the mesh, is made small, with a
//! prior against bending (Vu, Labatut, Pons and Keriven 2012). The steps are those of Gauss and Newton along the normals of the
//! vertices: they come out in units of length, and become small by themselves.

mod pair;
mod shot;
mod skin;

use drex_core::capture::Capture;
use drex_core::stats::{median, quantile};
use drex_core::{Error, Pose, Result, TriMesh};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::maps::Step;
use crate::options::{MvsOptions, Preset, Region};
use crate::scene::{View, prepare};
use pair::{Pulls, pulls};
use shot::{Blurred, Shot};
use skin::{Pull, Skin};

/// Photos whose pulls are held at once.
const BATCH: usize = 16;
/// Longest step, pixels of the size at work.
const LONGEST_STEP_PX: f64 = 0.3;
/// Most steps are shorter than this when nothing is left to gain, pixels.
const STILL_PX: f64 = 0.02;
/// Photos agree less than before only if their correlation lacks this many times as much of 1: from pass to pass windows are other ones as well.
const WORSE: f64 = 1.05;
/// It ends after so many passes in a row after which photos agree less.
const MOST_WORSE: usize = 2;
/// How much vertices that no depth map shows hold on to their place, beside what photos say of others.
const UNSEEN_HOLD: f64 = 0.3;
/// Share of the way that vertices slide along the surface towards the middle of their neighbours.
const SLIDE: f64 = 0.2;

/// How a mesh is refined.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RefineOptions {
    /// How many other photos each one is compared with.
    pub preset: Preset,
    /// Longest side of the pictures that are compared, pixels; larger photos are scaled down.
    pub max_side: Option<usize>,
    /// How stiff the surface is, beside what photos say of it in the middle.
    pub stiffness: f64,
    /// Most passes at half size and at full size.
    pub passes: [usize; 2],
}

impl Default for RefineOptions {
    fn default() -> Self {
        Self { preset: Preset::Default, max_side: Some(2000), stiffness: 20.0, passes: [12, 10] }
    }
}

/// What may happen to a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// Photos move it.
    Free,
    /// No depth map shows it: photos have to tell clearly where it is.
    Unseen,
    /// It stays.
    Fixed,
}

/// What came of it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RefineReport {
    /// Passes that were made.
    pub passes: usize,
    /// Share of the vertices that photos had a say in.
    pub seen_share: f64,
    /// How far vertices ended from where they began: median and 95 %, the capture's unit of length.
    pub moved: [f64; 2],
    /// Mean correlation of the windows at full size, before the passes there and after them; not a number if none were asked for.
    pub correlation: [f64; 2],
}

/// Refines a closed mesh in the capture's world and unit. `holds` has an entry per vertex, or none if all are free. The same input gives the
/// same numbers with any number of threads.
///
/// # Errors
/// If the mesh is empty or malformed, `holds` is of another length, the stiffness is negative or not finite, a photo cannot be read, or no two
/// photos see the same part of the mesh.
pub fn refine(
    mesh: &TriMesh,
    holds: &[Hold],
    capture: &Capture,
    options: &RefineOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<(TriMesh, RefineReport)> {
    if !holds.is_empty() && holds.len() != mesh.vertices.len() {
        return Err(Error::value(
            format!("what may happen to {} vertices is said of {}", mesh.vertices.len(), holds.len()),
            "give one per vertex, or none",
        ));
    }
    if !(options.stiffness >= 0.0 && options.stiffness.is_finite()) {
        return Err(Error::value(
            format!("a stiffness of {}", options.stiffness),
            "give 0 or more; the default holds for most",
        ));
    }
    let mesh = &TriMesh::new(mesh.vertices.clone(), mesh.faces.clone())?;
    let Some((lo, hi)) = mesh.bounds().filter(|_| !mesh.faces.is_empty()) else {
        return Err(Error::value("a mesh without faces", "give the mesh of the object"));
    };
    let mut prepared = MvsOptions::default();
    (prepared.preset, prepared.max_side, prepared.mask_margin_px) = (options.preset, options.max_side, 0);
    let margin = Vector3::repeat(0.02 * (hi - lo).norm());
    prepared.region = Some(Region { box_from_world: Pose::identity(), corners: [lo - margin, hi + margin] });
    let total = capture.views.len();
    let views = prepare(capture, &prepared, 2, &|done| progress(Step { stage: "photos", done, total }))?;
    let mut work = Work {
        views: &views,
        skin: Skin::new(mesh),
        holds,
        stiffness: options.stiffness,
        vertices: mesh.vertices.clone(),
    };
    let total = options.passes.iter().sum();
    let (mut passes, mut done) = (0, 0);
    let mut correlation = [f64::NAN; 2];
    let mut seen_share = 0.0;
    for (halvings, most) in [(1, options.passes[0]), (0, options.passes[1])] {
        if most == 0 {
            continue;
        }
        let pictures: Vec<Blurred> = views.par_iter().map(|v| Blurred::new(v, halvings)).collect();
        let pixel = work.pixel(halvings, &nalgebra::center(&lo, &hi));
        let mut best = (f64::NEG_INFINITY, work.vertices.clone());
        let (mut worse, mut step, mut last) = (0, f64::INFINITY, f64::NAN);
        for pass in 0..=most {
            progress(Step { stage: "refinement", done: done + pass, total });
            let pulls = work.pulls(halvings, &pictures);
            if passes == 0 && pulls.windows == 0 {
                return Err(Error::value(
                    format!("no two of the {} photos show the same part of the mesh", capture.views.len()),
                    "give the mesh in the frame and unit of the capture, and photos 3 to 45 degrees apart",
                ));
            }
            let agreement = pulls.correlation / f64::from(pulls.windows).max(1.0);
            if halvings == 0 && pass == 0 {
                correlation[0] = agreement;
            }
            worse = if 1.0 - agreement <= WORSE * (1.0 - best.0) { 0 } else { worse + 1 };
            if agreement > best.0 {
                best = (agreement, work.vertices.clone());
            }
            last = agreement;
            if worse == MOST_WORSE || step < STILL_PX * pixel || pass == most {
                break;
            }
            seen_share = pulls.share();
            passes += 1;
            step = work.step(&pulls, pixel);
        }
        if worse > 0 {
            (last, work.vertices) = best;
        }
        if halvings == 0 {
            correlation[1] = last;
        }
        done += most;
    }
    let distance = || mesh.vertices.iter().zip(&work.vertices).map(|(a, b)| (b - a).norm());
    let moved = [median(distance()), quantile(distance(), 0.95)].map(|d| d.unwrap_or(0.0));
    let refined = TriMesh { vertices: work.vertices, faces: mesh.faces.clone() };
    Ok((refined, RefineReport { passes, seen_share, moved, correlation }))
}

struct Work<'a> {
    views: &'a [View],
    skin: Skin<'a>,
    holds: &'a [Hold],
    stiffness: f64,
    vertices: Vec<Point3<f64>>,
}

impl Work<'_> {
    /// Side of a pixel at a place, median over the photos.
    fn pixel(&self, halvings: usize, at: &Point3<f64>) -> f64 {
        let sides = self.views.iter().filter_map(|v| Some(v.camera.project(at)?.1 / v.camera.fx));
        median(sides).unwrap_or(1.0) * (1 << halvings) as f64
    }

    /// What all photos say.
    fn pulls(&self, halvings: usize, pictures: &[Blurred]) -> Pulls {
        let faces = self.skin.faces;
        let shots: Vec<Shot> = self.views.par_iter().map(|v| Shot::new(v, halvings, &self.vertices, faces)).collect();
        let mut all = Pulls::new(self.vertices.len());
        let views: Vec<usize> = (0..self.views.len()).collect();
        for batch in views.chunks(BATCH) {
            let of = |&i: &usize| pulls(self.views, &shots, pictures, halvings, i, faces, &self.vertices);
            let each: Vec<Pulls> = batch.par_iter().map(of).collect();
            each.iter().for_each(|pulls| all.add(pulls));
        }
        all
    }

    /// Moves the vertices; returns the median of their steps.
    fn step(&mut self, pulls: &Pulls, pixel: f64) -> f64 {
        let Some(usual) = median(pulls.each.iter().map(|p| f64::from(p[1])).filter(|h| *h > 0.0)) else { return 0.0 };
        // Where nothing has texture, shading must not move the surface.
        let usual = usual.max(1.0 / (pixel * pixel));
        let hold = |v: usize| self.holds.get(v).copied().unwrap_or(Hold::Free);
        let each: Vec<[f64; 2]> = (0..self.vertices.len())
            .map(|v| match hold(v) {
                Hold::Free | Hold::Fixed => pulls.each[v].map(f64::from),
                // It holds on to where it is.
                Hold::Unseen => [f64::from(pulls.each[v][0]), f64::from(pulls.each[v][1]) + UNSEEN_HOLD * usual],
            })
            .collect();
        let fixed: Vec<bool> = (0..self.vertices.len()).map(|v| hold(v) == Hold::Fixed).collect();
        let normals = self.skin.normals(&self.vertices);
        let pull = Pull { each: &each, stiffness: self.stiffness * usual, fixed: &fixed };
        let steps = self.skin.steps(&pull, &self.vertices, &normals);
        let places: Vec<Vector3<f64>> = self.vertices.iter().map(|p| p.coords).collect();
        let inwards = self.skin.inwards(&places);
        let longest = LONGEST_STEP_PX * pixel;
        for (v, vertex) in self.vertices.iter_mut().enumerate() {
            if fixed[v] {
                continue;
            }
            let n = normals[v];
            let slide = inwards[v] - n * inwards[v].dot(&n);
            *vertex += n * steps[v].clamp(-longest, longest) + SLIDE * slide;
        }
        median(steps.iter().map(|s| s.abs().min(longest))).unwrap_or(0.0)
    }
}
