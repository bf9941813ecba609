//! The mesh as a photo sees it.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::maps::CONTRAST_TO_NOISE;
use crate::scene::View;

/// No face.
pub(super) const NONE: u32 = u32::MAX;
/// Surfaces at a smaller cosine to the ray tell little of where they are.
const LEAST_COSINE: f64 = 0.2;
/// Neighbouring pixels farther apart than so many pixels in depth are a step.
const STEP_PX: f32 = 8.0;
/// Pixels this near to a step or to where the mesh ends are not compared: they would pull the rim outwards.
const RIM_PX: usize = 2;

/// A grey picture, a little blurred, so that its slopes are those of what it shows.
pub(super) struct Blurred {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
    /// Variance of a window below which it may show noise.
    pub least_variance: f32,
}

/// For each pixel of a photo what part of the mesh it shows.
pub(super) struct Shot {
    pub width: usize,
    pub height: usize,
    /// [`NONE`] where it shows none.
    pub face: Vec<u32>,
    /// Inverse depth; 0 where there is none.
    pub w: Vec<f32>,
    /// Pixels that are compared.
    pub counts: Vec<bool>,
}

impl Blurred {
    pub fn new(view: &View, halvings: usize) -> Self {
        let picture = &view.pictures[halvings];
        let (width, height) = (picture.width, picture.height);
        let at = |x: usize, y: usize| f32::from(picture.values[y * width + x]) - 128.0;
        let mut across = vec![0.0; width * height];
        for y in 0..height {
            for x in 0..width {
                let (left, right) = (x.saturating_sub(1), (x + 1).min(width - 1));
                across[y * width + x] = 0.25 * (at(left, y) + 2.0 * at(x, y) + at(right, y));
            }
        }
        let mut values = vec![0.0; width * height];
        for y in 0..height {
            let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
            for x in 0..width {
                let [a, b, c] = [above, y, below].map(|y| across[y * width + x]);
                values[y * width + x] = 0.25 * (a + 2.0 * b + c);
            }
        }
        // The blur leaves 6/16 of the variance along each axis, and so of the deviation along both.
        let noise = 0.375 * view.noise[halvings];
        Self { width, height, values, least_variance: (CONTRAST_TO_NOISE * noise).powi(2).max(0.5) }
    }

    /// Grey and its slopes at a place that is two pixels away from the rim, by Catmull and Rom's cubic.
    #[inline(always)]
    pub fn sample(&self, x: f32, y: f32) -> [f32; 3] {
        let (column, line) = (x.floor(), y.floor());
        let (wx, dx) = cubic(x - column);
        let (wy, dy) = cubic(y - line);
        let first = (line as usize - 1) * self.width + column as usize - 1;
        let mut out = [0.0; 3];
        for r in 0..4 {
            let row = &self.values[first + r * self.width..][..4];
            let value = wx[0] * row[0] + wx[1] * row[1] + wx[2] * row[2] + wx[3] * row[3];
            let slope = dx[0] * row[0] + dx[1] * row[1] + dx[2] * row[2] + dx[3] * row[3];
            out[0] += wy[r] * value;
            out[1] += wy[r] * slope;
            out[2] += dy[r] * value;
        }
        out
    }
}

#[inline(always)]
fn cubic(t: f32) -> ([f32; 4], [f32; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, 0.5 * (t3 - t2)],
        [-0.5 + 2.0 * t - 1.5 * t2, -5.0 * t + 4.5 * t2, 0.5 + 4.0 * t - 4.5 * t2, 1.5 * t2 - t],
    )
}

impl Shot {
    pub fn new(view: &View, halvings: usize, vertices: &[Point3<f64>], faces: &[[u32; 3]]) -> Self {
        let picture = &view.pictures[halvings];
        let (width, height) = (picture.width, picture.height);
        let k = view.matrix(halvings);
        let seen = seen_by(view, vertices);
        let pixels: Vec<[f64; 2]> =
            seen.iter().map(|p| [k[(0, 0)] * p.x / p.z + k[(0, 2)], k[(1, 1)] * p.y / p.z + k[(1, 2)]]).collect();
        let mut shot = Self {
            width,
            height,
            face: vec![NONE; width * height],
            w: vec![0.0; width * height],
            counts: vec![false; width * height],
        };
        for (f, face) in faces.iter().enumerate() {
            shot.draw(f as u32, face.map(|v| seen[v as usize]), face.map(|v| pixels[v as usize]), &k);
        }
        let facing: Vec<bool> = (0..width * height)
            .map(|at| {
                let Some([a, b, c]) = shot.corners(at, faces, &seen) else { return false };
                let (ray, normal) = (ray(&k, at % width, at / width), (b - a).cross(&(c - a)));
                -normal.dot(&ray) >= LEAST_COSINE * normal.norm() * ray.norm()
            })
            .collect();
        let rim = shot.rim(k[(0, 0)] as f32);
        let shown = &view.searched[halvings].inside;
        for at in 0..width * height {
            shot.counts[at] = facing[at] && !rim[at] && shown[at];
        }
        shot
    }

