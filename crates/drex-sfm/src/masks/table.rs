//! What the support looks like: a picture of the plane, put together from all photos, and how well a pixel fits it.
//!
//! What lies on the plane, its cast shadows included, looks the same in every photo at the same place of the plane; what
//! stands above it does not. The picture is a pyramid of square lattices around the box, each twice as coarse and wide as
//! the one before: near the box a cell is about a pixel, and rays that pass over the object meet the plane far behind.

use nalgebra::{Point2, Point3};
use rayon::prelude::*;

use super::view::{Bounds, View};

/// Cells along one side of a level.
pub(super) const SIDE: usize = 384;
const LEVELS: usize = 4;
/// Photos that the picture is made from; of more, every so many-th is taken.
const MOST_VIEWS: usize = 72;
/// A cell narrower than this in a photo, pixels, is not read from it.
const NARROWEST_PX: f64 = 0.25;
/// Share of the photos that must agree on the colour of a place: the object may hide it from the others.
const AGREE: f64 = 0.5;
/// The noise of a channel is at least this, levels of 255.
pub(super) const LEAST_NOISE: f32 = 3.0;

/// A place of the plane.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    colour: [u8; 3],
    /// Range of the colours around, per channel.
    spread: [u8; 3],
    /// Whether enough photos agree on the colour.
    known: bool,
}

#[derive(Debug, Clone)]
struct Level {
    /// Lower corner and width of a cell, frame of the region.
    corner: Point2<f64>,
    cell: f64,
    cells: Vec<Cell>,
    /// Cells that rays near the box meet.
    needed: Vec<bool>,
    /// Colours of cells within the footprint of the box that are surely the plane.
    bare: Vec<Option<[u8; 3]>>,
}

impl Level {
    fn index(&self, p: [f32; 2]) -> Option<usize> {
        let x = (f64::from(p[0]) - self.corner.x) / self.cell;
        let y = (f64::from(p[1]) - self.corner.y) / self.cell;
        let inner = 1.0..(SIDE - 1) as f64;
        (inner.contains(&x) && inner.contains(&y)).then(|| y as usize * SIDE + x as usize)
    }

    fn centre(&self, index: usize) -> Point3<f64> {
        let (x, y) = ((index % SIDE) as f64 + 0.5, (index / SIDE) as f64 + 0.5);
        Point3::new(self.corner.x + x * self.cell, self.corner.y + y * self.cell, 0.0)
    }
}

/// How a photo differs from the picture of the plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tone {
    /// The photo's colour over the picture's, per channel.
    pub gain: [f32; 3],
    /// Spread of the difference, levels of 255, per channel.
    pub noise: [f32; 3],
    /// Share of the pixels beside the box that look as expected.
    pub trust: f32,
}

impl Tone {
    pub const PLAIN: Self = Self { gain: [1.0; 3], noise: [12.0; 3], trust: 0.5 };
}

/// The picture of the plane.
#[derive(Debug, Clone)]
pub(super) struct Table {
    levels: Vec<Level>,
    /// Cells within these bounds may lie under the object: they count only once the photos' masks leave them free.
    footprint: Bounds,
    step: usize,
}

/// The masks so far: per view, per pixel of its window.
pub(super) type Masks = [Vec<bool>];

impl Table {
    /// An empty picture around `bounds`, its cells as wide as a pixel at the distance of the middle photo.
    pub fn new(views: &[View], bounds: &Bounds) -> Self {
        let mut sizes: Vec<f64> = views
            .iter()
            .map(|v| (v.eye.centre - bounds.centre()).norm() * v.shrink as f64 / v.eye.focal_px())
            .filter(|s| s.is_finite() && *s > 0.0)
            .collect();
        sizes.sort_by(f64::total_cmp);
        let smallest = 1.2 * bounds.size().xy().max() / SIDE as f64;
        let first = sizes.get(sizes.len() / 2).copied().unwrap_or(smallest).max(smallest);
        let middle = bounds.centre();
        let levels = (0..LEVELS)
            .map(|level| {
                let cell = first * f64::from(1u32 << level);
                let half = 0.5 * cell * SIDE as f64;
                let mut this = Level {
                    corner: Point2::new(middle.x - half, middle.y - half),
                    cell,
                    cells: vec![Cell::default(); SIDE * SIDE],
                    needed: vec![false; SIDE * SIDE],
                    bare: vec![None; SIDE * SIDE],
                };
                if level == 0 {
                    // The finest level is whole, so that the neighbours of each cell are there.
                    this.needed.fill(true);
                }
                this
            })
            .collect();
        let step = views.len().div_ceil(MOST_VIEWS).max(1);
        let mut table = Self { levels, footprint: *bounds, step };
        for view in views {
            for floor in &view.floor {
                if let Some((level, index)) = table.place(*floor).filter(|(level, _)| *level > 0) {
                    for y in [index - SIDE, index, index + SIDE] {
                        table.levels[level].needed[y - 1..=y + 1].fill(true);
                    }
                }
            }
        }
        table
    }

