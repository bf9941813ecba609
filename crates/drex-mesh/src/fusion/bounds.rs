//! The first look at all views: where the object is, how fine it was seen, how noisy, and how thin its walls are.

use drex_core::stats::upper_median;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::FusionOptions;
use super::hits::{Hits, Sight};
use super::lattice::Field;
use super::prepare::plane_factor;
use crate::bvh::Aabb;
use crate::depth::{DepthMap, DepthViews};
use crate::{Error, Result};

/// Points taken from all views together.
const SAMPLES: usize = 60_000;
/// At least so many from each.
const LEAST_PER_VIEW: usize = 200;
/// Samples that make a patch.
const ENOUGH: usize = 5;
/// Patches whose thickness is probed.
const PROBES: usize = 4000;
/// Thinner walls than this share of the probed surface are not asked for.
const THIN_SHARE: f64 = 0.02;
/// Cosine beyond which two patches face each other's backs.
const OPPOSITE: f64 = -0.8;

/// A point of the surface with its normal (towards the camera), in the world.
#[derive(Debug, Clone, Copy)]
struct Sample {
    point: Point3<f64>,
    normal: Vector3<f64>,
    view: u32,
}

/// What all views say together.
#[derive(Debug)]
pub(super) struct BoundsEstimate {
    /// Box of the object's points.
    pub bounds: Aabb,
    /// Median width of a pixel on the surface, metres.
    pub footprint_m: f64,
    /// Median distance of the surface from the cameras, metres.
    pub depth_m: f64,
    /// Median over the views of the noise of a single depth, metres.
    pub noise_m: f64,
    /// Per view, where the object is in it; `None` for views without depth of the object.
    pub sights: Vec<Option<Sight>>,
    /// Where those views are from.
    eyes: Vec<Point3<f64>>,
    samples: Vec<Sample>,
}

/// One view's part.
struct Look {
    sight: Sight,
    eye: Point3<f64>,
    footprint_m: f64,
    samples: Vec<Sample>,
}

impl BoundsEstimate {
    /// Looks at every view once.
    pub fn new(views: &(impl DepthViews + ?Sized), options: &FusionOptions) -> Result<Self> {
        let n = views.len();
        if n == 0 {
            return Err(Error::value("there are no depth maps to fuse", "give at least one view"));
        }
        let per_view = (SAMPLES / n).max(LEAST_PER_VIEW);
        let looks: Vec<Option<Look>> = (0..n)
            .into_par_iter()
            .map(|i| {
                let map = views.borrow_view(i)?;
                map.check().map_err(|e| of_view(e, i))?;
                Ok(Look::new(&map, i, per_view, options))
            })
            .collect::<Result<_>>()?;
        let seen = || looks.iter().flatten();
        let samples: Vec<Sample> = seen().flat_map(|l| &l.samples).copied().collect();
        if samples.is_empty() {
            return Err(Error::value(
                format!("none of the {n} views has a depth of the object"),
                "check the unit (metres), the masks and the region",
            ));
        }
        let median_of = |get: fn(&Look) -> f64| upper_median(seen().map(get)).unwrap_or(0.0);
        Ok(Self {
            bounds: object_box(&samples, seen().count()),
            footprint_m: median_of(|l| l.footprint_m),
            depth_m: median_of(|l| l.sight.depth_m.into()),
            noise_m: median_of(|l| l.sight.noise_m.into()),
            sights: looks.iter().map(|l| l.as_ref().map(|l| l.sight)).collect(),
            eyes: seen().map(|l| l.eye).collect(),
            samples,
        })
    }
}

impl BoundsEstimate {
    /// Whether a view looks at a box from beyond its lower or upper (1) side along x, y or z.
    pub fn is_faced(&self, side: usize, k: usize, object: &Aabb) -> bool {
        self.eyes.iter().any(|eye| if side == 0 { eye[k] < object.lo[k] } else { eye[k] > object.hi[k] })
    }
}

/// The error with the number of the view it is about.
pub(super) fn of_view(e: Error, view: usize) -> Error {
    match e {
        Error::Value { what, remedy } => Error::value(format!("view {view}: {what}"), remedy),
        other => other,
    }
}

