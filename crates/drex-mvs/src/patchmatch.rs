//! PatchMatch: planes that explain a pixel are offered to its neighbours, and tried with small changes.
//!
//! Pixels are coloured like a chessboard and those of one colour are done at once, from the planes of the other colour: the order of the
//! work, and so the number of threads, does not matter. Where candidates come from follows Galliani, Lasinger and Schindler 2015 and Xu and
//! Tao 2019 (ACMH).

use std::sync::Arc;

use drex_core::simd::vectorised;
use nalgebra::Vector3;
use rayon::prelude::*;

use crate::kernel::{Patch, Plane, Source, WORST, Window, mapped};
use crate::picture::{Area, Grey};
use crate::scene::Limits;

/// Most photos that one is compared with.
pub(crate) const MOST_SOURCES: usize = 8;
/// The cost of a plane is the mean over so many photos, those that it fits best: others may not see the place.
pub(crate) const COUNTED: usize = 3;
/// A plane that two good photos like less than the best one by this much is not tried on the others.
pub(crate) const EARLY_STOP_COST: f32 = 0.15;
/// Planes are alike if they are nowhere in the window farther apart than this, pixels in the other photos.
pub(crate) const TWIN_PX: f32 = 0.1;
/// Samples that count as independent: a third of those of the windows in the [`COUNTED`] photos.
pub(crate) const INDEPENDENT: f32 = 24.0;
/// Photos never agree better than this, whatever the cost says.
pub(crate) const LEAST_COST: f32 = 0.01;
/// Cosine of the steepest slope of a surface to its ray.
pub(crate) const LEAST_COSINE: f32 = 0.15;
/// Weight of a pixel of disagreement with another photo's depth, and the most that counts, pixels (ACMM).
pub(crate) const PER_PIXEL: f32 = 0.2;
pub(crate) const MOST_PX: f32 = 3.0;

/// The planes of a photo at one size.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Field {
    pub width: usize,
    pub height: usize,
    pub planes: Vec<Plane>,
    /// 0 to [`WORST`], and what disagrees with other photos; infinite where nothing is searched.
    pub costs: Vec<f32>,
}

/// Another photo's planes, and how its pixels get back to the reference.
pub(crate) struct Peer {
    pub field: Arc<Field>,
    pub turn: [[f32; 3]; 3],
    pub shift: [f32; 3],
}

/// Everything that a pass over a photo reads.
pub(crate) struct Matcher<'a, const G: usize> {
    pub window: &'a Window<G>,
    /// Where planes are looked for.
    pub searched: &'a Area,
    /// The picture, and smaller ones for windows that show little.
    pub scales: Vec<Scale<'a>>,
    /// Whether pixels outside of `searched` belong to something else and may not be compared.
    pub masked: bool,
    /// Of each source's say: those nearby agree with everything and tell no depth.
    pub weights: Vec<f32>,
    /// One per source in passes where depth counts; else empty.
    pub peers: Vec<Peer>,
    /// Focal lengths and principal point, pixels from the centre of the first one.
    pub focal: [f32; 2],
    pub centre: [f32; 2],
    /// How near and far a pixel's surface can be, and how often its picture was halved.
    pub limits: &'a Limits<'a>,
    pub halvings: usize,
    /// Pixels that a place moves in the sources per unit of inverse depth.
    pub disparity: f32,
    /// Of the random numbers, with view and size in it.
    pub seed: u64,
}

/// The picture at one size and the others that it is compared with.
pub(crate) struct Scale<'a> {
    pub picture: &'a Grey,
    pub searched: &'a Area,
    /// Variance of a window, grey levels squared, below which a smaller picture tells more: what it shows may be noise.
    pub least_variance: f32,
    /// Of the noise, grey levels squared.
    pub noise_variance: f32,
    pub sources: Vec<Source>,
}

/// The window of a pixel in the largest picture in which it shows something.
struct Seen<const G: usize> {
    patch: Patch<G>,
    /// Which picture that is.
    scale: usize,
    /// Its pixel, and the steps from there to that pixel's centre.
    at: [f32; 2],
    aside: [f32; 2],
}

