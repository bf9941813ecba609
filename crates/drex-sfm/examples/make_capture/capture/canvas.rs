//! A picture while it is drawn: fills, strokes, made-up letters, noise, and the pyramid at the end.

use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::paint::{Colour, Level, Picture};
use super::{hash, hash01};

/// A picture while it is drawn: a torus of texels.
pub struct Canvas {
    columns: usize,
    rows: usize,
    pub(super) size_m: [f64; 2],
    pub(super) texel_m: [f64; 2],
    pub(super) texels: Vec<Colour>,
}

impl Canvas {
    /// An empty canvas in one colour.
    #[must_use]
    pub fn new(size_m: [f64; 2], texel_m: f64, ground: Colour) -> Self {
        let [columns, rows] = size_m.map(|s| ((s / texel_m).ceil() as usize).max(4));
        let texel_m = [size_m[0] / columns as f64, size_m[1] / rows as f64];
        Self { columns, rows, size_m, texel_m, texels: vec![ground; columns * rows] }
    }

    /// Fills where `distance` (metres from `centre`, negative inside) is negative; nothing reaches beyond `reach_m`.
    pub fn fill(&mut self, centre: Vector2<f64>, reach_m: f64, colour: Colour, distance: impl Fn(Vector2<f64>) -> f64) {
        let [tx, ty] = self.texel_m;
        let span = |c: f64, t: f64, n: usize| {
            let low = ((c - reach_m) / t).floor() as isize;
            low..=(((c + reach_m) / t).ceil() as isize).min(low + n as isize - 1)
        };
        for y in span(centre.y, ty, self.rows) {
            let row = y.rem_euclid(self.rows as isize) as usize * self.columns;
            for x in span(centre.x, tx, self.columns) {
                let at = Vector2::new((x as f64 + 0.5) * tx, (y as f64 + 0.5) * ty) - centre;
                let cover = (0.5 - distance(at) / tx).clamp(0.0, 1.0) as f32;
                if cover > 0.0 {
                    let texel = &mut self.texels[row + x.rem_euclid(self.columns as isize) as usize];
                    for c in 0..3 {
                        texel[c] += cover * (colour[c] - texel[c]);
                    }
                }
            }
        }
    }

    /// A made-up letter: three to five strokes between the points of a grid of 3 x 4.
    pub(super) fn letter(&mut self, corner: Vector2<f64>, height_m: f64, along: Vector2<f64>, shape: u64, ink: Colour) {
        let down = Vector2::new(-along.y, along.x);
        let knot = |k: u64| {
            let (i, j) = (k % 3, k / 3 % 4);
            corner + along * (0.27 * height_m * i as f64) + down * (height_m * j as f64 / 3.0)
        };
        let bold = 0.05 + 0.04 * hash01(shape ^ 0x51) as f64;
        let mut from = hash(shape) % 12;
        for stroke in 0..3 + hash(shape ^ 7) % 3 {
            let to = (from + 1 + hash(shape ^ (stroke + 11)) % 11) % 12;
            self.stroke(knot(from), knot(to), bold * height_m, ink);
            // Most letters are drawn without lifting the pen.
            from = if hash01(shape ^ (stroke + 31)) < 0.7 { to } else { hash(shape ^ (stroke + 57)) % 12 };
        }
    }

    pub(super) fn stroke(&mut self, from: Vector2<f64>, to: Vector2<f64>, radius_m: f64, ink: Colour) {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let length2 = half.norm_squared().max(1e-18);
        let reach = half.norm() + radius_m + self.texel_m[0];
        self.fill(middle, reach, ink, |p| (p - half * (p.dot(&half) / length2).clamp(-1.0, 1.0)).norm() - radius_m);
    }

    pub(super) fn word(
        &mut self,
        corner: Vector2<f64>,
        height_m: f64,
        along: Vector2<f64>,
        ink: Colour,
        rng: &mut ChaCha8Rng,
    ) -> f64 {
        let letters = rng.random_range(1..8);
        for i in 0..letters {
            let shape = rng.random_range(0..60u64) * 7919;
            self.letter(corner + along * (0.8 * height_m * f64::from(i)), height_m, along, shape, ink);
        }
        0.8 * height_m * f64::from(letters)
    }

    /// Mixes `colour` in where noise of the given scale is high; `contrast` makes the borders of the mix harder.
    pub(super) fn mix(&mut self, seed: u64, scale_m: [f64; 2], octaves: u32, colour: Colour, contrast: f32) {
        let noise = Noise::new(self, seed, scale_m, octaves);
        self.every_texel(|[near, _], u, v, texel| {
            let share = (0.5 + contrast * (noise.at(u, v, near) - 0.5)).clamp(0.0, 1.0);
            for c in 0..3 {
                texel[c] += share * (colour[c] - texel[c]);
            }
        });
    }

    /// Brightens and darkens by up to about `strength`.
    pub(super) fn shade(&mut self, seed: u64, scale_m: f64, octaves: u32, strength: f32) {
        let noise = Noise::new(self, seed, [scale_m; 2], octaves);
        self.every_texel(|[near, _], u, v, texel| {
            let factor = 1.0 + 2.0 * strength * (noise.at(u, v, near) - 0.5);
            *texel = texel.map(|c| (c * factor).clamp(0.0, 0.95));
        });
    }

