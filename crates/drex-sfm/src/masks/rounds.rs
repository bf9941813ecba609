//! The rounds: colours, evidence, vote of all photos, cut of each.

use drex_core::Pose;
use nalgebra::Point3;
use rayon::prelude::*;

use super::backdrop::Backdrop;
use super::colour::{Conditional, Histogram};
use super::cut::{Cut, Pixel, signed_distance};
use super::hull::Grid;
use super::table::{Fit, Table, Tone};
use super::view::{Bounds, View};
use super::{MaskInput, MaskOptions, bare, points};

/// What is known so far.
pub(super) struct Work {
    pub views: Vec<View>,
    table: Table,
    tones: Vec<Tone>,
    /// Whether plane and background move relative to the object, so that neither can be foretold.
    moving: bool,
    /// Places of the background away from the plane.
    behind: Vec<Point3<f64>>,
    /// Per view, what stands behind, and how it fits.
    backdrops: Vec<(Backdrop, Tone)>,
    /// Per view, 0 to 1: how sharp it is beside the others.
    pub sharpness: Vec<f32>,
    grid: Grid,
    /// Voxels with points of the object.
    full_seeds: Vec<(usize, f32)>,
    /// Per view: pixels at which points appear, and whether they are the object's.
    seen: Vec<Vec<(usize, bool)>>,
    object: Histogram,
    /// Per view, per pixel of the window.
    pub masks: Vec<Vec<bool>>,
    pub silhouettes: Vec<Vec<bool>>,
    /// Per view, per pixel of the window: how likely it shows the object by its colour, 0 to 255.
    likely: Vec<Vec<u8>>,
    /// Log-likelihood ratio, silhouette included, nats.
    pub evidence: Vec<Vec<f32>>,
}

/// What a pixel shows if not the object.
#[derive(Debug, Clone, Copy)]
enum Place {
    Plane,
    Behind,
}

impl Work {
    pub fn new(
        input: &MaskInput<'_>,
        views: Vec<View>,
        world_from_region: &Pose,
        bounds: Bounds,
        options: &MaskOptions,
    ) -> Self {
        let mut table = Table::new(&views, &bounds);
        let mut tones = vec![Tone::PLAIN; views.len()];
        for _ in 0..2 {
            table.paint(&views, &tones, None);
            tones = views.par_iter().map(|view| table.tone(view)).collect();
        }
        let sharpness: Vec<Option<f32>> =
            views.par_iter().zip(&tones).map(|(view, tone)| table.sharpness(view, tone)).collect();
        let mut behind = points::behind(input.points, world_from_region, &bounds);
        let moving = moves(&sharpness, &tones);
        if moving {
            table.forget();
            behind.clear();
        } else {
            table.add_bare(&bare::find(&table, &views, &tones, None));
            table.paint(&views, &tones, None);
        }
        let grid = Grid::new(&bounds, options.voxels.clamp(1000, 4_000_000));
        let seeds = points::seeds(input.points, world_from_region, &bounds);
        let full_seeds =
            seeds.iter().filter(|s| s.object).filter_map(|s| Some((grid.index(&s.position)?, 2.0))).collect();
        let seen = points::seen(&seeds, input.points, &views);
        Self {
            table,
            tones,
            moving,
            behind,
            backdrops: Vec::new(),
            sharpness: relative(&sharpness),
            grid,
            full_seeds,
            seen,
            object: Histogram::new(),
            masks: Vec::new(),
            silhouettes: Vec::new(),
            likely: Vec::new(),
            evidence: Vec::new(),
            views,
        }
    }

