//! Masks of the object, one per photo, from cameras, sparse points, the support plane and a box: no weights, no network.
//!
//! ```text
//! points ──► plane settled ──► picture of the plane ─┐
//!        └─► seeds ──────────────────────────────────┤
//! photos ──► colours in and around the box ──────────┴► evidence per pixel ──► vote of all photos per voxel
//!                    ▲                                                               │
//!                    └──────── masks ◄── cut per photo ◄── silhouette ◄── 3D cut ◄───┘      (a few rounds)
//!                                          └──► cut at full size along the border ──► masks
//! ```
//! - A ray that misses the box shows background.
//! - What lies on the plane, cast shadows included, looks the same from everywhere when it is put back onto the plane
//!   (`table`); this tells the object from a table of the same colours.
//! - Colours of object and background are learned from the masks so far (`colour`).
//! - What one photo says is weak; all photos together say for each voxel whether it is full (`hull`), after Campbell,
//!   Vogiatzis, Hernandez and Cipolla, "Automatic 3D object segmentation in multiple views using volumetric graph-cuts" (2010).
//!
//! The same input gives the same bytes with any number of threads.

mod backdrop;
mod bare;
mod colour;
mod cut;
mod hull;
mod maxflow;
mod points;
mod refine;
mod rounds;
mod table;
#[cfg(test)]
mod tests;
mod view;

use drex_core::Pose;
use drex_core::camera::Camera;
use nalgebra::Point3;
use rayon::prelude::*;

use self::rounds::Work;
use self::view::{Bounds, Eye, View, Window};

/// A photo, RGB, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Photo {
    /// Width in pixels.
    pub width_px: u32,
    /// Height in pixels.
    pub height_px: u32,
    /// Three bytes per pixel.
    pub rgb: Vec<u8>,
}

/// Where a photo was taken from.
#[derive(Debug, Clone)]
pub struct MaskView {
    /// What sentences call the photo.
    pub name: String,
    /// The lens.
    pub camera: Camera,
    /// Camera axes x right, y down, z forward.
    pub camera_from_world: Pose,
}

/// A sparse point of the scene.
#[derive(Debug, Clone)]
pub struct MaskPoint {
    /// World frame, the scene's unit.
    pub position: Point3<f64>,
    /// Colour.
    pub rgb: [u8; 3],
    /// The photos that saw it.
    pub photos: Vec<u32>,
}

/// The support plane and the box around what stands on it.
#[derive(Debug, Clone)]
pub struct MaskRegion {
    /// A frame with the plane at z = 0, z up, axes along the box.
    pub world_from_region: Pose,
    /// Lower corner of the box in this frame, the scene's unit.
    pub lower: Point3<f64>,
    /// Upper corner of the box in this frame.
    pub upper: Point3<f64>,
}

/// What masks are made from.
pub struct MaskInput<'a> {
    /// One per photo.
    pub views: &'a [MaskView],
    /// Any number; fewer make the start weaker.
    pub points: &'a [MaskPoint],
    /// Plane and box.
    pub region: &'a MaskRegion,
    /// Reads photo `i`, of the size that its camera says; called twice per photo, from several threads.
    pub load: &'a (dyn Fn(usize) -> std::result::Result<Photo, String> + Sync),
}

/// How masks are made.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MaskOptions {
    /// How often colours, vote and cut are repeated.
    pub rounds: usize,
    /// Voxels of the box, about.
    pub voxels: usize,
    /// The box is cut at about this many pixels on a side, before the border is refined at full size.
    pub working_px: f64,
}

impl Default for MaskOptions {
    fn default() -> Self {
        Self { rounds: 3, voxels: 300_000, working_px: 200.0 }
    }
}

/// The mask of a photo.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// Width of the photo in pixels.
    pub width_px: u32,
    /// Height of the photo in pixels.
    pub height_px: u32,
    /// 0 to 1: how well the photo and the shape that all photos voted for agree.
    pub confidence: f64,
    /// Share of the object's pixels that could as well be background or the other way round.
    pub undecided: f64,
    /// What is doubtful about it, in a sentence.
    pub doubt: Option<String>,
    window: Window,
    object: Vec<bool>,
}

impl Mask {
    /// One byte per pixel, row by row: 255 where the photo shows the object, else 0.
    pub fn pixels(&self) -> Vec<u8> {
        let (w, h) = (self.width_px as usize, self.height_px as usize);
        let mut all = vec![0; w * h];
        for (y, row) in self.object.chunks_exact(self.window.width().max(1)).enumerate() {
            let at = (y + self.window.y0) * w + self.window.x0;
            for (pixel, object) in all[at..at + row.len()].iter_mut().zip(row) {
                *pixel = if *object { 255 } else { 0 };
            }
        }
        all
    }

    /// The mask as a PNG file of 8-bit grey.
    ///
    /// # Errors
    /// If it cannot be encoded.
    pub fn to_png(&self) -> drex_core::Result<Vec<u8>> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        let colour = image::ExtendedColorType::L8;
        image::ImageEncoder::write_image(encoder, &self.pixels(), self.width_px, self.height_px, colour)
            .map_err(|e| drex_core::Error::value(format!("a mask cannot be encoded: {e}"), "report this"))?;
        Ok(bytes.into_inner())
    }

    /// Number of pixels that show the object.
    pub fn object_px(&self) -> usize {
        self.object.iter().filter(|o| **o).count()
    }

    fn empty(camera: &Camera, doubt: String) -> Self {
        Self {
            width_px: camera.width_px(),
            height_px: camera.height_px(),
            confidence: 0.0,
            undecided: 1.0,
            doubt: Some(doubt),
            window: Window { x0: 0, y0: 0, x1: 0, y1: 0 },
            object: Vec::new(),
        }
    }
}

