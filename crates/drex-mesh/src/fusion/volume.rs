//! What the views say about each voxel, and what the voxel is because of it.

use nalgebra::{Point3, Unit, Vector3};
use rayon::prelude::*;

use super::lattice::{Field, FieldBlock, Lattice, SIDE, VOXELS};
use super::marching::GridEdge;
use super::prepare::{BACKGROUND, Prepared};
use crate::bvh::Aabb;
use drex_core::simd::vectorised;

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
    /// Trust in views that see through that makes an otherwise unobserved voxel empty.
    pub votes: f32,
}

/// Samples along a side of the parts in which a block is compared with a view, and all samples of a part.
const PART: usize = 4;
const CELLS: usize = PART * PART * PART;

/// What was observed at the samples of a part; x changes fastest.
#[derive(Clone, Copy)]
struct Evidence {
    /// Sums of weights of observations in front of the surface, and of weights times distances.
    front: [[f32; CELLS]; 2],
    /// The same behind the surface.
    behind: [[f32; CELLS]; 2],
    /// Best cosine of the observations.
    cosine: [f32; CELLS],
    /// Views that measured the surface near here.
    views: [f32; CELLS],
    /// Trust in the views that saw through.
    empty: [f32; CELLS],
}

const NO_EVIDENCE: Evidence = Evidence {
    front: [[0.0; CELLS]; 2],
    behind: [[0.0; CELLS]; 2],
    cosine: [0.0; CELLS],
    views: [0.0; CELLS],
    empty: [0.0; CELLS],
};

/// The parts of a block.
type Parts = [Evidence; 8];

/// Part of sample `v` of a block, and its place there.
fn part_of(v: usize) -> (usize, usize) {
    let at = [v % SIDE, v / SIDE % SIDE, v / (SIDE * SIDE)];
    let join = |of: fn(usize) -> usize, base: usize| (of(at[2]) * base + of(at[1])) * base + of(at[0]);
    (join(|x| x / PART, 2), join(|x| x % PART, PART))
}

