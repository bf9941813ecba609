//! Where a surfel can touch the image: never too small, under any perspective.
//!
//! Two regions count: the projected disc of the radius at which the opacity falls to the cut, and a round spot of the
//! same number of standard deviations (σ = √½ px) about the floor's centre.

use nalgebra::{Matrix2, Vector2, Vector3};

use super::project::Surfel;

/// Added on every side, pixels: more than single precision can err.
const MARGIN: f64 = 0.05;
/// Corners of the polygon that stands for a disc cut by the camera's plane.
const CORNERS: usize = 16;

/// Pixel coordinates that a surfel can touch: a box and a strip across it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Footprint {
    /// Range of x, pixels.
    pub x: [f32; 2],
    /// Range of y, pixels.
    pub y: [f32; 2],
    /// Unit normal of the strip: the direction in which the projected disc is thinnest.
    pub axis: [f32; 2],
    /// Range of axis · (x, y), pixels.
    pub strip: [f32; 2],
    /// Longest half axis of the disc of three standard deviations, pixels; as long as the box where the camera's plane
    /// cuts that disc.
    pub radius: f32,
}

impl Footprint {
    /// Where `rho <= radius2` can hold in front of `near`; `None` if nowhere.
    pub fn new(surfel: &Surfel, radius2: f64, near: f64) -> Option<Self> {
        if !(radius2 > 0.0) {
            return None;
        }
        let floor = surfel.centre.map(|c| (c, Matrix2::identity() * (radius2 / 2.0)));
        let directions = |axis: Vector2<f64>| [Vector2::x(), Vector2::y(), axis];
        let (axis, ranges) = match ellipse(surfel, radius2) {
            Some((centre, spread)) => {
                let axis = thin_axis(&spread);
                (axis, directions(axis).map(|n| range(&n, &centre, &spread)))
            }
            None => {
                let corners = clipped_corners(surfel, radius2.sqrt(), near);
                (Vector2::x(), directions(Vector2::x()).map(|n| hull(corners.iter().map(|c| n.dot(c)))))
            }
        };
        let origin = Vector2::from(surfel.origin);
        let absolute =
            |[lo, hi]: [f64; 2], n: Vector2<f64>| [lo - MARGIN, hi + MARGIN].map(|v| (v + n.dot(&origin)) as f32);
        let [x, y, strip] = std::array::from_fn(|i| {
            let n = directions(axis)[i];
            let with_floor = floor.iter().map(|(c, spread)| range(&n, c, spread)).chain([ranges[i]]);
            absolute(hull(with_floor.flatten()), n)
        });
        let radius = match ellipse(surfel, 9.0) {
            Some((_, spread)) => spread_range(&spread).1.max(9.0 / 2.0).sqrt() as f32,
            None => (x[1] - x[0]).max(y[1] - y[0]),
        };
        Some(Self { x, y, axis: [axis.x as f32, axis.y as f32], strip, radius })
    }
}

/// The ellipse that the disc of squared radius `r2` projects to: centre and Γ with (x - c)ᵀ Γ⁻¹ (x - c) = 1, from the dual
/// conic T diag(r², r², -1) Tᵀ. None where the disc reaches the camera's plane.
fn ellipse(surfel: &Surfel, r2: f64) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let t = &surfel.transform;
    let dual = t * nalgebra::Matrix3::from_diagonal(&Vector3::new(r2, r2, -1.0)) * t.transpose();
    let (w, depth) = (dual[(2, 2)], t[(2, 2)]);
    // A disc that all but touches the plane has an ellipse too large for these digits.
    if !(w < -1e-6 * depth * depth) {
        return None;
    }
    let centre = Vector2::new(dual[(0, 2)], dual[(1, 2)]) / w;
    Some((centre, centre * centre.transpose() - dual.fixed_view::<2, 2>(0, 0) / w))
}

/// Smaller and larger eigenvalue.
fn spread_range(spread: &Matrix2<f64>) -> (f64, f64) {
    let [a, b, c] = [spread[(0, 0)], spread[(0, 1)], spread[(1, 1)]];
    let (middle, half) = (0.5 * (a + c), (0.25 * (a - c) * (a - c) + b * b).sqrt());
    (middle - half, middle + half)
}

