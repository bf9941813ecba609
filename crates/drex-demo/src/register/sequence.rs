//! The object in every frame of a sequence.

use drex_core::{Error, Result, Surface};
use nalgebra::Point3;

use super::icp::Problem;
use super::{MIDDLE, Placement, RegisterOptions, Registration, Symmetries, register};
use crate::{Demonstration, median};

/// Between two frames of a sequence the distance may grow by this factor before the object is looked for again everywhere.
const LOST: f64 = 2.0;

/// Brings the object onto the points of each frame of a sequence: the first as [`register`], each next from the frame before, and
/// everywhere again where the object was lost. Frames without enough points have their own error.
///
/// Of placements that look the same the one nearest to the frame before is taken, so that a symmetric object does not jump.
pub fn register_sequence(
    frames: &[Vec<Point3<f64>>],
    surface: &dyn Surface,
    options: &RegisterOptions,
) -> Vec<Result<Registration>> {
    let mut before: Option<Registration> = None;
    let mut out = Vec::with_capacity(frames.len());
    for points in frames {
        let found = match &before {
            Some(previous) => follow(points, surface, options, previous),
            None => register(points, surface, options),
        };
        if let Ok(found) = &found {
            before = Some(found.clone());
        }
        out.push(found);
    }
    out
}

/// The placement that goes on from `previous`; it and what looked the same then are all that is tried, unless the object is lost.
fn follow(
    points: &[Point3<f64>],
    surface: &dyn Surface,
    options: &RegisterOptions,
    previous: &Registration,
) -> Result<Registration> {
    let problem = Problem::new(points, surface, options)?;
    let starts: Vec<_> =
        std::iter::once(&previous.placement).chain(&previous.alternatives).map(|p| problem.start_at(p)).collect();
    let mut next = problem.registration(problem.finished(problem.refined(&starts, &MIDDLE)), Symmetries::Known)?;
    let is_lost = next.rms_m > LOST * previous.rms_m || next.inlier_share * LOST < previous.inlier_share;
    if is_lost {
        next = register(points, surface, options)?;
    }
    let turn = |p: &Placement| p.rotation.angle_to(&previous.placement.rotation);
    for alternative in &mut next.alternatives {
        if turn(alternative) < turn(&next.placement) {
            std::mem::swap(&mut next.placement, alternative);
        }
    }
    Ok(next)
}

impl Demonstration {
    /// Gives frames their object pose from points of the object, `clouds` of frame number and points in the source frame of the key points, and
    /// makes the demonstration metric: the reconstruction has one scale (the median of the frames', unless the options give it), the
    /// mesh says what a metre is, and key points and poses are divided by it.
    ///
    /// The result has one entry per cloud: its registration at that scale, or why there is none; such frames have no object pose. A note says
    /// how many frames were placed and at which scale.
    ///
    /// # Errors
    /// If no cloud could be registered, or none belongs to a frame of the demonstration.
    pub fn register_object(
        &mut self,
        clouds: &[(usize, Vec<Point3<f64>>)],
        surface: &dyn Surface,
        options: &RegisterOptions,
    ) -> Result<Vec<Result<Registration>>> {
        let points: Vec<Vec<Point3<f64>>> = clouds.iter().map(|(_, points)| points.clone()).collect();
        let mut found = register_sequence(&points, surface, options);
        let mut scales: Vec<f64> = found.iter().flatten().map(|r| r.placement.scale).collect();
        let Some(scale) = median(&mut scales) else {
            let why = found.into_iter().find_map(Result::err).map_or("no points".into(), |e| e.to_string());
            return Err(Error::value(format!("the object was found in no frame: {why}"), "check points and mesh"));
        };
        let one_scale = RegisterOptions { scale: Some(scale), ..options.clone() };
        for (registration, points) in found.iter_mut().zip(&points) {
            if let Ok(before) = registration {
                *registration = follow(points, surface, &one_scale, before);
            }
        }
        let mut placed = 0;
        for frame in &mut self.frames {
            frame.points = frame.points.map(|p| p.map(|p| p / scale));
            let own = clouds.iter().zip(&found).find(|((number, _), _)| *number == frame.index);
            frame.source_from_object = own.and_then(|(_, r)| Some(r.as_ref().ok()?.placement.metric_pose()));
            placed += usize::from(frame.source_from_object.is_some());
        }
        if placed == 0 {
            return Err(Error::value(
                "no cloud of points has the number of a frame of the demonstration",
                "number the clouds as the frames, from 0",
            ));
        }
        self.notes.push(format!(
            "the object was registered in {placed} of {} frames; {scale:.4} units of the source were a metre",
            self.frames.len()
        ));
        Ok(found)
    }
}