/// A block is stored when the views begin to differ within it.
#[derive(Default)]
pub(super) struct Block {
    /// Trust in the views that see all of it empty.
    empty: f32,
    evidence: Option<Box<Parts>>,
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

impl Block {
    /// Adds what a view says about the samples of the block whose first one is at `first`.
    #[inline(always)]
    fn add(&mut self, view: &Prepared, first: Vector3<f32>, spacing: f32, band: &Band) {
        match view.relation(first, (SIDE - 1) as f32 * spacing, band) {
            Relation::Nothing => {}
            Relation::Empty(trust) => self.empty += trust,
            Relation::Mixed => {
                let parts = self.evidence.get_or_insert_with(|| Box::new([NO_EVIDENCE; 8]));
                for (i, part) in parts.iter_mut().enumerate() {
                    let at = Vector3::from([i & 1, i >> 1 & 1, i >> 2].map(|p| (p * PART) as f32));
                    part.add(view, first + at * spacing, spacing, band);
                }
            }
        }
    }
}

/// The volume under construction.
pub(super) struct Volume {
    pub lattice: Lattice,
    pub band: Band,
    blocks: Vec<Block>,
}

/// Bytes of a stored block.
pub(super) const BLOCK_BYTES: usize = size_of::<Parts>() + VOXELS * size_of::<f32>();
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
            vectorised(
                #[inline(always)]
                || {
                    for view in views {
                        block.add(view, first, lattice.spacing as f32, band);
                    }
                },
            );
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
                let limited = limits.touch(corners, truncation);
                if block.evidence.is_none() && (unobserved > 0.0 || !limited) {
                    return FieldBlock::Constant(unobserved);
                }
                let mut values = Box::new([unobserved; VOXELS]);
                for (v, value) in values.iter_mut().enumerate() {
                    let observed = block.evidence.as_ref().and_then(|e| {
                        let (part, at) = part_of(v);
                        let (distance, observed) = e[part].value(at, block.empty, &self.band);
                        *value = distance;
                        observed.then_some(())
                    });
                    if limited && *value < truncation {
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

    /// How far that reaches from within a box which may be solid, below and above along x, y and z: where the first samples beyond are empty;
    /// `None` where it does not end.
    pub fn allowed_around(
        &self,
        within: &Aabb,
        support: Option<(Point3<f64>, Unit<Vector3<f64>>)>,
    ) -> [Option<f64>; 6] {
        let lattice = &self.lattice;
        let box_of =
            |i: usize| Aabb::of(&[lattice.point(i, Vector3::zeros()), lattice.point(i, Vector3::repeat(SIDE as f64))]);
        // First and last samples of a block that may be solid.
        let may_be_solid = |i: usize| {
            let Block { empty, evidence } = &self.blocks[i];
            let solid_at = |v: &usize| {
                let local = [v % SIDE, v / SIDE % SIDE, v / (SIDE * SIDE)].map(|x| x as f64);
                if support.is_some_and(|(point, up)| (lattice.point(i, local.into()) - point).dot(&up) <= 0.0) {
                    return false;
                }
                let Some(parts) = evidence else { return *empty < self.band.votes };
                let (part, at) = part_of(*v);
                parts[part].value(at, *empty, &self.band).0 < 0.0
            };
            let first = Vector3::from(lattice.first_voxel(i));
            let places = (0..VOXELS)
                .filter(solid_at)
                .map(|v| first + Vector3::new(v % SIDE, v / SIDE % SIDE, v / (SIDE * SIDE)));
            places.map(|at| [at; 2]).reduce(|[lo, hi], [at, _]| [lo.inf(&at), hi.sup(&at)])
        };
        let solid: Vec<Option<[Vector3<usize>; 2]>> =
            (0..self.blocks.len()).into_par_iter().map(may_be_solid).collect();
        let mut reached: Vec<bool> =
            (0..solid.len()).map(|i| solid[i].is_some() && box_of(i).overlaps(within)).collect();
        let mut next: Vec<usize> = (0..reached.len()).filter(|i| reached[*i]).collect();
        let (mut first, mut last) = (Vector3::repeat(usize::MAX), Vector3::repeat(0));
        while let Some(i) = next.pop() {
            let at = lattice.block_at(i);
            let Some([lo, hi]) = solid[i] else { continue };
            (first, last) = (first.inf(&lo), last.sup(&hi));
            for k in 0..3 {
                for step in [-1, 1] {
                    let beside = at[k].checked_add_signed(step).filter(|b| *b < lattice.blocks[k]);
                    let Some(beside) = beside else { continue };
                    let mut there = at;
                    there[k] = beside;
                    let there = lattice.block_index(there);
                    if solid[there].is_some() && !std::mem::replace(&mut reached[there], true) {
                        next.push(there);
                    }
                }
            }
        }
        std::array::from_fn(|side| {
            let k = side / 2;
            let beyond = match side % 2 {
                0 => first[k].checked_sub(1).filter(|_| first[k] < usize::MAX),
                _ => Some(last[k] + 1).filter(|end| *end < lattice.blocks[k] * SIDE),
            };
            beyond.map(|sample| lattice.origin[k] + sample as f64 * lattice.spacing)
        })
    }

    /// How many views measured the surface at a grid edge.
    pub fn views(&self, edge: &GridEdge) -> u16 {
        self.seen(edge.voxel).0.max(self.seen(edge.far()).0)
    }

    /// How many views measured the surface near a voxel, and the best cosine.
    pub fn seen(&self, voxel: [u32; 3]) -> (u16, f32) {
        let (block, v) = self.lattice.locate(voxel);
        let (part, at) = part_of(v);
        let evidence = self.blocks[block].evidence.as_ref().map(|parts| &parts[part]);
        evidence.map_or((0, 0.0), |e| (e.views[at] as u16, e.cosine[at]))
    }
}

/// What a view says about a cube of samples.
enum Relation {
    Nothing,
    /// With so much trust.
    Empty(f32),
    Mixed,
}

impl Prepared {
    /// Compares the depths over the part of the image that a cube covers with the depths of the cube.
    #[inline(always)]
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
        // So far to the right that rounding towards zero rounds down.
        const SHIFT: f32 = 32_768.0;
        let (mut lo, mut hi) = ([0; 2], [0; 2]);
        for k in 0..2 {
            // The box looks largest at its near end, and there also farthest from the axis.
            let (low, high) = (center[k] - half[k], center[k] + half[k]);
            lo[k] = (self.focal[k] * low / if low < 0.0 { near } else { far } + self.center[k] + SHIFT) as isize
                - SHIFT as isize;
            hi[k] = (self.focal[k] * high / if high > 0.0 { near } else { far } + self.center[k] + SHIFT) as isize
                - SHIFT as isize;
            if hi[k] < 0 || lo[k] >= self.size[k] as isize {
                return Relation::Nothing;
            }
        }
        let seen = self.extremes(lo, hi);
        let hit = seen.farthest > 0.0;
        let aside = seen.rim_px * near / self.focal[0].max(self.focal[1]);
        if !seen.unknown && aside >= band.truncation && (!hit || seen.nearest > far + FAR_IN_FRONT * band.truncation) {
            return if hit || seen.empty { Relation::Empty(seen.trust) } else { Relation::Nothing };
        }
        if !seen.empty && (!hit || seen.farthest < near - FAR_BEHIND * band.truncation) {
            return Relation::Nothing;
        }
        Relation::Mixed
    }
}

impl Evidence {
    /// Adds what a view says about the samples of the part whose first one is at `first`.
    #[inline(always)]
    fn add(&mut self, view: &Prepared, first: Vector3<f32>, spacing: f32, band: &Band) {
        match view.relation(first, (PART - 1) as f32 * spacing, band) {
            Relation::Nothing => {}
            Relation::Empty(trust) => self.empty.iter_mut().for_each(|n| *n += trust),
            Relation::Mixed => self.add_each(&Glance::new(view, first, spacing), view, band),
        }
    }

