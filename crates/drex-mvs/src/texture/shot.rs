//! What a photo shows of a mesh: colours, and how far they can be trusted.

use drex_core::TriMesh;
use drex_core::camera::PinholeCamera;
use drex_core::capture::Photo;
use nalgebra::{Point3, Vector3};

/// A surface seen at a smaller cosine shows too little: 75 degrees.
pub(super) const LEAST_COSINE: f64 = 0.26;
/// Neighbouring pixels farther apart than so many pixels in depth are a step.
const STEP_PX: f32 = 6.0;
/// Pixels this near to a step, a rim of the mesh or of the mask show a mixture.
const RIM_PX: f32 = 2.0;
/// From there trust grows with the distance, over so many pixels.
const RAMP_PX: f32 = 8.0;
/// A point behind the mesh by less than so many pixels is on it.
const BEHIND_PX: f64 = 2.0;
/// Limits of the blur that parts low from high frequencies, pixels.
const BLUR_PX: [f64; 2] = [1.0, 10.0];

/// The part of a photo that shows the mesh.
pub(super) struct Shot {
    camera: PinholeCamera,
    /// First column and row of the part.
    corner: [usize; 2],
    width: usize,
    height: usize,
    /// Inverse depth of the mesh; 0 where it is not.
    w: Vec<f32>,
    /// From 0, not to be used, to 1.
    trust: Vec<f32>,
    /// Colours in linear light.
    full: Vec<[f32; 3]>,
    /// The same, low frequencies alone.
    low: Vec<[f32; 3]>,
}

/// What a photo says of a point.
#[derive(Clone, Copy)]
pub(super) struct Sample {
    /// Cosine between normal and ray.
    pub cosine: f32,
    /// Pixels per unit of length, where the surface faces the camera.
    pub resolution: f32,
    /// From 0 to 1, small near rims and steps.
    pub trust: f32,
    /// Colour, linear light.
    pub full: [f32; 3],
    /// Its low frequencies.
    pub low: [f32; 3],
}

impl Shot {
    /// `blur` is the standard deviation of the blur on the surface, unit of the mesh. `None` if the photo shows nothing of the mesh.
    pub fn new(photo: &Photo, mesh: &TriMesh, blur: f64) -> Option<Self> {
        let camera = photo.camera.clone();
        let seen: Vec<Vector3<f64>> = mesh.vertices.iter().map(|p| (camera.camera_from_world * p).coords).collect();
        let place = |p: &Vector3<f64>| [camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy];
        let range = |axis: usize, size: usize| {
            let at = seen.iter().filter(|p| p.z > 0.0).map(|p| place(p)[axis]);
            let (lo, hi) = at.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
            ((lo - 2.0).max(0.0) as usize).min(size)..((hi + 3.0).max(0.0) as usize).min(size)
        };
        let (columns, rows) = (range(0, camera.width), range(1, camera.height));
        if columns.is_empty() || rows.is_empty() {
            return None;
        }
        let (width, height) = (columns.len(), rows.len());
        let mut shot = Self {
            corner: [columns.start, rows.start],
            width,
            height,
            w: vec![0.0; width * height],
            trust: Vec::new(),
            full: Vec::with_capacity(width * height),
            low: Vec::new(),
            camera,
        };
        for face in &mesh.faces {
            shot.draw(face.map(|v| seen[v as usize]));
        }
        let linear: [f32; 256] = std::array::from_fn(|v| linear(v as f32 / 255.0));
        let mut shown: Vec<bool> = shot.w.iter().map(|w| *w > 0.0).collect();
        for (y, line) in rows.enumerate() {
            let from = line * shot.camera.width + columns.start;
            shot.full.extend(photo.rgb[from..from + width].iter().map(|c| c.map(|v| linear[usize::from(v)])));
            if let Some(mask) = &photo.mask {
                let own = &mut shown[y * width..][..width];
                own.iter_mut().zip(&mask[from..]).for_each(|(shown, m)| *shown &= *m >= 128);
            }
        }
        shot.trust = shot.trust(&shown);
        let middle = mesh.bounds().map(|(lo, hi)| nalgebra::center(&lo, &hi))?;
        let distance = (shot.camera.camera_from_world * middle).coords.norm().max(f64::MIN_POSITIVE);
        let sigma = (blur * shot.camera.fx / distance).clamp(BLUR_PX[0], BLUR_PX[1]);
        shot.low = blurred(&shot.full, &shown, width, height, sigma);
        Some(shot)
    }

