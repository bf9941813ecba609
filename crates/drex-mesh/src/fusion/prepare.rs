//! A depth map made ready for fusion: smoothed by what its noise asks for, with slopes, and with silhouettes.

use nalgebra::{Matrix3, Vector3};

use drex_core::Pose;

use crate::depth::{DepthCamera, DepthMap};

/// Side of a tile, pixels.
pub(super) const TILE: usize = 16;
/// Largest half-width of the smoothing window, pixels.
const LARGEST_RADIUS: usize = 3;
/// Noise that smoothing aims at, in footprints of a pixel.
const NOISE_GOAL: f32 = 0.5;
/// Second differences beyond this many standard deviations are no noise but an edge.
const GATE: f32 = 3.5;
/// Noise, in footprints of a pixel, up to which the difference of two neighbours tells the slope.
const PRECISE: f32 = 0.1;
/// A slope of more than this many footprints per pixel (84 degrees from frontal) is a jump.
const STEEPEST: f32 = 10.0;
/// Farthest distance from a silhouette that is told apart, pixels.
pub(super) const FARTHEST_PX: usize = 32;

/// What a pixel says.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pixel {
    /// Depth along the optical axis, metres; [`BACKGROUND`] or [`UNKNOWN`] where there is none.
    pub z: f32,
    /// Change of depth per column and row, metres.
    pub slope: [f32; 2],
    /// Hit: what turns a difference of depths into a distance from the tangent plane; 0 where no plane was found.
    /// Background: distance from the silhouette in pixels, infinite if farther than is told apart.
    pub factor: f32,
}

pub(super) const BACKGROUND: f32 = 0.0;
pub(super) const UNKNOWN: f32 = -1.0;

/// Extremes of the pixels of a tile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tile {
    pub nearest: f32,
    pub farthest: f32,
    /// Pixels within reach of a silhouette, where the distance from it matters.
    pub rim: bool,
    pub empty: bool,
    pub unknown: bool,
}

const NO_PIXEL: Tile = Tile { nearest: f32::INFINITY, farthest: 0.0, rim: false, empty: false, unknown: false };

/// A depth map ready for fusion. Beyond the kept window there is background or nothing known.
#[derive(Debug)]
pub(super) struct Prepared {
    pub camera_from_grid: (Matrix3<f32>, Vector3<f32>),
    pub focal: [f32; 2],
    pub center: [f32; 2],
    pub size: [usize; 2],
    pub window: Window,
    pub pixels: Vec<Pixel>,
    pub tiles: Vec<Tile>,
    /// Whether rays beside the window are empty (else nothing is known of them).
    pub beside_is_empty: bool,
    /// Estimated noise of the depth before smoothing, metres.
    pub noise_m: f32,
    /// Half-width of the smoothing window, pixels.
    pub radius: usize,
}

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

/// Depth of the object at each pixel of a window, with a border of zeros; 0 where there is none.
pub(super) struct Hits {
    pub window: Window,
    pub depth: Vec<f32>,
    stride: usize,
    /// Median of the depths, metres.
    pub typical_z: f32,
    pub noise_m: f32,
}

const BORDER: usize = LARGEST_RADIUS;

impl Hits {
    /// The depths of the object in a map that was checked; `None` if there are none. The window holds the whole mask.
    pub fn new(map: &DepthMap) -> Option<Self> {
        let (width, height) = (map.camera.width_px as usize, map.camera.height_px as usize);
        let (mut x, mut y) = ((width, 0), (height, 0));
        for (row, line) in map.depth_m.chunks_exact(width).enumerate() {
            let mask = map.mask.as_ref().map(|m| &m[row * width..(row + 1) * width]);
            let object = |i: usize| mask.map_or_else(|| is_depth(line[i]), |m| m[i]);
            if let Some(first) = (0..width).find(|&i| object(i)) {
                let last = (first..width).rev().find(|&i| object(i)).unwrap_or(first);
                x = (x.0.min(first), x.1.max(last));
                y = (y.0.min(row), row);
            }
        }
        if x.0 > x.1 {
            return None;
        }
        let window = Window { x: x.0, y: y.0, width: x.1 + 1 - x.0, height: y.1 + 1 - y.0 };
        let stride = window.width + 2 * BORDER;
        let mut depth = vec![0.0; stride * (window.height + 2 * BORDER)];
        for row in 0..window.height {
            let from = (window.y + row) * width + window.x;
            let to = (row + BORDER) * stride + BORDER;
            for (i, out) in depth[to..to + window.width].iter_mut().enumerate() {
                let z = map.depth_m[from + i];
                *out = if is_depth(z) && map.mask.as_ref().is_none_or(|m| m[from + i]) { z } else { 0.0 };
            }
        }
        let mut hits = Self { window, depth, stride, typical_z: 0.0, noise_m: 0.0 };
        hits.measure();
        (hits.typical_z > 0.0).then_some(hits)
    }

