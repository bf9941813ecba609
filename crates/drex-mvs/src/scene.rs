//! The photos as they are compared: cut to where the object can be, grey, at several sizes, each with the photos that it is compared with.

use std::f64::consts::PI;

use drex_core::camera::PinholeCamera;
use drex_core::capture::{Capture, PhotoOptions, Photos};
use drex_core::stats::{median, quantile};
use drex_core::{Error, Result};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

use crate::kernel::{Source, mapped};
use crate::options::{MvsOptions, Region};
use crate::picture::{Area, Grey, LEAST_NOISE, Quads};

/// Pixels round the object's box that are kept, so that windows at its rim are whole.
const MARGIN_PX: f64 = 12.0;
/// Sides of what is cut out are multiples of this: pixels of all sizes cover each other.
const GRID: usize = 8;
/// Angle between the rays of two photos at which depth is best found, degrees, and how fast it becomes worse on either side.
const BEST_ANGLE_DEG: f64 = 15.0;
const ANGLE_SIGMA_DEG: [f64; 2] = [0.38 * BEST_ANGLE_DEG, 0.7 * BEST_ANGLE_DEG];
/// Angles that are taken at all.
const ANGLES_DEG: [f64; 2] = [3.0, 45.0];
/// Photos whose pixels are larger or smaller than these times those of the reference are left out.
const SCALES: [f64; 2] = [0.4, 2.5];

/// What is shown may be nearer or farther than the sparse points by so much,
const RANGE: [f64; 2] = [0.75, 1.25];
/// but an object beyond its own points by no more than this share of their extent.
const OBJECT_MARGIN: f64 = 0.5;
/// Fewer points say nothing of where an object is.
const LEAST_POINTS: usize = 20;

/// Photos of which the pixels are counted in which depth is looked for.
const SAMPLED: usize = 8;
/// Photos that are asked whether they confirm a depth.
const WITNESSES: usize = 12;

/// A photo that is compared with others.
#[derive(Debug)]
pub(crate) struct View {
    /// Of what is cut out.
    pub camera: PinholeCamera,
    /// Upper left corner of what is cut out in the straightened photo, pixels.
    pub corner: [usize; 2],
    /// At full size, halved once, and so on.
    pub pictures: Vec<Grey>,
    /// Standard deviation of the noise of each, grey levels.
    pub noise: Vec<f32>,
    /// Where depth is looked for, at the sizes of the pictures.
    pub searched: Vec<Area>,
    /// Whether a mask said where that is.
    pub masked: bool,
    /// Nearest and farthest depth of what is looked for, scene units.
    pub range: [f64; 2],
    /// The photos that are asked whether they confirm what was found, best first.
    pub witnesses: Vec<Neighbour>,
    /// It is compared with so many of them.
    source_count: usize,
}

/// A photo that another one is compared with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Neighbour {
    pub view: usize,
    /// Angle between the rays to what is looked at, rad.
    pub angle_rad: f64,
}

impl View {
    /// The photos that it is compared with, best first.
    pub fn sources(&self) -> &[Neighbour] {
        &self.witnesses[..self.source_count.min(self.witnesses.len())]
    }

    /// The camera at a size, principal point relative to the centre of the first pixel.
    pub fn matrix(&self, halvings: usize) -> Matrix3<f64> {
        let c = &self.camera;
        let s = 0.5f64.powi(halvings as i32);
        Matrix3::new(s * c.fx, 0.0, s * c.cx - 0.5, 0.0, s * c.fy, s * c.cy - 0.5, 0.0, 0.0, 1.0)
    }

    /// How pixels of this photo get to those of another, as A by columns and b of [`crate::kernel`].
    pub fn to(&self, other: &Self, halvings: usize) -> ([[f32; 3]; 3], [f32; 3]) {
        let relative = other.camera.camera_from_world * self.camera.camera_from_world.inverse();
        let (own, its) = (self.matrix(halvings), other.matrix(halvings));
        // A camera's matrix is regular, for its focal lengths are positive.
        let inverse = own.try_inverse().unwrap_or_else(Matrix3::identity);
        let a = its * relative.rotation.to_rotation_matrix().matrix() * inverse;
        let b = its * relative.translation.vector;
        ([0, 1, 2].map(|k| a.column(k).into_owned().map(|v| v as f32).into()), b.map(|v| v as f32).into())
    }