impl Look {
    fn new(map: &DepthMap, view: usize, wanted: usize, options: &FusionOptions) -> Option<Self> {
        let sight = Sight::new(map)?;
        let hits = Hits::new(map, &sight);
        let camera = &map.camera;
        // The window is not full, so this is a little less than wanted.
        let step = ((hits.window.width * hits.window.height) as f64 / wanted as f64).sqrt().ceil() as usize;
        let mut samples = Vec::new();
        for y in (step / 2..hits.window.height).step_by(step) {
            for x in (step / 2..hits.window.width).step_by(step) {
                let at = hits.index(x, y);
                let (true, Some((z, slope))) = (hits.depth[at] > 0.0, hits.plane(at)) else { continue };
                let ray = camera.ray((hits.window.x + x) as u32, (hits.window.y + y) as u32);
                // The normal of z(u, v) is along (f_x z_u, f_y z_v, -(z + x f_x z_u + y f_y z_v)), towards the camera.
                let (a, b) = (camera.fx_px * f64::from(slope[0]), camera.fy_px * f64::from(slope[1]));
                let factor = f64::from(plane_factor(z, [a as f32, b as f32], [ray.x as f32, ray.y as f32]));
                let normal = Vector3::new(a, b, -(f64::from(z) + ray.x * a + ray.y * b)) * (factor / f64::from(z));
                let point = map.world_from_camera * Point3::from(ray * f64::from(z));
                if options.region.is_none_or(|(lo, hi)| (0..3).all(|k| (lo[k]..=hi[k]).contains(&point[k]))) {
                    samples.push(Sample { point, normal: map.world_from_camera * normal, view: view as u32 });
                }
            }
        }
        let footprint_m = sight.footprint_m(camera).into();
        let eye = map.world_from_camera.translation.vector.into();
        (!samples.is_empty()).then_some(Self { sight, eye, footprint_m, samples })
    }
}

/// The box of the samples, without those that stand alone: a coarse cell counts if a second view saw it too (where there
/// are enough views to ask for that).
fn object_box(samples: &[Sample], views: usize) -> Aabb {
    const ACROSS: usize = 64;
    const ENOUGH_VIEWS: usize = 5;
    const SEVERAL: u32 = u32::MAX;
    let all = samples.iter().fold(Aabb::empty(), |b, s| b.grown(&s.point));
    if views < ENOUGH_VIEWS {
        return all;
    }
    let size = ((all.hi - all.lo).max() / ACROSS as f64).max(f64::MIN_POSITIVE);
    let cell = |s: &Sample| {
        let at = [0, 1, 2].map(|k| (((s.point[k] - all.lo[k]) / size) as usize).min(ACROSS - 1));
        (at[2] * ACROSS + at[1]) * ACROSS + at[0]
    };
    // The view that saw a cell, plus one.
    let mut seen = vec![0u32; ACROSS * ACROSS * ACROSS];
    for s in samples {
        let by = &mut seen[cell(s)];
        *by = if *by == 0 || *by == s.view + 1 { s.view + 1 } else { SEVERAL };
    }
    let kept = samples.iter().filter(|s| seen[cell(s)] == SEVERAL).fold(Aabb::empty(), |b, s| b.grown(&s.point));
    if kept.lo.x <= kept.hi.x { kept } else { all }
}

/// Averages of the samples that fell into one cell and face one way.
struct Patch {
    cell: u64,
    point: Point3<f64>,
    normal: Vector3<f64>,
    /// Standard deviation of the samples from their plane.
    spread: f64,
}

/// What the samples say at a given resolution.
#[derive(Debug, Clone, Copy)]
pub(super) struct Walls {
    /// Thickness of the thinnest walls, metres; `None` if none is thinner than looked for.
    pub thickness_m: Option<f64>,
    /// Median spread of the samples of a patch from their plane: noise after smoothing and disagreement of the views.
    pub spread_m: f64,
}

