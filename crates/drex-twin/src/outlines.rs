//! Masks that were made, held against the depth that was found: where several photos measured the object, it is not background.

use drex_core::camera::PinholeCamera;
use nalgebra::Point3;

/// So far from a mask its rim may be off anyway, pixels.
const RIM_PX: usize = 3;
/// So many other photos have to have measured something on a ray.
const LEAST_WITNESSES: u32 = 3;
/// Side of the squares in which their points are counted, pixels.
const CELL_PX: usize = 4;
/// Points of each photo, about.
const POINTS: usize = 20_000;
/// Depths with less confidence are no evidence.
const LEAST_CONFIDENCE: f32 = 0.5;

/// Points of the object that a photo is sure of, world frame.
pub(crate) fn sure_points(camera: &PinholeCamera, depth: &[f32], confidence: &[f32]) -> Vec<Point3<f32>> {
    let step = ((depth.len() / POINTS) as f64).sqrt().ceil().max(1.0) as usize;
    let world_from_camera = camera.camera_from_world.inverse();
    let pixels = (0..camera.height).step_by(step).flat_map(|y| (0..camera.width).step_by(step).map(move |x| [x, y]));
    let sure = pixels.map(|[x, y]| (x, y, y * camera.width + x));
    sure.filter(|(.., at)| depth[*at] > 0.0 && confidence[*at] >= LEAST_CONFIDENCE)
        .map(|(x, y, at)| {
            let ray = camera.ray([x as f64 + 0.5, y as f64 + 0.5]);
            (world_from_camera * Point3::from(ray * f64::from(depth[at]))).cast()
        })
        .collect()
}

/// Adds to the mask of a photo, 0 to 1, where `others` have points of the object well beside it.
pub(crate) fn mend(mask: &mut [f32], camera: &PinholeCamera, others: &[&[Point3<f32>]]) {
    let (width, height) = (camera.width, camera.height);
    let around = |x: usize, y: usize, reach: usize| {
        let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
        (y.saturating_sub(reach)..(y + reach + 1).min(height))
            .flat_map(move |y| columns.clone().map(move |x| y * width + x))
    };
    let across = width.div_ceil(CELL_PX);
    // Photos that have a point in a square, and the last of them.
    let mut counts = vec![(0u32, usize::MAX); across * height.div_ceil(CELL_PX)];
    for (k, points) in others.iter().enumerate() {
        for point in *points {
            let Some(([u, v], _)) = camera.project(&point.cast()) else { continue };
            if !(u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64) {
                continue;
            }
            let (x, y) = (u as usize, v as usize);
            let (count, last) = &mut counts[y / CELL_PX * across + x / CELL_PX];
            if *last != k && around(x, y, RIM_PX).all(|at| mask[at] < 0.5) {
                (*count, *last) = (*count + 1, k);
            }
        }
    }
    for (cell, (count, _)) in counts.iter().enumerate() {
        if *count >= LEAST_WITNESSES {
            let middle = [cell % across, cell / across].map(|c| c * CELL_PX + CELL_PX / 2);
            around(middle[0], middle[1], CELL_PX / 2 + RIM_PX).for_each(|at| mask[at] = 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::Pose;
    use nalgebra::{Translation3, UnitQuaternion};

    /// A wall of 40 x 40 mm, 0.4 m away, seen by a camera that far aside.
    fn wall(aside_m: f64) -> (PinholeCamera, Vec<f32>) {
        let camera_from_world = Pose::from_parts(Translation3::new(-aside_m, 0.0, 0.0), UnitQuaternion::identity());
        let camera =
            PinholeCamera { fx: 800.0, fy: 800.0, cx: 80.0, cy: 60.0, width: 160, height: 120, camera_from_world };
        let shows = |i: usize| {
            let ray = camera.ray([(i % 160) as f64 + 0.5, (i / 160) as f64 + 0.5]) * 0.4;
            (ray.x + aside_m).abs() < 0.02 && ray.y.abs() < 0.02
        };
        let depth = (0..160 * 120).map(|i| if shows(i) { 0.4 } else { 0.0 }).collect();
        (camera, depth)
    }

    #[test]
    fn a_bite_out_of_a_mask_is_filled_where_three_other_photos_measured_the_object_and_its_rim_stays() {
        let (camera, depth) = wall(0.0);
        let whole: Vec<f32> = depth.iter().map(|z| f32::from(u8::from(*z > 0.0))).collect();
        let mut bitten = whole.clone();
        // The lower right corner, to column 120 and row 100, from column 90 and row 70 on.
        bitten.iter_mut().enumerate().filter(|(i, _)| i % 160 >= 90 && i / 160 >= 70).for_each(|(_, m)| *m = 0.0);
        let others: Vec<Vec<Point3<f32>>> = [-0.004, 0.003, 0.006]
            .map(|aside_m| {
                let (camera, depth) = wall(aside_m);
                sure_points(&camera, &depth, &vec![0.6; depth.len()])
            })
            .into();
        let mended = |count: usize| {
            let mut mask = bitten.clone();
            mend(&mut mask, &camera, &others[..count].iter().map(Vec::as_slice).collect::<Vec<_>>());
            mask
        };
        let missing = |mask: &[f32]| mask.iter().zip(&whole).filter(|(m, w)| *m < *w).count();
        let beyond = |mask: &[f32]| mask.iter().zip(&whole).filter(|(m, w)| *m > *w).count();
        assert_eq!(missing(&bitten), 30 * 30);
        assert_eq!(mended(2), bitten, "two are not enough");
        let mask = mended(3);
        assert!(missing(&mask) <= 30, "{} pixels are still missing", missing(&mask));
        assert!(beyond(&mask) < 60 * (RIM_PX + CELL_PX), "{} too many", beyond(&mask));
        let (camera, depth) = wall(0.003);
        assert!(sure_points(&camera, &depth, &vec![0.4; depth.len()]).is_empty(), "these are not sure");
        let mut whole_mask = whole.clone();
        mend(&mut whole_mask, &wall(0.0).0, &others.iter().map(Vec::as_slice).collect::<Vec<_>>());
        assert_eq!(whole_mask, whole, "what is right stays as it is");
    }
}
