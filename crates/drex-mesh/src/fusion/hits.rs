//! The depths of the object in one map: where they are, how noisy, smoothed, with gradients.

use crate::depth::{DepthCamera, DepthMap};
use drex_core::simd::vectorised;

/// Largest half-width of the smoothing window, pixels.
const LARGEST_RADIUS: usize = 3;
/// Zeros around the window, so that neighbours can be read without asking.
const BORDER: usize = LARGEST_RADIUS;
/// Noise that smoothing aims at, in footprints of a pixel.
const NOISE_GOAL: f32 = 0.5;
/// Noise, in footprints of a pixel, up to which nothing is smoothed and the difference of two neighbours tells the slope.
const PRECISE: f32 = 0.1;
/// Second differences beyond this many standard deviations are no noise but an edge.
const GATE: f32 = 3.5;
/// A slope of more than this many footprints per pixel (84 degrees from frontal) is a jump.
const STEEPEST: f32 = 10.0;
/// Pixels looked at to learn about depth and noise.
const PROBES: u64 = 1024;

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

impl Window {
    #[inline(always)]
    fn around_object(map: &DepthMap) -> Option<Self> {
        let width = map.camera.width_px as usize;
        let (mut x, mut y) = ((width, 0), (usize::MAX, 0));
        let depths = map.depth_m.chunks_exact(width).enumerate();
        for (row, line) in depths {
            let ends = match &map.mask {
                Some(mask) => ends(&mask[row * width..][..width], |inside| inside),
                None => ends(line, is_depth),
            };
            if let Some((first, last)) = ends {
                x = (x.0.min(first), x.1.max(last));
                y = (y.0.min(row), row);
            }
        }
        (x.0 <= x.1).then(|| Self { x: x.0, y: y.0, width: x.1 + 1 - x.0, height: y.1 + 1 - y.0 })
    }
}

/// The first and the last place in a row that is wanted.
#[inline(always)]
fn ends<T: Copy>(line: &[T], wanted: impl Fn(T) -> bool + Copy) -> Option<(usize, usize)> {
    /// Whole chunks first: most of an image is background.
    const CHUNK: usize = 128;
    let any = |chunk: &[T]| chunk.iter().fold(false, |any, &z| any | wanted(z));
    let mut chunks = line.chunks(CHUNK);
    let (left, right) = (chunks.clone().position(any)?, chunks.rposition(any)?);
    let first = left * CHUNK + line[left * CHUNK..].iter().position(|&z| wanted(z))?;
    let end = ((right + 1) * CHUNK).min(line.len());
    Some((first, line[..end].iter().rposition(|&z| wanted(z))?))
}

/// Where the object is in a map, and how it was measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    /// The rectangle around the mask, or around the pixels with depth.
    pub window: Window,
    /// Median depth, metres.
    pub depth_m: f32,
    /// Standard deviation of the noise of a single depth, metres.
    pub noise_m: f32,
}

#[inline(always)]
fn is_depth(z: f32) -> bool {
    // The bits of positive finite numbers are between 0 and those of infinity.
    (z.to_bits().wrapping_sub(1)) < f32::INFINITY.to_bits() - 1
}

impl Sight {
    /// Looks at a map that was checked; `None` if there is no depth of the object.
    pub fn new(map: &DepthMap) -> Option<Self> {
        let window = vectorised(
            #[inline(always)]
            || Window::around_object(map),
        )?;
        let (depth_m, noise_m) = measure(map, &window)?;
        Some(Self { window, depth_m, noise_m })
    }

    /// Whether a map is as usable as the one that was looked at.
    pub fn fits(&self, map: &DepthMap) -> bool {
        let Window { x, y, width, height } = self.window;
        map.check().is_ok() && x + width <= map.camera.width_px as usize && y + height <= map.camera.height_px as usize
    }

    /// Width of a pixel on the surface, metres.
    pub fn footprint_m(&self, camera: &DepthCamera) -> f32 {
        self.depth_m / camera.fx_px.max(camera.fy_px) as f32
    }

    /// Half-width of the smoothing window, pixels; 0 for none.
    fn radius(&self, camera: &DepthCamera) -> usize {
        let footprint = self.footprint_m(camera);
        if self.noise_m < PRECISE * footprint {
            return 0;
        }
        // The mean of (2 r + 1)² values has 1 / (2 r + 1) of the noise.
        let wanted = 0.5 * (self.noise_m / (NOISE_GOAL * footprint) - 1.0);
        (wanted.ceil() as usize).clamp(1, LARGEST_RADIUS)
    }

