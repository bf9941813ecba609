//! Masks of the object, one per photo, from cameras, sparse points, the support plane and a box: no weights, no network.
//!
//! ```text
//! points ──► plane settled ──► picture of the plane ─┐
//!        └─► seeds ──────────────────────────────────┤
//! photos ──► colours in and around the box ──────────┴► evidence per pixel ──► vote of all photos per voxel
//!                    ▲                                                               │
//!                    └──────── masks ◄── cut per photo ◄── silhouette ◄── 3D cut ◄───┘      (a few rounds)
//!                                          └──► cut at full size along the border ──► masks
//! ```
//! - A ray that misses the box shows background.
//! - What lies on the plane, cast shadows included, looks the same from everywhere when it is put back onto the plane
//!   ([`table`]); this tells the object from a table of the same colours.
//! - Colours of object and background are learned from the masks so far ([`colour`]).
//! - What one photo says is weak; all photos together say for each voxel whether it is full ([`hull`]), after Campbell,
//!   Vogiatzis, Hernandez and Cipolla, "Automatic 3D object segmentation in multiple views using volumetric graph-cuts" (2010).
//!
//! The same input gives the same bytes with any number of threads.

mod backdrop;
mod colour;
mod cut;
mod hull;
mod maxflow;
mod points;
mod refine;
mod table;
#[cfg(test)]
mod tests;
mod view;

use drex_core::Pose;
use drex_core::camera::Camera;
use nalgebra::Point3;
use rayon::prelude::*;

use self::backdrop::Backdrop;
use self::colour::Histogram;
use self::cut::{Cut, Pixel, signed_distance};
use self::hull::Grid;
use self::table::{Table, Tone};
use self::view::{Bounds, Eye, View, Window};

/// A photo, RGB, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Photo {
    /// Width in pixels.
    pub width_px: u32,
    /// Height in pixels.
    pub height_px: u32,
    /// Three bytes per pixel.
    pub rgb: Vec<u8>,
}

/// Where a photo was taken from.
#[derive(Debug, Clone)]
pub struct MaskView {
    /// What sentences call the photo.
    pub name: String,
    /// The lens.
    pub camera: Camera,
    /// Camera axes x right, y down, z forward.
    pub camera_from_world: Pose,
}

/// A sparse point of the scene.
#[derive(Debug, Clone)]
pub struct MaskPoint {
    /// World frame, the scene's unit.
    pub position: Point3<f64>,
    /// Colour.
    pub rgb: [u8; 3],
    /// The photos that saw it.
    pub photos: Vec<u32>,
}

/// The support plane and the box around what stands on it.
#[derive(Debug, Clone)]
pub struct MaskRegion {
    /// A frame with the plane at z = 0, z up, axes along the box.
    pub world_from_region: Pose,
    /// Lower corner of the box in this frame, the scene's unit.
    pub lower: Point3<f64>,
    /// Upper corner of the box in this frame.
    pub upper: Point3<f64>,
}

/// What masks are made from.
pub struct MaskInput<'a> {
    /// One per photo.
    pub views: &'a [MaskView],
    /// Any number; fewer make the start weaker.
    pub points: &'a [MaskPoint],
    /// Plane and box.
    pub region: &'a MaskRegion,
    /// Reads photo `i`, of the size that its camera says; called twice per photo, from several threads.
    pub load: &'a (dyn Fn(usize) -> std::result::Result<Photo, String> + Sync),
}

/// How masks are made.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MaskOptions {
    /// How often colours, vote and cut are repeated.
    pub rounds: usize,
    /// Voxels of the box, about.
    pub voxels: usize,
    /// The box is cut at about this many pixels on a side, before the border is refined at full size.
    pub working_px: f64,
}

impl Default for MaskOptions {
    fn default() -> Self {
        Self { rounds: tune("ROUNDS", 3.0) as usize, voxels: 300_000, working_px: 200.0 }
    }
}

/// The mask of a photo.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// Width of the photo in pixels.
    pub width_px: u32,
    /// Height of the photo in pixels.
    pub height_px: u32,
    /// 0 to 1: how well the photo and the shape that all photos voted for agree.
    pub confidence: f64,
    /// Share of the object's pixels that could as well be background or the other way round.
    pub undecided: f64,
    /// What is doubtful about it, in a sentence.
    pub doubt: Option<String>,
    window: Window,
    object: Vec<bool>,
}

