//! Photos of the tin on a printed cloth, as a person with a phone would take them: two rounds and a few from above. Where they were taken from
//! is not written: the demo finds it as a user's scan does.

use std::f64::consts::TAU;
use std::io::Cursor;
use std::path::Path;

use anyhow::{Context, Result};
use drex_core::{Surface, TriMesh, fsutil};
use drex_mesh::MeshSdf;
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage};
use nalgebra::{Matrix3, Point3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde_json::json;

use super::normal3;

/// Size of a photo and its focal length, pixels.
const SIZE: (u32, u32) = (400, 300);
const FOCAL_PX: f64 = 430.0;
/// Rays per pixel and axis.
const RAYS: u32 = 3;
/// Photos of a round, its elevation in degrees and its distance in metres.
const ROUNDS: [(usize, f64, f64); 3] = [(18, 24.0, 0.34), (14, 48.0, 0.34), (4, 74.0, 0.36)];
/// What the camera looks at, metres.
const LOOKED_AT: [f64; 3] = [0.0, 0.0, 0.036];
/// Crosses that are printed on the cloth, the corners of a square, metres from its middle; found in photos to so many pixels.
const MARK_M: f64 = 0.06;
const MARK_SD_PX: f64 = 0.3;
/// Half the side of the cloth, metres.
const CLOTH_M: f64 = 0.16;
/// Light: direction to it, and its share; the rest comes from everywhere.
const LIGHT: ([f64; 3], f64) = ([0.45, -0.35, 0.82], 0.55);

/// A pinhole camera, OpenCV axes.
struct Camera {
    eye: Point3<f64>,
    /// Columns: right, down, forward.
    axes: Matrix3<f64>,
}

/// Writes `images/` and `marks.json`.
pub fn make(mesh: &TriMesh, folder: &Path, seed: u64) -> Result<()> {
    let tin = &MeshSdf::new(mesh)?;
    let cameras = cameras();
    let photos: Vec<Vec<u8>> = cameras.par_iter().map(|c| jpeg(&photo(tin, c))).collect::<Result<_>>()?;
    for (i, photo) in photos.iter().enumerate() {
        fsutil::write_atomic(&folder.join(format!("images/{}", name(i))), photo)?;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    fsutil::write_atomic(&folder.join("marks.json"), marks(tin, &cameras, &mut rng)?.as_bytes())?;
    Ok(())
}

fn name(i: usize) -> String {
    format!("{i:02}.jpg")
}

fn cameras() -> Vec<Camera> {
    let target = Point3::from(LOOKED_AT);
    let mut cameras = Vec::new();
    for (round, (count, elevation_deg, distance_m)) in ROUNDS.into_iter().enumerate() {
        for k in 0..count {
            let azimuth = TAU * (k as f64 + 0.5 * (round % 2) as f64) / count as f64;
            let (se, ce) = elevation_deg.to_radians().sin_cos();
            let away = Vector3::new(ce * azimuth.cos(), ce * azimuth.sin(), se);
            let right = Vector3::z().cross(&away).normalize();
            let axes = Matrix3::from_columns(&[right, away.cross(&right) * -1.0, -away]);
            cameras.push(Camera { eye: target + away * distance_m, axes });
        }
    }
    cameras
}

impl Camera {
    fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        let (cx, cy) = (0.5 * f64::from(SIZE.0), 0.5 * f64::from(SIZE.1));
        (self.axes * Vector3::new((u - cx) / FOCAL_PX, (v - cy) / FOCAL_PX, 1.0)).normalize()
    }

    /// Pixel of a point that the camera sees and nothing hides.
    fn sees(&self, tin: &MeshSdf, point: &Point3<f64>) -> Option<[f64; 2]> {
        let p = self.axes.transpose() * (point - self.eye);
        let u = FOCAL_PX * p.x / p.z + 0.5 * f64::from(SIZE.0);
        let v = FOCAL_PX * p.y / p.z + 0.5 * f64::from(SIZE.1);
        let inside = p.z > 0.0 && (0.0..f64::from(SIZE.0)).contains(&u) && (0.0..f64::from(SIZE.1)).contains(&v);
        let away = point - self.eye;
        let hidden = tin.ray_cast(&self.eye, &away.normalize(), away.norm() - 2e-4).is_some();
        (inside && !hidden).then_some([u, v])
    }
}

fn photo(tin: &MeshSdf, camera: &Camera) -> RgbImage {
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        let mut sum = Vector3::zeros();
        for k in 0..RAYS * RAYS {
            let sub = |n: u32| (f64::from(n) + 0.5) / f64::from(RAYS);
            let ray = camera.ray(f64::from(x) + sub(k % RAYS), f64::from(y) + sub(k / RAYS));
            sum += looks(tin, &camera.eye, &ray);
        }
        let mean = sum / f64::from(RAYS * RAYS);
        // Linear light to sRGB, nearly.
        Rgb(std::array::from_fn(|c| (255.0 * mean[c].clamp(0.0, 1.0).powf(1.0 / 2.2)).round() as u8))
    })
}

