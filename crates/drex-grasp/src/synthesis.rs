//! Grasps that nobody demonstrated: power grasps and pinches of one object.

use drex_core::Object;
use drex_robot::Robot;

use crate::{Grasp, Result, pinch_grasps, power_grasps};

/// Candidates of the pinch search for one try of a power grasp: closing a hand takes longer, and more of those that are closed
/// hold.
const PINCHES_PER_POWER_GRASP: usize = 50;

/// Power grasps and pinches, from `candidates` pinches that are looked at. The same for any number of threads.
///
/// # Errors
/// If the hand has no collision shapes, or neither thumb nor finger.
pub fn synthesize_grasps(object: &Object, robot: &Robot, candidates: usize, seed: u64) -> Result<Vec<Grasp>> {
    let tries = candidates.div_ceil(PINCHES_PER_POWER_GRASP);
    let mut grasps = power_grasps(object, robot, tries, seed)?;
    grasps.extend(pinch_grasps(object, robot, candidates, seed)?);
    Ok(grasps)
}
