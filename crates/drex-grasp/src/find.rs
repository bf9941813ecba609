//! Where a posed hand touches an object.

use drex_core::{Pose, SdfSample, SignedDistance};
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};

use crate::{Contact, GraspError, HandSurface, Result};

/// What counts as a contact and how many are kept.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ContactOptions {
    /// A link touches if a point of it is at most this far from the surface, metres.
    pub max_gap_m: f64,
    /// Distance between the points sampled on the hand, metres.
    pub spacing_m: f64,
    /// Coulomb coefficient of friction of hand against object.
    pub friction: f64,
    /// Contacts kept per link: the deepest point and those of its patch that spread furthest.
    pub max_per_link: usize,
    /// Points belong to the patch if they are at most this much farther out than the deepest, metres.
    pub patch_depth_m: f64,
    /// Least distance between two contacts of one link, metres.
    pub separation_m: f64,
}

impl Default for ContactOptions {
    fn default() -> Self {
        Self {
            max_gap_m: 0.002,
            spacing_m: 0.003,
            friction: 0.5,
            max_per_link: 3,
            patch_depth_m: 0.0005,
            separation_m: 0.005,
        }
    }
}

impl ContactOptions {
    /// The defaults with Coulomb coefficient `friction`.
    pub fn with_friction(friction: f64) -> Self {
        Self { friction, ..Self::default() }
    }

    pub(crate) fn check(&self) -> Result<()> {
        if !(self.max_gap_m >= 0.0 && self.friction >= 0.0 && self.max_per_link > 0) {
            return Err(GraspError::value(
                format!(
                    "contact options: gap {} m, friction {}, {} per link",
                    self.max_gap_m, self.friction, self.max_per_link
                ),
                "give a gap and friction of zero or more and at least one contact per link",
            ));
        }
        Ok(())
    }
}

/// Contacts of the hand at joint vector `q` (model order, rad) with an object.
///
/// `object_from_base` is the pose of the robot's base in the object's frame. Per link at most
/// [`ContactOptions::max_per_link`] points, the deepest first; links in the model's order. The point is moved onto the object's
/// surface and the normal is against the gradient of the distance there.
///
/// # Errors
/// If `q` does not fit the robot, an option is not positive, or the robot has no collision shapes.
pub fn find_contacts(
    robot: &Robot,
    q: &[f64],
    object_from_base: &Pose,
    object: &dyn SignedDistance,
    options: &ContactOptions,
) -> Result<Vec<Contact>> {
    let surface = HandSurface::new(robot, options.spacing_m)?;
    surface.contacts(robot, q, object_from_base, object, options)
}

impl HandSurface {
    /// [`find_contacts`] with the hand already sampled ([`ContactOptions::spacing_m`] is not used).
    ///
    /// # Errors
    /// As [`find_contacts`].
    pub fn contacts(
        &self,
        robot: &Robot,
        q: &[f64],
        object_from_base: &Pose,
        object: &dyn SignedDistance,
        options: &ContactOptions,
    ) -> Result<Vec<Contact>> {
        check_joints(robot, q)?;
        options.check()?;
        let poses = robot.forward_kinematics(q, object_from_base);
        Ok(self.contacts_among(&poses, &self.near(&poses, object, options.max_gap_m), options))
    }

    /// Per link the points within `limit_m` of the object: index and what the object says there.
    pub(crate) fn near(
        &self,
        poses: &[Pose],
        object: &dyn SignedDistance,
        limit_m: f64,
    ) -> Vec<Vec<(usize, SdfSample)>> {
        self.links.iter().zip(poses).map(|(link, pose)| link.within(pose, object, limit_m)).collect()
    }

    /// The contacts among points that are near.
    pub(crate) fn contacts_among(
        &self,
        poses: &[Pose],
        near: &[Vec<(usize, SdfSample)>],
        options: &ContactOptions,
    ) -> Vec<Contact> {
        let mut contacts = Vec::new();
        for (link, (surface, pose)) in self.links.iter().zip(poses).enumerate() {
            let touching = near[link].iter().filter(|(_, s)| s.distance_m <= options.max_gap_m);
            let touching = touching
                .filter_map(|(i, s)| {
                    Some((pose * surface.samples()[*i].0, s.distance_m, s.gradient.try_normalize(1e-9)?))
                })
                .collect();
            for (point, distance, gradient) in patch(touching, options) {
                contacts.push(Contact {
                    point: point - gradient * distance,
                    normal: -gradient,
                    link,
                    finger: self.finger_of_link[link],
                    depth_m: -distance,
                    friction: options.friction,
                });
            }
        }
        contacts
    }
}

/// The deepest point, then those of the same patch that are furthest from the ones taken.
fn patch(
    mut near: Vec<(Point3<f64>, f64, Vector3<f64>)>,
    options: &ContactOptions,
) -> Vec<(Point3<f64>, f64, Vector3<f64>)> {
    let Some(deepest) = near.iter().map(|n| n.1).min_by(f64::total_cmp) else { return Vec::new() };
    near.retain(|n| n.1 <= deepest + options.patch_depth_m);
    let first = near.iter().position(|n| n.1 == deepest).unwrap_or(0);
    let mut taken = vec![near[first]];
    while taken.len() < options.max_per_link {
        let spread = |n: &(Point3<f64>, f64, Vector3<f64>)| {
            taken.iter().map(|t| (t.0 - n.0).norm()).fold(f64::INFINITY, f64::min)
        };
        // The first of equals, so that the order of the samples decides and nothing else.
        let mut best: Option<(f64, usize)> = None;
        for (i, n) in near.iter().enumerate() {
            let s = spread(n);
            if best.is_none_or(|b| s > b.0) {
                best = Some((s, i));
            }
        }
        match best {
            Some((s, i)) if s >= options.separation_m => taken.push(near[i]),
            _ => break,
        }
    }
    taken
}

/// Refuses joint vectors that are not of this robot.
pub(crate) fn check_joints(robot: &Robot, q: &[f64]) -> Result<()> {
    if q.len() != robot.dof() {
        return Err(GraspError::Robot(format!(
            "{} joint values for the {} joints of \"{}\"; give one per joint, in the model's order",
            q.len(),
            robot.dof(),
            robot.name
        )));
    }
    if let Some(j) = q.iter().position(|v| !v.is_finite()) {
        return Err(GraspError::Robot(format!(
            "the value of joint \"{}\" is not finite; repair the grasp",
            robot.joints[j].name
        )));
    }
    Ok(())
}
