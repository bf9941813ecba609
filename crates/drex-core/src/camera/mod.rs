//! Cameras with the lens models of COLMAP: points to pixels, pixels to rays.
//!
//! Camera axes are OpenCV's: x right, y down, z forward. Pixel coordinates have their origin at the outer corner of the
//! top-left pixel, so that the centre of that pixel is (0.5, 0.5) and scaling an image scales the coordinates.
//!
//! Every model is one of two maps from a direction to the plane, followed by one polynomial distortion
//! (see [`Camera::project`]), except FOV, whose radial map has a closed inverse.

mod lens;
mod model;
mod pinhole;

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point2, Point3, Vector2, Vector3};

use self::lens::Lens;
pub use self::model::CameraModel;
pub use self::pinhole::PinholeCamera;
use crate::{Error, Pose, Result};

/// A camera: image size and intrinsic parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    model: CameraModel,
    width_px: u32,
    height_px: u32,
    params: Vec<f64>,
    focal: Vector2<f64>,
    center: Vector2<f64>,
    lens: Lens,
}

impl Camera {
    /// A camera from COLMAP's parameters, in COLMAP's order (see [`CameraModel`]).
    ///
    /// # Errors
    /// If the number of parameters is wrong, one is not finite, a focal length is not positive, or the image is empty.
    pub fn new(model: CameraModel, width_px: u32, height_px: u32, params: &[f64]) -> Result<Self> {
        let refuse = |what: String, remedy: &str| Err(Error::value(format!("{} camera: {what}", model.name()), remedy));
        let names = model.parameter_names();
        if params.len() != names.len() {
            return refuse(
                format!("{} parameters instead of {}", params.len(), names.len()),
                &format!("give {}", names.join(", ")),
            );
        }
        if let Some(i) = params.iter().position(|p| !p.is_finite()) {
            return refuse(format!("{} is not finite", names[i]), "calibrate again");
        }
        if width_px == 0 || height_px == 0 {
            return refuse(format!("an image of {width_px} x {height_px} pixels"), "give the size of the images");
        }
        let two_focals = names[1] == "fy";
        let (focal, at) = if two_focals { ([params[0], params[1]], 2) } else { ([params[0]; 2], 1) };
        if !focal.iter().all(|f| *f > 0.0) {
            return refuse(format!("a focal length of {focal:?} pixels"), "give positive focal lengths");
        }
        let lens = Lens::new(model, &params[at + 2..]);
        let center = Vector2::new(params[at], params[at + 1]);
        Ok(Self { model, width_px, height_px, params: params.to_vec(), focal: focal.into(), center, lens })
    }

    /// A camera from COLMAP's numeric model id.
    ///
    /// # Errors
    /// If the id is unknown, and as [`Camera::new`].
    pub fn from_colmap_id(model_id: i32, width_px: u32, height_px: u32, params: &[f64]) -> Result<Self> {
        Self::new(CameraModel::from_id(model_id)?, width_px, height_px, params)
    }

    /// A camera from COLMAP's model name, such as `OPENCV`.
    ///
    /// # Errors
    /// If the name is unknown, and as [`Camera::new`].
    pub fn from_colmap_name(model_name: &str, width_px: u32, height_px: u32, params: &[f64]) -> Result<Self> {
        Self::new(model_name.parse()?, width_px, height_px, params)
    }

    /// The lens model.
    pub fn model(&self) -> CameraModel {
        self.model
    }

    /// Image width in pixels.
    pub fn width_px(&self) -> u32 {
        self.width_px
    }

    /// Image height in pixels.
    pub fn height_px(&self) -> u32 {
        self.height_px
    }

    /// Parameters in COLMAP's order.
    pub fn params(&self) -> &[f64] {
        &self.params
    }

    /// Focal lengths in pixels.
    pub fn focal_px(&self) -> Vector2<f64> {
        self.focal
    }

    /// Principal point in pixels.
    pub fn principal_point_px(&self) -> Vector2<f64> {
        self.center
    }

