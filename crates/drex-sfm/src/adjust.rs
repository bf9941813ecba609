//! The last bundle adjustment: poses, points and lenses together, with the covariance of the poses.
//!
//! Residual r = π(R X + t) - x of every observation, divided by the standard deviation of its kind (aligned to sub-pixels, or as
//! the detector placed it), with a Cauchy loss by iterated weights. Levenberg-Marquardt on the reduced system: points are eliminated
//! (S = B - E C⁻¹ Eᵀ, Triggs et al. 2000), poses and lenses solved by a dense Cholesky factorisation. openmvg's own adjuster, which
//! brings the model here, keeps the principal point and the tangential terms; object captures gain most by just these.
//!
//! Sums run over fixed parts of the points in a fixed order: results do not depend on the number of threads.

use drex_core::stats::upper_median;
use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix3, Matrix3x6, Point3, SMatrix, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;

use crate::model::{LENS_NUMBERS, Lens, Model, Observation, Point, View};

/// Which of a lens's numbers are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum LensFreedom {
    /// A calibration that was given.
    Fixed,
    /// Focal length and one radial coefficient.
    Simple,
    /// Focal length, principal point, two radial and two tangential coefficients.
    Full,
}

impl LensFreedom {
    /// f, cx, cy, k1, k2, p1, p2.
    fn mask(self) -> [bool; LENS_NUMBERS] {
        match self {
            Self::Fixed => [false; LENS_NUMBERS],
            Self::Simple => [true, false, false, true, false, false, false],
            Self::Full => [true; LENS_NUMBERS],
        }
    }
}

/// An observation is left out when it is farther off than so many standard deviations of its kind.
const OUTLIER_SIGMAS: f64 = 5.0;
/// The Cauchy loss halves the weight of what is this many standard deviations off.
const CAUCHY_SIGMAS: f64 = 2.4;
/// No kind of observation is trusted more than this, pixels.
const LEAST_SIGMA_PX: f64 = 0.03;
/// Rays of a point differ by this at least, radians.
const LEAST_ANGLE: f64 = 0.026;
/// Parts over which sums are made side by side.
const PARTS: usize = 8;
/// The principal point is expected in the middle, within this share of the width.
const PRINCIPAL_POINT_SIGMA: f64 = 0.01;
/// What second radial and tangential coefficients are expected to be within; a lens whose photos say nothing of them keeps them small.
const K2_SIGMA: f64 = 0.3;
const TANGENTIAL_SIGMA: f64 = 0.005;

/// Standard deviations of one axis, pixels: as the detector placed it, aligned.
type Sigmas = [f64; 2];

/// How an adjustment ended.
#[derive(Debug, Clone)]
pub(crate) struct Adjusted {
    /// Of the detector's and of the aligned observations, pixels.
    pub(crate) sigmas_px: Sigmas,
}

impl Adjusted {
    /// The share by which this adjustment's observations lie nearer than another's.
    pub(crate) fn gain_over(&self, other: &Self) -> f64 {
        1.0 - self.sigmas_px[1] / other.sigmas_px[1]
    }
}

/// Adjusts the model in place.
pub(crate) fn adjust(model: &mut Model, freedom: LensFreedom, iterations: usize) -> Result<Adjusted, String> {
    let mut sigmas_px = sigmas(model);
    let layout = Layout::new(model, freedom);
    let mut cost = robust_cost(model, &layout, sigmas_px);
    if !cost.is_finite() {
        return Err("the model has observations that its cameras cannot see".into());
    }
    let mut damping = 1e-4;
    for iteration in 0..iterations {
        if iteration == iterations / 3 {
            sigmas_px = sigmas(model);
            cost = robust_cost(model, &layout, sigmas_px);
        }
        let system = System::new(model, &layout, sigmas_px);
        let mut gained = 0.0;
        let mut accepted = false;
        for _ in 0..8 {
            let Some(step) = system.solve(model, &layout, damping) else {
                damping *= 10.0;
                continue;
            };
            let mut moved = model.clone();
            step.apply(&mut moved, &layout);
            let next = robust_cost(&moved, &layout, sigmas_px);
            if next < cost {
                gained = (cost - next) / cost;
                (*model, cost, accepted) = (moved, next, true);
                damping = (damping * 0.2).max(1e-10);
                break;
            }
            damping *= 10.0;
        }
        if !accepted || gained < 1e-7 && iteration > iterations / 3 {
            break;
        }
    }
    Ok(Adjusted { sigmas_px: sigmas(model) })
}

