//! A small renderer of printed tags on a textured table: perspective, lens distortion, blur in light, sRGB, noise.
#![allow(dead_code, clippy::unwrap_used)] // each test file uses a part, and a test may stop

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use nalgebra::{Isometry3, Point2, Point3, Rotation3, UnitQuaternion, Vector2, Vector3};

/// Data cells of some tags of tag36h11, `#` black, upright, as OpenCV 5's generator draws them turned by 180 degrees: a
/// source independent of the table in the crate.
const TAGS: [(u32, [&str; 6]); 5] = [
    (0, ["..#.#.", "#...#.", "#..###", ".#.###", "#.#..#", "###.##"]),
    (11, ["##....", "......", ".##.#.", ".###.#", "..##..", "#.#.#."]),
    (12, ["#.####", "...#.#", "##.##.", "#.##..", "##.#.#", "#..#.#"]),
    (200, [".##...", "###...", ".#..#.", "#...##", "..##.#", "#.##.#"]),
    (586, ["...#.#", "####..", ".#....", ".##.##", ".#..#.", "..##.."]),
];

/// Numbers from a seed (splitmix64, Steele and others 2014).
pub struct Random(pub u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in low to high.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        let [u, angle] = [self.uniform(0.0, 1.0), self.uniform(0.0, std::f64::consts::TAU)];
        drex_core::stats::normal_pair(u, angle)[0]
    }
}

/// A tag lying on the table z = 0, metres.
#[derive(Clone, Copy)]
pub struct Tag {
    pub id: u32,
    pub side_m: f64,
    pub centre: [f64; 2],
    pub yaw_rad: f64,
}

impl Tag {
    /// Corners in the world, clockwise seen from above, from the top left.
    pub fn corners(&self) -> [Point3<f64>; 4] {
        [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(x, y)| {
            let (sin, cos) = self.yaw_rad.sin_cos();
            let (x, y) = (0.5 * self.side_m * x, 0.5 * self.side_m * y);
            Point3::new(self.centre[0] + cos * x - sin * y, self.centre[1] + sin * x + cos * y, 0.0)
        })
    }

    /// Whether the print is white at a point of the table; `None` beside the print with its margin of one cell.
    fn white(&self, at: Vector2<f64>) -> Option<bool> {
        let (sin, cos) = self.yaw_rad.sin_cos();
        let d = at - Vector2::from(self.centre);
        let (x, y) = (cos * d.x + sin * d.y, -sin * d.x + cos * d.y);
        let cell = self.side_m / 8.0;
        let (column, row) = ((x / cell + 4.0).floor() as i64, (4.0 - y / cell).floor() as i64);
        match (row, column) {
            (-1..=8, -1..=8) if row == -1 || row == 8 || column == -1 || column == 8 => Some(true),
            (1..=6, 1..=6) => {
                let (_, rows) = TAGS.iter().find(|(id, _)| *id == self.id).expect("a tag of the list");
                Some(rows[row as usize - 1].as_bytes()[column as usize - 1] == b'.')
            }
            (0..=7, 0..=7) => Some(false),
            _ => None,
        }
    }
}

/// How a photo is taken.
#[derive(Clone, Copy)]
pub struct Taking {
    /// Standard deviation of the lens's blur, pixels.
    pub blur_px: f64,
    /// Standard deviation of noise, grey values.
    pub noise: f64,
    /// Light of white paper, 0 to 1.
    pub exposure: f64,
    /// How far ink reaches beyond the black cells, metres.
    pub ink_m: f64,
}

impl Default for Taking {
    fn default() -> Self {
        Self { blur_px: 0.7, noise: 2.0, exposure: 0.75, ink_m: 0.0 }
    }
}

pub fn camera(width: u32, height: u32, focal: f64, k1: f64) -> Camera {
    let (cx, cy) = (f64::from(width) / 2.0 + 3.0, f64::from(height) / 2.0 - 2.0);
    Camera::new(CameraModel::OpenCv, width, height, &[focal, focal, cx, cy, k1, 0.01, 0.0, 0.0]).unwrap()
}

/// Camera from world: at `eye`, looking at `target`, turned by `roll` about the view.
pub fn looking(eye: Point3<f64>, target: Point3<f64>, roll: f64) -> Pose {
    let z = (target - eye).normalize();
    let side = if z.z.abs() > 0.999 { Vector3::x() } else { z.cross(&Vector3::z()).normalize() };
    let rotation = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[side, z.cross(&side), z]));
    let rotation = rotation * Rotation3::from_axis_angle(&Vector3::z_axis(), roll);
    Isometry3::from_parts(eye.coords.into(), UnitQuaternion::from_rotation_matrix(&rotation)).inverse()
}