impl Mask {
    /// One byte per pixel, row by row: 255 where the photo shows the object, else 0.
    pub fn pixels(&self) -> Vec<u8> {
        let (w, h) = (self.width_px as usize, self.height_px as usize);
        let mut all = vec![0; w * h];
        for (y, row) in self.object.chunks_exact(self.window.width().max(1)).enumerate() {
            let at = (y + self.window.y0) * w + self.window.x0;
            for (pixel, object) in all[at..at + row.len()].iter_mut().zip(row) {
                *pixel = if *object { 255 } else { 0 };
            }
        }
        all
    }

    /// Number of pixels that show the object.
    pub fn object_px(&self) -> usize {
        self.object.iter().filter(|o| **o).count()
    }

    fn empty(camera: &Camera, doubt: String) -> Self {
        Self {
            width_px: camera.width_px(),
            height_px: camera.height_px(),
            confidence: 0.0,
            undecided: 1.0,
            doubt: Some(doubt),
            window: Window { x0: 0, y0: 0, x1: 0, y1: 0 },
            object: Vec::new(),
        }
    }
}

/// Why no masks were made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MaskError {
    /// No photo.
    #[error("no photos to mask; give the photos of the reconstruction")]
    NoPhotos,
    /// The box has no volume above the plane, or a number is not finite.
    #[error(
        "the box from {lower:?} to {upper:?} (frame of the plane, z up) has no volume above the plane; give a box around the object"
    )]
    Box {
        /// Lower corner.
        lower: [f64; 3],
        /// Upper corner.
        upper: [f64; 3],
    },
    /// A photo could not be read.
    #[error("photo {name} cannot be read: {reason}")]
    Photo {
        /// Name of the photo.
        name: String,
        /// Why.
        reason: String,
    },
    /// A photo is not of its camera's size.
    #[error(
        "photo {name} has {width_px} x {height_px} pixels ({bytes} bytes), its camera {camera_width_px} x {camera_height_px}; \
         give the photos that the cameras were computed from"
    )]
    Size {
        /// Name of the photo.
        name: String,
        /// Width of the photo.
        width_px: u32,
        /// Height of the photo.
        height_px: u32,
        /// Length of its data.
        bytes: usize,
        /// Width that the camera says.
        camera_width_px: u32,
        /// Height that the camera says.
        camera_height_px: u32,
    },
}

/// The object's mask in each photo, in their order.
///
/// `progress` hears the share done, 0 to 1, and what is being done.
///
/// # Errors
/// If there is no photo, the box is empty, or a photo cannot be read or is not of its camera's size.
pub fn make_masks(
    input: &MaskInput<'_>,
    options: &MaskOptions,
    progress: &mut dyn FnMut(f64, &str),
) -> Result<Vec<Mask>, MaskError> {
    if input.views.is_empty() {
        return Err(MaskError::NoPhotos);
    }
    let (world_from_region, bounds) = frame(input)?;
    progress(0.0, "read photos");
    let views = read_views(input, &world_from_region, &bounds, options)?;
    let mut state = Work::new(input, views, &world_from_region, bounds, options);
    for round in 0..options.rounds.max(1) {
        progress(0.1 + 0.7 * round as f64 / options.rounds.max(1) as f64, "cut");
        state.round(round);
    }
    progress(0.8, "refine borders");
    finish(input, &state)
}

/// The settled frame and the box on its plane.
fn frame(input: &MaskInput<'_>) -> Result<(Pose, Bounds), MaskError> {
    let region = input.region;
    let refuse = || MaskError::Box { lower: region.lower.coords.into(), upper: region.upper.coords.into() };
    let pose = region.world_from_region;
    let finite =
        region.lower.iter().chain(region.upper.iter()).chain(pose.to_homogeneous().iter()).all(|v| v.is_finite());
    let mut lower = region.lower;
    lower.z = 0.0;
    let size = region.upper - lower;
    if !finite || !size.iter().all(|s| *s > 0.0) || !(size.min() > 1e-4 * size.max()) {
        return Err(refuse());
    }
    Ok((points::settle(region, input.points), Bounds { lower, upper: region.upper }))
}

