//! Depth fusion: from depth maps to a closed mesh.
//!
//! A sparse truncated signed distance field (Curless and Levoy, "A Volumetric Method for Building Complex Models from Range
//! Images", 1996) with their carving of empty space, so that every voxel is outside, near the surface or inside, and the
//! surface is closed by construction. Two passes over the views: the first measures noise, pixel size and the thickness of
//! walls, from which voxel and truncation follow; the second fuses.

mod bounds;
mod evidence;
mod hits;
mod lattice;
mod marching;
mod parts;
mod prepare;
mod sharp;
mod volume;

use nalgebra::{Point3, Unit, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use drex_core::{Pose, TriMesh};

use self::bounds::{BoundsEstimate, of_view};
pub use self::evidence::{SurfaceShares, write_evidence};
use self::hits::Sight;
use self::lattice::{Lattice, SIDE};
use self::marching::{GridEdge, extract};
pub use self::parts::DroppedPart;
use self::prepare::Prepared;
use self::volume::{BLOCK_BYTES, Band, ENTRY_BYTES, Limits, Volume};
use crate::bvh::Aabb;
use crate::depth::DepthViews;
use crate::{Error, Result};

/// Views that are prepared at once.
const BATCH: usize = 8;
/// Half-width of the band around the surface, in voxels, where noise and walls do not ask for another.
const BAND_VOXELS: f64 = 1.75;
/// Views whose points are farther than this share of the truncation from their common surface, one in ten or more,
/// contradict each other: then the band is widened, and the voxels with it.
const MOST_RESIDUAL: f64 = 0.35;
/// By this factor at a time,
const WIDENING: f64 = 1.5;
/// up to this one.
const MOST_WIDENING: f64 = 4.0;
/// A band wider than this many voxels shows no more than one of larger voxels.
const MOST_BAND_VOXELS: f64 = 3.0;
/// Silhouettes may show the object to end farther from the measured points than these do, by this share of their diagonal at the most;
const SILHOUETTE_REACH: f64 = 1.0;
/// and are looked at in samples of the diagonal by this.
const COARSE: f64 = 128.0;
/// Even where all was measured the first empty sample is so many beyond.
const SILHOUETTE_SAMPLES: f64 = 2.0;
/// A truncation of more than this share of a wall lets its two sides meet.
const SHARE_OF_WALL: f64 = 0.7;

/// The plane an object stands on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Support {
    /// A point of the plane, world, metres.
    pub point: Point3<f64>,
    /// Its normal on the object's side.
    pub up: Unit<Vector3<f64>>,
}

/// Settings of [`fuse`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FusionOptions {
    /// Distance of the samples, metres. `None`: two pixels on the surface, at least 1/256 of the object's diagonal.
    pub voxel_m: Option<f64>,
    /// How far from a measured surface its distance counts, metres. `None`: 1.75 voxels or three times the noise, at most
    /// 0.7 of the thinnest wall that was probed.
    pub truncation_m: Option<f64>,
    /// A pixel without depth means that nothing was hit (rendered depth), not that nothing was measured (RGB-D).
    /// With a mask, the mask says so.
    pub background_is_empty: bool,
    /// Box of the object in the world, metres; what is outside is not extracted.
    pub region: Option<(Point3<f64>, Point3<f64>)>,
    /// The table: what is below is cut off, the cut is closed and marked.
    pub support: Option<Support>,
    /// Move vertices near edges of the object onto the intersection of its planes.
    pub sharp_edges: bool,
    /// How many views must see a place empty that no view measured, each counted by its trust; more if single maps are wrong at many pixels.
    pub empty_votes: f64,
    /// Parts with a smaller share of the volume of the largest one are dropped.
    pub smallest_volume_share: f64,
    /// Parts with less than a tenth of the volume of the largest one are dropped where fewer views measured them than this share of those that measured
    /// it, in the mean over the surface: matching makes up such parts where little is known.
    pub least_views_share: f64,
    /// Most memory that the volume may take, bytes.
    pub memory_bytes: usize,
}

