//! What the views say about each voxel, and what the voxel is because of it.

use nalgebra::{Point3, Unit, Vector3};
use rayon::prelude::*;

use super::lattice::{Field, FieldBlock, Lattice, SIDE, VOXELS};
use super::marching::GridEdge;
use super::prepare::{BACKGROUND, Prepared};
use crate::bvh::Aabb;

/// Depth differences beyond this many truncations count as far in front or far behind whatever the slope.
const FAR: f32 = 3.0;
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

/// What was observed in a block: near-surface distances in front of and behind the surface, votes for empty.
struct Evidence {
    front: [[f32; 2]; VOXELS],
    behind: [[f32; 2]; VOXELS],
    empty: [u16; VOXELS],
    views: [u16; VOXELS],
    cosine: [f32; VOXELS],
}

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
            let first = lattice.first_voxel(i).map(|x| (x as f64 * lattice.spacing) as f32);
            for view in views {
                match view.relation(first, lattice.spacing as f32, band) {
                    Relation::Nothing => {}
                    Relation::Empty => block.empty = block.empty.saturating_add(1),
                    Relation::Mixed => {
                        let evidence = block.evidence.get_or_insert_with(Evidence::none);
                        evidence.add(view, first, lattice.spacing as f32, band);
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
                        let (distance, observed) = e.value(v, block.empty, &self.band);
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
        self.blocks[block].evidence.as_ref().map_or((0, 0.0), |e| (e.views[v], e.cosine[v]))
    }
}

/// What a view says about a whole block.
enum Relation {
    Nothing,
    Empty,
    Mixed,
}

impl Prepared {
    /// Compares the depths over the part of the image that a block covers with the depths of the block.
    fn relation(&self, first: [f32; 3], spacing: f32, band: &Band) -> Relation {
        let (rotation, translation) = &self.camera_from_grid;
        let half = 0.5 * (SIDE - 1) as f32 * spacing;
        let center = rotation * Vector3::from(first.map(|x| x + half)) + translation;
        let radius = half * 3.0_f32.sqrt();
        let (near, far) = (center.z - radius, center.z + radius);
        if far <= 0.0 {
            return Relation::Nothing;
        }
        if near <= radius {
            return Relation::Mixed; // so close to the camera that its outline is not a small rectangle
        }
        // Columns and rows of the sphere's box, from its nearest side, where it looks largest.
        let mut lo = [0isize; 2];
        let mut hi = [0isize; 2];
        for k in 0..2 {
            let side = |s: f32| {
                let x = center[k] + s * radius;
                self.focal[k] * (x / near).max(x / far) + self.center[k]
            };
            let other = |s: f32| {
                let x = center[k] + s * radius;
                self.focal[k] * (x / near).min(x / far) + self.center[k]
            };
            (lo[k], hi[k]) = (other(-1.0).floor() as isize, side(1.0).floor() as isize);
            if hi[k] < 0 || lo[k] >= self.size[k] as isize {
                return Relation::Nothing;
            }
        }
        let seen = self.extremes(lo, hi);
        let hit = seen.farthest > 0.0;
        let margin = FAR * band.truncation;
        if !seen.rim && !seen.unknown && (!hit || seen.nearest > far + margin) {
            return if hit || seen.empty { Relation::Empty } else { Relation::Nothing };
        }
        if !seen.rim && !seen.empty && (!hit || seen.farthest < near - margin) {
            return Relation::Nothing;
        }
        Relation::Mixed
    }
}

impl Evidence {
    fn none() -> Box<Self> {
        Box::new(Self {
            front: [[0.0; 2]; VOXELS],
            behind: [[0.0; 2]; VOXELS],
            empty: [0; VOXELS],
            views: [0; VOXELS],
            cosine: [0.0; VOXELS],
        })
    }

    /// Adds what a view says about each voxel of the block whose first one is at `first`.
    fn add(&mut self, view: &Prepared, first: [f32; 3], spacing: f32, band: &Band) {
        let (rotation, translation) = &view.camera_from_grid;
        let start = rotation * Vector3::from(first) + translation;
        let step = rotation * spacing;
        for row in 0..SIDE * SIDE {
            let (j, k) = ((row % SIDE) as f32, (row / SIDE) as f32);
            let at = start + step.column(1) * j + step.column(2) * k;
            let (mut u, mut v, mut z) = ([0.0_f32; SIDE], [0.0_f32; SIDE], [0.0_f32; SIDE]);
            for i in 0..SIDE {
                let x = i as f32;
                z[i] = at.z + step[(2, 0)] * x;
                let inverse = 1.0 / z[i];
                u[i] = view.focal[0] * (at.x + step[(0, 0)] * x) * inverse + view.center[0];
                v[i] = view.focal[1] * (at.y + step[(1, 0)] * x) * inverse + view.center[1];
            }
            for i in 0..SIDE {
                self.add_voxel(row * SIDE + i, view, [u[i], v[i]], z[i], band);
            }
        }
    }

    fn add_voxel(&mut self, voxel: usize, view: &Prepared, [u, v]: [f32; 2], z: f32, band: &Band) {
        // Not so for NaN either.
        if !(z > 0.0 && u >= 0.0 && v >= 0.0 && u < view.size[0] as f32 && v < view.size[1] as f32) {
            return;
        }
        let (column, row) = (u as usize, v as usize);
        let Some(pixel) = view.pixel(column, row) else {
            self.empty[voxel] += u16::from(view.beside_is_empty);
            return;
        };
        let truncation = band.truncation;
        if pixel.z > 0.0 {
            let measured =
                pixel.z + pixel.slope[0] * (u - column as f32 - 0.5) + pixel.slope[1] * (v - row as f32 - 0.5);
            let in_front = measured - z;
            let distance = in_front * pixel.factor;
            if in_front > FAR * truncation || distance > truncation {
                self.empty[voxel] += 1;
            } else if in_front > -FAR * truncation && distance > -truncation {
                let ray = [(u - view.center[0]) / view.focal[0], (v - view.center[1]) / view.focal[1]];
                let cosine = pixel.factor / (1.0 + ray[0] * ray[0] + ray[1] * ray[1]).sqrt();
                if cosine < LEAST_COSINE {
                    return;
                }
                let weight = cosine * (band.depth / z).powi(2).clamp(0.1, 10.0);
                if distance >= 0.0 {
                    accumulate(&mut self.front[voxel], weight, distance);
                } else {
                    accumulate(&mut self.behind[voxel], weight * band.falloff(distance), distance);
                }
                self.views[voxel] += 1;
                self.cosine[voxel] = self.cosine[voxel].max(cosine);
            }
        } else if pixel.z == BACKGROUND {
            let aside = pixel.factor * z / view.focal[0].max(view.focal[1]);
            if aside >= truncation {
                self.empty[voxel] += 1;
            } else if pixel.factor >= LEAST_RIM_PX {
                accumulate(&mut self.front[voxel], SILHOUETTE_WEIGHT, aside);
            }
        }
    }

    /// The signed distance of a voxel and whether it was observed. `empty_block`: votes for the whole block.
    fn value(&self, voxel: usize, empty_block: u16, band: &Band) -> (f32, bool) {
        let ([front_weight, front], [behind_weight, behind]) = (self.front[voxel], self.behind[voxel]);
        let empty = self.empty[voxel].saturating_add(empty_block);
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