    /// The finest level that holds a point of the plane, and the cell.
    fn place(&self, p: [f32; 2]) -> Option<(usize, usize)> {
        self.levels.iter().enumerate().find_map(|(k, level)| level.index(p).map(|index| (k, index)))
    }

    /// Gives the picture up for good: nothing is known of the plane.
    pub fn forget(&mut self) {
        for level in &mut self.levels {
            level.needed.fill(false);
            level.cells.fill(Cell::default());
        }
    }

    /// Whether the colour of the plane is known at a point.
    pub fn is_known(&self, p: [f32; 2]) -> bool {
        self.place(p).is_some_and(|(level, index)| self.levels[level].cells[index].known)
    }

    /// Whether the colour of the plane is known at a point, or the point may be under the object: nothing to look for behind.
    pub fn is_settled(&self, p: [f32; 2]) -> bool {
        self.is_known(p) || covers(&self.footprint, &Point3::new(f64::from(p[0]), f64::from(p[1]), 0.0))
    }

    /// The finest level's cells, for [`super::bare`]: colour where it is known.
    pub fn finest_colour(&self, index: usize) -> Option<[u8; 3]> {
        Some(self.levels[0].cells[index]).filter(|cell| cell.known).map(|cell| cell.colour)
    }

    /// The middle of a cell of the finest level.
    pub fn finest_centre(&self, index: usize) -> Point3<f64> {
        self.levels[0].centre(index)
    }

    /// Whether the object may stand on a point of the plane.
    pub fn may_be_covered(&self, p: &Point3<f64>) -> bool {
        covers(&self.footprint, p)
    }

    /// Height of the box.
    pub fn height(&self) -> f64 {
        self.footprint.upper.z
    }

    /// Middle of the box.
    pub fn middle(&self) -> Point3<f64> {
        self.footprint.centre()
    }

    /// Says which cells of the finest level are surely the plane, though below the box, and their colours.
    pub fn add_bare(&mut self, bare: &[Option<[u8; 3]>]) {
        for (had, new) in self.levels[0].bare.iter_mut().zip(bare) {
            *had = had.or(*new);
        }
    }

    /// How sharp a photo is: the steps between its neighbouring pixels over those of the picture of the plane, by least squares.
    pub fn sharpness(&self, view: &View, tone: &Tone) -> Option<f32> {
        let w = view.window.width();
        let expected = |at: usize| {
            let (level, index) = self.place(view.floor[at])?;
            let cell = self.levels[level].cells[index];
            (cell.known && !view.inside[at]).then(|| cell.colour.map(f32::from))
        };
        let (mut both, mut own, mut pairs) = (0.0f64, 0.0f64, 0);
        for at in (0..view.floor.len()).filter(|at| at % w + 1 < w) {
            let (Some(a), Some(b)) = (expected(at), expected(at + 1)) else { continue };
            let (seen_a, seen_b) = (view.colour(at), view.colour(at + 1));
            for c in 0..3 {
                let step = f64::from(tone.gain[c] * (b[c] - a[c]));
                both += step * (f64::from(seen_b[c]) - f64::from(seen_a[c]));
                own += step * step;
            }
            pairs += 1;
        }
        (pairs > 200 && own > 0.0).then(|| (both / own) as f32)
    }