impl BoundsEstimate {
    /// Probes the thickness of walls up to `deepest_m`: averages the samples per cell and facing, then looks from each
    /// patch along its inward normal for one that faces the other way.
    pub fn walls(&self, cell_m: f64, deepest_m: f64) -> Walls {
        let patches = self.patches(cell_m);
        let spread_m = upper_median(patches.iter().map(|p| p.spread)).unwrap_or(0.0);
        // Thinner ones cannot be told from noise or shown by the voxels.
        let range = (4.0 * spread_m).max(0.25 * cell_m)..deepest_m;
        let step = patches.len().div_ceil(PROBES).max(1);
        let mut thickness: Vec<f64> = patches
            .par_iter()
            .step_by(step)
            .map(|p| self.thickness_at(p, &patches, cell_m, &range).unwrap_or(f64::INFINITY))
            .collect();
        thickness.sort_by(f64::total_cmp);
        let thinnest = thickness.get((thickness.len() as f64 * THIN_SHARE) as usize);
        Walls { thickness_m: thinnest.copied().filter(|t| t.is_finite()), spread_m }
    }

    /// The distance from the fused surface that nine of ten measured points keep, metres, at most the truncation: how far
    /// the views contradict each other.
    pub fn residual_m(&self, field: &Field) -> f64 {
        let mut distances: Vec<f32> =
            self.samples.iter().filter_map(|s| field.nearest(&s.point)).map(f32::abs).collect();
        let place = 9 * distances.len() / 10;
        if place >= distances.len() {
            return 0.0;
        }
        f64::from(*distances.select_nth_unstable_by(place, f32::total_cmp).1)
    }

    /// A number for the cell that a point is in: 20 bits for each coordinate, with the box in the middle of their range.
    fn cell(&self, p: &Point3<f64>, cell_m: f64) -> u64 {
        let at =
            |k: usize| ((p[k] - self.bounds.lo[k]) / cell_m + f64::from(1 << 19)).clamp(0.0, f64::from((1 << 20) - 1));
        (at(2) as u64) << 40 | (at(1) as u64) << 20 | at(0) as u64
    }

    /// Patches in the order of their cells.
    fn patches(&self, cell_m: f64) -> Vec<Patch> {
        let facing = |n: &Vector3<f64>| {
            let axis = n.iamax();
            2 * axis as u64 + u64::from(n[axis] < 0.0)
        };
        let key = |s: &Sample| self.cell(&s.point, cell_m) << 3 | facing(&s.normal);
        let mut keyed: Vec<(u64, u32)> = self.samples.iter().enumerate().map(|(i, s)| (key(s), i as u32)).collect();
        keyed.par_sort_unstable();
        let patch = |group: &[(u64, u32)]| {
            let members = || group.iter().map(|&(_, i)| &self.samples[i as usize]);
            let n = group.len() as f64;
            let normal = members().map(|s| s.normal).sum::<Vector3<f64>>().try_normalize(1e-9)?;
            let point = Point3::from(members().map(|s| s.point.coords).sum::<Vector3<f64>>() / n);
            let variance = members().map(|s| (s.point - point).dot(&normal).powi(2)).sum::<f64>() / (n - 1.0);
            Some(Patch { cell: group[0].0 >> 3, point, normal, spread: variance.sqrt() })
        };
        let groups = keyed.chunk_by(|a, b| a.0 == b.0);
        groups.filter(|g| g.len() >= ENOUGH).filter_map(patch).collect()
    }

    fn thickness_at(&self, from: &Patch, patches: &[Patch], cell_m: f64, range: &std::ops::Range<f64>) -> Option<f64> {
        let steps = (2.0 * range.end / cell_m).ceil() as usize;
        let in_cell = |cell: u64| {
            let first = patches.partition_point(|p| p.cell < cell);
            patches[first..].iter().take_while(move |p| p.cell == cell)
        };
        let mut cells: Vec<u64> =
            (0..=steps).map(|i| self.cell(&(from.point - from.normal * (0.5 * cell_m * i as f64)), cell_m)).collect();
        cells.dedup();
        cells
            .into_iter()
            .flat_map(in_cell)
            .filter(|p| p.normal.dot(&from.normal) < OPPOSITE)
            .filter_map(|p| {
                let depth = (from.point - p.point).dot(&from.normal);
                let aside = (p.point - from.point + from.normal * depth).norm();
                (range.contains(&depth) && aside < cell_m).then_some(depth)
            })
            .min_by(f64::total_cmp)
    }
}
