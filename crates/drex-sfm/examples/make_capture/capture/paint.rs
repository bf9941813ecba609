//! Pictures for surfaces: drawn from a seed, repeated in both directions, read at any fineness.

use std::f64::consts::TAU;

use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::{hash, hash01};

/// Linear reflectance of red, green, blue.
pub type Colour = [f32; 3];

/// A picture that repeats, with a pyramid of halved copies.
pub struct Picture {
    /// Width and height of one repetition, metres.
    pub size_m: [f64; 2],
    levels: Vec<Level>,
}

struct Level {
    columns: usize,
    rows: usize,
    /// Square root of the reflectance, in 255ths: as fine in the dark as an eye is.
    texels: Vec<[u8; 3]>,
}

impl Picture {
    /// The colour at `at_m`, averaged over about `fineness_m`: linear between texels and between levels.
    #[must_use]
    pub fn colour(&self, at_m: Vector2<f64>, fineness_m: f64) -> Colour {
        let texel_m = self.size_m[0] / self.levels[0].columns as f64;
        let level = (fineness_m / texel_m).max(1.0).log2().min((self.levels.len() - 1) as f64);
        let (lower, between) = (level as usize, level.fract() as f32);
        let (u, v) = ((at_m.x / self.size_m[0]).rem_euclid(1.0), (at_m.y / self.size_m[1]).rem_euclid(1.0));
        let fine = self.levels[lower].bilinear(u, v);
        if between < 0.05 || lower + 1 == self.levels.len() {
            return fine;
        }
        let coarse = self.levels[lower + 1].bilinear(u, v);
        std::array::from_fn(|c| fine[c] + between * (coarse[c] - fine[c]))
    }
}

impl Level {
    fn bilinear(&self, u: f64, v: f64) -> Colour {
        let (x, y) = (u * self.columns as f64 - 0.5, v * self.rows as f64 - 0.5);
        let (fx, fy) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
        let wrap = |i: f64, n: usize| {
            let i = i as isize;
            if i < 0 {
                n - 1
            } else if i as usize >= n {
                i as usize - n
            } else {
                i as usize
            }
        };
        let (x0, x1) = (wrap(x.floor(), self.columns), wrap(x.floor() + 1.0, self.columns));
        let (y0, y1) = (wrap(y.floor(), self.rows) * self.columns, wrap(y.floor() + 1.0, self.rows) * self.columns);
        let corners = [self.texels[y0 + x0], self.texels[y0 + x1], self.texels[y1 + x0], self.texels[y1 + x1]];
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        std::array::from_fn(|c| {
            let root: f32 = corners.iter().zip(weights).map(|(t, w)| f32::from(t[c]) * w).sum::<f32>() / 255.0;
            root * root
        })
    }
}

/// What a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// Lines of made-up letters in several sizes.
    Print,
    /// Discs, bars, polygons and letters of many sizes, scattered.
    Confetti,
    /// Two or three colours mixed by noise of many scales.
    Clouds,
    /// Upright bars with words, as the backs of books.
    Spines,
    /// Small chips close together.
    Terrazzo,
    /// Patches with ragged borders.
    Quilt,
    /// Planks with grain.
    Wood,
    /// One small motif again and again.
    Cloth,
    /// Next to nothing.
    Plain,
}

/// Order for a picture.
#[derive(Debug, Clone, Copy)]
pub struct Order {
    /// What it shows.
    pub style: Style,
    /// Width and height of one repetition, metres.
    pub size_m: [f64; 2],
    /// What one pixel of a photo covers at the usual distance, metres: drawings scale with it.
    pub unit_m: f64,
    /// Most texels along a side.
    pub most_texels: usize,
}

