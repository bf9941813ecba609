//! What the sparse points say: where exactly the plane is, and which pixels show the object or the background for sure.

use drex_core::Pose;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::view::{Bounds, View};
use super::{MaskPoint, MaskRegion};

/// Points nearer to the plane than this part of the box's diagonal take part in its fit.
const NEAR_PLANE: f64 = 0.03;
/// The fit may turn the plane by this much at most; a farther turn says that the points are not of this plane.
const MOST_TURN_DEG: f64 = 3.0;
const FEWEST_FOR_PLANE: usize = 40;
/// Points this far above the plane, as part of the box's diagonal, are the object's; below the half of it, the plane's.
const ABOVE_PLANE: f64 = 0.02;

/// A point that was put to a side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seed {
    /// Frame of the region.
    pub position: Point3<f64>,
    pub object: bool,
    /// Which of the points.
    pub point: usize,
}

/// The region with its plane moved onto the points around it: least squares on heights, reweighted by Tukey's biweight.
///
/// The caller's plane may be off by a degree or a hundredth of the box; what is seen of the plane from several sides then
/// would not fit together to a pixel.
pub(super) fn settle(region: &MaskRegion, points: &[MaskPoint]) -> Pose {
    let given = region.world_from_region;
    let size = region.upper - region.lower;
    let (diagonal, middle) = (size.norm(), nalgebra::center(&region.lower, &region.upper));
    let reach = 1.5 * size.xy().norm();
    let near: Vec<Vector3<f64>> = points
        .iter()
        .map(|p| given.inverse_transform_point(&p.position).coords)
        .filter(|p| p.iter().all(|v| v.is_finite()) && (p.xy() - middle.coords.xy()).norm() < reach)
        .filter(|p| p.z.abs() < NEAR_PLANE * diagonal)
        .collect();
    // z = c.x + c.y x + c.z y, coordinates from the middle of the box.
    let mut c = Vector3::zeros();
    let mut scale = NEAR_PLANE * diagonal;
    for _ in 0..12 {
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        let mut heights = Vec::with_capacity(near.len());
        let mut count = 0;
        for p in &near {
            let row = Vector3::new(1.0, (p.x - middle.x) / reach, (p.y - middle.y) / reach);
            let off = p.z - row.dot(&c);
            heights.push(off.abs());
            let u = off / scale;
            if u.abs() < 1.0 {
                let weight = (1.0 - u * u).powi(2);
                a += row * row.transpose() * weight;
                b += row * (p.z * weight);
                count += 1;
            }
        }
        if count < FEWEST_FOR_PLANE {
            return given;
        }
        let Some(inverse) = a.try_inverse().filter(|_| a.symmetric_eigenvalues().min() > 1e-3 * count as f64) else {
            return given;
        };
        c = inverse * b;
        heights.sort_by(f64::total_cmp);
        scale = (4.7 * 1.48 * heights[heights.len() / 2]).clamp(1e-4 * diagonal, NEAR_PLANE * diagonal);
    }
    let normal = Vector3::new(-c.y / reach, -c.z / reach, 1.0).normalize();
    if !(normal.z > MOST_TURN_DEG.to_radians().cos()) {
        return given;
    }
    let turn = Rotation3::rotation_between(&Vector3::z(), &normal).unwrap_or_default();
    let pivot = Vector3::new(middle.x, middle.y, 0.0);
    let shift = pivot + Vector3::new(0.0, 0.0, c.x) - turn * pivot;
    given * Pose::from_parts(Translation3::from(shift), UnitQuaternion::from_rotation_matrix(&turn))
}

/// Puts each point to its side, or leaves it out where it is too near to the border between.
pub(super) fn seeds(points: &[MaskPoint], world_from_region: &Pose, bounds: &Bounds) -> Vec<Seed> {
    let above = ABOVE_PLANE * bounds.diagonal();
    let slack = 0.01 * bounds.diagonal();
    let mut seeds = Vec::new();
    for (point, p) in points.iter().enumerate() {
        let position = world_from_region.inverse_transform_point(&p.position);
        if !position.iter().all(|v| v.is_finite()) || p.photos.len() < 3 {
            continue;
        }
        let object = bounds.contains(&position) && position.z > above;
        let away = (0..3).any(|k| position[k] < bounds.lower[k] - slack || position[k] > bounds.upper[k] + slack);
        // A point low in the middle of the footprint may be a foot of the object.
        let low = position.z < 0.5 * above && position.z > -2.0 * above;
        if object || away || low {
            seeds.push(Seed { position, object, point });
        }
    }
    seeds
}

/// Points of the background: outside of the box and away from the plane, frame of the region.
pub(super) fn behind(points: &[MaskPoint], world_from_region: &Pose, bounds: &Bounds) -> Vec<Point3<f64>> {
    let off = 0.5 * ABOVE_PLANE * bounds.diagonal();
    let slack = 0.05 * bounds.diagonal();
    points
        .iter()
        .map(|p| world_from_region.inverse_transform_point(&p.position))
        .filter(|p| p.iter().all(|v| v.is_finite()) && p.z.abs() > off)
        .filter(|p| (0..3).any(|k| p[k] < bounds.lower[k] - slack || p[k] > bounds.upper[k] + slack))
        .collect()
}

/// Per view, the pixels of its window at which points appear that it saw, and the side of each.
pub(super) fn seen(seeds: &[Seed], points: &[MaskPoint], views: &[View]) -> Vec<Vec<(usize, bool)>> {
    let last = views.iter().map(|v| v.photo + 1).max().unwrap_or(0);
    let mut view_of = vec![usize::MAX; last];
    for (k, view) in views.iter().enumerate() {
        view_of[view.photo] = k;
    }
    let mut all = vec![Vec::new(); views.len()];
    for seed in seeds {
        for photo in &points[seed.point].photos {
            let Some(view) = view_of.get(*photo as usize).copied().filter(|v| *v != usize::MAX) else { continue };
            if let Some(at) = views[view].pixel_of(&seed.position) {
                all[view].push((at, seed.object));
            }
        }
    }
    all
}
