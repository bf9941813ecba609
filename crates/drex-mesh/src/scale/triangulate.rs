//! A point seen in several photos.

use drex_core::stats::upper_median;
use nalgebra::{Matrix3, Point2, Point3, Vector2, Vector3};

use drex_core::Pose;
use drex_core::camera::Camera;

use crate::{Error, Result};

/// Rays of one point that differ by less than this cannot tell its distance, radians.
const SMALLEST_ANGLE: f64 = 2e-3;
/// A sighting is never left out for being off by less than this, pixels: a careful click or detection is this good.
const ALWAYS_GOOD_PX: f64 = 2.0;
/// Photos from which pairs are tried as a start; more are thinned out evenly.
const MOST_STARTS: usize = 48;

/// A point seen in one photo.
#[derive(Debug, Clone, Copy)]
pub struct Sighting<'a> {
    /// The photo's camera.
    pub camera: &'a Camera,
    /// Where it stood, camera axes x right, y down, z forward.
    pub world_from_camera: Pose,
    /// Where the point appears, pixels; the centre of the first pixel is (0.5, 0.5).
    pub pixel: Point2<f64>,
}

/// A point found from its sightings.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Triangulated {
    /// The point, in the world of the cameras.
    pub point: Point3<f64>,
    /// Root mean square distance between the sightings that were used and the point's images, pixels.
    pub rms_px: f64,
    /// Sightings that were left out because they contradict the others.
    pub left_out: Vec<usize>,
}

/// Finds the point that several photos show.
///
/// The start is the pair of sightings whose point (the one nearest to both rays) has the least median reprojection error over
/// all (Rousseeuw 1984), so that up to half of the sightings may be wrong; sightings farther off than three robust
/// standard deviations and 2 pixels are left out; Gauss-Newton then minimises the reprojection error of the rest.
/// With three sightings one bad one is found if it contradicts the geometry; with two nothing can be checked but that.
///
/// # Errors
/// If there are fewer than two sightings, their rays are parallel, or the point would lie behind a camera.
pub fn triangulate(sightings: &[Sighting<'_>]) -> Result<Triangulated> {
    if sightings.len() < 2 {
        return Err(Error::value(
            format!("a point is seen in {} photos", sightings.len()),
            "mark it in at least two photos taken from different places",
        ));
    }
    let rays = sightings
        .iter()
        .enumerate()
        .map(|(i, s)| {
            let ray = s.camera.unproject(&s.pixel).ok_or_else(|| {
                Error::value(
                    format!("sighting {i} at pixel {:.1}, {:.1} has no ray through its lens", s.pixel.x, s.pixel.y),
                    "give pixels inside the photo, or calibrate the camera again",
                )
            })?;
            Ok((s.world_from_camera.translation.vector.into(), s.world_from_camera.rotation * ray))
        })
        .collect::<Result<Vec<(Point3<f64>, Vector3<f64>)>>>()?;

    let start = best_pair(sightings, &rays)?;
    let error = |p: &Point3<f64>, i: usize| residual(&sightings[i], p).map_or(f64::INFINITY, |r| r.norm());
    let spread = 1.4826 * upper_median((0..sightings.len()).map(|i| error(&start, i))).unwrap_or(0.0);
    let within = (3.0 * spread).max(ALWAYS_GOOD_PX);
    let (used, left_out): (Vec<usize>, Vec<usize>) = (0..sightings.len()).partition(|&i| error(&start, i) <= within);
    if used.len() < 2 || !parallax(&used.iter().map(|&i| rays[i].1).collect::<Vec<_>>()) {
        return Err(Error::value(
            format!("only {} of {} sightings agree on a point", used.len(), sightings.len()),
            "check that the mark has the same name in all photos",
        ));
    }
    let point = refine(sightings, &used, start);
    let sum: f64 = used.iter().map(|&i| error(&point, i).powi(2)).sum();
    Ok(Triangulated { point, rms_px: (sum / used.len() as f64).sqrt(), left_out })
}

fn best_pair(sightings: &[Sighting<'_>], rays: &[(Point3<f64>, Vector3<f64>)]) -> Result<Point3<f64>> {
    let stride = sightings.len().div_ceil(MOST_STARTS);
    let mut best: Option<(f64, Point3<f64>)> = None;
    let mut any_parallax = false;
    for i in (0..rays.len()).step_by(stride) {
        for j in (i + 1..rays.len()).step_by(stride) {
            if !parallax(&[rays[i].1, rays[j].1]) {
                continue;
            }
            any_parallax = true;
            let Some(p) = nearest_to_rays(&[rays[i], rays[j]]) else { continue };
            let errors = sightings.iter().map(|s| residual(s, &p).map_or(f64::INFINITY, |r| r.norm()));
            let m = upper_median(errors).unwrap_or(0.0);
            if m.is_finite() && best.is_none_or(|(b, _)| m < b) {
                best = Some((m, p));
            }
        }
    }
    best.map(|(_, p)| p).ok_or_else(|| {
        if any_parallax {
            Error::value(
                "the rays of the sightings meet behind the cameras",
                "check the poses (world_from_camera, z forward) and that the mark is the same in all photos",
            )
        } else {
            Error::value(
                "the rays of the sightings are parallel",
                "mark the point in photos taken from different directions",
            )
        }
    })
}

/// Whether two of the rays differ enough in direction.
fn parallax(rays: &[Vector3<f64>]) -> bool {
    rays.iter().any(|r| r.cross(&rays[0]).norm() > SMALLEST_ANGLE || r.dot(&rays[0]) < 0.0)
}

/// The point with the least sum of squared distances to the rays: Σ (1 - d dᵀ) x = Σ (1 - d dᵀ) o.
fn nearest_to_rays(rays: &[(Point3<f64>, Vector3<f64>)]) -> Option<Point3<f64>> {
    let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
    for (o, d) in rays {
        let across = Matrix3::identity() - d * d.transpose();
        a += across;
        b += across * o.coords;
    }
    a.cholesky().map(|c| c.solve(&b).into())
}

fn residual(s: &Sighting<'_>, p: &Point3<f64>) -> Option<Vector2<f64>> {
    s.camera.project(&s.world_from_camera.inverse_transform_point(p)).map(|q| q - s.pixel)
}

/// Gauss-Newton on the reprojection error, a step halved until it helps.
fn refine(sightings: &[Sighting<'_>], used: &[usize], start: Point3<f64>) -> Point3<f64> {
    let cost = |p: &Point3<f64>| -> f64 {
        used.iter().map(|&i| residual(&sightings[i], p).map_or(f64::INFINITY, |r| r.norm_squared())).sum()
    };
    let (mut p, mut c) = (start, cost(&start));
    for _ in 0..30 {
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for &i in used {
            let s = &sightings[i];
            let camera_from_world = s.world_from_camera.rotation.inverse().to_rotation_matrix();
            let local = s.world_from_camera.inverse_transform_point(&p);
            let Some((pixel, by_point)) = s.camera.project_with_jacobian(&local) else { continue };
            let j = by_point * camera_from_world.matrix();
            a += j.transpose() * j;
            b += j.transpose() * (pixel - s.pixel);
        }
        let Some(mut step) = a.cholesky().map(|f| -f.solve(&b)) else { break };
        let better = (0..8).find_map(|_| {
            let q = p + step;
            step *= 0.5;
            let cq = cost(&q);
            (cq < c).then_some((q, cq))
        });
        let Some((q, cq)) = better else { break };
        let done = c - cq <= 1e-14 * c;
        (p, c) = (q, cq);
        if done {
            break;
        }
    }
    p
}