/// What one pass tries.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pass {
    /// Counts passes at this size, for the random numbers.
    pub number: u64,
    /// Whether planes from far away are offered as well.
    pub far: bool,
    /// Largest change that is tried, pixels in the other photos.
    pub step_px: f32,
    /// Whether a plane of any depth and slope is tried.
    pub restart: bool,
    /// Whether each plane goes down to the nearest minimum.
    pub last: bool,
}

/// What is known of one pixel while planes are tried on it.
struct Trial<'m, 'a, const G: usize> {
    matcher: &'m Matcher<'a, G>,
    seen: Seen<G>,
    at: [f32; 2],
    /// Sources, the one that likes the first plane best first.
    order: [u8; MOST_SOURCES],
    limits: [f32; 2],
    best: Plane,
    cost: f32,
}

impl Field {
    /// Random planes within the limits of each pixel that is searched.
    pub fn random<const G: usize>(matcher: &Matcher<'_, G>) -> Self {
        let Area { width, height, inside } = matcher.searched;
        let start = |(i, inside): (usize, &bool)| {
            if !inside {
                return (Plane::default(), f32::INFINITY);
            }
            let (x, y) = (i % width, i / width);
            let mut random = Random::new(matcher.seed, [u64::MAX, i as u64]);
            (
                matcher.any_plane(
                    &mut random,
                    [x as f32, y as f32],
                    matcher.limits.inverse_depths(matcher.halvings, x, y),
                ),
                WORST,
            )
        };
        let (planes, costs) = inside.par_iter().enumerate().map(start).unzip();
        Self { width: *width, height: *height, planes, costs }
    }

    /// The same planes at twice the size.
    pub fn doubled(&self, searched: &Area) -> Self {
        let Area { width, height, inside } = searched;
        let of = |(i, inside): (usize, &bool)| {
            // What is searched at twice the size was searched here.
            let (x, y) = ((i % width) / 2, (i / width) / 2);
            let at = y.min(self.height - 1) * self.width + x.min(self.width - 1);
            if !inside || !self.costs[at].is_finite() {
                return (Plane::default(), f32::INFINITY);
            }
            let quarter = |v: usize| if v.is_multiple_of(2) { -0.25 } else { 0.25 };
            let plane = self.planes[at].moved(quarter(i % width), quarter(i / width));
            (plane.scaled(0.5), self.costs[at])
        };
        let (planes, costs) = inside.par_iter().enumerate().map(of).unzip();
        Self { width: *width, height: *height, planes, costs }
    }
}

