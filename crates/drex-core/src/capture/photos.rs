//! The pictures of a capture: read when asked for, straightened, scaled, and kept as far as memory allows.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard};

use super::assemble::same_aspect;
use super::companions;
use super::undistort::{Plane, Undistortion};
use super::{Capture, View, refuse};
use crate::Result;
use crate::camera::PinholeCamera;

/// How photos are read.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PhotoOptions {
    /// Longest side of the pictures, pixels; larger photos are scaled down, smaller ones stay.
    pub max_side: Option<usize>,
    /// Bytes of pictures that are kept; the one read last is always kept.
    pub memory_bytes: usize,
    /// Scene units of one step of a 16-bit depth map; the default takes millimetres to metres.
    pub depth_scale: f64,
    /// Which axes of normal maps are turned. Maps have x right, y down, z forward (a wall in front has z = -1); for maps
    /// with y up and z towards the viewer (OpenGL) turn the second and the third.
    pub flip_normals: [bool; 3],
}

impl Default for PhotoOptions {
    fn default() -> Self {
        Self { max_side: None, memory_bytes: 2 << 30, depth_scale: 1e-3, flip_normals: [false; 3] }
    }
}

/// One picture as a pinhole camera sees it. All arrays are [height, width], row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Photo {
    /// The camera; equal to [`Photos::camera`] and [`Capture::pinhole`].
    pub camera: PinholeCamera,
    /// Colours as stored in the file, not made linear.
    pub rgb: Vec<[u8; 3]>,
    /// 0 background to 255 object, from the mask's file or the photo's alpha channel.
    pub mask: Option<Vec<u8>>,
    /// z in the camera frame, scene units; 0 where unknown.
    pub depth: Option<Vec<f32>>,
    /// How far each depth is to be trusted, 0 to 255 fully.
    pub confidence: Option<Vec<u8>>,
    /// Unit normal in the camera frame (x right, y down, z forward); zero where unknown.
    pub normal: Option<Vec<[f32; 3]>>,
}

/// The pictures of a capture, read on demand; may be used by several threads at once. What [`Photos::get`] gives does
/// not depend on what was kept.
#[derive(Debug)]
pub struct Photos {
    options: PhotoOptions,
    sources: Vec<Source>,
    shelf: Mutex<Shelf>,
}

#[derive(Debug)]
struct Source {
    view: View,
    undistortion: Undistortion,
    camera: PinholeCamera,
}

/// Pictures that are kept, the one used longest ago first.
#[derive(Debug, Default)]
struct Shelf {
    kept: Vec<(usize, Arc<Photo>)>,
    kept_bytes: usize,
    /// Bytes of pictures being read now.
    reading_bytes: usize,
    peak_bytes: usize,
}

impl Photos {
    /// Prepares the cameras of all views; no picture is read yet.
    ///
    /// # Errors
    /// If `max_side` is 0, `depth_scale` is not positive, or a lens cannot be straightened.
    pub fn new(capture: &Capture, options: PhotoOptions) -> Result<Self> {
        if !(options.depth_scale.is_finite() && options.depth_scale > 0.0) {
            return refuse(format!("a depth scale of {}", options.depth_scale), "give a positive number");
        }
        let source = |view: &View| {
            let undistortion = Undistortion::new(view)?;
            let camera = undistortion.camera(view.camera_from_world, options.max_side)?;
            let view = View { keypoints: Vec::new(), ..view.clone() };
            Ok(Source { view, undistortion, camera })
        };
        let sources = capture.views.iter().map(source).collect::<Result<_>>()?;
        Ok(Self { options, sources, shelf: Mutex::default() })
    }

    /// Number of views.
    pub fn len(&self) -> usize {
        self.sources.len()
    }

    /// Name of a view as its capture has it; empty if there is no such view.
    pub fn name(&self, view: usize) -> &str {
        self.sources.get(view).map_or("", |source| &source.view.name)
    }

    /// Whether there is no view.
    pub fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }

    /// The camera of a view's picture.
    ///
    /// # Panics
    /// Never for `view` below [`Photos::len`].
    pub fn camera(&self, view: usize) -> &PinholeCamera {
        &self.sources[view].camera
    }

    /// The picture of a view.
    ///
    /// # Errors
    /// If there is no such view, or one of its files cannot be read or has changed its size.
    pub fn get(&self, view: usize) -> Result<Arc<Photo>> {
        let Some(source) = self.sources.get(view) else {
            return refuse(format!("view {view} of {} photos", self.len()), "give the index of a view");
        };
        if let Some(photo) = self.shelf().take_out(view) {
            return Ok(photo);
        }
        let reading = source.bytes_to_read();
        self.shelf().start_reading(reading);
        let photo = source.read(&self.options).map(Arc::new);
        let mut shelf = self.shelf();
        shelf.reading_bytes -= reading;
        let photo = photo?;
        shelf.put_in(view, &photo, self.options.memory_bytes);
        Ok(photo)
    }

    /// The most bytes of pictures that were held at one time, kept and being read. Pictures that a caller still holds
    /// after they were dropped here are the caller's.
    pub fn peak_bytes(&self) -> usize {
        self.shelf().peak_bytes
    }

    fn shelf(&self) -> MutexGuard<'_, Shelf> {
        // A thread that panicked elsewhere left the shelf whole: every change is done before anything can fail.
        self.shelf.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Shelf {
    /// The picture of a view, which becomes the one used last.
    fn take_out(&mut self, view: usize) -> Option<Arc<Photo>> {
        let at = self.kept.iter().position(|(v, _)| *v == view)?;
        let entry = self.kept.remove(at);
        let photo = entry.1.clone();
        self.kept.push(entry);
        Some(photo)
    }

    fn start_reading(&mut self, bytes: usize) {
        self.reading_bytes += bytes;
        self.peak_bytes = self.peak_bytes.max(self.kept_bytes + self.reading_bytes);
    }

    fn put_in(&mut self, view: usize, photo: &Arc<Photo>, memory_bytes: usize) {
        if self.take_out(view).is_some() {
            return; // another thread read it meanwhile
        }
        self.kept_bytes += photo.bytes();
        self.kept.push((view, photo.clone()));
        while self.kept_bytes > memory_bytes && self.kept.len() > 1 {
            let (_, dropped) = self.kept.remove(0);
            self.kept_bytes -= dropped.bytes();
        }
        self.peak_bytes = self.peak_bytes.max(self.kept_bytes + self.reading_bytes);
    }
}

