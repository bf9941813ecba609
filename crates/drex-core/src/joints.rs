//! Logged joint values, keyed by joint name.

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