    /// Adds what is known of each sample. All cases are computed for all samples and one is chosen: that is faster than to
    /// ask, for the processor cannot guess the answers.
    #[inline(always)]
    fn add_each(&mut self, at: &Glance, view: &Prepared, band: &Band) {
        let truncation = band.truncation;
        let middle = at.depth[CELLS / 2];
        let per_focal = 1.0 / view.focal[0].max(view.focal[1]);
        // The noise grows with the square of the depth.
        let noise_weight = (band.depth / middle).powi(2).clamp(0.1, 10.0);
        for i in 0..CELLS {
            let (hit, background) = (at.measured[i] > 0.0, at.measured[i] == BACKGROUND);
            let in_front = at.measured[i] - at.depth[i];
            let distance = in_front * at.factor[i];
            let cosine = at.factor[i] * at.per_ray;
            let through = hit & ((in_front > FAR_IN_FRONT * truncation) | (distance > truncation));
            let within = (in_front > -FAR_BEHIND * truncation) & (distance > -truncation) & (cosine >= LEAST_COSINE);
            let near = hit & !through & within;
            let (front, behind) = (near & (distance >= 0.0), near & (distance < 0.0));

            let aside = at.factor[i] * at.depth[i] * per_focal;
            let beside = background & (aside >= truncation);
            let rim = background & (aside < truncation) & (at.factor[i] >= LEAST_RIM_PX);

            let weight = cosine * noise_weight * at.trust[i] * at.trust[i];
            self.front[0][i] += only_if(front, weight) + only_if(rim, SILHOUETTE_WEIGHT);
            self.front[1][i] += only_if(front, weight * distance) + only_if(rim, SILHOUETTE_WEIGHT * aside);
            let weight = weight * band.falloff(distance);
            self.behind[0][i] += only_if(behind, weight);
            self.behind[1][i] += only_if(behind, weight * distance);
            let cosine = only_if(near, cosine);
            self.cosine[i] = if cosine > self.cosine[i] { cosine } else { self.cosine[i] };
            self.views[i] += only_if(near, 1.0);
            self.empty[i] += only_if(through | beside, at.trust[i]);
        }
    }