impl<const G: usize> Matcher<'_, G> {
    /// Photos that it is compared with.
    pub fn sources(&self) -> usize {
        self.weights.len()
    }

    /// One pass over both colours.
    pub fn pass(&self, field: &mut Field, pass: Pass) {
        for colour in 0..2 {
            let rows: Vec<Vec<(usize, Plane, f32)>> =
                (0..field.height).into_par_iter().map(|y| self.row(field, pass, colour, y)).collect();
            for (at, plane, cost) in rows.into_iter().flatten() {
                (field.planes[at], field.costs[at]) = (plane, cost);
            }
        }
    }

    fn row(&self, field: &Field, pass: Pass, colour: usize, y: usize) -> Vec<(usize, Plane, f32)> {
        let mut done = Vec::new();
        vectorised(
            #[inline(always)]
            || {
                for x in ((y + colour) % 2..field.width).step_by(2) {
                    let at = y * field.width + x;
                    if self.searched.inside[at] {
                        let (plane, cost) = self.pixel(field, pass, x, y);
                        done.push((at, plane, cost));
                    }
                }
            },
        );
        done
    }

    /// How far off the disparity of each pixel's plane may be, see [`Trial::deviation`]; infinite where nothing is known.
    pub fn deviations(&self, field: &Field) -> Vec<f32> {
        let mut deviations = vec![f32::INFINITY; field.costs.len()];
        deviations.par_chunks_mut(field.width.max(1)).enumerate().for_each(|(y, row)| {
            vectorised(
                #[inline(always)]
                || {
                    for (x, deviation) in row.iter_mut().enumerate() {
                        let at = y * field.width + x;
                        if !(field.costs[at] < WORST) {
                            continue;
                        }
                        let seen = self.seen(x, y);
                        if seen.patch.says_something() {
                            let limits = self.limits.inverse_depths(self.halvings, x, y);
                            let place = [x as f32, y as f32];
                            *deviation = Trial::new(self, seen, place, limits, field.planes[at]).deviation();
                        }
                    }
                },
            );
        });
        deviations
    }

    /// The best of the pixel's plane, its neighbours' and changes of it.
    #[inline(always)]
    pub fn pixel(&self, field: &Field, pass: Pass, x: usize, y: usize) -> (Plane, f32) {
        let at = y * field.width + x;
        let own = field.planes[at];
        let seen = self.seen(x, y);
        if !seen.patch.says_something() {
            return (own, WORST);
        }
        let mut trial =
            Trial::new(self, seen, [x as f32, y as f32], self.limits.inverse_depths(self.halvings, x, y), own);
        // What others offer, and what has been tried.
        let mut tried = [own; 9];
        let mut count = 1;
        let areas: &[&[[i32; 2]]] = if pass.far { &ALL_AREAS } else { &NEAR_AREAS };
        for area in areas {
            let Some([dx, dy]) = best_of(field, area, x, y) else { continue };
            let from = (y as i32 + dy) as usize * field.width + (x as i32 + dx) as usize;
            let plane = field.planes[from].moved(-dx as f32, -dy as f32);
            if tried[..count].iter().any(|t| self.alike(*t, plane)) {
                continue;
            }
            (tried[count], count) = (plane, count + 1);
            trial.offer(plane);
        }
        let mut random = Random::new(self.seed, [pass.number, at as u64]);
        if pass.restart {
            trial.offer(self.any_plane(&mut random, trial.at, trial.limits));
        }
        if pass.step_px > 0.0 {
            let along = pass.step_px / self.disparity;
            let across = along / self.window.radius as f32;
            trial.offer_change(along * random.signed(), 0.0, 0.0);
            trial.offer_change(0.0, across * random.signed(), across * random.signed());
            trial.offer_change(
                0.5 * along * random.signed(),
                0.5 * across * random.signed(),
                0.5 * across * random.signed(),
            );
        }
        if pass.last {
            for px in [0.3, 0.15] {
                let along = px / self.disparity;
                let across = along / self.window.radius as f32;
                trial.descend(Plane { w: along, a: 0.0, b: 0.0 });
                trial.descend(Plane { w: 0.0, a: across, b: 0.0 });
                trial.descend(Plane { w: 0.0, a: 0.0, b: across });
            }
        }
        (trial.best, trial.cost)
    }

    #[inline(always)]
    fn seen(&self, x: usize, y: usize) -> Seen<G> {
        let mut scale = 0;
        loop {
            let Scale { picture, searched, least_variance, .. } = &self.scales[scale];
            // What is left of an odd number of pixels belongs to the last one.
            let (u, v) = ((x >> scale).min(picture.width - 1), (y >> scale).min(picture.height - 1));
            let patch = self.window.patch(picture, u, v, |i| !self.masked || searched.inside[i]);
            if patch.variance() >= *least_variance || scale + 1 == self.scales.len() {
                let size = (1 << scale) as f32;
                let centre = |p: usize| (p as f32 + 0.5) * size - 0.5;
                let aside = [centre(u) - x as f32, centre(v) - y as f32];
                return Seen { patch, scale, at: [u as f32, v as f32], aside };
            }
            scale += 1;
        }
    }

    /// Whether two planes look the same within the window.
    #[inline(always)]
    fn alike(&self, p: Plane, q: Plane) -> bool {
        let near = TWIN_PX / self.disparity;
        let r = self.window.radius as f32;
        (p.w - q.w).abs() < near && (p.a - q.a).abs() * r < near && (p.b - q.b).abs() * r < near
    }

    /// Inverse depth uniform within the limits, normal uniform over what faces the camera.
    #[inline(always)]
    fn any_plane(&self, random: &mut Random, at: [f32; 2], limits: [f32; 2]) -> Plane {
        let w = limits[0] + (limits[1] - limits[0]) * random.unit();
        let ray = self.ray(at);
        // Of two random directions the one that looks more at the camera: few surfaces are seen at a flat angle.
        let mut normal = Vector3::zeros();
        let mut facing = -1.0;
        for _ in 0..2 {
            let z = 2.0 * random.unit() - 1.0;
            let angle = std::f32::consts::TAU * random.unit();
            let across = (1.0 - z * z).max(0.0).sqrt();
            let n = Vector3::new(across * angle.cos(), across * angle.sin(), z);
            let cosine = -n.dot(&ray) / ray.norm();
            let (n, cosine) = if cosine < 0.0 { (-n, -cosine) } else { (n, cosine) };
            if cosine > facing {
                (normal, facing) = (n, cosine);
            }
        }
        // Far from flat along the ray, so that slopes stay finite.
        if facing < 0.3 {
            normal = -ray.normalize();
        }
        let m = normal * (w / normal.dot(&ray));
        Plane { w, a: m.x / self.focal[0], b: m.y / self.focal[1] }
    }

    #[inline(always)]
    fn ray(&self, at: [f32; 2]) -> Vector3<f32> {
        Vector3::new((at[0] - self.centre[0]) / self.focal[0], (at[1] - self.centre[1]) / self.focal[1], 1.0)
    }

    /// Whether a surface can lie so: within the limits, and not seen at too flat an angle.
    #[inline(always)]
    fn possible(&self, plane: Plane, at: [f32; 2], limits: [f32; 2]) -> bool {
        let ray = self.ray(at);
        let (mx, my) = (plane.a * self.focal[0], plane.b * self.focal[1]);
        let mz = plane.w - mx * ray.x - my * ray.y;
        let cosine_squared = plane.w * plane.w;
        let norms = (mx * mx + my * my + mz * mz) * ray.norm_squared();
        plane.w >= limits[0] && plane.w <= limits[1] && cosine_squared >= LEAST_COSINE * LEAST_COSINE * norms
    }

    /// How much a plane's window differs from one source.
    #[inline(always)]
    fn photometric(&self, seen: &Seen<G>, plane: Plane, source: usize) -> f32 {
        let there = plane.moved(seen.aside[0], seen.aside[1]).scaled((1 << seen.scale) as f32);
        seen.patch.cost(self.window, seen.at, there, &self.scales[seen.scale].sources[source])
    }

    /// Cost of a plane with one source.
    #[inline(always)]
    fn cost(&self, seen: &Seen<G>, at: [f32; 2], plane: Plane, source: usize) -> f32 {
        let photometric = self.photometric(seen, plane, source);
        match self.peers.get(source) {
            Some(peer) if photometric < WORST => {
                photometric + PER_PIXEL * self.disagreement_px(at, plane.w, source, peer)
            }
            Some(_) => photometric + PER_PIXEL * MOST_PX,
            None => photometric,
        }
    }

    /// From the pixel to the other photo, to the plane that lies there, and back: how far away that ends, at most [`MOST_PX`].
    #[inline(always)]
    fn disagreement_px(&self, at: [f32; 2], w: f32, source: usize, peer: &Peer) -> f32 {
        let source = &self.scales[0].sources[source];
        let Some([x, y]) = mapped(&source.turn, &source.shift, at, w) else { return MOST_PX };
        let Some((plane, _)) = peer.field.at(x, y) else { return MOST_PX };
        let Some([u, v]) = mapped(&peer.turn, &peer.shift, [x, y], plane.w) else { return MOST_PX };
        let (du, dv) = (u - at[0], v - at[1]);
        (du * du + dv * dv).sqrt().min(MOST_PX)
    }
}

