//! From a lens to a pinhole: the camera of the straightened picture, and the picture itself.

use nalgebra::{Point2, Point3};
use rayon::prelude::*;

use super::{View, refuse};
use crate::camera::{Camera, CameraModel, PinholeCamera};
use crate::{Pose, Result};

/// A wide lens is cut at this tangent of the angle to the axis, 60°: beyond it a plane stretches too much.
const WIDEST: f64 = 1.732_050_8;
/// Pixels between the places at which the lens is evaluated; between them the map is interpolated (0.01 px of error).
const STEP: usize = 8;

/// The straightened picture of a lens, before it is scaled: its intrinsics and where its pixels come from.
#[derive(Debug, Clone)]
pub(super) struct Undistortion {
    name: String,
    lens: Camera,
    /// Whether the lens bends nothing: pixels stay where they are.
    straight: bool,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: usize,
    height: usize,
}

impl Undistortion {
    /// Keeps focal lengths and optical axis, and crops to the largest rectangle of whole pixels, grown side by side from
    /// the borders of the photo, that lies within the photo.
    ///
    /// # Errors
    /// If less than 8 pixels are left: the lens model is wrong.
    pub(super) fn new(view: &View) -> Result<Self> {
        let lens = &view.lens;
        let (f, c) = (lens.focal_px(), lens.principal_point_px());
        let (width, height) = (lens.width_px() as usize, lens.height_px() as usize);
        let whole = Self {
            name: view.name.clone(),
            lens: lens.clone(),
            straight: is_straight(lens),
            fx: f.x,
            fy: f.y,
            cx: c.x,
            cy: c.y,
            width,
            height,
        };
        if whole.straight {
            return Ok(whole);
        }
        let Some([left, top, right, bottom]) = whole.window() else {
            return refuse(
                format!("the {} lens of {} leaves no straight picture", lens.model(), view.name),
                "calibrate again, or with a simpler lens model",
            );
        };
        Ok(Self {
            cx: c.x - left,
            cy: c.y - top,
            width: (right - left) as usize,
            height: (bottom - top) as usize,
            ..whole
        })
    }

    /// Left, top, right, bottom of the crop in whole pixels of the uncropped straight picture.
    fn window(&self) -> Option<[f64; 4]> {
        let (w, h) = (self.width as f64, self.height as f64);
        // How far from the axis the lens is defined: a side far beyond its fold would take the others with it below.
        let reach = |x: f64, y: f64| {
            let covers = |t: f64| self.source([self.cx + t * x, self.cy + t * y]).is_some();
            if covers(WIDEST) {
                return WIDEST;
            }
            let (mut inside, mut outside) = (0.0, WIDEST);
            while outside - inside > 1e-4 {
                let middle = 0.5 * (inside + outside);
                *(if covers(middle) { &mut inside } else { &mut outside }) = middle;
            }
            inside
        };
        let (mut left, mut right) = (self.cx - self.fx * reach(-self.fx, 0.0), self.cx + self.fx * reach(self.fx, 0.0));
        let (mut top, mut bottom) = (self.cy - self.fy * reach(0.0, -self.fy), self.cy + self.fy * reach(0.0, self.fy));
        // Where the photo's borders come to lie; a border that the plane does not reach cuts nothing.
        for i in 0..=64 {
            let t = f64::from(i) / 64.0;
            let straight = |x: f64, y: f64| self.straight_pixel([x, y]);
            left = straight(0.0, t * h).map_or(left, |p| left.max(p[0].min(self.cx)));
            right = straight(w, t * h).map_or(right, |p| right.min(p[0].max(self.cx)));
            top = straight(t * w, 0.0).map_or(top, |p| top.max(p[1].min(self.cy)));
            bottom = straight(t * w, h).map_or(bottom, |p| bottom.min(p[1].max(self.cy)));
        }
        // The rim of rounding keeps a side that is exact where it is.
        const RIM: f64 = 1e-6;
        let mut sides = [(left - RIM).ceil(), (top - RIM).ceil(), (right + RIM).floor(), (bottom + RIM).floor()];
        // Sides were cut one by one; what is still outside of the photo, or beyond the fold of the lens, goes now.
        for _ in 0..2000 {
            let [left, top, right, bottom] = sides;
            if !(right - left >= 8.0 && bottom - top >= 8.0) {
                return None;
            }
            let outside = |x: f64, y: f64| !self.source([x, y]).is_some_and(|[u, v]| in_image(u, w) && in_image(v, h));
            let along = |a: f64, b: f64| (0..=64).map(move |i| a + (b - a) * f64::from(i) / 64.0);
            let bad = [
                along(top, bottom).any(|y| outside(left, y)),
                along(left, right).any(|x| outside(x, top)),
                along(top, bottom).any(|y| outside(right, y)),
                along(left, right).any(|x| outside(x, bottom)),
            ];
            if bad == [false; 4] {
                return Some(sides);
            }
            let step = [0.002 * w, 0.002 * h].map(|s| s.ceil());
            for (side, (bad, towards)) in bad.into_iter().zip([step[0], step[1], -step[0], -step[1]]).enumerate() {
                sides[side] += if bad { towards } else { 0.0 };
            }
        }
        None
    }