    /// Mean of two depths minus the one in the middle, `step` pixels from both, beyond which they are on no line, metres.
    fn gate(&self, camera: &DepthCamera, step: usize) -> f32 {
        // Rounding and curvature look like a little noise even in a perfect map.
        GATE * 1.5_f32.sqrt() * self.noise_m.max(0.01 * step as f32 * self.footprint_m(camera))
    }
}

/// Median depth and noise. The second difference of independent noise has 6 times its variance; the largest tenth (edges,
/// jumps) is left out, which for a normal distribution keeps 0.6237 of the mean square.
fn measure(map: &DepthMap, window: &Window) -> Option<(f32, f32)> {
    const KEPT_SHARE: f32 = 0.6237;
    let width = map.camera.width_px as usize;
    let depth = |i: usize| {
        let z = map.depth_m.get(i).copied().unwrap_or(0.0);
        if is_depth(z) && map.mask.as_ref().is_none_or(|m| m[i]) { z } else { 0.0 }
    };
    let n = (window.width * window.height) as u64;
    let (mut depths, mut squares) = (Vec::new(), Vec::new());
    for k in 0..PROBES {
        // All pixels of a small window, else places spread evenly (multiples of the golden ratio).
        let i = if n <= PROBES { k } else { ((k.wrapping_mul(0x9e37_79b9) & 0xffff_ffff) * n) >> 32 } as usize;
        if i as u64 >= n {
            break;
        }
        let at = (window.y + i / window.width) * width + window.x + i % window.width;
        let z = depth(at);
        if z > 0.0 {
            depths.push(z);
            let (before, after) = (depth(at.wrapping_sub(1)), depth(at + 1));
            if before > 0.0 && after > 0.0 {
                squares.push((before - 2.0 * z + after).powi(2));
            }
        }
    }
    let middle = depths.len() / 2;
    let typical = (middle < depths.len()).then(|| *depths.select_nth_unstable_by(middle, f32::total_cmp).1);
    // A few pixels in a large window can all be missed.
    let typical = typical.or_else(|| (0..map.depth_m.len()).map(depth).find(|&z| z > 0.0))?;
    let kept = squares.len() * 9 / 10;
    let mut noise = 0.0;
    if kept > 0 {
        squares.select_nth_unstable_by(kept, f32::total_cmp);
        noise = (squares[..kept].iter().sum::<f32>() / kept as f32 / (6.0 * KEPT_SHARE)).sqrt();
    }
    Some((typical, noise))
}

/// The depths of a window with zeros where there is none.
pub(super) struct Hits {
    pub window: Window,
    pub depth: Vec<f32>,
    pub stride: usize,
    /// Half-width of the smoothing window, pixels; 0 for none.
    radius: usize,
    gate: f32,
    per_z: f32,
}

impl Hits {
    /// The depths of the object that were sighted in a map.
    #[inline(always)]
    pub fn new(map: &DepthMap, sight: &Sight) -> Self {
        let (window, width) = (sight.window, map.camera.width_px as usize);
        let stride = window.width + 2 * BORDER;
        let mut depth = vec![0.0; stride * (window.height + 2 * BORDER)];
        for row in 0..window.height {
            let from = (window.y + row) * width + window.x;
            let to = (row + BORDER) * stride + BORDER;
            let (line, out) = (&map.depth_m[from..from + window.width], &mut depth[to..to + window.width]);
            for (out, &z) in out.iter_mut().zip(line) {
                *out = if is_depth(z) { z } else { 0.0 };
            }
            if let Some(mask) = &map.mask {
                for (out, inside) in out.iter_mut().zip(&mask[from..from + window.width]) {
                    *out = if *inside { *out } else { 0.0 };
                }
            }
        }
        let per_z = 1.0 / map.camera.fx_px.max(map.camera.fy_px) as f32;
        Self { window, depth, stride, radius: sight.radius(&map.camera), gate: sight.gate(&map.camera, 1), per_z }
    }

    pub fn index(&self, x: usize, y: usize) -> usize {
        (y + BORDER) * self.stride + x + BORDER
    }