fn load(input: &MaskInput<'_>, photo: usize) -> Result<Photo, MaskError> {
    let view = &input.views[photo];
    let loaded = (input.load)(photo).map_err(|reason| MaskError::Photo { name: view.name.clone(), reason })?;
    let (width, height) = (view.camera.width_px(), view.camera.height_px());
    if (loaded.width_px, loaded.height_px) != (width, height)
        || loaded.rgb.len() != 3 * width as usize * height as usize
    {
        return Err(MaskError::Size {
            name: view.name.clone(),
            width_px: loaded.width_px,
            height_px: loaded.height_px,
            bytes: loaded.rgb.len(),
            camera_width_px: width,
            camera_height_px: height,
        });
    }
    Ok(loaded)
}

/// The photos that see the box, at working size.
fn read_views(
    input: &MaskInput<'_>,
    world_from_region: &Pose,
    bounds: &Bounds,
    options: &MaskOptions,
) -> Result<Vec<View>, MaskError> {
    const MOST_PX: f64 = 1e6;
    let views: Result<Vec<Option<View>>, MaskError> = (0..input.views.len())
        .into_par_iter()
        .map(|photo| {
            let view = &input.views[photo];
            let eye = Eye::new(&view.camera, &(view.camera_from_world * world_from_region));
            let Some(window) = eye.window(bounds) else { return Ok(None) };
            let side = (window.len() as f64).sqrt();
            let [w, h] = eye.size_px();
            let whole = (w as f64 * h as f64 / MOST_PX).sqrt().ceil();
            let shrink = (side / options.working_px.max(16.0)).round().max(whole).max(1.0) as usize;
            Ok(View::new(photo, eye, &load(input, photo)?, shrink.min(w.min(h)), bounds))
        })
        .collect();
    Ok(views?.into_iter().flatten().collect())
}

/// What is known so far.
struct Work {
    views: Vec<View>,
    table: Table,
    tones: Vec<Tone>,
    /// Places of the background away from the plane.
    behind: Vec<Point3<f64>>,
    /// Per view, what stands behind, and its noise.
    backdrops: Vec<(Backdrop, [f32; 3])>,
    grid: Grid,
    /// Voxels with points of the object.
    full_seeds: Vec<(usize, f32)>,
    /// Per view: pixels at which points appear, and whether they are the object's.
    seen: Vec<Vec<(usize, bool)>>,
    object: Histogram,
    /// Per view, per pixel of the window.
    masks: Vec<Vec<bool>>,
    silhouettes: Vec<Vec<bool>>,
    /// Log-likelihood ratio, silhouette included, nats.
    evidence: Vec<Vec<f32>>,
}

impl Work {
    fn new(
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
        table.find_bare(&views, &tones);
        table.paint(&views, &tones, None);
        if let Ok(n) = std::env::var("DUMP") {
            table.dump(&n);
        }
        let grid = Grid::new(&bounds, options.voxels.clamp(1000, 4_000_000));
        let seeds = points::seeds(input.points, world_from_region, &bounds);
        let full_seeds =
            seeds.iter().filter(|s| s.object).filter_map(|s| Some((grid.index(&s.position)?, 2.0))).collect();
        let seen = points::seen(&seeds, input.points, &views);
        let behind = points::behind(input.points, world_from_region, &bounds);
        Self {
            table,
            tones,
            behind,
            backdrops: Vec::new(),
            grid,
            full_seeds,
            seen,
            object: Histogram::new(),
            masks: Vec::new(),
            silhouettes: Vec::new(),
            evidence: Vec::new(),
            views,
        }
    }

