//! Colours of points from photos that have depth.

use nalgebra::Point3;

use drex_core::SurfacePoint;

use crate::depth::{DepthMap, DepthViews};
use crate::{Error, Result};

/// Colour of each of some points of a surface: the mean over the views that see it, weighted by cos⁴ of the angle between normal and ray
/// and by the inverse square of the distance. A view sees a point if its depth there is the point's within `tolerance_m`. `None` for points
/// that no view sees.
///
/// `rgb` gives the picture of view `i`, row by row, of the size of its depth map.
///
/// # Errors
/// If a view or a picture cannot be had or a picture has another size than its depth map.
pub fn point_colors(
    points: &[SurfacePoint],
    views: &(impl DepthViews + ?Sized),
    rgb: impl Fn(usize) -> Result<Vec<[u8; 3]>>,
    tolerance_m: f64,
) -> Result<Vec<Option<[u8; 3]>>> {
    Ok(sums_at(points, views, rgb, tolerance_m)?.iter().map(mean).collect())
}

fn mean(sum: &[f64; 4]) -> Option<[u8; 3]> {
    (sum[3] > 0.0).then(|| [0, 1, 2].map(|k| (sum[k] / sum[3]).round() as u8))
}

/// Weighted sums of red, green and blue, and of the weights.
fn sums_at(
    points: &[SurfacePoint],
    views: &(impl DepthViews + ?Sized),
    rgb: impl Fn(usize) -> Result<Vec<[u8; 3]>>,
    tolerance_m: f64,
) -> Result<Vec<[f64; 4]>> {
    let mut sums = vec![[0.0; 4]; points.len()];
    for i in 0..views.len() {
        let (map, picture) = (views.view(i)?, rgb(i)?);
        map.check()?;
        if picture.len() != map.depth_m.len() {
            return Err(Error::value(
                format!("picture {i} has {} pixels, its depth map {}", picture.len(), map.depth_m.len()),
                "give pictures of the depth maps' size",
            ));
        }
        let camera_from_world = map.world_from_camera.inverse();
        for (SurfacePoint { point, normal }, sum) in points.iter().zip(&mut sums) {
            let p = camera_from_world * point;
            let facing = -(camera_from_world * normal).dot(&p.coords.normalize());
            let Some(pixel) = pixel_of(&map, &p).filter(|_| facing > 0.0) else { continue };
            if (f64::from(map.depth_m[pixel]) - p.z).abs() > tolerance_m {
                continue;
            }
            let weight = facing.powi(4) / p.coords.norm_squared();
            for k in 0..3 {
                sum[k] += weight * f64::from(picture[pixel][k]);
            }
            sum[3] += weight;
        }
    }
    Ok(sums)
}

/// Index of the pixel that shows a point in camera axes.
fn pixel_of(map: &DepthMap, p: &Point3<f64>) -> Option<usize> {
    let c = &map.camera;
    let (u, v) = (c.fx_px * p.x / p.z + c.cx_px, c.fy_px * p.y / p.z + c.cy_px);
    let within = p.z > 0.0 && u >= 0.0 && v >= 0.0 && u < f64::from(c.width_px) && v < f64::from(c.height_px);
    within.then(|| v as usize * c.width_px as usize + u as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::{DepthCamera, cast_depth};
    use crate::shapes::sphere;
    use drex_core::Pose;

    #[test]
    fn points_have_the_colour_of_the_view_that_sees_them_and_others_none() {
        let mesh = sphere(0.05, 4);
        let camera =
            DepthCamera { width_px: 160, height_px: 160, fx_px: 200.0, fy_px: 200.0, cx_px: 80.0, cy_px: 80.0 };
        let from_below = [cast_depth(&mesh, &camera, &Pose::translation(0.0, 0.0, -0.3))];
        let points = drex_core::mesh::sample_surface(&mesh, 200, 7);
        let colors = point_colors(&points, from_below.as_slice(), |_| Ok(vec![[9, 8, 7]; 160 * 160]), 1e-3).unwrap();
        // A pixel shows what is up to a pixel beside it: near the rim that has another depth.
        for (p, c) in points.iter().zip(&colors) {
            match p.point.z {
                z if z < -0.03 => assert_eq!(*c, Some([9, 8, 7]), "{p:?}"),
                z if z > 0.0 => assert_eq!(*c, None, "{p:?}"),
                _ => {}
            }
        }
        let short = point_colors(&points, from_below.as_slice(), |_| Ok(vec![[0; 3]; 5]), 1e-3);
        assert!(short.unwrap_err().to_string().contains("picture 0 has 5 pixels"));
    }
}
