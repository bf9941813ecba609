//! From forces at contacts to the current that each joint may take.

use drex_core::Pose;
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};

use super::TorqueCurrentModel;
use super::model::finite;
use crate::{Error, Result};

/// No hand gives such a torque, N m; beyond it arithmetic overflows.
const HUGE_NM: f64 = 1e9;

/// A force that a link is to exert on the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactForce {
    /// Index of the link.
    pub link: usize,
    /// Where, link frame, m.
    pub point: Point3<f64>,
    /// On the object, frame of the hand's base, N.
    pub force: Vector3<f64>,
}

/// How a demand is spread over the joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LimitMode {
    /// Each joint gets what its own torque needs.
    #[default]
    Jacobian,
    /// All joints get what the one that needs most gets: one number for the hand, as in the paper. Joints near the tip then press much
    /// harder than asked.
    Uniform,
}

/// What current limits are made with; currents in mA.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LimitOptions {
    /// How a demand is spread.
    pub mode: LimitMode,
    /// No limit is above this.
    pub cap_ma: f64,
    /// No limit is below this: joints without load hold their place with it.
    pub floor_ma: f64,
    /// Added for joints that press, for what friction keeps.
    pub friction_ma: f64,
}

impl Default for LimitOptions {
    /// Jacobian, 20 to 300 mA, no friction.
    fn default() -> Self {
        Self { mode: LimitMode::Jacobian, cap_ma: 300.0, floor_ma: 20.0, friction_ma: 0.0 }
    }
}

/// Torques of the joints, N m, that exert forces on an object: Jᵀ f at the joint angles `q`, rad, without the hand's own weight.
///
/// # Errors
/// [`Error::Value`] for angles, points or forces that are not finite, the wrong number of angles, or a link that is not there.
pub fn contact_torques(robot: &Robot, q: &[f64], contacts: &[ContactForce]) -> Result<Vec<f64>> {
    let poses = poses(robot, q)?;
    let mut torques = vec![0.0; robot.dof()];
    for c in contacts {
        c.force.iter().try_for_each(|f| finite(*f, "N at a contact"))?;
        let column = column(robot, &poses, c.link, &c.point, &c.force)?;
        torques.iter_mut().zip(column).for_each(|(t, x)| *t += x);
    }
    Ok(torques)
}

/// Limits, N m, under which the joints of a hand that is told torques give these torques, N m: their magnitudes, with a floor for
/// joints that only hold their place, and never above `caps_nm`.
///
/// # Errors
/// [`Error::Value`] for torques that are not finite, a floor or cap below zero, and lists of different lengths.
pub fn torque_limits_nm(torques_nm: &[f64], floor_nm: f64, caps_nm: &[f64]) -> Result<Vec<f64>> {
    same_length("torques", torques_nm.len(), "caps", caps_nm.len())?;
    torques_nm.iter().try_for_each(|t| finite(*t, "N m"))?;
    if let Some(bad) = caps_nm.iter().chain([&floor_nm]).find(|x| !(**x >= 0.0 && x.is_finite())) {
        return Err(Error::value(format!("a floor or cap of {bad} N m"), "give zero or more"));
    }
    Ok(torques_nm.iter().zip(caps_nm).map(|(t, cap)| t.abs().max(floor_nm).min(*cap)).collect())
}

impl LimitOptions {
    /// The same with this mode.
    pub fn with_mode(mut self, mode: LimitMode) -> Self {
        self.mode = mode;
        self
    }

    /// The same with limits from `floor_ma` to `cap_ma`.
    pub fn with_range_ma(mut self, floor_ma: f64, cap_ma: f64) -> Self {
        (self.floor_ma, self.cap_ma) = (floor_ma, cap_ma);
        self
    }

    /// The same with this current added for joints that press.
    pub fn with_friction_ma(mut self, friction_ma: f64) -> Self {
        self.friction_ma = friction_ma;
        self
    }

    /// Limits, mA, under which the joints give these torques, N m, with a model for each joint.
    ///
    /// A joint that would need more than the cap, or more than its model was calibrated for, gets that much and gives less torque than
    /// asked; see [`LimitOptions::short_nm`].
    ///
    /// # Errors
    /// [`Error::Value`] for options or torques that mean nothing and for another number of models than of torques.
    pub fn limits_ma(&self, models: &[TorqueCurrentModel], torques_nm: &[f64]) -> Result<Vec<f64>> {
        self.check()?;
        same_length("models", models.len(), "torques", torques_nm.len())?;
        let mut limits = Vec::with_capacity(models.len());
        for (model, tau) in models.iter().zip(torques_nm) {
            finite(*tau, "N m")?;
            let most = self.cap_ma.min(model.max_current_ma()).max(self.floor_ma);
            let needed = match tau.abs() {
                0.0 => 0.0,
                tau if tau > model.max_torque_nm() => most,
                tau => model.current_ma(tau)? + self.friction_ma,
            };
            limits.push(needed.clamp(self.floor_ma, most));
        }
        if self.mode == LimitMode::Uniform {
            let most = limits.iter().copied().fold(self.floor_ma, f64::max);
            limits.fill(most);
        }
        Ok(limits)
    }

