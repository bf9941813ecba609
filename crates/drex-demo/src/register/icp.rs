//! Gauss-Newton steps of a similarity between points and a surface.

use drex_core::{Surface, SurfacePoint};
use nalgebra::{Matrix3, Point2, Point3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::initial_guesses::{Moments, across};
use super::{Placement, RegisterOptions};
use crate::median;

/// Points, surface, and what is the same for all starts.
pub(super) struct Problem<'a> {
    /// Shuffled: the first n are n points spread over all.
    pub(super) points: Vec<Point3<f64>>,
    /// Spread over the surface by area, in the object's frame.
    pub(super) samples: Vec<SurfacePoint>,
    pub(super) surface: &'a dyn Surface,
    pub(super) options: &'a RegisterOptions,
    pub(super) points_moments: Moments,
    pub(super) surface_moments: Moments,
}

/// A placement under way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub(super) scale: f64,
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) translation: Vector3<f64>,
    pub(super) cost: f64,
}

/// How well a placement fits.
pub(super) struct Report {
    pub(super) rms: f64,
    pub(super) inlier_share: f64,
    pub(super) covered_share: f64,
}

/// Weights vanish beyond this many robust standard deviations (Tukey's biweight at 95 % efficiency).
const TUKEY: f64 = 4.685;
/// Normal standard deviation per median of absolute values.
const MAD_TO_SIGMA: f64 = 1.4826;
/// Deviations below this part of the cloud's radius are rounding.
const LEAST_SIGMA: f64 = 2e-4;
/// Part of the sliding along the surface that is held back in the first steps, and number of these.
const STICKY: (f64, usize) = (0.3, 5);
/// Weight of the surface-to-points residuals. Points end a little before an edge does, by chance, so that these residuals draw the edge
/// inwards; they need only be strong enough to keep a surface from growing where nothing else does.
const BACKWARD_WEIGHT: f64 = 0.2;
/// Neighbours of a surface sample whose hull covers it.
const NEIGHBOURS: usize = 12;
/// Mean normal of the matched surface longer than this: only one side was seen. Half a sphere has 0.5, a whole object 0.
const ONE_SIDED: f64 = 0.3;
/// A surface this steep to the view (sine) is not counted on.
const GRAZING: f64 = 0.15;
/// Largest turn (rad), growth and shift (of the radius) in one step.
const LARGEST_STEP: (f64, f64, f64) = (0.4, 0.15, 0.5);
/// A step smaller than this (of the cloud's radius, rad) is the end.
const SMALL_STEP: f64 = 1e-4;
/// Residuals count fully up to this part of the cloud's radius when placements are compared.
const COMPARED_AT: f64 = 0.08;

impl Candidate {
    pub(super) fn placement(&self) -> Placement {
        Placement { scale: self.scale, rotation: self.rotation, translation: self.translation, cost: self.cost }
    }

    pub(super) fn point(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * p.coords * self.scale + self.translation)
    }

    fn inverse(&self, p: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation.inverse() * (p.coords - self.translation) / self.scale)
    }

    /// The object turned in its own frame about `center` first.
    pub(super) fn turned(&self, turn: &UnitQuaternion<f64>, center: &Point3<f64>) -> Self {
        let rotation = self.rotation * turn;
        let at = self.point(center).coords;
        Self { rotation, translation: at - rotation * center.coords * self.scale, ..*self }
    }
}

/// One scalar residual along `direction`: how far the placed object point `at` is from where it belongs.
struct Residual {
    at: Vector3<f64>,
    direction: Vector3<f64>,
    value: f64,
    /// Weight of the directions across.
    sticky: f64,
    weight: f64,
}