    /// Pixels that what it shows moves in its sources per unit of inverse depth, on average.
    pub fn disparity(&self, views: &[Self], halvings: usize) -> f32 {
        // In the middle of the picture, at the middle of the range.
        let picture = &self.pictures[halvings];
        let middle = [0.5 * picture.width as f32, 0.5 * picture.height as f32];
        let w = (2.0 / (self.range[0] + self.range[1])) as f32;
        let moves = self.sources().iter().filter_map(|n| {
            let (turn, shift) = self.to(&views[n.view], halvings);
            let [x, y] = mapped(&turn, &shift, middle, w)?;
            let [u, v] = mapped(&turn, &shift, middle, 1.01 * w)?;
            Some(((u - x).powi(2) + (v - y).powi(2)).sqrt() / (0.01 * w)).filter(|d| *d > 0.0)
        });
        let moves: Vec<f32> = moves.collect();
        if moves.is_empty() { 1.0 } else { moves.iter().sum::<f32>() / moves.len() as f32 }
    }

    pub fn source(&self, other: &Self, halvings: usize) -> Source {
        let (turn, shift) = self.to(other, halvings);
        Source { quads: Quads::new(&other.pictures[halvings]), turn, shift }
    }
}

/// Reads the photos and decides what is compared with what.
///
/// # Errors
/// If a photo cannot be read, or the region is no box.
pub(crate) fn prepare(
    capture: &Capture,
    options: &MvsOptions,
    sizes: usize,
    progress: &(dyn Fn(usize) + Sync),
) -> Result<Vec<View>> {
    let photos = photos(capture, options)?;
    let shown = shown_points(capture, &photos);
    let mut views = Vec::with_capacity(photos.len());
    for (i, shown) in shown.iter().enumerate() {
        progress(i);
        views.push(view(&photos, i, shown, options, sizes)?);
    }
    let object = match &options.region {
        Some(_) => Vec::new(),
        None => masked_points(capture, &shown, &views),
    };
    if !object.is_empty() {
        views.iter_mut().for_each(|v| v.range = range_of(&object, &v.camera).unwrap_or(v.range));
    }
    let middle = |v: &View| ahead(&v.camera, 0.5 * (v.range[0] + v.range[1]));
    let common = options.region.as_ref().map(Region::centre).or_else(|| middle_of(&object));
    let targets: Vec<Point3<f64>> = views.iter().map(|v| common.unwrap_or_else(|| middle(v))).collect();
    let witnesses: Vec<Vec<Neighbour>> = (0..views.len())
        .into_par_iter()
        .map(|i| neighbours(&views, i, &targets[i], options.preset.sources().max(WITNESSES)))
        .collect();
    for (view, witnesses) in views.iter_mut().zip(witnesses) {
        (view.witnesses, view.source_count) = (witnesses, options.preset.sources());
    }
    Ok(views)
}

impl MvsOptions {
    /// The same with pictures that are so small that the preset has time for the pixels in which depth is looked for, in the median of some
    /// photos.
    ///
    /// # Errors
    /// If one of these cannot be read, or the region is no box.
    pub fn within_time(mut self, capture: &Capture) -> Result<Self> {
        let photos = photos(capture, &self)?;
        let shown = shown_points(capture, &photos);
        let some = (0..photos.len()).step_by(photos.len().div_ceil(SAMPLED).max(1));
        let searched = |i: usize| -> Result<f64> {
            let area = &view(&photos, i, &shown[i], &self, 1)?.searched[0];
            Ok(area.inside.iter().filter(|inside| **inside).count() as f64)
        };
        let pixels: Vec<f64> = some.map(searched).collect::<Result<_>>()?;
        let scale = (self.preset.pixels() / median(pixels).unwrap_or(0.0)).sqrt();
        if scale < 1.0 {
            let side = (0..photos.len()).map(|i| photos.camera(i).width.max(photos.camera(i).height)).max();
            self.max_side = side.map(|side| (scale * side as f64) as usize);
        }
        Ok(self)
    }
}

