//! What stands far behind: the colour that each pixel would have without the object, from photos that look past it.
//!
//! Sparse points outside of the box say how far the background is; the inverse of the depth is linear in the picture over a
//! plane, so it is fitted by a plane around each knot of a lattice. The place behind a pixel is then looked up in the photos
//! in which it lies beside the box. Where these agree, the colour is known.

use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::table::{Fit, Masks, Tone, densest, trust_of};
use super::view::{View, Window};

/// Knots of the lattice of depths are this many pixels apart.
const KNOT: usize = 8;
/// Points that a knot listens to.
const NEIGHBOURS: usize = 16;
/// Points per view; of more, every so many-th.
const MOST_POINTS: usize = 3000;
/// Photos asked per pixel, nearest first, and how many must answer.
const MOST_SAMPLES: usize = 12;
const FEWEST_SAMPLES: usize = 3;

/// What a pixel should look like if it shows the background.
#[derive(Debug, Clone, Copy, Default)]
struct Expected {
    colour: [u8; 3],
    spread: [u8; 3],
    known: bool,
}

/// The background behind the box in one view.
#[derive(Debug, Clone)]
pub(super) struct Backdrop {
    width: usize,
    pixels: Vec<Expected>,
}

impl Backdrop {
    /// The background of view `k` at the pixels of its window that are `needed`; `points` are places outside of the box, away
    /// from the plane, in the frame of the region.
    pub fn new(
        views: &[View],
        k: usize,
        tones: &[Tone],
        points: &[Point3<f64>],
        needed: &dyn Fn(usize) -> bool,
        masks: Option<&Masks>,
    ) -> Self {
        let view = &views[k];
        let window = view.window;
        let (w, h) = (window.width(), window.height());
        let mut pixels = vec![Expected::default(); w * h];
        let Some(depths) = Depths::new(view, points) else { return Self { width: w, pixels } };
        let mut others: Vec<(f64, usize)> = (0..views.len())
            .filter(|o| *o != k)
            .map(|o| ((views[o].eye.centre - view.eye.centre).norm_squared(), o))
            .collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut at = 0;
        let mut samples: [Vec<f32>; 3] = std::array::from_fn(|_| Vec::new());
        view.each_ray(&window, |ray| {
            let index = at;
            at += 1;
            let Some(ray) = ray.filter(|_| needed(index)) else { return };
            let along = view.eye.along_axis(&ray);
            if !(along > 1e-3) {
                return;
            }
            let depth = depths.at((index % w) as f64, (index / w) as f64);
            let place = view.eye.centre + ray * (depth / along);
            samples.iter_mut().for_each(Vec::clear);
            for (_, o) in &others {
                let other = &views[*o];
                let Some(pixel) = other.project(&place) else { continue };
                let hidden = other.index(pixel).is_some_and(|at| match masks {
                    Some(masks) => masks[*o][at],
                    None => other.inside[at],
                });
                let Some(colour) = other.picture.sample(pixel.x, pixel.y).filter(|_| !hidden) else { continue };
                (0..3).for_each(|c| samples[c].push(colour[c] / tones[*o].gain[c]));
                if samples[0].len() == MOST_SAMPLES {
                    break;
                }
            }
            let seen = samples[0].len();
            if seen < FEWEST_SAMPLES {
                return;
            }
            let mut known = true;
            let colour = std::array::from_fn(|c| {
                let all = &mut samples[c];
                let (from, to) = densest(all, 0.5);
                let mean = all[from..=to].iter().sum::<f32>() / (to + 1 - from) as f32;
                known &= 2 * all.iter().filter(|v| (**v - mean).abs() <= 10.0 + mean / 8.0).count() > seen;
                (mean * tones[k].gain[c]).round().clamp(0.0, 255.0) as u8
            });
            pixels[index] = Expected { colour, spread: [0; 3], known };
        });
        spread(&mut pixels, w, h);
        Self { width: w, pixels }
    }

    /// As [`super::table::Table::fit`], for what stands behind.
    pub fn fit(&self, colour: [u8; 3], noise: &[f32; 3], at: usize) -> Option<Fit> {
        let here = self.pixels[at];
        if !here.known {
            return None;
        }
        let sigma: [f32; 3] =
            std::array::from_fn(|c| (noise[c].powi(2) + (0.25 * f32::from(here.spread[c])).powi(2)).sqrt());
        let (x, y) = (at % self.width, at / self.width);
        let rows = self.pixels.len() / self.width;
        let (x0, x1) = (x.saturating_sub(1), (x + 1).min(self.width - 1));
        let (y0, y1) = (y.saturating_sub(1), (y + 1).min(rows - 1));
        let around = (y0..=y1).flat_map(|y| &self.pixels[y * self.width + x0..=y * self.width + x1]);
        let expected = |pixel: &Expected| pixel.colour.map(f32::from);
        Some(Fit::new(colour, expected(&here), around.filter(|p| p.known).map(expected), &sigma))
    }

