//! One grasp of one object: where the hand is, where its joints are, where it comes from.

use std::fmt;

use drex_core::{Object, Pose, PoseRecord};
use drex_robot::Robot;
use serde::{Deserialize, Serialize};

use crate::{ContactOptions, HandSurface, Result, grip_force_per_weight, holds_any_load};

/// Deepest that a hand may be inside the object in a grasp that is worth simulating, metres.
const MAX_PENETRATION_M: f64 = 0.002;

/// Where a grasp comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GraspOrigin {
    /// A demonstrated grasp, retargeted to the hand.
    Retargeted,
    /// A grasp made of a demonstrated one: by the object's symmetries and noise, or by perturbations in simulation.
    Refined,
    /// A power grasp: the palm placed on the object and the fingers closed around it.
    Power,
    /// A pinch between opposite points of the surface.
    Pinch,
}

impl GraspOrigin {
    /// The origin of a perturbed grasp. One of a grasp that nobody demonstrated is still one that was synthesised.
    #[must_use]
    pub fn perturbed(self) -> Self {
        match self {
            Self::Retargeted | Self::Refined => Self::Refined,
            Self::Power | Self::Pinch => self,
        }
    }
}

/// How many grasps come from where.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct OriginCounts {
    /// Grasps that somebody demonstrated.
    pub demonstrated: usize,
    /// Grasps made of demonstrated ones.
    pub refined: usize,
    /// Grasps found without a demonstration: power grasps and pinches.
    pub searched: usize,
}

impl OriginCounts {
    /// Counts grasps of these origins.
    pub fn of(origins: impl IntoIterator<Item = GraspOrigin>) -> Self {
        let mut counts = Self::default();
        for origin in origins {
            match origin {
                GraspOrigin::Retargeted => counts.demonstrated += 1,
                GraspOrigin::Refined => counts.refined += 1,
                GraspOrigin::Power | GraspOrigin::Pinch => counts.searched += 1,
            }
        }
        counts
    }

    /// The number of all of them.
    pub fn total(&self) -> usize {
        self.demonstrated + self.refined + self.searched
    }
}

impl fmt::Display for OriginCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} demonstrated, {} refined, {} searched", self.demonstrated, self.refined, self.searched)
    }
}

/// A grasp of an object on its table, with what is known of it without forces.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(into = "GraspRecord", try_from = "GraspRecord")]
pub struct Grasp {
    /// Where the grasp comes from.
    pub origin: GraspOrigin,
    /// Number of the demonstration or of the candidate that the grasp comes from.
    pub source: usize,
    /// Joint angles in the model's order, rad.
    pub joints_rad: Vec<f64>,
    /// Pose of the hand's base link in the object's frame.
    pub object_from_base: Pose,
    /// Number of contacts of each finger in the model's order, then of the palm.
    pub contacts: Vec<usize>,
    /// Smallest sum of normal forces that carries the object at rest, in units of its weight.
    pub grip_per_weight: f64,
    /// Height of the hand's lowest point above the table, metres.
    pub table_clearance_m: f64,
    /// Depth of the hand's deepest point inside the object, metres; zero or more.
    pub penetration_m: f64,
}

impl Grasp {
    /// The grasp with these joint angles (model order, rad) at this pose, if it is worth simulating: the thumb and another
    /// finger touch, the hand is at most 2 mm inside the object, and the contacts are in force closure at this friction.
    ///
    /// # Errors
    /// If the joint vector does not fit the hand, or a solver gives up.
    pub fn screened(
        object: &Object,
        robot: &Robot,
        surface: &HandSurface,
        joints_rad: &[f64],
        object_from_base: &Pose,
        friction: f64,
    ) -> Result<Option<Self>> {
        let table = object.table();
        let links = robot.forward_kinematics(joints_rad, object_from_base);
        let lowest_m = surface.lowest(&links, &table.up).into_iter().fold(f64::INFINITY, f64::min);
        let exact = object.geometry.exact();
        let penetration_m = surface.depths(&links, exact, 0.0).into_iter().fold(0.0, f64::max);
        let options = ContactOptions::with_friction(friction);
        let contacts = surface.contacts(robot, joints_rad, object_from_base, exact, &options)?;
        let count = |finger: Option<usize>| contacts.iter().filter(|c| c.finger == finger).count();
        let counts: Vec<usize> = (0..surface.fingers.len()).map(Some).chain(std::iter::once(None)).map(count).collect();
        let thumb_touches = surface.thumb().is_none_or(|t| counts[t] > 0);
        let touching = counts[..surface.fingers.len()].iter().filter(|n| **n > 0).count();
        let center = object.center_of_mass();
        if penetration_m > MAX_PENETRATION_M || !thumb_touches || touching < 2 || !holds_any_load(&contacts, &center)? {
            return Ok(None);
        }
        let grip = grip_force_per_weight(&contacts, center, table.up)?;
        Ok(grip.map(|grip_per_weight| Self {
            origin: GraspOrigin::Retargeted,
            source: 0,
            joints_rad: joints_rad.to_vec(),
            object_from_base: *object_from_base,
            contacts: counts,
            grip_per_weight,
            table_clearance_m: lowest_m - table.height_m,
            penetration_m,
        }))
    }
}

/// A [`Grasp`] as files hold it.
#[derive(Clone, Serialize, Deserialize)]
struct GraspRecord {
    origin: GraspOrigin,
    source: usize,
    joints_rad: Vec<f64>,
    object_from_base: PoseRecord,
    contacts: Vec<usize>,
    grip_per_weight: f64,
    table_clearance_m: f64,
    penetration_m: f64,
}

impl From<Grasp> for GraspRecord {
    fn from(g: Grasp) -> Self {
        let Grasp { origin, source, joints_rad, contacts, grip_per_weight, table_clearance_m, penetration_m, .. } = g;
        let object_from_base = PoseRecord::from(&g.object_from_base);
        Self {
            origin,
            source,
            joints_rad,
            object_from_base,
            contacts,
            grip_per_weight,
            table_clearance_m,
            penetration_m,
        }
    }
}

impl TryFrom<GraspRecord> for Grasp {
    type Error = drex_core::Error;

    fn try_from(r: GraspRecord) -> Result<Self, drex_core::Error> {
        let object_from_base = r.object_from_base.to_pose()?;
        let GraspRecord {
            origin, source, joints_rad, contacts, grip_per_weight, table_clearance_m, penetration_m, ..
        } = r;
        Ok(Self {
            origin,
            source,
            joints_rad,
            object_from_base,
            contacts,
            grip_per_weight,
            table_clearance_m,
            penetration_m,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_perturbed_demonstration_was_not_demonstrated() {
        use GraspOrigin::{Pinch, Power, Refined, Retargeted};
        let origins = [Retargeted, Power, Pinch, Refined, Pinch];
        let tried = OriginCounts::of(origins);
        assert_eq!(tried, OriginCounts { demonstrated: 1, refined: 1, searched: 3 });
        // Twice: what is perturbed again is still made of a demonstrated one, what was synthesised still is.
        let perturbed = OriginCounts::of(origins.map(GraspOrigin::perturbed).map(GraspOrigin::perturbed));
        assert_eq!(perturbed, OriginCounts { demonstrated: 0, refined: 2, searched: 3 });
        assert_eq!((tried.total(), perturbed.total()), (5, 5));
        assert_eq!(perturbed.to_string(), "0 demonstrated, 2 refined, 3 searched");
    }
}