    /// Colours, evidence, vote, cut.
    fn round(&mut self, round: usize) {
        if round > 0 {
            self.table.paint(&self.views, &self.tones, Some(&self.masks));
            self.tones = self.views.par_iter().map(|view| self.table.tone(view)).collect();
        }
        let masks = (!self.masks.is_empty()).then_some(self.masks.as_slice());
        self.backdrops = (0..self.views.len())
            .into_par_iter()
            .map(|k| {
                let view = &self.views[k];
                let wanted = |at: usize| !self.table.is_settled(view.floor[at]);
                let backdrop = Backdrop::new(&self.views, k, &self.tones, &self.behind, &wanted, masks);
                let noise = backdrop.noise(view);
                (backdrop, noise)
            })
            .collect();
        let backgrounds: Vec<Histogram> = (0..self.views.len()).into_par_iter().map(|k| self.background(k)).collect();
        self.object = self.object_colours(&backgrounds);
        let evidence: Vec<Vec<f32>> =
            (0..self.views.len()).into_par_iter().map(|k| self.colour_evidence(k, &backgrounds[k])).collect();
        let likely: Vec<Vec<u8>> = evidence
            .iter()
            .zip(&self.views)
            .map(|(all, view)| {
                let p = |nats: f32| (255.0 / (1.0 + (-nats).exp())).round() as u8;
                all.iter().zip(&view.inside).map(|(nats, inside)| if *inside { p(*nats) } else { 0 }).collect()
            })
            .collect();
        self.grid.vote(&self.views, &likely, &self.full_seeds);
        self.silhouettes = self.grid.silhouettes(&self.views);
        let cuts: Vec<(Vec<f32>, Vec<bool>)> =
            (0..self.views.len()).into_par_iter().map(|k| self.cut(k, &evidence[k])).collect();
        (self.evidence, self.masks) = cuts.into_iter().unzip();
        if let Ok(n) = std::env::var("DBG") {
            let k = self.views.iter().position(|v| v.photo == n.parse::<usize>().unwrap_or(0)).unwrap_or(0);
            let v = &self.views[k];
            let w = v.window;
            let mut out = Vec::new();
            for y in 0..w.height() {
                for part in 0..5 {
                    for x in 0..w.width() {
                        let at = y * w.width() + x;
                        out.extend(match part {
                            0 => v.colour(at),
                            1 => self.backdrops[k].0.rgb(at),
                            2 => [likely[k][at]; 3],
                            3 => [if self.silhouettes[k][at] { 255 } else { 0 }; 3],
                            _ => [if self.masks[k][at] { 255 } else { 0 }; 3],
                        });
                    }
                }
            }
            let _ = image::save_buffer(format!("/tmp/masks_dev/dbg{round}.png"), &out, 5 * w.width() as u32, w.height() as u32, image::ColorType::Rgb8);
            eprintln!("{} noise {:?} tone {:?} points {}", k, self.backdrops[k].1, self.tones[k], self.behind.len());
        }
    }

    /// Colours of the background in a view: around the box, and in it where the mask says so.
    ///
    /// Before there are masks, the cast shadow of the object is in the box and nowhere else: the table's colours are added
    /// as they are in the shade.
    fn background(&self, k: usize) -> Histogram {
        const SHADE: [f32; 5] = [0.4, 0.5, 0.6, 0.7, 0.85];
        #[allow(non_snake_case)]
        let SHADE_WEIGHT: f32 = tune("SHADE", 0.08);
        let view = &self.views[k];
        let mut all = Histogram::new();
        for at in 0..view.inside.len() {
            let free = self.masks.get(k).is_some_and(|mask| !mask[at]);
            if view.inside[at] && !free {
                continue;
            }
            let colour = view.colour(at);
            all.add(colour, 1.0);
            if self.masks.is_empty() && self.table.is_known(view.floor[at]) {
                for shade in SHADE {
                    all.add(colour.map(|c| (f32::from(c) * shade) as u8), SHADE_WEIGHT);
                }
            }
        }
        all.smoothed(1)
    }

