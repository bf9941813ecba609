//! Rigid poses. A pose is named `a_from_b`: it maps coordinates in frame b to coordinates in frame a.

use std::path::Path;

use nalgebra::{
    Isometry3, Matrix3, Matrix4, Quaternion, Rotation3, Translation3, Unit, UnitQuaternion, Vector3, Vector6,
};

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// The scalar that generic mathematics in the workspace runs on: `f64` or a dual number over it.
pub trait Real: nalgebra::RealField + Copy {}
impl<T: nalgebra::RealField + Copy> Real for T {}

/// A rigid transform `a_from_b`, rotation as a unit quaternion, translation in metres.
pub type Pose<T = f64> = Isometry3<T>;

/// How far the norm of a quaternion, or R Rᵀ, may be from one before a pose is refused.
/// Files print four decimals at the least (1.5e-4 seen in real logs).
pub const UNIT_TOLERANCE: f64 = 1e-2;

/// Largest coordinate of a position on a tabletop, metres: larger numbers in a file are taken for millimetres and refused.
pub const MAX_POSITION_M: f64 = 20.0;

/// A pose from a translation in metres and a quaternion in the order w, x, y, z.
///
/// # Errors
/// If a number is not finite or the quaternion's norm is not 1 within [`UNIT_TOLERANCE`].
pub fn pose_from_wxyz(translation_m: [f64; 3], quat_wxyz: [f64; 4]) -> Result<Pose> {
    if translation_m.iter().chain(&quat_wxyz).any(|v| !v.is_finite()) {
        return Err(Error::value("the pose has a number that is not finite", "remove the row or repair the track"));
    }
    let [w, x, y, z] = quat_wxyz;
    let q = Quaternion::new(w, x, y, z);
    let norm = q.norm();
    if (norm - 1.0).abs() > UNIT_TOLERANCE {
        return Err(Error::value(
            format!("the quaternion ({w}, {x}, {y}, {z}) has norm {norm:.4}, not 1"),
            "give unit quaternions in the order w, x, y, z",
        ));
    }
    Ok(Isometry3::from_parts(Translation3::from(translation_m), UnitQuaternion::from_quaternion(q)))
}

/// A pose as files hold it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseRecord {
    /// Translation, metres.
    pub translation_m: [f64; 3],
    /// Unit quaternion in the order w, x, y, z.
    pub quat_wxyz: [f64; 4],
}

impl From<&Pose> for PoseRecord {
    fn from(pose: &Pose) -> Self {
        let (translation_m, quat_wxyz) = to_wxyz(pose);
        Self { translation_m, quat_wxyz }
    }
}

impl PoseRecord {
    /// The pose.
    ///
    /// # Errors
    /// As [`pose_from_wxyz`].
    pub fn to_pose(self) -> Result<Pose> {
        pose_from_wxyz(self.translation_m, self.quat_wxyz)
    }
}

/// How serde keeps a [`Pose`] as a [`PoseRecord`]: `#[serde(with = "drex_core::pose::record")]`.
pub mod record {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::{Pose, PoseRecord};

    /// Writes the pose as its record.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
        PoseRecord::from(pose).serialize(serializer)
    }

    /// Reads what [`serialize`] wrote.
    ///
    /// # Errors
    /// Those of the deserializer; if the record is no pose.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
        PoseRecord::deserialize(deserializer)?.to_pose().map_err(serde::de::Error::custom)
    }
}

/// A pose from a homogeneous 4 x 4 matrix; the rotation is replaced by the nearest proper one.
///
/// # Errors
/// If a number is not finite, the last row is not (0, 0, 0, 1), or the upper 3 x 3 block is not a
/// right-handed rotation within [`UNIT_TOLERANCE`].
pub fn pose_from_matrix(m: &Matrix4<f64>) -> Result<Pose> {
    if m.iter().any(|v| !v.is_finite()) {
        return Err(Error::value("the matrix has a number that is not finite", "remove the frame or repair the track"));
    }
    let last = [m[(3, 0)], m[(3, 1)], m[(3, 2)], m[(3, 3)] - 1.0];
    if last.iter().any(|v| v.abs() > 1e-6) {
        return Err(Error::value(
            "the last row of the 4 x 4 matrix is not 0 0 0 1",
            "give a_from_b with row-major rows",
        ));
    }
    let r: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
    let rotation = rotation_from_matrix(&r)?;
    Ok(Isometry3::from_parts(Translation3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]), rotation))
}