impl Photo {
    fn bytes(&self) -> usize {
        self.rgb.len() * 3
            + self.mask.as_ref().map_or(0, Vec::len)
            + self.depth.as_ref().map_or(0, |d| d.len() * 4)
            + self.confidence.as_ref().map_or(0, Vec::len)
            + self.normal.as_ref().map_or(0, |n| n.len() * 12)
    }
}

impl Source {
    /// About what reading takes: each file decoded, and again in the form it is used in, and the picture.
    fn bytes_to_read(&self) -> usize {
        let lens = &self.view.lens;
        let decoded = lens.width_px() as usize * lens.height_px() as usize;
        let kept = self.camera.width * self.camera.height;
        let mask = usize::from(self.view.mask.is_some());
        let depth = usize::from(self.view.depth.is_some());
        let confidence = usize::from(self.view.confidence.is_some());
        let normal = usize::from(self.view.normal.is_some());
        (6 + 2 * mask + 6 * depth + 2 * confidence + 18 * normal) * decoded
            + (3 + mask + 4 * depth + confidence + 12 * normal) * kept
    }

    fn read(&self, options: &PhotoOptions) -> Result<Photo> {
        let Self { view, undistortion, camera } = self;
        let (width, height) = (camera.width, camera.height);
        let warp = undistortion.warp();
        let (rgb, alpha) = colours(view)?;
        let (w, h) = (view.lens.width_px() as usize, view.lens.height_px() as usize);
        let rgb = warp.area(&Plane { width: w, height: h, values: &rgb }, width, height);
        let mask = match &view.mask {
            Some(path) => Some(companions::mask(path)?),
            None => alpha.map(|alpha| (w, h, alpha)),
        };
        let mask = mask.map(|(w, h, values)| {
            let values = values.as_chunks().0;
            warp.area::<1>(&Plane { width: w, height: h, values }, width, height).into_iter().flatten().collect()
        });
        let mut photo = Photo { camera: camera.clone(), rgb, mask, depth: None, confidence: None, normal: None };
        if let Some(path) = &view.depth {
            let (w, h, values) = companions::depth(path, options.depth_scale)?;
            photo.depth = Some(warp.nearest(&of_same_aspect(path, view, w, h, &values)?, width, height));
        }
        if let Some(path) = &view.confidence {
            let (w, h, values) = companions::mask(path)?;
            photo.confidence = Some(warp.nearest(&of_same_aspect(path, view, w, h, &values)?, width, height));
        }
        if let Some(path) = &view.normal {
            let (w, h, values) = companions::normal(path, options.flip_normals)?;
            photo.normal = Some(warp.nearest(&of_same_aspect(path, view, w, h, &values)?, width, height));
        }
        Ok(photo)
    }
}

/// A map, if it has the aspect of its photo.
fn of_same_aspect<'a, T>(
    path: &Path,
    view: &View,
    width: usize,
    height: usize,
    values: &'a [T],
) -> Result<Plane<'a, T>> {
    let (w, h) = (view.lens.width_px(), view.lens.height_px());
    if same_aspect([f64::from(w), f64::from(h)], [width as f64, height as f64]) {
        return Ok(Plane { width, height, values });
    }
    refuse(
        format!("{} has {width} x {height} pixels, its photo {w} x {h}", path.display()),
        "give a map of the photo's aspect",
    )
}

/// Colours of a photo and its alpha channel, if it has one.
type Colours = (Vec<[u8; 3]>, Option<Vec<u8>>);

fn colours(view: &View) -> Result<Colours> {
    let picture = companions::picture(&view.photo)?;
    if (picture.width(), picture.height()) != (view.lens.width_px(), view.lens.height_px()) {
        return refuse(format!("{} has changed its size", view.photo.display()), "load the capture again");
    }
    if !picture.color().has_alpha() {
        return Ok((picture.into_rgb8().into_raw().as_chunks().0.to_vec(), None));
    }
    let picture = picture.into_rgba8();
    let rgb = picture.pixels().map(|p| [p.0[0], p.0[1], p.0[2]]).collect();
    Ok((rgb, Some(picture.pixels().map(|p| p.0[3]).collect())))
}