/// The photos of a capture in the size in which they are compared.
fn photos(capture: &Capture, options: &MvsOptions) -> Result<Photos> {
    if let Some(region) = &options.region {
        region.check()?;
    }
    let mut read = PhotoOptions::default();
    read.max_side = options.max_side;
    read.memory_bytes = 0;
    Photos::new(capture, read)
}

/// A sparse point that a view shows.
struct Shown {
    point: usize,
    pixel: [f64; 2],
    depth: f64,
}

/// The sparse points that each view shows.
fn shown_points(capture: &Capture, photos: &Photos) -> Vec<Vec<Shown>> {
    let mut shown: Vec<Vec<Shown>> = (0..photos.len()).map(|_| Vec::new()).collect();
    for (i, point) in capture.points.iter().enumerate() {
        // Whoever made the capture by hand may name a view that it has not.
        for (view, _) in point.track.iter().filter(|(view, _)| *view < photos.len()) {
            if let Some((pixel, depth)) = photos.camera(*view).project(&point.position.into()) {
                shown[*view].push(Shown { point: i, pixel, depth });
            }
        }
    }
    shown
}

/// The sparse points that masks show: inside of them in more photos than outside. None if there are no masks, or they show too few points.
fn masked_points(capture: &Capture, shown: &[Vec<Shown>], views: &[View]) -> Vec<Point3<f64>> {
    let mut balance = vec![0i32; capture.points.len()];
    for (view, shown) in views.iter().zip(shown).filter(|(view, _)| view.masked) {
        let Area { width, height, inside } = &view.searched[0];
        for Shown { point, pixel, .. } in shown {
            let [x, y] = [0, 1].map(|k| pixel[k] - view.corner[k] as f64);
            let within = x >= 0.0 && y >= 0.0 && x < *width as f64 && y < *height as f64;
            let masked = within && inside[y as usize * width + x as usize];
            balance[*point] += if masked { 1 } else { -1 };
        }
    }
    let object: Vec<_> =
        capture.points.iter().zip(&balance).filter(|(_, b)| **b > 0).map(|(p, _)| p.position.into()).collect();
    if object.len() < LEAST_POINTS { Vec::new() } else { object }
}

/// Nearest and farthest depth at which an object can be whose points those are; `None` if it is behind the camera.
fn range_of(object: &[Point3<f64>], camera: &PinholeCamera) -> Option<[f64; 2]> {
    let depths: Vec<f64> = object.iter().map(|p| (camera.camera_from_world * p).z).filter(|z| *z > 0.0).collect();
    let [near, far] = [0.01, 0.99].map(|q| quantile(depths.iter().copied(), q));
    let (near, far) = (near?, far?);
    let margin = OBJECT_MARGIN * (far - near);
    Some([(near - margin).max(RANGE[0] * near), (far + margin).min(RANGE[1] * far)])
}

/// The middle of most of them.
fn middle_of(points: &[Point3<f64>]) -> Option<Point3<f64>> {
    let along = |k: usize| median(points.iter().map(|p| p[k]));
    Some(Point3::new(along(0)?, along(1)?, along(2)?))
}

fn ahead(camera: &PinholeCamera, depth: f64) -> Point3<f64> {
    camera.camera_from_world.inverse() * Point3::from(camera.ray([camera.cx, camera.cy]) * depth)
}