    /// Typical depth and noise. The second difference of independent noise has 6 times its variance; the largest tenth
    /// (edges, jumps) is left out, which for a normal distribution keeps 0.6237 of the mean square.
    fn measure(&mut self) {
        const KEPT_SHARE: f32 = 0.6237;
        let step = (self.window.width * self.window.height / 20_000).max(1);
        let (mut depths, mut squares) = (Vec::new(), Vec::new());
        for i in (0..self.window.width * self.window.height).step_by(step) {
            let at = self.index(i % self.window.width, i / self.window.width);
            let [before, z, after] = [at - 1, at, at + 1].map(|j| self.depth[j]);
            if z > 0.0 {
                depths.push(z);
                if before > 0.0 && after > 0.0 {
                    squares.push((before - 2.0 * z + after).powi(2));
                }
            }
        }
        let middle = depths.len() / 2;
        if !depths.is_empty() {
            self.typical_z = *depths.select_nth_unstable_by(middle, f32::total_cmp).1;
        }
        squares.sort_unstable_by(f32::total_cmp);
        squares.truncate(squares.len() * 9 / 10);
        if !squares.is_empty() {
            let mean = squares.iter().sum::<f32>() / squares.len() as f32;
            self.noise_m = (mean / (6.0 * KEPT_SHARE)).sqrt();
        }
    }

    pub fn index(&self, x: usize, y: usize) -> usize {
        (y + BORDER) * self.stride + x + BORDER
    }

    /// The smoothing for this map.
    pub fn smoother(&self, camera: &DepthCamera) -> Smoother {
        let footprint = self.typical_z / camera.fx_px.max(camera.fy_px) as f32;
        // The mean of (2 r + 1)² values has 1 / (2 r + 1) of the noise.
        let wanted = 0.5 * (self.noise_m / (NOISE_GOAL * footprint) - 1.0);
        let radius = (wanted.ceil() as usize).clamp(1, LARGEST_RADIUS) as isize;
        let pairs = (0..=radius)
            .flat_map(|dy| (-radius..=radius).map(move |dx| (dx, dy)))
            .filter(|&(dx, dy)| dy > 0 || dx > 0)
            .map(|(dx, dy)| (dx as f32, dy as f32, dy * self.stride as isize + dx))
            .collect();
        // Rounding and curvature look like a little noise even in a perfect map.
        let gate = GATE * 1.5_f32.sqrt() * self.noise_m.max(0.01 * footprint);
        let precise = self.noise_m < PRECISE * footprint;
        Smoother { pairs, gate, precise, radius: radius as usize, per_z: 1.0 / camera.fx_px.max(camera.fy_px) as f32 }
    }