/// Robust standard deviation of one axis of each kind of observation, pixels.
fn sigmas(model: &Model) -> Sigmas {
    [false, true].map(|aligned| {
        let of_kind = |p: &'_ Point| -> Vec<f64> {
            let kind = p.observations.iter().filter(|o| o.aligned == aligned);
            kind.map(|o| model.project(o.view, &p.position).map_or(f64::INFINITY, |q| (q - o.pixel).norm())).collect()
        };
        let median = upper_median(model.points.iter().flat_map(of_kind));
        // The median of a Rayleigh distribution is 1.1774 of its parameter.
        median.map_or(1.0, |m| m / 1.1774).max(LEAST_SIGMA_PX)
    })
}

/// Where each unknown stands: six of each view, then the free numbers of each lens.
struct Layout {
    free: Vec<usize>,
    views: usize,
    size: usize,
    /// Expected value and standard deviation of the lens numbers that have one, by lens.
    priors: Vec<[Option<(f64, f64)>; LENS_NUMBERS]>,
}

impl Layout {
    fn new(model: &Model, freedom: LensFreedom) -> Self {
        let free: Vec<usize> = (0..LENS_NUMBERS).filter(|&k| freedom.mask()[k]).collect();
        let views = model.views.len();
        let prior = |lens: &Lens| {
            let (w, h) = (f64::from(lens.width), f64::from(lens.height));
            let middle = PRINCIPAL_POINT_SIGMA * w;
            let (cx, cy) = (0.5 * w - 0.5, 0.5 * h - 0.5);
            let tangential = Some((0.0, TANGENTIAL_SIGMA));
            [None, Some((cx, middle)), Some((cy, middle)), None, Some((0.0, K2_SIGMA)), tangential, tangential]
        };
        let size = 6 * views + free.len() * model.lenses.len();
        Self { views, size, priors: model.lenses.iter().map(prior).collect(), free }
    }

    fn lens(&self, lens: usize) -> usize {
        6 * self.views + lens * self.free.len()
    }
}

/// Priors and observations, each by ρ(e) = s²/2 ln(1 + e²/s²) of its error in standard deviations.
fn robust_cost(model: &Model, layout: &Layout, sigmas: Sigmas) -> f64 {
    let s2 = CAUCHY_SIGMAS * CAUCHY_SIGMAS;
    let of_point = |p: &Point| -> f64 {
        let one = |o: &Observation| match model.project(o.view, &p.position) {
            Some(q) => 0.5 * s2 * ((q - o.pixel).norm_squared() / sigmas[usize::from(o.aligned)].powi(2) / s2).ln_1p(),
            None => f64::INFINITY,
        };
        p.observations.iter().map(one).sum()
    };
    let part = |points: &[Point]| -> f64 { points.iter().map(of_point).sum() };
    let parts: Vec<f64> = model.points.par_chunks(part_size(model)).map(part).collect();
    let of_lens = |(lens, priors): (&Lens, &[Option<(f64, f64)>; LENS_NUMBERS])| -> f64 {
        let off = |&k: &usize| priors[k].map_or(0.0, |(mean, sd)| 0.5 * ((lens.numbers[k] - mean) / sd).powi(2));
        layout.free.iter().map(off).sum()
    };
    parts.iter().sum::<f64>() + model.lenses.iter().zip(&layout.priors).map(of_lens).sum::<f64>()
}

