//! Points on a surface, moments, and orientations to start from.

use drex_core::{Surface, SurfacePoint};
use nalgebra::{Matrix3, Point3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Mean, principal axes and root mean square radius of points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moments {
    pub(super) mean: Point3<f64>,
    /// Columns: principal axes, longest first, right-handed.
    pub(super) axes: Matrix3<f64>,
    pub(super) radius: f64,
}

impl Moments {
    pub(super) fn of(points: &[Point3<f64>]) -> Self {
        let n = points.len().max(1) as f64;
        let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n;
        let covariance =
            points.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum::<Matrix3<f64>>() / n;
        let eigen = covariance.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let [x, y] = [order[0], order[1]].map(|i| eigen.eigenvectors.column(i).into_owned());
        let axes = Matrix3::from_columns(&[x, y, x.cross(&y)]);
        Self { mean: mean.into(), axes, radius: covariance.trace().max(0.0).sqrt() }
    }
}

/// At most `n` of the points in an order in which every beginning is spread over all of them.
pub(super) fn shuffled(mut points: Vec<Point3<f64>>, n: usize) -> Vec<Point3<f64>> {
    points.shuffle(&mut ChaCha8Rng::seed_from_u64(0));
    points.truncate(n);
    points
}

/// Steps of a four-dimensional low-discrepancy sequence (Roberts' R4: powers of 1/1.1673039782614187).
const STEPS: [f64; 4] =
    [0.856_674_883_854_502_8, 0.733_891_856_627_126, 0.628_706_721_037_609_6, 0.538_597_257_223_612_2];

fn quasi_random(i: usize) -> [f64; 4] {
    STEPS.map(|s| (0.5 + s * (i + 1) as f64).fract())
}

/// About `n` points spread over the surface evenly by area: lines spread evenly over all lines through the bounding sphere cross
/// every piece of surface in proportion to its area (Cauchy and Crofton).
pub(super) fn surface_samples(surface: &dyn Surface, n: usize) -> Vec<SurfacePoint> {
    let (lo, hi) = surface.bounds();
    let (center, radius) = (nalgebra::center(&lo, &hi), (hi - lo).norm() / 2.0);
    if !(radius > 0.0 && radius.is_finite()) {
        return Vec::new();
    }
    let mut out = Vec::with_capacity(n);
    // A thin object is missed by most lines.
    for i in 0..50 * n {
        let [z, phi, r, theta] = quasi_random(i);
        let direction = on_sphere(z, phi);
        let (e1, e2) = across(&direction);
        let (sin, cos) = (std::f64::consts::TAU * theta).sin_cos();
        let foot = center + (e1 * cos + e2 * sin) * (radius * r.sqrt());
        let mut origin = foot - direction * (1.01 * radius);
        let step = 1e-6 * radius;
        // A line crosses a mesh of a solid a few times; more is a surface that gives no end.
        for _ in 0..16 {
            let Some(hit) = surface.ray_cast(&origin, &direction, 4.0 * radius) else { break };
            if !hit.point.iter().chain(&hit.normal).all(|v| v.is_finite()) {
                break;
            }
            origin = hit.point + direction * step;
            out.push(hit);
        }
        if out.len() >= n {
            break;
        }
    }
    out
}

fn on_sphere(u: f64, v: f64) -> Vector3<f64> {
    let z = 2.0 * u - 1.0;
    let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
    let flat = (1.0 - z * z).max(0.0).sqrt();
    Vector3::new(flat * cos, flat * sin, z)
}

/// Two unit vectors across `d` and each other.
pub(super) fn across(d: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let helper = if d.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let e1 = d.cross(&helper).normalize();
    (e1, d.cross(&e1))
}

/// Orientations to start from: principal axes on principal axes in all 24 ways, and `n` spread evenly over all rotations
/// (Shoemake 1992 on a low-discrepancy sequence).
pub(super) fn rotations(points: &Moments, surface: &Moments, n: usize) -> Vec<UnitQuaternion<f64>> {
    let mut out: Vec<_> =
        cube_rotations().into_iter().map(|p| quaternion(points.axes * p * surface.axes.transpose())).collect();
    out.extend((0..n).map(|i| {
        let [u, v, w, _] = quasi_random(i);
        let ((s1, c1), (s2, c2)) = ((std::f64::consts::TAU * v).sin_cos(), (std::f64::consts::TAU * w).sin_cos());
        let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
        UnitQuaternion::from_quaternion(Quaternion::new(b * c2, a * s1, a * c1, b * s2))
    }));
    out
}

/// Turns by quarters about the principal axes of the surface, in its own frame, without the identity.
pub(super) fn quarter_turns(surface: &Moments) -> Vec<UnitQuaternion<f64>> {
    cube_rotations()
        .into_iter()
        .map(|p| quaternion(surface.axes * p * surface.axes.transpose()))
        .filter(|q| q.angle() > 0.1)
        .collect()
}

/// The 24 rotations of a cube.
fn cube_rotations() -> Vec<Matrix3<f64>> {
    let axes = [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y(), Vector3::z(), -Vector3::z()];
    let mut out = Vec::with_capacity(24);
    for a in &axes {
        for b in axes.iter().filter(|b| a.dot(b) == 0.0) {
            out.push(Matrix3::from_columns(&[*a, *b, a.cross(b)]));
        }
    }
    out
}

fn quaternion(m: Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m))
}
