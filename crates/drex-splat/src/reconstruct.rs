//! From a capture to Gaussians and their scores on photos held out.

use std::path::{Path, PathBuf};
use std::time::Instant;

use drex_core::camera::PinholeCamera;
use drex_core::capture::{Capture, CaptureReport, PhotoOptions, Photos, SparsePoint};
use drex_core::fsutil::{self, OutputFolder, output_path};
use drex_core::stats::{median, quantile};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

use crate::io::{picture, ply};
use crate::loss::MaskMode;
use crate::metrics::{Table, similarity};
use crate::train::{
    Density, DensityChoice, NEAR, Preset, Progress, SurfacePoint, TrainOptions, Trainer, VisualHull, from_points,
    from_surface,
};
use crate::{Error, Gaussians, Kind, Label, Rasterizer, RenderOptions, Result, usage};

/// What to reconstruct, and how carefully.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ReconstructOptions {
    /// How much time it may take.
    pub preset: Preset,
    /// How Gaussians are born and removed.
    pub density: DensityChoice,
    /// Every n-th photo by name is not trained on but measured against.
    pub hold_out: Option<usize>,
    /// Whether masks cut the object out. Without masks the whole scene is trained.
    pub use_masks: bool,
    /// Seed of everything random.
    pub seed: u64,
    /// Longest side of the photos instead of the preset's, pixels.
    pub max_side: Option<usize>,
    /// Steps of each set instead of the preset's.
    pub iterations: Option<u32>,
    /// Most Gaussians of each set instead of the preset's ([`Preset::max_gaussians`]).
    pub max_gaussians: Option<usize>,
    /// Places on the object's surface, where it is known: as many Gaussians start there, and stay whatever silhouettes say, instead of coming and
    /// going from the sparse points.
    pub born: Vec<SurfacePoint>,
    /// Whether each photo gets an affine colour of its own.
    pub exposure: bool,
    /// Whether poses are refined.
    pub refine_poses: bool,
    /// Weight of normal maps, where the capture has them, on the surfels.
    pub normal_weight: f32,
    /// Weight of depth maps, where the capture has them.
    pub depth_weight: f32,
    /// Steps between checkpoints; 0 for none.
    pub checkpoint_every: u32,
    /// Whether to go on from checkpoints in the output folder.
    pub resume: bool,
    /// Bytes of pictures that are kept in memory.
    pub memory_bytes: usize,
}

impl Default for ReconstructOptions {
    fn default() -> Self {
        Self {
            preset: Preset::Default,
            density: DensityChoice::default(),
            hold_out: None,
            use_masks: true,
            seed: 0,
            max_side: None,
            iterations: None,
            max_gaussians: None,
            born: Vec::new(),
            exposure: false,
            refine_poses: false,
            normal_weight: 0.05,
            depth_weight: 0.2,
            checkpoint_every: 1000,
            resume: false,
            memory_bytes: 1 << 30,
        }
    }
}

/// What came out; also written as `splat/report.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reconstruction {
    /// Photos trained on and held out.
    pub photos_trained: usize,
    /// See `photos_trained`.
    pub photos_held_out: usize,
    /// Photos left out, and why.
    pub left_out: Vec<String>,
    /// Whether only the object was trained.
    pub object_only: bool,
    /// The ellipsoids: looks.
    pub appearance: SetSummary,
    /// Peak memory of the process, bytes, where the system tells; not in the file, as it is another in every run.
    #[serde(skip)]
    pub peak_memory_bytes: Option<u64>,
}

/// One set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetSummary {
    /// Its file, relative to the output folder.
    pub file: String,
    /// Gaussians in it.
    pub gaussians: usize,
    /// Removed at the end because a silhouette excludes their centre.
    pub outside_hull: usize,
    /// Steps of training.
    pub iterations: u32,
    /// Processor seconds of all threads, where the system tells; not in the file.
    #[serde(skip)]
    pub core_seconds: Option<f64>,
    /// Seconds on the clock; not in the file.
    #[serde(skip)]
    pub seconds: f64,
    /// Scores on the photos held out, as they are: no exposure is fitted to them.
    pub held_out: Table,
}