    /// The signed distance of a sample and whether it was observed. `empty_block`: votes for the whole block.
    fn value(&self, at: usize, empty_block: f32, band: &Band) -> (f32, bool) {
        let (front_weight, front) = (self.front[0][at], self.front[1][at]);
        let (behind_weight, behind) = (self.behind[0][at], self.behind[1][at]);
        let (empty, votes) = (self.empty[at] + empty_block, band.votes);
        let weight = front_weight + behind_weight;
        if weight < OBSERVED {
            return (if empty >= votes { band.truncation } else { -band.truncation }, false);
        }
        let mean = (front + behind) / weight;
        // Behind a surface is inside only as far as nobody sees otherwise: rays that cut a corner say so behind it too.
        if mean < 0.0 && empty > votes && empty > CONTRADICTION * behind_weight {
            return (if front_weight > OBSERVED { front / front_weight } else { 0.5 * band.truncation }, true);
        }
        (mean, true)
    }
}

/// The samples of a part in a view: their depths, and what was measured on their rays.
struct Glance {
    depth: [f32; CELLS],
    /// Depth of the surface on the ray, continued from the pixel's centre along its slope.
    measured: [f32; CELLS],
    factor: [f32; CELLS],
    trust: [f32; CELLS],
    /// Inverse length of the ray to the middle with z = 1.
    per_ray: f32,
}

impl Glance {
    #[inline(always)]
    fn new(view: &Prepared, first: Vector3<f32>, spacing: f32) -> Self {
        let (rotation, translation) = &view.camera_from_grid;
        let start = rotation * first + translation;
        let step = rotation * spacing;
        let (mut u, mut v, mut depth) = ([0.0; CELLS], [0.0; CELLS], [0.0; CELLS]);
        for i in 0..CELLS {
            let [x, y, z] = [i % PART, i / PART % PART, i / (PART * PART)].map(|k| k as f32);
            let at = |row: usize| start[row] + step[(row, 0)] * x + step[(row, 1)] * y + step[(row, 2)] * z;
            depth[i] = at(2);
            let inverse = 1.0 / depth[i];
            // Centres of pixels are whole numbers here.
            u[i] = view.focal[0] * at(0) * inverse + view.center[0] - 0.5;
            v[i] = view.focal[1] * at(1) * inverse + view.center[1] - 0.5;
        }
        // In three loops: only the second one cannot be done for many samples at once.
        let (mut place, mut aside, mut below) = ([0; CELLS], [0.0; CELLS], [0.0; CELLS]);
        for i in 0..CELLS {
            let (column, row);
            (column, aside[i]) = nearest(u[i]);
            (row, below[i]) = nearest(v[i]);
            place[i] = view.place(if depth[i] > 0.0 { column } else { OUTSIDE }, row);
        }
        let pixels = place.map(|p| view.pixels[p as usize].values());
        let (mut measured, mut factor, mut trust) = ([0.0; CELLS], [0.0; CELLS], [0.0; CELLS]);
        for i in 0..CELLS {
            let [z, along, down, f, t] = pixels[i];
            // Slopes are zero where there is no surface.
            measured[i] = z + along * aside[i] + down * below[i];
            (factor[i], trust[i]) = (f, t);
        }
        let middle = start + step * Vector3::repeat(0.5 * (PART - 1) as f32);
        Self { depth, measured, factor, trust, per_ray: (middle.z / middle.norm()).clamp(0.1, 1.0) }
    }
}

/// The nearest whole number and how far the number is beyond it; far outside any image for what is no coordinate.
#[inline(always)]
fn nearest(x: f32) -> (i32, f32) {
    // Adding 1.5 · 2^23 leaves no bits for a fraction, so the sum is rounded, and its low bits are the whole number.
    const ROUND: f32 = 12_582_912.0;
    let rounded = x + ROUND;
    let whole = (rounded.to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32);
    (if x.abs() < 4_194_304.0 { whole } else { OUTSIDE }, x - (rounded - ROUND))
}

/// A column or row outside any image.
const OUTSIDE: i32 = i32::MIN;

impl Band {
    /// Weight of a distance behind the surface.
    #[inline(always)]
    fn falloff(&self, distance: f32) -> f32 {
        let past = (-distance - self.trusted) * (1.0 / (self.truncation - self.trusted));
        let past = if past > 0.0 { past } else { 0.0 };
        let past = if past < 1.0 { past } else { 1.0 };
        let root = 1.0 - (1.0 - WEIGHT_BEHIND) * past;
        root * root
    }
}

/// `x` or 0, without a branch.
#[inline(always)]
fn only_if(condition: bool, x: f32) -> f32 {
    f32::from_bits(x.to_bits() & u32::from(condition).wrapping_neg())
}