/// Why no masks were made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MaskError {
    /// No photo.
    #[error("no photos to mask; give the photos of the reconstruction")]
    NoPhotos,
    /// The box has no volume above the plane, or a number is not finite.
    #[error(
        "the box from {lower:?} to {upper:?} (frame of the plane, z up) has no volume above the plane; give a box around the object"
    )]
    Box {
        /// Lower corner.
        lower: [f64; 3],
        /// Upper corner.
        upper: [f64; 3],
    },
    /// A photo could not be read.
    #[error("photo {name} cannot be read: {reason}")]
    Photo {
        /// Name of the photo.
        name: String,
        /// Why.
        reason: String,
    },
    /// A photo is not of its camera's size.
    #[error(
        "photo {name} has {width_px} x {height_px} pixels ({bytes} bytes), its camera {camera_width_px} x {camera_height_px}; \
         give the photos that the cameras were computed from"
    )]
    Size {
        /// Name of the photo.
        name: String,
        /// Width of the photo.
        width_px: u32,
        /// Height of the photo.
        height_px: u32,
        /// Length of its data.
        bytes: usize,
        /// Width that the camera says.
        camera_width_px: u32,
        /// Height that the camera says.
        camera_height_px: u32,
    },
}

/// The object's mask in each photo, in their order.
///
/// `progress` hears the share done, 0 to 1, and what is being done.
///
/// # Errors
/// If there is no photo, the box is empty, or a photo cannot be read or is not of its camera's size.
pub fn make_masks(
    input: &MaskInput<'_>,
    options: &MaskOptions,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Vec<Mask>, MaskError> {
    if input.views.is_empty() {
        return Err(MaskError::NoPhotos);
    }
    let (world_from_region, bounds) = frame(input)?;
    progress(0.0, "read photos");
    let views = read_views(input, &world_from_region, &bounds, options)?;
    let mut state = Work::new(input, views, &world_from_region, bounds, options);
    for round in 0..options.rounds.max(1) {
        progress(0.1 + 0.7 * round as f64 / options.rounds.max(1) as f64, "cut");
        state.round(round);
    }
    progress(0.8, "refine borders");
    refine::finish(input, &state)
}

/// The settled frame and the box on its plane.
fn frame(input: &MaskInput<'_>) -> Result<(Pose, Bounds), MaskError> {
    let region = input.region;
    let refuse = || MaskError::Box { lower: region.lower.coords.into(), upper: region.upper.coords.into() };
    let pose = region.world_from_region;
    let finite =
        region.lower.iter().chain(region.upper.iter()).chain(pose.to_homogeneous().iter()).all(|v| v.is_finite());
    let mut lower = region.lower;
    lower.z = 0.0;
    let size = region.upper - lower;
    if !finite || !size.iter().all(|s| *s > 0.0) || !(size.min() > 1e-4 * size.max()) {
        return Err(refuse());
    }
    Ok((points::settle(region, input.points), Bounds { lower, upper: region.upper }))
}

fn load(input: &MaskInput<'_>, photo: usize) -> Result<Photo, MaskError> {
    let view = &input.views[photo];
    let loaded = (input.load)(photo).map_err(|reason| MaskError::Photo { name: view.name.clone(), reason })?;
    let (width, height) = (view.camera.width_px(), view.camera.height_px());
    if (loaded.width_px, loaded.height_px) != (width, height)
        || loaded.rgb.len() != 3 * width as usize * height as usize
    {
        return Err(MaskError::Size {
            name: view.name.clone(),
            width_px: loaded.width_px,
            height_px: loaded.height_px,
            bytes: loaded.rgb.len(),
            camera_width_px: width,
            camera_height_px: height,
        });
    }
    Ok(loaded)
}

/// The photos that see the box, at working size.
fn read_views(
    input: &MaskInput<'_>,
    world_from_region: &Pose,
    bounds: &Bounds,
    options: &MaskOptions,
) -> Result<Vec<View>, MaskError> {
    const MOST_PX: f64 = 1e6;
    let views: Result<Vec<Option<View>>, MaskError> = (0..input.views.len())
        .into_par_iter()
        .map(|photo| {
            let view = &input.views[photo];
            let eye = Eye::new(&view.camera, &(view.camera_from_world * world_from_region));
            let Some(window) = eye.window(bounds) else { return Ok(None) };
            let side = (window.len() as f64).sqrt();
            let [w, h] = eye.size_px();
            let whole = (w as f64 * h as f64 / MOST_PX).sqrt().ceil();
            let shrink = (side / options.working_px.max(16.0)).round().max(whole).max(1.0) as usize;
            Ok(View::new(photo, eye, &load(input, photo)?, shrink.min(w.min(h)), bounds))
        })
        .collect();
    Ok(views?.into_iter().flatten().collect())
}