impl Field {
    /// The plane of the nearest pixel, seen from exactly here, and its cost.
    #[inline(always)]
    pub fn at(&self, x: f32, y: f32) -> Option<(Plane, f32)> {
        let (column, line) = ((x + 0.5).floor(), (y + 0.5).floor());
        let inside = column >= 0.0 && line >= 0.0 && column < self.width as f32 && line < self.height as f32;
        if !inside {
            return None;
        }
        let i = line as usize * self.width + column as usize;
        self.costs[i].is_finite().then(|| (self.planes[i].moved(x - column, y - line), self.costs[i]))
    }
}

impl<'m, 'a, const G: usize> Trial<'m, 'a, G> {
    #[inline(always)]
    fn new(matcher: &'m Matcher<'a, G>, seen: Seen<G>, at: [f32; 2], limits: [f32; 2], own: Plane) -> Self {
        let n = matcher.sources().min(MOST_SOURCES);
        let mut costs = [f32::INFINITY; MOST_SOURCES];
        for (k, cost) in costs[..n].iter_mut().enumerate() {
            *cost = matcher.cost(&seen, at, own, k);
        }
        let mut order = std::array::from_fn(|k| k as u8);
        for i in 1..n {
            let mut k = i;
            while k > 0 && costs[order[k] as usize] < costs[order[k - 1] as usize] {
                order.swap(k, k - 1);
                k -= 1;
            }
        }
        let cost = matcher.counted(&costs[..n]);
        Self { matcher, seen, at, order, limits, best: own, cost }
    }

