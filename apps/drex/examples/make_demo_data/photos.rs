//! Photos of the tin on a cloth with a printed tag beside it, as a person with a phone would take them: two rounds and some from above.
//! Where they were taken from is not written: the demo finds it as a user's scan does.

use std::f64::consts::TAU;
use std::io::Cursor;
use std::path::Path;

use anyhow::{Context, Result};
use drex_bench::tin::normal3;
use drex_core::camera::point_looked_at;
use drex_core::{Pose, Surface, TriMesh, fsutil};
use drex_mesh::MeshSdf;
use drex_sfm::marker::Marker;
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage};
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::print::{Paint, on_table, on_tin};

/// Size of a photo and its focal length, pixels.
const SIZE: (u32, u32) = (640, 480);
const FOCAL_PX: f64 = 600.0;
/// Rays per pixel and axis.
const RAYS: u32 = 4;
/// Quality of the JPEG files.
const QUALITY: u8 = 85;
/// Photos of a round, its elevation in degrees and its distance in metres.
const ROUNDS: [(usize, f64, f64); 3] = [(18, 24.0, 0.30), (14, 48.0, 0.30), (8, 68.0, 0.31)];
/// What the camera looks at, metres, and how far a hand strays from the rounds: the place, what is looked at (metres), and roll (radians).
const LOOKED_AT: [f64; 3] = [0.0, 0.0, 0.036];
const STRAY: (f64, f64, f64) = (0.010, 0.005, 0.03);
/// A round lamp: its middle, its radius (metres) and its share of the light; the rest comes from everywhere.
const LAMP: ([f64; 3], f64, f64) = ([0.42, -0.34, 0.80], 0.09, 0.62);
/// How far what is near takes light away, metres.
const NEAR_M: f64 = 0.10;
/// Exposures differ by this share, and a pixel's noise, of 255.
const EXPOSURE_SD: f64 = 0.04;
const NOISE: f64 = 1.2;
/// The lens is so much darker in the corners.
const VIGNETTE: f64 = 0.18;

/// A pinhole camera, OpenCV axes.
struct Camera {
    eye: Point3<f64>,
    /// Columns: right, down, forward.
    axes: Matrix3<f64>,
    exposure: f64,
    seed: u64,
}

/// Writes `images/`.
pub fn make(mesh: &TriMesh, tag: &Marker, folder: &Path, seed: u64) -> Result<()> {
    let tin = &MeshSdf::new(mesh)?;
    for (i, camera) in cameras(seed).iter().enumerate() {
        fsutil::write_atomic(&folder.join(format!("images/{i:02}.jpg")), &jpeg(&photo(tin, tag, camera))?)?;
    }
    Ok(())
}

/// Where the photos are taken from.
pub fn world_from_camera(seed: u64) -> Vec<Pose> {
    let pose = |c: &Camera| {
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(c.axes));
        Pose::from_parts(c.eye.into(), turn)
    };
    cameras(seed).iter().map(pose).collect()
}

/// The frame of a mesh that is made of the photos: z up from the table, under the point that the cameras look at, x towards the first of them.
///
/// # Errors
/// If the cameras look at no point.
pub fn mesh_from_world(seed: u64) -> Result<Pose> {
    let cameras = world_from_camera(seed);
    let target = point_looked_at(&cameras).context("the cameras look at no point")?;
    let x = cameras[0].translation.vector - target.coords;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -x.y.atan2(x.x));
    Ok(Pose::from_parts((turn * -Vector3::new(target.x, target.y, 0.0)).into(), turn))
}

fn cameras(seed: u64) -> Vec<Camera> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (place, aim, roll) = STRAY;
    let mut cameras = Vec::new();
    for (round, (count, elevation_deg, distance_m)) in ROUNDS.into_iter().enumerate() {
        for k in 0..count {
            let azimuth = TAU * (k as f64 + 0.5 * (round % 2) as f64) / count as f64;
            let (se, ce) = f64::to_radians(elevation_deg).sin_cos();
            let from = Vector3::new(ce * azimuth.cos(), ce * azimuth.sin(), se);
            let target = Point3::from(LOOKED_AT) + normal3(&mut rng) * aim;
            let eye = Point3::from(LOOKED_AT) + from * distance_m + normal3(&mut rng) * place;
            let forward = (target - eye).normalize();
            let level = forward.cross(&Vector3::z()).normalize();
            let (s, c) = (roll * normal3(&mut rng).x).sin_cos();
            let right = level * c + forward.cross(&level) * s;
            let axes = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
            let exposure = 1.0 + EXPOSURE_SD * normal3(&mut rng).x;
            cameras.push(Camera { eye, axes, exposure, seed: rng.random() });
        }
    }
    cameras
}