    /// The paper's one number: the limit, mA, of all joints at a normalised force from 0 (the floor) to 1 (the cap).
    ///
    /// # Errors
    /// [`Error::Value`] for options or a number that mean nothing.
    pub fn uniform_ma(&self, share: f64) -> Result<f64> {
        self.check()?;
        if !(0.0..=1.0).contains(&share) {
            return Err(Error::value(format!("a normalised force of {share}"), "give 0 to 1"));
        }
        Ok(self.floor_ma + share * (self.cap_ma - self.floor_ma))
    }

    /// How much torque, N m, each joint lacks under these limits; zero where the demand is met.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that mean nothing and for lists of different lengths.
    pub fn short_nm(&self, models: &[TorqueCurrentModel], torques_nm: &[f64], limits_ma: &[f64]) -> Result<Vec<f64>> {
        self.check()?;
        same_length("models", models.len(), "torques", torques_nm.len())?;
        same_length("models", models.len(), "limits", limits_ma.len())?;
        let lack = |((model, tau), limit): ((&TorqueCurrentModel, &f64), &f64)| {
            finite(*tau, "N m")?;
            let given = pressing_nm(model, *limit, self.friction_ma)?;
            let short = tau.abs() - given;
            Ok(if short > 1e-9 * tau.abs() { short } else { 0.0 })
        };
        models.iter().zip(torques_nm).zip(limits_ma).map(lack).collect()
    }

    fn check(&self) -> Result<()> {
        let demands = [
            ("floor_ma", self.floor_ma, self.floor_ma >= 0.0),
            ("cap_ma", self.cap_ma, self.cap_ma > 0.0 && self.cap_ma >= self.floor_ma),
            ("friction_ma", self.friction_ma, self.friction_ma >= 0.0),
        ];
        match demands.into_iter().find(|(_, value, met)| !(*met && value.is_finite())) {
            Some((name, value, _)) => Err(Error::value(
                format!("limit option {name} is {value}"),
                "give finite numbers of at least 0, and a cap above the floor",
            )),
            None => Ok(()),
        }
    }
}

/// Torque, N m, that is left of a current, mA, after friction; beyond the end of a table that of its end.
pub(super) fn pressing_nm(model: &TorqueCurrentModel, current_ma: f64, friction_ma: f64) -> Result<f64> {
    finite(current_ma, "mA")?;
    let useful = (current_ma.abs() - friction_ma).clamp(0.0, model.max_current_ma());
    Ok(model.torque_nm(useful)?.copysign(current_ma))
}

/// Poses of the links in the frame of the base.
pub(super) fn poses(robot: &Robot, q: &[f64]) -> Result<Vec<Pose>> {
    same_length("joints of the model", robot.dof(), "angles", q.len())?;
    q.iter().try_for_each(|x| finite(*x, "rad"))?;
    Ok(robot.forward_kinematics(q, &Pose::identity()))
}

/// Joint torques of one force on the object.
pub(super) fn column(
    robot: &Robot,
    poses: &[Pose],
    link: usize,
    point: &Point3<f64>,
    force: &Vector3<f64>,
) -> Result<Vec<f64>> {
    point.iter().try_for_each(|x| finite(*x, "m at a contact"))?;
    let Some(pose) = poses.get(link) else {
        return Err(Error::value(
            format!("a contact at link {link} of {}", poses.len()),
            "give the index of one of the model's links",
        ));
    };
    let (linear, _) = robot.jacobian(poses, link, &(pose * point));
    let torques = linear.tr_mul(force).as_slice().to_vec();
    match torques.iter().all(|t| t.abs() < HUGE_NM) {
        true => Ok(torques),
        false => Err(Error::value(format!("a force of {} N at {point} m", force.norm()), "give newtons and metres")),
    }
}

pub(super) fn same_length(a: &str, n: usize, b: &str, m: usize) -> Result<()> {
    match n == m {
        true => Ok(()),
        false => Err(Error::value(format!("{n} {a} and {m} {b}"), "give one of each for every joint")),
    }
}
