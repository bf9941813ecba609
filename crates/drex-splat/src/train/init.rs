//! The first Gaussians: one for every sparse point, as large as the distance to its neighbours.

use nalgebra::{UnitQuaternion, Vector3};

use crate::{Gaussians, Kind, Label};

/// Opacity of a Gaussian on a known surface.
const BORN_OPACITY: f32 = 0.9;
/// Its standard deviation along the surface, as a share of the distance to its neighbours,
const BORN_SIZE: f32 = 0.5;
/// and off it, as a share of that.
const BORN_FLATNESS: f32 = 0.2;

/// Coefficient of the constant basis function: colour = 0.5 + C0 · coefficient.
pub(crate) const SH_C0: f32 = 0.282_094_79;

/// Gaussians at `points` (scene frame) in their colours. Each scale is the root mean square distance to the three
/// nearest others, as 3DGS starts (Kerbl et al. 2023, section 7.1); surfels face a random direction drawn from the
/// index, since nothing is known of the surface yet.
pub fn from_points(points: &[[f64; 3]], colours: &[[u8; 3]], kind: Kind, sh_degree: usize, opacity: f32) -> Gaussians {
    let mut out = Gaussians::new(kind, sh_degree);
    let distances = neighbour_distances(points);
    let logit = (opacity / (1.0 - opacity)).ln();
    for (i, (p, c)) in points.iter().zip(colours).enumerate() {
        out.means.push(p.map(|v| v as f32));
        out.rotations.push(match kind {
            Kind::Ellipsoid => [1.0, 0.0, 0.0, 0.0],
            Kind::Surfel => spread_rotation(i),
        });
        out.log_scales.push([(distances[i].max(1e-7) as f32).ln(); 3]);
        out.logit_opacities.push(logit);
        let start = out.sh.len();
        out.sh.resize(start + out.sh_stride(), 0.0);
        for (k, &v) in c.iter().enumerate() {
            out.sh[start + k] = (f32::from(v) / 255.0 - 0.5) / SH_C0;
        }
        out.labels.push(Label::BACKGROUND);
    }
    out
}

/// A place on a known surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Scene frame.
    pub position: [f64; 3],
    /// Unit vector off the surface.
    pub normal: [f64; 3],
    /// Colour there.
    pub rgb: [u8; 3],
}

/// Flat Gaussians that lie on a known surface and cover it, nearly opaque, in its colours.
pub(crate) fn from_surface(points: &[SurfacePoint], kind: Kind, sh_degree: usize) -> Gaussians {
    let (places, colours): (Vec<_>, Vec<_>) = points.iter().map(|p| (p.position, p.rgb)).unzip();
    let mut out = from_points(&places, &colours, kind, sh_degree, BORN_OPACITY);
    for ((point, rotation), scales) in points.iter().zip(&mut out.rotations).zip(&mut out.log_scales) {
        let normal = Vector3::from(point.normal);
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &normal)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        *rotation = [turn.w as f32, turn.i as f32, turn.j as f32, turn.k as f32];
        let across = scales[0] + BORN_SIZE.ln();
        *scales = [across, across, across + BORN_FLATNESS.ln()];
    }
    out
}

/// Root mean square distance of every point to its three nearest others; of all there are, if fewer.
fn neighbour_distances(points: &[[f64; 3]]) -> Vec<f64> {
    let tree = KdTree::new(points);
    (0..points.len())
        .map(|i| {
            let near = tree.nearest(i);
            let found: Vec<f64> = near.into_iter().filter(|d| d.is_finite()).collect();
            if found.is_empty() { 1.0 } else { (found.iter().sum::<f64>() / found.len() as f64).sqrt() }
        })
        .collect()
}

/// Points ordered so that the middle of every range splits it along one axis.
struct KdTree<'a> {
    points: &'a [[f64; 3]],
    order: Vec<u32>,
}

