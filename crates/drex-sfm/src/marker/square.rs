//! A rigid square in the scene, fitted to its corners in the photos.

use nalgebra::{Isometry3, Matrix3, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3};

use drex_core::stats::median;

use super::Sighting;

/// Steps of Levenberg and Marquardt at most.
const MAX_STEPS: usize = 100;

/// Huber's constant for the length of a residual in two coordinates, in standard deviations of one.
const HUBER: f64 = 2.0;

/// Median of that length for normal errors of standard deviation one.
const MEDIAN_LENGTH: f64 = 1.177_41;

/// Residuals are not taken for smaller than this, pixels: exact data keeps weights of one.
const LEAST_SPREAD_PX: f64 = 1e-6;

/// Centre, directions and edge of a square in the scene.
#[derive(Clone, Copy)]
pub(super) struct Square {
    /// Tag axes: x to the right of the upright tag, y to its top, z towards who sees it; origin at the centre.
    pub(super) scene_from_tag: Isometry3<f64>,
    /// Length of an edge, scene units.
    pub(super) edge: f64,
}

/// Corners in order, in halves of the edge, tag axes.
const CORNERS: [(f64, f64); 4] = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];

/// Unknowns: movement of the centre in edges (3), rotation about scene axes (3), logarithm of the edge.
const UNKNOWNS: usize = 7;
type Unknowns = SVector<f64, UNKNOWNS>;

/// A fitted square.
pub(super) struct Fitted {
    pub(super) square: Square,
    /// Root of the mean squared reprojection error of a corner, pixels.
    pub(super) rms_px: f64,
    /// Standard error of the edge over the edge; infinite if the photos do not determine it.
    pub(super) edge_sigma: f64,
}

impl Square {
    /// The square nearest to four points. `None` if they are not spread over two directions.
    pub(super) fn through(points: &[Point3<f64>; 4]) -> Option<Self> {
        let [tl, tr, br, bl] = points.map(|p| p.coords);
        let x = (tr + br - tl - bl).try_normalize(0.0)?;
        let y = tl + tr - bl - br;
        let y = (y - x * x.dot(&y)).try_normalize(1e-6 * y.norm())?;
        let rotation = Matrix3::from_columns(&[x, y, x.cross(&y)]);
        let edge = 0.25 * ((tr - tl).norm() + (br - tr).norm() + (bl - br).norm() + (tl - bl).norm());
        let centre = Translation3::from(0.25 * (tl + tr + br + bl));
        let rotation = UnitQuaternion::from_matrix(&rotation);
        let finite = edge > 0.0 && edge.is_finite() && centre.vector.iter().all(|v| v.is_finite());
        finite.then_some(Self { scene_from_tag: Isometry3::from_parts(centre, rotation), edge })
    }

    /// Corners in the scene.
    pub(super) fn corners(&self) -> [Point3<f64>; 4] {
        CORNERS.map(|(x, y)| self.scene_from_tag * Point3::new(0.5 * x * self.edge, 0.5 * y * self.edge, 0.0))
    }

    fn moved(&self, step: &Unknowns) -> Self {
        let by: Vector3<f64> = step.fixed_rows::<3>(0) * self.edge;
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
        let pose = &self.scene_from_tag;
        let translation = Translation3::from(pose.translation.vector + by);
        Self {
            scene_from_tag: Isometry3::from_parts(translation, turn * pose.rotation),
            edge: self.edge * step[6].exp(),
        }
    }

    /// Error of each corner in each photo, photo by photo, and its derivative. `None` if one has no image.
    fn errors(&self, seen: &[&Sighting]) -> Option<Vec<(Vector2<f64>, SMatrix<f64, 2, UNKNOWNS>)>> {
        let centre = self.scene_from_tag.translation.vector;
        let corners = self.corners();
        let mut errors = Vec::with_capacity(4 * seen.len());
        for sighting in seen {
            for (corner, pixel) in corners.iter().zip(sighting.corners) {
                let in_camera = sighting.camera_from_world * corner;
                let (at, by_camera) = sighting.camera.project_with_jacobian(&in_camera)?;
                let by_scene = by_camera * sighting.camera_from_world.rotation.to_rotation_matrix().matrix();
                let arm = corner.coords - centre;
                let mut j = SMatrix::<f64, 2, UNKNOWNS>::zeros();
                j.fixed_columns_mut::<3>(0).copy_from(&(by_scene * self.edge));
                j.fixed_columns_mut::<3>(3).copy_from(&(-by_scene * arm.cross_matrix()));
                j.set_column(6, &(by_scene * arm));
                errors.push((Vector2::from(pixel) - at.coords, j));
            }
        }
        Some(errors)
    }