    /// Puts the picture together: per cell the colour that most photos that see it agree on, `masks` telling where the object hides it.
    pub fn paint(&mut self, views: &[View], tones: &[Tone], masks: Option<&Masks>) {
        let (footprint, step) = (self.footprint, self.step);
        for level in &mut self.levels {
            let this = &*level;
            let mut cells: Vec<Cell> = (0..SIDE * SIDE)
                .into_par_iter()
                .map_init(
                    || std::array::from_fn::<Vec<f32>, 3, _>(|_| Vec::new()),
                    |samples, index| {
                        if !this.needed[index] {
                            return Cell::default();
                        }
                        let point = this.centre(index);
                        let under = covers(&footprint, &point);
                        if let Some(colour) = this.bare[index] {
                            return Cell { colour, spread: [0; 3], known: true };
                        }
                        if under && masks.is_none() {
                            return Cell::default();
                        }
                        samples.iter_mut().for_each(Vec::clear);
                        let mut in_picture = 0;
                        for (k, view) in views.iter().enumerate().step_by(step) {
                            let along = point - view.eye.centre;
                            let distance = along.norm();
                            let narrow = this.cell * (-along.z / distance) * view.eye.focal_px()
                                / (distance * view.shrink as f64);
                            if !(narrow >= NARROWEST_PX) {
                                continue;
                            }
                            let Some(pixel) = view.project(&point) else { continue };
                            let Some(colour) = view.picture.sample(pixel.x, pixel.y) else { continue };
                            in_picture += 1;
                            if masks.is_some_and(|masks| view.index(pixel).is_some_and(|at| masks[k][at])) {
                                continue;
                            }
                            for c in 0..3 {
                                samples[c].push(colour[c] / tones[k].gain[c]);
                            }
                        }
                        let seen = samples[0].len();
                        if seen < 2 || 4 * seen < in_picture {
                            return Cell::default();
                        }
                        let mut agree = true;
                        let colour = std::array::from_fn(|c| {
                            let all = &mut samples[c];
                            let (from, to) = densest(all, AGREE);
                            let mean = all[from..=to].iter().sum::<f32>() / (to + 1 - from) as f32;
                            let near = all.iter().filter(|v| (**v - mean).abs() <= 10.0 + mean / 8.0).count();
                            agree &= near as f64 >= AGREE * seen as f64;
                            mean.round().clamp(0.0, 255.0) as u8
                        });
                        Cell { colour, spread: [0; 3], known: agree }
                    },
                )
                .collect();
            spread_of_neighbours(&mut cells);
            level.cells = cells;
        }
    }

    /// How each photo differs from the picture, from the pixels that show the plane beside the box.
    pub fn tone(&self, view: &View) -> Tone {
        let mut ratios: [Vec<f32>; 3] = std::array::from_fn(|_| Vec::new());
        let known = |at: usize| {
            let (level, index) = self.place(view.floor[at])?;
            Some(self.levels[level].cells[index]).filter(|cell| cell.known)
        };
        let outside = || (0..view.floor.len()).filter(|at| !view.inside[*at]);
        for at in outside() {
            let Some(cell) = known(at) else { continue };
            let colour = view.colour(at);
            (0..3).for_each(|c| ratios[c].push((f32::from(colour[c]) + 2.0) / (f32::from(cell.colour[c]) + 2.0)));
        }
        if ratios[0].len() < 50 {
            return Tone::PLAIN;
        }
        let gain = ratios.map(|mut all| {
            let middle = all.len() / 2;
            *all.select_nth_unstable_by(middle, f32::total_cmp).1
        });
        let mut off: [Vec<f32>; 3] = std::array::from_fn(|_| Vec::new());
        for at in outside() {
            let Some(cell) = known(at) else { continue };
            let colour = view.colour(at);
            (0..3).for_each(|c| {
                let away = (f32::from(colour[c]) - gain[c] * f32::from(cell.colour[c])).abs();
                off[c].push((away - 0.25 * f32::from(cell.spread[c])).max(0.0));
            });
        }
        let noise = off.map(|mut all| {
            let at = all.len() * 7 / 10;
            all.select_nth_unstable_by(at, f32::total_cmp).1.max(LEAST_NOISE)
        });
        let tone = Tone { gain, noise, trust: 1.0 };
        let fits: Vec<Fit> = outside().filter_map(|at| self.fit(view, &tone, at)).collect();
        Tone { trust: trust_of(&fits), ..tone }
    }

