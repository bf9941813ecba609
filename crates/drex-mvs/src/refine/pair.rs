//! What pairs of photos say about where the mesh should be.

use nalgebra::Point3;

use super::shot::{Blurred, Shot, seen_by};
use crate::picture::box_sum;
use crate::scene::View;

/// Windows reach so many pixels from their centre.
const RADIUS: usize = 3;
/// Pixels of a window that both photos have to show.
const LEAST_PIXELS: f32 = 30.0;
/// A pixel is seen by the other photo if what that one shows is not farther away than so many of its pixels.
const HIDDEN_PX: f32 = 3.0;
/// Windows whose grey varies by this count half, grey levels squared.
const CONTRAST: f32 = 30.0;
/// Windows that correlate less are of something else, or hidden.
const LEAST_CORRELATION: f32 = 0.2;

/// Sums over photos of what they say about each vertex.
pub(super) struct Pulls {
    /// Per vertex, the force along the normal and how fast it becomes less: their quotient is the step to where it ends.
    pub each: Vec<[f32; 2]>,
    /// Sum of the correlations of the windows, and their number.
    pub correlation: f64,
    pub windows: u32,
}

impl Pulls {
    pub fn new(vertices: usize) -> Self {
        Self { each: vec![[0.0; 2]; vertices], correlation: 0.0, windows: 0 }
    }

    pub fn add(&mut self, other: &Self) {
        for (sum, pull) in self.each.iter_mut().zip(&other.each) {
            *sum = [sum[0] + pull[0], sum[1] + pull[1]];
        }
        self.correlation += other.correlation;
        self.windows += other.windows;
    }

    /// Share of the vertices that are pulled.
    pub fn share(&self) -> f64 {
        self.each.iter().filter(|p| p[1] > 0.0).count() as f64 / self.each.len().max(1) as f64
    }
}

/// Another photo as it looks through the mesh from the place of the first: 0 where it shows nothing of what the first one shows.
struct Warped {
    counts: Vec<f32>,
    grey: Vec<f32>,
    /// Change of grey as the mesh moves along its normal.
    slope: Vec<f32>,
}

/// What view `i` and its sources say.
pub(super) fn pulls(
    views: &[View],
    shots: &[Shot],
    pictures: &[Blurred],
    halvings: usize,
    i: usize,
    faces: &[[u32; 3]],
    vertices: &[Point3<f64>],
) -> Pulls {
    let (shot, own) = (&shots[i], &pictures[i]);
    let mut pulls = Pulls::new(vertices.len());
    if !shot.counts.contains(&true) {
        return pulls;
    }
    let (seen, k) = (seen_by(&views[i], vertices), views[i].matrix(halvings));
    let gains = shot.gains(&k, faces, &seen);
    let mut force = vec![0.0; shot.face.len()];
    let mut hessian = vec![0.0; shot.face.len()];
    for n in views[i].sources() {
        let (turn, shift) = views[i].to(&views[n.view], halvings);
        let focal = views[n.view].matrix(halvings)[(0, 0)] as f32;
        let warped = warp((shot, &gains), &shots[n.view], &pictures[n.view], &turn, &shift, focal);
        let least_variance = own.least_variance.max(pictures[n.view].least_variance);
        let (correlation, windows) = compare(own, &warped, least_variance, &mut force, &mut hessian);
        pulls.correlation += correlation;
        pulls.windows += windows;
    }
    // As if vertices moved along the normal of the face: where it bends little that is their own.
    for at in 0..force.len() {
        if hessian[at] > 0.0 {
            let corners = faces[shot.face[at] as usize];
            for (v, share) in corners.into_iter().zip(shot.shares(at, &k, faces, &seen)) {
                let pull = &mut pulls.each[v as usize];
                *pull = [pull[0] + share * force[at], pull[1] + share * hessian[at]];
            }
        }
    }
    pulls
}

