//! Scale, turn and shift.

use nalgebra::{Matrix3, Matrix4, Point3, Rotation3, UnitQuaternion, Vector3};

use drex_core::{Pose, TriMesh};

use crate::scale::plane::TablePlane;
use crate::{Error, Result};

/// A similarity a_from_b: x ↦ scale · R x + translation. Never mirrors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity {
    /// Units of a per unit of b.
    pub scale: f64,
    /// Rotation.
    pub rotation: UnitQuaternion<f64>,
    /// Translation, in units of a.
    pub translation: Vector3<f64>,
}

impl Similarity {
    /// A similarity from a homogeneous 4 x 4 matrix.
    ///
    /// # Errors
    /// If a number is not finite, the last row is not (0, 0, 0, 1), the axes are sheared or scaled differently (by more
    /// than 1e-3), or the matrix mirrors (determinant below zero): frames are right-handed.
    pub fn from_matrix(m: &Matrix4<f64>) -> Result<Self> {
        let refuse = |what: String, remedy: &str| Err(Error::value(what, remedy));
        if m.iter().any(|v| !v.is_finite()) {
            return refuse("the matrix has a number that is not finite".into(), "estimate it again");
        }
        if (m.row(3) - nalgebra::RowVector4::new(0.0, 0.0, 0.0, 1.0)).abs().max() > 1e-9 {
            return refuse("the last row of the matrix is not 0 0 0 1".into(), "give a_from_b with row-major rows");
        }
        let a: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
        let determinant = a.determinant();
        let scale = determinant.abs().cbrt();
        if !(scale > 0.0) {
            return refuse("the matrix has no scale: its determinant is 0".into(), "give three independent axes");
        }
        let shear = ((a.transpose() * a) / (scale * scale) - Matrix3::identity()).abs().max();
        if !(shear <= 1e-3) {
            return refuse(
                format!("the matrix is no similarity: it shears or scales its axes differently by {shear:.4}"),
                "scale all axes alike",
            );
        }
        if determinant < 0.0 {
            return refuse(
                "the matrix mirrors: its determinant is negative, so it turns a right hand into a left one".into(),
                "flip one axis: frames are right-handed",
            );
        }
        let rotation = drex_core::pose::rotation_from_matrix(&(a / scale))?;
        Ok(Self { scale, rotation, translation: m.fixed_view::<3, 1>(0, 3).into_owned() })
    }

    /// The homogeneous 4 x 4 matrix.
    pub fn to_matrix(&self) -> Matrix4<f64> {
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&(self.rotation.to_rotation_matrix().matrix() * self.scale));
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        m
    }

    /// The map of a point.
    pub fn point(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords * self.scale + self.translation)
    }

    /// The map of a pose of something in b (a camera, say): a turn and a place in a.
    pub fn pose(&self, b_from_c: &Pose) -> Pose {
        let place = self.point(&b_from_c.translation.vector.into());
        Pose::from_parts(place.coords.into(), self.rotation * b_from_c.rotation)
    }

    /// The map of a mesh.
    pub fn mesh(&self, mesh: &TriMesh) -> TriMesh {
        TriMesh { vertices: mesh.vertices.iter().map(|v| self.point(v)).collect(), faces: mesh.faces.clone() }
    }

    /// a_from_c = a_from_b · b_from_c, for `self` = a_from_b.
    pub fn after(&self, b_from_c: &Self) -> Self {
        Self {
            scale: self.scale * b_from_c.scale,
            rotation: self.rotation * b_from_c.rotation,
            translation: self.point(&b_from_c.translation.into()).coords,
        }
    }

    /// b_from_a.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { scale: 1.0 / self.scale, rotation, translation: rotation * self.translation / -self.scale }
    }

    /// The metric frame of a table: z up, the origin at the foot of `origin` on the table, x along the part of `towards`
    /// that lies in the table; all arguments in model units. Gives metric_from_model.
    ///
    /// # Errors
    /// If the scale is not positive or `towards` points straight up.
    pub fn of_table(
        metres_per_unit: f64,
        table: &TablePlane,
        origin: &Point3<f64>,
        towards: &Vector3<f64>,
    ) -> Result<Self> {
        if !(metres_per_unit > 0.0 && metres_per_unit.is_finite()) {
            return Err(Error::value(format!("the scale is {metres_per_unit} m per unit"), "give a positive number"));
        }
        let up = table.up.into_inner();
        let x = (towards - up * up.dot(towards))
            .try_normalize(1e-9 * towards.norm())
            .ok_or_else(|| Error::value("the direction of x is vertical", "give a direction along the table"))?;
        let axes = Matrix3::from_rows(&[x.transpose(), up.cross(&x).transpose(), up.transpose()]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let foot = origin - up * up.dot(&(origin - table.point));
        Ok(Self { scale: metres_per_unit, rotation, translation: rotation * foot.coords * -metres_per_unit })
    }

    /// The similarity a_from_b that brings points of b onto points of a with the least squares (Umeyama 1991), never a
    /// mirrored one, and the root mean square distance that remains, in units of a.
    ///
    /// # Errors
    /// If there are fewer than three pairs, the points lie on a line, one is not finite, or points that fill space agree
    /// better with a mirror image.
    pub fn between(b: &[Point3<f64>], a: &[Point3<f64>]) -> Result<(Self, f64)> {
        let n = a.len();
        if n < 3 || b.len() != n {
            return Err(Error::value(
                format!("{} and {n} points give no frame", b.len()),
                "give at least three pairs of points",
            ));
        }
        if a.iter().chain(b).any(|p| p.iter().any(|c| !c.is_finite())) {
            return Err(Error::value("a point is not finite", "leave it out"));
        }
        let mean = |p: &[Point3<f64>]| p.iter().map(|q| q.coords).sum::<Vector3<f64>>() / n as f64;
        let (ma, mb) = (mean(a), mean(b));
        let pairs = || a.iter().zip(b).map(|(p, q)| (p.coords - ma, q.coords - mb));
        let sigma = pairs().map(|(p, q)| p * q.transpose()).sum::<Matrix3<f64>>() / n as f64;
        let variance = pairs().map(|(_, q)| q.norm_squared()).sum::<f64>() / n as f64;
        let svd = sigma.svd(true, true);
        let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
            return Err(Error::value("the points have no singular value decomposition", "check their coordinates"));
        };
        let d = svd.singular_values;
        if !(d[1] > 1e-9 * d[0]) || !(variance > 0.0) {
            return Err(Error::value("the points lie on a line", "add one beside it"));
        }
        let sign = (u.determinant() * v_t.determinant()).signum();
        // Points in a plane have no third singular value but noise: then the sign says nothing.
        if sign < 0.0 && d[2] > 1e-2 * d[1] {
            return Err(Error::value(
                "the points fit their mirror image better",
                "check that both sets have right-handed axes and the right names",
            ));
        }
        let flip = Vector3::new(1.0, 1.0, sign);
        let r = u * Matrix3::from_diagonal(&flip) * v_t;
        let scale = d.dot(&flip) / variance;
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r));
        let out = Self { scale, rotation, translation: ma - rotation * mb * scale };
        let rms = (a.iter().zip(b).map(|(p, q)| (out.point(q) - p).norm_squared()).sum::<f64>() / n as f64).sqrt();
        Ok((out, rms))
    }
}
