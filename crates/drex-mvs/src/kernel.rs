//! How well a plane explains a pixel: bilaterally weighted, normalised cross-correlation of its window with another photo.
//!
//! A plane is given by the inverse depth w at the pixel and its slopes a and b along row and column, for 1/z is linear over
//! the image of a plane. A pixel p + (x, y) then comes to lie in the other photo at A p + b w + x (A₀ + b a) + y (A₁ + b b),
//! with A = K' R K⁻¹ and b = K' t: a homography without a camera in it.

use crate::picture::{Grey, Quads};

/// Samples that are computed side by side.
pub(crate) const LANES: usize = 8;
/// Cost of a window that says nothing: without contrast, or outside of the other photo.
pub(crate) const WORST: f32 = 2.0;
/// Variance, grey levels squared, below which a window says nothing: it may be noise.
pub(crate) const LEAST_VARIANCE: f32 = 2.0;

type Lanes = [f32; LANES];

/// Places of the samples of a window, padded with its centre to `G` groups of [`LANES`].
#[derive(Debug, Clone)]
pub(crate) struct Window<const G: usize> {
    pub radius: i32,
    x: [Lanes; G],
    y: [Lanes; G],
    /// Steps from the centre in whole pixels, and the weight of their distance.
    samples: Vec<([i32; 2], f32)>,
    /// Weight of a difference of grey.
    of_difference: [f32; 256],
}

/// The window of one pixel: weights that sum to 1, and weights times deviation from the mean.
#[derive(Debug, Clone)]
pub(crate) struct Patch<const G: usize> {
    weight: [Lanes; G],
    centred: [Lanes; G],
    variance: f32,
}

/// The photo a window is looked for in, and how pixels of the reference get there.
#[derive(Debug)]
pub(crate) struct Source {
    pub quads: Quads,
    /// A = K' R K⁻¹, by columns.
    pub turn: [[f32; 3]; 3],
    /// b = K' t.
    pub shift: [f32; 3],
}

/// A plane seen from a pixel: inverse depth there, and its slopes per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Plane {
    pub w: f32,
    pub a: f32,
    pub b: f32,
}

impl Plane {
    /// The same plane seen from a pixel `x` to the right and `y` below.
    #[inline(always)]
    pub fn moved(self, x: f32, y: f32) -> Self {
        Self { w: self.w + self.a * x + self.b * y, ..self }
    }

    /// The same plane in a picture of pixels `size` times as large.
    #[inline(always)]
    pub fn scaled(self, size: f32) -> Self {
        Self { a: size * self.a, b: size * self.b, ..self }
    }
}

impl<const G: usize> Window<G> {
    /// Every second pixel, both ways, of a square that reaches `radius` pixels from its centre; an odd radius leaves the centre out.
    ///
    /// `sigma_px` and `sigma_grey` are those of the bilateral weights.
    pub fn new(radius: i32, sigma_px: f32, sigma_grey: f32) -> Self {
        let steps = || (-radius..=radius).step_by(2);
        let spatial = |x: i32, y: i32| (-((x * x + y * y) as f32) / (2.0 * sigma_px * sigma_px)).exp();
        let samples: Vec<_> = steps().flat_map(|y| steps().map(move |x| ([x, y], spatial(x, y)))).collect();
        assert!(samples.len() <= G * LANES, "a window of {} samples in {G} groups", samples.len());
        let mut window = Self {
            radius,
            x: [[0.0; LANES]; G],
            y: [[0.0; LANES]; G],
            of_difference: std::array::from_fn(|d| (-((d * d) as f32) / (2.0 * sigma_grey * sigma_grey)).exp()),
            samples,
        };
        for (i, ([x, y], _)) in window.samples.iter().enumerate() {
            (window.x[i / LANES][i % LANES], window.y[i / LANES][i % LANES]) = (*x as f32, *y as f32);
        }
        window
    }

    /// Weights of its samples by their distance, row by row, and those of differences of grey.
    #[cfg(feature = "wgpu")]
    pub fn weights(&self) -> Vec<f32> {
        self.samples.iter().map(|(_, weight)| *weight).chain(self.of_difference).collect()
    }

    /// Mean of the squared distance of its samples from the centre along one axis, by their weights, pixels squared.
    pub fn spread(&self) -> f32 {
        let sum = |of: fn(i32) -> f32| self.samples.iter().map(|([x, _], weight)| weight * of(*x)).sum::<f32>();
        sum(|x| (x * x) as f32) / sum(|_| 1.0)
    }

