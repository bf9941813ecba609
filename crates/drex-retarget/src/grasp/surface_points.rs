//! Points on a link, searched in few look-ups of the object's distance.

use crate::self_collision::ball;
use drex_core::{Pose, SdfSample, SignedDistance};
use drex_robot::Shape;
use nalgebra::{Point3, Vector3};

/// Edge of the cells whose points are skipped together, m.
const CELL_M: f64 = 0.014;
/// Between the directions in which the outermost points are looked for: on a fingertip of 1 cm radius that is 0.03 mm, rad.
const DIRECTIONS_RAD: f64 = 0.15;
/// Support points that are looked at.
const SUPPORTS: usize = 4;

/// Points on a link, link frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct SurfacePoints {
    points: Vec<Point3<f64>>,
    /// Distance of each point from the centre of its cell.
    reach: Vec<f64>,
    cells: Vec<(Point3<f64>, f64, std::ops::Range<usize>)>,
    /// Ball around all.
    ball: (Point3<f64>, f64),
}

/// What an earlier look-up says of a cell: where its centre was, and how far from the object. A distance changes by no more than
/// the way travelled.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CellBound {
    center: Point3<f64>,
    distance_m: f64,
}

/// A distance that is interpolated may change by this much more, m.
const INTERPOLATED_M: f64 = 0.0005;

impl SurfacePoints {
    pub(crate) fn new(points: impl IntoIterator<Item = Point3<f64>>) -> Self {
        let mut cells: std::collections::BTreeMap<[i64; 3], Vec<Point3<f64>>> = std::collections::BTreeMap::new();
        for p in points {
            cells.entry([0, 1, 2].map(|k| (p[k] / CELL_M).floor() as i64)).or_default().push(p);
        }
        let mut points = Self::default();
        for members in cells.into_values() {
            let (center, radius) = ball(&members);
            let start = points.points.len();
            points.reach.extend(members.iter().map(|p| (p - center).norm()));
            points.points.extend(members);
            points.cells.push((center, radius, start..points.points.len()));
        }
        points.ball = ball(&points.points);
        points
    }

    /// Only the points that are farthest in some direction, of many: what [`SurfacePoints::nearest`] can find.
    pub(crate) fn outermost(points: Vec<Point3<f64>>) -> Self {
        let all = Self::new(points);
        let directions = Shape::Sphere { radius: 1.0 }.surface_samples(DIRECTIONS_RAD);
        let mut kept: Vec<usize> = directions.iter().filter_map(|(_, n)| all.support(n)).collect();
        kept.sort_unstable();
        kept.dedup();
        Self::new(kept.into_iter().map(|i| all.points[i]))
    }

    /// The deepest point inside the object: where, and what the object says there.
    pub(crate) fn deepest(
        &self,
        pose: &Pose,
        object: &dyn SignedDistance,
        bounds: &(Point3<f64>, Point3<f64>),
        known: &mut Vec<CellBound>,
    ) -> Option<(Point3<f64>, SdfSample)> {
        known.resize(self.cells.len(), CellBound { center: Point3::origin(), distance_m: f64::NEG_INFINITY });
        let mut best: Option<(Point3<f64>, SdfSample)> = None;
        if self.points.is_empty() || box_distance(bounds, &(pose * self.ball.0)) > self.ball.1 {
            return None;
        }
        for ((center, radius, range), known) in self.cells.iter().zip(known) {
            let center = pose * center;
            let limit = best.as_ref().map_or(0.0, |b| b.1.distance_m);
            if known.distance_m - (center - known.center).norm() - INTERPOLATED_M - radius > limit
                || box_distance(bounds, &center) > *radius
            {
                continue;
            }
            *known = CellBound { center, distance_m: object.signed_distance(&center).distance_m };
            if known.distance_m - radius > limit {
                continue;
            }
            for i in range.clone() {
                let limit = best.as_ref().map_or(0.0, |b| b.1.distance_m);
                if known.distance_m - self.reach[i] - INTERPOLATED_M > limit {
                    continue;
                }
                let at = pose * self.points[i];
                let s = object.signed_distance(&at);
                if s.distance_m < limit {
                    best = Some((at, s));
                }
            }
        }
        best
    }

    /// A point nearest to the object: the support point against the distance's gradient, again from there until it stays (Frank and
    /// Wolfe's steps). Exact for a convex set of points and a flat object, a local minimum else.
    pub(crate) fn nearest(&self, pose: &Pose, object: &dyn SignedDistance) -> Option<(Point3<f64>, SdfSample)> {
        let mut gradient = object.signed_distance(&(pose * self.ball.0)).gradient;
        let mut best: Option<(usize, Point3<f64>, SdfSample)> = None;
        for _ in 0..SUPPORTS {
            let i = self.support(&-pose.inverse_transform_vector(&gradient))?;
            if best.as_ref().is_some_and(|b| b.0 == i) {
                break;
            }
            let at = pose * self.points[i];
            let s = object.signed_distance(&at);
            gradient = s.gradient;
            if best.as_ref().is_none_or(|b| s.distance_m < b.2.distance_m) {
                best = Some((i, at, s));
            } else {
                break;
            }
        }
        best.map(|b| (b.1, b.2))
    }

    fn support(&self, direction: &Vector3<f64>) -> Option<usize> {
        let mut best = (f64::NEG_INFINITY, None);
        for (i, p) in self.points.iter().enumerate() {
            let reach = p.coords.dot(direction);
            if reach > best.0 {
                best = (reach, Some(i));
            }
        }
        best.1
    }
}

/// Distance of a point from a box, a cheap lower bound of the distance from what is in it.
fn box_distance((lo, hi): &(Point3<f64>, Point3<f64>), point: &Point3<f64>) -> f64 {
    (lo - point).sup(&(point - hi)).sup(&Vector3::zeros()).norm()
}
