//! The hand's surface as points, sampled once and reused for many poses.

use drex_core::Pose;
use drex_robot::{Finger, Robot};
use nalgebra::{Point3, Vector3};

use crate::{GraspError, Result};

/// Points on the collision shapes of every link of a hand.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct HandSurface {
    /// One entry per link of the robot, in its order.
    pub links: Vec<LinkSurface>,
    /// The fingers, as the model found them.
    pub fingers: Vec<Finger>,
    /// Per link, the finger that it belongs to.
    pub finger_of_link: Vec<Option<usize>>,
    /// Distance between neighbouring points, metres.
    pub spacing_m: f64,
}

/// Points on one link, with a ball around them.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct LinkSurface {
    /// Points and outward unit normals, link frame, metres.
    pub samples: Vec<(Point3<f64>, Vector3<f64>)>,
    /// Centre of a ball around the points, link frame.
    pub center: Point3<f64>,
    /// Radius of that ball, metres.
    pub radius_m: f64,
}

impl HandSurface {
    /// Samples every collision shape of `robot` at about `spacing_m`.
    ///
    /// # Errors
    /// If the spacing is not positive or the robot has no collision shape at all.
    pub fn new(robot: &Robot, spacing_m: f64) -> Result<Self> {
        if !(spacing_m > 1e-5 && spacing_m.is_finite()) {
            return Err(GraspError::value(format!("a sample spacing of {spacing_m} m"), "give millimetres, such as 0.003"));
        }
        let links: Vec<LinkSurface> =
            (0..robot.links.len()).map(|l| LinkSurface::new(robot.surface_samples(l, spacing_m))).collect();
        if links.iter().all(|l| l.samples.is_empty()) {
            return Err(GraspError::Robot(format!(
                "\"{}\" has no collision shapes; load a model that has them",
                robot.name
            )));
        }
        let fingers = robot.fingers();
        let mut finger_of_link = vec![None; robot.links.len()];
        for (index, finger) in fingers.iter().enumerate() {
            for &link in &finger.links {
                finger_of_link[link] = Some(index);
            }
        }
        Ok(Self { links, fingers, finger_of_link, spacing_m })
    }

    /// Index of the thumb among the fingers, if the model has one.
    pub fn thumb(&self) -> Option<usize> {
        self.fingers.iter().position(|f| f.is_thumb)
    }

    /// Lowest height of each link's points over the plane `up · x = 0`, in the frame of `link_poses`, metres; infinite for
    /// links without points.
    pub fn lowest(&self, link_poses: &[Pose], up: &Vector3<f64>) -> Vec<f64> {
        self.links
            .iter()
            .zip(link_poses)
            .map(|(link, pose)| {
                let up_link = pose.rotation.inverse() * up;
                let origin = pose.translation.vector.dot(up);
                link.samples.iter().map(|(p, _)| origin + p.coords.dot(&up_link)).fold(f64::INFINITY, f64::min)
            })
            .collect()
    }
}

impl LinkSurface {
    fn new(samples: Vec<(Point3<f64>, Vector3<f64>)>) -> Self {
        let (mut lo, mut hi) = (Point3::from([f64::INFINITY; 3]), Point3::from([f64::NEG_INFINITY; 3]));
        for (p, _) in &samples {
            lo = lo.inf(p);
            hi = hi.sup(p);
        }
        let center = if samples.is_empty() { Point3::origin() } else { nalgebra::center(&lo, &hi) };
        let radius_m = samples.iter().map(|(p, _)| (p - center).norm()).fold(0.0, f64::max);
        Self { samples, center, radius_m }
    }
}
