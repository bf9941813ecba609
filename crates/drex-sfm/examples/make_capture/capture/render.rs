//! Rays to photos: light, lens, shutter, sensor.

use drex_core::Pose;
use drex_core::camera::Camera;
use image::{GrayImage, RgbImage};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use rayon::prelude::*;

use super::paint::Colour;
use super::scene::{Role, Scene, Traced};
use super::{Outcome, hash, hash01};

/// Rays of a pixel.
const RAYS: usize = 4;
/// Where they pass: a turned square grid, so that edges along rows and columns get four shades too.
const OFFSETS: [[f64; 2]; RAYS] = [[0.125, 0.625], [0.375, 0.125], [0.625, 0.875], [0.875, 0.375]];

/// A camera with the rays of its pixels.
pub struct Lens {
    /// The camera.
    pub camera: Camera,
    /// Unit rays, camera axes: four of each pixel, row by row.
    rays: Vec<[f32; 3]>,
}

impl Lens {
    /// Computes the rays of every pixel.
    ///
    /// # Errors
    /// If the lens folds back inside the picture.
    pub fn new(camera: Camera) -> Outcome<Self> {
        let w = camera.width_px() as usize;
        let pixels = w * camera.height_px() as usize;
        let ray = |i: usize| {
            let (pixel, [dx, dy]) = (i / RAYS, OFFSETS[i % RAYS]);
            let at = Point2::new((pixel % w) as f64 + dx, (pixel / w) as f64 + dy);
            camera.unproject(&at).map(|r| [r.x as f32, r.y as f32, r.z as f32])
        };
        let rays: Option<Vec<[f32; 3]>> = (0..pixels * RAYS).into_par_iter().map(ray).collect();
        let rays =
            rays.ok_or("the distortion of this lens folds back inside the picture: choose smaller coefficients")?;
        Ok(Self { camera, rays })
    }

    fn ray(&self, x: usize, y: usize, number: usize) -> Vector3<f64> {
        let r = self.rays[(y * self.camera.width_px() as usize + x) * RAYS + number];
        Vector3::new(f64::from(r[0]), f64::from(r[1]), f64::from(r[2]))
    }
}

/// One photo to take.
#[derive(Clone)]
pub struct Shot {
    /// File name.
    pub name: String,
    /// Camera from world at evenly spread moments while the shutter is open, at least one.
    pub shutter: Vec<Pose>,
    /// Truth: camera from the frame of the object (the world, or the disc of a turntable), middle of the exposure.
    pub camera_from_object: Pose,
    /// Turn of the object about the world's z axis, radians.
    pub turn_rad: f64,
    /// Factor on the exposure.
    pub gain: f64,
}

/// What lens and sensor do to the light.
#[derive(Debug, Clone, Copy)]
pub struct Sensor {
    /// Loss of light in the corners.
    pub vignetting: f64,
    /// Gaussian blur of the lens, pixels.
    pub blur_px: f64,
    /// Electrons of a white pixel: their counting noise is the shot noise.
    pub full_well: f64,
    /// Noise of a dark pixel, share of white.
    pub read_noise: f64,
    /// Quality of the JPEG.
    pub jpeg_quality: u8,
}

/// A photo and what it shows.
pub struct Photo {
    /// Gamma-coded colours, 8 bits.
    pub rgb: RgbImage,
    /// The object's silhouette: 255 where at least half of the pixel shows it in the middle of the exposure.
    pub mask: GrayImage,
}

/// Takes one photo. `seed` decides the noise and the edges of shadows.
#[must_use]
pub fn take(scene: &Scene, lens: &Lens, sensor: &Sensor, shot: &Shot, seed: u64) -> Photo {
    let traced = Traced::new(scene, shot.turn_rad);
    let (w, h) = (lens.camera.width_px() as usize, lens.camera.height_px() as usize);
    let eyes: Vec<Eye> = shot.shutter.iter().map(Eye::new).collect();
    let quarter_rad = 0.5 / lens.camera.focal_px().x;
    let per_pixel = eyes.len().next_multiple_of(RAYS);
    let mut light: Vec<Colour> = vec![[0.0; 3]; w * h];
    let mut mask = vec![0u8; w * h];
    light.par_chunks_mut(w).zip(mask.par_chunks_mut(w)).enumerate().for_each(|(y, (row, mask))| {
        for x in 0..w {
            let mut sum = [0.0f32; 3];
            let mut on_object = 0;
            for i in 0..per_pixel {
                let key = hash(seed ^ ((y * w + x) * per_pixel + i) as u64);
                let eye = &eyes[i * eyes.len() / per_pixel];
                let ray = eye.world_from_camera * lens.ray(x, y, i % RAYS);
                let (colour, object) = traced.seen(&eye.centre, &ray, quarter_rad, key, true);
                // The middle four rays of a long exposure stand for its mask.
                let from = (per_pixel - RAYS) / 2;
                on_object += usize::from(object && (from..from + RAYS).contains(&i));
                for c in 0..3 {
                    sum[c] += colour[c];
                }
            }
            row[x] = sum.map(|s| s / per_pixel as f32);
            mask[x] = if 2 * on_object >= RAYS { 255 } else { 0 };
        }
    });
    blur(&mut light, w, h, sensor.blur_px);
    let rgb = develop(&light, lens, sensor, shot.gain, hash(seed ^ 0x5e_4504));
    let size = (lens.camera.width_px(), lens.camera.height_px());
    Photo {
        rgb: RgbImage::from_raw(size.0, size.1, rgb).unwrap_or_default(),
        mask: GrayImage::from_raw(size.0, size.1, mask).unwrap_or_default(),
    }
}

struct Eye {
    centre: Point3<f64>,
    world_from_camera: nalgebra::Matrix3<f64>,
}

