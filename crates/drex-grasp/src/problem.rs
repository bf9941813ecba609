//! What a grip force has to do: contacts, a load, and limits of the object and of the motors.

use drex_core::Pose;
use drex_robot::Robot;
use nalgebra::{DVector, Matrix3xX, Point3, Vector3, Vector6};

use crate::contact::validate;
use crate::find::check_joints;
use crate::{Contact, GraspError, Result};

/// Contacts, load and limits.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GripForceProblem {
    /// Where the hand touches the object, object frame.
    pub contacts: Vec<Contact>,
    /// Mass of the object, kg.
    pub mass_kg: f64,
    /// Centre of mass, object frame, metres.
    pub center_of_mass: Point3<f64>,
    /// Gravity in the object frame, m/s².
    pub gravity: Vector3<f64>,
    /// Margin γ on the weight: 1 carries it at rest, 1.5 covers errors of about 20 % in mass and friction.
    pub gamma: f64,
    /// Further load on the object: force (N) and torque about the centre of mass (N m), object frame.
    pub extra_wrench: Vector6<f64>,
    /// Soft fingers: torque about the normal up to this many metres times the normal force.
    pub torsion_m: Option<f64>,
    /// Least normal force of each contact, N.
    pub min_normal_n: f64,
    /// Largest normal force of each contact, N: what the object stands before it is damaged.
    pub max_normal_n: Option<f64>,
    /// What the fingers' motors can do.
    pub torques: Option<TorqueLimits>,
}

/// Joint torques that the contact forces ask for, and what the motors can give.
#[derive(Debug, Clone, PartialEq)]
pub struct TorqueLimits {
    /// Per contact, 3 × dof: velocity of the link's point at the contact, in the object frame, per joint speed.
    pub jacobians: Vec<Matrix3xX<f64>>,
    /// Lower and upper torque of each joint, N m; infinite where a joint has no limit.
    pub limits_nm: Vec<(f64, f64)>,
    /// Torque of each joint that holds the hand's own weight, N m.
    pub gravity_nm: DVector<f64>,
}

impl GripForceProblem {
    /// Carries `mass_kg` at rest against `gravity` (object frame, m/s²): no margin, no limits, point contacts.
    pub fn new(contacts: Vec<Contact>, mass_kg: f64, center_of_mass: Point3<f64>, gravity: Vector3<f64>) -> Self {
        Self {
            contacts,
            mass_kg,
            center_of_mass,
            gravity,
            gamma: 1.0,
            extra_wrench: Vector6::zeros(),
            torsion_m: None,
            min_normal_n: 0.0,
            max_normal_n: None,
            torques: None,
        }
    }

    /// The same with the margin `gamma` on the weight.
    pub fn with_gamma(mut self, gamma: f64) -> Self {
        self.gamma = gamma;
        self
    }

    /// The same with soft fingers of torsional friction `torsion_m`, metres.
    pub fn with_torsion_m(mut self, torsion_m: f64) -> Self {
        self.torsion_m = Some(torsion_m);
        self
    }

    /// The same with at most `max_normal_n` newtons at each contact.
    pub fn with_max_normal_n(mut self, max_normal_n: f64) -> Self {
        self.max_normal_n = Some(max_normal_n);
        self
    }

    /// The same with at least `min_normal_n` newtons at each contact.
    pub fn with_min_normal_n(mut self, min_normal_n: f64) -> Self {
        self.min_normal_n = min_normal_n;
        self
    }

    /// The same with motors.
    pub fn with_torques(mut self, torques: TorqueLimits) -> Self {
        self.torques = Some(torques);
        self
    }

    /// The wrench the contacts have to balance, about the centre of mass.
    pub(crate) fn load(&self) -> Vector6<f64> {
        let weight = self.gravity * (self.mass_kg * self.gamma);
        self.extra_wrench + Vector6::new(weight.x, weight.y, weight.z, 0.0, 0.0, 0.0)
    }

    /// Refuses sizes that do not fit and numbers that are none.
    pub(crate) fn check(&self) -> Result<()> {
        validate(&self.contacts)?;
        let bad = |what: String, remedy| Err(GraspError::value(what, remedy));
        if !(self.mass_kg >= 0.0 && self.mass_kg.is_finite()) {
            return bad(format!("the mass is {} kg", self.mass_kg), "give a finite mass of zero or more");
        }
        if !(self.gamma >= 0.0 && self.gamma.is_finite()) {
            return bad(format!("the margin gamma is {}", self.gamma), "give a factor such as 1.5");
        }
        let numbers = self.center_of_mass.iter().chain(self.gravity.iter()).chain(self.extra_wrench.iter());
        if numbers.copied().any(|v| !v.is_finite()) {
            return bad(
                "the centre of mass, gravity or extra wrench is not finite".into(),
                "check where they come from",
            );
        }
        if !(self.min_normal_n >= 0.0) || self.max_normal_n.is_some_and(|m| !(m >= self.min_normal_n)) {
            return bad(
                format!("the normal force limits are {} to {:?} N", self.min_normal_n, self.max_normal_n),
                "give 0 <= floor <= ceiling",
            );
        }
        if self.torsion_m.is_some_and(|t| !(t >= 0.0 && t.is_finite())) {
            return bad(format!("the torsional friction is {:?} m", self.torsion_m), "give metres, such as 0.005");
        }
        if let Some(t) = &self.torques {
            let dof = t.limits_nm.len();
            if t.jacobians.len() != self.contacts.len() {
                return bad(
                    format!("{} Jacobians for {} contacts", t.jacobians.len(), self.contacts.len()),
                    "give one Jacobian per contact",
                );
            }
            if t.gravity_nm.len() != dof || t.jacobians.iter().any(|j| j.ncols() != dof) {
                return bad(
                    format!("Jacobians or gravity torques do not have {dof} joints"),
                    "give one column per joint",
                );
            }
            if let Some(joint) = t.limits_nm.iter().position(|(l, u)| !(l <= u)) {
                return bad(format!("joint {joint} has no interval of torques"), "give lower <= upper, N m");
            }
            let mut values = t.jacobians.iter().flat_map(|j| j.iter()).chain(t.gravity_nm.iter());
            if values.any(|v| !v.is_finite()) {
                return bad("a Jacobian or gravity torque is not finite".into(), "check the joint values");
            }
        }
        Ok(())
    }
}

impl TorqueLimits {
    /// Jacobians of the contacts, motor limits and the hand's own weight for the hand at `q` (model order, rad).
    ///
    /// `gravity` is in the object's frame, m/s². The limits are [`Robot::effort_ranges`]: a joint for which the model names none is
    /// unlimited.
    ///
    /// # Errors
    /// If `q` does not fit the robot.
    pub fn of_robot(
        robot: &Robot,
        q: &[f64],
        object_from_base: &Pose,
        contacts: &[Contact],
        gravity: &Vector3<f64>,
    ) -> Result<Self> {
        check_joints(robot, q)?;
        let poses = robot.forward_kinematics(q, object_from_base);
        let jacobians = contacts.iter().map(|c| robot.jacobian(&poses, c.link, &c.point).0).collect();
        let gravity_nm = robot.gravity_torque(q, &(object_from_base.rotation.inverse() * gravity));
        Ok(Self { jacobians, limits_nm: robot.effort_ranges(), gravity_nm })
    }
}