    /// How a view differs from its backdrop, from the pixels beside the box; the gain is in the backdrop.
    pub fn tone(&self, view: &View) -> Tone {
        let mut off: [Vec<f32>; 3] = std::array::from_fn(|_| Vec::new());
        for (at, pixel) in self.pixels.iter().enumerate().filter(|(at, p)| p.known && !view.inside[*at]) {
            let colour = view.colour(at);
            for c in 0..3 {
                let away = (f32::from(colour[c]) - f32::from(pixel.colour[c])).abs();
                off[c].push((away - 0.25 * f32::from(pixel.spread[c])).max(0.0));
            }
        }
        if off[0].len() < 50 {
            return Tone::PLAIN;
        }
        let noise = off.map(|mut all| {
            let at = all.len() * 7 / 10;
            all.select_nth_unstable_by(at, f32::total_cmp).1.max(super::table::LEAST_NOISE)
        });
        let fits: Vec<Fit> = (0..self.pixels.len())
            .filter(|at| !view.inside[*at])
            .filter_map(|at| self.fit(view.colour(at), &noise, at))
            .collect();
        Tone { gain: [1.0; 3], noise, trust: trust_of(&fits) }
    }
}

/// Fills in the range of the colours of the 3 x 3 pixels around each pixel.
fn spread(pixels: &mut [Expected], w: usize, h: usize) {
    let before: Vec<Expected> = pixels.to_vec();
    for (at, pixel) in pixels.iter_mut().enumerate().filter(|(_, p)| p.known) {
        let (x, y) = (at % w, at / w);
        let (mut low, mut high) = (pixel.colour, pixel.colour);
        for row in y.saturating_sub(1)..(y + 2).min(h) {
            for other in before[row * w + x.saturating_sub(1)..row * w + (x + 2).min(w)].iter().filter(|p| p.known) {
                for c in 0..3 {
                    low[c] = low[c].min(other.colour[c]);
                    high[c] = high[c].max(other.colour[c]);
                }
            }
        }
        pixel.spread = std::array::from_fn(|c| high[c] - low[c]);
    }
}

/// Depth of the background over a window.
struct Depths {
    columns: usize,
    inverse: Vec<f64>,
}

impl Depths {
    fn new(view: &View, points: &[Point3<f64>]) -> Option<Self> {
        let Window { x0, y0, x1, y1 } = view.window;
        let (w, h) = (view.window.width() as f64, view.window.height() as f64);
        // Points in and around the window: pixel from its corner, inverse depth.
        let mut near: Vec<(Point2<f64>, f64)> = points
            .iter()
            .filter_map(|point| {
                let pixel = view.project(point)?;
                let around = (x0 as f64 - w..x1 as f64 + w).contains(&pixel.x)
                    && (y0 as f64 - h..y1 as f64 + h).contains(&pixel.y);
                let inverse = 1.0 / view.eye.depth(point);
                (around && inverse.is_finite())
                    .then(|| (Point2::new(pixel.x - x0 as f64, pixel.y - y0 as f64), inverse))
            })
            .collect();
        if near.is_empty() {
            return None;
        }
        let step = near.len().div_ceil(MOST_POINTS);
        near = near.into_iter().step_by(step).collect();
        let columns = view.window.width().div_ceil(KNOT) + 1;
        let rows = view.window.height().div_ceil(KNOT) + 1;
        let mut order: Vec<(f64, usize)> = Vec::new();
        let inverse = (0..rows * columns)
            .map(|knot| {
                let at = Point2::new((knot % columns * KNOT) as f64, (knot / columns * KNOT) as f64);
                order.clear();
                order.extend(near.iter().enumerate().map(|(i, (p, _))| ((p - at).norm_squared(), i)));
                let count = NEIGHBOURS.min(order.len());
                order.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                order[..count].sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                let around: Vec<_> = order[..count].iter().map(|(d2, i)| (near[*i].0 - at, near[*i].1, *d2)).collect();
                fit(&around)
            })
            .collect();
        Some(Self { columns, inverse })
    }

    /// Depth at a pixel of the window.
    fn at(&self, x: f64, y: f64) -> f64 {
        let (x, y) = (x / KNOT as f64, y / KNOT as f64);
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = (x - i as f64, y - j as f64);
        let at = j * self.columns + i;
        let [a, b, c, d] = [at, at + 1, at + self.columns, at + self.columns + 1].map(|k| self.inverse[k]);
        1.0 / ((a * (1.0 - fx) + b * fx) * (1.0 - fy) + (c * (1.0 - fx) + d * fx) * fy)
    }
}

/// Inverse depth at the origin from points around it (offset, inverse depth, squared distance): a plane, near points first,
/// reweighted against those that lie elsewhere.
fn fit(around: &[(nalgebra::Vector2<f64>, f64, f64)]) -> f64 {
    let mut all: Vec<f64> = around.iter().map(|p| p.1).collect();
    all.sort_by(f64::total_cmp);
    let (least, most, median) = (all[0], all[all.len() - 1], all[all.len() / 2]);
    let reach = around.iter().map(|p| p.2).fold(1.0, f64::max).sqrt();
    let mut c = Vector3::new(median, 0.0, 0.0);
    for _ in 0..4 {
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        let mut total = 0.0;
        for (offset, inverse, d2) in around {
            let row = Vector3::new(1.0, offset.x / reach, offset.y / reach);
            let off = (inverse - row.dot(&c)) / (0.04 * median);
            let weight = 1.0 / ((d2 / (reach * reach) + 0.05) * (1.0 + off * off));
            a += row * row.transpose() * weight;
            b += row * (inverse * weight);
            total += weight;
        }
        // Held level where the points do not say how it slopes.
        a[(1, 1)] += 0.02 * total;
        a[(2, 2)] += 0.02 * total;
        let Some(inverse) = a.try_inverse() else { break };
        c = inverse * b;
    }
    c.x.clamp(0.9 * least, 1.1 * most)
}
