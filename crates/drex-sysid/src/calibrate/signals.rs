//! Joint logs as smooth signals on an even grid: position, velocity, acceleration, effort and the gravity torque of the
//! links, each from the same stretch of samples, so that relations between them survive the smoothing.

use drex_core::Pose;
use drex_recording::JointLog;
use drex_recording::{Drive, PushRecording};
use drex_robot::Robot;
use nalgebra::{Matrix3, Vector3};

use crate::{Result, SysidError};

/// Slower than this a joint counts as standing, rad/s.
pub(super) const LEAST_SPEED: f64 = 0.1;
/// Time between grid points, s.
pub(super) const STEP: f64 = 0.01;
/// Half the stretch of samples that a grid point is made from, s.
const HALF: f64 = 0.05;
/// More than this many times what its drive can do is another unit.
const MOST_LOAD: f64 = 10.0;
/// Samples that a grid point needs.
const LEAST: usize = 8;

/// One log of a hand, with what is known of how the hand stood.
#[derive(Debug, Clone, Copy)]
pub struct HandRun<'a> {
    /// Name for reports.
    pub name: &'a str,
    /// Positions and efforts over time.
    pub joints: &'a JointLog,
    /// Pose of the hand's base in the world; only its orientation against gravity is used.
    pub world_from_base: &'a Pose,
    /// Gravity in the world, m/s².
    pub gravity: Vector3<f64>,
}

/// A joint may read beyond its limits by this much: zero positions of encoders differ, rad.
const BEYOND: f64 = 0.2;

impl<'a> HandRun<'a> {
    /// The hand of a recorded push; `None` if none pushed.
    pub fn of(recording: &'a PushRecording) -> Option<Self> {
        let Drive::Hand(hand) = &recording.drive else { return None };
        Some(Self {
            name: &recording.name,
            joints: &hand.joints,
            world_from_base: &hand.world_from_base,
            gravity: recording.gravity,
        })
    }

    /// Whether efforts were logged; a column of zeros is none.
    pub(crate) fn has_efforts(&self) -> bool {
        self.joints.efforts.iter().flatten().any(|e| *e != 0.0)
    }

    /// Checks that the log can be of `robot`: its joints, within their limits.
    ///
    /// # Errors
    /// If it names a joint that the robot does not have, or one is where it cannot go.
    pub fn check(&self, robot: &Robot) -> Result<()> {
        let other = |what: String| SysidError::Calibration {
            what: format!("run `{}` is not of the hand `{}`: {what}", self.name, robot.name),
            remedy: "give the robot that the log was made with, and its joints in the order of the columns".into(),
        };
        for (column, name) in self.joints.names.iter().enumerate() {
            let j = robot.require_joint(name).map_err(|e| other(e.to_string()))?;
            let Some((lo, hi)) = robot.joints[j].limits else { continue };
            let values = self.joints.positions.iter().filter_map(|row| row.get(column).copied());
            let rows: Vec<(f64, f64)> = self.joints.times_s.iter().copied().zip(values).collect();
            // A joint that never moves may not have been read at all.
            if rows.iter().all(|r| (r.1 - rows[0].1).abs() < BEYOND) {
                continue;
            }
            if let Some((t, q)) = rows.iter().find(|r| !(lo - BEYOND..=hi + BEYOND).contains(&r.1)) {
                return Err(other(format!(
                    "`{name}` is at {q:.2} rad at {t:.3} s, beyond its limits {lo:.2} to {hi:.2}"
                )));
            }
        }
        Ok(())
    }
}

/// Smoothed signals, `[joint of the robot][grid point]`; a joint that the log does not have is empty.
#[derive(Debug, Clone)]
pub(super) struct Signals {
    pub times_s: Vec<f64>,
    pub position: Vec<Vec<f64>>,
    pub velocity: Vec<Vec<f64>>,
    pub acceleration: Vec<Vec<f64>>,
    pub effort: Vec<Vec<f64>>,
    /// Torque that holds the links against gravity, N m.
    pub gravity: Vec<Vec<f64>>,
}

