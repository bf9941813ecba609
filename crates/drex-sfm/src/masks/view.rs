//! One photo in the frame of the region: its picture at working size, the pixels whose rays meet the box, and these rays.

use drex_core::Pose;
use drex_core::camera::Camera;
use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::Photo;

/// Rays are computed exactly on a lattice of this many pixels and interpolated between.
const RAY_STEP: usize = 8;

/// A rectangle of pixels: `x0..x1`, `y0..y1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    pub x0: usize,
    pub y0: usize,
    pub x1: usize,
    pub y1: usize,
}

impl Window {
    pub fn width(&self) -> usize {
        self.x1 - self.x0
    }

    pub fn height(&self) -> usize {
        self.y1 - self.y0
    }

    pub fn len(&self) -> usize {
        self.width() * self.height()
    }
}

/// A box `lower..upper` in the frame of the region, its floor on the support plane z = 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    pub lower: Point3<f64>,
    pub upper: Point3<f64>,
}

impl Bounds {
    pub fn size(&self) -> Vector3<f64> {
        self.upper - self.lower
    }

    pub fn diagonal(&self) -> f64 {
        self.size().norm()
    }

    pub fn centre(&self) -> Point3<f64> {
        nalgebra::center(&self.lower, &self.upper)
    }

    pub fn contains(&self, p: &Point3<f64>) -> bool {
        (0..3).all(|k| self.lower[k] <= p[k] && p[k] <= self.upper[k])
    }

    /// Where the ray `from + t along`, t > 0, is inside.
    pub fn span(&self, from: &Point3<f64>, along: &Vector3<f64>) -> Option<(f64, f64)> {
        let (mut near, mut far) = (0.0f64, f64::INFINITY);
        for k in 0..3 {
            if along[k].abs() < 1e-12 {
                if from[k] < self.lower[k] || from[k] > self.upper[k] {
                    return None;
                }
                continue;
            }
            let a = (self.lower[k] - from[k]) / along[k];
            let b = (self.upper[k] - from[k]) / along[k];
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        (near < far && far.is_finite()).then_some((near, far))
    }
}

/// A camera in the frame of the region.
#[derive(Debug, Clone)]
pub(super) struct Eye {
    camera: Camera,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    /// Centre of projection, frame of the region.
    pub centre: Point3<f64>,
}

impl Eye {
    pub fn new(camera: &Camera, camera_from_region: &Pose) -> Self {
        let rotation = *camera_from_region.rotation.to_rotation_matrix().matrix();
        let translation = camera_from_region.translation.vector;
        Self {
            camera: camera.clone(),
            rotation,
            translation,
            centre: Point3::from(-(rotation.transpose() * translation)),
        }
    }

    /// The pixel of the full photo at which a point appears, in front of the camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        let seen = self.rotation * point.coords + self.translation;
        if !(seen.z > 0.0) {
            return None;
        }
        self.camera.project(&Point3::from(seen))
    }

    /// Distance along the optical axis.
    pub fn depth(&self, point: &Point3<f64>) -> f64 {
        (self.rotation * point.coords + self.translation).z
    }

    /// The direction, frame of the region, that a pixel of the full photo looks along.
    pub fn ray(&self, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        self.camera.unproject(pixel).map(|ray| self.rotation.transpose() * ray)
    }

    /// Part of a direction (frame of the region) along the optical axis.
    pub fn along_axis(&self, direction: &Vector3<f64>) -> f64 {
        (self.rotation * direction).z
    }

    pub fn focal_px(&self) -> f64 {
        self.camera.focal_px().mean()
    }

    pub fn size_px(&self) -> [usize; 2] {
        [self.camera.width_px() as usize, self.camera.height_px() as usize]
    }

