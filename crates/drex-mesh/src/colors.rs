//! Colours of a mesh from photos that have depth.

use nalgebra::{Point3, Vector3};

use drex_core::{SurfacePoint, TriMesh};

use crate::depth::{DepthMap, DepthViews};
use crate::{Error, Result};

/// Colour of each vertex: the mean over the views that see it, weighted by cos⁴ of the angle between normal and ray and by
/// the inverse square of the distance. A view sees a vertex if its depth there is the vertex's within `tolerance_m`.
/// Vertices that no view sees take the mean of their neighbours; grey if nothing is seen at all.
///
/// `rgb` gives the picture of view `i`, row by row, of the size of its depth map.
///
/// # Errors
/// If a view or a picture cannot be had or a picture has another size than its depth map.
pub fn vertex_colors(
    mesh: &TriMesh,
    views: &(impl DepthViews + ?Sized),
    rgb: impl Fn(usize) -> Result<Vec<[u8; 3]>>,
    tolerance_m: f64,
) -> Result<Vec<[u8; 3]>> {
    let vertices: Vec<SurfacePoint> = mesh
        .vertices
        .iter()
        .zip(vertex_normals(mesh))
        .map(|(point, normal)| SurfacePoint { point: *point, normal })
        .collect();
    let mut sums = sums_at(&vertices, views, rgb, tolerance_m)?;
    spread(mesh, &mut sums);
    Ok(sums.iter().map(|sum| mean(sum).unwrap_or([128; 3])).collect())
}

/// Colour of each of some points of a surface, as of the vertices by [`vertex_colors`]; `None` of those that no view sees.
///
/// # Errors
/// As [`vertex_colors`].
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

/// Unit normals, each the area-weighted mean of the faces round a vertex.
fn vertex_normals(mesh: &TriMesh) -> Vec<Vector3<f64>> {
    let mut normals = vec![Vector3::zeros(); mesh.vertices.len()];
    for (f, corners) in mesh.faces.iter().enumerate() {
        let [a, b, c] = mesh.triangle(f);
        let n = (b - a).cross(&(c - a));
        corners.iter().for_each(|&v| normals[v as usize] += n);
    }
    normals.iter().map(|n| n.try_normalize(0.0).unwrap_or_default()).collect()
}

/// Gives vertices without a colour the mean of their neighbours', ring by ring.
fn spread(mesh: &TriMesh, sums: &mut [[f64; 4]]) {
    loop {
        let mut next = vec![[0.0; 4]; sums.len()];
        for &[a, b, c] in &mesh.faces {
            for (to, from) in [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)] {
                let (to, from) = (to as usize, sums[from as usize]);
                if sums[to][3] == 0.0 && from[3] > 0.0 {
                    (0..3).for_each(|k| next[to][k] += from[k] / from[3]);
                    next[to][3] += 1.0;
                }
            }
        }
        let mut changed = false;
        for (sum, new) in sums.iter_mut().zip(next) {
            if new[3] > 0.0 {
                *sum = new;
                changed = true;
            }
        }
        if !changed {
            return;
        }
    }
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
    }

    #[test]
    fn each_side_has_the_colour_of_the_view_that_sees_it() {
        let mesh = sphere(0.05, 4);
        let camera =
            DepthCamera { width_px: 160, height_px: 160, fx_px: 200.0, fy_px: 200.0, cx_px: 80.0, cy_px: 80.0 };
        let view = |x: f64| {
            let eye = Point3::new(x, 0.0, 0.0);
            cast_depth(&mesh, &camera, &Pose::face_towards(&eye, &Point3::origin(), &Vector3::z()))
        };
        let views = vec![view(0.3), view(-0.3)];
        let colour = [[200, 10, 20], [10, 60, 220]];
        let colors = vertex_colors(&mesh, &views, |i| Ok(vec![colour[i]; 160 * 160]), 2e-3).unwrap();
        for (v, c) in mesh.vertices.iter().zip(&colors) {
            if v.x.abs() > 0.012 {
                assert_eq!(*c, colour[usize::from(v.x < 0.0)], "{v}");
            }
        }
        // The ring that neither camera sees is filled from both sides.
        assert!(colors.iter().all(|c| *c != [128; 3]));
        let short = vertex_colors(&mesh, &views, |_| Ok(vec![[0; 3]; 5]), 2e-3);
        assert!(short.unwrap_err().to_string().contains("picture 0 has 5 pixels"));
    }
}