    /// The camera of the same pictures scaled to another size.
    ///
    /// # Errors
    /// If the new image is empty.
    pub fn resized(&self, width_px: u32, height_px: u32) -> Result<Self> {
        let s = [f64::from(width_px) / f64::from(self.width_px), f64::from(height_px) / f64::from(self.height_px)];
        let mut params = self.params.clone();
        if self.model.parameter_names()[1] == "fy" {
            for (p, k) in params.iter_mut().zip([s[0], s[1], s[0], s[1]]) {
                *p *= k;
            }
        } else {
            // One focal length cannot follow two scales; sizes rounded to whole pixels differ by less than a pixel.
            for (p, k) in params.iter_mut().zip([0.5 * (s[0] + s[1]), s[0], s[1]]) {
                *p *= k;
            }
        }
        Self::new(self.model, width_px, height_px, &params)
    }

    /// The pixel at which a point in camera coordinates (metres) appears, inside the image or not.
    ///
    /// With x' = x/z, y' = y/z for perspective models, or (x', y') = θ (x, y)/√(x² + y²) with the angle θ to the optical
    /// axis for fisheye models, and r² = x'² + y'²: u = f_x (x' ρ + 2 p₁ x'y' + p₂ (r² + 2 x'²) + s_x r²) + c_x, v likewise,
    /// ρ = (1 + k₁r² + k₂r⁴ + k₃r⁶ [+ k₄r⁸]) / (1 + …), as in COLMAP's `models.h`.
    ///
    /// `None` where the model gives no image: behind a perspective camera, at the camera's centre, or so far outside that
    /// the polynomial folds back, where points beyond the field of view would reappear inside the image.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        Some(self.project_with_jacobian(point)?.0)
    }

    /// As [`Camera::project`], with the derivative of the pixel by the point, pixels per metre.
    pub fn project_with_jacobian(&self, point: &Point3<f64>) -> Option<(Point2<f64>, Matrix2x3<f64>)> {
        let (plane, plane_by_point) = self.lens.to_plane(&point.coords)?;
        if !self.lens.covers(&plane) {
            return None;
        }
        let (bent, bent_by_plane) = self.lens.distort(&plane);
        let pixel = bent.component_mul(&self.focal) + self.center;
        let jacobian = Matrix2::from_diagonal(&self.focal) * bent_by_plane * plane_by_point;
        (pixel.iter().all(|v| v.is_finite())).then_some((pixel.into(), jacobian))
    }

    /// The unit direction, in camera coordinates, that a pixel looks along; the inverse of [`Camera::project`].
    ///
    /// `None` where the lens model has no inverse: its polynomial folds back there, as fitted models do far outside
    /// of the image.
    pub fn unproject(&self, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        let bent = (pixel.coords - self.center).component_div(&self.focal);
        let plane = self.lens.undistort(&bent).filter(|p| self.lens.covers(p))?;
        // Numbers at the end of the range may overflow on the way.
        self.lens.ray_of(&plane).filter(|ray| (ray.norm() - 1.0).abs() < 1e-6)
    }

    /// Whether a pixel coordinate lies in the image.
    pub fn contains(&self, pixel: &Point2<f64>) -> bool {
        (0.0..f64::from(self.width_px)).contains(&pixel.x) && (0.0..f64::from(self.height_px)).contains(&pixel.y)
    }
}

/// The point that the cameras look at: nearest to all optical axes (least squares), world frame. `None` if the axes are
/// parallel or there are fewer than two cameras (`world_from_camera`, z forward).
pub fn point_looked_at(cameras: &[Pose]) -> Option<Point3<f64>> {
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for camera in cameras {
        let d = camera.rotation * Vector3::z();
        let across = Matrix3::identity() - d * d.transpose();
        a += across;
        b += across * camera.translation.vector;
    }
    if cameras.len() < 2 || a.symmetric_eigenvalues().min() < 1e-4 * cameras.len() as f64 {
        return None;
    }
    a.try_inverse().map(|inverse| Point3::from(inverse * b))
}