/// Where a camera sees the corners of a tag.
pub fn true_corners(camera: &Camera, camera_from_world: &Pose, tag: &Tag) -> [[f64; 2]; 4] {
    tag.corners().map(|c| camera.project(&(camera_from_world * c)).expect("before the camera").into())
}

/// A photo, grey values in sRGB's curve.
pub fn render(camera: &Camera, camera_from_world: &Pose, tags: &[Tag], taking: &Taking, seed: u64) -> Vec<u8> {
    const SAMPLES: usize = 5;
    let (w, h) = (camera.width_px() as usize, camera.height_px() as usize);
    let world_from_camera = camera_from_world.inverse();
    let table = |pixel: Point2<f64>| {
        let ray = world_from_camera * camera.unproject(&pixel)?;
        let eye = world_from_camera.translation.vector;
        (ray.z < -1e-3).then(|| eye.xy() - ray.xy() * (eye.z / ray.z))
    };
    let shade = |at: Vector2<f64>| {
        let near = |d: Vector2<f64>| tags.iter().find_map(|t| t.white(at + d));
        match near(Vector2::zeros()) {
            Some(white) => {
                let i = taking.ink_m;
                let inked = |d: Vector2<f64>| near(d) == Some(false);
                let spread = i > 0.0
                    && [(i, 0.0), (-i, 0.0), (0.0, i), (0.0, -i)].iter().any(|&(x, y)| inked(Vector2::new(x, y)));
                if white && !spread { taking.exposure } else { 0.06 * taking.exposure }
            }
            None => taking.exposure * (0.35 + 0.1 * wood(at, seed)),
        }
    };
    // Places on the table at the corners of pixels; within a pixel they change linearly.
    let grid: Vec<Option<Vector2<f64>>> = (0..=h)
        .flat_map(|y| (0..=w).map(move |x| (x, y)))
        .map(|(x, y)| table(Point2::new(x as f64, y as f64)))
        .collect();
    let mut light = vec![0.1; w * h];
    for y in 0..h {
        for x in 0..w {
            let k = y * (w + 1) + x;
            let (Some(a), Some(b), Some(c), Some(d)) = (grid[k], grid[k + 1], grid[k + w + 1], grid[k + w + 2]) else {
                continue;
            };
            let mut sum = 0.0;
            for j in 0..SAMPLES {
                for i in 0..SAMPLES {
                    let (u, v) = ((i as f64 + 0.5) / SAMPLES as f64, (j as f64 + 0.5) / SAMPLES as f64);
                    sum += shade((a * (1.0 - u) + b * u) * (1.0 - v) + (c * (1.0 - u) + d * u) * v);
                }
            }
            light[y * w + x] = sum / (SAMPLES * SAMPLES) as f64;
        }
    }
    let mut random = Random(seed);
    blurred(&light, w, h, taking.blur_px)
        .iter()
        .enumerate()
        .map(|(k, l)| {
            // A lamp from the left.
            let l = l * (1.0 - 0.3 * (k % w) as f64 / w as f64);
            (255.0 * srgb(l.clamp(0.0, 1.0)) + taking.noise * random.normal()).round().clamp(0.0, 255.0) as u8
        })
        .collect()
}

/// IEC 61966-2-1.
fn srgb(l: f64) -> f64 {
    if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 }
}

fn wood(at: Vector2<f64>, seed: u64) -> f64 {
    let phase = seed as f64 * 0.7;
    (at.x * 310.0 + 2.0 * (at.y * 47.0 + phase).sin() + phase).sin() * (at.y * 90.0 + phase).cos()
}

fn blurred(image: &[f64], w: usize, h: usize, sigma: f64) -> Vec<f64> {
    let reach = (3.0 * sigma).ceil() as i64;
    let weights: Vec<f64> = (-reach..=reach).map(|d| (-0.5 * (d as f64 / sigma).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let pass = |image: &[f64], dx: i64, dy: i64| -> Vec<f64> {
        (0..w * h)
            .map(|k| {
                let (x, y) = ((k % w) as i64, (k / w) as i64);
                let at = |d: i64| {
                    let (x, y) = ((x + d * dx).clamp(0, w as i64 - 1), (y + d * dy).clamp(0, h as i64 - 1));
                    image[y as usize * w + x as usize]
                };
                (-reach..=reach).zip(&weights).map(|(d, weight)| weight * at(d)).sum::<f64>() / sum
            })
            .collect()
    };
    pass(&pass(image, 1, 0), 0, 1)
}