fn part_size(model: &Model) -> usize {
    model.points.len().div_ceil(PARTS).max(1)
}

/// Reduced matrix and gradient, and the inverses of the points' blocks.
type Reduced = (DMatrix<f64>, DVector<f64>, Vec<Matrix3<f64>>);
type LensJacobian = SMatrix<f64, 2, LENS_NUMBERS>;
type LensPoint = SMatrix<f64, LENS_NUMBERS, 3>;

/// Normal equations with what is needed to get the points back.
struct System {
    /// Poses and lenses alone.
    cameras: DMatrix<f64>,
    gradient: DVector<f64>,
    points: Vec<PointBlock>,
}

struct PointBlock {
    own: Matrix3<f64>,
    gradient: Vector3<f64>,
    /// Pose and lens of each observation against the point.
    views: Vec<(usize, SMatrix<f64, 6, 3>)>,
    lenses: Vec<(usize, LensPoint)>,
}

impl System {
    fn new(model: &Model, layout: &Layout, sigmas: Sigmas) -> Self {
        let part = |points: &[Point]| {
            let mut cameras = DMatrix::zeros(layout.size, layout.size);
            let mut gradient = DVector::zeros(layout.size);
            let blocks: Vec<PointBlock> =
                points.iter().map(|p| block(model, layout, sigmas, p, &mut cameras, &mut gradient)).collect();
            (cameras, gradient, blocks)
        };
        let parts: Vec<_> = model.points.par_chunks(part_size(model)).map(part).collect();
        let mut cameras = DMatrix::zeros(layout.size, layout.size);
        let mut gradient = DVector::zeros(layout.size);
        let mut points = Vec::with_capacity(model.points.len());
        for (own, slope, blocks) in parts {
            cameras += own;
            gradient += slope;
            points.extend(blocks);
        }
        for (k, (lens, priors)) in model.lenses.iter().zip(&layout.priors).enumerate() {
            for (at, &number) in layout.free.iter().enumerate() {
                if let Some((mean, sd)) = priors[number] {
                    let i = layout.lens(k) + at;
                    cameras[(i, i)] += 1.0 / (sd * sd);
                    gradient[i] += (lens.numbers[number] - mean) / (sd * sd);
                }
            }
        }
        Self { cameras, gradient, points }
    }

    /// The reduced system of poses and lenses, with the inverses of the points' blocks.
    fn reduced(&self, layout: &Layout, damping: f64) -> Option<Reduced> {
        let reduce = |blocks: &[PointBlock]| {
            let mut s = DMatrix::zeros(layout.size, layout.size);
            let mut g = DVector::zeros(layout.size);
            let mut inverses = Vec::with_capacity(blocks.len());
            for block in blocks {
                let mut own = block.own;
                for k in 0..3 {
                    own[(k, k)] *= 1.0 + damping;
                }
                let inverse = own.cholesky()?.inverse();
                eliminate(block, &inverse, layout, &mut s, &mut g);
                inverses.push(inverse);
            }
            Some((s, g, inverses))
        };
        let size = self.points.len().div_ceil(PARTS).max(1);
        let parts: Vec<_> = self.points.par_chunks(size).map(reduce).collect();
        let mut s = self.cameras.clone();
        for k in 0..layout.size {
            s[(k, k)] *= 1.0 + damping;
        }
        let mut g = self.gradient.clone();
        let mut inverses = Vec::with_capacity(self.points.len());
        for part in parts {
            let (own, slope, own_inverses) = part?;
            s -= own;
            g -= slope;
            inverses.extend(own_inverses);
        }
        s.fill_upper_triangle_with_lower_triangle();
        Some((s, g, inverses))
    }

