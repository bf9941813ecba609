//! What a proposal network learns from: objects on a table with the grasps that a search found for them.

use drex_core::Pose;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// Masses at which grasps are labelled, kg: from a table-tennis bat to a full bottle.
pub const LABELLED_KG: [f64; 6] = [0.02, 0.05, 0.12, 0.3, 0.6, 1.0];

/// An object on the table z = 0 and grasps of it by one hand. The frame is the world's: metres, z up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspedObject {
    /// Name of the object.
    pub name: String,
    /// Points spread evenly over its surface, metres.
    pub points: Vec<[f32; 3]>,
    /// Of cameras around it, which of the points each one sees.
    pub views: Vec<Vec<u16>>,
    /// Grasps for which there is a grip force at some of the labelled masses.
    pub grasps: Vec<LabelledGrasp>,
}

/// A grasp and what it can carry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelledGrasp {
    /// Joint angles, model order, rad.
    pub joints_rad: Vec<f32>,
    /// The hand's base.
    #[serde(with = "drex_core::pose::record")]
    pub world_from_base: Pose,
    /// Fixed points of the hand, such as its palm and fingertips, metres: grasps whose points are near are alike.
    pub key_points: Vec<[f32; 3]>,
    /// Where the closed hand touches the object, metres.
    pub contacts: Vec<[f32; 3]>,
    /// For each of [`LABELLED_KG`] the least friction at which there is a grip force; `None` if there is none.
    pub least_friction: Vec<Option<f32>>,
    /// The grip force there, sum of normal forces, N.
    pub grip_force_n: Vec<Option<f32>>,
    /// How many of the grasps that were found it stands for.
    pub stands_for: f32,
    /// Whether the object stayed in the hand in a rollout at a mass and a friction that the grasp can carry; `None` without one.
    pub held: Option<bool>,
}

impl GraspedObject {
    /// The points.
    pub fn points_m(&self) -> Vec<Point3<f64>> {
        self.points.iter().map(|p| Point3::from(p.map(f64::from))).collect()
    }
}

impl LabelledGrasp {
    /// Whether there is a grip force for a mass at a friction: the answer at the next heavier one of [`LABELLED_KG`].
    pub fn carries(&self, mass_kg: f64, friction: f64) -> bool {
        let at = LABELLED_KG.partition_point(|m| *m < mass_kg - 1e-9);
        self.least_friction.get(at).copied().flatten().is_some_and(|least| f64::from(least) <= friction)
    }

    /// Sum of the frictions that it needs at the labelled masses, a mass that it does not carry counted as 1.5: what needs less carries more.
    pub fn demand(&self) -> f64 {
        self.least_friction.iter().map(|f| f.map_or(1.5, f64::from)).sum()
    }

    /// Where the hand touches.
    pub(crate) fn touches(&self) -> impl Iterator<Item = Point3<f64>> {
        self.contacts.iter().map(|c| Point3::from(c.map(f64::from)))
    }
}