impl Signals {
    /// Smooths a log of `robot`.
    ///
    /// # Errors
    /// If the log has no efforts, names a joint that the robot does not have, or is shorter than a tenth of a second.
    pub fn of(run: &HandRun<'_>, robot: &Robot) -> Result<Self> {
        let log = run.joints;
        let n = log.times_s.len();
        if log.efforts.len() != n || log.positions.len() != n {
            return Err(SysidError::Calibration {
                what: format!(
                    "run `{}` has {n} times, {} rows of positions and {} of efforts",
                    run.name,
                    log.positions.len(),
                    log.efforts.len()
                ),
                remedy: "log effort_* beside position_* for every sample".into(),
            });
        }
        run.check(robot)?;
        let columns = log.names.iter().map(|name| robot.require_joint(name)).collect::<Result<Vec<_>, _>>()?;
        let short = || SysidError::Calibration {
            what: format!("run `{}` is shorter than a tenth of a second", run.name),
            remedy: "give a longer joint log".into(),
        };
        let (first, last) = log.span_s().filter(|s| s.1 - s.0 > 2.0 * HALF).ok_or_else(short)?;
        let dof = robot.dof();
        let mut out = Self {
            times_s: Vec::new(),
            position: vec![Vec::new(); dof],
            velocity: vec![Vec::new(); dof],
            acceleration: vec![Vec::new(); dof],
            effort: vec![Vec::new(); dof],
            gravity: vec![Vec::new(); dof],
        };
        let down = run.world_from_base.rotation.inverse() * run.gravity;
        for k in 0..=((last - first - 2.0 * HALF) / STEP).floor() as usize {
            let t = first + HALF + k as f64 * STEP;
            let (a, b) =
                (log.times_s.partition_point(|&s| s < t - HALF), log.times_s.partition_point(|&s| s <= t + HALF));
            let Some(fit) = (b >= a + LEAST).then(|| Quadratic::new(t, &log.times_s[a..b])).flatten() else { continue };
            out.times_s.push(t);
            let mut q = robot.joints.iter().map(|j| j.reference).collect::<Vec<_>>();
            for (column, &j) in columns.iter().enumerate() {
                let [p, v, acc] = fit.of(log.positions[a..b].iter().map(|row| row[column]));
                q[j] = p;
                out.position[j].push(p);
                out.velocity[j].push(v);
                out.acceleration[j].push(acc);
                out.effort[j].push(fit.of(log.efforts[a..b].iter().map(|row| row[column]))[0]);
            }
            let gravity = robot.gravity_torque(&q, &down);
            for &j in &columns {
                out.gravity[j].push(gravity[j]);
            }
        }
        if out.times_s.len() < LEAST {
            return Err(short());
        }
        out.check(run.name, robot)?;
        Ok(out)
    }

    /// Checks that the efforts can have moved this robot: a drive does not exert many times what it can, and what it does beyond
    /// lifting the links goes into friction, never out of it.
    ///
    /// # Errors
    /// If they are of another unit or sign.
    pub fn check(&self, name: &str, robot: &Robot) -> Result<()> {
        let refuse = |what: String| SysidError::Calibration {
            what: format!("run `{name}`: {what}"),
            remedy: "give efforts in N m, positive where they push towards larger joint angles".into(),
        };
        for (joint, effort) in robot.joints.iter().zip(&self.effort) {
            let drive = robot.actuators.iter().find(|a| robot.joints[a.joint].name == joint.name);
            let limit = drive.and_then(|a| a.force_range).map(|r| r.1).or(joint.effort_limit);
            let most = effort.iter().map(|e| e.abs()).fold(0.0, f64::max);
            if let Some(limit) = limit.filter(|l| *l > 0.0 && most > MOST_LOAD * l) {
                return Err(refuse(format!(
                    "`{}` has an effort of {most:.3} N m, its drive can do {limit}",
                    joint.name
                )));
            }
        }
        let lost = |j: usize| -> f64 {
            let at = |k: usize| (self.effort[j][k] - self.gravity[j][k]) * self.velocity[j][k];
            (0..self.velocity[j].len()).filter(|&k| self.velocity[j][k].abs() > LEAST_SPEED).map(at).sum()
        };
        let work: f64 = (0..robot.dof()).map(lost).sum::<f64>() * STEP;
        let moves = self.velocity.iter().flatten().any(|v| v.abs() > LEAST_SPEED);
        if moves && work <= 0.0 {
            return Err(refuse(format!(
                "the efforts do {work:.2e} J on friction over the whole log, less than nothing: they did not move this hand"
            )));
        }
        Ok(())
    }

    /// Joint vector at grid point `k`, at the reference where the log has no such joint.
    pub fn joint_vector(&self, robot: &Robot, k: usize) -> Vec<f64> {
        let value =
            |(j, joint): (usize, &drex_robot::Joint)| self.position[j].get(k).copied().unwrap_or(joint.reference);
        robot.joints.iter().enumerate().map(value).collect()
    }
}

/// Least-squares parabola through samples about a time.
struct Quadratic {
    offsets: Vec<f64>,
    inverse: Matrix3<f64>,
}

impl Quadratic {
    fn new(t: f64, times_s: &[f64]) -> Option<Self> {
        let offsets: Vec<f64> = times_s.iter().map(|s| s - t).collect();
        let mut normal = Matrix3::zeros();
        for d in &offsets {
            let row = Vector3::new(1.0, *d, d * d);
            normal += row * row.transpose();
        }
        Some(Self { offsets, inverse: normal.try_inverse()? })
    }

    /// Value, first and second derivative at the middle.
    fn of(&self, values: impl Iterator<Item = f64>) -> [f64; 3] {
        let sum: Vector3<f64> = self.offsets.iter().zip(values).map(|(d, y)| Vector3::new(1.0, *d, d * d) * y).sum();
        let c = self.inverse * sum;
        [c[0], c[1], 2.0 * c[2]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_is_kept_whatever_the_sampling() {
        let times = [0.0, 0.003, 0.011, 0.013, 0.02, 0.031, 0.04];
        let fit = Quadratic::new(0.015, &times).unwrap();
        let y = |t: f64| 2.0 - 3.0 * t + 40.0 * t * t;
        let [p, v, a] = fit.of(times.iter().map(|t| y(*t)));
        assert!((p - y(0.015)).abs() < 1e-12 && (v - (-3.0 + 80.0 * 0.015)).abs() < 1e-9 && (a - 80.0).abs() < 1e-6);
    }
}
