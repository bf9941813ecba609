//! What the views say about each voxel, and what the voxel is because of it.

use nalgebra::{Point3, Unit, Vector3};
use rayon::prelude::*;

use super::lattice::{Field, FieldBlock, Lattice, SIDE, VOXELS};
use super::marching::GridEdge;
use super::prepare::{BACKGROUND, Prepared};
use crate::bvh::Aabb;

/// Depth differences beyond this many truncations count as far in front of the surface whatever the slope.
const FAR_IN_FRONT: f32 = 2.0;
/// The same behind the surface.
const FAR_BEHIND: f32 = 1.5;
/// Planes seen at a smaller cosine tell nothing about distances.
const LEAST_COSINE: f32 = 0.15;
/// Weight of a distance from a silhouette, beside 1 of a surface seen from the front.
const SILHOUETTE_WEIGHT: f32 = 0.5;
/// Distances from a silhouette below this many pixels are as uncertain as the silhouette.
const LEAST_RIM_PX: f32 = 1.0;
/// Square root of the weight of an observation at the truncation behind the surface.
const WEIGHT_BEHIND: f32 = 0.1;
/// Votes for empty, as a share of the weight behind the surface, that prove it wrong.
const CONTRADICTION: f32 = 0.25;
/// Weight from which the observed distance counts.
const OBSERVED: f32 = 0.05;

/// How observations become distances.
#[derive(Debug, Clone, Copy)]
pub(super) struct Band {
    pub truncation: f32,
    /// Observations up to this far behind the surface have full weight: noise must not decide the weight.
    pub trusted: f32,
    /// Typical depth, for weights relative to the noise that grows with its square.
    pub depth: f32,
    /// Votes for empty that make an otherwise unobserved voxel empty.
    pub votes: u16,
}

/// What was observed at a voxel.
#[derive(Clone, Copy, Default)]
struct Voxel {
    /// Sums of weights and weighted distances of observations in front of the surface.
    front: [f32; 2],
    /// The same behind the surface.
    behind: [f32; 2],
    /// Best cosine of the observations.
    cosine: f32,
    /// Views that measured the surface near here.
    views: u16,
    /// Views that saw through.
    empty: u16,
}

/// What was observed in a block.
struct Evidence([Voxel; VOXELS]);

/// A block is stored when the views begin to differ within it.
#[derive(Default)]
pub(super) struct Block {
    /// Views that see all of it empty.
    empty: u16,
    evidence: Option<Box<Evidence>>,
}

/// Where the solid may be.
#[derive(Debug)]
pub(super) struct Limits {
    /// The solid, seen or not.
    pub solid: Aabb,
    /// What nobody has seen.
    pub unseen: Aabb,
    /// A plane with nothing of the object on its lower side.
    pub support: Option<(Point3<f64>, Unit<Vector3<f64>>)>,
}

impl Limits {
    /// How far a point is outside; negative within.
    fn distance(&self, p: &Point3<f64>, observed: bool) -> f64 {
        let beside = |b: &Aabb| (0..3).map(|k| (b.lo[k] - p[k]).max(p[k] - b.hi[k])).fold(f64::NEG_INFINITY, f64::max);
        let below = self.support.map_or(f64::NEG_INFINITY, |(point, up)| (point - p).dot(&up));
        let unseen = if observed { f64::NEG_INFINITY } else { beside(&self.unseen) };
        beside(&self.solid).max(below).max(unseen)
    }

    /// Whether a box of samples comes so close to a limit that its distance could count.
    fn touch(&self, [lo, hi]: [Point3<f64>; 2], truncation: f32) -> bool {
        let corner = |c: usize| Point3::from([0, 1, 2].map(|k| if c >> k & 1 == 1 { hi[k] } else { lo[k] }));
        (0..8).any(|c| self.distance(&corner(c), false) > -f64::from(truncation))
    }
}

/// The volume under construction.
pub(super) struct Volume {
    pub lattice: Lattice,
    pub band: Band,
    blocks: Vec<Block>,
}

