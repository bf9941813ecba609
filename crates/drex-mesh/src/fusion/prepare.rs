//! A depth map made ready for fusion: depths with tangent planes, and distances from silhouettes.

use nalgebra::{Matrix3, Vector3};

use drex_core::Pose;

use super::hits::{Raster, Sight, Smooth, Window};
use crate::depth::DepthMap;
use drex_core::simd::vectorised;

/// Side of a tile, pixels.
const TILE: usize = 4;
/// Pixels need not be closer together on the surface than this share of a voxel.
const SPACING: f32 = 0.7;
/// Farthest distance from a silhouette that is told apart, pixels.
const FARTHEST_PX: usize = 32;

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
    /// How far that is to be trusted; 1 for background.
    pub trust: f32,
}

impl Pixel {
    /// Depth, gradients, factor, trust.
    #[inline(always)]
    pub fn values(&self) -> [f32; 5] {
        [self.z, self.slope[0], self.slope[1], self.factor, self.trust]
    }
}

pub(super) const BACKGROUND: f32 = 0.0;
const UNKNOWN: f32 = -1.0;

/// A pixel whose ray meets nothing, far from any silhouette.
const EMPTY: Pixel = Pixel { z: BACKGROUND, slope: [0.0; 2], factor: f32::INFINITY, trust: 1.0 };
/// A pixel of which nothing is known.
const NOTHING: Pixel = Pixel { z: UNKNOWN, slope: [0.0; 2], factor: 0.0, trust: 0.0 };

/// Extremes of the pixels of a tile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tile {
    pub nearest: f32,
    pub farthest: f32,
    /// Smallest distance from a silhouette of pixels whose rays meet nothing, in pixels; infinite if there is none.
    pub rim_px: f32,
    /// Least trust in what is measured; 1 if nothing is.
    pub trust: f32,
    /// Pixels whose rays meet nothing.
    pub empty: bool,
    /// Pixels of which nothing is known.
    pub unknown: bool,
}

const NO_PIXEL: Tile =
    Tile { nearest: f32::INFINITY, farthest: 0.0, rim_px: f32::INFINITY, trust: 1.0, empty: false, unknown: false };

/// A depth map ready for fusion, at every pixel or, where those are much finer than the voxels, at those of a raster: then
/// it is like the map of a camera with larger pixels, and they are meant below. Beside the kept window there is background, or nothing is known.
#[derive(Debug)]
pub(super) struct Prepared {
    pub camera_from_grid: (Matrix3<f32>, Vector3<f32>),
    pub focal: [f32; 2],
    pub center: [f32; 2],
    pub size: [usize; 2],
    /// Whether rays beside the window are empty (else nothing is known of them).
    pub beside_is_empty: bool,
    window: Window,
    /// The pixels of the window, one for those beside it and one for those outside the image.
    pub pixels: Vec<Pixel>,
    tiles: Vec<Tile>,
}

impl Prepared {
    /// Prepares a checked map for voxels of `voxel_m`. `reach_m`: how far from a silhouette distances are wanted.
    pub fn new(
        map: &DepthMap,
        sight: &Sight,
        camera_from_grid: &Pose,
        background_is_empty: bool,
        voxel_m: f64,
        reach_m: f64,
    ) -> Self {
        let camera = &map.camera;
        let footprint = sight.footprint_m(camera);
        let step = (SPACING * voxel_m as f32 / footprint) as usize;
        let step = step.min(sight.window.width).min(sight.window.height).max(1);
        let raster = Raster { step };
        let coarser = 1.0 / step as f32;
        let focal = [camera.fx_px as f32 * coarser, camera.fy_px as f32 * coarser];
        let size = [raster.before(camera.width_px as usize), raster.before(camera.height_px as usize)];
        // Centres of pixels are at halves.
        let center = [camera.cx_px, camera.cy_px].map(|c| (c as f32 - raster.pixel(0) as f32 - 0.5) * coarser + 0.5);
        // Where the surface is nearer than usual, a length covers more pixels than there, and less of it is told apart.
        let reach = (1.25 * reach_m as f32 * coarser / footprint).ceil() as usize;
        let reach = reach.saturating_add(1).min(FARTHEST_PX);
        let smooth = vectorised(
            #[inline(always)]
            || Smooth::new(map, sight, raster),
        );
        let window = grown(&smooth.window, reach + 1, size);
        let beside_is_empty = background_is_empty || map.mask.is_some();
        let mut prepared = Self {
            camera_from_grid: (
                camera_from_grid.rotation.to_rotation_matrix().matrix().cast(),
                camera_from_grid.translation.vector.cast(),
            ),
            focal,
            center,
            size,
            beside_is_empty,
            window,
            pixels: Vec::new(),
            tiles: Vec::new(),
        };
        vectorised(
            #[inline(always)]
            || {
                prepared.read_background(map, raster);
                prepared.read_hits(&smooth, map, raster);
                if prepared.beside_is_empty {
                    prepared.measure_silhouettes(reach);
                }
                prepared.tile();
            },
        );
        prepared.pixels.extend([if beside_is_empty { EMPTY } else { NOTHING }, NOTHING]);
        prepared
    }