    /// The cost of a plane; infinite if it is far worse than the best one, or impossible.
    #[inline(always)]
    fn cost_of(&self, plane: Plane) -> f32 {
        if !self.matcher.possible(plane, self.at, self.limits) {
            return f32::INFINITY;
        }
        let n = self.matcher.sources().min(MOST_SOURCES);
        let mut costs = [f32::INFINITY; MOST_SOURCES];
        for (done, source) in self.order[..n].iter().enumerate() {
            let source = usize::from(*source);
            if done == 2 {
                let [a, b] = [self.order[0], self.order[1]].map(|s| costs[usize::from(s)]);
                if 0.5 * (a + b) > self.cost + EARLY_STOP_COST {
                    return f32::INFINITY;
                }
            }
            costs[source] = self.matcher.cost(&self.seen, self.at, plane, source);
        }
        self.matcher.counted(&costs[..n])
    }

    /// Deviation of the disparity that the best plane has, pixels of the size at work: by how much the cost rises a pixel to either side,
    /// beside what noise and what is left unexplained make of it.
    ///
    /// A shift d makes 1 - correlation rise by d² Σ g² / (2 N var), where g are the slopes of the grey; the variance of the shift that is
    /// found is that of what a sample differs by, over Σ g².
    #[inline(always)]
    fn deviation(&self) -> f32 {
        let matcher = self.matcher;
        let scale = &matcher.scales[self.seen.scale];
        let size = (1 << self.seen.scale) as f32;
        let aside = size / matcher.disparity;
        let n = matcher.sources().min(COUNTED);
        let mean = |w: f32| {
            let plane = Plane { w, ..self.best };
            let costs = self.order[..n].iter().map(|s| matcher.photometric(&self.seen, plane, usize::from(*s)));
            costs.sum::<f32>() / n as f32
        };
        let rise = mean(self.best.w - aside).min(mean(self.best.w + aside)) - mean(self.best.w);
        if !(rise > 0.0) {
            return f32::INFINITY;
        }
        let noise = scale.noise_variance / (2.0 * self.seen.patch.variance());
        size * ((self.cost.max(LEAST_COST) + noise) / (INDEPENDENT * rise)).sqrt()
    }

    #[inline(always)]
    fn offer(&mut self, plane: Plane) {
        let cost = self.cost_of(plane);
        if cost < self.cost {
            (self.best, self.cost) = (plane, cost);
        }
    }

    #[inline(always)]
    fn offer_change(&mut self, w: f32, a: f32, b: f32) {
        self.offer(Plane { w: self.best.w + w, a: self.best.a + a, b: self.best.b + b });
    }

    /// Towards the vertex of the parabola through the best plane and one step to either side.
    #[inline(always)]
    fn descend(&mut self, step: Plane) {
        let (best, middle) = (self.best, self.cost);
        let along = |t: f32| Plane { w: best.w + t * step.w, a: best.a + t * step.a, b: best.b + t * step.b };
        let [before, after] = [along(-1.0), along(1.0)].map(|p| self.cost_of(p).min(2.0 * WORST));
        let curvature = before - 2.0 * middle + after;
        if before < middle || after < middle {
            let (plane, cost) = if before < after { (along(-1.0), before) } else { (along(1.0), after) };
            (self.best, self.cost) = (plane, cost);
        } else if curvature > 1e-6 {
            self.offer(along(0.5 * (before - after) / curvature));
        }
    }
}