/// Bytes of a stored block.
pub(super) const BLOCK_BYTES: usize = size_of::<Evidence>() + VOXELS * size_of::<f32>();
/// Bytes of a block that is not stored.
pub(super) const ENTRY_BYTES: usize = size_of::<Block>() + size_of::<FieldBlock>() + 8;

impl Volume {
    pub fn new(lattice: Lattice, band: Band) -> Self {
        let blocks = (0..lattice.count()).map(|_| Block::default()).collect();
        Self { lattice, band, blocks }
    }

    /// Blocks that are stored.
    pub fn stored(&self) -> usize {
        self.blocks.iter().filter(|b| b.evidence.is_some()).count()
    }

    /// Adds what some views say, in their order: every block is the business of one thread.
    pub fn integrate(&mut self, views: &[Prepared]) {
        let (lattice, band) = (&self.lattice, &self.band);
        self.blocks.par_iter_mut().enumerate().for_each(|(i, block)| {
            let first = Vector3::from(lattice.first_voxel(i).map(|x| (x as f64 * lattice.spacing) as f32));
            let spacing = lattice.spacing as f32;
            for view in views {
                match view.relation(first, (SIDE - 1) as f32 * spacing, band) {
                    Relation::Nothing => {}
                    Relation::Empty => block.empty = block.empty.saturating_add(1),
                    Relation::Mixed => {
                        let evidence = block.evidence.get_or_insert_with(Evidence::none);
                        evidence.add(view, first, spacing, band);
                    }
                }
            }
        });
    }

    /// Signed distances, negative inside: what was observed near the surface, outside where views saw through, inside where
    /// nobody could see; all within `limits`.
    pub fn field(&self, limits: &Limits) -> Field {
        let lattice = &self.lattice;
        let truncation = self.band.truncation;
        let blocks = self
            .blocks
            .par_iter()
            .enumerate()
            .map(|(i, block)| {
                let unobserved = if block.empty >= self.band.votes { truncation } else { -truncation };
                let corners =
                    [lattice.point(i, Vector3::zeros()), lattice.point(i, Vector3::repeat((SIDE - 1) as f64))];
                if block.evidence.is_none() && (unobserved > 0.0 || !limits.touch(corners, truncation)) {
                    return FieldBlock::Constant(unobserved);
                }
                let mut values = Box::new([unobserved; VOXELS]);
                for (v, value) in values.iter_mut().enumerate() {
                    let observed = block.evidence.as_ref().and_then(|e| {
                        let (distance, observed) = e.0[v].value(block.empty, &self.band);
                        *value = distance;
                        observed.then_some(())
                    });
                    if *value < 0.0 {
                        let local = [v % SIDE, v / SIDE % SIDE, v / (SIDE * SIDE)].map(|x| x as f64);
                        let outside = limits.distance(&lattice.point(i, local.into()), observed.is_some());
                        *value = value.max((outside as f32).min(truncation));
                    }
                }
                FieldBlock::Samples(values)
            })
            .collect();
        Field { lattice: lattice.clone(), blocks }
    }

    /// Whether the surface was measured at a grid edge.
    pub fn observed(&self, edge: &GridEdge) -> bool {
        self.seen(edge.voxel).0 > 0 || self.seen(edge.far()).0 > 0
    }

    /// How many views measured the surface near a voxel, and the best cosine.
    pub fn seen(&self, voxel: [u32; 3]) -> (u16, f32) {
        let (block, v) = self.lattice.locate(voxel);
        self.blocks[block].evidence.as_ref().map_or((0, 0.0), |e| (e.0[v].views, e.0[v].cosine))
    }
}

/// What a view says about a cube of samples.
enum Relation {
    Nothing,
    Empty,
    Mixed,
}

