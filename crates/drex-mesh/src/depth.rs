//! Depth maps: what a camera measured of a surface, and casting them from a mesh.

use std::borrow::Cow;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use drex_core::{Pose, TriMesh};

use crate::bvh::Bvh;
use crate::{Error, Result};

/// Pinhole camera without distortion; the ray of column u, row v (from 0) goes through (u + 0.5, v + 0.5).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthCamera {
    /// Columns of the image.
    pub width_px: u32,
    /// Rows of the image.
    pub height_px: u32,
    /// Focal length along a row, pixels.
    pub fx_px: f64,
    /// Focal length along a column, pixels.
    pub fy_px: f64,
    /// Column of the principal point, pixels.
    pub cx_px: f64,
    /// Row of the principal point, pixels.
    pub cy_px: f64,
}

/// One depth image with its camera.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap {
    /// The camera.
    pub camera: DepthCamera,
    /// Where it stands: OpenCV axes (x right, y down, z forward).
    pub world_from_camera: Pose,
    /// Row-major, z along the optical axis, metres; zero, negative or not finite: nothing measured.
    pub depth_m: Vec<f32>,
    /// The object's silhouette, row-major: on rays outside it there is nothing of the object.
    pub mask: Option<Vec<bool>>,
    /// How far each depth is to be trusted beside others, row-major, from 0: its weight is the square of it, and so much it counts against what is
    /// nearer. `None`: 1 for all of them.
    pub trust: Option<Vec<f32>>,
}

/// Views one at a time, so that hundreds of maps need not be in memory.
pub trait DepthViews: Sync {
    /// Number of views.
    fn len(&self) -> usize;

    /// Whether there is none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// View `i`, from 0. Fusion asks for each view twice.
    ///
    /// # Errors
    /// If it cannot be read or made.
    fn view(&self, i: usize) -> Result<DepthMap>;

    /// View `i` without a copy, where the maps are in memory.
    ///
    /// # Errors
    /// As [`DepthViews::view`].
    fn borrow_view(&self, i: usize) -> Result<Cow<'_, DepthMap>> {
        self.view(i).map(Cow::Owned)
    }
}

impl DepthViews for [DepthMap] {
    fn len(&self) -> usize {
        <[DepthMap]>::len(self)
    }

    fn view(&self, i: usize) -> Result<DepthMap> {
        self.borrow_view(i).map(Cow::into_owned)
    }

    fn borrow_view(&self, i: usize) -> Result<Cow<'_, DepthMap>> {
        self.get(i).map(Cow::Borrowed).ok_or_else(|| {
            Error::value(format!("view {i} of {} was asked for", self.len()), "views are numbered from 0")
        })
    }
}

impl DepthViews for Vec<DepthMap> {
    fn len(&self) -> usize {
        self.as_slice().len()
    }

    fn view(&self, i: usize) -> Result<DepthMap> {
        self.as_slice().view(i)
    }

    fn borrow_view(&self, i: usize) -> Result<Cow<'_, DepthMap>> {
        self.as_slice().borrow_view(i)
    }
}

impl DepthCamera {
    /// Pixels of the image.
    pub fn pixels(&self) -> usize {
        self.width_px as usize * self.height_px as usize
    }

    /// Direction of the ray of a pixel in the camera's axes, with z = 1.
    pub fn ray(&self, column: u32, row: u32) -> Vector3<f64> {
        let x = (f64::from(column) + 0.5 - self.cx_px) / self.fx_px;
        let y = (f64::from(row) + 0.5 - self.cy_px) / self.fy_px;
        Vector3::new(x, y, 1.0)
    }
}

impl DepthMap {
    /// Whether camera, pose and arrays are such that the map can be used.
    ///
    /// # Errors
    /// An array of the wrong length, a focal length that is not positive, a number that is not finite.
    pub fn check(&self) -> Result<()> {
        let c = &self.camera;
        let pixels = c.pixels();
        if pixels == 0 {
            return Err(Error::value(
                format!("the image is {} x {} pixels", c.width_px, c.height_px),
                "give the size of the depth image",
            ));
        }
        let lengths = [
            ("depth_m", Some(self.depth_m.len())),
            ("mask", self.mask.as_ref().map(Vec::len)),
            ("trust", self.trust.as_ref().map(Vec::len)),
        ];
        for (name, length) in lengths {
            if length.is_some_and(|n| n != pixels) {
                return Err(Error::value(
                    format!(
                        "{name} has {} entries for an image of {} x {} pixels",
                        length.unwrap_or(0),
                        c.width_px,
                        c.height_px
                    ),
                    "give one entry per pixel, row by row",
                ));
            }
        }
        if self.trust.iter().flatten().any(|t| !(*t >= 0.0 && t.is_finite())) {
            return Err(Error::value(
                "a trust is negative or not finite",
                "give 1 for what counts as usual, 0 for nothing",
            ));
        }
        if !(c.fx_px > 0.0 && c.fy_px > 0.0 && [c.fx_px, c.fy_px, c.cx_px, c.cy_px].iter().all(|x| x.is_finite())) {
            return Err(Error::value(
                format!(
                    "the camera has focal lengths {}, {} and principal point {}, {}",
                    c.fx_px, c.fy_px, c.cx_px, c.cy_px
                ),
                "give positive focal lengths in pixels and a finite principal point",
            ));
        }
        let pose = &self.world_from_camera;
        let finite = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite());
        if !finite || (pose.rotation.norm() - 1.0).abs() > 1e-6 {
            return Err(Error::value(
                "world_from_camera is not a rigid pose of finite numbers",
                "leave out views that have no pose",
            ));
        }
        Ok(())
    }
}

/// Depth of `mesh` seen by a camera: exact, without noise; 0 where nothing is hit, no mask. For tests, examples and checks.
pub fn cast_depth(mesh: &TriMesh, camera: &DepthCamera, world_from_camera: &Pose) -> DepthMap {
    let seen = mesh.transformed(&world_from_camera.inverse());
    let tree = Bvh::new(&seen);
    let (columns, rows) = silhouette_box(&seen, camera);
    let mut depth_m = vec![0.0_f32; camera.pixels()];
    depth_m.par_chunks_mut(camera.width_px.max(1) as usize).enumerate().for_each(|(row, out)| {
        if rows.contains(&(row as u32)) {
            for column in columns.clone() {
                // With z = 1 in the direction, the parameter of the ray is the depth.
                if let Some((_, z)) = tree.ray(&Point3::origin(), &camera.ray(column, row as u32), f64::INFINITY) {
                    out[column as usize] = z as f32;
                }
            }
        }
    });
    DepthMap { camera: *camera, world_from_camera: *world_from_camera, depth_m, mask: None, trust: None }
}

/// Columns and rows outside which nothing of the mesh (camera axes) can be seen.
fn silhouette_box(seen: &TriMesh, camera: &DepthCamera) -> (std::ops::Range<u32>, std::ops::Range<u32>) {
    let whole = (0..camera.width_px, 0..camera.height_px);
    if seen.vertices.iter().any(|p| p.z <= 0.0) {
        return whole;
    }
    let range = |f: f64, c: f64, axis: usize, size: u32| {
        let at = seen.vertices.iter().map(|p| f * p[axis] / p.z + c);
        let (lo, hi) = at.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), x| (lo.min(x), hi.max(x)));
        // A float outside the range of the integer becomes its nearest value, infinity included.
        ((lo - 1.0).floor() as u32).min(size)..((hi + 1.0).ceil() as u32).min(size)
    };
    (range(camera.fx_px, camera.cx_px, 0, camera.width_px), range(camera.fy_px, camera.cy_px, 1, camera.height_px))
}