/// Eigenvector of the smaller eigenvalue.
fn thin_axis(spread: &Matrix2<f64>) -> Vector2<f64> {
    let [a, b, c] = [spread[(0, 0)], spread[(0, 1)], spread[(1, 1)]];
    let (_, largest) = spread_range(spread);
    // Perpendicular to (largest - c, b) and to (b, largest - a): the longer of both has the digits.
    let axis = if a > c { Vector2::new(-b, largest - c) } else { Vector2::new(largest - a, -b) };
    axis.try_normalize(0.0).unwrap_or(Vector2::x())
}

/// Extent of an ellipse along `n`.
fn range(n: &Vector2<f64>, centre: &Vector2<f64>, spread: &Matrix2<f64>) -> [f64; 2] {
    let (middle, half) = (n.dot(centre), n.dot(&(spread * n)).max(0.0).sqrt());
    [middle - half, middle + half]
}

/// Corners of a polygon round the disc, cut at z = `near`, projected: a convex region in front of the camera stays
/// convex, so their hull holds the whole disc.
fn clipped_corners(surfel: &Surfel, radius: f64, near: f64) -> Vec<Vector2<f64>> {
    let step = std::f64::consts::TAU / CORNERS as f64;
    let outer = radius / (0.5 * step).cos();
    let corner = |i: usize| {
        let (sin, cos) = (step * i as f64).sin_cos();
        surfel.transform * Vector3::new(outer * cos, outer * sin, 1.0)
    };
    let mut points = Vec::with_capacity(CORNERS + 2);
    for (a, b) in (0..CORNERS).map(|i| (corner(i), corner(i + 1))) {
        if a.z >= near {
            points.push(a);
        }
        if (a.z >= near) != (b.z >= near) {
            points.push(a + (b - a) * ((near - a.z) / (b.z - a.z)));
        }
    }
    points.iter().map(|p| p.xy() / p.z.max(near)).collect()
}

/// Smallest range that holds all values; empty (reversed) without any.
fn hull(values: impl IntoIterator<Item = f64>) -> [f64; 2] {
    values.into_iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], v| [lo.min(v), hi.max(v)])
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3};

    use super::*;
    use drex_core::camera::PinholeCamera;

    fn camera() -> PinholeCamera {
        let camera_from_world = drex_core::Pose::identity();
        PinholeCamera { camera_from_world, fx: 100.0, fy: 120.0, cx: 50.0, cy: 40.0, width: 100, height: 80 }
    }

    fn footprint(r: Matrix3<f64>, s: [f64; 2], t: Vector3<f64>) -> Footprint {
        let surfel = Surfel::new(&camera(), r, s.map(f64::ln), t, 0.01, 9.0).unwrap();
        Footprint::new(&surfel, 4.0, 0.01).unwrap()
    }

    #[test]
    fn a_disc_that_faces_the_camera_has_the_box_of_its_ellipse() {
        let f = footprint(Matrix3::identity(), [0.2, 0.1], Vector3::new(0.5, -0.25, 2.0));
        let near = |range: [f32; 2], lo: f32, hi: f32| {
            assert!(
                (range[0] - lo + 0.05).abs() < 1e-3 && (range[1] - hi - 0.05).abs() < 1e-3,
                "{range:?}, {lo} to {hi}"
            );
        };
        near(f.x, 75.0 - 20.0, 75.0 + 20.0);
        near(f.y, 25.0 - 12.0, 25.0 + 12.0);
        assert_eq!((f.axis[0].abs(), f.axis[1].abs()), (0.0, 1.0), "thinnest along y");
        assert!((f.radius - 30.0).abs() < 1e-3, "three times 10 px: {}", f.radius);
    }

    #[test]
    fn an_edge_on_disc_has_a_strip_as_thin_as_its_floor() {
        let turn =
            Rotation3::from_axis_angle(&Vector3::z_axis(), 0.7) * Rotation3::from_axis_angle(&Vector3::x_axis(), 1.57);
        let f = footprint(turn.into_inner(), [0.2, 0.2], Vector3::new(0.0, 0.0, 2.0));
        assert!(f.strip[1] - f.strip[0] < 2.0 * (2.0 + 0.05) * 1.01, "floor of two standard deviations: {f:?}");
        assert!(f.x[1] - f.x[0] > 20.0);
    }

    #[test]
    fn a_disc_across_the_cameras_plane_has_a_finite_box() {
        let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), 1.2);
        let f = footprint(turn.into_inner(), [1.0, 1.0], Vector3::new(0.0, 1.0, 1.0));
        assert!(f.x.iter().chain(&f.y).chain(&f.strip).all(|v| v.is_finite()));
        assert!(f.y[1] > 80.0, "it goes on below the image: {f:?}");
    }
}