    /// How the colour of a pixel fits if it shows the plane; `None` where the plane is not known or not seen.
    pub fn fit(&self, view: &View, tone: &Tone, at: usize) -> Option<Fit> {
        let (level, index) = self.place(view.floor[at])?;
        let cells = &self.levels[level].cells;
        let cell = cells[index];
        if !cell.known {
            return None;
        }
        let seen = view.colour(at);
        let sigma: [f32; 3] =
            std::array::from_fn(|c| (tone.noise[c].powi(2) + (0.25 * f32::from(cell.spread[c])).powi(2)).sqrt());
        let expected = |cell: &Cell| std::array::from_fn(|c| tone.gain[c] * f32::from(cell.colour[c]));
        let around = [index - SIDE, index, index + SIDE].into_iter().flat_map(|row| &cells[row - 1..=row + 1]);
        Some(Fit::new(seen, expected(&cell), around.filter(|c| c.known).map(expected), &sigma))
    }
}

/// How a colour fits what is expected.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// The expected colour of the place itself.
    pub expected: [u8; 3],
    /// Density of the colour, relative to the density if all colours were alike.
    pub density: f32,
}

impl Fit {
    /// That of a colour if one of the colours `around` is right, of which `expected` is that of the place itself.
    pub fn new(seen: [u8; 3], expected: [f32; 3], around: impl Iterator<Item = [f32; 3]>, sigma: &[f32; 3]) -> Self {
        let (sum, count) =
            around.fold((0.0, 0.0f32), |(sum, n), other| (sum + fit_density(seen, other, sigma), n + 1.0));
        Self { expected: expected.map(|c| c.round().clamp(0.0, 255.0) as u8), density: sum / count.max(1.0) }
    }
}

/// Density of a colour about an expected one with spread `sigma`, relative to the density if all colours were alike: Student's t of four degrees
/// in three dimensions.
pub(super) fn fit_density(seen: [u8; 3], expected: [f32; 3], sigma: &[f32; 3]) -> f32 {
    let q: f32 = (0..3).map(|c| ((f32::from(seen[c]) - expected[c]) / sigma[c]).powi(2)).sum();
    let base = 1.0 / (1.0 + 0.25 * q);
    0.0746 * 256f32.powi(3) / (sigma[0] * sigma[1] * sigma[2]) * base * base * base * base.sqrt()
}

/// Share of the fits that say "as expected": more than if all colours were alike. At most 0.9.
pub(super) fn trust_of(fits: &[Fit]) -> f32 {
    const MOST: f32 = 0.9;
    let fit = fits.iter().filter(|fit| fit.density > 1.0).count() as f32;
    (fit / (fits.len().max(1) as f32)).min(MOST)
}

/// Sorts and gives the ends of the narrowest run that holds `share` of the values. Not for empty slices.
pub(super) fn densest(all: &mut [f32], share: f64) -> (usize, usize) {
    all.sort_unstable_by(f32::total_cmp);
    let run = ((all.len() as f64 * share).ceil() as usize).clamp(1, all.len());
    let width = |from: usize| all[from + run - 1] - all[from];
    let from = (0..=all.len() - run).min_by(|a, b| width(*a).total_cmp(&width(*b))).unwrap_or(0);
    (from, from + run - 1)
}

/// Whether a point of the plane lies below the box.
fn covers(footprint: &Bounds, p: &Point3<f64>) -> bool {
    (0..2).all(|k| footprint.lower[k] <= p[k] && p[k] <= footprint.upper[k])
}

/// Fills in the range of the colours of the 3 x 3 cells around each cell.
fn spread_of_neighbours(cells: &mut [Cell]) {
    let before: Vec<Cell> = cells.to_vec();
    for y in 1..SIDE - 1 {
        for x in 1..SIDE - 1 {
            let index = y * SIDE + x;
            if !before[index].known {
                continue;
            }
            let (mut low, mut high) = ([255u8; 3], [0u8; 3]);
            for row in [index - SIDE, index, index + SIDE] {
                for other in before[row - 1..=row + 1].iter().filter(|c| c.known) {
                    for c in 0..3 {
                        low[c] = low[c].min(other.colour[c]);
                        high[c] = high[c].max(other.colour[c]);
                    }
                }
            }
            cells[index].spread = std::array::from_fn(|c| high[c] - low[c]);
        }
    }
}
