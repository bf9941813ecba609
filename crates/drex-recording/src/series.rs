//! Recorded series: joint values keyed by joint name, forces, points and fingertip motion over time.

use nalgebra::{Point3, Vector3};

use drex_core::{Error, Result};

/// Time series of named joints; row i of each table belongs to `times_s[i]`, column j to `names[j]`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointLog {
    /// Joint names.
    pub names: Vec<String>,
    /// Seconds.
    pub times_s: Vec<f64>,
    /// Positions, rad (m for slides).
    pub positions: Vec<Vec<f64>>,
    /// Velocities, rad/s; empty if not logged.
    pub velocities: Vec<Vec<f64>>,
    /// Efforts, N m; empty if not logged.
    pub efforts: Vec<Vec<f64>>,
}

/// A set of grasps or hand poses: joint angles keyed by joint name.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointPoses {
    /// Joint names, one per column.
    pub names: Vec<String>,
    /// One row per pose, rad.
    pub rows: Vec<Vec<f64>>,
}

/// A force or wrench over time, held constant from each sample to the next (zero-order hold), zero outside.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceProfile {
    /// Sample times, seconds, increasing.
    pub times_s: Vec<f64>,
    /// Force in the world frame, newtons, per sample.
    pub forces_n: Vec<Vector3<f64>>,
    /// Torque about the point where the force acts, world frame, N m, per sample; empty for a force without one.
    pub torques_nm: Vec<Vector3<f64>>,
    /// Where it acts, in the object's mesh frame, metres.
    pub point_in_object: Point3<f64>,
}

/// Points over time, held from each sample to the next.
#[derive(Debug, Clone, PartialEq)]
pub struct PointSeries {
    /// Seconds, increasing.
    pub times_s: Vec<f64>,
    /// Metres, one per time.
    pub points: Vec<Point3<f64>>,
}

/// Measured fingertip motion.
#[derive(Debug, Clone, PartialEq)]
pub struct EncoderTrack {
    /// Seconds.
    pub times_s: Vec<f64>,
    /// Tip positions in the world, metres.
    pub positions: Vec<Point3<f64>>,
    /// Tip velocities in the world, m/s.
    pub velocities: Vec<Vector3<f64>>,
}

impl JointLog {
    /// First and last time; `None` when empty.
    pub fn span_s(&self) -> Option<(f64, f64)> {
        Some((*self.times_s.first()?, *self.times_s.last()?))
    }

    /// Positions at time `t_s`, one per joint, linear between samples; `None` outside the recorded span.
    pub fn positions_at(&self, t_s: f64) -> Option<Vec<f64>> {
        let (first, last) = self.span_s()?;
        if !(first <= t_s && t_s <= last) {
            return None;
        }
        let after = self.times_s.partition_point(|&t| t <= t_s).min(self.times_s.len() - 1);
        let before = after.saturating_sub(1);
        let (t0, t1) = (self.times_s[before], self.times_s[after]);
        let s = if t1 > t0 { (t_s - t0) / (t1 - t0) } else { 0.0 };
        let (a, b) = (self.positions.get(before)?, self.positions.get(after)?);
        Some(a.iter().zip(b).map(|(a, b)| a + (b - a) * s).collect())
    }
}

impl JointPoses {
    /// Number of poses.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are no poses.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The same poses with the joints `names`, in that order; other joints are left out.
    ///
    /// # Errors
    /// If a joint is not in the set; the message names it and those present.
    pub fn select<S: AsRef<str>>(&self, names: &[S]) -> Result<Self> {
        let columns = names
            .iter()
            .map(|name| {
                self.names.iter().position(|n| n == name.as_ref()).ok_or_else(|| {
                    Error::value(
                        format!("the poses have no joint {}; they have {}", name.as_ref(), self.names.join(", ")),
                        "give poses of this hand, or the right joint order",
                    )
                })
            })
            .collect::<Result<Vec<usize>>>()?;
        let pick = |row: &Vec<f64>| columns.iter().map(|&c| row.get(c).copied().unwrap_or(f64::NAN)).collect();
        Ok(Self {
            names: names.iter().map(|n| n.as_ref().to_owned()).collect(),
            rows: self.rows.iter().map(pick).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_are_found_by_name_and_time() {
        let poses = JointPoses { names: vec!["a".into(), "b".into()], rows: vec![vec![1.0, 2.0]] };
        assert_eq!(poses.select(&["b"]).unwrap().rows, [[2.0]]);
        assert!(poses.select(&["c"]).unwrap_err().to_string().contains("no joint c; they have a, b"));
        let log = JointLog {
            names: vec!["a".into()],
            times_s: vec![1.0, 2.0, 4.0],
            positions: vec![vec![0.0], vec![1.0], vec![5.0]],
            ..JointLog::default()
        };
        assert_eq!(log.positions_at(1.5), Some(vec![0.5]));
        assert_eq!(log.positions_at(3.0), Some(vec![3.0]));
        assert_eq!(log.positions_at(4.0), Some(vec![5.0]));
        assert_eq!((log.positions_at(0.9), log.positions_at(f64::NAN)), (None, None));
        assert_eq!(JointLog::default().positions_at(0.0), None);
    }
}