impl Prepared {
    /// Compares the depths over the part of the image that a cube covers with the depths of the cube.
    fn relation(&self, first: Vector3<f32>, side: f32, band: &Band) -> Relation {
        let (rotation, translation) = &self.camera_from_grid;
        let center = rotation * first.add_scalar(0.5 * side) + translation;
        // Half the sides of the box around the cube along the axes of the camera.
        let half = rotation.abs() * Vector3::repeat(0.5 * side);
        let (near, far) = (center.z - half.z, center.z + half.z);
        if far <= 0.0 {
            return Relation::Nothing;
        }
        if near <= half.z {
            return Relation::Mixed; // so close to the camera that its outline is not a small rectangle
        }
        let (mut lo, mut hi) = ([0; 2], [0; 2]);
        for k in 0..2 {
            // The box looks largest at its near end, and there also farthest from the axis.
            let (low, high) = (center[k] - half[k], center[k] + half[k]);
            lo[k] = (self.focal[k] * low / if low < 0.0 { near } else { far } + self.center[k]).floor() as isize;
            hi[k] = (self.focal[k] * high / if high > 0.0 { near } else { far } + self.center[k]).floor() as isize;
            if hi[k] < 0 || lo[k] >= self.size[k] as isize {
                return Relation::Nothing;
            }
        }
        let seen = self.extremes(lo, hi);
        let hit = seen.farthest > 0.0;
        let aside = seen.rim_px * near / self.focal[0].max(self.focal[1]);
        if !seen.unknown && aside >= band.truncation && (!hit || seen.nearest > far + FAR_IN_FRONT * band.truncation) {
            return if hit || seen.empty { Relation::Empty } else { Relation::Nothing };
        }
        if !seen.empty && (!hit || seen.farthest < near - FAR_BEHIND * band.truncation) {
            return Relation::Nothing;
        }
        Relation::Mixed
    }
}

/// What is the same for the voxels of a small cube.
struct Here<'a> {
    view: &'a Prepared,
    band: &'a Band,
    /// Weight by the noise, which grows with the square of the depth.
    weight: f32,
    /// Inverse length of the ray with z = 1.
    per_ray: f32,
}

/// Samples along a side of the cubes in which a block is compared with a view.
const PART: usize = 4;

impl Evidence {
    fn none() -> Box<Self> {
        Box::new(Self([Voxel::default(); VOXELS]))
    }

    /// Adds what a view says about the voxels of the block whose first one is at `first`.
    fn add(&mut self, view: &Prepared, first: Vector3<f32>, spacing: f32, band: &Band) {
        for part in 0..8 {
            let at = [part & 1, part >> 1 & 1, part >> 2].map(|p| p * PART);
            let corner = first + Vector3::from(at.map(|x| x as f32)) * spacing;
            match view.relation(corner, (PART - 1) as f32 * spacing, band) {
                Relation::Nothing => {}
                Relation::Empty => self.rows(at).for_each(|row| row.iter_mut().for_each(|v| v.empty += 1)),
                Relation::Mixed => self.add_part(view, at, corner, spacing, band),
            }
        }
    }

    /// The rows along x of a part.
    fn rows(&mut self, at: [usize; 3]) -> impl Iterator<Item = &mut [Voxel]> {
        let layers = self.0.chunks_exact_mut(SIDE * SIDE).skip(at[2]).take(PART);
        let rows = layers.flat_map(move |layer| layer.chunks_exact_mut(SIDE).skip(at[1]).take(PART));
        rows.map(move |row| &mut row[at[0]..at[0] + PART])
    }

