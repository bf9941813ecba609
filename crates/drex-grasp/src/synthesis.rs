//! Grasps that nobody demonstrated: power grasps and pinches of one object.

use drex_core::Object;
use drex_robot::Robot;

use crate::{
    ContactOptions, FingerClosing, Grasp, GraspOrigin, HandSurface, PowerGraspOptions, Result, SearchOptions,
    power_grasps, search_grasps,
};

/// Points of the surface from which opposite ones are searched.
const SURFACE_POINTS: usize = 3000;
/// Candidates of the pinch search for one try of a power grasp: closing a hand takes longer, and more of those that are closed
/// hold.
const PINCHES_PER_POWER_GRASP: usize = 50;

/// Power grasps and pinches, from `candidates` pinches that are looked at. The same for any number of threads.
///
/// # Errors
/// If the hand has no collision shapes, or neither thumb nor finger.
pub fn synthesize_grasps(
    object: &Object,
    robot: &Robot,
    candidates: usize,
    friction: f64,
    seed: u64,
) -> Result<Vec<Grasp>> {
    let tries = candidates.div_ceil(PINCHES_PER_POWER_GRASP);
    let options = PowerGraspOptions { friction, ..PowerGraspOptions::default() };
    let mut grasps = power_grasps(object, robot, tries, seed, &options)?;
    grasps.extend(pinch_grasps(object, robot, candidates, friction, seed)?);
    Ok(grasps)
}

/// Pinches between opposite points of the surface, from `candidates` that are looked at.
///
/// # Errors
/// As [`search_grasps`].
pub fn pinch_grasps(object: &Object, robot: &Robot, candidates: usize, friction: f64, seed: u64) -> Result<Vec<Grasp>> {
    let options = SearchOptions { candidates, seed, friction, min_fingers: 1, ..SearchOptions::default() };
    let surface = HandSurface::new(robot, ContactOptions::default().spacing_m)?;
    let closing = FingerClosing::new(robot)?;
    let points = object.surface_points(SURFACE_POINTS, seed);
    let center = object.center_of_mass();
    let found = search_grasps(robot, &surface, &*object.geometry, &points, &center, &object.table(), &options)?;
    let mut grasps = Vec::new();
    for (source, f) in found.into_iter().enumerate().filter(|(_, f)| f.closed && closing.is_clear_of_itself(&f.joints))
    {
        let screened = Grasp::screened(object, robot, &surface, &f.joints, &f.object_from_base, friction)?;
        grasps.extend(screened.map(|g| Grasp { origin: GraspOrigin::Pinch, source, ..g }));
    }
    Ok(grasps)
}