    /// Where a pixel of the photo comes to lie in the straight picture; `None` behind the plane.
    fn straight_pixel(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let ray = self.lens.unproject(&Point2::from(pixel)).filter(|ray| ray.z > 1e-3)?;
        Some([self.fx * ray.x / ray.z + self.cx, self.fy * ray.y / ray.z + self.cy])
    }

    /// Where a pixel of the straight picture comes from in the photo; `None` beyond the fold of the lens.
    fn source(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let ray = Point3::new((pixel[0] - self.cx) / self.fx, (pixel[1] - self.cy) / self.fy, 1.0);
        self.lens.project(&ray).map(|p| [p.x, p.y])
    }

    /// The camera of the straight picture, scaled so that no side is longer than `max_side`.
    pub(super) fn camera(&self, camera_from_world: Pose, max_side: Option<usize>) -> Result<PinholeCamera> {
        let Self { fx, fy, cx, cy, width, height, .. } = *self;
        let whole = PinholeCamera { camera_from_world, fx, fy, cx, cy, width, height };
        let longest = width.max(height);
        let camera = match max_side {
            Some(0) => return refuse("photos of 0 pixels", "give a longest side of at least 1 pixel"),
            Some(side) if side < longest => {
                let scaled = |n: usize| ((n as f64 * side as f64 / longest as f64).round() as usize).max(1);
                whole.resized(scaled(width), scaled(height))
            }
            _ => whole,
        };
        match camera.check() {
            Ok(()) => Ok(camera),
            Err(e) => refuse(format!("{}: {e}", self.name), "use smaller photos or another lens model"),
        }
    }

    /// The map from the straight picture to the photo.
    pub(super) fn warp(&self) -> Warp {
        let (w, h) = (self.width, self.height);
        let columns = w.div_ceil(STEP) + 1;
        let nodes = if self.straight {
            Vec::new()
        } else {
            let node = |i: usize| [(i % columns * STEP).min(w) as f64, (i / columns * STEP).min(h) as f64];
            // Nodes lie in the window, where the lens is defined; on its rim rounding decides, and the axis is safe.
            let centre = [self.cx, self.cy];
            (0..columns * (h.div_ceil(STEP) + 1))
                .into_par_iter()
                .map(|i| self.source(node(i)).unwrap_or(centre).map(|v| v as f32))
                .collect()
        };
        let photo = [f64::from(self.lens.width_px()), f64::from(self.lens.height_px())];
        Warp { width: w, height: h, photo, columns, nodes }
    }
}

/// Within the image, and half a pixel round it: there the outermost pixel is as near as any.
fn in_image(v: f64, size: f64) -> bool {
    (-0.01..=size + 0.01).contains(&v)
}

/// Whether the lens is a pinhole.
fn is_straight(lens: &Camera) -> bool {
    match lens.model() {
        CameraModel::SimplePinhole | CameraModel::Pinhole => true,
        CameraModel::SimpleRadial | CameraModel::Radial | CameraModel::OpenCv | CameraModel::FullOpenCv => {
            let first = if lens.model().parameter_names()[1] == "fy" { 4 } else { 3 };
            lens.params()[first..].iter().all(|k| *k == 0.0)
        }
        _ => false,
    }
}

/// Where each pixel of a straight picture comes from in its photo.
#[derive(Debug)]
pub(super) struct Warp {
    width: usize,
    height: usize,
    /// Size of the photo, pixels.
    photo: [f64; 2],
    columns: usize,
    /// Positions in the photo of every [`STEP`]th pixel corner; empty if nothing moves.
    nodes: Vec<[f32; 2]>,
}

/// A picture of `C` channels, row by row.
#[derive(Debug)]
pub(super) struct Plane<'a, T> {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) values: &'a [T],
}

impl Warp {
    /// Place in the photo of a place in the straight picture, pixels.
    fn source(&self, x: f64, y: f64) -> [f64; 2] {
        if self.nodes.is_empty() {
            return [x, y];
        }
        let cell = |v: f64, size: usize| {
            let i = ((v / STEP as f64) as usize).min(size.div_ceil(STEP) - 1);
            // The last cell ends at the picture's edge.
            let (a, b) = (i * STEP, ((i + 1) * STEP).min(size));
            (i, (v - a as f64) / (b - a) as f64)
        };
        let ((i, s), (j, t)) = (cell(x, self.width), cell(y, self.height));
        let node = |i: usize, j: usize| self.nodes[j * self.columns + i].map(f64::from);
        let (a, b, c, d) = (node(i, j), node(i + 1, j), node(i, j + 1), node(i + 1, j + 1));
        [0, 1].map(|k| (1.0 - t) * ((1.0 - s) * a[k] + s * b[k]) + t * ((1.0 - s) * c[k] + s * d[k]))
    }