    fn solve(&self, model: &Model, layout: &Layout, damping: f64) -> Option<Step> {
        let (s, g, inverses) = self.reduced(layout, damping)?;
        let cameras = -s.cholesky()?.solve(&g);
        if !cameras.iter().all(|v| v.is_finite()) {
            return None;
        }
        let back = |(block, inverse): (&PointBlock, &Matrix3<f64>)| {
            let mut right = block.gradient;
            for (view, w) in &block.views {
                right += w.transpose() * cameras.fixed_rows::<6>(6 * view);
            }
            for (lens, w) in &block.lenses {
                for (at, &number) in layout.free.iter().enumerate() {
                    right += w.row(number).transpose() * cameras[layout.lens(*lens) + at];
                }
            }
            -(inverse * right)
        };
        let points = self.points.iter().zip(&inverses).map(back).collect();
        debug_assert_eq!(model.points.len(), self.points.len());
        Some(Step { cameras, points })
    }
}

/// Adds what a point and its observations say to the poses and lenses; returns its own part.
fn block(
    model: &Model,
    layout: &Layout,
    sigmas: Sigmas,
    point: &Point,
    cameras: &mut DMatrix<f64>,
    gradient: &mut DVector<f64>,
) -> PointBlock {
    let mut out =
        PointBlock { own: Matrix3::zeros(), gradient: Vector3::zeros(), views: Vec::new(), lenses: Vec::new() };
    for o in &point.observations {
        let view = &model.views[o.view];
        let Some(d) = derivatives(view, &model.lenses[view.lens], &point.position) else { continue };
        let sigma2 = sigmas[usize::from(o.aligned)].powi(2);
        let error = d.pixel - o.pixel.coords;
        let weight = 1.0 / sigma2 / (1.0 + error.norm_squared() / sigma2 / CAUCHY_SIGMAS.powi(2));
        let at = 6 * o.view;
        let mut pose = cameras.fixed_view_mut::<6, 6>(at, at);
        pose += weight * d.by_pose.transpose() * d.by_pose;
        let mut slope = gradient.fixed_rows_mut::<6>(at);
        slope += weight * d.by_pose.transpose() * error;
        let first = layout.lens(view.lens);
        for (i, &a) in layout.free.iter().enumerate() {
            let by_a = d.by_lens.column(a);
            gradient[first + i] += weight * by_a.dot(&error);
            for (j, &b) in layout.free.iter().enumerate() {
                cameras[(first + i, first + j)] += weight * by_a.dot(&d.by_lens.column(b));
            }
            for k in 0..6 {
                let mixed = weight * by_a.dot(&d.by_pose.column(k));
                cameras[(first + i, at + k)] += mixed;
                cameras[(at + k, first + i)] += mixed;
            }
        }
        out.own += weight * d.by_point.transpose() * d.by_point;
        out.gradient += weight * d.by_point.transpose() * error;
        out.views.push((o.view, weight * d.by_pose.transpose() * d.by_point));
        let mixed = weight * d.by_lens.transpose() * d.by_point;
        match out.lenses.iter_mut().find(|(lens, _)| *lens == view.lens) {
            Some((_, sum)) => *sum += mixed,
            None => out.lenses.push((view.lens, mixed)),
        }
    }
    out
}