    /// The pixels of the full photo around the box: the rectangle around its edges, clipped. The whole photo if the camera
    /// is inside the box or the box reaches behind it; `None` if nothing of it can be in the picture.
    pub fn window(&self, bounds: &Bounds) -> Option<Window> {
        const SAMPLES: usize = 16;
        let [w, h] = self.size_px();
        let whole = Window { x0: 0, y0: 0, x1: w, y1: h };
        if bounds.contains(&self.centre) {
            return Some(whole);
        }
        let corner = |k: usize| Point3::from(Vector3::from_fn(|i, _| [bounds.lower[i], bounds.upper[i]][k >> i & 1]));
        let (mut low, mut high) = (Point2::new(f64::MAX, f64::MAX), Point2::new(f64::MIN, f64::MIN));
        let (mut in_front, mut lost) = (false, false);
        for k in 0..8 {
            for bit in 0..3 {
                if k >> bit & 1 == 1 {
                    continue;
                }
                let (a, b) = (corner(k), corner(k | 1 << bit));
                for sample in 0..=SAMPLES {
                    let point = a + (b - a) * (sample as f64 / SAMPLES as f64);
                    in_front |= self.depth(&point) > 0.0;
                    match self.project(&point) {
                        Some(pixel) => {
                            low = low.inf(&pixel);
                            high = high.sup(&pixel);
                        }
                        None => lost = true,
                    }
                }
            }
        }
        if !in_front {
            return None;
        }
        if lost {
            return Some(whole);
        }
        let window = Window {
            x0: (low.x.floor() - 1.0).clamp(0.0, w as f64) as usize,
            y0: (low.y.floor() - 1.0).clamp(0.0, h as f64) as usize,
            x1: (high.x.ceil() + 1.0).clamp(0.0, w as f64) as usize,
            y1: (high.y.ceil() + 1.0).clamp(0.0, h as f64) as usize,
        };
        (window.x0 < window.x1 && window.y0 < window.y1).then_some(window)
    }
}

/// A picture of RGB bytes.
#[derive(Debug, Clone)]
pub(super) struct Picture {
    pub width: usize,
    pub height: usize,
    pub rgb: Vec<[u8; 3]>,
}

impl Picture {
    /// The photo made smaller by a whole number, averaging; rests at the right and lower border are dropped.
    pub fn shrink(photo: &Photo, by: usize) -> Self {
        let (w, h) = (photo.width_px as usize, photo.height_px as usize);
        let (width, height) = (w / by, h / by);
        let mut rgb = Vec::with_capacity(width * height);
        let area = (by * by) as u32;
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0u32; 3];
                for row in y * by..(y + 1) * by {
                    let at = 3 * (row * w + x * by);
                    for pixel in photo.rgb[at..at + 3 * by].as_chunks::<3>().0 {
                        (0..3).for_each(|k| sum[k] += u32::from(pixel[k]));
                    }
                }
                rgb.push(sum.map(|s| ((s + area / 2) / area) as u8));
            }
        }
        Self { width, height, rgb }
    }

    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        self.rgb[y * self.width + x]
    }

    /// The colour at a point (centre of the first pixel (0.5, 0.5)), between the four pixels around it.
    pub fn sample(&self, x: f64, y: f64) -> Option<[f32; 3]> {
        let (x, y) = (x - 0.5, y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x + 1.0 < self.width as f64 && y + 1.0 < self.height as f64) {
            return None;
        }
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
        let [a, b, c, d] = [self.at(i, j), self.at(i + 1, j), self.at(i, j + 1), self.at(i + 1, j + 1)];
        Some(std::array::from_fn(|k| {
            let top = f32::from(a[k]) * (1.0 - fx) + f32::from(b[k]) * fx;
            let bottom = f32::from(c[k]) * (1.0 - fx) + f32::from(d[k]) * fx;
            top * (1.0 - fy) + bottom * fy
        }))
    }
}

/// A photo that sees the box.
#[derive(Debug, Clone)]
pub(super) struct View {
    /// Which of the photos.
    pub photo: usize,
    pub eye: Eye,
    /// Pixels of the full photo per pixel of the working picture, along one side.
    pub shrink: usize,
    pub picture: Picture,
    /// Pixels of the working picture around the box.
    pub window: Window,
    /// For each pixel of the window, row by row: whether its ray meets the box.
    pub inside: Vec<bool>,
    /// For each pixel of the window: where its ray meets the support plane, frame of the region; NaN if it does not.
    pub floor: Vec<[f32; 2]>,
}