impl Default for FusionOptions {
    fn default() -> Self {
        Self {
            voxel_m: None,
            truncation_m: None,
            background_is_empty: false,
            region: None,
            support: None,
            sharp_edges: false,
            empty_votes: 1.0,
            smallest_volume_share: 0.01,
            least_views_share: 0.0,
            memory_bytes: 2 << 30,
        }
    }
}

/// Where a piece of surface comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum EvidenceKind {
    /// Measured.
    Seen,
    /// Nobody saw it: the boundary of what could be inside.
    Unseen,
    /// The cut at the support plane.
    Support,
    /// Not measured, but shown by Gaussians that were trained on the photos.
    Surfels,
}

/// What is known of a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Evidence {
    /// Views that measured the surface here.
    pub views: u16,
    /// Largest cosine between surface normal and ray among them: 1 seen from the front, 0 along the surface.
    pub best_cosine: f32,
    /// Measured or made up.
    pub kind: EvidenceKind,
}

/// What was found out and done. Lengths in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct FusionReport {
    /// Views given.
    pub views: usize,
    /// Views with depth of the object.
    pub used_views: usize,
    /// Distance of the samples.
    pub voxel_m: f64,
    /// Truncation of the distances.
    pub truncation_m: f64,
    /// Thickness of the thinnest walls; `None` if no thin wall was found.
    pub wall_m: Option<f64>,
    /// Whether walls are thinner than the voxels can show.
    pub wall_below_resolution: bool,
    /// Width of a pixel on the surface.
    pub footprint_m: f64,
    /// Standard deviation of a single depth, from its neighbours.
    pub noise_m: f64,
    /// Standard deviation of smoothed depths of all views about a common plane: noise and disagreement of the views.
    pub spread_m: f64,
    /// Blocks of 8 x 8 x 8 samples that were stored.
    pub blocks: usize,
    /// Memory of the volume, bytes.
    pub volume_bytes: usize,
    /// Volume of the mesh, m³.
    pub volume_m3: f64,
    /// Shares of the area that were measured, made up, and cut at the support.
    pub seen_share: f64,
    /// See `seen_share`.
    pub unseen_share: f64,
    /// See `seen_share`.
    pub support_share: f64,
    /// Separate parts that the mesh keeps.
    pub parts: usize,
    /// Number of parts that were dropped.
    pub dropped_parts: usize,
    /// The largest of them, at most 16.
    pub dropped: Vec<DroppedPart>,
    /// Hollows without a way out, which were filled.
    pub filled_hollows: usize,
}

/// The result of [`fuse`].
#[derive(Debug, Clone, PartialEq)]
pub struct Fused {
    /// A closed 2-manifold in the world of the views, metres.
    pub mesh: TriMesh,
    /// One entry per vertex.
    pub evidence: Vec<Evidence>,
    /// What was found out and done.
    pub report: FusionReport,
}

/// Fuses depth maps into a closed mesh.
///
/// What no view saw is taken for solid, as far as the box of the measured points reaches; with the background empty, as far as the silhouettes allow
/// on each side that some view looks at, or on all of them over a support. The same views and options give the same bytes with any number of threads.
///
/// # Errors
/// If there are no views, a view is malformed (which and why), no view has depth of the object, an option is out of range,
/// the volume would take more than `memory_bytes` (the message says which voxel would do), or no surface is left.
pub fn fuse(views: &(impl DepthViews + ?Sized), options: &FusionOptions) -> Result<Fused> {
    options.check()?;
    // Once inside the pool of threads, not again for each of many short loops.
    rayon::scope(|_| fuse_in_pool(views, options))
}