    /// Depth and slopes at a hit pixel, from the pairs of opposite neighbours that lie on a plane with it: such a mean is not
    /// drawn towards either side, whatever the slope, and stops at edges.
    pub fn plane(&self, at: usize, smoother: &Smoother) -> (f32, Option<[f32; 2]>) {
        let z = self.depth[at];
        let (mut bend, mut count) = (0.0_f32, 0.0_f32);
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
        let jump = STEEPEST * z * smoother.per_z;
        for &(dx, dy, shift) in &smoother.pairs {
            let (a, b) = (self.depth[at.wrapping_add_signed(shift)], self.depth[at.wrapping_add_signed(-shift)]);
            let off = 0.5 * (a + b) - z;
            if a > 0.0 && b > 0.0 && off.abs() < smoother.gate && (a - b).abs() < 2.0 * jump * (dx.abs() + dy) {
                bend += off;
                count += 1.0;
                let half = 0.5 * (a - b);
                xx += dx * dx;
                xy += dx * dy;
                yy += dy * dy;
                xz += dx * half;
                yz += dy * half;
            }
        }
        let smooth = z + 2.0 * bend / (1.0 + 2.0 * count);
        let det = xx * yy - xy * xy;
        let slope = if det > 0.5 {
            Some([(yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det])
        } else if smoother.precise {
            let [x, y] = [1, self.stride].map(|step| self.one_sided(at, step, jump));
            x.zip(y).map(|(x, y)| [x, y])
        } else {
            None
        };
        (smooth, slope)
    }

    /// The smaller of the differences to the two neighbours: the other one may lie beyond an edge.
    fn one_sided(&self, at: usize, step: usize, jump: f32) -> Option<f32> {
        let z = self.depth[at];
        let (before, after) = (self.depth[at - step], self.depth[at + step]);
        let sides = [(before > 0.0).then_some(z - before), (after > 0.0).then_some(after - z)];
        sides.into_iter().flatten().filter(|d| d.abs() < jump).min_by(|a, b| a.abs().total_cmp(&b.abs()))
    }
}

/// How a map is smoothed.
pub(super) struct Smoother {
    /// Offsets of one of each pair of opposite neighbours, and its shift in the array.
    pairs: Vec<(f32, f32, isize)>,
    gate: f32,
    /// Whether the difference of two neighbours tells the slope.
    precise: bool,
    pub radius: usize,
    per_z: f32,
}

pub(super) fn is_depth(z: f32) -> bool {
    z > 0.0 && z.is_finite()
}

/// What turns a difference of depths on one ray into a distance from the tangent plane: with the ray r = (x, y, 1) and the
/// unit normal n of the surface z(u, v), |n · r| = z / |(f_x z_u, f_y z_v, z + x f_x z_u + y f_y z_v)|.
pub(super) fn plane_factor(z: f32, slope: [f32; 2], focal: [f32; 2], ray: [f32; 2]) -> f32 {
    let (a, b) = (focal[0] * slope[0], focal[1] * slope[1]);
    z / (a * a + b * b + (z + ray[0] * a + ray[1] * b).powi(2)).sqrt()
}

impl Prepared {
    /// Prepares a checked map. `reach_m`: how far from a silhouette distances are wanted. `None` if there is no depth of the
    /// object: that is more often a view or a mask that failed than a view past the object.
    pub fn new(map: &DepthMap, camera_from_grid: &Pose, background_is_empty: bool, reach_m: f64) -> Option<Self> {
        let camera = &map.camera;
        let beside_is_empty = background_is_empty || map.mask.is_some();
        let hits = Hits::new(map)?;
        let focal = [camera.fx_px as f32, camera.fy_px as f32];
        let center = [camera.cx_px as f32, camera.cy_px as f32];
        let size = [camera.width_px as usize, camera.height_px as usize];
        let mut prepared = Self {
            camera_from_grid: (
                camera_from_grid.rotation.to_rotation_matrix().matrix().cast(),
                camera_from_grid.translation.vector.cast(),
            ),
            focal,
            center,
            size,
            window: Window { x: 0, y: 0, width: 0, height: 0 },
            pixels: Vec::new(),
            tiles: Vec::new(),
            beside_is_empty,
            noise_m: 0.0,
            radius: 0,
        };
        let smoother = hits.smoother(camera);
        let nearest = hits.depth.iter().copied().filter(|&z| z > 0.0).fold(f32::INFINITY, f32::min);
        let reach = (reach_m as f32 * focal[0].max(focal[1]) / nearest).ceil() as usize;
        let reach = reach.saturating_add(1).min(FARTHEST_PX);
        prepared.window = grown(&hits.window, reach + 1, size);
        prepared.noise_m = hits.noise_m;
        prepared.radius = smoother.radius;
        prepared.read(map, &hits, &smoother);
        if beside_is_empty {
            prepared.measure_silhouettes(reach);
        }
        prepared.tile();
        Some(prepared)
    }

    /// The pixel at a place of the image, if it is in the window.
    pub fn pixel(&self, x: usize, y: usize) -> Option<&Pixel> {
        let (x, y) = (x.wrapping_sub(self.window.x), y.wrapping_sub(self.window.y));
        (x < self.window.width && y < self.window.height).then(|| &self.pixels[y * self.window.width + x])
    }

    fn read(&mut self, map: &DepthMap, hits: &Hits, smoother: &Smoother) {
        let window = self.window;
        self.pixels.reserve_exact(window.width * window.height);
        for y in window.y..window.y + window.height {
            let ray_y = (y as f32 + 0.5 - self.center[1]) / self.focal[1];
            for x in window.x..window.x + window.width {
                let (in_x, in_y) = (x.wrapping_sub(hits.window.x), y.wrapping_sub(hits.window.y));
                let inside = in_x < hits.window.width && in_y < hits.window.height;
                let at = if inside { hits.index(in_x, in_y) } else { 0 };
                self.pixels.push(if hits.depth[at] > 0.0 {
                    let (z, slope) = hits.plane(at, smoother);
                    let ray_x = (x as f32 + 0.5 - self.center[0]) / self.focal[0];
                    let factor = slope.map_or(0.0, |s| plane_factor(z, s, self.focal, [ray_x, ray_y]));
                    Pixel { z, slope: slope.unwrap_or_default(), factor }
                } else {
                    let empty = match &map.mask {
                        Some(mask) => !mask[y * self.size[0] + x],
                        None => self.beside_is_empty,
                    };
                    Pixel { z: if empty { BACKGROUND } else { UNKNOWN }, slope: [0.0; 2], factor: f32::INFINITY }
                });
            }
        }
    }