/// A progress report: where training is, its steps in all, and seconds since it began.
pub type OnProgress<'a> = dyn FnMut(&Progress, u32, f64) + 'a;

/// Longest side at which silhouettes are kept, pixels; a bit a pixel.
const HULL_SIDE: usize = 2048;
/// Longest side of the pictures of what held-out photos should show, pixels.
const PICTURE_SIDE: usize = 1024;
/// On a known surface Gaussians only have to find their sizes,
const BORN_SCALE_RATE: f32 = 2.0;
/// and what photos of differing light show from each side.
const BORN_COLOUR_REST_RATE: f32 = 2.0;
/// Surfels also where the surface is: Adam's steps add up to about the rate times their number, and a silhouette leaves centimetres.
const BORN_SURFEL_RATE: f32 = 3.0;
/// A surface that is sought is to explain the photos, not their harmonics.
const BORN_SURFEL_SH_DEGREE: usize = 1;
/// Margin round a silhouette in which centres are kept, pixels at that size.
const HULL_MARGIN_PX: usize = 2;
/// Points of the hull that Gaussians start from.
const HULL_POINTS: usize = 2000;
/// They are sought in so many steps along a ray, and as far from the middle of the object's sparse points as most of these, times this.
const HULL_STEPS: u32 = 200;
/// Side of a patch of the photos, about what the windows of the structural similarity tell apart.
const PATCH_PX: usize = 8;
/// With a sparse point for so many patches the hull is not needed.
const PATCHES_A_POINT: usize = 4;
const HULL_REACH: f64 = 2.0;

/// Trains ellipsoids from `capture` and writes `splat/appearance.ply`, `splat/report.json` and, as `splat/held_out/NAME.png`, what they
/// show from where each held-out photo was taken.
///
/// Photos whose camera `report` calls far are left out, and where masks are used those whose mask it calls misplaced.
/// The files depend on capture and options alone.
///
/// # Errors
/// If there are no sparse points, too few photos, a photo or mask cannot be read, a view's name leads out of the folder of its picture or
/// to the file of another view, or a file cannot be written.
pub fn reconstruct<R: Rasterizer + Clone>(
    capture: &Capture,
    report: &CaptureReport,
    rasterizer: &R,
    out: &Path,
    options: &ReconstructOptions,
    on_progress: &mut OnProgress<'_>,
) -> Result<Reconstruction> {
    // Before hours of training.
    let report_file = output_path(out, "splat/report.json")?;
    let mut pictures = OutputFolder::new(out.join("splat/held_out"));
    let pictures: Vec<PathBuf> =
        capture.views.iter().map(|v| pictures.file(&format!("{}.png", stem_of(&v.name)))).collect::<Result<_, _>>()?;
    let job = Job::new(capture, report, options)?;
    let appearance = job.train(Kind::Ellipsoid, rasterizer, out, on_progress)?;
    let near = NEAR * capture.extent() as f32;
    let render_options = RenderOptions { near, ..RenderOptions::default() };
    for &i in &job.held_out {
        let camera = &fitting(job.photos.camera(i), PICTURE_SIDE);
        let seen = rasterizer.forward(&appearance.0, camera, &render_options)?.0;
        picture::write_rgba(&pictures[i], camera.width, camera.height, &seen.rgb, &seen.alpha)?;
    }
    let reconstruction = Reconstruction {
        photos_trained: job.trained.len(),
        photos_held_out: job.held_out.len(),
        left_out: job.left_out,
        object_only: job.masked,
        appearance: appearance.1,
        peak_memory_bytes: usage::peak_memory_bytes(),
    };
    let text = serde_json::to_string_pretty(&reconstruction).map_err(|e| Error::Option {
        what: format!("the report cannot be written: {e}"),
        remedy: "look for numbers that are not finite".into(),
    })?;
    fsutil::write_atomic(&report_file, text.as_bytes())?;
    remove_checkpoint(out, Kind::Ellipsoid)?;
    Ok(reconstruction)
}