fn warp(
    (shot, gains): (&Shot, &[f32]),
    other: &Shot,
    picture: &Blurred,
    turn: &[[f32; 3]; 3],
    shift: &[f32; 3],
    focal: f32,
) -> Warped {
    let count = shot.face.len();
    let mut out = Warped { counts: vec![0.0; count], grey: vec![0.0; count], slope: vec![0.0; count] };
    let (right, bottom) = (picture.width as f32 - 3.0, picture.height as f32 - 3.0);
    for at in (0..count).filter(|at| shot.counts[*at]) {
        let (px, py) = ((at % shot.width) as f32, (at / shot.width) as f32);
        let w = shot.w[at];
        let row = |k: usize| turn[0][k] * px + turn[1][k] * py + turn[2][k] + shift[k] * w;
        let z = row(2);
        let (x, y) = (row(0) / z, row(1) / z);
        if !(z > 0.0 && x >= 1.0 && y >= 1.0 && x <= right && y <= bottom) {
            continue;
        }
        let there = (y + 0.5) as usize * other.width + (x + 0.5) as usize;
        let its = w / z;
        if !other.counts[there] || (its - other.w[there]).abs() > HIDDEN_PX * its / focal {
            continue;
        }
        let [grey, across, down] = picture.sample(x, y);
        let per_w = (across * (shift[0] - x * shift[2]) + down * (shift[1] - y * shift[2])) / z;
        out.counts[at] = 1.0;
        out.grey[at] = grey;
        out.slope[at] = per_w * gains[at];
    }
    out
}

/// Adds what the correlation of all windows says to force and hessian of each pixel; returns the sum of the correlations and their number.
fn compare(own: &Blurred, warped: &Warped, least_variance: f32, force: &mut [f32], hessian: &mut [f32]) -> (f64, u32) {
    let (width, height) = (own.width, own.height);
    let of = |f: &dyn Fn(usize) -> f32| {
        let mut values: Vec<f32> =
            (0..width * height).map(|at| if warped.counts[at] > 0.0 { f(at) } else { 0.0 }).collect();
        box_sum(&mut values, width, height, RADIUS);
        values
    };
    let (a, b) = (&own.values, &warped.grey);
    let counts = of(&|_| 1.0);
    let [sum_a, sum_b] = [of(&|at| a[at]), of(&|at| b[at])];
    let [aa, bb, ab] = [of(&|at| a[at] * a[at]), of(&|at| b[at] * b[at]), of(&|at| a[at] * b[at])];
    // Per window: factors of a and b in the derivative, what both have in common, and the second derivative.
    let mut terms = [(); 4].map(|()| vec![0.0; width * height]);
    let (mut correlation, mut windows) = (0.0, 0);
    for at in 0..width * height {
        let n = counts[at];
        if n < LEAST_PIXELS {
            continue;
        }
        let (ma, mb) = (sum_a[at] / n, sum_b[at] / n);
        let (va, vb) = (aa[at] / n - ma * ma, bb[at] / n - mb * mb);
        if va < least_variance || vb < least_variance {
            continue;
        }
        let both = (va * vb).sqrt();
        let ncc = (ab[at] / n - ma * mb) / both;
        correlation += f64::from(ncc);
        windows += 1;
        if ncc < LEAST_CORRELATION {
            continue;
        }
        // Little contrast may be shading or a reflection, which move with the camera.
        let weight = va.min(vb) / (va.min(vb) + CONTRAST);
        let (alpha, beta) = (weight / (n * both), weight * ncc / (n * vb));
        terms[0][at] = alpha;
        terms[1][at] = beta;
        terms[2][at] = beta * mb - alpha * ma;
        terms[3][at] = weight / (n * vb);
    }
    terms.iter_mut().for_each(|t| box_sum(t, width, height, RADIUS));
    for at in (0..width * height).filter(|at| warped.counts[*at] > 0.0) {
        let slope = warped.slope[at];
        force[at] += (a[at] * terms[0][at] - b[at] * terms[1][at] + terms[2][at]) * slope;
        hessian[at] += terms[3][at] * slope * slope;
    }
    (correlation, windows)
}