    /// Colours, evidence, vote, cut.
    pub fn round(&mut self, round: usize) {
        if round > 0 {
            if round == 1 && !self.moving {
                self.table.add_bare(&bare::find(&self.table, &self.views, &self.tones, Some(&self.likely)));
            }
            self.table.paint(&self.views, &self.tones, Some(&self.masks));
            self.tones = self.views.par_iter().map(|view| self.table.tone(view)).collect();
        }
        let masks = (!self.masks.is_empty()).then_some(self.masks.as_slice());
        self.backdrops = (0..self.views.len())
            .into_par_iter()
            .map(|k| {
                let view = &self.views[k];
                let needed = |at: usize| !self.table.is_settled(view.floor[at]);
                let backdrop = Backdrop::new(&self.views, k, &self.tones, &self.behind, &needed, masks);
                let tone = backdrop.tone(view);
                (backdrop, tone)
            })
            .collect();
        let backgrounds: Vec<Histogram> = (0..self.views.len()).into_par_iter().map(|k| self.background(k)).collect();
        self.object = self.object_colours(&backgrounds);
        let evidence: Vec<Vec<f32>> =
            (0..self.views.len()).into_par_iter().map(|k| self.colour_evidence(k, &backgrounds[k])).collect();
        self.likely = evidence
            .iter()
            .zip(&self.views)
            .map(|(all, view)| {
                let p = |nats: f32| (255.0 / (1.0 + (-nats).exp())).round() as u8;
                all.iter().zip(&view.inside).map(|(nats, inside)| if *inside { p(*nats) } else { 0 }).collect()
            })
            .collect();
        self.grid.vote(&self.views, &self.likely, &self.full_seeds);
        self.silhouettes = self.grid.silhouettes(&self.views);
        let cuts: Vec<(Vec<f32>, Vec<bool>)> =
            (0..self.views.len()).into_par_iter().map(|k| self.cut(k, &evidence[k])).collect();
        (self.evidence, self.masks) = cuts.into_iter().unzip();
    }

    /// Colours of the background in a view: around the box, and in it where the mask says so.
    ///
    /// The cast shadow of the object may be in the box and nowhere else: the table's colours are added as they are in the
    /// shade.
    fn background(&self, k: usize) -> Histogram {
        const SHADE: [f32; 5] = [0.4, 0.5, 0.6, 0.7, 0.85];
        const SHADE_WEIGHT: f32 = 0.08;
        let view = &self.views[k];
        let mut all = Histogram::new();
        for at in 0..view.inside.len() {
            let free = self.masks.get(k).is_some_and(|mask| !mask[at]);
            if view.inside[at] && !free {
                continue;
            }
            let colour = view.colour(at);
            all.add(colour, 1.0);
            if self.table.is_known(view.floor[at]) && !view.inside[at] {
                for shade in SHADE {
                    all.add(colour.map(|c| (f32::from(c) * shade) as u8), SHADE_WEIGHT);
                }
            }
        }
        all.smoothed(1)
    }

    /// Colours of the object over all views.
    fn object_colours(&self, backgrounds: &[Histogram]) -> Histogram {
        // Share of the box's pixels that is taken for background at the start where it is not known.
        const BACKGROUND: f32 = 0.7;
        const DOUBTED: f32 = 0.1;
        let parts: Vec<Histogram> = self
            .views
            .par_iter()
            .enumerate()
            .map(|(k, view)| {
                let mut all = Histogram::new();
                if let Some(mask) = self.masks.get(k) {
                    // What the shape alone put into the mask, such as a shadow, does not teach colours.
                    for at in (0..mask.len()).filter(|at| mask[*at]) {
                        all.add(view.colour(at), if self.likely[k][at] > 127 { 1.0 } else { DOUBTED });
                    }
                    return all;
                }
                // Where nothing is expected, what is common round the box is taken away from what is seen.
                let mut unknown = Histogram::new();
                for at in (0..view.inside.len()).filter(|at| view.inside[*at]) {
                    match self.expected(k, at) {
                        Some((fit, place)) => {
                            let fit = self.tone(k, place).trust * fit.density;
                            all.add(view.colour(at), 1.0 / (1.0 + 0.2 * fit));
                        }
                        None => unknown.add(view.colour(at), 1.0),
                    }
                }
                all.merge(&unknown.smoothed(1).without(&backgrounds[k], BACKGROUND), 1.0);
                for (at, _) in self.seen[k].iter().filter(|(_, object)| *object) {
                    all.add(view.colour(*at), 10.0);
                }
                all
            })
            .collect();
        let mut sum = Histogram::new();
        parts.iter().for_each(|part| sum.merge(part, 1.0));
        sum.smoothed(1)
    }

    /// How the colour of a pixel fits if it shows the plane, or else what stands behind, where either is known.
    fn expected(&self, k: usize, at: usize) -> Option<(Fit, Place)> {
        let view = &self.views[k];
        let plane = || Some((self.table.fit(view, &self.tones[k], at)?, Place::Plane));
        let behind = || {
            let (backdrop, tone) = &self.backdrops[k];
            Some((backdrop.fit(view.colour(at), &tone.noise, at)?, Place::Behind))
        };
        plane().or_else(behind)
    }