/// Linear colour along a ray.
fn looks(tin: &MeshSdf, eye: &Point3<f64>, ray: &Vector3<f64>) -> Vector3<f64> {
    let hit = tin.ray_cast(eye, ray, 2.0);
    let cloth = (ray.z < -1e-6).then(|| eye - ray * (eye.z / ray.z));
    let (point, normal, color) = match (hit, cloth) {
        (Some(s), _) => (s.point, s.normal, tin_color(&s.point, &s.normal)),
        (None, Some(p)) => (p, Vector3::z(), cloth_color(&p)),
        (None, None) => return Vector3::new(0.52, 0.55, 0.58),
    };
    let light = Vector3::from(LIGHT.0).normalize();
    let lit = tin.ray_cast(&(point + normal * 1e-5), &light, 0.5).is_none();
    let direct = if lit { normal.dot(&light).max(0.0) } else { 0.0 };
    color * (1.0 - LIGHT.1 + 1.25 * LIGHT.1 * direct)
}

/// A printed tin: a label with leaves between two bands, a golden lid.
fn tin_color(p: &Point3<f64>, normal: &Vector3<f64>) -> Vector3<f64> {
    let grain = 0.85 + 0.3 * noise(&(p.coords * 900.0));
    if p.z > 0.0701 || (p.z > 0.0699 && normal.z > 0.5) {
        let ring = 0.9 + 0.2 * noise(&(p.coords * 260.0)) + 0.12 * (900.0 * p.coords.xy().norm()).sin();
        return Vector3::new(0.62, 0.44, 0.14) * grain * ring;
    }
    let around = p.y.atan2(p.x);
    let (u, v) = (around * 0.031, p.z - 0.036);
    let band = v.abs() > 0.024;
    let leaf = (u * 420.0 + 2.5 * (v * 160.0).sin()).sin() * (v * 330.0 + 1.7 * (u * 190.0).cos()).sin();
    let paint = if band {
        let stripe = (around * 24.0 + v * 500.0).sin() > 0.1;
        if stripe { Vector3::new(0.05, 0.20, 0.22) } else { Vector3::new(0.10, 0.33, 0.32) }
    } else if leaf > 0.25 {
        Vector3::new(0.16, 0.42, 0.18)
    } else if noise(&(p.coords * 170.0)) > 0.72 {
        Vector3::new(0.62, 0.16, 0.12)
    } else {
        Vector3::new(0.78, 0.71, 0.55)
    };
    paint * grain
}

/// A woven cloth with a border and four crosses; bare wood around it.
fn cloth_color(p: &Point3<f64>) -> Vector3<f64> {
    let from_edge = CLOTH_M - p.x.abs().max(p.y.abs());
    let grain = 0.75 + 0.5 * noise(&(p.coords * 600.0));
    if from_edge < 0.0 {
        let wood = noise(&Vector3::new(p.x * 30.0, p.y * 340.0, 3.0));
        return Vector3::new(0.33, 0.20, 0.11) * (0.6 + 0.8 * wood);
    }
    let (dx, dy) = ((p.x.abs() - MARK_M).abs(), (p.y.abs() - MARK_M).abs());
    if dx.max(dy) < 0.008 && dx.min(dy) < 0.0008 {
        return Vector3::repeat(0.02);
    }
    if from_edge < 0.012 {
        return Vector3::new(0.42, 0.10, 0.09) * grain;
    }
    let check = ((p.x / 0.018).floor() + (p.y / 0.018).floor()).rem_euclid(2.0) > 0.5;
    let spots = noise(&(p.coords * 140.0)) > 0.66;
    let base = if check { Vector3::new(0.62, 0.64, 0.66) } else { Vector3::new(0.42, 0.47, 0.56) };
    if spots { base.component_mul(&Vector3::new(0.62, 0.72, 1.05)) * grain } else { base * grain }
}

/// Smooth noise in [0, 1]: random values at the corners of a unit grid, interpolated.
fn noise(p: &Vector3<f64>) -> f64 {
    let cell = p.map(f64::floor);
    let f = (p - cell).map(|t| t * t * (3.0 - 2.0 * t));
    let mut sum = 0.0;
    for k in 0..8_u32 {
        let offset = Vector3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
        let weight = (0..3).map(|i| if offset[i] > 0.5 { f[i] } else { 1.0 - f[i] }).product::<f64>();
        sum += weight * hashed(&(cell + offset));
    }
    sum
}

/// A number in [0, 1] for a corner of the grid (the finaliser of splitmix64).
fn hashed(corner: &Vector3<f64>) -> f64 {
    let mut h = corner.iter().fold(7_u64, |h, c| h.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (*c as i64 as u64));
    h = (h ^ (h >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((h ^ (h >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

fn jpeg(photo: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    JpegEncoder::new_with_quality(&mut bytes, 76).encode_image(photo).context("cannot encode a photo")?;
    Ok(bytes.into_inner())
}

/// Where the crosses are in some of the photos.
fn marks(tin: &MeshSdf, cameras: &[Camera], rng: &mut ChaCha8Rng) -> Result<String> {
    let at = |x: f64, y: f64| Point3::new(x * MARK_M, y * MARK_M, 0.0);
    let marks = [("A", at(-1.0, -1.0)), ("B", at(1.0, -1.0)), ("C", at(1.0, 1.0)), ("D", at(-1.0, 1.0))];
    let mut photos = serde_json::Map::new();
    for (i, camera) in cameras.iter().enumerate().step_by(5) {
        let mut seen = serde_json::Map::new();
        for (mark, point) in &marks {
            if let Some([u, v]) = camera.sees(tin, point) {
                let noise = normal3(rng) * MARK_SD_PX;
                let tenth = |v: f64| (v * 10.0).round() / 10.0;
                seen.insert((*mark).into(), json!([tenth(u + noise.x), tenth(v + noise.y)]));
            }
        }
        photos.insert(name(i), seen.into());
    }
    Ok(serde_json::to_string_pretty(&photos).context("marks")? + "\n")
}