/// Refuses a position in `line` of `path` that cannot be in metres.
///
/// # Errors
/// If a coordinate is larger than [`MAX_POSITION_M`].
pub fn check_position(path: &Path, line: usize, position: &Vector3<f64>) -> Result<()> {
    if position.amax() > MAX_POSITION_M {
        return Err(Error::content(
            path,
            line,
            format!("a position of {:.3} m, farther than {MAX_POSITION_M} m from the origin", position.amax()),
            "positions are metres; if these are millimetres, divide them by 1000",
        ));
    }
    Ok(())
}

/// A pose from the text of a homogeneous 4 x 4 matrix, one row per line or all sixteen numbers in a row, with or without
/// brackets and commas. The text starts at `line` of `path`, which are for messages only.
///
/// # Errors
/// If there are not sixteen finite numbers, they are no rigid transform, or the position cannot be in metres.
pub fn parse_pose_matrix(path: &Path, line: usize, text: &str) -> Result<Pose> {
    let separators = |c: char| c.is_whitespace() || matches!(c, ',' | '[' | ']' | '(' | ')');
    let mut numbers = Vec::with_capacity(16);
    for (i, row) in text.lines().enumerate() {
        for token in row.split(separators).filter(|t| !t.is_empty()) {
            match token.parse::<f64>() {
                Ok(v) if v.is_finite() => numbers.push(v),
                _ => {
                    let what = format!("`{token}` is not a finite number");
                    return Err(Error::content(path, line + i, what, "remove the frame or repair the track"));
                }
            }
        }
    }
    if numbers.len() != 16 {
        let what = format!("{} numbers where a 4 x 4 matrix has 16", numbers.len());
        return Err(Error::content(path, line, what, "give one camera_from_object matrix, row by row"));
    }
    let pose = pose_from_matrix(&Matrix4::from_row_slice(&numbers)).map_err(|e| Error::at(path, line, e))?;
    check_position(path, line, &pose.translation.vector)?;
    Ok(pose)
}

/// The proper rotation nearest to `r` (polar decomposition by SVD).
///
/// # Errors
/// If `r` is not orthonormal within [`UNIT_TOLERANCE`] or is a reflection.
pub fn rotation_from_matrix(r: &Matrix3<f64>) -> Result<UnitQuaternion<f64>> {
    let defect = (r * r.transpose() - Matrix3::identity()).abs().max();
    if !(defect <= 2.0 * UNIT_TOLERANCE) {
        return Err(Error::value(
            format!("the 3 x 3 block is no rotation (R Rᵀ differs from 1 by {defect:.3})"),
            "check rows against columns and whether the matrix carries a scale",
        ));
    }
    if r.determinant() < 0.0 {
        return Err(Error::value(
            "the 3 x 3 block is a reflection (determinant -1)",
            "flip one axis: frames are right-handed",
        ));
    }
    let svd = r.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(Error::value("the 3 x 3 block has no singular value decomposition", "check the matrix"));
    };
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v_t)))
}

/// Position and w, x, y, z quaternion of a pose, as files carry them (w >= 0).
pub fn to_wxyz(pose: &Pose) -> ([f64; 3], [f64; 4]) {
    let q = pose.rotation.quaternion();
    let s = if q.w < 0.0 { -1.0 } else { 1.0 };
    (pose.translation.vector.into(), [s * q.w, s * q.i, s * q.j, s * q.k])
}

/// The shortest turn that makes the direction `up` vertical (+z); of straight down the half turn about x.
pub fn upright(up: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between_axis(up, &Vector3::z_axis())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

/// The difference `b ⊖ a` as (translation in the common frame, rotation vector of `a⁻¹ b` in frame of a), metres and radians.
/// The geodesic residual of a pose observation: sign-safe and scale-safe, never a difference of quaternion entries.
pub fn pose_difference(a: &Pose, b: &Pose) -> Vector6<f64> {
    let dt = b.translation.vector - a.translation.vector;
    let dr = (a.rotation.inverse() * b.rotation).scaled_axis();
    Vector6::new(dt.x, dt.y, dt.z, dr.x, dr.y, dr.z)
}

/// The pose a fraction `s` in [0, 1] of the way from `a` to `b`: linear in translation, slerp in rotation.
pub fn interpolate(a: &Pose, b: &Pose, s: f64) -> Pose {
    let t = a.translation.vector.lerp(&b.translation.vector, s);
    let delta: Vector3<f64> = (a.rotation.inverse() * b.rotation).scaled_axis();
    Isometry3::from_parts(t.into(), a.rotation * UnitQuaternion::from_scaled_axis(delta * s))
}