    /// Applies `change` to every texel with its place in [0, 1)², row by row, with what two noises may keep.
    pub(super) fn every_texel(&mut self, change: impl Fn(&mut [Near; 2], f64, f64, &mut Colour) + Sync) {
        let (columns, rows) = (self.columns, self.rows);
        self.texels.par_chunks_mut(columns).enumerate().for_each(|(y, row)| {
            let v = (y as f64 + 0.5) / rows as f64;
            let mut near = [Near::default(); 2];
            for (x, texel) in row.iter_mut().enumerate() {
                change(&mut near, (x as f64 + 0.5) / columns as f64, v, texel);
            }
        });
    }

    /// The picture, with its pyramid.
    #[must_use]
    pub fn finish(self) -> Picture {
        let encode = |c: &Colour| c.map(|v| (v.clamp(0.0, 1.0).sqrt() * 255.0 + 0.5) as u8);
        let (mut columns, mut rows, mut texels) = (self.columns, self.rows, self.texels);
        let mut levels = vec![Level { columns, rows, texels: texels.iter().map(encode).collect() }];
        while columns > 1 && rows > 1 {
            let (half_columns, half_rows) = (columns / 2, rows / 2);
            // Where a side is odd the halved texels are a little wider: the box average follows.
            let (sx, sy) = (columns as f64 / half_columns as f64, rows as f64 / half_rows as f64);
            let halved: Vec<Colour> = (0..half_rows)
                .into_par_iter()
                .flat_map_iter(|y| (0..half_columns).map(move |x| (x, y)))
                .map(|(x, y)| average(&texels, columns, rows, [x as f64 * sx, y as f64 * sy], [sx, sy]))
                .collect();
            (columns, rows, texels) = (half_columns, half_rows, halved);
            levels.push(Level { columns, rows, texels: texels.iter().map(encode).collect() });
        }
        Picture { size_m: self.size_m, levels }
    }
}

fn average(texels: &[Colour], columns: usize, rows: usize, low: [f64; 2], span: [f64; 2]) -> Colour {
    let mut sum = [0.0f32; 3];
    let overlap = |i: usize, low: f64, span: f64| ((i + 1) as f64).min(low + span) - (i as f64).max(low);
    for y in low[1] as usize..((low[1] + span[1]).ceil() as usize).min(rows) {
        for x in low[0] as usize..((low[0] + span[0]).ceil() as usize).min(columns) {
            let weight = (overlap(x, low[0], span[0]) * overlap(y, low[1], span[1])).max(0.0) as f32;
            for c in 0..3 {
                sum[c] += weight * texels[y * columns + x][c];
            }
        }
    }
    sum.map(|s| s / (span[0] * span[1]) as f32)
}

/// Value noise that repeats with the canvas: octaves of halved scale and halved strength, about 0.5.
pub(super) struct Noise {
    seed: u64,
    cells: [f64; 2],
    octaves: u32,
}

impl Noise {
    pub(super) fn new(canvas: &Canvas, seed: u64, scale_m: [f64; 2], octaves: u32) -> Self {
        let cells = [0, 1].map(|i| (canvas.size_m[i] / scale_m[i]).round().max(1.0));
        Self { seed, cells, octaves }
    }

    pub(super) fn at(&self, u: f64, v: f64, near: &mut Near) -> f32 {
        let (mut sum, mut weight, mut all) = (0.0, 1.0f32, 0.0);
        let [mut nx, mut ny] = self.cells;
        for (octave, cell) in (0..self.octaves).zip(&mut near.0) {
            sum += weight * self.one([u * nx, v * ny], [nx, ny], octave, cell);
            all += weight;
            weight *= 0.55;
            nx *= 2.0;
            ny *= 2.0;
        }
        sum / all
    }

    #[inline(always)]
    fn one(&self, [x, y]: [f64; 2], cells: [f64; 2], octave: u32, cell: &mut Cell) -> f32 {
        let (column, row) = (x as i32, y as i32);
        if cell.place != [column, row] {
            *cell = Cell { place: [column, row], knots: self.knots([column, row].map(|i| i as u64), cells, octave) };
        }
        let smooth = |t: f64| {
            let t = t as f32;
            t * t * (3.0 - 2.0 * t)
        };
        let (fx, fy) = (smooth(x - f64::from(column)), smooth(y - f64::from(row)));
        let [a, b, c, d] = cell.knots;
        let top = a + fx * (b - a);
        let bottom = c + fx * (d - c);
        top + fy * (bottom - top)
    }

    #[cold]
    fn knots(&self, place: [u64; 2], cells: [f64; 2], octave: u32) -> [f32; 4] {
        let [nx, ny] = cells.map(|n| n as u64);
        let (ix, iy) = (place[0] % nx, place[1] % ny);
        let (jx, jy) = ((ix + 1) % nx, (iy + 1) % ny);
        let knot = |i: u64, j: u64| hash01(self.seed ^ (u64::from(octave) << 58) ^ (j << 29) ^ i);
        [knot(ix, iy), knot(jx, iy), knot(ix, jy), knot(jx, jy)]
    }
}

/// What noise is made of about the place that was looked at last, octave by octave: the next place is mostly in the same cells.
#[derive(Clone, Copy, Default)]
pub(super) struct Near([Cell; 8]);

#[derive(Clone, Copy)]
struct Cell {
    place: [i32; 2],
    knots: [f32; 4],
}

impl Default for Cell {
    fn default() -> Self {
        Self { place: [-1; 2], knots: [0.0; 4] }
    }
}