impl Problem<'_> {
    /// The placement at this rotation that puts middle on middle.
    pub(super) fn start(&self, rotation: UnitQuaternion<f64>) -> Candidate {
        let scale = self.options.scale.unwrap_or(self.points_moments.radius / self.surface_moments.radius);
        let translation = self.points_moments.mean.coords - rotation * self.surface_moments.mean.coords * scale;
        Candidate { scale, rotation, translation, cost: f64::INFINITY }
    }

    /// The placement of the frame before.
    pub(super) fn start_at(&self, placement: &Placement) -> Candidate {
        Candidate {
            scale: self.options.scale.unwrap_or(placement.scale),
            rotation: placement.rotation,
            translation: placement.translation,
            cost: f64::INFINITY,
        }
    }

    /// Improves `start` on the first `points` points and `samples` samples.
    pub(super) fn refine(&self, start: &Candidate, points: usize, samples: usize, iterations: usize) -> Candidate {
        let points = &self.points[..points.min(self.points.len())];
        let samples = &self.samples[..samples.min(self.samples.len())];
        let mut fit = *start;
        let mut seen = Vec::new();
        for i in 0..iterations {
            let (mut forward, normals) = self.forward(&fit, points);
            let sigma = self.sigma(&forward);
            let reach = TUKEY * sigma;
            if i % 4 == 0 || i < 4 {
                seen = self.seen(&fit, samples, &mean_normal(&forward, &normals, reach));
            }
            let mut backward = backward(&fit, points, &seen);
            // Places without points are hidden, by the hand perhaps; but not those right beside points.
            set_weights(&mut forward, reach);
            set_weights(&mut backward, reach.max(2.0 * spacing(&fit, &seen, points.len())));
            // What is covered pulls nowhere, and must not hold what is not covered back.
            backward.iter_mut().filter(|r| r.value == 0.0).for_each(|r| r.weight = 0.0);
            let sticky = if i < STICKY.1 { STICKY.0 } else { 0.0 };
            forward.iter_mut().for_each(|r| r.sticky = sticky);
            let Some(step) = self.step(&forward, &backward) else { break };
            self.take(&mut fit, &step);
            if step.norm() < SMALL_STEP {
                break;
            }
        }
        fit.cost = self.cost(&fit, points, samples);
        fit
    }

    /// Each point to the nearest place on the surface, and the normal there in the object's frame.
    fn forward(&self, fit: &Candidate, points: &[Point3<f64>]) -> (Vec<Residual>, Vec<Vector3<f64>>) {
        points
            .iter()
            .map(|p| {
                let near = self.surface.nearest(&fit.inverse(p));
                let away = p - fit.point(&near.point);
                let direction = away.try_normalize(1e-12 * self.points_moments.radius);
                let direction = direction.unwrap_or_else(|| fit.rotation * near.normal);
                let at = fit.rotation * near.point.coords * fit.scale;
                (Residual { at, direction, value: away.norm(), sticky: 0.0, weight: 1.0 }, near.normal)
            })
            .unzip()
    }

    fn sigma(&self, residuals: &[Residual]) -> f64 {
        let mut values: Vec<f64> = residuals.iter().map(|r| r.value).collect();
        (MAD_TO_SIGMA * median(&mut values).unwrap_or(0.0)).max(LEAST_SIGMA * self.points_moments.radius)
    }

    /// The samples that should have points: all of them, or those that face the viewer with nothing in between.
    fn seen(&self, fit: &Candidate, samples: &[SurfacePoint], normal: &Vector3<f64>) -> Vec<SurfacePoint> {
        let size = self.surface_moments.radius;
        let towards = |s: &SurfacePoint| match &self.options.viewpoint {
            Some(eye) => (fit.inverse(eye) - s.point).try_normalize(0.0),
            None => normal.try_normalize(ONE_SIDED),
        };
        let is_seen = |s: &&SurfacePoint| {
            let Some(view) = towards(s) else { return true };
            s.normal.dot(&view) > GRAZING
                && self.surface.ray_cast(&(s.point + s.normal * (1e-3 * size)), &view, 8.0 * size).is_none()
        };
        samples.iter().filter(is_seen).copied().collect()
    }

    /// Normal equations over (translation, turn, growth).
    fn step(&self, forward: &[Residual], backward: &[Residual]) -> Option<SVector<f64, 7>> {
        let mut a = SMatrix::<f64, 7, 7>::zeros();
        let mut b = SVector::<f64, 7>::zeros();
        // Lengths in units of the cloud's radius, so that turns and shifts weigh alike.
        let unit = self.points_moments.radius;
        for (residuals, share) in [(forward, 1.0), (backward, BACKWARD_WEIGHT)] {
            let total = residuals.len().max(1) as f64 / share;
            for r in residuals.iter().filter(|r| r.weight > 0.0) {
                let at = r.at / unit;
                let row = |d: &Vector3<f64>| {
                    let turn = at.cross(d);
                    SVector::<f64, 7>::from([d.x, d.y, d.z, turn.x, turn.y, turn.z, at.dot(d)])
                };
                let j = row(&r.direction);
                let w = r.weight / total;
                a += j * j.transpose() * w;
                b += j * (w * r.value / unit);
                if r.sticky > 0.0 {
                    let (e1, e2) = across(&r.direction);
                    for e in [e1, e2] {
                        let j = row(&e);
                        a += j * j.transpose() * (w * r.sticky);
                    }
                }
            }
        }
        if self.options.scale.is_some() {
            a.fixed_view_mut::<7, 1>(0, 6).fill(0.0);
            a.fixed_view_mut::<1, 7>(6, 0).fill(0.0);
            a[(6, 6)] = 1.0;
            b[6] = 0.0;
        }
        a += SMatrix::<f64, 7, 7>::identity() * (1e-6 * a.trace().max(1e-12));
        let step = a.cholesky()?.solve(&b);
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    fn take(&self, fit: &mut Candidate, step: &SVector<f64, 7>) {
        let shift: Vector3<f64> = step.fixed_rows::<3>(0).into_owned();
        let turn: Vector3<f64> = step.fixed_rows::<3>(3).into_owned();
        let (most_turn, most_growth, most_shift) = LARGEST_STEP;
        let k = [turn.norm() / most_turn, step[6].abs() / most_growth, shift.norm() / most_shift]
            .into_iter()
            .fold(1.0, f64::max);
        fit.rotation = UnitQuaternion::from_scaled_axis(turn / k) * fit.rotation;
        fit.scale *= (step[6] / k).exp();
        fit.translation += shift * (self.points_moments.radius / k);
    }

    /// Mean of both kinds of residuals, each squared, cut off and at most 1.
    fn cost(&self, fit: &Candidate, points: &[Point3<f64>], samples: &[SurfacePoint]) -> f64 {
        let (forward, normals) = self.forward(fit, points);
        let reach = TUKEY * self.sigma(&forward);
        let seen = self.seen(fit, samples, &mean_normal(&forward, &normals, reach));
        let at = COMPARED_AT * self.points_moments.radius;
        let mean =
            |r: &[Residual]| r.iter().map(|r| (r.value / at).powi(2).min(1.0)).sum::<f64>() / r.len().max(1) as f64;
        mean(&forward) + mean(&backward(fit, points, &seen))
    }

    /// How well the placement fits all points.
    pub(super) fn report(&self, fit: &Candidate) -> Report {
        let (forward, normals) = self.forward(fit, &self.points);
        let reach = TUKEY * self.sigma(&forward);
        let inliers: Vec<f64> = forward.iter().map(|r| r.value).filter(|v| *v < reach).collect();
        let seen = self.seen(fit, &self.samples, &mean_normal(&forward, &normals, reach));
        let limit = reach.max(2.0 * spacing(fit, &seen, self.points.len()));
        let backward = backward(fit, &self.points, &seen);
        let n = inliers.len().max(1) as f64;
        Report {
            rms: (inliers.iter().map(|v| v * v).sum::<f64>() / n).sqrt(),
            inlier_share: inliers.len() as f64 / forward.len().max(1) as f64,
            covered_share: backward.iter().filter(|r| r.value < limit).count() as f64 / backward.len().max(1) as f64,
        }
    }
}