    /// Draws a face that looks at the camera where it is nearer than what is there.
    fn draw(&mut self, corners: [Vector3<f64>; 3]) {
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let offset = normal.dot(&corners[0]);
        if offset >= 0.0 || corners.iter().any(|p| p.z <= 0.0) {
            return;
        }
        let [left, top] = self.corner.map(|c| c as f64);
        let c = &self.camera;
        let pixels = corners.map(|p| [c.fx * p.x / p.z + c.cx - left, c.fy * p.y / p.z + c.cy - top]);
        // Inverse depth is linear in the picture.
        let slope = [normal.x / c.fx / offset, normal.y / c.fy / offset];
        let at_zero = normal.dot(&c.ray([left, top])) / offset;
        for (x, y, _) in super::charts::covered(&pixels, [self.width, self.height]) {
            let w = (at_zero + slope[0] * (x as f64 + 0.5) + slope[1] * (y as f64 + 0.5)) as f32;
            let here = &mut self.w[y * self.width + x];
            *here = here.max(w);
        }
    }

    /// How far pixels can be trusted: by their distance to what is not shown, to steps of depth and to the picture's rim.
    fn trust(&self, shown: &[bool]) -> Vec<f32> {
        let (width, height) = (self.width, self.height);
        let focal = self.camera.fx as f32;
        let step = |p: usize, q: usize| {
            let (a, b) = (self.w[p], self.w[q]);
            (a - b).abs() > STEP_PX * a.max(b) / focal
        };
        let most = RIM_PX + RAMP_PX;
        let mut far: Vec<f32> = shown.iter().map(|s| if *s { most } else { 0.0 }).collect();
        let ends = [
            self.corner[0] == 0,
            self.corner[1] == 0,
            self.corner[0] + width == self.camera.width,
            self.corner[1] + height == self.camera.height,
        ];
        for y in 0..height {
            for x in 0..width {
                let at = y * width + x;
                if (x + 1 < width && step(at, at + 1)) || (y + 1 < height && step(at, at + width)) {
                    far[at] = 0.0;
                }
                let rims = [x == 0, y == 0, x + 1 == width, y + 1 == height];
                if (0..4).any(|k| rims[k] && ends[k]) {
                    far[at] = 0.0;
                }
            }
        }
        grow_distances(&mut far, width, height);
        far.iter()
            .map(|d| {
                let t = ((d - RIM_PX) / RAMP_PX).clamp(0.0, 1.0);
                t * t * (3.0 - 2.0 * t)
            })
            .collect()
    }

