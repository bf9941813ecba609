//! The palmar side of a finger.

use drex_core::{Pose, SignedDistance};
use drex_grasp::LinkSurface;
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};

/// The points of a finger that may press on an object, by link.
#[derive(Debug, Clone)]
pub(crate) struct Pad {
    pub(crate) parts: Vec<(usize, LinkSurface)>,
}

impl Pad {
    /// Link, point (object frame) and distance of the point that is nearest to the object; `None` without points.
    pub(crate) fn nearest(&self, poses: &[Pose], object: &dyn SignedDistance) -> Option<(usize, Point3<f64>, f64)> {
        let mut best: Option<(usize, Point3<f64>, f64)> = None;
        for (link, part) in &self.parts {
            let limit_m = best.map_or(f64::INFINITY, |b| b.2);
            if let Some((i, distance_m)) = part.nearest(&poses[*link], object, limit_m) {
                best = Some((*link, poses[*link] * part.samples()[i].0, distance_m));
            }
        }
        best
    }
}

/// The way in which the point `far` of a finger moves when `joint` bends it, a unit vector in the frame of `poses`: a finger bends towards the side on which
/// its joint has the wider range. `None` for a point on the joint's axis.
pub(crate) fn palmar(robot: &Robot, poses: &[Pose], joint: usize, far: &Point3<f64>) -> Option<Vector3<f64>> {
    let (axis, anchor) = robot.joint_axis(poses, joint);
    let bends = robot.joints[joint].limits.map_or(1.0, |(lo, hi)| if hi >= -lo { 1.0 } else { -1.0 });
    (axis * bends).cross(&(far - anchor)).try_normalize(1e-9)
}