/// Trains surfels that are born on a known surface ([`ReconstructOptions::born`]) and writes `splat/surface.ply`. Photos are chosen and held out as by
/// [`reconstruct()`].
///
/// # Errors
/// If no place is given where they are born, and as [`reconstruct()`].
pub fn train_surfels<R: Rasterizer + Clone>(
    capture: &Capture,
    report: &CaptureReport,
    rasterizer: &R,
    out: &Path,
    options: &ReconstructOptions,
    on_progress: &mut OnProgress<'_>,
) -> Result<(Gaussians, SetSummary)> {
    if options.born.is_empty() {
        return Err(Error::Option {
            what: "no place is given where surfels are born".into(),
            remedy: "give points on a mesh of the object as ReconstructOptions::born".into(),
        });
    }
    output_path(out, "splat/surface.ply")?;
    let trained = Job::new(capture, report, options)?.train(Kind::Surfel, rasterizer, out, on_progress)?;
    remove_checkpoint(out, Kind::Surfel)?;
    Ok(trained)
}

fn name_of(kind: Kind) -> &'static str {
    match kind {
        Kind::Ellipsoid => "appearance",
        Kind::Surfel => "surface",
    }
}

fn checkpoint_of(out: &Path, kind: Kind) -> PathBuf {
    out.join(format!("splat/{}.checkpoint", name_of(kind)))
}

fn remove_checkpoint(out: &Path, kind: Kind) -> Result<()> {
    let checkpoint = checkpoint_of(out, kind);
    if checkpoint.exists() {
        std::fs::remove_file(&checkpoint).map_err(|e| drex_core::Error::io("remove", checkpoint, e))?;
    }
    Ok(())
}

/// The mask of a photo as the hull needs it.
enum Silhouette {
    Missing,
    Empty,
    Shape(VisualHull),
}

/// The silhouette of every view, from its mask at (nearly) full size, one after the other.
fn silhouettes(capture: &Capture) -> Result<Vec<Silhouette>> {
    let mut photo_options = PhotoOptions::default();
    (photo_options.max_side, photo_options.memory_bytes) = (Some(HULL_SIDE), 0);
    let photos = Photos::new(capture, photo_options)?;
    let silhouette = |i: usize| {
        let view = &capture.views[i];
        let may_be_transparent =
            view.photo.extension().is_some_and(|e| !e.eq_ignore_ascii_case("jpg") && !e.eq_ignore_ascii_case("jpeg"));
        if view.mask.is_none() && !may_be_transparent {
            return Ok(Silhouette::Missing);
        }
        let photo = photos.get(i)?;
        let Some(mask) = &photo.mask else { return Ok(Silhouette::Missing) };
        if mask.iter().all(|&m| m < 128) {
            return Ok(Silhouette::Empty);
        }
        let mut shape = VisualHull::new();
        shape.add(&photo.camera, mask, HULL_MARGIN_PX);
        Ok(Silhouette::Shape(shape))
    };
    (0..photos.len()).map(silhouette).collect()
}

/// What sets of the same photos share.
struct Job<'a> {
    capture: &'a Capture,
    options: &'a ReconstructOptions,
    photos: Photos,
    trained: Vec<usize>,
    held_out: Vec<usize>,
    left_out: Vec<String>,
    masked: bool,
    /// Silhouettes of the photos trained on, empty unless masks are used.
    hull: VisualHull,
    /// Silhouettes of all photos: cuts the finished sets, after they have been measured, or labels a whole scene.
    whole_hull: VisualHull,
}

