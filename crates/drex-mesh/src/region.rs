//! Where in a scan of a whole scene the object stands.

use std::collections::{BTreeMap, VecDeque};

use drex_core::Pose;
use drex_core::camera::point_looked_at;
use nalgebra::{Point3, Vector3};

use crate::{Error, Result};

/// Points lower than this share of the cameras' distance may be the table.
const LOWEST: f64 = 0.01;
/// Points are neighbours when they share a cell, or sit in cells side by side, of this share of the cameras' distance.
const CELL: f64 = 0.04;
/// A group is a candidate if it has at least this share of the points above the table.
const LEAST_SHARE: f64 = 0.1;
/// Share of a group's points on each side of each axis that is not trusted to be the object's.
const TRIMMED: f64 = 0.002;
/// The box is larger than the points by this share of its size, on each side.
const MARGIN: f64 = 0.1;

/// A box around an object on a table.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ObjectRegion {
    /// Lower corner, metres, table frame; on the table.
    pub lo: Point3<f64>,
    /// Upper corner.
    pub hi: Point3<f64>,
    /// Sparse points of the object.
    pub points: usize,
    /// Groups of points that stand on the table and are not the object.
    pub others: usize,
}

/// The box of the object among the sparse points of a scan without masks, by grouping the points above the table:
/// of the groups with a tenth of these points or more it is the one nearest to where the cameras look.
///
/// `points` and `cameras` (`world_from_camera`) are in the table's frame: the table is z = 0, z points up.
///
/// # Errors
/// If the cameras do not look at one place, or nothing stands on the table.
pub fn object_on_table(points: &[Point3<f64>], cameras: &[Pose]) -> Result<ObjectRegion> {
    let Some(target) = point_looked_at(cameras) else {
        return Err(Error::value(
            format!("{} cameras do not look at one place", cameras.len()),
            "give masks of the object, or the box it is in",
        ));
    };
    let mut distances: Vec<f64> = cameras.iter().map(|c| (c.translation.vector - target.coords).norm()).collect();
    let distance = *distances.select_nth_unstable_by(cameras.len() / 2, f64::total_cmp).1;
    let standing: Vec<Point3<f64>> =
        points.iter().filter(|p| p.z > LOWEST * distance && (*p - target).norm() < distance).copied().collect();
    let groups = groups_of(&standing, CELL * distance);
    let least = ((LEAST_SHARE * standing.len() as f64).ceil() as usize).max(8);
    let candidates = groups.iter().filter(|g| g.len() >= least);
    let off = |group: &[usize]| {
        let mean: Vector3<f64> = group.iter().map(|&i| standing[i].coords).sum::<Vector3<f64>>() / group.len() as f64;
        (mean - target.coords).norm()
    };
    let Some(object) = candidates.clone().min_by(|a, b| off(a).total_cmp(&off(b))) else {
        return Err(Error::value(
            format!("of {} sparse points none, or too few together, stand on the table", points.len()),
            "give masks of the object, the box it is in, or a table plane that is right",
        ));
    };
    let (mut lo, mut hi) = (Point3::origin(), Point3::origin());
    for k in 0..3 {
        let mut along: Vec<f64> = object.iter().map(|&i| standing[i][k]).collect();
        along.sort_by(f64::total_cmp);
        let cut = (TRIMMED * along.len() as f64) as usize;
        (lo[k], hi[k]) = (along[cut], along[along.len() - 1 - cut]);
        let margin = MARGIN * (hi[k] - lo[k]);
        (lo[k], hi[k]) = (lo[k] - margin, hi[k] + margin);
    }
    lo.z = 0.0;
    Ok(ObjectRegion { lo, hi, points: object.len(), others: candidates.count() - 1 })
}

/// Groups of points connected through cells of side `cell`, each as indices into `points`.
fn groups_of(points: &[Point3<f64>], cell: f64) -> Vec<Vec<usize>> {
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (i, p) in points.iter().enumerate() {
        cells.entry([0, 1, 2].map(|k| (p[k] / cell).floor() as i64)).or_default().push(i);
    }
    let mut groups = Vec::new();
    while let Some((first, members)) = cells.pop_first() {
        let (mut group, mut queue) = (members, VecDeque::from([first]));
        while let Some(at) = queue.pop_front() {
            for n in 0..27 {
                let next = [at[0] + n / 9 - 1, at[1] + n / 3 % 3 - 1, at[2] + n % 3 - 1];
                if let Some(members) = cells.remove(&next) {
                    group.extend(members);
                    queue.push_back(next);
                }
            }
        }
        groups.push(group);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::low_discrepancy;

    /// Cameras on a ring of 0.3 m, 0.2 m above the table, that look at a point.
    fn ring(target: Point3<f64>) -> Vec<Pose> {
        let camera = |k: usize| {
            let (sin, cos) = (k as f64 * 0.7).sin_cos();
            let eye = Point3::new(target.x + 0.3 * cos, target.y + 0.3 * sin, 0.2);
            Pose::face_towards(&eye, &target, &Vector3::z())
        };
        (0..9).map(camera).collect()
    }

    fn cloud(lo: [f64; 3], size: [f64; 3], n: usize) -> impl Iterator<Item = Point3<f64>> {
        (0..n).map(move |i| {
            let u = low_discrepancy(i);
            Point3::new(lo[0] + size[0] * u[0], lo[1] + size[1] * u[1], lo[2] + size[2] * u[2])
        })
    }

    #[test]
    fn the_object_is_what_the_cameras_look_at() {
        let target = Point3::new(0.02, -0.01, 0.03);
        let mut points: Vec<_> = cloud([-0.02, -0.04, 0.0], [0.08, 0.06, 0.07], 900).collect();
        points.extend(cloud([-0.4, -0.4, -0.002], [0.8, 0.8, 0.004], 3000)); // the table
        points.extend(cloud([0.13, -0.02, 0.0], [0.05, 0.05, 0.1], 1500)); // another object, with more points
        points.extend(cloud([-2.0, 1.0, 0.0], [4.0, 0.1, 2.0], 500)); // the wall
        let found = object_on_table(&points, &ring(target)).unwrap();
        assert_eq!(found.others, 1);
        assert!((found.lo - Point3::new(-0.028, -0.046, 0.0)).norm() < 2e-3, "{found:?}");
        assert!((found.hi - Point3::new(0.068, 0.026, 0.077)).norm() < 2e-3, "{found:?}");
    }

    #[test]
    fn an_empty_table_and_cameras_that_look_elsewhere_are_refused() {
        let cameras = ring(Point3::origin());
        let table: Vec<_> = cloud([-0.4, -0.4, -0.002], [0.8, 0.8, 0.004], 3000).collect();
        assert!(object_on_table(&table, &cameras).unwrap_err().to_string().contains("stand on the table"));
        let parallel: Vec<Pose> = (0..4).map(|k| Pose::translation(0.1 * f64::from(k), 0.0, 0.0)).collect();
        assert!(object_on_table(&table, &parallel).unwrap_err().to_string().contains("do not look at one place"));
        assert!(object_on_table(&[], &[]).is_err());
        assert!(point_looked_at(&parallel).is_none());
    }
}