    /// Distance of background pixels from the nearest other one, up to `reach`: first along columns, then across
    /// (Meijster, Roerdink and Hesselink 2000, with a search of bounded width).
    fn measure_silhouettes(&mut self, reach: usize) {
        let Window { width, height, .. } = self.window;
        let far = reach as u16 + 1;
        let mut column = vec![far; width * height];
        for x in 0..width {
            for (rows, back) in [((0..height).collect::<Vec<_>>(), true), ((0..height).rev().collect(), false)] {
                let mut distance = far;
                for y in rows {
                    let i = y * width + x;
                    distance = if self.pixels[i].z == BACKGROUND { (distance + 1).min(far) } else { 0 };
                    column[i] = if back { distance } else { column[i].min(distance) };
                }
            }
        }
        for y in 0..height {
            let line = &column[y * width..(y + 1) * width];
            for x in 0..width {
                let pixel = &mut self.pixels[y * width + x];
                if pixel.z != BACKGROUND {
                    continue;
                }
                let (from, to) = (x.saturating_sub(reach), (x + reach).min(width - 1));
                let square = (from..=to)
                    .filter(|&i| line[i] < far)
                    .map(|i| usize::from(line[i]).pow(2) + x.abs_diff(i).pow(2))
                    .min()
                    .filter(|&s| s <= reach * reach);
                // The silhouette runs half a pixel outside the centre of the last pixel.
                pixel.factor = square.map_or(f32::INFINITY, |s| (s as f32).sqrt() - 0.5);
            }
        }
    }

    fn tile(&mut self) {
        let across = self.window.width.div_ceil(TILE);
        self.tiles = vec![NO_PIXEL; across * self.window.height.div_ceil(TILE)];
        for (i, p) in self.pixels.iter().enumerate() {
            let tile = &mut self.tiles[i / self.window.width / TILE * across + i % self.window.width / TILE];
            if p.z > 0.0 {
                tile.nearest = tile.nearest.min(p.z);
                tile.farthest = tile.farthest.max(p.z);
            } else if p.z == UNKNOWN {
                tile.unknown = true;
            } else if p.factor.is_finite() {
                tile.rim = true;
            } else {
                tile.empty = true;
            }
        }
    }

    /// Extremes over a rectangle of the image, given by its inclusive corners in pixels.
    pub fn extremes(&self, lo: [isize; 2], hi: [isize; 2]) -> Tile {
        let mut out = NO_PIXEL;
        if lo[0] < 0 || lo[1] < 0 || hi[0] >= self.size[0] as isize || hi[1] >= self.size[1] as isize {
            out.unknown = true;
        }
        let (x, y) = (self.window.x as isize, self.window.y as isize);
        let (right, bottom) = (x + self.window.width as isize - 1, y + self.window.height as isize - 1);
        if lo[0] < x || lo[1] < y || hi[0] > right || hi[1] > bottom {
            out.empty |= self.beside_is_empty;
            out.unknown |= !self.beside_is_empty;
        }
        let (lo, hi) = ([lo[0].max(x), lo[1].max(y)], [hi[0].min(right), hi[1].min(bottom)]);
        if lo[0] > hi[0] || lo[1] > hi[1] {
            return out;
        }
        let across = self.window.width.div_ceil(TILE);
        let tile = |p: isize, first: isize| (p - first) as usize / TILE;
        for ty in tile(lo[1], y)..=tile(hi[1], y) {
            for t in &self.tiles[ty * across + tile(lo[0], x)..=ty * across + tile(hi[0], x)] {
                out.nearest = out.nearest.min(t.nearest);
                out.farthest = out.farthest.max(t.farthest);
                out.rim |= t.rim;
                out.empty |= t.empty;
                out.unknown |= t.unknown;
            }
        }
        out
    }
}

fn grown(window: &Window, by: usize, size: [usize; 2]) -> Window {
    let (x, y) = (window.x.saturating_sub(by), window.y.saturating_sub(by));
    let width = (window.x + window.width + by).min(size[0]) - x;
    let height = (window.y + window.height + by).min(size[1]) - y;
    Window { x, y, width, height }
}