fn view(photos: &Photos, i: usize, shown: &[Shown], options: &MvsOptions, sizes: usize) -> Result<View> {
    let photo = photos.get(i)?;
    let whole = &photo.camera;
    let (mut window, range) = match &options.region {
        Some(region) => seen_of(region, whole),
        None => {
            let end = |q| quantile(shown.iter().map(|s| s.depth), q);
            let (Some(near), Some(far)) = (end(0.01), end(0.99)) else {
                return Err(Error::capture(
                    format!("{} shows no sparse point", photos.name(i)),
                    "give a region, or cameras with the points that they were found with",
                ));
            };
            ([0.0, 0.0, whole.width as f64, whole.height as f64], [RANGE[0] * near, RANGE[1] * far])
        }
    };
    if let Some(mask) = &photo.mask {
        window = met(window, box_of(mask, whole.width));
    }
    let lower = |v: f64| (v.max(0.0) as usize) / GRID * GRID;
    let upper =
        |v: f64, size: usize| (v.max(0.0).ceil() as usize).div_ceil(GRID).saturating_mul(GRID).min(size / GRID * GRID);
    let (x0, y0) = (lower(window[0] - MARGIN_PX), lower(window[1] - MARGIN_PX));
    let (x1, y1) = (upper(window[2] + MARGIN_PX, whole.width), upper(window[3] + MARGIN_PX, whole.height));
    // A photo that does not show the region keeps a corner, so that nobody has to ask.
    let (x0, y0) = (x0.min(whole.width.saturating_sub(2 * GRID)), y0.min(whole.height.saturating_sub(2 * GRID)));
    let (width, height) = (x1.saturating_sub(x0).max(2 * GRID), y1.saturating_sub(y0).max(2 * GRID));
    if whole.width < 2 * GRID || whole.height < 2 * GRID {
        return Err(Error::capture(
            format!("{} has {} x {} pixels", photos.name(i), whole.width, whole.height),
            "give larger photos",
        ));
    }
    let camera = PinholeCamera { cx: whole.cx - x0 as f64, cy: whole.cy - y0 as f64, width, height, ..whole.clone() };
    let rows = || (0..height).flat_map(|y| (0..width).map(move |x| (y + y0) * whole.width + x + x0));
    let picture = Grey::from_rgb(width, height, rows().map(|at| photo.rgb[at]));
    let mut area = match &photo.mask {
        Some(mask) => {
            let shown = Area { width, height, inside: rows().map(|at| mask[at] >= 128).collect() };
            shown.grown(options.mask_margin_px)
        }
        None => Area { width, height, inside: vec![true; width * height] },
    };
    if let Some(region) = &options.region {
        let limits = Limits::new(&camera, range, Some(region));
        let shows = |i: usize| limits.depths([(i % width) as f64 + 0.5, (i / width) as f64 + 0.5]).is_some();
        area.inside.iter_mut().enumerate().for_each(|(i, inside)| *inside = *inside && shows(i));
    }
    let mut pictures = vec![picture];
    let mut searched = vec![area];
    for k in 1..sizes {
        pictures.push(pictures[k - 1].halved());
        searched.push(searched[k - 1].halved());
    }
    let masked = photo.mask.is_some();
    // Each halving averages four pixels.
    let noise = pictures[0].noise();
    let noise = (0..sizes).map(|k| (noise / (1 << k) as f32).max(LEAST_NOISE as f32)).collect();
    Ok(View {
        camera,
        corner: [x0, y0],
        pictures,
        noise,
        searched,
        masked,
        range,
        witnesses: Vec::new(),
        source_count: 0,
    })
}

/// The pixels and depths in which a camera sees a region: left, top, right, bottom.
fn seen_of(region: &Region, camera: &PinholeCamera) -> ([f64; 4], [f64; 2]) {
    let mut window = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let mut range = [f64::INFINITY, 0.0f64];
    for corner in region.corners_world() {
        let z = (camera.camera_from_world * corner).z;
        range = [range[0].min(z), range[1].max(z)];
        match camera.project(&corner) {
            Some(([u, v], _)) => window = [window[0].min(u), window[1].min(v), window[2].max(u), window[3].max(v)],
            None => window = [0.0, 0.0, camera.width as f64, camera.height as f64],
        }
    }
    let least = 1e-3 * range[1].max(f64::MIN_POSITIVE);
    (window, [range[0].max(least), range[1].max(2.0 * least)])
}

/// Left, top, right, bottom of what a mask shows.
fn box_of(mask: &[u8], width: usize) -> [f64; 4] {
    let mut found = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for (i, _) in mask.iter().enumerate().filter(|(_, v)| **v >= 128) {
        let (x, y) = ((i % width) as f64, (i / width) as f64);
        found = [found[0].min(x), found[1].min(y), found[2].max(x + 1.0), found[3].max(y + 1.0)];
    }
    found
}

fn met(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])]
}

/// How near and how far what a pixel shows can be.
#[derive(Debug)]
pub(crate) struct Limits<'a> {
    camera: &'a PinholeCamera,
    region: Option<RayBox<'a>>,
    range: [f64; 2],
}

/// A region as rays of a camera meet it.
#[derive(Debug)]
struct RayBox<'a> {
    /// The camera's centre and axes in the frame of the box.
    start: Vector3<f64>,
    rotation: Matrix3<f64>,
    corners: &'a [Point3<f64>; 2],
}