/// A photo; each of its rows has its own random numbers, so that threads do not matter.
fn photo(tin: &MeshSdf, tag: &Marker, camera: &Camera) -> RgbImage {
    let (width, height) = SIZE;
    let rows: Vec<Vec<u8>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let mut rng = ChaCha8Rng::seed_from_u64(camera.seed ^ u64::from(y));
            (0..width).flat_map(|x| pixel(tin, tag, camera, (x, y), &mut rng)).collect()
        })
        .collect();
    RgbImage::from_fn(width, height, |x, y| Rgb(std::array::from_fn(|c| rows[y as usize][3 * x as usize + c])))
}

fn pixel(tin: &MeshSdf, tag: &Marker, camera: &Camera, (x, y): (u32, u32), rng: &mut ChaCha8Rng) -> [u8; 3] {
    let middle = [0.5 * f64::from(SIZE.0), 0.5 * f64::from(SIZE.1)];
    let mut sum = Vector3::zeros();
    for k in 0..RAYS * RAYS {
        let mut sub = |n: u32| (f64::from(n) + rng.random::<f64>()) / f64::from(RAYS);
        let (u, v) = (f64::from(x) + sub(k % RAYS) - middle[0], f64::from(y) + sub(k / RAYS) - middle[1]);
        let ray = (camera.axes * Vector3::new(u / FOCAL_PX, v / FOCAL_PX, 1.0)).normalize();
        sum += seen(tin, tag, &camera.eye, &ray, rng);
    }
    let corner = ((f64::from(x) - middle[0]).powi(2) + (f64::from(y) - middle[1]).powi(2))
        / (middle[0].powi(2) + middle[1].powi(2));
    let light = sum * (camera.exposure * (1.0 - VIGNETTE * corner) / f64::from(RAYS * RAYS));
    let noise = normal3(rng) * NOISE;
    // Linear light to sRGB, nearly.
    std::array::from_fn(|c| (255.0 * light[c].clamp(0.0, 1.0).powf(1.0 / 2.2) + noise[c]).round() as u8)
}

/// Linear colour along a ray: a lamp with soft shadows, light from everywhere that near things take away, highlights.
fn seen(tin: &MeshSdf, tag: &Marker, eye: &Point3<f64>, ray: &Vector3<f64>, rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let hit = tin.ray_cast(eye, ray, 2.0);
    let table = (ray.z < -1e-6).then(|| eye - ray * (eye.z / ray.z)).filter(|p| p.coords.norm() < 1.2);
    let (point, normal, Paint { color, gloss }) = match (hit, table) {
        (Some(s), _) => (s.point, s.normal, on_tin(&s.point, &s.normal)),
        (None, Some(p)) => (p, Vector3::z(), on_table(&p, tag)),
        (None, None) => return Vector3::new(0.30, 0.31, 0.32),
    };
    let (lamp, radius, share) = LAMP;
    let above = point + normal * 1e-5;
    let to_lamp = Point3::from(lamp) + unit(rng) * radius - above;
    let (light, far) = (to_lamp.normalize(), to_lamp.norm());
    let facing = normal.dot(&light).max(0.0);
    let lit = facing > 0.0 && tin.ray_cast(&above, &light, far).is_none();
    let direct = if lit { facing * (Vector3::from(lamp).norm() / far).powi(2) } else { 0.0 };
    // A ray to anywhere above the surface, more often upright.
    let anywhere = (normal + unit(rng)).try_normalize(1e-9).unwrap_or(normal);
    let hidden = tin.ray_cast(&above, &anywhere, NEAR_M).is_some();
    let floor = anywhere.z < 0.0 && point.z < -anywhere.z * NEAR_M;
    let around = if hidden {
        0.25
    } else if floor {
        0.55
    } else {
        1.0
    };
    let half = (light - ray).normalize();
    let highlight = if lit { gloss.0 * normal.dot(&half).max(0.0).powf(gloss.1) } else { 0.0 };
    color * ((1.0 - share) * around + 1.3 * share * direct) + Vector3::repeat(highlight * share)
}

/// A random direction.
fn unit(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    let z: f64 = rng.random_range(-1.0..1.0);
    let angle = TAU * rng.random::<f64>();
    let r = (1.0 - z * z).sqrt();
    Vector3::new(r * angle.cos(), r * angle.sin(), z)
}

fn jpeg(photo: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode_image(photo).context("cannot encode a photo")?;
    Ok(bytes.into_inner())
}
