//! Photos, cameras and masks in: COLMAP models, transforms.json, RGB-D recordings.
//!
//! [`Capture`] says what was photographed from where; [`Photos`] reads the pictures, undistorted and at the size that is
//! asked for; [`CaptureReport`] says what to trust.
//!
//! A capture folder is laid out as
//! ```text
//! images/       photos, in subfolders if need be              (or photos/, input/, or beside the model)
//! masks/        same relative name, .png or .jpg, or COLMAP's NAME.jpg.png; white is the object; or the photo's own alpha
//! depths/       same relative name: 16-bit .png, or .npy of 32- or 64-bit numbers
//! normals/      same relative name: .png, rgb = (n + 1)/2 in the camera's frame
//! sparse/0/     COLMAP's model, binary or text                (or sparse/, colmap/sparse/0/, or the folder itself)
//! transforms.json                                             where there is no model
//! cam_K.txt, rgb/, depth/, ob_in_cam/                          or an RGB-D recording with poses of the object
//! ```

mod assemble;
mod colmap;
mod companions;
mod layout;
mod photos;
mod point_cloud;
mod report;
mod rgbd;
mod transforms;
mod undistort;
mod write_colmap;
mod write_transforms;

use std::path::{Path, PathBuf};

use nalgebra::Point3;

pub use self::companions::{PhotoFile, find_mask, photo_size, photos_in, photos_under, read_rgb};
pub use self::photos::{Photo, PhotoOptions, Photos};
pub use self::report::{CaptureReport, Coverage, MaskCheck, ReprojectionError, ViewReport};
use self::undistort::Undistortion;
use crate::camera::{Camera, PinholeCamera};
use crate::stats::upper_median;
use crate::{Error, Pose, Result};

/// Photos of a scene with their cameras, and the sparse points the cameras were found with.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    /// The folder it was read from.
    pub folder: PathBuf,
    /// One per photo that has a camera, sorted by name.
    pub views: Vec<View>,
    /// Triangulated points, none where the source has none; in the order of the file.
    pub points: Vec<SparsePoint>,
    /// Photos in the folder that no camera was found for, sorted.
    pub unregistered: Vec<String>,
    /// What was odd, in sentences.
    pub notes: Vec<String>,
}

/// A photo and the camera that took it.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Name in the model, with subfolders and extension.
    pub name: String,
    /// The photo's file.
    pub photo: PathBuf,
    /// A picture in which the object is white.
    pub mask: Option<PathBuf>,
    /// A depth map.
    pub depth: Option<PathBuf>,
    /// How far each depth is to be trusted: a grey picture, white for fully.
    pub confidence: Option<PathBuf>,
    /// A normal map.
    pub normal: Option<PathBuf>,
    /// The lens, for pixels of the photo's file as it is stored (an orientation tag turns nothing).
    pub lens: Camera,
    /// Maps world coordinates to camera coordinates, scene units.
    pub camera_from_world: Pose,
    /// Where features were found, in pixels of the photo's file; empty for transforms.json.
    pub keypoints: Vec<Keypoint>,
}

/// A feature in a photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Pixels from the left edge.
    pub x: f64,
    /// Pixels from the upper edge.
    pub y: f64,
    /// Index in [`Capture::points`] of the point seen there.
    pub point: Option<usize>,
}

/// A point that several photos see.
#[derive(Debug, Clone, PartialEq)]
pub struct SparsePoint {
    /// World frame, scene units.
    pub position: [f64; 3],
    /// Colour.
    pub rgb: [u8; 3],
    /// Mean reprojection error as the file states it, pixels; 0 where it states none.
    pub error_px: f64,
    /// Index of the view and of its keypoint, sorted.
    pub track: Vec<(usize, usize)>,
}

/// Where to look for what.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct CaptureOptions {
    /// Folder of the photos instead of the usual ones.
    pub images: Option<PathBuf>,
    /// Folder of the masks instead of `masks`.
    pub masks: Option<PathBuf>,
    /// Folder of the depth maps instead of `depths`.
    pub depths: Option<PathBuf>,
    /// Folder of the normal maps instead of `normals`.
    pub normals: Option<PathBuf>,
    /// Folder of the object's poses in the camera, for RGB-D recordings, instead of `annotated_poses`, `ob_in_cam` or
    /// `poses`.
    pub poses: Option<PathBuf>,
}