    /// The window round a pixel; what lies outside of the picture, or where `counts` says no, has no weight.
    #[inline(always)]
    pub fn patch(&self, picture: &Grey, x: usize, y: usize, counts: impl Fn(usize) -> bool) -> Patch<G> {
        let centre = picture.values[y * picture.width + x];
        let mut patch = Patch { weight: [[0.0; LANES]; G], centred: [[0.0; LANES]; G], variance: 0.0 };
        let (mut sum, mut mean) = (0.0, 0.0);
        for (i, ([dx, dy], spatial)) in self.samples.iter().enumerate() {
            let (u, v) = (x as i32 + dx, y as i32 + dy);
            if u < 0 || v < 0 || u >= picture.width as i32 || v >= picture.height as i32 {
                continue;
            }
            let at = v as usize * picture.width + u as usize;
            if !counts(at) {
                continue;
            }
            let grey = picture.values[at];
            let weight = spatial * self.of_difference[usize::from(grey.abs_diff(centre))];
            patch.weight[i / LANES][i % LANES] = weight;
            patch.centred[i / LANES][i % LANES] = f32::from(grey);
            sum += weight;
            mean += weight * f32::from(grey);
        }
        if sum <= 0.0 {
            return patch;
        }
        let inverse = 1.0 / sum;
        mean *= inverse;
        let mut squares = [0.0; LANES];
        for g in 0..G {
            for l in 0..LANES {
                patch.weight[g][l] *= inverse;
                let deviation = patch.centred[g][l] - mean;
                patch.centred[g][l] = patch.weight[g][l] * deviation;
                squares[l] += patch.centred[g][l] * deviation;
            }
        }
        patch.variance = total(squares);
        patch
    }
}

impl<const G: usize> Patch<G> {
    /// Of its grey, by its weights, grey levels squared.
    #[inline(always)]
    pub fn variance(&self) -> f32 {
        self.variance
    }

    /// Whether there is contrast to compare.
    #[inline(always)]
    pub fn says_something(&self) -> bool {
        self.variance >= LEAST_VARIANCE
    }

    /// 1 - correlation of the window round pixel `at` with `source`, if the surface there is `plane`: 0 (alike) to 2.
    #[inline(always)]
    pub fn cost(&self, window: &Window<G>, at: [f32; 2], plane: Plane, source: &Source) -> f32 {
        let [first, second, third] = &source.turn;
        let row = |k: usize| {
            let shift = source.shift[k];
            let base = first[k] * at[0] + second[k] * at[1] + third[k] + shift * plane.w;
            (base, first[k] + shift * plane.a, second[k] + shift * plane.b)
        };
        let ((x0, xx, xy), (y0, yx, yy), (z0, zx, zy)) = (row(0), row(1), row(2));
        let r = window.radius as f32;
        // The image of a square that lies before the camera lies between those of its corners.
        for (dx, dy) in [(-r, -r), (r, -r), (-r, r), (r, r)] {
            let z = z0 + zx * dx + zy * dy;
            let (x, y) = (x0 + xx * dx + xy * dy, y0 + yx * dx + yy * dy);
            let inside =
                z > 0.0 && x >= 0.0 && y >= 0.0 && x < source.quads.limit[0] * z && y < source.quads.limit[1] * z;
            if !inside {
                return WORST;
            }
        }
        let (mut sum, mut squares, mut product) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for g in 0..G {
            let (mut right, mut down, mut place) = ([0.0; LANES], [0.0; LANES], [0; LANES]);
            for l in 0..LANES {
                let (dx, dy) = (window.x[g][l], window.y[g][l]);
                let inverse = 1.0 / (z0 + zx * dx + zy * dy);
                let (column, x) = split((x0 + xx * dx + xy * dy) * inverse);
                let (line, y) = split((y0 + yx * dx + yy * dy) * inverse);
                (right[l], down[l]) = (x, y);
                place[l] = line.wrapping_mul(source.quads.stride).wrapping_add(column);
            }
            let read = place.map(|p| source.quads.values.get(p as usize).copied().unwrap_or(0));
            for l in 0..LANES {
                let byte = |k: u32| (read[l] >> (8 * k) & 255) as i32 as f32;
                let upper = byte(0) + right[l] * (byte(1) - byte(0));
                let lower = byte(2) + right[l] * (byte(3) - byte(2));
                let grey = upper + down[l] * (lower - upper);
                let weighted = self.weight[g][l] * grey;
                sum[l] += weighted;
                squares[l] += weighted * grey;
                product[l] += self.centred[g][l] * grey;
            }
        }
        let mean = total(sum);
        let variance = total(squares) - mean * mean;
        if !(variance >= LEAST_VARIANCE) {
            return WORST;
        }
        (1.0 - total(product) / (self.variance * variance).sqrt()).clamp(0.0, WORST)
    }
}