impl<'a> Job<'a> {
    fn new(capture: &'a Capture, report: &CaptureReport, options: &'a ReconstructOptions) -> Result<Self> {
        if report.views.len() != capture.views.len() {
            return Err(Error::Option {
                what: format!(
                    "the report is of {} photos, the capture has {}",
                    report.views.len(),
                    capture.views.len()
                ),
                remedy: "give the report of this capture".into(),
            });
        }
        let max_side = Some(options.max_side.unwrap_or(options.preset.max_side()));
        let mut photo_options = PhotoOptions::default();
        (photo_options.max_side, photo_options.memory_bytes) = (max_side, options.memory_bytes);
        let photos = Photos::new(capture, photo_options)?;
        if options.hold_out.is_some_and(|n| n < 2) {
            return Err(Error::Option {
                what: "every photo would be held out".into(),
                remedy: "hold out every 2nd or fewer".into(),
            });
        }
        let silhouettes = silhouettes(capture)?;
        let masked = options.use_masks && silhouettes.iter().any(|s| !matches!(s, Silhouette::Missing));
        let (mut trained, mut held_out, mut left_out) = (Vec::new(), Vec::new(), Vec::new());
        let (mut hull, mut whole_hull) = (VisualHull::new(), VisualHull::new());
        for (i, (view, silhouette)) in capture.views.iter().zip(&silhouettes).enumerate() {
            let misplaced = report.views[i].mask.as_ref().is_some_and(|m| m.misplaced);
            let far = report.views[i].far;
            let reason = match silhouette {
                _ if far => Some("its camera stands far from all others"),
                Silhouette::Missing if masked => Some("it has no mask"),
                Silhouette::Empty if masked => Some("its mask is empty"),
                Silhouette::Shape(_) if masked && misplaced => Some("its mask looks misplaced"),
                _ => None,
            };
            let holds_out = options.hold_out.is_some_and(|n| i % n == 0);
            match reason {
                Some(why) => left_out.push(format!("{}: {why}", view.name)),
                None if holds_out => held_out.push(i),
                None => trained.push(i),
            }
            if let (false, Silhouette::Shape(shape)) = (far || misplaced, silhouette) {
                whole_hull.extend(shape);
                if masked && !holds_out {
                    hull.extend(shape);
                }
            }
        }
        if trained.len() < 2 && !left_out.is_empty() {
            return Err(drex_core::Error::capture(
                format!("photos left to train on: {}; left out: {}", trained.len(), left_out.join("; ")),
                "mend the masks or cameras, or train the whole scene without masks",
            )
            .into());
        }
        Ok(Self { capture, options, photos, trained, held_out, left_out, masked, hull, whole_hull })
    }

    /// Trains one set, measures it, cuts it to the hull and writes it.
    fn train<R: Rasterizer + Clone>(
        &self,
        kind: Kind,
        rasterizer: &R,
        out: &Path,
        on_progress: &mut OnProgress<'_>,
    ) -> Result<(Gaussians, SetSummary)> {
        let (clock, cores) = (Instant::now(), usage::core_seconds());
        let checkpoint = checkpoint_of(out, kind);
        let wanted = self.train_options(kind);
        wanted.check()?;
        let extent = self.capture.extent();
        let indices = self.trained.clone();
        let mut trainer = if self.options.resume && checkpoint.exists() {
            Trainer::resume(&self.photos, indices, rasterizer.clone(), extent, &checkpoint)?
        } else {
            let first = self.first(&wanted)?;
            Trainer::new(&self.photos, indices, rasterizer.clone(), first, extent, wanted.clone())?
        };
        if *trainer.options() != wanted {
            return Err(Error::Training {
                what: format!("{} was made with other settings", checkpoint.display()),
                remedy: "give the settings it was made with, or leave --resume out to start anew".into(),
            });
        }
        if !self.is_born() {
            trainer.set_hull(self.hull.clone());
        }
        while !trainer.is_done() {
            let progress = trainer.step()?;
            let every = self.options.checkpoint_every;
            if every > 0 && progress.step.is_multiple_of(every) {
                trainer.save(&checkpoint)?;
            }
            on_progress(&progress, trainer.options().iterations, clock.elapsed().as_secs_f64());
        }
        let core_seconds = usage::core_seconds().zip(cores).map(|(now, then)| now - then);
        let seconds = clock.elapsed().as_secs_f64();
        let held_out = self.score(&trainer)?;
        let outside_hull = if self.masked && !self.is_born() { trainer.cut(&self.whole_hull) } else { 0 };
        let mut gaussians = trainer.gaussians().clone();
        for (label, mean) in gaussians.labels.iter_mut().zip(&gaussians.means) {
            // In a whole scene a place that no silhouette can judge is not the object's.
            let object = self.masked || (self.whole_hull.seen_by(mean) >= 2 && self.whole_hull.contains(mean));
            *label = if object { Label::OBJECT } else { Label::BACKGROUND };
        }
        let file = format!("splat/{}.ply", name_of(kind));
        ply::write(&out.join(&file), &gaussians)?;
        let iterations = trainer.steps_done();
        let summary =
            SetSummary { file, gaussians: gaussians.len(), outside_hull, iterations, core_seconds, seconds, held_out };
        Ok((gaussians, summary))
    }