impl Capture {
    /// Reads the capture in `folder`: the biggest COLMAP model there, or else transforms.json, or else an RGB-D
    /// recording, whose world is the frame of the object.
    ///
    /// Only headers of photos are read. A camera of another size than its photo is scaled, with its keypoints, if the
    /// aspect agrees.
    ///
    /// # Errors
    /// If there is none of these, a file is damaged, no photo is found, or a photo or mask has
    /// another aspect than its camera.
    pub fn load(folder: &Path, options: &CaptureOptions) -> Result<Self> {
        layout::load(folder, options)
    }

    /// Reads the biggest of the COLMAP models in `models` and the folders in it, of photos of `folder`; `None` where there
    /// is no model.
    ///
    /// # Errors
    /// As [`Capture::load`].
    pub fn load_model(folder: &Path, models: &Path, options: &CaptureOptions) -> Result<Option<Self>> {
        let places = assemble::models_in(models);
        if places.is_empty() { Ok(None) } else { assemble::load_model(folder, &places, options).map(Some) }
    }

    /// Whether `folder` says where its photos were taken from, so that [`Capture::load`] has something to read.
    pub fn is_in(folder: &Path) -> bool {
        layout::has_cameras(folder)
    }

    /// The pinhole camera of a view: undistorted, and scaled so that no side is longer than `max_side` pixels. It is
    /// the camera of the [`Photo`] that [`Photos`] gives for the same `max_side`.
    ///
    /// The focal lengths and the direction of the optical axis are the lens's. The image is the largest rectangle round
    /// the optical axis, whole pixels, that the photo fills, so that no pixel is made up; a wide lens is cut at 60° to
    /// each side.
    ///
    /// # Errors
    /// If there is no such view, or the lens model cannot be inverted near its axis.
    pub fn pinhole(&self, view: usize, max_side: Option<usize>) -> Result<PinholeCamera> {
        let Some(view) = self.views.get(view) else {
            let what = format!("view {view} of a capture of {}", self.views.len());
            return Err(Error::value(what, "give the index of a view"));
        };
        Undistortion::new(view)?.camera(view.camera_from_world, max_side)
    }

    /// Leaves out the views of these names (outlier cameras, say) and their sightings; names of no view do nothing.
    pub fn drop_views(&mut self, names: &[&str]) {
        let mut kept = 0;
        let new_index: Vec<Option<usize>> = self
            .views
            .iter()
            .map(|v| {
                let keep = !names.contains(&v.name.as_str());
                kept += usize::from(keep);
                keep.then(|| kept - 1)
            })
            .collect();
        self.views.retain(|v| !names.contains(&v.name.as_str()));
        for point in &mut self.points {
            point.track = point.track.iter().filter_map(|(view, k)| Some(((*new_index.get(*view)?)?, *k))).collect();
        }
    }

    /// Where the cameras stand, world frame.
    pub fn centres(&self) -> Vec<Point3<f64>> {
        self.views.iter().map(|v| v.camera_from_world.inverse().translation.vector.into()).collect()
    }

    /// 1.1 times the largest distance of a camera from the mean of the cameras (3DGS), scene units; cameras that
    /// [`CaptureReport`] calls outliers by their place do not count. Where all cameras stand in one place, the median
    /// distance of the points to them, or 1.
    pub fn extent(&self) -> f64 {
        let centres = self.centres();
        let outlier = report::outliers_by_place(&centres);
        let kept: Vec<_> = centres.iter().zip(outlier).filter(|(_, far)| !far).map(|(c, _)| c.coords).collect();
        let mean = kept.iter().sum::<nalgebra::Vector3<f64>>() / kept.len().max(1) as f64;
        let radius = kept.iter().map(|c| (c - mean).norm()).fold(0.0, f64::max);
        if radius > 0.0 {
            return 1.1 * radius;
        }
        let distances = self.points.iter().map(|p| (nalgebra::Vector3::from(p.position) - mean).norm());
        upper_median(distances).filter(|d| *d > 0.0).unwrap_or(1.0)
    }

    /// What to trust of this capture; reads the masks.
    ///
    /// # Errors
    /// If a mask cannot be read.
    pub fn report(&self) -> Result<CaptureReport> {
        CaptureReport::new(self)
    }
}

/// Shorthand for an error about a capture.
fn refuse<T>(what: impl Into<String>, remedy: impl Into<String>) -> Result<T> {
    Err(Error::capture(what, remedy))
}