    /// Depth and gradients at one hit pixel: the plane through the pairs of opposite neighbours that lie on a line with it.
    pub fn plane(&self, at: usize) -> Option<(f32, [f32; 2])> {
        let (z, radius) = (self.depth[at], self.radius.max(1) as isize);
        let (mut bend, mut count) = (0.0_f32, 0.0_f32);
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
        for (dx, dy) in half_window(radius) {
            let shift = dy * self.stride as isize + dx;
            let (a, b) = (self.depth[at.wrapping_add_signed(shift)], self.depth[at.wrapping_add_signed(-shift)]);
            let off = 0.5 * (a + b) - z;
            if a > 0.0 && b > 0.0 && off.abs() < self.gate {
                let (x, y, half) = (dx as f32, dy as f32, 0.5 * (a - b));
                bend += off;
                count += 1.0;
                xx += x * x;
                xy += x * y;
                yy += y * y;
                xz += x * half;
                yz += y * half;
            }
        }
        let det = xx * yy - xy * xy;
        let slope = [(yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det];
        let steepest = STEEPEST * self.per_z * z;
        let smooth = if self.radius == 0 { z } else { z + 2.0 * bend / (1.0 + 2.0 * count) };
        (det > 0.5 && slope.iter().all(|s| s.abs() < steepest)).then_some((smooth, slope))
    }
}

/// Every `step`-th column and row of the pixels of a map: pixel `i` of the raster is pixel `step i + step / 2` of the map.
#[derive(Debug, Clone, Copy)]
pub(super) struct Raster {
    pub step: usize,
}

impl Raster {
    /// The pixel of the map.
    pub fn pixel(self, i: usize) -> usize {
        self.step * i + self.step / 2
    }

    /// How many pixels of the raster come before a pixel of the map.
    pub fn before(self, pixel: usize) -> usize {
        pixel.saturating_sub(self.step / 2).div_ceil(self.step)
    }

    /// The pixels of the raster in a window that is at least `step` pixels wide and high.
    fn window(self, w: &Window) -> Window {
        let (x, y) = (self.before(w.x), self.before(w.y));
        Window { x, y, width: self.before(w.x + w.width) - x, height: self.before(w.y + w.height) - y }
    }
}

/// Smoothed depths at the pixels of a raster, with zeros where there is none and around them.
pub(super) struct Smooth {
    /// In pixels of the raster.
    pub window: Window,
    pub depth: Vec<f32>,
    pub stride: usize,
    /// How far the neighbours are whose difference tells the slope, pixels of the raster.
    reach: usize,
    /// Whether the difference to one neighbour tells the slope.
    precise: bool,
    gate: f32,
    per_z: f32,
}

impl Smooth {
    /// The depths of the object that were sighted in a map; neighbours in the map smooth them, in the raster or not.
    #[inline(always)]
    pub fn new(map: &DepthMap, sight: &Sight, raster: Raster) -> Self {
        let (window, radius) = (raster.window(&sight.window), sight.radius(&map.camera));
        let stride = window.width + 2 * BORDER;
        let mut out = Self {
            window,
            depth: vec![0.0; stride * (window.height + 2 * BORDER)],
            stride,
            reach: radius.div_ceil(raster.step).max(1),
            precise: radius == 0,
            gate: sight.gate(&map.camera, raster.step),
            per_z: raster.step as f32 / map.camera.fx_px.max(map.camera.fy_px) as f32,
        };
        if radius == 0 {
            for row in 0..window.height {
                let at = out.index(0, row);
                let line = &mut out.depth[at..at + window.width];
                read(map, raster.pixel(window.y + row), raster.pixel(window.x), raster.step, line);
            }
        } else {
            out.smooth(map, sight, raster, radius);
        }
        out
    }

    pub fn index(&self, x: usize, y: usize) -> usize {
        (y + BORDER) * self.stride + x + BORDER
    }

    /// Every depth as the mean over the pairs of opposite neighbours that lie on a line with it: such a mean is not drawn to
    /// either side, whatever the slope, and it stops at edges.
    #[inline(always)]
    fn smooth(&mut self, map: &DepthMap, sight: &Sight, raster: Raster, radius: usize) {
        let (n, step, aside) = (self.window.width, raster.step, radius.div_ceil(raster.step));
        let fine = Phases::new(map, sight, raster, &self.window, radius);
        let shifts: Vec<(isize, isize)> = half_window(radius as isize).collect();
        let (mut bend, mut count) = (vec![0.0_f32; n], vec![0.0_f32; n]);
        for y in 0..self.window.height {
            let line = |dx: isize, dy: isize| {
                let row = (radius + step * y).wrapping_add_signed(dy);
                let column = (step * aside).wrapping_add_signed(dx);
                &fine.depth[(row * step + column % step) * fine.stride + column / step..][..n]
            };
            let z = line(0, 0);
            bend.fill(0.0);
            count.fill(0.0);
            for &(dx, dy) in &shifts {
                let (a, b) = (line(dx, dy), line(-dx, -dy));
                for x in 0..n {
                    let off = 0.5 * (a[x] + b[x]) - z[x];
                    let flat = (a[x] > 0.0) & (b[x] > 0.0) & (off.abs() < self.gate);
                    bend[x] += if flat { off } else { 0.0 };
                    count[x] += if flat { 1.0 } else { 0.0 };
                }
            }
            let at = self.index(0, y);
            for (x, out) in self.depth[at..at + n].iter_mut().enumerate() {
                *out = if z[x] > 0.0 { z[x] + 2.0 * bend[x] / (1.0 + 2.0 * count[x]) } else { 0.0 };
            }
        }
    }