impl<'a> KdTree<'a> {
    fn new(points: &'a [[f64; 3]]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        sort_range(points, &mut order, 0);
        Self { points, order }
    }

    /// Squared distances of the three points nearest to point `i`, itself left out.
    fn nearest(&self, i: usize) -> [f64; 3] {
        let mut best = [f64::INFINITY; 3];
        self.search(&self.order, 0, i, &mut best);
        best
    }

    fn search(&self, range: &[u32], axis: usize, i: usize, best: &mut [f64; 3]) {
        let Some((&middle, middle_at)) = range.get(range.len() / 2).map(|m| (m, range.len() / 2)) else { return };
        let (here, other) = (self.points[i], self.points[middle as usize]);
        if middle as usize != i {
            let d: f64 = (0..3).map(|k| (here[k] - other[k]).powi(2)).sum();
            if d < best[2] {
                best[2] = d;
                best.sort_by(f64::total_cmp);
            }
        }
        let off = here[axis] - other[axis];
        let (left, right) = (&range[..middle_at], &range[middle_at + 1..]);
        let (near, far) = if off < 0.0 { (left, right) } else { (right, left) };
        self.search(near, (axis + 1) % 3, i, best);
        if off * off < best[2] {
            self.search(far, (axis + 1) % 3, i, best);
        }
    }
}

fn sort_range(points: &[[f64; 3]], range: &mut [u32], axis: usize) {
    if range.len() < 2 {
        return;
    }
    let middle = range.len() / 2;
    range.select_nth_unstable_by(middle, |&a, &b| {
        points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
    });
    let (left, right) = range.split_at_mut(middle);
    sort_range(points, left, (axis + 1) % 3);
    sort_range(points, &mut right[1..], (axis + 1) % 3);
}

/// A rotation from a sequence that fills the sphere evenly (golden ratio in the index).
fn spread_rotation(i: usize) -> [f32; 4] {
    let u = (i as f64 * 0.618_033_988_749_895).fract();
    let azimuth = std::f64::consts::TAU * (i as f64 * 0.754_877_666_246_693).fract();
    // The third axis points to height 1 - 2u: turn z by the polar angle about a horizontal axis.
    let half = 0.5 * (1.0 - 2.0 * u).acos();
    [half.cos() as f32, (half.sin() * -azimuth.sin()) as f32, (half.sin() * azimuth.cos()) as f32, 0.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_those_of_a_plain_search() {
        let points: Vec<[f64; 3]> = (0..300)
            .map(|i| {
                let f = |k: f64| ((i as f64 + 1.0) * k).sin() * 10.0;
                [f(12.9898), f(78.233), f(37.719)]
            })
            .collect();
        for (i, &d) in neighbour_distances(&points).iter().enumerate() {
            let mut all: Vec<f64> = (0..points.len())
                .filter(|&j| j != i)
                .map(|j| (0..3).map(|k| (points[i][k] - points[j][k]).powi(2)).sum())
                .collect();
            all.sort_by(f64::total_cmp);
            let plain = (all[..3].iter().sum::<f64>() / 3.0).sqrt();
            assert!((d - plain).abs() < 1e-12, "point {i}: {d} against {plain}");
        }
    }

    #[test]
    fn lone_and_equal_points_have_a_size() {
        let one = from_points(&[[1.0; 3]], &[[255, 0, 128]], Kind::Ellipsoid, 0, 0.1);
        assert_eq!(one.log_scales[0], [0.0; 3]);
        assert!((one.opacity(0) - 0.1).abs() < 1e-6);
        assert!((0.5 + SH_C0 * one.sh[0] - 1.0).abs() < 1e-6 && (0.5 + SH_C0 * one.sh[1]).abs() < 1e-6);
        let same = from_points(&[[0.0; 3]; 5], &[[0; 3]; 5], Kind::Surfel, 3, 0.1);
        assert!(same.check().is_ok());
    }
}
