//! Pictures for surfaces: drawn from a seed, repeated in both directions, read at any fineness.

use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

pub use super::canvas::Canvas;

/// Linear reflectance of red, green, blue.
pub type Colour = [f32; 3];

/// A picture that repeats, with a pyramid of halved copies.
pub struct Picture {
    /// Width and height of one repetition, metres.
    pub size_m: [f64; 2],
    pub(super) levels: Vec<Level>,
}

/// One fineness of a picture.
pub(super) struct Level {
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// Square root of the reflectance, in 255ths: as fine in the dark as an eye is.
    pub(super) texels: Vec<[u8; 3]>,
}

impl Picture {
    /// The colour at `at_m`, averaged over about `fineness_m`: linear between texels and between levels.
    #[must_use]
    pub fn colour(&self, at_m: Vector2<f64>, fineness_m: f64) -> Colour {
        let texel_m = self.size_m[0] / self.levels[0].columns as f64;
        let level = (fineness_m / texel_m).max(1.0).log2().min((self.levels.len() - 1) as f64);
        let (lower, between) = (level as usize, level.fract() as f32);
        let (u, v) = (repeated(at_m.x / self.size_m[0]), repeated(at_m.y / self.size_m[1]));
        let fine = self.levels[lower].bilinear(u, v);
        if between < 0.05 || lower + 1 == self.levels.len() {
            return fine;
        }
        let coarse = self.levels[lower + 1].bilinear(u, v);
        std::array::from_fn(|c| fine[c] + between * (coarse[c] - fine[c]))
    }
}

/// The place in [0, 1] of a repetition; as `x.rem_euclid(1.0)`, without the division of the mathematics library.
fn repeated(x: f64) -> f64 {
    let rest = x - x as i64 as f64;
    if rest < 0.0 { rest + 1.0 } else { rest }
}

impl Level {
    /// `u` and `v` in [0, 1].
    fn bilinear(&self, u: f64, v: f64) -> Colour {
        let (x, y) = (u * self.columns as f64 - 0.5, v * self.rows as f64 - 0.5);
        let floor = |x: f64| x as isize - isize::from(x < 0.0);
        let (ix, iy) = (floor(x), floor(y));
        let (fx, fy) = ((x - ix as f64) as f32, (y - iy as f64) as f32);
        let wrap = |i: isize, n: usize| {
            if i < 0 {
                n - 1
            } else if i as usize >= n {
                i as usize - n
            } else {
                i as usize
            }
        };
        let (x0, x1) = (wrap(ix, self.columns), wrap(ix + 1, self.columns));
        let (y0, y1) = (wrap(iy, self.rows) * self.columns, wrap(iy + 1, self.rows) * self.columns);
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

/// How light a colour is to the eye.
pub fn luminance(c: Colour) -> f32 {
    0.25 * c[0] + 0.6 * c[1] + 0.15 * c[2]
}
