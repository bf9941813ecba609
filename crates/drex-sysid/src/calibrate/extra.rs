//! Torque beyond friction, gravity and inertia: what touches the links.

use drex_core::Pose;
use drex_robot::{Finger, Robot};
use nalgebra::{Matrix3, Point3, Vector3};

use super::signals::{LEAST_SPEED, STEP, Signals};
use super::{HandCalibration, HandRun, JointCalibration};
use crate::Result;

/// Standard deviations that a touch must reach, and those below which it ends.
const SURE: f64 = 3.0;
const FAINT: f64 = 1.0;
/// A touch lasts at least this long, s.
const SHORTEST: f64 = 0.05;
/// Interruptions shorter than this do not end a touch, s.
const BLINK: f64 = 0.05;

/// Contact torques over time. Tables are `[joint of the robot][time]`; a joint that was not calibrated has NaN.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ExtraTorque {
    /// Seconds of the joint log's clock, a hundred per second.
    pub times_s: Vec<f64>,
    /// Joint positions, rad.
    pub positions: Vec<Vec<f64>>,
    /// Torque that the links take up from outside, N m: positive against positive motion.
    pub torque_nm: Vec<Vec<f64>>,
    /// Its standard deviation, N m, without the common scale error of [`ExtraTorque::scale_sd`]. At rest it is the width of the
    /// friction: a standing joint tells little.
    pub sd_nm: Vec<Vec<f64>>,
    /// Relative standard deviation of all torques of one joint together: load factor and masses of the links.
    pub scale_sd: Vec<f64>,
    /// Standard deviation of the part of the error that stays the same over a touch, N m.
    pub offset_sd_nm: Vec<f64>,
}

/// A finger that pushes.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Touch {
    /// Name of the finger.
    pub finger: String,
    /// First and last time, seconds of the joint log's clock.
    pub from_to_s: [f64; 2],
    /// The joint that shows it best.
    pub joint: String,
    /// Largest extra torque there, N m.
    pub peak_nm: f64,
    /// Standard deviations that this is.
    pub sigmas: f64,
}

/// The force at a fingertip, world frame.
#[derive(Debug, Clone, Copy)]
pub struct TipForce {
    /// On the object, newtons.
    pub force_n: Vector3<f64>,
    /// Covariance, N².
    pub covariance: Matrix3<f64>,
    /// Where, metres in the world.
    pub point: Point3<f64>,
}

impl HandCalibration {
    /// The extra torque in a run of the calibrated hand.
    ///
    /// # Errors
    /// If the log has no efforts or is of another hand.
    pub fn extra_torque(&self, run: &HandRun<'_>, robot: &Robot) -> Result<ExtraTorque> {
        self.check(robot)?;
        let s = Signals::of(run, robot)?;
        let n = s.times_s.len();
        let dof = robot.dof();
        let mut out = ExtraTorque {
            positions: (0..n).map(|k| s.joint_vector(robot, k)).collect(),
            torque_nm: vec![vec![f64::NAN; n]; dof],
            sd_nm: vec![vec![f64::INFINITY; n]; dof],
            scale_sd: vec![1.0; dof],
            offset_sd_nm: vec![f64::INFINITY; dof],
            times_s: Vec::new(),
        };
        for j in 0..dof {
            let Some(c) = self.joint(&robot.joints[j].name).filter(|_| s.effort[j].len() == n) else { continue };
            out.scale_sd[j] = (c.load_factor[1] / c.load_factor[0]).hypot(self.link_mass_sd);
            out.offset_sd_nm[j] = c.repeatability_nm / c.load_factor[0];
            for k in 0..n {
                let at = (s.effort[j][k], s.gravity[j][k], s.acceleration[j][k], s.velocity[j][k]);
                (out.torque_nm[j][k], out.sd_nm[j][k]) = c.torque(at);
            }
        }
        out.times_s = s.times_s;
        Ok(out)
    }
}

impl JointCalibration {
    /// Contact torque and its standard deviation from effort, gravity torque, acceleration and velocity.
    fn torque(&self, (e, g, a, v): (f64, f64, f64, f64)) -> (f64, f64) {
        let [factor, inertia] = [self.load_factor[0], self.inertia_kg_m2[0]];
        if v.abs() < LEAST_SPEED {
            // Friction may take any value up to what the joint was seen to hold.
            let width = self.holds_nm.max(self.coulomb_nm[0]);
            return ((e - inertia * a) / factor - g, width / factor);
        }
        let sign = v.signum();
        let x = (e - sign * self.coulomb_nm[0] - self.viscous_nms[0] * v - inertia * a) / factor - g;
        let known = self.spread(&[1.0, sign * g, sign * a, v.abs()]);
        let variance = self.repeatability_nm.powi(2) + known.powi(2) + (self.start_error * inertia * a).powi(2);
        (x, variance.sqrt() / factor)
    }
}

impl ExtraTorque {
    /// Which fingers of `robot` push, and when, in order of time.
    pub fn touches(&self, robot: &Robot) -> Vec<Touch> {
        let mut all = Vec::new();
        for finger in robot.fingers() {
            let mut best: Vec<Touch> = Vec::new();
            for &j in &finger.joints {
                best.extend(self.touches_of(&finger, j, robot));
            }
            // Joints of one finger feel the same touch.
            best.sort_by(|a, b| b.sigmas.total_cmp(&a.sigmas));
            let mut kept: Vec<Touch> = Vec::new();
            for t in best {
                let apart = |k: &Touch| k.from_to_s[1] < t.from_to_s[0] || t.from_to_s[1] < k.from_to_s[0];
                if kept.iter().all(apart) {
                    kept.push(t);
                }
            }
            all.extend(kept);
        }
        all.sort_by(|a, b| a.from_to_s[0].total_cmp(&b.from_to_s[0]));
        all
    }