fn fuse_in_pool(views: &(impl DepthViews + ?Sized), options: &FusionOptions) -> Result<Fused> {
    let mut estimate = BoundsEstimate::new(views, options)?;
    if options.background_is_empty {
        estimate.bounds = with_silhouettes(views, &mut estimate, options)?;
    }
    let mut plan = Plan::new(&estimate, options, 1.0)?;
    let (volume, field) = loop {
        let volume = integrated(views, &estimate, &plan, options)?;
        let field = volume.field(&plan.limits);
        let contradicted = estimate.residual_m(&field) > MOST_RESIDUAL * f64::from(plan.band.truncation);
        let wider = (contradicted && options.truncation_m.is_none() && plan.widening < MOST_WIDENING)
            .then(|| Plan::new(&estimate, options, WIDENING * plan.widening))
            .transpose()?;
        match wider.filter(|w| w.band.truncation > plan.band.truncation) {
            Some(wider) => plan = wider,
            None => break (volume, field),
        }
    };
    let mut extracted = extract(&field);
    let cleaned =
        parts::clean(&mut extracted, options.smallest_volume_share, options.least_views_share, |e| volume.views(e));
    if extracted.mesh.faces.is_empty() {
        return Err(Error::Empty { subject: "the fused volume".into() });
    }
    if options.sharp_edges {
        sharp::snap_edges(&mut extracted.mesh, plan.voxel_m);
    }
    let evidence: Vec<Evidence> =
        extracted.mesh.vertices.iter().zip(&extracted.edges).map(|(p, e)| plan.evidence(&volume, p, e)).collect();
    let shares = SurfaceShares::of(&extracted.mesh, &evidence);
    let blocks = volume.stored();
    let report = FusionReport {
        views: views.len(),
        used_views: estimate.sights.iter().flatten().count(),
        voxel_m: plan.voxel_m,
        truncation_m: plan.band.truncation.into(),
        wall_m: plan.wall_m,
        wall_below_resolution: plan.wall_m.is_some_and(|w| SHARE_OF_WALL * w < plan.voxel_m),
        footprint_m: estimate.footprint_m,
        noise_m: estimate.noise_m,
        spread_m: plan.spread_m,
        blocks,
        volume_bytes: blocks * BLOCK_BYTES + volume.lattice.count() * ENTRY_BYTES,
        volume_m3: parts::volume(&extracted.mesh),
        seen_share: shares.measured,
        unseen_share: shares.silhouettes,
        support_share: shares.support,
        parts: cleaned.parts,
        dropped_parts: cleaned.dropped_parts,
        dropped: cleaned.dropped,
        filled_hollows: cleaned.filled_hollows,
    };
    Ok(Fused { mesh: extracted.mesh, evidence, report })
}

/// The box of the measured points, and beyond it as far as the silhouettes allow on sides where these close. Without a table nothing says how far
/// that goes which no view looks at.
fn with_silhouettes(
    views: &(impl DepthViews + ?Sized),
    estimate: &mut BoundsEstimate,
    options: &FusionOptions,
) -> Result<Aabb> {
    let measured = estimate.bounds;
    let diagonal = (measured.hi - measured.lo).norm();
    estimate.bounds = measured.fattened(SILHOUETTE_REACH * diagonal);
    let mut coarse = options.clone();
    coarse.voxel_m = Some(diagonal / COARSE);
    let plan = Plan::new(estimate, &coarse, 1.0)?;
    let allowed = integrated(views, estimate, &plan, &coarse)?.allowed_around(&measured, plan.limits.support);
    let end = |side: usize, k: usize, measured_end: f64| {
        let inwards = if side == 0 { 1.0 } else { -1.0 };
        let looked_at = options.support.is_some() || estimate.is_faced(side, k, &measured);
        // No photo shows the edge on which an object stands, and nothing is measured down there.
        let at_table = options.support.is_some_and(|s| inwards * s.up[k] > 0.5);
        let beyond = |end: &f64| at_table || (end - measured_end).abs() > SILHOUETTE_SAMPLES * plan.voxel_m;
        allowed[2 * k + side].filter(|_| looked_at).filter(beyond).unwrap_or(measured_end)
    };
    let lo = Point3::from([0, 1, 2].map(|k| end(0, k, measured.lo[k])));
    let hi = Point3::from([0, 1, 2].map(|k| end(1, k, measured.hi[k])));
    Ok(measured.union(&Aabb { lo, hi }))
}

