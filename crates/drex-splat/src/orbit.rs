//! Cameras on a circle round something.

use drex_core::Pose;
use drex_core::camera::PinholeCamera;
use drex_core::stats::{quantile, upper_median};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::{Error, Gaussians, Result};

/// A circle of cameras that look at its centre.
#[derive(Debug, Clone, PartialEq)]
pub struct Orbit {
    /// What is looked at, world frame.
    pub centre: Point3<f64>,
    /// Axis of the circle; up in the pictures.
    pub up: Vector3<f64>,
    /// Distance of the cameras from the centre, scene units.
    pub radius: f64,
    /// Angle of the cameras above the plane through the centre, radians.
    pub elevation: f64,
    /// Angle of view from the left edge to the right one, radians.
    pub field_of_view: f64,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
}

impl Orbit {
    /// An orbit from which the visible part of `gaussians` fills the picture: round the median of the centres that are
    /// at least half opaque (of all, if none is), at a distance that shows nine in ten of them whole.
    ///
    /// # Errors
    /// If there are no Gaussians, or an option is out of range.
    pub fn round(
        gaussians: &Gaussians,
        up: Vector3<f64>,
        elevation: f64,
        field_of_view: f64,
        width: usize,
        height: usize,
    ) -> Result<Self> {
        let all: Vec<usize> = (0..gaussians.len()).collect();
        let solid: Vec<usize> = all.iter().copied().filter(|&i| gaussians.logit_opacities[i] >= 0.0).collect();
        let seen = if solid.is_empty() { all } else { solid };
        let axis = |k: usize| upper_median(seen.iter().map(|&i| f64::from(gaussians.means[i][k])));
        let (Some(x), Some(y), Some(z)) = (axis(0), axis(1), axis(2)) else {
            return Err(Error::Gaussians {
                what: "there are no Gaussians to look at".into(),
                remedy: "give a set that is not empty, or a centre and a radius".into(),
            });
        };
        let centre = Point3::new(x, y, z);
        let distance = |i: &usize| (Point3::from(gaussians.means[*i].map(f64::from)) - centre).norm();
        let extent = quantile(seen.iter().map(distance), 0.9).unwrap_or(0.0);
        let narrow = (0.5 * field_of_view).tan() * (height as f64 / width as f64).min(1.0);
        // A ball of radius e is seen whole from e / sin(half the angle of view); a single point from anywhere.
        let radius = if extent > 0.0 { 1.1 * extent / narrow.atan().sin() } else { 1.0 };
        let orbit = Self { centre, up, radius, elevation, field_of_view, width, height };
        orbit.camera(0.0).map(|_| orbit)
    }

    /// `n` cameras at even angles, anticlockwise seen from above.
    ///
    /// # Errors
    /// If a number of the orbit is out of range.
    pub fn cameras(&self, n: usize) -> Result<Vec<PinholeCamera>> {
        (0..n).map(|k| self.camera(std::f64::consts::TAU * k as f64 / n as f64)).collect()
    }

    /// The camera at an angle round the axis, radians.
    ///
    /// # Errors
    /// If a number of the orbit is out of range.
    pub fn camera(&self, azimuth: f64) -> Result<PinholeCamera> {
        let Self { centre, up, radius, elevation, field_of_view, width, height } = *self;
        let refuse = |what: String, remedy: &str| Err(Error::Option { what, remedy: remedy.into() });
        if !(radius > 0.0 && radius.is_finite()) {
            return refuse(format!("an orbit of radius {radius}"), "give a positive number in the scene's unit");
        }
        if !(elevation.abs() < 1.57) {
            return refuse(format!("an orbit {elevation} rad above the plane"), "stay within 89 degrees");
        }
        if !(field_of_view > 0.0 && field_of_view < 3.1) {
            return refuse(
                format!("an angle of view of {field_of_view} rad"),
                "give more than 0 and less than 3.1 (177 degrees)",
            );
        }
        if !(up.norm() > 1e-12 && up.norm().is_finite()) {
            return refuse(format!("an orbit round the axis ({}, {}, {})", up.x, up.y, up.z), "give a direction");
        }
        let up = up.normalize();
        let side = sideways(&up);
        let front = up.cross(&side);
        let flat = side * azimuth.cos() + front * azimuth.sin();
        let eye = centre + (flat * elevation.cos() + up * elevation.sin()) * radius;
        let f = 0.5 * width as f64 / (0.5 * field_of_view).tan();
        let camera = PinholeCamera {
            camera_from_world: look_at(&eye, &centre, &up)?,
            fx: f,
            fy: f,
            cx: 0.5 * width as f64,
            cy: 0.5 * height as f64,
            width,
            height,
        };
        camera.check()?;
        Ok(camera)
    }
}

/// The pose `camera_from_world` of a camera at `eye` that looks at `target`, with `up` (world frame) upwards in the
/// picture.
///
/// # Errors
/// If the points coincide, are not finite, or the camera would look along `up`.
pub fn look_at(eye: &Point3<f64>, target: &Point3<f64>, up: &Vector3<f64>) -> Result<Pose> {
    // OpenCV axes: x right, y down, z forward.
    let z = (target - eye).normalize();
    let x = z.cross(up);
    if !(x.norm() > 1e-9 * up.norm()) {
        return Err(Error::Option {
            what: "a camera stands on what it looks at, or looks along the direction that is up".into(),
            remedy: "move it, or choose another direction as up".into(),
        });
    }
    let x = x.normalize();
    let y = z.cross(&x);
    let camera_from_world =
        Rotation3::from_matrix_unchecked(Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]));
    let rotation = UnitQuaternion::from_rotation_matrix(&camera_from_world);
    Ok(Isometry3::from_parts((-(rotation * eye.coords)).into(), rotation))
}

/// A unit vector across `up`: the x axis, unless that is nearly parallel.
fn sideways(up: &Vector3<f64>) -> Vector3<f64> {
    let x = if up.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    (x - up * up.dot(&x)).normalize()
}