/// Adds the lower triangle of E C⁻¹ Eᵀ, and E C⁻¹ g, of one point.
fn eliminate(block: &PointBlock, inverse: &Matrix3<f64>, layout: &Layout, s: &mut DMatrix<f64>, g: &mut DVector<f64>) {
    let solved = inverse * block.gradient;
    let free = &layout.free;
    for (view, w) in &block.views {
        let wi = w * inverse;
        let mut slope = g.fixed_rows_mut::<6>(6 * view);
        slope += w * solved;
        for (other, v) in block.views.iter().filter(|(other, _)| other <= view) {
            let mut at = s.fixed_view_mut::<6, 6>(6 * view, 6 * other);
            // Most of the time goes here; written out, it is computed four numbers at a time.
            for c in 0..6 {
                for r in 0..6 {
                    at[(r, c)] += wi[(r, 0)] * v[(c, 0)] + wi[(r, 1)] * v[(c, 1)] + wi[(r, 2)] * v[(c, 2)];
                }
            }
        }
        for (lens, v) in &block.lenses {
            let mixed = wi * v.transpose();
            for (j, &number) in free.iter().enumerate() {
                for k in 0..6 {
                    s[(layout.lens(*lens) + j, 6 * view + k)] += mixed[(k, number)];
                }
            }
        }
    }
    for (lens, w) in &block.lenses {
        let slope = w * solved;
        for (i, &a) in free.iter().enumerate() {
            g[layout.lens(*lens) + i] += slope[a];
        }
        for (other, v) in &block.lenses {
            let mixed = w * inverse * v.transpose();
            for (i, &a) in free.iter().enumerate() {
                for (j, &b) in free.iter().enumerate() {
                    s[(layout.lens(*lens) + i, layout.lens(*other) + j)] += mixed[(a, b)];
                }
            }
        }
    }
}

/// Changes of poses, lenses and points.
struct Step {
    cameras: DVector<f64>,
    points: Vec<Vector3<f64>>,
}

impl Step {
    fn apply(&self, model: &mut Model, layout: &Layout) {
        for (k, view) in model.views.iter_mut().enumerate() {
            let d = self.cameras.fixed_rows::<6>(6 * k);
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(d[0], d[1], d[2]));
            let pose = &mut view.camera_from_world;
            pose.rotation = turn * pose.rotation;
            pose.translation.vector = turn * pose.translation.vector + Vector3::new(d[3], d[4], d[5]);
        }
        for (k, lens) in model.lenses.iter_mut().enumerate() {
            for (at, &number) in layout.free.iter().enumerate() {
                lens.numbers[number] += self.cameras[layout.lens(k) + at];
            }
        }
        for (point, d) in model.points.iter_mut().zip(&self.points) {
            point.position += d;
        }
    }
}

/// A pixel with its derivatives by the pose (turn, then shift, of the camera's frame), the lens and the point.
struct Derivatives {
    pixel: Vector2<f64>,
    by_pose: SMatrix<f64, 2, 6>,
    by_lens: LensJacobian,
    by_point: Matrix2x3<f64>,
}

fn derivatives(view: &View, lens: &Lens, position: &Point3<f64>) -> Option<Derivatives> {
    let p = view.camera_from_world * position;
    let (pixel, by_camera_point, by_lens) = lens.project_with_jacobians(&p)?;
    let mut point_by_pose = Matrix3x6::zeros();
    point_by_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&-p.coords.cross_matrix());
    point_by_pose.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
    let rotation = view.camera_from_world.rotation.to_rotation_matrix();
    Some(Derivatives {
        pixel,
        by_pose: by_camera_point * point_by_pose,
        by_lens,
        by_point: by_camera_point * rotation.matrix(),
    })
}

/// Leaves out observations that are far off, and points that are then seen by fewer than two photos or from one direction;
/// returns how many observations went.
pub(crate) fn drop_outliers(model: &mut Model) -> usize {
    let within = sigmas(model).map(|s| OUTLIER_SIGMAS * s);
    let (views, lenses) = (&model.views, &model.lenses);
    let before = model.points.iter().map(|p| p.observations.len()).sum::<usize>();
    model.points.retain_mut(|point| {
        let position = point.position;
        point.observations.retain(|o| {
            let view = &views[o.view];
            let seen = lenses[view.lens].project(&(view.camera_from_world * position));
            seen.is_some_and(|q| (q - o.pixel).norm() <= within[usize::from(o.aligned)])
        });
        let ray = |o: &Observation| (position - views[o.view].centre()).normalize();
        let rays: Vec<_> = point.observations.iter().map(ray).collect();
        rays.len() >= 2 && rays.iter().any(|a| rays.iter().any(|b| a.cross(b).norm() > LEAST_ANGLE))
    });
    before - model.points.iter().map(|p| p.observations.len()).sum::<usize>()
}