    /// How a view differs from what is known of the plane or of what stands behind.
    fn tone(&self, k: usize, place: Place) -> &Tone {
        match place {
            Place::Plane => &self.tones[k],
            Place::Behind => &self.backdrops[k].1,
        }
    }

    /// Log-likelihood ratio of each pixel of a view by its colour, nats.
    fn colour_evidence(&self, k: usize, background: &Histogram) -> Vec<f32> {
        const MOST: f32 = 4.0;
        // The object's colours are known in part only: it may have any colour, and those of the background.
        const OWN: f32 = 0.7;
        const ANY: f32 = 0.1;
        let view = &self.views[k];
        let [mut plane, mut behind] =
            [Place::Plane, Place::Behind].map(|place| Conditional::new(background, &self.tone(k, place).noise));
        (0..view.inside.len())
            .map(|at| {
                if !view.inside[at] {
                    return -MOST;
                }
                let colour = view.colour(at);
                let mut other = background.density(colour);
                let object = OWN * self.object.density(colour) + ANY + (1.0 - OWN - ANY) * other;
                if let Some((fit, place)) = self.expected(k, at) {
                    let trust = self.tone(k, place).trust;
                    let conditional = match place {
                        Place::Plane => &mut plane,
                        Place::Behind => &mut behind,
                    };
                    other = trust * conditional.density(colour, &fit) + (1.0 - trust) * other;
                }
                (object / other).ln().clamp(-MOST, MOST)
            })
            .collect()
    }

    /// The cut of a view: its evidence with the silhouette in it, and the mask.
    fn cut(&self, k: usize, colours: &[f32]) -> (Vec<f32>, Vec<bool>) {
        // Nats: of the colours beside the silhouette, of the silhouette per pixel from its border and at most, and at points.
        const COLOURS: f32 = 0.7;
        const SLOPE: f32 = 0.8;
        const MOST_WITHIN: f32 = 1.0;
        const MOST_OUTSIDE: f32 = 3.0;
        const SEED: f32 = 6.0;
        let view = &self.views[k];
        let (w, h) = (view.window.width(), view.window.height());
        let distance = signed_distance(&self.silhouettes[k], w, h);
        let weight = COLOURS * self.sharpness[k].max(0.3);
        let shape = |at: usize| (SLOPE * distance[at]).clamp(-MOST_OUTSIDE, MOST_WITHIN);
        let mut evidence: Vec<f32> = (0..w * h).map(|at| weight * colours[at] + shape(at)).collect();
        for (at, object) in &self.seen[k] {
            evidence[*at] += if *object { SEED } else { -SEED };
        }
        let pixels: Vec<Pixel> =
            (0..w * h).map(|at| if view.inside[at] { Pixel::Open(evidence[at]) } else { Pixel::Background }).collect();
        let mask = Cut { width: w, height: h, pixels: &pixels, colour: &|at| view.colour(at) }.solve();
        (evidence, mask)
    }
}

/// Sharpness of each view over that of the median view, at most 1.
fn relative(sharpness: &[Option<f32>]) -> Vec<f32> {
    let usual = median(sharpness.iter().flatten().copied().filter(|s| *s > 0.0));
    sharpness.iter().map(|s| s.zip(usual).map_or(1.0, |(s, usual)| (s / usual).clamp(0.0, 1.0))).collect()
}

/// Whether the surroundings move relative to the object, as on a turntable: most photos show another pattern than the
/// picture of the plane, and not for want of a pattern.
fn moves(sharpness: &[Option<f32>], tones: &[Tone]) -> bool {
    const LEAST_LIKENESS: f32 = 0.35;
    const MOST_NOISE: f32 = 15.0;
    let likeness = median(sharpness.iter().flatten().copied());
    let noise = median(tones.iter().map(|tone| tone.noise[1]));
    likeness.is_some_and(|l| l < LEAST_LIKENESS) && noise.is_some_and(|n| n > MOST_NOISE)
}

fn median(values: impl Iterator<Item = f32>) -> Option<f32> {
    let mut all: Vec<f32> = values.collect();
    all.sort_by(f32::total_cmp);
    all.get(all.len() / 2).copied()
}