    /// The straight picture at `width` x `height` pixels: bilinear in the photo's values, then the mean over the area of
    /// each pixel, rounded once. The picture may have another size than the photo (a mask).
    pub(super) fn area<const C: usize>(
        &self,
        picture: &Plane<'_, [u8; C]>,
        width: usize,
        height: usize,
    ) -> Vec<[u8; C]> {
        let moved = !self.nodes.is_empty() || [picture.width as f64, picture.height as f64] != self.photo;
        if !moved && (width, height) == (self.width, self.height) {
            return picture.values.to_vec();
        }
        let (sx, sy) = (self.width as f64 / width as f64, self.height as f64 / height as f64);
        let shares: Vec<_> = (0..self.width).map(|x| Share::new(x, sx, width)).collect();
        let rows = (0..height).into_par_iter().flat_map_iter(|row| {
            let (y0, y1) = (row as f64 * sy, (row + 1) as f64 * sy);
            let mut sums = vec![[0.0f32; C]; width];
            for y in y0 as usize..(y1.ceil() as usize).min(self.height) {
                let overlap = (y1.min((y + 1) as f64) - y0.max(y as f64)) as f32;
                for (x, share) in shares.iter().enumerate() {
                    let value = if moved {
                        picture.bilinear(self.scaled_source(x, y, picture))
                    } else {
                        picture.values[y * self.width + x].map(f32::from)
                    };
                    share.add(&mut sums, overlap, value);
                }
            }
            let area = (sx * sy) as f32;
            sums.into_iter().map(move |sum| sum.map(|v| (v / area + 0.5) as u8))
        });
        rows.collect()
    }

    /// The straight picture by nearest neighbour, for values that must not be mixed.
    pub(super) fn nearest<T: Copy + Send + Sync>(&self, map: &Plane<'_, T>, width: usize, height: usize) -> Vec<T> {
        let (sx, sy) = (self.width as f64 / width as f64, self.height as f64 / height as f64);
        let (kx, ky) = (map.width as f64 / self.photo[0], map.height as f64 / self.photo[1]);
        let pixel = |i: usize| {
            let [u, v] = self.source((0.5 + (i % width) as f64) * sx, (0.5 + (i / width) as f64) * sy);
            let (u, v) = ((u * kx).max(0.0) as usize, (v * ky).max(0.0) as usize);
            map.values[v.min(map.height - 1) * map.width + u.min(map.width - 1)]
        };
        (0..width * height).into_par_iter().map(pixel).collect()
    }

    /// Place in `picture` of the centre of a pixel of the straight picture.
    fn scaled_source<T>(&self, x: usize, y: usize, picture: &Plane<'_, T>) -> [f64; 2] {
        let [u, v] = self.source(x as f64 + 0.5, y as f64 + 0.5);
        [u * picture.width as f64 / self.photo[0], v * picture.height as f64 / self.photo[1]]
    }
}

impl<const C: usize> Plane<'_, [u8; C]> {
    /// The value at a place, between the centres of four pixels; beyond the outermost centres theirs.
    fn bilinear(&self, [u, v]: [f64; 2]) -> [f32; C] {
        let split = |v: f64, size: usize| {
            let v = (v - 0.5).clamp(0.0, (size - 1) as f64);
            let i = v as usize;
            (i, (i + 1).min(size - 1), (v - i as f64) as f32)
        };
        let ((x0, x1, s), (y0, y1, t)) = (split(u, self.width), split(v, self.height));
        let at = |x: usize, y: usize| self.values[y * self.width + x];
        let (a, b, c, d) = (at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1));
        std::array::from_fn(|k| {
            let [a, b, c, d] = [a[k], b[k], c[k], d[k]].map(f32::from);
            (1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * c + s * d)
        })
    }
}

/// How much of a column goes to which columns of a narrower picture.
struct Share {
    column: usize,
    here: f32,
    next: f32,
}

impl Share {
    fn new(x: usize, scale: f64, width: usize) -> Self {
        let column = ((x as f64 / scale) as usize).min(width - 1);
        let end = (column + 1) as f64 * scale;
        let next = if column + 1 < width { ((x + 1) as f64 - end).max(0.0) } else { 0.0 };
        Self { column, here: 1.0 - next as f32, next: next as f32 }
    }

    fn add<const C: usize>(&self, sums: &mut [[f32; C]], weight: f32, value: [f32; C]) {
        for k in 0..C {
            sums[self.column][k] += weight * self.here * value[k];
            if self.next > 0.0 {
                sums[self.column + 1][k] += weight * self.next * value[k];
            }
        }
    }
}