/// Standard deviations of a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PoseSigma {
    /// Of the rotation, root mean square over its axes, radians.
    pub(crate) rotation_rad: f64,
    /// Of the place, root mean square over its axes, units of the scene.
    pub(crate) centre: f64,
}

/// What is added to the diagonal, as a share of it, so that a point that its rays hardly place does not spoil the deviations of the others.
const TINY: f64 = 1e-8;

/// Standard deviation of each pose, from the inverse of the reduced system at the solution (points and lenses integrated out), with the
/// frame and scale fixed by the poses as a whole (a free network: the seven directions that no observation sees are left out).
pub(crate) fn pose_sigmas(model: &Model, freedom: LensFreedom) -> Option<Vec<PoseSigma>> {
    let layout = Layout::new(model, freedom);
    let (s, ..) = System::new(model, &layout, sigmas(model)).reduced(&layout, TINY)?;
    let gauge = gauge_directions(model, &layout);
    let weight = s.diagonal().mean().max(f64::MIN_POSITIVE);
    let fixed = s + weight * &gauge * gauge.transpose();
    // Scaled to a diagonal of ones, since turns and shifts have other units; a direction that rounding hides is given what it takes.
    let scales = fixed.diagonal().map(|v| 1.0 / v.max(f64::MIN_POSITIVE).sqrt());
    let scaled = DMatrix::from_fn(layout.size, layout.size, |i, j| scales[i] * fixed[(i, j)] * scales[j]);
    let factor = [0.0, 1e-12, 1e-10, 1e-8, 1e-6]
        .into_iter()
        .find_map(|ridge| (&scaled + ridge * DMatrix::<f64>::identity(layout.size, layout.size)).cholesky())?;
    let inverse = factor.inverse();
    let inverse = DMatrix::from_fn(layout.size, layout.size, |i, j| scales[i] * inverse[(i, j)] * scales[j]);
    let project = |m: DMatrix<f64>| {
        // (1 - G Gᵀ) C (1 - G Gᵀ)
        let left = &m - &gauge * (gauge.transpose() * &m);
        &left - (&left * &gauge) * gauge.transpose()
    };
    let covariance = project(inverse);
    // The shift in the camera's frame is that of its centre, turned: c = -Rᵀ t and t' = exp(w) t + dt give dc = -Rᵀ dt.
    let of_view = |k: usize| {
        let c = covariance.fixed_view::<6, 6>(6 * k, 6 * k);
        let sd = |at: usize| (c.fixed_view::<3, 3>(at, at).trace() / 3.0).max(0.0).sqrt();
        PoseSigma { rotation_rad: sd(0), centre: sd(3) }
    };
    Some((0..model.views.len()).map(of_view).collect())
}

/// Orthonormal directions of shift, turn and scale of the whole scene, in the unknowns.
fn gauge_directions(model: &Model, layout: &Layout) -> DMatrix<f64> {
    let mut g = DMatrix::zeros(layout.size, 7);
    for (k, view) in model.views.iter().enumerate() {
        let r = view.camera_from_world.rotation.to_rotation_matrix();
        let t = view.camera_from_world.translation.vector;
        for axis in 0..3 {
            let e = Vector3::ith(axis, 1.0);
            // X -> X + a e: dt = -R a e.
            g.fixed_view_mut::<3, 1>(6 * k + 3, axis).copy_from(&-(r * e));
            // X -> exp(a e) X: R turns by w = -R a e, and t = exp(w) t + dt stays.
            let turn = -(r * e);
            g.fixed_view_mut::<3, 1>(6 * k, 3 + axis).copy_from(&turn);
            g.fixed_view_mut::<3, 1>(6 * k + 3, 3 + axis).copy_from(&-turn.cross(&t));
        }
        // X -> (1 + a) X: dt = a t.
        g.fixed_view_mut::<3, 1>(6 * k + 3, 6).copy_from(&t);
    }
    g.qr().q()
}