    /// Whether the sets start on the known surface.
    fn is_born(&self) -> bool {
        !self.options.born.is_empty()
    }

    fn train_options(&self, kind: Kind) -> TrainOptions {
        let o = self.options;
        let mut options = o.preset.train_options(kind, o.density, self.capture.points.len());
        options.seed = o.seed;
        options.iterations = o.iterations.unwrap_or(options.iterations);
        options.max_gaussians = o.max_gaussians.unwrap_or(options.max_gaussians);
        options.exposure = o.exposure;
        options.refine_poses = o.refine_poses;
        options.surface.prior_normal = o.normal_weight;
        options.depth_weight = o.depth_weight;
        if self.is_born() {
            options.max_gaussians = o.born.len();
            options.density = Density::Fixed;
            options.coarse.clear();
            options.rates.scale *= BORN_SCALE_RATE;
            if kind == Kind::Surfel {
                options.sh_degree = BORN_SURFEL_SH_DEGREE;
                options.rates.position *= BORN_SURFEL_RATE;
                options.rates.position_end *= BORN_SURFEL_RATE;
            } else {
                options.rates.colour_rest *= BORN_COLOUR_REST_RATE;
            }
        }
        if self.masked {
            options.masks = MaskMode::Transparent;
            options.background = None;
        } else {
            // An open scene: depth has steps that the terms would smear (2DGS, section 5, weighs it less, too).
            options.surface.median_share = 0.0;
            options.surface.distortion = 1.0;
        }
        options
    }

    /// The first Gaussians: the sparse points; if masks are used, those of the object, and points of the visual hull.
    fn first(&self, options: &TrainOptions) -> Result<Gaussians> {
        if self.is_born() {
            return Ok(from_surface(&self.options.born, options.kind, options.sh_degree));
        }
        let kept: Vec<_> =
            self.capture.points.iter().filter(|p| self.hull.contains(&p.position.map(|v| v as f32))).collect();
        if kept.is_empty() {
            return Err(drex_core::Error::capture(
                format!("of {} sparse points none lies on the object", self.capture.points.len()),
                "give a model with points3D, or check that the masks show the object in white",
            )
            .into());
        }
        let step = kept.len().div_ceil(options.max_gaussians);
        let mut first: Vec<_> = kept.iter().step_by(step).map(|p| (p.position, p.rgb)).collect();
        if self.masked {
            first.extend(self.hull_points(&kept, HULL_POINTS.min(options.max_gaussians - first.len()))?);
        }
        let (points, colours): (Vec<_>, Vec<_>) = first.into_iter().unzip();
        let opacity = if matches!(options.density, Density::Mcmc(_)) { 0.5 } else { 0.1 };
        Ok(from_points(&points, &colours, options.kind, options.sh_degree, opacity))
    }