/// The volume with all views in it.
fn integrated(
    views: &(impl DepthViews + ?Sized),
    estimate: &BoundsEstimate,
    plan: &Plan,
    options: &FusionOptions,
) -> Result<Volume> {
    let mut volume = Volume::new(plan.lattice.clone(), plan.band);
    let grid_from_world = Pose::translation(-plan.lattice.origin.x, -plan.lattice.origin.y, -plan.lattice.origin.z);
    for start in (0..views.len()).step_by(BATCH) {
        let sighted: Vec<(usize, &Sight)> = (start..views.len().min(start + BATCH))
            .filter_map(|i| estimate.sights[i].as_ref().map(|sight| (i, sight)))
            .collect();
        let prepared: Vec<Prepared> = sighted
            .into_par_iter()
            .map(|(i, sight)| {
                let map = views.borrow_view(i)?;
                if !sight.fits(&map) {
                    return Err(of_view(
                        Error::value("it is not the one it was before", "give the same view again"),
                        i,
                    ));
                }
                let camera_from_grid = map.world_from_camera.inverse() * grid_from_world.inverse();
                let reach = plan.band.truncation.into();
                Ok(Prepared::new(&map, sight, &camera_from_grid, options.background_is_empty, plan.voxel_m, reach))
            })
            .collect::<Result<_>>()?;
        volume.integrate(&prepared);
        check_memory(volume.stored() * BLOCK_BYTES + volume.lattice.count() * ENTRY_BYTES, plan.voxel_m, options)?;
    }
    Ok(volume)
}

impl FusionOptions {
    fn check(&self) -> Result<()> {
        for (name, value) in [("voxel_m", self.voxel_m), ("truncation_m", self.truncation_m)] {
            if value.is_some_and(|v| !(v > 0.0 && v.is_finite())) {
                return Err(Error::value(format!("{name} is {value:?}"), "give a positive length in metres or none"));
            }
        }
        if let Some((lo, hi)) = self.region
            && !(0..3).all(|k| lo[k] < hi[k] && lo[k].is_finite() && hi[k].is_finite())
        {
            return Err(Error::value(
                format!("the region from {lo} to {hi} is no box"),
                "give its lower and upper corner",
            ));
        }
        if let Some(s) = self.support
            && !s.point.iter().chain(s.up.iter()).all(|x| x.is_finite())
        {
            return Err(Error::value("the support plane is not finite", "give a point and an upward normal"));
        }
        if !(self.empty_votes > 0.0 && self.empty_votes.is_finite()) {
            return Err(Error::value(
                format!("empty_votes is {}", self.empty_votes),
                "give a positive number of views",
            ));
        }
        let shares =
            [("smallest_volume_share", self.smallest_volume_share), ("least_views_share", self.least_views_share)];
        for (name, share) in shares {
            if !(0.0..=1.0).contains(&share) {
                return Err(Error::value(format!("{name} is {share}"), "give a share from 0 to 1"));
            }
        }
        Ok(())
    }
}

/// What the estimate and the options decide.
struct Plan {
    widening: f64,
    voxel_m: f64,
    wall_m: Option<f64>,
    spread_m: f64,
    lattice: Lattice,
    band: Band,
    limits: Limits,
    support: Option<Support>,
}