    /// What the photo shows of a point with this unit normal; `None` if it does not see it well enough.
    pub fn sample(&self, point: &Point3<f64>, normal: &Vector3<f64>) -> Option<Sample> {
        let c = &self.camera;
        let p = c.camera_from_world * point;
        let distance = p.coords.norm();
        let cosine = -(c.camera_from_world.rotation * normal).dot(&p.coords) / distance;
        if p.z <= 0.0 || !(cosine > LEAST_COSINE) {
            return None;
        }
        // Pixel centres at whole numbers.
        let x = c.fx * p.x / p.z + c.cx - self.corner[0] as f64 - 0.5;
        let y = c.fy * p.y / p.z + c.cy - self.corner[1] as f64 - 0.5;
        if !(x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f64 && y < (self.height - 1) as f64) {
            return None;
        }
        let at = y as usize * self.width + x as usize;
        let four = [at, at + 1, at + self.width, at + self.width + 1];
        // The farthest of the four: on a slope the others are nearer than the point.
        let farthest = four.iter().map(|i| self.w[*i]).fold(f32::INFINITY, f32::min);
        if !(farthest > 0.0 && p.z * f64::from(farthest) <= 1.0 + BEHIND_PX / c.fx) {
            return None;
        }
        let (tx, ty) = (x.fract() as f32, y.fract() as f32);
        let weights = [(1.0 - tx) * (1.0 - ty), tx * (1.0 - ty), (1.0 - tx) * ty, tx * ty];
        let colour = |of: &[[f32; 3]]| [0, 1, 2].map(|k| (0..4).map(|i| weights[i] * of[four[i]][k]).sum::<f32>());
        let trust = four.iter().map(|i| self.trust[*i]).fold(1.0, f32::min);
        (trust > 0.0).then(|| Sample {
            cosine: cosine as f32,
            resolution: (c.fx / distance) as f32,
            trust,
            full: colour(&self.full),
            low: colour(&self.low),
        })
    }
}

/// sRGB to linear light, 0 to 1 (IEC 61966-2-1).
pub(super) fn linear(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Distances to the nearest zero, no larger than those given: chamfer distances in two passes.
fn grow_distances(far: &mut [f32], width: usize, height: usize) {
    const DIAGONAL: f32 = std::f32::consts::SQRT_2;
    let relax = |far: &mut [f32], x: usize, y: usize, steps: [(isize, isize, f32); 4]| {
        for (dx, dy, length) in steps {
            let (u, v) = (x as isize + dx, y as isize + dy);
            if u >= 0 && v >= 0 && u < width as isize && v < height as isize {
                let through = far[v as usize * width + u as usize] + length;
                let own = &mut far[y * width + x];
                *own = own.min(through);
            }
        }
    };
    let before = [(-1, 0, 1.0), (0, -1, 1.0), (-1, -1, DIAGONAL), (1, -1, DIAGONAL)];
    for y in 0..height {
        (0..width).for_each(|x| relax(far, x, y, before));
    }
    for y in (0..height).rev() {
        (0..width).rev().for_each(|x| relax(far, x, y, before.map(|(dx, dy, length)| (-dx, -dy, length))));
    }
}

/// Mean of what is shown round each pixel, by a Gaussian; zero where nothing is.
fn blurred(full: &[[f32; 3]], shown: &[bool], width: usize, height: usize, sigma: f64) -> Vec<[f32; 3]> {
    let reach = (2.5 * sigma).ceil() as usize;
    let kernel: Vec<f32> = (0..=reach).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp() as f32).collect();
    let weighted: Vec<[f32; 4]> =
        full.iter().zip(shown).map(|(c, s)| if *s { [c[0], c[1], c[2], 1.0] } else { [0.0; 4] }).collect();
    let pass = |from: &[[f32; 4]], across: bool| {
        let (step, size) = if across { (1, width) } else { (width, height) };
        let mut to = vec![[0.0f32; 4]; from.len()];
        for (at, to) in to.iter_mut().enumerate() {
            let place = if across { at % width } else { at / width };
            let mut add = |other: usize, weight: f32| (0..4).for_each(|k| to[k] += weight * from[other][k]);
            add(at, kernel[0]);
            for (k, weight) in kernel.iter().enumerate().skip(1) {
                if place >= k {
                    add(at - k * step, *weight);
                }
                if place + k < size {
                    add(at + k * step, *weight);
                }
            }
        }
        to
    };
    let sums = pass(&pass(&weighted, true), false);
    sums.iter().map(|s| if s[3] > 0.0 { [s[0], s[1], s[2]].map(|v| v / s[3]) } else { [0.0; 3] }).collect()
}