    /// Colours of the object over all views.
    fn object_colours(&self, backgrounds: &[Histogram]) -> Histogram {
        // Share of the box's pixels that is taken for background at the start.
        #[allow(non_snake_case)]
        let BACKGROUND: f32 = tune("BG", 0.7);
        let parts: Vec<Histogram> = self
            .views
            .par_iter()
            .enumerate()
            .map(|(k, view)| {
                let mut all = Histogram::new();
                if let Some(mask) = self.masks.get(k) {
                    (0..mask.len()).filter(|at| mask[*at]).for_each(|at| all.add(view.colour(at), 1.0));
                    return all;
                }
                for at in (0..view.inside.len()).filter(|at| view.inside[*at]) {
                    let expected = self.expected(k, at).unwrap_or(0.0);
                    all.add(view.colour(at), 1.0 / (1.0 + 0.2 * expected));
                }
                let mut all = all.smoothed(1).without(&backgrounds[k], BACKGROUND);
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

    /// Density of the colour of a pixel if it shows the plane or what stands behind, where either is known.
    fn expected(&self, k: usize, at: usize) -> Option<f32> {
        let view = &self.views[k];
        self.table.density(view, &self.tones[k], at).or_else(|| {
            let (backdrop, noise) = &self.backdrops[k];
            backdrop.density(view.colour(at), noise, at)
        })
    }

    /// Log-likelihood ratio of each pixel of a view by its colour, nats.
    fn colour_evidence(&self, k: usize, background: &Histogram) -> Vec<f32> {
        #[allow(non_snake_case)]
        let TABLE: f32 = tune("TABLE", 0.85);
        #[allow(non_snake_case)]
        let MOST: f32 = tune("MOST", 4.0);
        let view = &self.views[k];
        (0..view.inside.len())
            .map(|at| {
                if !view.inside[at] {
                    return -MOST;
                }
                let colour = view.colour(at);
                let mut other = background.density(colour);
                let object = (1.0 - tune("ANY", 0.1) - tune("LIKE", 0.2)) * self.object.density(colour) + tune("ANY", 0.1) + tune("LIKE", 0.2) * other;
                if let Some(expected) = self.expected(k, at) {
                    other = TABLE * expected + (1.0 - TABLE) * other;
                }
                (object / other).ln().clamp(-MOST, MOST)
            })
            .collect()
    }

    /// The cut of a view: its evidence with the silhouette in it, and the mask.
    fn cut(&self, k: usize, colours: &[f32]) -> (Vec<f32>, Vec<bool>) {
        let cw = tune("CW", 0.7);
        let most_in = tune("IN", 1.0);
        let most_out = tune("OUT", 3.0);
        let tune_slope = tune("SLOPE", 0.8);
        const SEED: f32 = 6.0;
        let view = &self.views[k];
        let (w, h) = (view.window.width(), view.window.height());
        let distance = signed_distance(&self.silhouettes[k], w, h);
        let mut evidence: Vec<f32> = (0..w * h)
            .map(|at| cw * colours[at] + (tune_slope * distance[at]).clamp(-most_out, most_in))
            .collect();
        for (at, object) in &self.seen[k] {
            evidence[*at] += if *object { SEED } else { -SEED };
        }
        let pixels: Vec<Pixel> =
            (0..w * h).map(|at| if view.inside[at] { Pixel::Open(evidence[at]) } else { Pixel::Background }).collect();
        let mask = Cut { width: w, height: h, pixels: &pixels, colour: &|at| view.colour(at) }.solve();
        (evidence, mask)
    }
}

/// Masks at full size, with what is doubtful about each.
fn finish(input: &MaskInput<'_>, work: &Work) -> Result<Vec<Mask>, MaskError> {
    let mut view_of = vec![None; input.views.len()];
    for (k, view) in work.views.iter().enumerate() {
        view_of[view.photo] = Some(k);
    }
    (0..input.views.len())
        .into_par_iter()
        .map(|photo| {
            let given = &input.views[photo];
            let Some(k) = view_of[photo] else {
                return Ok(Mask::empty(&given.camera, format!("{}: the box is not in the picture", given.name)));
            };
            let view = &work.views[k];
            let (coarse, s) = (view.window, view.shrink);
            let window = Window {
                x0: coarse.x0 * s,
                y0: coarse.y0 * s,
                x1: (coarse.x1 * s).min(given.camera.width_px() as usize),
                y1: (coarse.y1 * s).min(given.camera.height_px() as usize),
            };
            let object = refine::refine(&load(input, photo)?, &window, &work.masks[k], &coarse, s);
            let (mask, shape) = (&work.masks[k], &work.silhouettes[k]);
            let both = mask.iter().zip(shape).filter(|(m, s)| **m && **s).count() as f64;
            let either = mask.iter().zip(shape).filter(|(m, s)| **m || **s).count() as f64;
            let own = mask.iter().filter(|m| **m).count() as f64;
            let open = work.evidence[k].iter().zip(&view.inside).filter(|(e, i)| **i && e.abs() < 0.7).count() as f64;
            let undecided = (open / own.max(1.0)).min(1.0);
            let confidence = if either > 0.0 { both / either * (1.0 - 0.5 * undecided) } else { 0.0 };
            let doubt = if own == 0.0 {
                Some(format!("{}: nothing in the box looks unlike the background", given.name))
            } else if confidence < 0.75 {
                Some(format!(
                    "{}: {:.0} % of the mask is undecided, and it covers the shape that all photos voted for by {:.0} % only",
                    given.name,
                    100.0 * undecided,
                    100.0 * both / either
                ))
            } else {
                None
            };
            Ok(Mask {
                width_px: given.camera.width_px(),
                height_px: given.camera.height_px(),
                confidence,
                undecided,
                doubt,
                window,
                object,
            })
        })
        .collect()
}

pub(crate) fn tune(name: &str, default: f32) -> f32 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}