/// Draws the picture that is ordered.
#[must_use]
pub fn draw(order: &Order, rng: &mut ChaCha8Rng) -> Picture {
    let Order { style, size_m, unit_m, most_texels } = *order;
    let texel_m = (0.6 * unit_m).max(size_m[0].max(size_m[1]) / most_texels as f64);
    let ground = random_colour(rng, 0.12..0.65);
    let mut canvas = Canvas::new(size_m, texel_m, ground);
    match style {
        Style::Print => canvas.print(unit_m, rng),
        Style::Confetti => canvas.confetti(unit_m, rng),
        Style::Clouds => {
            for _ in 0..rng.random_range(1..3) {
                let (seed, colour) = (rng.random(), random_colour(rng, 0.05..0.75));
                let scale = unit_m * rng.random_range(60.0..160.0);
                canvas.mix(seed, [scale, scale * rng.random_range(0.7..1.4)], 6, colour, rng.random_range(2.0..5.0));
            }
        }
        Style::Spines => canvas.spines(unit_m, rng),
        Style::Terrazzo => canvas.chips(unit_m, rng),
        Style::Quilt => canvas.quilt(unit_m, rng),
        Style::Wood => canvas.wood(unit_m, rng),
        Style::Cloth => canvas.cloth(unit_m, rng),
        Style::Plain => {
            canvas.shade(rng.random(), 0.25 * size_m[0].min(size_m[1]), 2, 0.03);
            return canvas.finish();
        }
    }
    // What any surface has: stains, and a grain of a few pixels.
    canvas.shade(rng.random(), 200.0 * unit_m, 3, 0.12);
    canvas.shade(rng.random(), 6.0 * unit_m, 2, rng.random_range(0.02..0.08));
    canvas.finish()
}

/// A colour with a luminance in `light`, of any hue and moderate saturation.
pub fn random_colour(rng: &mut ChaCha8Rng, light: std::ops::Range<f32>) -> Colour {
    let hue: f32 = rng.random_range(0.0..6.0);
    let saturation: f32 = rng.random_range(0.1f32..0.75);
    let light = rng.random_range(light);
    let pure: Colour = std::array::from_fn(|c| {
        let d = (hue - 2.0 * c as f32).rem_euclid(6.0);
        (1.0 - (d.min(6.0 - d) - 1.0).clamp(0.0, 1.0)).clamp(0.0, 1.0)
    });
    let grey = 0.25 * pure[0] + 0.6 * pure[1] + 0.15 * pure[2];
    std::array::from_fn(|c| {
        let chroma = 1.0 + saturation * (pure[c] / grey.max(0.3) - 1.0);
        (light * chroma).clamp(0.02, 0.9)
    })
}