    /// About `count` places where rays of the photos' masks enter the visual hull, in the colours of their pixels. Sparse points
    /// are few where a thing has little texture, and what starts from them alone takes thousands of steps to cover it. None
    /// where there is a sparse point for every four patches of the masks: they know better where the surface is than the hull.
    fn hull_points(&self, object: &[&SparsePoint], count: usize) -> Result<Vec<([f64; 3], [u8; 3])>> {
        let mut shown = 0;
        for &view in &self.trained {
            shown += self.photos.get(view)?.mask.as_ref().map_or(0, |m| m.iter().filter(|&&v| v >= 128).count());
        }
        let patches = shown / (PATCH_PX * PATCH_PX);
        if object.len() >= patches / PATCHES_A_POINT {
            return Ok(Vec::new());
        }
        let count = count.min(patches);
        let axis = |k: usize| median(object.iter().map(|p| p.position[k])).unwrap_or(0.0);
        let middle = Point3::new(axis(0), axis(1), axis(2));
        let from_middle = object.iter().map(|p| (Point3::from(p.position) - middle).norm());
        let reach = HULL_REACH * quantile(from_middle, 0.95).unwrap_or(0.0);
        let mut found = Vec::new();
        for &view in &self.trained {
            let photo = self.photos.get(view)?;
            let Some(mask) = &photo.mask else { continue };
            let camera = self.photos.camera(view);
            let world_from_camera = camera.camera_from_world.inverse();
            let eye = Point3::from(world_from_camera.translation.vector);
            let from = ((middle - eye).norm() - reach).max(0.0);
            let shown: Vec<usize> = (0..mask.len()).filter(|&i| mask[i] >= 128).collect();
            let step = (shown.len() * self.trained.len()).div_ceil(count.max(1)).max(1);
            let enters = |&i: &usize| {
                let (x, y) = ((i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5);
                let ray = Vector3::new((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0).normalize();
                let ray = world_from_camera.rotation * ray;
                let at = |k: u32| eye + ray * (from + 2.0 * reach * f64::from(k) / f64::from(HULL_STEPS));
                let place = (0..=HULL_STEPS).map(at).find(|p| self.hull.contains(&p.coords.cast::<f32>().into()))?;
                Some((place.coords.into(), photo.rgb[i]))
            };
            let some: Vec<usize> = shown.into_iter().skip(step / 2).step_by(step).collect();
            found.extend(some.par_iter().filter_map(enters).collect::<Vec<_>>());
        }
        Ok(found)
    }

    /// PSNR and SSIM on the photos held out, inside their masks where masks are used.
    fn score<R: Rasterizer>(&self, trainer: &Trainer<'_, Photos, R>) -> Result<Table> {
        let mut table = Table::default();
        for &i in &self.held_out {
            let photo = self.photos.get(i)?;
            let render = trainer.render(&photo.camera, [0.0; 3])?;
            let mask = photo.mask.as_deref().filter(|_| self.masked);
            let count = mask.map_or(photo.rgb.len(), |m| m.iter().filter(|&&v| v >= 128).count());
            let score = match mask {
                None => similarity(&render.rgb, &photo.rgb, None, render.width, render.height)?,
                // Where the object is half transparent, so is the photo: over black, as the render.
                Some(m) => {
                    let shown = |(c, &m): (&[u8; 3], &u8)| c.map(|v| f32::from(v) * f32::from(m) / (255.0 * 255.0));
                    let target: Vec<[f32; 3]> = photo.rgb.iter().zip(m).map(shown).collect();
                    similarity(&render.rgb, &target, mask, render.width, render.height)?
                }
            };
            table.push(&self.capture.views[i].name, score, count);
        }
        Ok(table)
    }
}

/// The name of a view without its ending.
fn stem_of(name: &str) -> String {
    Path::new(name).with_extension("").to_string_lossy().replace('\\', "/")
}

/// The camera with no side longer than `side` pixels.
fn fitting(camera: &PinholeCamera, side: usize) -> PinholeCamera {
    let longest = camera.width.max(camera.height);
    if longest <= side {
        return camera.clone();
    }
    let scaled = |n: usize| (n * side / longest).max(1);
    camera.resized(scaled(camera.width), scaled(camera.height))
}
