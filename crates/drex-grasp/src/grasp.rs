//! One grasp of one object: where the hand is, where its joints are, where it comes from.

use std::fmt;

use drex_core::Pose;
use drex_robot::Robot;
use serde::{Deserialize, Serialize};

use crate::find::check_joints;
use crate::{GraspError, Result};

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
    /// Predicted by a network.
    Predicted,
}

impl GraspOrigin {
    /// Whether somebody showed it, or what it was made of.
    pub fn is_demonstrated(self) -> bool {
        matches!(self, Self::Retargeted | Self::Refined)
    }

    /// The origin of a perturbed grasp. One of a grasp that nobody demonstrated is still one that was synthesised.
    #[must_use]
    pub fn perturbed(self) -> Self {
        match self {
            Self::Retargeted | Self::Refined => Self::Refined,
            Self::Power | Self::Pinch | Self::Predicted => self,
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
    /// Counts grasps of these origins; those that a network predicts descend from all of them and are none.
    pub fn of(origins: impl IntoIterator<Item = GraspOrigin>) -> Self {
        let mut counts = Self::default();
        for origin in origins {
            match origin {
                GraspOrigin::Retargeted => counts.demonstrated += 1,
                GraspOrigin::Refined => counts.refined += 1,
                GraspOrigin::Power | GraspOrigin::Pinch => counts.searched += 1,
                GraspOrigin::Predicted => {}
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

/// A grasp of an object on its table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Grasp {
    /// Name of the hand's model.
    pub hand: String,
    /// Names of the joints of `joints_rad`.
    pub joint_names: Vec<String>,
    /// Joint angles, rad.
    pub joints_rad: Vec<f64>,
    /// Pose of the hand's base link in the object's frame.
    #[serde(with = "drex_core::pose::record")]
    pub object_from_base: Pose,
    /// Where the hand touches the object; empty as long as nobody has looked.
    pub contacts: Vec<GraspContact>,
    /// Smallest sum of normal forces that carries the object at rest, N; `None` as long as nobody has looked.
    pub grip_force_n: Option<f64>,
    /// Where the grasp comes from.
    pub origin: GraspOrigin,
    /// Number of the demonstration or of the candidate that the grasp comes from.
    pub source: usize,
}

/// How far one grasp is from another of the same hand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct GraspChange {
    /// Largest difference of a joint's angle, rad.
    pub joint_rad: f64,
    /// Shift of the hand's base, metres.
    pub base_m: f64,
    /// Turn of the hand's base, rad.
    pub base_rad: f64,
}

impl GraspChange {
    /// Whether nothing changed by more than in `most`.
    pub fn is_within(&self, most: &Self) -> bool {
        self.joint_rad <= most.joint_rad && self.base_m <= most.base_m && self.base_rad <= most.base_rad
    }
}

/// A point where the hand touches the object, object frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GraspContact {
    /// Name of the link.
    pub link: String,
    /// Where, on the object's surface, metres.
    pub point_m: [f64; 3],
    /// Unit normal into the object.
    pub normal: [f64; 3],
}

impl Grasp {
    /// The grasp of this hand with these joint angles (model order, rad), a demonstrated one until `origin` says otherwise. What it touches, and how
    /// hard, is not known yet.
    pub fn new(robot: &Robot, joints_rad: Vec<f64>, object_from_base: Pose) -> Self {
        Self {
            hand: robot.name.clone(),
            joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
            joints_rad,
            object_from_base,
            contacts: Vec::new(),
            grip_force_n: None,
            origin: GraspOrigin::Retargeted,
            source: 0,
        }
    }

    /// How far this grasp is from another whose joints are in the same order.
    pub fn change_from(&self, other: &Self) -> GraspChange {
        let joints = self.joints_rad.iter().zip(&other.joints_rad).map(|(a, b)| (a - b).abs());
        let base = other.object_from_base.inverse() * self.object_from_base;
        GraspChange {
            joint_rad: joints.fold(0.0, f64::max),
            base_m: base.translation.vector.norm(),
            base_rad: base.rotation.angle(),
        }
    }

    /// Joint angles in the order of the robot's model, rad.
    ///
    /// # Errors
    /// If the grasp is of another hand, or its joints are not those of the robot, or an angle is not finite.
    pub fn joints_of(&self, robot: &Robot) -> Result<Vec<f64>> {
        let wrong = |what: String| Err(GraspError::Robot(format!("a grasp of \"{}\" {what}", self.hand)));
        if self.hand != robot.name {
            return wrong(format!("is none of \"{}\"; take one of this hand", robot.name));
        }
        if self.joint_names.len() != robot.dof() || self.joints_rad.len() != robot.dof() {
            let (names, angles) = (self.joint_names.len(), self.joints_rad.len());
            return wrong(format!("has {names} joints with {angles} angles, the hand has {} joints", robot.dof()));
        }
        let mut joints = Vec::with_capacity(robot.dof());
        for (i, name) in robot.joint_names().into_iter().enumerate() {
            // Nearly always the order is the model's.
            let here = (self.joint_names[i] == name).then_some(i);
            let Some(k) = here.or_else(|| self.joint_names.iter().position(|n| n == name)) else {
                return wrong(format!("says nothing of joint \"{name}\""));
            };
            joints.push(self.joints_rad[k]);
        }
        check_joints(robot, &joints)?;
        Ok(joints)
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