    fn add_part(&mut self, view: &Prepared, at: [usize; 3], corner: Vector3<f32>, spacing: f32, band: &Band) {
        let (rotation, translation) = &view.camera_from_grid;
        let start = rotation * corner + translation;
        let step = rotation * spacing;
        let middle = start + step * Vector3::repeat(0.5 * (PART - 1) as f32);
        let here = Here {
            view,
            band,
            weight: (band.depth / middle.z).powi(2).clamp(0.1, 10.0),
            per_ray: (middle.z / middle.norm()).clamp(0.1, 1.0),
        };
        for (i, row) in self.rows(at).enumerate() {
            let at = start + step.column(1) * (i % PART) as f32 + step.column(2) * (i / PART) as f32;
            let (mut u, mut v, mut z) = ([0.0_f32; PART], [0.0_f32; PART], [0.0_f32; PART]);
            for i in 0..PART {
                let x = i as f32;
                z[i] = at.z + step[(2, 0)] * x;
                let inverse = 1.0 / z[i];
                u[i] = view.focal[0] * (at.x + step[(0, 0)] * x) * inverse + view.center[0];
                v[i] = view.focal[1] * (at.y + step[(1, 0)] * x) * inverse + view.center[1];
            }
            for (i, voxel) in row.iter_mut().enumerate() {
                voxel.add(&here, [u[i], v[i]], z[i]);
            }
        }
    }
}

impl Voxel {
    /// Adds what a view says about a voxel at these image coordinates and this depth.
    #[inline]
    fn add(&mut self, here: &Here<'_>, [u, v]: [f32; 2], z: f32) {
        let (view, truncation) = (here.view, here.band.truncation);
        // Not so for NaN either.
        if !(z > 0.0 && u >= 0.0 && v >= 0.0 && u < view.size[0] as f32 && v < view.size[1] as f32) {
            return;
        }
        let (column, row) = (u as usize, v as usize);
        let Some(pixel) = view.pixel(column, row) else {
            self.empty += u16::from(view.beside_is_empty);
            return;
        };
        if pixel.z > 0.0 {
            let aside = [u - column as f32 - 0.5, v - row as f32 - 0.5];
            let in_front = pixel.z + pixel.slope[0] * aside[0] + pixel.slope[1] * aside[1] - z;
            let distance = in_front * pixel.factor;
            if in_front > FAR_IN_FRONT * truncation || distance > truncation {
                self.empty += 1;
            } else if in_front > -FAR_BEHIND * truncation && distance > -truncation {
                let cosine = pixel.factor * here.per_ray;
                if cosine < LEAST_COSINE {
                    return;
                }
                let weight = cosine * here.weight;
                if distance >= 0.0 {
                    accumulate(&mut self.front, weight, distance);
                } else {
                    accumulate(&mut self.behind, weight * here.band.falloff(distance), distance);
                }
                self.views += 1;
                self.cosine = if cosine > self.cosine { cosine } else { self.cosine };
            }
        } else if pixel.z == BACKGROUND {
            let aside = pixel.factor * z / view.focal[0].max(view.focal[1]);
            if aside >= truncation {
                self.empty += 1;
            } else if pixel.factor >= LEAST_RIM_PX {
                accumulate(&mut self.front, SILHOUETTE_WEIGHT, aside);
            }
        }
    }

    /// The signed distance of a voxel and whether it was observed. `empty_block`: votes for the whole block.
    fn value(&self, empty_block: u16, band: &Band) -> (f32, bool) {
        let ([front_weight, front], [behind_weight, behind]) = (self.front, self.behind);
        let empty = self.empty.saturating_add(empty_block);
        let weight = front_weight + behind_weight;
        if weight < OBSERVED {
            return (if empty >= band.votes { band.truncation } else { -band.truncation }, false);
        }
        let mean = (front + behind) / weight;
        // Behind a surface is inside only as far as nobody sees otherwise: rays that cut a corner say so behind it too.
        if mean < 0.0 && empty > band.votes && f32::from(empty) > CONTRADICTION * behind_weight {
            return (if front_weight > OBSERVED { front / front_weight } else { 0.5 * band.truncation }, true);
        }
        (mean, true)
    }
}

impl Band {
    /// Weight of a distance behind the surface.
    fn falloff(&self, distance: f32) -> f32 {
        let past = (-distance - self.trusted) / (self.truncation - self.trusted);
        (1.0 - (1.0 - WEIGHT_BEHIND) * past.clamp(0.0, 1.0)).powi(2)
    }
}

fn accumulate(sum: &mut [f32; 2], weight: f32, distance: f32) {
    sum[0] += weight;
    sum[1] += weight * distance;
}