impl Eye {
    fn new(camera_from_world: &Pose) -> Self {
        let inverse = camera_from_world.inverse();
        Self {
            centre: inverse.translation.vector.into(),
            world_from_camera: inverse.rotation.to_rotation_matrix().into_inner(),
        }
    }
}

impl Traced<'_> {
    /// Light along a ray that is `width_rad` wide, and whether it comes from the object.
    fn seen(&self, eye: &Point3<f64>, ray: &Vector3<f64>, width_rad: f64, key: u64, mirrors: bool) -> (Colour, bool) {
        let scene = self.scene();
        let hit = self.first_hit(eye, ray);
        let (paint, object) = match hit.solid {
            Some(i) => (&scene.solids[i].paint, scene.solids[i].role == Role::Object),
            None => (&scene.room.paints[hit.face], false),
        };
        let facing = -hit.normal.dot(ray);
        // Between the short and the long axis of the pixel's footprint.
        let fineness_m = hit.distance_m * width_rad / facing.max(0.02).sqrt();
        let albedo = paint.picture.colour(hit.on_face_m + paint.shifts_m[hit.face], fineness_m);

        let at = eye + ray * hit.distance_m + hit.normal * 1e-7;
        let lamp = &scene.lamp;
        let angle = std::f64::consts::TAU * f64::from(hash01(key));
        let radius = lamp.radius_m * f64::from(hash01(key ^ 0xa5a5)).sqrt();
        let to_lamp = lamp.centre_m - at + Vector3::new(radius * angle.cos(), radius * angle.sin(), 0.0);
        let distance2 = to_lamp.norm_squared();
        let distance = distance2.sqrt();
        let light = to_lamp / distance;
        let cosine = hit.normal.dot(&light);
        let mut direct = 0.0;
        if cosine > 0.0 && light.z > 0.0 && !self.blocked(&at, &light, distance) {
            direct = lamp.strength * light.z * lamp.centre_m.coords.norm_squared() / distance2;
        }
        // Light from everywhere is a little weaker from below.
        let ambient = lamp.ambient * (0.8 + 0.2 * hit.normal.z);
        let middle = (light - ray).normalize();
        let highlight = if direct > 0.0 && paint.specular > 0.0 {
            paint.specular
                * direct
                * 0.125
                * (paint.hardness + 2.0)
                * hit.normal.dot(&middle).max(0.0).powf(paint.hardness)
        } else {
            0.0
        };
        let diffuse = (ambient + direct * cosine.max(0.0)) as f32;
        let mut colour: Colour = std::array::from_fn(|c| albedo[c] * diffuse + highlight as f32);
        if mirrors && paint.mirror > 0.0 {
            let share = (paint.mirror + (1.0 - paint.mirror) * (1.0 - facing.clamp(0.0, 1.0)).powi(5)) as f32;
            let bounced = (ray + hit.normal * (2.0 * facing)).normalize();
            let (other, _) = self.seen(&at, &bounced, 2.0 * width_rad, hash(key), false);
            for c in 0..3 {
                colour[c] += share * (other[c] - colour[c]);
            }
        }
        (colour, object)
    }
}

/// Gaussian blur in both directions; the border repeats.
fn blur(light: &mut Vec<Colour>, w: usize, h: usize, sigma_px: f64) {
    if !(sigma_px > 0.0) {
        return;
    }
    let reach = (3.0 * sigma_px).ceil() as isize;
    let kernel: Vec<f32> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma_px).powi(2)).exp() as f32).collect();
    let sum: f32 = kernel.iter().sum();
    for (dx, dy) in [(1, 0), (0, 1)] {
        let source = std::mem::take(light);
        *light = (0..w * h)
            .into_par_iter()
            .map(|i| {
                let (x, y) = ((i % w) as isize, (i / w) as isize);
                let mut out = [0.0f32; 3];
                for (k, weight) in (-reach..=reach).zip(&kernel) {
                    let xx = (x + dx * k).clamp(0, w as isize - 1) as usize;
                    let yy = (y + dy * k).clamp(0, h as isize - 1) as usize;
                    for c in 0..3 {
                        out[c] += weight * source[yy * w + xx][c];
                    }
                }
                out.map(|v| v / sum)
            })
            .collect();
    }
}

/// Light to 8-bit colours: exposure, vignetting, noise, gamma.
fn develop(light: &[Colour], lens: &Lens, sensor: &Sensor, gain: f64, seed: u64) -> Vec<u8> {
    let w = lens.camera.width_px() as usize;
    let (half_w, half_h) = (0.5 * w as f64, 0.5 * f64::from(lens.camera.height_px()));
    let corner2 = half_w * half_w + half_h * half_h;
    light
        .par_iter()
        .enumerate()
        .flat_map_iter(|(i, colour)| {
            let (x, y) = ((i % w) as f64 + 0.5 - half_w, (i / w) as f64 + 0.5 - half_h);
            let factor = (gain * (1.0 - sensor.vignetting * Vector2::new(x, y).norm_squared() / corner2)) as f32;
            (0..3).map(move |c| {
                let value = colour[c] * factor;
                let variance = f64::from(value.max(0.0)) / sensor.full_well + sensor.read_noise.powi(2);
                let noisy = value + variance.sqrt() as f32 * normal(seed ^ (3 * i + c) as u64);
                (noisy.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0 + 0.5) as u8
            })
        })
        .collect()
}

/// About a standard normal number: the sum of four even ones.
fn normal(key: u64) -> f32 {
    let bits = hash(key);
    let sum: f32 = (0..4).map(|k| (bits >> (16 * k) & 0xffff) as f32 / 65536.0).sum();
    (sum - 2.0) * 3.0f32.sqrt()
}
