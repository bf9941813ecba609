//! How far down a masked object goes.

use std::ops::Range;

use drex_core::stats::{median, quantile};
use nalgebra::{Unit, Vector3};
use rayon::prelude::*;

use crate::check::Silhouette;

/// Rays of each mask that are followed.
const RAYS: usize = 100;
/// Steps down a ray.
const STEPS: usize = 400;
/// Of the rays along a mask's rim the share that ends lower than what is called its lowest.
const LOWEST_SHARE: f64 = 0.05;
/// Masks that may be wrong about a place, as a share of all.
const WRONG_MASKS: f64 = 0.02;
/// Rays that go down less steeply tell no height.
const LEAST_SLOPE: f64 = 0.1;

/// Height along `up` of the lowest part of what masks show, sought within `heights`; `None` if no ray of their rims meets the visual hull.
///
/// A ray through the lower rim of a silhouette touches the object at its foot, so that the ray enters the visual hull no lower than that, and
/// hardly higher where masks from all round bound the hull. Masks from above do not say how far down the hull goes, but this they do.
pub fn silhouette_base(masks: &[Silhouette], up: &Unit<Vector3<f64>>, heights: Range<f64>) -> Option<f64> {
    let allowed = (WRONG_MASKS * masks.len() as f64) as usize;
    let step = (heights.end - heights.start) / STEPS as f64;
    let entry = |mask: &Silhouette, (column, row): (u32, u32)| {
        let eye = mask.world_from_camera.translation.vector;
        let ray = mask.world_from_camera * mask.camera.ray(column, row);
        let slope = ray.dot(up);
        if slope > -LEAST_SLOPE * ray.norm() {
            return None;
        }
        (0..=STEPS).map(|k| heights.end - k as f64 * step).find(|height| {
            let t = (height - eye.dot(up)) / slope;
            let p = (eye + ray * t).into();
            let (mut inside, mut outside) = (0, 0);
            masks.iter().filter_map(|m| m.shows(&p)).for_each(|s| *if s { &mut inside } else { &mut outside } += 1);
            // What few photos look at is not where the object is.
            t > 0.0 && outside <= allowed && 2 * inside > masks.len()
        })
    };
    let of = |mask: &Silhouette| {
        let rim = mask.rim();
        let some = rim.iter().step_by(rim.len().div_ceil(RAYS).max(1));
        quantile(some.filter_map(|pixel| entry(mask, *pixel)), LOWEST_SHARE)
    };
    let lowest: Vec<Option<f64>> = masks.par_iter().map(of).collect();
    median(lowest.into_iter().flatten())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::{DepthCamera, cast_depth};
    use crate::shapes::{cuboid, joined};
    use drex_core::Pose;
    use nalgebra::Point3;

    #[test]
    fn a_disc_below_an_object_is_its_base() {
        // A cube on a slab, seen from above all round; heights count from the slab's underside at -0.012.
        let thing = joined(&[cuboid([-0.03; 3], [0.03; 3]), cuboid([-0.08, -0.08, -0.042], [0.08, 0.08, -0.03])]);
        let camera =
            DepthCamera { width_px: 320, height_px: 240, fx_px: 300.0, fy_px: 300.0, cx_px: 160.0, cy_px: 120.0 };
        let seen_from = |k: usize, height: f64| {
            let (sin, cos) = (k as f64 * std::f64::consts::TAU / 24.0).sin_cos();
            let eye = Point3::new(0.4 * cos, 0.4 * sin, height);
            let world_from_camera = Pose::face_towards(&eye, &Point3::origin(), &-Vector3::z());
            let mask = cast_depth(&thing, &camera, &world_from_camera).depth_m.iter().map(|z| *z > 0.0).collect();
            Silhouette { camera, world_from_camera, mask, name: k.to_string() }
        };
        let mut masks: Vec<Silhouette> = (0..24).map(|k| seen_from(k, 0.15 + 0.01 * (k % 5) as f64)).collect();
        let pixel = 0.4 / 300.0;
        let base = silhouette_base(&masks, &Vector3::z_axis(), -0.3..0.2).unwrap();
        assert!((base + 0.042).abs() < 2.0 * pixel, "{base}");
        masks.iter_mut().for_each(|m| m.mask.fill(false));
        assert_eq!(silhouette_base(&masks, &Vector3::z_axis(), -0.3..0.2), None);
    }
}