fn set_weights(residuals: &mut [Residual], reach: f64) {
    for r in residuals {
        r.weight = (1.0 - (r.value / reach).powi(2)).max(0.0).powi(2);
    }
}

/// Mean normal of the surface next to the points that belong to it.
fn mean_normal(residuals: &[Residual], normals: &[Vector3<f64>], reach: f64) -> Vector3<f64> {
    let near = residuals.iter().zip(normals).filter(|(r, _)| r.value < reach);
    let (sum, n) = near.fold((Vector3::zeros(), 0), |(sum, n), (_, normal)| (sum + normal, n + 1));
    sum / f64::from(n.max(1))
}

/// Typical distance between points that cover the seen part of the surface, source units.
fn spacing(fit: &Candidate, seen: &[SurfacePoint], points: usize) -> f64 {
    // The samples are spread by area: their bounding box's surface stands for it.
    let first = seen.first().map_or_else(Point3::origin, |s| s.point);
    let (lo, hi) = seen.iter().fold((first, first), |(lo, hi), s| (lo.inf(&s.point), hi.sup(&s.point)));
    let d = hi - lo;
    let area = d.x * d.y + d.y * d.z + d.z * d.x;
    fit.scale * (area / points.max(1) as f64).sqrt()
}

/// Each sample, placed, to the hull of the points around it, seen along the surface's normal: zero where the points go all round it.
/// Points of the faces beside it reach up to their common edge, so that the edge is where the mesh has it.
fn backward(fit: &Candidate, points: &[Point3<f64>], samples: &[SurfacePoint]) -> Vec<Residual> {
    let rotation: Matrix3<f64> = *fit.rotation.to_rotation_matrix().matrix();
    samples
        .iter()
        .map(|s| {
            let at = rotation * s.point.coords * fit.scale;
            let placed = Point3::from(at + fit.translation);
            let (e1, e2) = across(&(rotation * s.normal));
            let around = nearest(points, &placed);
            let flat: Vec<Point2<f64>> = around
                .iter()
                .map(|&(_, i)| {
                    let d = points[i] - placed;
                    Point2::new(d.dot(&e1), d.dot(&e2))
                })
                .collect();
            let away = to_hull(&flat);
            let value = away.norm();
            let direction = if value > 0.0 { (e1 * away.x + e2 * away.y) / value } else { e1 };
            Residual { at, direction, value, sticky: 0.0, weight: 1.0 }
        })
        .collect()
}