impl<const G: usize> Matcher<'_, G> {
    /// The mean of the least costs, by the weights of their sources.
    #[inline(always)]
    fn counted(&self, costs: &[f32]) -> f32 {
        let mut used = [false; MOST_SOURCES];
        let (mut sum, mut weight) = (0.0, 0.0);
        for _ in 0..COUNTED.min(costs.len()) {
            let mut least = usize::MAX;
            for k in 0..costs.len() {
                if !used[k] && (least == usize::MAX || costs[k] < costs[least]) {
                    least = k;
                }
            }
            used[least] = true;
            sum += self.weights[least] * costs[least];
            weight += self.weights[least];
        }
        if weight > 0.0 { sum / weight } else { WORST }
    }
}

/// The pixel with the least cost among some that lie so from a pixel.
#[inline(always)]
fn best_of(field: &Field, steps: &[[i32; 2]], x: usize, y: usize) -> Option<[i32; 2]> {
    let mut best = None;
    let mut least = f32::INFINITY;
    for [dx, dy] in steps {
        let (u, v) = (x as i32 + dx, y as i32 + dy);
        if u >= 0 && v >= 0 && u < field.width as i32 && v < field.height as i32 {
            let cost = field.costs[v as usize * field.width + u as usize];
            if cost < least {
                (best, least) = (Some([*dx, *dy]), cost);
            }
        }
    }
    best
}

/// Seven pixels of the other colour in a V that opens upwards, downwards, to the left and to the right.
static UP: [[i32; 2]; 7] = [[0, -1], [-1, -2], [1, -2], [-2, -3], [2, -3], [-3, -4], [3, -4]];
static DOWN: [[i32; 2]; 7] = [[0, 1], [-1, 2], [1, 2], [-2, 3], [2, 3], [-3, 4], [3, 4]];
static LEFT: [[i32; 2]; 7] = [[-1, 0], [-2, -1], [-2, 1], [-3, -2], [-3, 2], [-4, -3], [-4, 3]];
static RIGHT: [[i32; 2]; 7] = [[1, 0], [2, -1], [2, 1], [3, -2], [3, 2], [4, -3], [4, 3]];
static FAR_UP: [[i32; 2]; 11] = strip(0, -1);
static FAR_DOWN: [[i32; 2]; 11] = strip(0, 1);
static FAR_LEFT: [[i32; 2]; 11] = strip(-1, 0);
static FAR_RIGHT: [[i32; 2]; 11] = strip(1, 0);
static NEAR_AREAS: [&[[i32; 2]]; 4] = [&UP, &DOWN, &LEFT, &RIGHT];
static ALL_AREAS: [&[[i32; 2]]; 8] = [&UP, &DOWN, &LEFT, &RIGHT, &FAR_UP, &FAR_DOWN, &FAR_LEFT, &FAR_RIGHT];

/// Eleven pixels of the other colour in a line, 3 to 23 pixels away.
const fn strip(x: i32, y: i32) -> [[i32; 2]; 11] {
    let mut steps = [[0; 2]; 11];
    let mut k = 0;
    while k < 11 {
        let far = 3 + 2 * k as i32;
        steps[k] = [far * x, far * y];
        k += 1;
    }
    steps
}

/// Random numbers of one pixel: a hash of what they are for (SplitMix64, Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    #[inline(always)]
    fn new(seed: u64, [pass, pixel]: [u64; 2]) -> Self {
        let mut random = Self(seed);
        random.0 = random.next() ^ pass;
        random.0 = random.next() ^ pixel;
        random
    }

    #[inline(always)]
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From 0 to 1.
    #[inline(always)]
    fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// From -1 to 1.
    #[inline(always)]
    fn signed(&mut self) -> f32 {
        2.0 * self.unit() - 1.0
    }
}
