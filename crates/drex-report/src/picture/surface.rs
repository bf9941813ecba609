//! Surfaces of files with the pictures on them, and photos of them as a camera of no distortion would have taken them.

use std::path::Path;

use drex_core::camera::{Camera, PinholeCamera};
use drex_core::{Pose, TriMesh};
use drex_mesh::read_model;
use image::{Rgb, RgbImage};
use nalgebra::Point3;

use super::raster::{Part, Texture};
use crate::{Error, Result};

/// Samples of a photo in each pixel of a smaller picture, per axis.
const SAMPLES: u32 = 2;

/// A mesh with a picture on it, or without.
#[derive(Clone)]
pub struct Surface {
    /// The mesh in the frame of its file. Corners that differ in texture coordinate are separate vertices.
    pub mesh: TriMesh,
    /// Texture coordinate of each vertex, and the picture.
    pub(crate) texture: Option<(Vec<[f32; 2]>, RgbImage)>,
}

impl Surface {
    /// All surfaces of a mesh file.
    ///
    /// # Errors
    /// If the file or a picture that it names cannot be read.
    pub fn read(file: &Path) -> Result<Vec<Self>> {
        let model = read_model(file)?;
        let materials = model.materials;
        let surface = |part: drex_mesh::ModelPart| {
            let picture = part.material.and_then(|k| materials.get(k)?.texture.as_ref());
            let texture = match (part.uv, picture) {
                (Some(uv), Some(picture)) => Some((uv, decoded(&picture.bytes, file)?)),
                _ => None,
            };
            Ok(Self { mesh: part.mesh, texture })
        };
        model.parts.into_iter().map(surface).collect()
    }

    /// The surface somewhere, in this colour if it has no picture.
    pub fn part(&self, world_from_mesh: Pose, color: [f64; 3]) -> Part<'_> {
        let texture = self.texture.as_ref().map(|(uv, picture)| Texture { uv, picture });
        Part { mesh: &self.mesh, world_from_mesh, color, texture }
    }
}

fn decoded(bytes: &[u8], file: &Path) -> Result<RgbImage> {
    let refuse = |e| {
        Error::Refused(format!(
            "{}: the picture on it cannot be read: {e}; export it as PNG or JPEG, or take map_Kd out of its material",
            file.display()
        ))
    };
    Ok(image::load_from_memory(bytes).map_err(refuse)?.to_rgb8())
}

/// A camera at the place of a photo's that shows these points (frame of the scan) in the middle of a picture of `width` x `height` pixels; `None` if
/// one of them is behind the camera or outside of the photo. Also how many pixels of the photo go into the picture's width.
pub(crate) fn close_up(
    points: &[Point3<f64>],
    lens: &Camera,
    camera_from_world: &Pose,
    [width, height]: [usize; 2],
) -> Option<(PinholeCamera, f64)> {
    /// Share of the picture that the points span.
    const FILLED: f64 = 0.84;
    let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in points {
        let p = camera_from_world * p;
        if p.z <= 0.0 || !lens.contains(&lens.project(&p)?) {
            return None;
        }
        for (k, at) in [p.x / p.z, p.y / p.z].into_iter().enumerate() {
            (lo[k], hi[k]) = (lo[k].min(at), hi[k].max(at));
        }
    }
    let size = [width as f64, height as f64];
    let focal = (0..2).map(|k| FILLED * size[k] / (hi[k] - lo[k])).fold(f64::INFINITY, f64::min);
    let centre = |k: usize| 0.5 * size[k] - focal * 0.5 * (lo[k] + hi[k]);
    let camera_from_world = *camera_from_world;
    let camera = PinholeCamera { camera_from_world, fx: focal, fy: focal, cx: centre(0), cy: centre(1), width, height };
    (focal.is_finite() && !points.is_empty()).then(|| (camera, size[0] * lens.focal_px().x / focal))
}

/// What a camera would have seen that stood at the place of a photo's, in the photo's colours; black beside the photo.
pub(crate) fn resampled(photo: &RgbImage, lens: &Camera, camera: &PinholeCamera) -> RgbImage {
    let at = |x: f64, y: f64| {
        let ray = Point3::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0);
        let p = lens.project(&ray).filter(|p| lens.contains(p));
        let size = [lens.width_px(), lens.height_px()].map(f64::from);
        p.map_or([0.0; 3], |p| super::raster::sampled(photo, [p.x / size[0], p.y / size[1]]))
    };
    RgbImage::from_fn(camera.width as u32, camera.height as u32, |x, y| {
        let mut sum = [0.0; 3];
        for k in 0..SAMPLES * SAMPLES {
            let sub = |n: u32| (f64::from(n) + 0.5) / f64::from(SAMPLES);
            let c = at(f64::from(x) + sub(k % SAMPLES), f64::from(y) + sub(k / SAMPLES));
            (0..3).for_each(|i| sum[i] += c[i]);
        }
        Rgb(sum.map(|s| (255.0 * s / f64::from(SAMPLES * SAMPLES)).round() as u8))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::camera::CameraModel;

    #[test]
    fn a_close_up_holds_its_points_and_shows_the_photo_there_without_its_distortion() {
        let lens =
            Camera::new(CameraModel::OpenCv, 320, 240, &[260.0, 260.0, 158.0, 122.0, -0.1, 0.01, 0.0, 0.0]).unwrap();
        let place = Pose::translation(0.02, -0.01, 1.0);
        let points = [[-0.3, -0.2, 0.0], [0.1, 0.15, 0.1], [0.0, 0.1, -0.1]].map(Point3::from);
        // A photo whose colour is where it was taken: red by column, green by row.
        let photo = RgbImage::from_fn(320, 240, |x, y| Rgb([(x / 2) as u8, y as u8, 0]));
        let (camera, _) = close_up(&points, &lens, &place, [200, 160]).unwrap();
        let shown = resampled(&photo, &lens, &camera);
        for p in &points {
            let ([x, y], _) = camera.project(p).unwrap();
            assert!((10.0..190.0).contains(&x) && (10.0..150.0).contains(&y), "{x} {y}");
            let color = shown.get_pixel(x as u32, y as u32).0.map(f64::from);
            let expected = lens.project(&(place * p)).unwrap();
            assert!(
                (color[0] - expected.x / 2.0).abs() < 2.0 && (color[1] - expected.y).abs() < 3.0,
                "{color:?} {expected}"
            );
        }
        let outside = [Point3::new(2.0, 0.0, 0.0)];
        assert!(close_up(&outside, &lens, &place, [200, 160]).is_none());
        assert!(close_up(&[Point3::new(0.0, 0.0, -2.0)], &lens, &place, [200, 160]).is_none());
    }
}