    /// Slope of smoothed depths along columns (`step` 1) or rows (`step` the stride) at `out.len()` pixels from `at`,
    /// metres per pixel of the raster; NaN where there is none.
    #[inline(always)]
    pub fn gradients(&self, at: usize, step: usize, out: &mut [f32]) {
        let (n, reach) = (out.len(), self.reach);
        let line = |from: usize| &self.depth[from..from + n];
        let (before, here, after) = (line(at - reach * step), line(at), line(at + reach * step));
        let per = 1.0 / reach as f32;
        for x in 0..n {
            let (a, z, b) = (before[x], here[x], after[x]);
            let steepest = STEEPEST * self.per_z * z;
            let (left, right) = ((z - a) * per, (b - z) * per);
            let left_ok = (a > 0.0) & (left.abs() < steepest);
            let right_ok = (b > 0.0) & (right.abs() < steepest);
            let flat = left_ok & right_ok & ((b - z - (z - a)).abs() < 2.0 * self.gate);
            // At an edge, the side with the smaller difference: the other one may lie beyond it.
            let smaller = if left_ok & (!right_ok | (left.abs() < right.abs())) { left } else { right };
            let one_sided = if self.precise & (left_ok | right_ok) { smaller } else { f32::NAN };
            out[x] = if flat { 0.5 * (left + right) } else { one_sided };
        }
    }
}

/// All depths around the pixels of a raster. Each row is split into `step` lines, so that what is equally far from the
/// pixels of the raster lies side by side.
struct Phases {
    depth: Vec<f32>,
    /// Length of a line.
    stride: usize,
}

impl Phases {
    #[inline(always)]
    fn new(map: &DepthMap, sight: &Sight, raster: Raster, window: &Window, radius: usize) -> Self {
        let (step, aside) = (raster.step, radius.div_ceil(raster.step));
        let stride = window.width + 2 * aside;
        let rows = step * (window.height - 1) + 2 * radius + 1;
        let mut depth = vec![0.0; rows * step * stride];
        let inside = &sight.window;
        // The first line of a row begins here, `right` pixels beside the image.
        let (left, right) = (raster.pixel(window.x), step * aside);
        for (row, lines) in depth.chunks_exact_mut(step * stride).enumerate() {
            let y = (raster.pixel(window.y) + row).wrapping_sub(radius);
            if y < inside.y || y >= inside.y + inside.height {
                continue;
            }
            for (phase, line) in lines.chunks_exact_mut(stride).enumerate() {
                // Columns of the line that are in the window: left - right + phase + step i.
                let first = (inside.x + right).saturating_sub(left + phase).div_ceil(step);
                let end = (inside.x + inside.width + right).saturating_sub(left + phase).div_ceil(step).min(stride);
                if first < end {
                    read(map, y, left + phase + step * first - right, step, &mut line[first..end]);
                }
            }
        }
        Self { depth, stride }
    }
}

/// Reads every `step`-th depth of the object from a pixel on, 0 where there is none.
#[inline(always)]
fn read(map: &DepthMap, row: usize, column: usize, step: usize, out: &mut [f32]) {
    let from = row * map.camera.width_px as usize + column;
    for (out, &z) in out.iter_mut().zip(map.depth_m[from..].iter().step_by(step)) {
        *out = if is_depth(z) { z } else { 0.0 };
    }
    if let Some(mask) = &map.mask {
        for (out, inside) in out.iter_mut().zip(mask[from..].iter().step_by(step)) {
            *out = if *inside { *out } else { 0.0 };
        }
    }
}

/// Half of the offsets of a square window: the other half are the opposite ones.
fn half_window(radius: isize) -> impl Iterator<Item = (isize, isize)> {
    (0..=radius).flat_map(move |dy| (-radius..=radius).map(move |dx| (dx, dy))).filter(|&(dx, dy)| dy > 0 || dx > 0)
}