impl<'a> Limits<'a> {
    pub fn new(camera: &'a PinholeCamera, range: [f64; 2], region: Option<&'a Region>) -> Self {
        let region = region.map(|region| {
            let box_from_camera = region.box_from_world * camera.camera_from_world.inverse();
            let rotation = *box_from_camera.rotation.to_rotation_matrix().matrix();
            RayBox { start: box_from_camera.translation.vector, rotation, corners: &region.corners }
        });
        Self { camera, region, range }
    }

    /// Nearest and farthest depth at a place of the picture at full size, pixels from its upper left corner; `None` if the ray misses the region.
    pub fn depths(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let [mut near, mut far] = self.range;
        if let Some(RayBox { start, rotation, corners }) = &self.region {
            let ray = rotation * self.camera.ray(pixel);
            for k in 0..3 {
                let ends = [0, 1].map(|e| (corners[e][k] - start[k]) / ray[k]);
                // A ray along a side divides by zero: infinities of either sign compare as they should, and 0/0 sets no limit.
                let (a, b) = if ends[0] <= ends[1] { (ends[0], ends[1]) } else { (ends[1], ends[0]) };
                (near, far) = (near.max(a), far.min(b));
            }
        }
        (near < far).then_some([near, far])
    }

    /// Least and greatest inverse depth of a pixel of the picture halved so many times.
    pub fn inverse_depths(&self, halvings: usize, x: usize, y: usize) -> [f32; 2] {
        let size = (1 << halvings) as f64;
        // At a smaller size a pixel may be searched for the sake of a part of it.
        let [near, far] = self.depths([x, y].map(|v| (v as f64 + 0.5) * size)).unwrap_or(self.range);
        [(1.0 / far) as f32, (1.0 / near) as f32]
    }
}

/// The photos that are best compared with one, by the angle at `target`, the size of their pixels there, and from several sides.
fn neighbours(views: &[View], i: usize, target: &Point3<f64>, count: usize) -> Vec<Neighbour> {
    let own = &views[i].camera;
    let footprint = |c: &PinholeCamera| c.project(target).map(|(_, z)| z / c.fx);
    let Some(own_footprint) = footprint(own) else { return Vec::new() };
    let direction = |c: &PinholeCamera| (c.centre() - target).normalize();
    let towards = direction(own);
    let mut scored: Vec<(f64, f64, Neighbour)> = Vec::new();
    for (view, other) in views.iter().enumerate().filter(|(k, _)| *k != i) {
        let Some(its_footprint) = footprint(&other.camera) else { continue };
        let scale = its_footprint / own_footprint;
        let angle_rad = towards.angle(&direction(&other.camera));
        let angle = angle_rad.to_degrees();
        if !(ANGLES_DEG[0]..=ANGLES_DEG[1]).contains(&angle) || !(SCALES[0]..=SCALES[1]).contains(&scale) {
            continue;
        }
        let sigma = ANGLE_SIGMA_DEG[usize::from(angle > BEST_ANGLE_DEG)];
        let by_angle = (-((angle - BEST_ANGLE_DEG) / sigma).powi(2) / 2.0).exp().max(1e-3);
        let by_scale = if scale > 1.0 { 1.0 / scale } else { scale };
        let baseline = own.camera_from_world * other.camera.centre();
        scored.push((by_angle * by_scale.powi(2), baseline.y.atan2(baseline.x), Neighbour { view, angle_rad }));
    }
    let mut chosen: Vec<Neighbour> = Vec::new();
    while chosen.len() < count {
        // The first of the best, so that equal scores give the same answer everywhere.
        let best = (0..scored.len()).reduce(|a, b| if scored[b].0 > scored[a].0 { b } else { a });
        let Some(best) = best else { break };
        let (_, azimuth, neighbour) = scored.remove(best);
        chosen.push(neighbour);
        // Photos on one side of the reference miss the same things.
        for (score, other, _) in &mut scored {
            let apart = (*other - azimuth).abs() % (2.0 * PI);
            if apart.min(2.0 * PI - apart) < 40f64.to_radians() {
                *score *= 0.5;
            }
        }
    }
    chosen
}