    /// Change of inverse depth as the face of each pixel moves along its normal.
    pub fn gains(&self, k: &Matrix3<f64>, faces: &[[u32; 3]], seen: &[Vector3<f64>]) -> Vec<f32> {
        let gain = |at: usize| {
            let Some([a, b, c]) = self.corners(at, faces, seen) else { return 0.0 };
            let normal = (b - a).cross(&(c - a));
            let w = f64::from(self.w[at]);
            // Along the ray the face moves by the step over the cosine; inverse depth by that over the squared depth.
            (-w * w * normal.norm() / normal.dot(&ray(k, at % self.width, at / self.width))) as f32
        };
        (0..self.face.len()).map(gain).collect()
    }

    /// How much of a pixel belongs to each corner of its face.
    pub fn shares(&self, at: usize, k: &Matrix3<f64>, faces: &[[u32; 3]], seen: &[Vector3<f64>]) -> [f32; 3] {
        let Some([a, b, c]) = self.corners(at, faces, seen) else { return [0.0; 3] };
        let normal = (b - a).cross(&(c - a));
        let place = ray(k, at % self.width, at / self.width) / f64::from(self.w[at]);
        let area =
            |p: Vector3<f64>, q: Vector3<f64>| (p - place).cross(&(q - place)).dot(&normal) / normal.norm_squared();
        [area(b, c), area(c, a), area(a, b)].map(|v| v as f32)
    }

    /// Corners of the face that a pixel shows, in the frame of the camera.
    fn corners(&self, at: usize, faces: &[[u32; 3]], seen: &[Vector3<f64>]) -> Option<[Vector3<f64>; 3]> {
        Some(faces.get(self.face[at] as usize)?.map(|v| seen[v as usize]))
    }

    /// Draws a face that looks at the camera where it is nearer than what is there.
    fn draw(&mut self, f: u32, corners: [Vector3<f64>; 3], pixels: [[f64; 2]; 3], k: &Matrix3<f64>) {
        if corners.iter().any(|p| p.z <= 0.0) {
            return;
        }
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let offset = normal.dot(&corners[0]);
        if offset >= 0.0 {
            return;
        }
        let range = |axis: usize, size: usize| {
            let (lo, hi) =
                pixels.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[axis]), h.max(p[axis])));
            // A float outside the range of the integer becomes its nearest value.
            (lo.ceil().max(0.0) as usize, ((hi.floor() + 1.0).max(0.0) as usize).min(size))
        };
        let ((left, right), (top, bottom)) = (range(0, self.width), range(1, self.height));
        for y in top..bottom {
            for x in left..right {
                let side = |a: usize, b: usize| {
                    let (p, q) = (pixels[a], pixels[b]);
                    (q[0] - p[0]) * (y as f64 - p[1]) - (q[1] - p[1]) * (x as f64 - p[0])
                };
                let sides = [side(0, 1), side(1, 2), side(2, 0)];
                if !(sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0)) {
                    continue;
                }
                let w = (normal.dot(&ray(k, x, y)) / offset) as f32;
                let at = y * self.width + x;
                if w > self.w[at] {
                    (self.w[at], self.face[at]) = (w, f);
                }
            }
        }
    }

    /// Pixels near a step of depth or the end of the mesh.
    fn rim(&self, focal: f32) -> Vec<bool> {
        let (width, height) = (self.width, self.height);
        let step = |p: usize, q: usize| {
            let (a, b) = (self.w[p], self.w[q]);
            // A pixel is z / f wide, which is w / f of inverse depth.
            (a - b).abs() > STEP_PX * a.max(b) / focal
        };
        let mut rim = vec![false; width * height];
        for y in 0..height {
            for x in 0..width {
                let at = y * width + x;
                let mut mark = |other: usize| {
                    if step(at, other) {
                        (rim[at], rim[other]) = (true, true);
                    }
                };
                if x + 1 < width {
                    mark(at + 1);
                }
                if y + 1 < height {
                    mark(at + width);
                }
            }
        }
        crate::picture::Area { width, height, inside: rim }.grown(RIM_PX).inside
    }
}

/// The vertices in the frame of a camera.
pub(super) fn seen_by(view: &View, vertices: &[Point3<f64>]) -> Vec<Vector3<f64>> {
    vertices.iter().map(|p| (view.camera.camera_from_world * p).coords).collect()
}

fn ray(k: &Matrix3<f64>, x: usize, y: usize) -> Vector3<f64> {
    Vector3::new((x as f64 - k[(0, 2)]) / k[(0, 0)], (y as f64 - k[(1, 2)]) / k[(1, 1)], 1.0)
}