    fn touches_of(&self, finger: &Finger, j: usize, robot: &Robot) -> Vec<Touch> {
        let n = self.times_s.len();
        // Contact resists motion; at rest the sign is open.
        let level = |k: usize| {
            let moving = k > 0 && (self.positions[k][j] - self.positions[k - 1][j]).abs() > LEAST_SPEED * STEP;
            let sign = if k > 0 { (self.positions[k][j] - self.positions[k - 1][j]).signum() } else { 0.0 };
            if moving && self.torque_nm[j][k].is_finite() {
                sign * self.torque_nm[j][k] / self.sd_nm[j][k]
            } else {
                0.0
            }
        };
        let levels: Vec<f64> = (0..n).map(level).collect();
        let mut out = Vec::new();
        let mut k = 0;
        while k < n {
            if levels[k] < SURE {
                k += 1;
                continue;
            }
            let blink = (BLINK / STEP) as usize;
            let mut from = k;
            while from > 0 && levels[from.saturating_sub(blink)..from].iter().any(|l| *l > FAINT) {
                from -= 1;
            }
            let mut to = k;
            while to + 1 < n && levels[to + 1..(to + 1 + blink).min(n)].iter().any(|l| *l > FAINT) {
                to += 1;
            }
            let peak = (from..=to).max_by(|&a, &b| levels[a].total_cmp(&levels[b])).unwrap_or(k);
            if self.times_s[to] - self.times_s[from] >= SHORTEST {
                out.push(Touch {
                    finger: finger.name.clone(),
                    from_to_s: [self.times_s[from], self.times_s[to]],
                    joint: robot.joints[j].name.clone(),
                    peak_nm: self.torque_nm[j][peak],
                    sigmas: levels[peak],
                });
            }
            k = to + 1;
        }
        out
    }

    /// The force of the tip of `finger` on the object at grid point `k`, from x = Jᵀ f over the joints of the finger (least
    /// squares, each joint weighed by its standard deviation). `normal` is the direction in which the tip pushes, if it is known:
    /// then forces across it count as friction, about `friction` times as large as along it. Without it all directions are alike,
    /// and a finger that moves one joint tells one component only, as the covariance shows.
    pub fn tip_force(
        &self,
        robot: &Robot,
        finger: &Finger,
        world_from_base: &Pose,
        k: usize,
        normal: Option<(Vector3<f64>, f64)>,
    ) -> Option<TipForce> {
        /// Forces of a hand that size, N.
        const USUAL: f64 = 10.0;
        let q = self.positions.get(k)?;
        let poses = robot.forward_kinematics(q, world_from_base);
        let point = poses[finger.tip_link] * finger.tip_point;
        let (linear, _) = robot.jacobian(&poses, finger.tip_link, &point);
        let mut information = match normal {
            None => Matrix3::identity() / USUAL.powi(2),
            Some((n, friction)) => {
                let along = n * n.transpose();
                (along + (Matrix3::identity() - along) / friction.max(1e-3).powi(2)) / USUAL.powi(2)
            }
        };
        let mut right = Vector3::zeros();
        for &j in &finger.joints {
            let (x, sd) = (self.torque_nm[j][k], self.sd_nm[j][k]);
            if x.is_finite() && sd.is_finite() && sd > 0.0 {
                let sd = sd.hypot(self.scale_sd[j] * x);
                let column = Vector3::from(linear.column(j));
                information += column * column.transpose() / (sd * sd);
                right += column * (x / (sd * sd));
            }
        }
        let covariance = information.try_inverse()?;
        Some(TipForce { force_n: covariance * right, covariance, point })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_torque_of_a_contact_is_what_friction_weight_and_inertia_leave_of_the_effort() {
        let c = JointCalibration {
            joint: "j".into(),
            alike: vec!["j".into()],
            coulomb_nm: [0.08, 0.0],
            load_factor: [1.6, 0.0],
            load_factor_seen: true,
            viscous_nms: [0.03, 0.0],
            inertia_kg_m2: [0.004, 0.0],
            armature_kg_m2: None,
            noise_nm: 0.01,
            repeatability_nm: 0.012,
            start_error: 0.5,
            holds_nm: 0.2,
            covariance: [[0.01_f64.powi(2), 0.0, 0.0, 0.0], [0.0; 4], [0.0; 4], [0.0; 4]],
            spans: Vec::new(),
        };
        for (contact, gravity, a, v) in [(-0.05, 0.03, 2.0, 0.9), (0.07, -0.02, -3.0, -1.4), (0.0, 0.04, 0.0, 0.5)] {
            let effort = 0.08 * f64::signum(v) + 0.03 * v + 0.004 * a + 1.6 * (gravity + contact);
            let (torque, sd) = c.torque((effort, gravity, a, v));
            assert!((torque - contact).abs() < 1e-12, "{torque} for {contact}");
            let expected = (0.012_f64.powi(2) + 0.01_f64.powi(2) + (0.5 * 0.004 * a).powi(2)).sqrt() / 1.6;
            assert!((sd - expected).abs() < 1e-12, "{sd} for {expected}");
            // At rest friction is anything up to what the joint holds.
            let (torque, sd) = c.torque((0.004 * a + 1.6 * (gravity + contact), gravity, a, 0.0));
            assert!((torque - contact).abs() < 1e-12 && (sd - 0.2 / 1.6).abs() < 1e-12, "{torque} {sd}");
        }
    }
}