    /// Where among the pixels that of a column and row is.
    #[inline(always)]
    pub fn place(&self, column: i32, row: i32) -> u32 {
        let [width, height] = self.size.map(|n| n as u32);
        let in_image = ((column as u32) < width) & ((row as u32) < height);
        let (x, y) =
            ((column as u32).wrapping_sub(self.window.x as u32), (row as u32).wrapping_sub(self.window.y as u32));
        let (width, height) = (self.window.width as u32, self.window.height as u32);
        let beside = width * height + u32::from(!in_image);
        if (x < width) & (y < height) { y * width + x } else { beside }
    }

    #[inline(always)]
    fn read_background(&mut self, map: &DepthMap, raster: Raster) {
        let Window { x, y, width, height } = self.window;
        let pixel = |empty: bool| if empty { EMPTY } else { NOTHING };
        self.pixels = match &map.mask {
            None => vec![pixel(self.beside_is_empty); width * height],
            Some(mask) => (y..y + height)
                .flat_map(|row| {
                    let from = raster.pixel(row) * map.camera.width_px as usize + raster.pixel(x);
                    mask[from..].iter().step_by(raster.step).take(width)
                })
                .map(|inside| if *inside { NOTHING } else { EMPTY })
                .collect(),
        };
    }

    #[inline(always)]
    fn read_hits(&mut self, hits: &Smooth, map: &DepthMap, raster: Raster) {
        let n = hits.window.width;
        let (mut along, mut down, mut factor) = (vec![0.0_f32; n], vec![0.0_f32; n], vec![0.0_f32; n]);
        let [fx, fy] = self.focal;
        for row in 0..hits.window.height {
            let at = hits.index(0, row);
            let z = &hits.depth[at..at + n];
            hits.gradients(at, 1, &mut along);
            hits.gradients(at, hits.stride, &mut down);
            let ray_y = ((hits.window.y + row) as f32 + 0.5 - self.center[1]) / fy;
            let first_x = (hits.window.x as f32 + 0.5 - self.center[0]) / fx;
            for x in 0..n {
                let ray_x = first_x + x as f32 / fx;
                let found = (along[x] + down[x]).is_finite();
                factor[x] = plane_factor(z[x], [fx * along[x], fy * down[x]], [ray_x, ray_y]);
                factor[x] = if found { factor[x] } else { 0.0 };
                along[x] = if found { along[x] } else { 0.0 };
                down[x] = if found { down[x] } else { 0.0 };
            }
            let to = (hits.window.y - self.window.y + row) * self.window.width + hits.window.x - self.window.x;
            let from = raster.pixel(hits.window.y + row) * map.camera.width_px as usize;
            for (x, out) in self.pixels[to..to + n].iter_mut().enumerate() {
                if z[x] > 0.0 {
                    let trust = map.trust.as_ref().map_or(1.0, |c| c[from + raster.pixel(hits.window.x + x)]);
                    *out = Pixel { z: z[x], slope: [along[x], down[x]], factor: factor[x], trust };
                }
            }
        }
    }