impl View {
    /// The photo at working size; `None` if the box is not in the picture.
    pub fn new(photo: usize, eye: Eye, picture: &Photo, shrink: usize, bounds: &Bounds) -> Option<Self> {
        let full = eye.window(bounds)?;
        let picture = Picture::shrink(picture, shrink);
        let window = Window {
            x0: full.x0 / shrink,
            y0: full.y0 / shrink,
            x1: full.x1.div_ceil(shrink).min(picture.width),
            y1: full.y1.div_ceil(shrink).min(picture.height),
        };
        if window.x0 >= window.x1 || window.y0 >= window.y1 {
            return None;
        }
        let mut view = Self { photo, eye, shrink, picture, window, inside: Vec::new(), floor: Vec::new() };
        (view.inside, view.floor) = view.cast(&window, bounds);
        view.inside.contains(&true).then_some(view)
    }

    /// Whether the rays of the pixels of `window` (working size) meet the box, and where they meet the plane.
    pub fn cast(&self, window: &Window, bounds: &Bounds) -> (Vec<bool>, Vec<[f32; 2]>) {
        let (mut inside, mut floor) = (Vec::with_capacity(window.len()), Vec::with_capacity(window.len()));
        let o = self.eye.centre;
        self.each_ray(window, |ray| {
            inside.push(ray.is_some_and(|d| bounds.span(&o, &d).is_some()));
            floor.push(match ray {
                Some(d) if d.z < -1e-9 && o.z > 0.0 => {
                    let t = -o.z / d.z;
                    [(o.x + t * d.x) as f32, (o.y + t * d.y) as f32]
                }
                _ => [f32::NAN; 2],
            });
        });
        (inside, floor)
    }

    /// Calls `visit` with the ray of each pixel of `window`, row by row.
    pub fn each_ray(&self, window: &Window, mut visit: impl FnMut(Option<Vector3<f64>>)) {
        let columns = window.width().div_ceil(RAY_STEP) + 1;
        let rows = window.height().div_ceil(RAY_STEP) + 1;
        let s = self.shrink as f64;
        let knot = |i: usize, j: usize| {
            let pixel =
                Point2::new((window.x0 + i * RAY_STEP) as f64 + 0.5, (window.y0 + j * RAY_STEP) as f64 + 0.5) * s;
            self.eye.ray(&pixel)
        };
        let lattice: Vec<_> = (0..rows * columns).map(|k| knot(k % columns, k / columns)).collect();
        for y in 0..window.height() {
            for x in 0..window.width() {
                let (i, j) = (x / RAY_STEP, y / RAY_STEP);
                let (fx, fy) = ((x % RAY_STEP) as f64 / RAY_STEP as f64, (y % RAY_STEP) as f64 / RAY_STEP as f64);
                let at = j * columns + i;
                let [a, b, c, d] = [lattice[at], lattice[at + 1], lattice[at + columns], lattice[at + columns + 1]];
                visit(match (a, b, c, d) {
                    (Some(a), Some(b), Some(c), Some(d)) => {
                        Some((a * (1.0 - fx) + b * fx) * (1.0 - fy) + (c * (1.0 - fx) + d * fx) * fy)
                    }
                    // Near the border of what the lens can see.
                    _ => self.eye.ray(&(Point2::new((window.x0 + x) as f64 + 0.5, (window.y0 + y) as f64 + 0.5) * s)),
                });
            }
        }
    }

    /// Where a point appears in the working picture.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        self.eye.project(point).map(|p| p / self.shrink as f64)
    }

    /// The index into the window of the pixel at which a point appears.
    pub fn pixel_of(&self, point: &Point3<f64>) -> Option<usize> {
        let p = self.project(point)?;
        self.index(p)
    }

    /// The index into the window of the pixel that holds a point of the working picture.
    pub fn index(&self, p: Point2<f64>) -> Option<usize> {
        if !(p.x >= 0.0 && p.y >= 0.0) {
            return None;
        }
        let (x, y) = (p.x as usize, p.y as usize);
        let w = self.window;
        (w.x0 <= x && x < w.x1 && w.y0 <= y && y < w.y1).then(|| (y - w.y0) * w.width() + x - w.x0)
    }

    /// The colour of a pixel of the window.
    pub fn colour(&self, index: usize) -> [u8; 3] {
        self.picture.at(self.window.x0 + index % self.window.width(), self.window.y0 + index / self.window.width())
    }
}
