//! Grey pictures at several sizes, and the form in which the kernel reads them.

use drex_core::stats::quantile;

/// Of the rounding to whole levels.
pub(crate) const LEAST_NOISE: f64 = 0.29;
/// Of a photo that one would still compare.
const MOST_NOISE: f64 = 3.0;

/// A grey picture, row by row; the centre of the first pixel is at (0, 0) in this crate's computations.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Grey {
    pub width: usize,
    pub height: usize,
    pub values: Vec<u8>,
}

impl Grey {
    /// Rec. 601 luma of the colours as they are stored: correlation does not mind their curve.
    pub fn from_rgb(width: usize, height: usize, rgb: impl Iterator<Item = [u8; 3]>) -> Self {
        let luma = |[r, g, b]: [u8; 3]| ((u32::from(r) * 77 + u32::from(g) * 150 + u32::from(b) * 29 + 128) >> 8) as u8;
        Self { width, height, values: rgb.map(luma).collect() }
    }

    /// Half the size; each pixel the mean of four. An odd last column or row is left out.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            let (upper, lower) = (&self.values[2 * y * self.width..], &self.values[(2 * y + 1) * self.width..]);
            for x in 0..width {
                let sum = [upper[2 * x], upper[2 * x + 1], lower[2 * x], lower[2 * x + 1]].map(u32::from);
                values.push(((sum.iter().sum::<u32>() + 2) / 4) as u8);
            }
        }
        Self { width, height, values }
    }

    /// Standard deviation of the noise, grey levels: by the second differences along the rows of small blocks, in the fifth of them that vary
    /// least, for the others show something; no more than [`MOST_NOISE`], for where all blocks do.
    pub fn noise(&self) -> f32 {
        const SIDE: usize = 8;
        let mut variances = Vec::new();
        for y in (0..self.height.saturating_sub(SIDE - 1)).step_by(SIDE) {
            for x in (0..self.width.saturating_sub(SIDE - 1)).step_by(SIDE) {
                let mut sum = 0;
                for row in self.values.chunks_exact(self.width).skip(y).take(SIDE) {
                    for w in row[x..x + SIDE].windows(3) {
                        sum += (i32::from(w[0]) - 2 * i32::from(w[1]) + i32::from(w[2])).pow(2);
                    }
                }
                // 6 is the sum of the squares of (1, -2, 1).
                variances.push(f64::from(sum) / (6 * SIDE * (SIDE - 2)) as f64);
            }
        }
        quantile(variances, 0.2).unwrap_or(0.0).sqrt().clamp(LEAST_NOISE, MOST_NOISE) as f32
    }
}

/// A picture with each pixel's right, lower and lower right neighbour beside it, so that one read serves to interpolate.
#[derive(Debug)]
pub(crate) struct Quads {
    /// Places below these, both ways, lie between four pixels.
    pub limit: [f32; 2],
    pub stride: i32,
    pub values: Vec<u32>,
}

impl Quads {
    pub fn new(picture: &Grey) -> Self {
        let (w, h) = (picture.width, picture.height);
        let mut values = Vec::with_capacity(w * h);
        for y in 0..h {
            let row = &picture.values[y * w..][..w];
            let below = &picture.values[(y + 1).min(h - 1) * w..][..w];
            for x in 0..w {
                let next = (x + 1).min(w - 1);
                values.push(u32::from_le_bytes([row[x], row[next], below[x], below[next]]));
            }
        }
        Self { limit: [w as f32 - 1.0, h as f32 - 1.0], stride: w as i32, values }
    }
}

/// Where something is asked for, one byte a pixel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Area {
    pub width: usize,
    pub height: usize,
    pub inside: Vec<bool>,
}

impl Area {
    /// Half the size; a pixel is inside where one of its four is.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let at = |x: usize, y: usize| self.inside[y * self.width + x];
        let any = |i: usize| {
            let (x, y) = (2 * (i % width), 2 * (i / width));
            at(x, y) || at(x + 1, y) || at(x, y + 1) || at(x + 1, y + 1)
        };
        Self { width, height, inside: (0..width * height).map(any).collect() }
    }

    /// Grown by `radius` pixels along both axes.
    pub fn grown(&self, radius: usize) -> Self {
        let (w, h) = (self.width, self.height);
        let mut along = vec![false; w * h];
        for y in 0..h {
            let row = &self.inside[y * w..][..w];
            for x in 0..w {
                along[y * w + x] = row[x.saturating_sub(radius)..(x + radius + 1).min(w)].contains(&true);
            }
        }
        let inside = (0..w * h)
            .map(|i| {
                let (x, y) = (i % w, i / w);
                (y.saturating_sub(radius)..(y + radius + 1).min(h)).any(|y| along[y * w + x])
            })
            .collect();
        Self { width: w, height: h, inside }
    }
}

/// The sum over a square of 2 `reach` + 1 pixels round each; what is beyond the rim is 0.
pub(crate) fn box_sum(values: &mut [f32], width: usize, height: usize, reach: usize) {
    let mut line = vec![0.0; width + 2 * reach];
    for row in values.chunks_exact_mut(width) {
        line[reach..reach + width].copy_from_slice(row);
        for (x, out) in row.iter_mut().enumerate() {
            *out = line[x..=x + 2 * reach].iter().sum();
        }
    }
    let whole = values.to_vec();
    for (y, out) in values.chunks_exact_mut(width).enumerate() {
        out.fill(0.0);
        for from in y.saturating_sub(reach)..(y + reach + 1).min(height) {
            out.iter_mut().zip(&whole[from * width..]).for_each(|(o, v)| *o += v);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ramp with noise of a deviation, by a sum of four uniform numbers; its right part in stripes.
    fn noisy(deviation: f32, stripes_from: usize) -> Grey {
        let (width, height) = (160, 120);
        let mut state = 1u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32 - 0.5
        };
        let values = (0..width * height).map(|i| {
            let x = i % width;
            let stripes = if x >= stripes_from { 60.0 * (x % 2) as f32 } else { 0.0 };
            let noise = 3f32.sqrt() * (uniform() + uniform() + uniform() + uniform());
            (60.0 + 0.3 * x as f32 + stripes + deviation * noise + 0.5) as u8
        });
        Grey { width, height, values: values.collect() }
    }

    #[test]
    fn noise_is_that_of_what_shows_nothing() {
        for deviation in [1.0, 2.0] {
            for stripes_from in [160, 80] {
                let found = noisy(deviation, stripes_from).noise();
                assert!((0.75..1.1).contains(&(found / deviation)), "{found} for {deviation}, {stripes_from}");
            }
        }
        assert_eq!(noisy(0.0, 0).noise(), MOST_NOISE as f32, "stripes everywhere");
        assert_eq!(Grey { width: 16, height: 16, values: vec![7; 256] }.noise(), LEAST_NOISE as f32);
    }
}