    /// Distance of background pixels from the nearest other one, up to `reach`: first along columns, then across
    /// (Meijster, Roerdink and Hesselink 2000, with a search of bounded width).
    #[inline(always)]
    fn measure_silhouettes(&mut self, reach: usize) {
        let Window { width, height, .. } = self.window;
        let far = reach as i16 + 1;
        let mut column = vec![far; width * height];
        for y in 0..height {
            let (above, line) = column.split_at_mut(y * width);
            let above = above.rchunks_exact(width).next();
            for x in 0..width {
                let distance = above.map_or(far, |a| (a[x] + 1).min(far));
                line[x] = if self.pixels[y * width + x].z == BACKGROUND { distance } else { 0 };
            }
        }
        for y in (1..height).rev() {
            let (above, line) = column.split_at_mut(y * width);
            let above = &mut above[(y - 1) * width..];
            above.iter_mut().zip(line).for_each(|(a, l)| *a = (*a).min(*l + 1));
        }
        let none = i16::MAX - far * far;
        let mut squares = vec![none; width + 2 * reach];
        let mut nearest = vec![none; width];
        for y in 0..height {
            let line = &column[y * width..(y + 1) * width];
            if line.iter().all(|&d| d == far) {
                continue;
            }
            for (square, &d) in squares[reach..].iter_mut().zip(line) {
                *square = if d < far { d * d } else { none };
            }
            nearest.fill(none);
            for shift in 0..=2 * reach {
                let aside = (shift.abs_diff(reach) as i16).pow(2);
                for (best, square) in nearest.iter_mut().zip(&squares[shift..]) {
                    *best = (*best).min(*square + aside);
                }
            }
            for (pixel, &square) in self.pixels[y * width..(y + 1) * width].iter_mut().zip(&nearest) {
                // The silhouette runs half a pixel outside the centre of the last pixel.
                if pixel.z == BACKGROUND && usize::from(square.unsigned_abs()) <= reach * reach {
                    pixel.factor = f32::from(square).sqrt() - 0.5;
                }
            }
        }
    }

    #[inline(always)]
    fn tile(&mut self) {
        let across = self.window.width.div_ceil(TILE);
        self.tiles = vec![NO_PIXEL; across * self.window.height.div_ceil(TILE)];
        for (y, line) in self.pixels.chunks_exact(self.window.width).enumerate() {
            for (tile, pixels) in self.tiles[y / TILE * across..].iter_mut().zip(line.chunks(TILE)) {
                // A copy, so that it is written once and not after each pixel.
                let mut t = *tile;
                for p in pixels {
                    let (hit, background) = (p.z > 0.0, p.z == BACKGROUND);
                    t.rim_px = if background & (p.factor < t.rim_px) { p.factor } else { t.rim_px };
                    t.nearest = if hit & (p.z < t.nearest) { p.z } else { t.nearest };
                    t.farthest = if p.z > t.farthest { p.z } else { t.farthest };
                    t.trust = if hit & (p.trust < t.trust) { p.trust } else { t.trust };
                    t.empty |= background;
                    t.unknown |= !hit & !background;
                }
                *tile = t;
            }
        }
    }

    /// Extremes over a rectangle of the image, given by its inclusive corners in pixels.
    #[inline(always)]
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
                out.rim_px = out.rim_px.min(t.rim_px);
                out.trust = out.trust.min(t.trust);
                out.empty |= t.empty;
                out.unknown |= t.unknown;
            }
        }
        out
    }
}

/// What turns a difference of depths on one ray into a distance from the tangent plane: with the ray r = (x, y, 1) and the
/// unit normal n of the surface z(u, v), |n · r| = z / |(f_x z_u, f_y z_v, z + x f_x z_u + y f_y z_v)|.
/// `rise` is (f_x z_u, f_y z_v).
#[inline(always)]
pub(super) fn plane_factor(z: f32, rise: [f32; 2], ray: [f32; 2]) -> f32 {
    let along = z + ray[0] * rise[0] + ray[1] * rise[1];
    z / (rise[0] * rise[0] + rise[1] * rise[1] + along * along).sqrt()
}

fn grown(window: &Window, by: usize, size: [usize; 2]) -> Window {
    let (x, y) = (window.x.saturating_sub(by), window.y.saturating_sub(by));
    let width = (window.x + window.width + by).min(size[0]) - x;
    let height = (window.y + window.height + by).min(size[1]) - y;
    Window { x, y, width, height }
}