/// Where a pixel with an inverse depth comes to lie in another photo.
#[inline(always)]
pub(crate) fn mapped(turn: &[[f32; 3]; 3], shift: &[f32; 3], at: [f32; 2], w: f32) -> Option<[f32; 2]> {
    let row = |k: usize| turn[0][k] * at[0] + turn[1][k] * at[1] + turn[2][k] + shift[k] * w;
    let z = row(2);
    (z > 0.0).then(|| [row(0) / z, row(1) / z])
}

/// A number from 0 to 4 million as a whole number and the rest, from 0 to 1.
#[inline(always)]
fn split(x: f32) -> (i32, f32) {
    // Adding 1.5 · 2^23 leaves no bits for a fraction: the sum is rounded, and its low bits are the whole number.
    const ROUND: f32 = 12_582_912.0;
    let rounded = (x - 0.5) + ROUND;
    ((rounded.to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32), x - (rounded - ROUND))
}

/// The sum of all lanes, in an order that does not depend on the machine.
#[inline(always)]
fn total(v: Lanes) -> f32 {
    ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A picture of smooth waves of several directions, moved to the right by `shift` pixels.
    pub(crate) fn waves(shift: f32) -> Grey {
        let (width, height) = (64, 48);
        let grey = |i: usize| {
            let (x, y) = ((i % width) as f32 - shift, (i / width) as f32);
            let wave = |a: f32, b: f32, c: f32| (a * x + b * y + c).sin();
            (128.0 + 30.0 * (wave(0.7, 0.2, 0.0) + wave(-0.3, 0.8, 1.0) + wave(0.4, -0.5, 2.0)) + 0.5) as u8
        };
        Grey { width, height, values: (0..width * height).map(grey).collect() }
    }

    /// Another photo in which a pixel moves to the right by its inverse depth.
    fn source(picture: &Grey) -> Source {
        Source {
            quads: Quads::new(picture),
            turn: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            shift: [1.0, 0.0, 0.0],
        }
    }

    #[test]
    fn the_best_disparity_is_the_true_one() {
        let window = Window::<5>::new(5, 4.0, 25.5);
        let picture = waves(0.0);
        for truth in [0.0f32, 0.37, 2.5, -1.25] {
            let other = source(&waves(truth));
            let patch = window.patch(&picture, 30, 20, |_| true);
            let cost = |w: f32| patch.cost(&window, [30.0, 20.0], Plane { w, a: 0.0, b: 0.0 }, &other);
            let tries = (-400..400).map(|k| truth + 0.01 * k as f32);
            let best = tries.min_by(|p, q| cost(*p).total_cmp(&cost(*q))).unwrap();
            assert!((best - truth).abs() < 0.03 && cost(best) < 0.01, "{best} for {truth}: {}", cost(best));
        }
    }

    #[test]
    fn a_window_that_leaves_the_picture_or_shows_nothing_is_worst() {
        let window = Window::<4>::new(4, 3.0, 25.5);
        let (picture, other) = (waves(0.0), source(&waves(0.0)));
        let patch = window.patch(&picture, 30, 20, |_| true);
        let at = |w: f32| patch.cost(&window, [30.0, 20.0], Plane { w, a: 0.0, b: 0.0 }, &other);
        // 63 is the last column; the window reaches four pixels beyond its centre.
        assert!(at(28.9) < WORST && at(29.1) == WORST && at(-26.1) == WORST && at(f32::NAN) == WORST);
        let blank = Grey { values: vec![90; 64 * 48], ..picture.clone() };
        assert!(!window.patch(&blank, 30, 20, |_| true).says_something());
        assert_eq!(patch.cost(&window, [30.0, 20.0], Plane::default(), &source(&blank)), WORST);
    }

    #[test]
    fn pixels_that_do_not_count_change_nothing() {
        let window = Window::<4>::new(4, 3.0, 25.5);
        let picture = waves(0.0);
        let mut painted = picture.clone();
        let beside = |i: usize| i % 64 >= 32;
        (0..64 * 48).filter(|i| beside(*i)).for_each(|i| painted.values[i] = (i * 37 % 251) as u8);
        let other = source(&waves(0.4));
        let [a, b] = [&picture, &painted].map(|p| {
            let patch = window.patch(p, 30, 20, |i| !beside(i));
            patch.cost(&window, [30.0, 20.0], Plane { w: 0.1, a: 0.0, b: 0.01 }, &other)
        });
        assert_eq!(a, b);
    }
}