impl Plan {
    /// `widening`: how much wider the band is than the resolution asks for, because the views contradict each other.
    fn new(estimate: &BoundsEstimate, options: &FusionOptions, widening: f64) -> Result<Self> {
        let diagonal = (estimate.bounds.hi - estimate.bounds.lo).norm();
        let finest = (2.0 * estimate.footprint_m).max(diagonal / 256.0);
        let widened = BAND_VOXELS * widening * options.voxel_m.unwrap_or(finest);
        let voxel_m = options.voxel_m.unwrap_or(finest.max(widened / MOST_BAND_VOXELS));
        // Patches of two voxels; walls that the largest truncation would spare need not be found.
        let cell = 2.0 * voxel_m;
        let walls = estimate.walls(cell, 4.0 * voxel_m / SHARE_OF_WALL);
        let wished = widened.max(3.0 * walls.spread_m).min(4.0 * voxel_m);
        let spared = walls.thickness_m.map_or(wished, |t| wished.min(SHARE_OF_WALL * t));
        let truncation = options.truncation_m.unwrap_or(spared.max(0.9 * voxel_m).max(2.0 * walls.spread_m));
        let band = Band {
            truncation: truncation as f32,
            trusted: (2.5 * walls.spread_m).clamp(0.25 * truncation, 0.7 * truncation) as f32,
            depth: estimate.depth_m as f32,
            votes: options.empty_votes as f32,
        };
        // Noise spreads the points beyond the surface, and smoothed depths less so.
        let mut solid = estimate.bounds.fattened(truncation + voxel_m);
        if let Some((lo, hi)) = options.region {
            solid = Aabb { lo: solid.lo.sup(&lo), hi: solid.hi.inf(&hi) };
        }
        let limits = Limits { solid, unseen: estimate.bounds, support: options.support.map(|s| (s.point, s.up)) };
        let lattice = lattice_over(&solid.fattened(1.5 * voxel_m), voxel_m, options)?;
        Ok(Self {
            widening,
            voxel_m,
            wall_m: walls.thickness_m,
            spread_m: walls.spread_m,
            lattice,
            band,
            limits,
            support: options.support,
        })
    }

    fn evidence(&self, volume: &Volume, point: &Point3<f64>, edge: &GridEdge) -> Evidence {
        let (a, b) = (volume.seen(edge.voxel), volume.seen(edge.far()));
        let (views, best_cosine) = (a.0.max(b.0), a.1.max(b.1).min(1.0));
        let on_support = self.support.is_some_and(|s| (point - s.point).dot(&s.up).abs() < 0.05 * self.voxel_m);
        let kind = match () {
            () if on_support => EvidenceKind::Support,
            () if views > 0 => EvidenceKind::Seen,
            () => EvidenceKind::Unseen,
        };
        Evidence { views, best_cosine, kind }
    }
}

fn lattice_over(bounds: &Aabb, voxel_m: f64, options: &FusionOptions) -> Result<Lattice> {
    let extent = bounds.hi - bounds.lo;
    let blocks = [0, 1, 2].map(|k| (extent[k] / (voxel_m * SIDE as f64)).floor() + 1.0);
    let bytes = blocks.iter().product::<f64>() * ENTRY_BYTES as f64;
    // Beyond 2^53 the count is only about right, and far beyond any memory.
    check_memory(bytes.min(usize::MAX as f64) as usize, voxel_m, options)?;
    Ok(Lattice { origin: bounds.lo, spacing: voxel_m, blocks: blocks.map(|b| b as usize) })
}

fn check_memory(bytes: usize, voxel_m: f64, options: &FusionOptions) -> Result<()> {
    if bytes <= options.memory_bytes {
        return Ok(());
    }
    // Stored blocks grow with the area (second power), the table of blocks with the volume; the second is on the safe side.
    let enough = voxel_m * 1.1 * (bytes as f64 / options.memory_bytes.max(1) as f64).sqrt();
    Err(Error::value(
        format!("voxels of {voxel_m:.6} m would take more than {} MB", options.memory_bytes >> 20),
        format!("take voxels of {enough:.6} m, give the region of the object, or allow more memory_bytes"),
    ))
}