/// A picture while it is drawn: a torus of texels.
pub struct Canvas {
    columns: usize,
    rows: usize,
    size_m: [f64; 2],
    texel_m: [f64; 2],
    texels: Vec<Colour>,
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
    fn letter(&mut self, corner: Vector2<f64>, height_m: f64, along: Vector2<f64>, shape: u64, ink: Colour) {
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

    fn stroke(&mut self, from: Vector2<f64>, to: Vector2<f64>, radius_m: f64, ink: Colour) {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let length2 = half.norm_squared().max(1e-18);
        let reach = half.norm() + radius_m + self.texel_m[0];
        self.fill(middle, reach, ink, |p| (p - half * (p.dot(&half) / length2).clamp(-1.0, 1.0)).norm() - radius_m);
    }

    fn word(
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

    fn print(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let dark = luminance(self.texels[0]) < 0.2;
        let range = if dark { 0.5..0.85 } else { 0.02..0.08 };
        let ink = random_colour(rng, range.clone());
        let other = random_colour(rng, range);
        let columns = (self.size_m[0] / (unit_m * rng.random_range(250.0..600.0))).ceil().max(1.0);
        let width = self.size_m[0] / columns;
        for column in 0..columns as usize {
            let left = width * (column as f64 + 0.04);
            let right = width * (column as f64 + 0.94);
            let mut y = 0.0;
            while y < self.size_m[1] {
                let size: f64 =
                    if rng.random_bool(0.12) { rng.random_range(28.0..75.0) } else { rng.random_range(9.0..17.0) };
                let height = size * unit_m;
                if y + height > self.size_m[1] {
                    break;
                }
                let mut x = left + rng.random_range(0.0..0.1) * width;
                while x + 3.0 * height < right {
                    let colour = if rng.random_bool(0.85) { ink } else { other };
                    x += self.word(Vector2::new(x, y), height, Vector2::x(), colour, rng) + 0.7 * height;
                }
                y += height * rng.random_range(1.3..1.8);
            }
        }
    }

    fn confetti(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let palette: Vec<Colour> = (0..12).map(|_| random_colour(rng, 0.03..0.8)).collect();
        let mut left = 1.1 * self.size_m[0] * self.size_m[1];
        let largest = 0.2 * self.size_m[0].min(self.size_m[1]);
        let dense = rng.random_range(0.8..1.6);
        while left > 0.0 {
            // Sizes by a power law: many small, few large.
            let r = (unit_m * 4.0 * rng.random_range(0.012f64..1.0).powf(-0.7) * dense).min(largest);
            left -= 2.0 * r * r;
            let at = Vector2::new(rng.random_range(0.0..self.size_m[0]), rng.random_range(0.0..self.size_m[1]));
            let ink = palette[rng.random_range(0..palette.len())];
            self.scrap(at, r, ink, rng);
        }
    }

    fn scrap(&mut self, at: Vector2<f64>, r: f64, ink: Colour, rng: &mut ChaCha8Rng) {
        let angle: f64 = rng.random_range(0.0..TAU);
        let along = Vector2::new(angle.cos(), angle.sin());
        let slim: f64 = rng.random_range(0.35..1.0);
        let reach = 1.6 * r + self.texel_m[0];
        match rng.random_range(0..5) {
            0 => self.fill(at, reach, ink, |p| {
                let q = Vector2::new(p.dot(&along), p.perp(&along) / slim);
                (q.norm() - r) * slim
            }),
            1 => self.stroke(at - along * r, at + along * r, 0.15 * r, ink),
            2 => {
                self.word(at, r, along, ink, rng);
            }
            _ => {
                let corners = rng.random_range(3..6);
                let sides: Vec<(Vector2<f64>, f64)> = (0..corners)
                    .map(|i| {
                        let a = angle + TAU * (f64::from(i) + rng.random_range(-0.25..0.25)) / f64::from(corners);
                        (Vector2::new(a.cos(), a.sin()), r * rng.random_range(0.4..0.8))
                    })
                    .collect();
                self.fill(at, reach, ink, |p| sides.iter().map(|(n, d)| n.dot(&p) - d).fold(f64::MIN, f64::max));
            }
        }
    }

    fn spines(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let mut shelf = 0.0;
        while shelf < self.size_m[1] {
            let tall = (unit_m * rng.random_range(220.0..420.0)).min(self.size_m[1] - shelf);
            let mut x = 0.0;
            while x < self.size_m[0] {
                let wide = (unit_m * rng.random_range(22.0..70.0)).min(self.size_m[0] - x);
                let top = tall * rng.random_range(0.03..0.25);
                let half = Vector2::new(0.5 * wide, 0.5 * (tall - top));
                let middle = Vector2::new(x + half.x, shelf + top + half.y);
                let colour = random_colour(rng, 0.03..0.7);
                self.fill(middle, half.norm(), colour, |p| (p.x.abs() - half.x).max(p.y.abs() - half.y));
                let ink = random_colour(rng, if luminance(colour) < 0.25 { 0.4..0.85 } else { 0.02..0.1 });
                let mut y = shelf + top + 0.1 * tall;
                let height = wide * rng.random_range(0.3..0.6);
                while y + 6.0 * height < shelf + tall {
                    let corner = Vector2::new(x + 0.5 * (wide + height), y);
                    y += self.word(corner, height, Vector2::y(), ink, rng) + rng.random_range(0.5..3.0) * height;
                }
                x += wide;
            }
            shelf += tall;
        }
    }

    fn chips(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let palette: Vec<Colour> = (0..5).map(|_| random_colour(rng, 0.04..0.8)).collect();
        let coarse = rng.random_range(1.0..1.8);
        let mut left = 0.8 * self.size_m[0] * self.size_m[1];
        while left > 0.0 {
            let r = unit_m * coarse * rng.random_range(2.0..10.0f64);
            left -= 2.0 * r * r;
            let at = Vector2::new(rng.random_range(0.0..self.size_m[0]), rng.random_range(0.0..self.size_m[1]));
            let ink = palette[rng.random_range(0..palette.len())];
            let angle: f64 = rng.random_range(0.0..TAU);
            let sides: Vec<(Vector2<f64>, f64)> = (0..5)
                .map(|i| {
                    let a = angle + TAU * f64::from(i) / 5.0;
                    (Vector2::new(a.cos(), a.sin()), r * rng.random_range(0.5..1.0))
                })
                .collect();
            self.fill(at, 1.6 * r, ink, |p| sides.iter().map(|(n, d)| n.dot(&p) - d).fold(f64::MIN, f64::max));
        }
    }

    fn quilt(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let cell = unit_m * rng.random_range(35.0..90.0);
        let cells = self.size_m.map(|s| (s / cell).ceil().max(2.0) as i64);
        let pitch = [self.size_m[0] / cells[0] as f64, self.size_m[1] / cells[1] as f64];
        let colours: Vec<Colour> = (0..cells[0] * cells[1]).map(|_| random_colour(rng, 0.04..0.75)).collect();
        let seed: u64 = rng.random();
        let ragged = [Noise::new(self, seed ^ 1, [0.3 * cell; 2], 3), Noise::new(self, seed ^ 2, [0.3 * cell; 2], 3)];
        self.every_texel(|u, v, texel| {
            let [dx, dy] = [0, 1].map(|i| f64::from(ragged[i].at(u, v)) - 0.5);
            let (x, y) = (u * cells[0] as f64 + 0.5 * dx, v * cells[1] as f64 + 0.5 * dy);
            let (cx, cy) = (x.floor() as i64, y.floor() as i64);
            let mut best = (f64::INFINITY, 0);
            for j in cy - 1..=cy + 1 {
                for i in cx - 1..=cx + 1 {
                    let id = (j.rem_euclid(cells[1]) * cells[0] + i.rem_euclid(cells[0])) as usize;
                    let (jx, jy) = (hash01(seed ^ id as u64), hash01(seed ^ (id as u64 + (1 << 32))));
                    let d = Vector2::new(
                        (i as f64 + 0.1 + 0.8 * f64::from(jx) - x) * pitch[0],
                        (j as f64 + 0.1 + 0.8 * f64::from(jy) - y) * pitch[1],
                    );
                    if d.norm_squared() < best.0 {
                        best = (d.norm_squared(), id);
                    }
                }
            }
            *texel = colours[best.1];
        });
        self.shade(seed ^ 5, 25.0 * unit_m, 3, 0.35);
    }

    fn wood(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let dark = luminance(self.texels[0]) < 0.3;
        let other = random_colour(rng, if dark { 0.4..0.65 } else { 0.05..0.16 });
        let planks = (self.size_m[1] / (unit_m * rng.random_range(150.0..320.0))).ceil();
        let rings = rng.random_range(5.0..11.0);
        let seed: u64 = rng.random();
        let size = self.size_m;
        let bend = Noise::new(self, seed ^ 3, [360.0 * unit_m, 60.0 * unit_m], 4);
        let fibre = Noise::new(self, seed ^ 4, [90.0 * unit_m, 4.0 * unit_m], 3);
        self.every_texel(|u, v, texel| {
            let plank = (v * planks).floor();
            let key = seed ^ plank as u64;
            let across = v * planks - plank;
            let at = f64::from(bend.at((u + f64::from(hash01(key))).fract(), v));
            let ring = (rings * (across + 2.2 * at)).fract();
            let grain = f64::from(fibre.at(u, v));
            let tone = 0.75 * (ring * (2.0 - ring)) + 0.25 * grain;
            let shade = 0.85 + 0.3 * hash01(key ^ 99);
            let gap = (0.5 - (across - 0.5).abs()) * size[1] / planks < 0.7 * unit_m;
            for c in 0..3 {
                let mixed = (texel[c] + tone as f32 * (other[c] - texel[c])) * shade;
                texel[c] = if gap { 0.3 * mixed } else { mixed };
            }
        });
    }

    fn cloth(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let pitch = unit_m * rng.random_range(26.0..44.0);
        let count = self.size_m.map(|s| (s / pitch).round().max(1.0) as usize);
        let step = Vector2::new(self.size_m[0] / count[0] as f64, self.size_m[1] / count[1] as f64);
        let inks = [0, 1, 2].map(|_| random_colour(rng, 0.05..0.8));
        let letter = rng.random_range(0..60u64) * 7919;
        let r = 0.22 * pitch;
        for j in 0..count[1] {
            for i in 0..count[0] {
                let at = Vector2::new((i as f64 + 0.3) * step.x, (j as f64 + 0.3) * step.y);
                self.fill(at, r + unit_m, inks[0], |p| p.norm() - r);
                let corner = at + Vector2::new(0.45 * step.x, 0.2 * step.y);
                self.letter(corner, 0.4 * pitch, Vector2::x(), letter, inks[1]);
                let line = Vector2::new((i as f64 + 0.5) * step.x, (j as f64 + 0.95) * step.y);
                self.stroke(
                    line - step * 0.3,
                    line + Vector2::new(0.3, -0.3).component_mul(&step),
                    0.03 * pitch,
                    inks[2],
                );
            }
        }
    }

    /// Mixes `colour` in where noise of the given scale is high; `contrast` makes the borders of the mix harder.
    fn mix(&mut self, seed: u64, scale_m: [f64; 2], octaves: u32, colour: Colour, contrast: f32) {
        let noise = Noise::new(self, seed, scale_m, octaves);
        self.every_texel(|u, v, texel| {
            let share = (0.5 + contrast * (noise.at(u, v) - 0.5)).clamp(0.0, 1.0);
            for c in 0..3 {
                texel[c] += share * (colour[c] - texel[c]);
            }
        });
    }

    /// Brightens and darkens by up to about `strength`.
    fn shade(&mut self, seed: u64, scale_m: f64, octaves: u32, strength: f32) {
        let noise = Noise::new(self, seed, [scale_m; 2], octaves);
        self.every_texel(|u, v, texel| {
            let factor = 1.0 + 2.0 * strength * (noise.at(u, v) - 0.5);
            *texel = texel.map(|c| (c * factor).clamp(0.0, 0.95));
        });
    }

    /// Applies `change` to every texel with its place in [0, 1)².
    fn every_texel(&mut self, change: impl Fn(f64, f64, &mut Colour) + Sync) {
        let (columns, rows) = (self.columns, self.rows);
        self.texels.par_chunks_mut(columns).enumerate().for_each(|(y, row)| {
            let v = (y as f64 + 0.5) / rows as f64;
            for (x, texel) in row.iter_mut().enumerate() {
                change((x as f64 + 0.5) / columns as f64, v, texel);
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

fn luminance(c: Colour) -> f32 {
    0.25 * c[0] + 0.6 * c[1] + 0.15 * c[2]
}

/// Value noise that repeats with the canvas: octaves of halved scale and halved strength, about 0.5.
struct Noise {
    seed: u64,
    cells: [f64; 2],
    octaves: u32,
}

impl Noise {
    fn new(canvas: &Canvas, seed: u64, scale_m: [f64; 2], octaves: u32) -> Self {
        let cells = [0, 1].map(|i| (canvas.size_m[i] / scale_m[i]).round().max(1.0));
        Self { seed, cells, octaves }
    }

    fn at(&self, u: f64, v: f64) -> f32 {
        let (mut sum, mut weight, mut all) = (0.0, 1.0f32, 0.0);
        let [mut nx, mut ny] = self.cells;
        for octave in 0..self.octaves {
            sum += weight * self.one(u * nx, v * ny, nx as u64, ny as u64, octave);
            all += weight;
            weight *= 0.55;
            nx *= 2.0;
            ny *= 2.0;
        }
        sum / all
    }

    fn one(&self, x: f64, y: f64, nx: u64, ny: u64, octave: u32) -> f32 {
        let (ix, iy) = (x.floor() as u64 % nx, y.floor() as u64 % ny);
        let smooth = |t: f64| {
            let t = t as f32;
            t * t * (3.0 - 2.0 * t)
        };
        let (fx, fy) = (smooth(x.fract()), smooth(y.fract()));
        let knot = |i: u64, j: u64| hash01(self.seed ^ (u64::from(octave) << 58) ^ (j << 29) ^ i);
        let (jx, jy) = ((ix + 1) % nx, (iy + 1) % ny);
        let top = knot(ix, iy) + fx * (knot(jx, iy) - knot(ix, iy));
        let bottom = knot(ix, jy) + fx * (knot(jx, jy) - knot(ix, jy));
        top + fy * (bottom - top)
    }
}
