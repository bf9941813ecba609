//! The camera a scene is drawn from: a pinhole with any principal point. Lenses are undistorted before, once.

use nalgebra::{Point3, Vector3};

use crate::{Error, Pose, Result};

/// A pinhole camera at a pose. OpenCV axes: x right, y down, z forward; the centre of the first pixel is (0.5, 0.5).
#[derive(Debug, Clone, PartialEq)]
pub struct PinholeCamera {
    /// Maps world coordinates to camera coordinates; translation in the scene's unit of length.
    pub camera_from_world: Pose,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point, pixels from the image's left edge.
    pub cx: f64,
    /// Principal point, pixels from the image's upper edge.
    pub cy: f64,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
}

impl PinholeCamera {
    /// Largest width and height, pixels: positions in an image are kept in 16 bits of tiles and in single precision.
    pub const MAX_SIDE: usize = 1 << 15;

    /// # Errors
    /// If a number is not finite, a focal length is not positive, or the image is empty or larger than
    /// [`PinholeCamera::MAX_SIDE`].
    pub fn check(&self) -> Result<()> {
        let numbers = [self.fx, self.fy, self.cx, self.cy];
        let pose = self.camera_from_world.to_homogeneous();
        let sides = 1..=Self::MAX_SIDE;
        if numbers.iter().chain(pose.iter()).any(|v| !v.is_finite()) || !(self.fx > 0.0 && self.fy > 0.0) {
            return Err(Error::Value {
                what: format!(
                    "a camera has focal lengths {} and {}, principal point {}, {}, or a pose that is not finite",
                    self.fx, self.fy, self.cx, self.cy
                ),
                remedy: "give finite numbers and positive focal lengths in pixels".into(),
            });
        }
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            return Err(Error::Value {
                what: format!("a camera has an image of {} x {} pixels", self.width, self.height),
                remedy: format!("give sides from 1 to {}", Self::MAX_SIDE),
            });
        }
        Ok(())
    }

    /// Where the camera stands, world frame.
    pub fn centre(&self) -> Point3<f64> {
        self.camera_from_world.inverse().translation.vector.into()
    }

    /// The same view with images of another size; the principal point moves with the pixels.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self { fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy, width, height, ..self.clone() }
    }

    /// Pixel and depth (z in the camera frame) of a world point; `None` at or behind the camera's plane.
    pub fn project(&self, point_world: &Point3<f64>) -> Option<([f64; 2], f64)> {
        let p = self.camera_from_world * point_world;
        (p.z > 0.0).then(|| ([self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy], p.z))
    }

    /// Direction through a pixel coordinate in the camera frame, scaled to z = 1.
    pub fn ray(&self, pixel: [f64; 2]) -> Vector3<f64> {
        Vector3::new((pixel[0] - self.cx) / self.fx, (pixel[1] - self.cy) / self.fy, 1.0)
    }
}