    /// Least squares of reprojection errors with Huber's weights.
    pub(super) fn fitted(mut self, seen: &[&Sighting]) -> Option<Fitted> {
        let mut errors = self.errors(seen)?;
        let mut damping = 1e-6;
        for _ in 0..MAX_STEPS {
            let spread = spread_px(&errors)?;
            let cost = |errors: &[(Vector2<f64>, SMatrix<f64, 2, UNKNOWNS>)]| -> f64 {
                errors.iter().map(|(e, _)| huber(e.norm() / spread)).sum()
            };
            let (mut a, mut b) = (SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros(), Unknowns::zeros());
            for (e, j) in &errors {
                let w = weight(e, spread);
                a += j.transpose() * j * w;
                b += j.transpose() * e * w;
            }
            let before = cost(&errors);
            let mut size = 0.0;
            // Damping grows until a step helps; at the minimum none does, and that ends the search.
            while damping < 1e12 {
                let damped = a + SMatrix::from_diagonal(&(a.diagonal() * damping));
                let Some(step) = damped.cholesky().map(|c| c.solve(&b)) else { break };
                let next = self.moved(&step);
                if let Some(next_errors) = next.errors(seen).filter(|n| cost(n) <= before) {
                    (self, errors, size) = (next, next_errors, step.norm());
                    damping = (damping * 0.1).max(1e-15);
                    break;
                }
                damping *= 10.0;
            }
            if !(size > 1e-13) {
                break;
            }
        }
        let rms_px = (errors.iter().map(|(e, _)| e.norm_squared()).sum::<f64>() / errors.len() as f64).sqrt();
        Some(Fitted { square: self, rms_px, edge_sigma: edge_sigma(&errors) })
    }
}

/// Standard deviation of one coordinate, from the median length. `None` of nothing.
fn spread_px(errors: &[(Vector2<f64>, SMatrix<f64, 2, UNKNOWNS>)]) -> Option<f64> {
    Some((median(errors.iter().map(|(e, _)| e.norm()))? / MEDIAN_LENGTH).max(LEAST_SPREAD_PX))
}

fn weight(error: &Vector2<f64>, spread: f64) -> f64 {
    (HUBER * spread / error.norm().max(1e-300)).min(1.0)
}

fn huber(length: f64) -> f64 {
    if length <= HUBER { 0.5 * length * length } else { HUBER * (length - 0.5 * HUBER) }
}

/// Standard error of the logarithm of the edge: the larger of the one from the size of the residuals, as if each coordinate
/// had its own error, and the one from the sums over each photo (sandwich, clustered by photo), which sees errors that the
/// corners of a photo share, as wrong poses make them.
fn edge_sigma(errors: &[(Vector2<f64>, SMatrix<f64, 2, UNKNOWNS>)]) -> f64 {
    let Some(spread) = spread_px(errors) else { return f64::INFINITY };
    let (photos, numbers) = (errors.len() as f64 / 4.0, 2.0 * errors.len() as f64);
    let (mut a, mut between, mut squares) = (SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros(), SMatrix::zeros(), 0.0);
    for photo in errors.chunks(4) {
        let mut sum = Unknowns::zeros();
        for (e, j) in photo {
            let w = weight(e, spread);
            a += j.transpose() * j * w;
            sum += j.transpose() * e * w;
            squares += w * e.norm_squared();
        }
        between += sum * sum.transpose();
    }
    let Some(inverse) = a.cholesky().map(|c| c.inverse()) else { return f64::INFINITY };
    let plain = inverse[(6, 6)] * squares / (numbers - UNKNOWNS as f64);
    let clustered = (inverse * between * inverse)[(6, 6)] * photos / (photos - 1.0);
    let sigma = plain.max(clustered).sqrt();
    if sigma.is_finite() { sigma } else { f64::INFINITY }
}