/// The nearest points, squared distance and index, nearest first.
fn nearest(points: &[Point3<f64>], to: &Point3<f64>) -> Vec<(f64, usize)> {
    let mut found: Vec<(f64, usize)> = Vec::with_capacity(NEIGHBOURS + 1);
    let mut worst = f64::INFINITY;
    for (i, p) in points.iter().enumerate() {
        let d = (p - to).norm_squared();
        if d < worst {
            let place = found.partition_point(|(e, _)| *e <= d);
            found.insert(place, (d, i));
            found.truncate(NEIGHBOURS);
            if found.len() == NEIGHBOURS {
                worst = found[NEIGHBOURS - 1].0;
            }
        }
    }
    found
}

/// From the origin to the convex hull of the points: zero inside. Every line between two points lies in the hull, and the hull's edges
/// are among them.
fn to_hull(points: &[Point2<f64>]) -> Vector2<f64> {
    let mut angles: Vec<f64> = points.iter().map(|p| p.y.atan2(p.x)).collect();
    angles.sort_by(f64::total_cmp);
    let round = angles.last().zip(angles.first()).map_or(0.0, |(l, f)| f + std::f64::consts::TAU - l);
    let widest = angles.windows(2).map(|w| w[1] - w[0]).fold(round, f64::max);
    if widest < std::f64::consts::PI {
        return Vector2::zeros();
    }
    let mut best = points.first().map_or_else(Vector2::zeros, |p| p.coords);
    for (i, a) in points.iter().enumerate() {
        for b in &points[i + 1..] {
            let along = b - a;
            let t = (-a.coords.dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            let on = a.coords + along * t;
            if on.norm_squared() < best.norm_squared() {
                best = on;
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hull_of_points_around_the_origin_holds_it() {
        let p = |x, y| Point2::new(x, y);
        assert_eq!(to_hull(&[p(1.0, 0.0), p(-1.0, 1.0), p(-1.0, -1.0)]), Vector2::zeros());
        assert!((to_hull(&[p(1.0, -1.0), p(1.0, 1.0), p(3.0, 0.0)]) - Vector2::new(1.0, 0.0)).norm() < 1e-12);
        assert!((to_hull(&[p(2.0, 1.0)]) - Vector2::new(2.0, 1.0)).norm() < 1e-12);
        assert!(to_hull(&[p(-1.0, 0.0), p(1.0, 0.0)]).norm() < 1e-12);
    }
}
