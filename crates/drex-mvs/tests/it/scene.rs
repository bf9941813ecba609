//! Pictures of analytic surfaces, painted with noise in space.

use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use drex_core::capture::{Capture, View};
use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, Vector3};

pub const WIDTH: u32 = 200;
pub const HEIGHT: u32 = 152;
pub const FOCAL_PX: f64 = 300.0;

/// Distance along a ray from a point, in directions' lengths, to a surface.
pub type Surface<'a> = &'a (dyn Fn(&Point3<f64>, &Vector3<f64>) -> Option<f64> + Sync);

/// Cameras at distance `far` from the origin that look at it, turned by these angles about y and x, degrees.
pub fn ring(far: f64, angles: &[[f64; 2]]) -> Vec<Pose> {
    let pose = |[about_y, about_x]: &[f64; 2]| {
        let turn = nalgebra::UnitQuaternion::from_euler_angles(about_x.to_radians(), about_y.to_radians(), 0.0);
        Isometry3::translation(0.0, 0.0, far) * Isometry3::from_parts(Vector3::zeros().into(), turn)
    };
    angles.iter().map(pose).collect()
}

/// Photos of a surface as files in a folder, with their cameras; `grain` is the size of what is painted on it, `contrast` its range of grey.
pub fn photograph(folder: &Path, cameras: &[Pose], surface: Surface<'_>, grain: f64, contrast: f64) -> Capture {
    let lens = Camera::new(
        CameraModel::Pinhole,
        WIDTH,
        HEIGHT,
        &[FOCAL_PX, FOCAL_PX, 0.5 * f64::from(WIDTH), 0.5 * f64::from(HEIGHT)],
    )
    .unwrap();
    let views = cameras.iter().enumerate().map(|(i, pose)| {
        let world_from_camera = pose.inverse();
        let eye = Point3::from(world_from_camera.translation.vector);
        let mut picture = RgbImage::new(WIDTH, HEIGHT);
        for (u, v, pixel) in picture.enumerate_pixels_mut() {
            // Four rays a pixel, as a sensor averages.
            let mut sum = 0.0;
            for (dx, dy) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                let ray = world_from_camera.rotation
                    * Vector3::new(
                        (f64::from(u) + dx - 0.5 * f64::from(WIDTH)) / FOCAL_PX,
                        (f64::from(v) + dy - 0.5 * f64::from(HEIGHT)) / FOCAL_PX,
                        1.0,
                    );
                sum += surface(&eye, &ray).map_or(40.0, |t| 128.0 + contrast * noise(&((eye + ray * t) / grain)));
            }
            // A little of the sensor's noise, another in every photo.
            let grey = 0.25 * sum + 1.5 * noise(&Point3::new(f64::from(u) + 0.5, f64::from(v) + 0.5, 31.5 + i as f64));
            *pixel = Rgb([(grey + 0.5).clamp(0.0, 255.0) as u8; 3]);
        }
        let name = format!("{i:02}.png");
        let photo = folder.join(&name);
        picture.save(&photo).unwrap();
        view(name, photo, &lens, pose)
    });
    let views = views.collect();
    Capture { folder: folder.to_owned(), views, points: Vec::new(), unregistered: Vec::new(), notes: Vec::new() }
}

/// A photo and its camera, nothing else.
pub fn view(name: String, photo: PathBuf, lens: &Camera, camera_from_world: &Pose) -> View {
    View {
        name,
        photo,
        mask: None,
        depth: None,
        confidence: None,
        normal: None,
        lens: lens.clone(),
        camera_from_world: *camera_from_world,
        keypoints: Vec::new(),
    }
}

/// Smooth noise from -1 to 1 of about unit grain, in two octaves.
pub fn noise(p: &Point3<f64>) -> f64 {
    (value_noise(p) + 0.5 * value_noise(&(p * 2.0 + Vector3::repeat(17.3)))) / 1.2
}

fn value_noise(p: &Point3<f64>) -> f64 {
    let cell = p.map(f64::floor);
    let t = (p - cell).map(|t| t * t * (3.0 - 2.0 * t));
    let mut sum = 0.0;
    for corner in 0..8u32 {
        let step = Vector3::new(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
        let weight: f64 = (0..3).map(|k| if step[k] == 1 { t[k] } else { 1.0 - t[k] }).product();
        sum += weight * hash((cell + step.map(f64::from)).coords.map(|v| v as i64));
    }
    sum
}

fn hash(cell: Vector3<i64>) -> f64 {
    let mut z = cell.iter().fold(0u64, |h, v| (h ^ *v as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}
