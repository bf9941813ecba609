//! From the marker's corners in posed photos to the scale of the scene, its up and an origin.

use drex_core::{Error, Result};
use nalgebra::{Matrix3, Point2, Point3, Similarity3, Translation3, Unit, Vector3};

use super::square::{Fitted, Square};
use super::{Marker, Sighting};

/// Photos that have to agree: of two, either may be wrong.
const MIN_PHOTOS: usize = 3;

/// How far a corner may be from where the others put it: pixels, and share of the longest edge in that photo.
const TOLERANCE: (f64, f64) = (2.0, 0.05);

/// Sine of the least angle between the rays of two photos that make a guess (about one degree).
const MIN_PARALLAX: f64 = 0.02;

/// Pairs of photos that are tried.
const MAX_PAIRS: usize = 3000;

/// Share of the main group's photos from which a second place of the marker is taken for a second marker.
const RIVAL_SHARE: f64 = 1.0 / 3.0;

/// Deviation from a square, and standard error of the scale, that are worth a warning.
const MAX_SPREAD: f64 = 0.01;
const DOUBTFUL_SIGMA: f64 = 0.005;

/// Standard error of the scale from which there is no answer.
const MAX_SIGMA: f64 = 0.05;

/// What the marker says about a scene.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct MarkerFit {
    /// From scene units to metres: origin at the marker's centre, z up from its face, x to the right of the upright marker.
    pub metric_from_scene: Similarity3<f64>,
    /// Metres per scene unit.
    pub scale: f64,
    /// Standard error of `scale`, metres per scene unit, as the scatter of the corners says. A side that was measured wrongly
    /// is not in it, nor what all corners share: detected ones are outside by 0.03 % of the size where cells are 4 px wide.
    pub scale_sigma: f64,
    /// The marker's normal towards the cameras, scene axes.
    pub up: Unit<Vector3<f64>>,
    /// The marker's centre in the scene.
    pub centre: Point3<f64>,
    /// Sightings that agree, by position in the list that was given; the others show it elsewhere.
    pub used: Vec<usize>,
    /// Root of the mean squared distance of a corner from the fitted square's, pixels.
    pub rms_px: f64,
    /// Largest deviation of the four edges and two diagonals from a square's, over their length, when each corner is
    /// triangulated on its own.
    pub spread: f64,
    /// A sentence for the user where the fit is doubtful.
    pub warning: Option<String>,
}

/// The scale, up and origin that the marker gives a scene: the photos that agree on a place (pairs as guesses, MSAC),
/// each corner triangulated by itself for the check, then one rigid square of unknown pose and size fitted to all corners by
/// least squares of reprojection errors with Huber's weights.
///
/// # Errors
/// If fewer than three photos see the marker or agree on its place, if they show it at two places, if they are too close to one
/// another to tell its size, or if they see its back (mirrored photos).
pub fn metric(sightings: &[Sighting], marker: &Marker) -> Result<MarkerFit> {
    let refuse = |what: String, remedy: &str| Err(Error::value(format!("marker {marker}: {what}"), remedy));
    if sightings.len() < MIN_PHOTOS {
        let photos = if sightings.len() == 1 { "photo sees" } else { "photos see" };
        return refuse(
            format!("{} {photos} it, {MIN_PHOTOS} are needed", sightings.len()),
            "check id and family, and take more photos in which all of it shows, larger than 30 pixels",
        );
    }
    let all: Vec<View<'_>> = sightings.iter().enumerate().filter_map(|(i, s)| View::new(i, s)).collect();
    let Some(group) = largest_group(&all) else {
        return refuse(
            format!("the {} photos that see it do not tell how far away it is", sightings.len()),
            "take photos of it from places farther apart",
        );
    };
    if group.len() < MIN_PHOTOS {
        return refuse(
            format!("of {} photos that see it at most {} agree on its place", sightings.len(), group.len()),
            "check that the marker and the object lay still together, and that only one marker has this id",
        );
    }
    let (corners, fitted, used) = match settle(&all, group) {
        Some(settled) => settled,
        None => {
            return refuse(
                "its corners in the photos do not make a square".into(),
                "take photos of it from places farther apart",
            );
        }
    };
    let others: Vec<View<'_>> = all.iter().filter(|v| !used.contains(&v.index)).cloned().collect();
    let rivals = largest_group(&others).map_or(0, |g| g.len());
    if rivals >= MIN_PHOTOS && rivals as f64 >= RIVAL_SHARE * used.len() as f64 {
        return refuse(
            format!("{} photos show it at one place and {rivals} at another", used.len()),
            "leave only one marker of this id, and do not move it between photos",
        );
    }
    let square = fitted.square;
    let up = Unit::new_normalize(square.scene_from_tag * Vector3::z());
    let centre = Point3::from(square.scene_from_tag.translation.vector);
    let before = all.iter().filter(|v| used.contains(&v.index) && up.dot(&(v.centre - centre)) > 0.0).count();
    if 2 * before <= used.len() {
        return refuse(
            format!("{} of {} photos see its back", used.len() - before, used.len()),
            "do not mirror photos, and give the corners clockwise as seen",
        );
    }
    if !(fitted.edge_sigma <= MAX_SIGMA) {
        return refuse(
            format!("its size in the scene is uncertain by {:.0} %", 100.0 * fitted.edge_sigma),
            "take photos of it from places farther apart",
        );
    }
    let scale = marker.side_m / square.edge;
    let spread = spread(&corners);
    let warning = if spread > MAX_SPREAD {
        Some(format!(
            "marker {marker}: its edges and diagonals are up to {:.1} % off a square; print it without stretching, fix it flat, \
             or take sharper photos of it",
            100.0 * spread
        ))
    } else if fitted.edge_sigma > DOUBTFUL_SIGMA {
        Some(format!(
            "marker {marker}: the scale from it is uncertain by {:.1} %; take more and closer photos of it",
            100.0 * fitted.edge_sigma
        ))
    } else {
        None
    };
    let tag_from_scene = square.scene_from_tag.rotation.inverse();
    let shift = Translation3::from(-(tag_from_scene * centre.coords) * scale);
    Ok(MarkerFit {
        metric_from_scene: Similarity3::from_parts(shift, tag_from_scene, scale),
        scale,
        scale_sigma: scale * fitted.edge_sigma,
        up,
        centre,
        used,
        rms_px: fitted.rms_px,
        spread,
        warning,
    })
}

/// A sighting with what is used of it again and again.
#[derive(Clone)]
struct View<'a> {
    index: usize,
    sighting: &'a Sighting,
    /// The camera's centre, scene.
    centre: Point3<f64>,
    /// Unit directions to the corners, scene axes.
    rays: [Vector3<f64>; 4],
    tolerance_px: f64,
}

impl<'a> View<'a> {
    /// `None` if a number is not finite or the lens has no ray for a corner.
    fn new(index: usize, sighting: &'a Sighting) -> Option<Self> {
        let world_from_camera = sighting.camera_from_world.inverse();
        let mut rays = [Vector3::zeros(); 4];
        for (ray, &pixel) in rays.iter_mut().zip(&sighting.corners) {
            *ray = world_from_camera * sighting.camera.unproject(&Point2::from(pixel))?;
        }
        let centre = Point3::from(world_from_camera.translation.vector);
        let finite = rays.iter().flatten().chain(centre.iter()).all(|v| v.is_finite());
        let longest = super::Detection { corners: sighting.corners }.longest_edge();
        let tolerance_px = TOLERANCE.0 + TOLERANCE.1 * longest;
        finite.then_some(Self { index, sighting, centre, rays, tolerance_px })
    }

    /// Largest distance of a corner from where these points appear, over the tolerance. Infinite where one does not.
    fn misfit(&self, corners: &[Point3<f64>; 4]) -> f64 {
        let (camera, pose) = (&self.sighting.camera, &self.sighting.camera_from_world);
        corners.iter().zip(self.sighting.corners).fold(0.0, |worst: f64, (corner, pixel)| {
            let error = camera.project(&(pose * corner)).map_or(f64::INFINITY, |at| (at - Point2::from(pixel)).norm());
            worst.max(error / self.tolerance_px)
        })
    }
}

/// The largest set of views that agree on the place of the corners, as positions in `views`, by the least sum of truncated
/// squared misfits over the guesses of pairs. `None` if no pair makes a guess.
fn largest_group(views: &[View<'_>]) -> Option<Vec<usize>> {
    let pairs: Vec<(usize, usize)> = (0..views.len()).flat_map(|i| (0..i).map(move |j| (j, i))).collect();
    // A stride that is no divisor of the number of views takes pairs of all of them.
    let stride = pairs.len().div_ceil(MAX_PAIRS).max(1) | 1;
    let mut best: Option<(f64, [Point3<f64>; 4])> = None;
    for (i, j) in pairs.into_iter().step_by(stride) {
        let Some(corners) = from_pair(&views[i], &views[j]) else { continue };
        let cost: f64 = views.iter().map(|v| v.misfit(&corners).powi(2).min(1.0)).sum();
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, corners));
        }
    }
    let (_, corners) = best?;
    Some((0..views.len()).filter(|&i| views[i].misfit(&corners) < 1.0).collect())
}

/// Corners half way between the nearest points of two rays each. `None` if the rays are nearly parallel.
fn from_pair(a: &View<'_>, b: &View<'_>) -> Option<[Point3<f64>; 4]> {
    let mut corners = [Point3::origin(); 4];
    for k in 0..4 {
        if a.rays[k].cross(&b.rays[k]).norm() < MIN_PARALLAX {
            return None;
        }
        corners[k] = nearest_to_rays([(&a.centre, &a.rays[k]), (&b.centre, &b.rays[k])].into_iter())?;
    }
    Some(corners)
}

/// The point with the least sum of squared distances from lines.
fn nearest_to_rays<'a>(rays: impl Iterator<Item = (&'a Point3<f64>, &'a Vector3<f64>)>) -> Option<Point3<f64>> {
    let (mut m, mut y) = (Matrix3::zeros(), Vector3::zeros());
    for (centre, ray) in rays {
        let across = Matrix3::identity() - ray * ray.transpose();
        m += across;
        y += across * centre.coords;
    }
    Some(Point3::from(m.cholesky()?.solve(&y))).filter(|p| p.iter().all(|v| v.is_finite()))
}

type Settled = ([Point3<f64>; 4], Fitted, Vec<usize>);

/// The corners each by itself, the square, and the views that agree with it; the set is chosen again until it stays.
fn settle(all: &[View<'_>], mut group: Vec<usize>) -> Option<Settled> {
    let mut settled = None;
    for _ in 0..5 {
        let views: Vec<&View<'_>> = group.iter().map(|&i| &all[i]).collect();
        let corners = triangulated(&views)?;
        let seen: Vec<&Sighting> = views.iter().map(|v| v.sighting).collect();
        let fitted = Square::through(&corners)?.fitted(&seen)?;
        let placed = fitted.square.corners();
        settled = Some((corners, fitted, views.iter().map(|v| v.index).collect()));
        let agreeing: Vec<usize> = (0..all.len()).filter(|&i| all[i].misfit(&placed) < 1.0).collect();
        if agreeing == group || agreeing.len() < MIN_PHOTOS {
            break;
        }
        group = agreeing;
    }
    settled
}

/// Each corner by itself: least squares of reprojection errors by the method of Gauss and Newton with Huber's weights.
fn triangulated(views: &[&View<'_>]) -> Option<[Point3<f64>; 4]> {
    let mut corners = [Point3::origin(); 4];
    for (k, corner) in corners.iter_mut().enumerate() {
        let mut x = nearest_to_rays(views.iter().map(|v| (&v.centre, &v.rays[k])))?;
        for _ in 0..10 {
            let (mut m, mut y) = (Matrix3::zeros(), Vector3::zeros());
            for v in views {
                let pose = &v.sighting.camera_from_world;
                let (at, by_camera) = v.sighting.camera.project_with_jacobian(&(pose * x))?;
                let j = by_camera * pose.rotation.to_rotation_matrix().matrix();
                let error = Point2::from(v.sighting.corners[k]) - at;
                let weight = (0.25 * v.tolerance_px / error.norm().max(1e-300)).min(1.0);
                m += j.transpose() * j * weight;
                y += j.transpose() * error * weight;
            }
            let step = m.cholesky()?.solve(&y);
            x += step;
            if step.norm() <= 1e-12 * (x.coords.norm() + 1.0) {
                break;
            }
        }
        *corner = x;
    }
    Some(corners)
}

/// Largest deviation of edges and diagonals from those of a square with the mean edge, over their length.
fn spread(corners: &[Point3<f64>; 4]) -> f64 {
    let edges = [0, 1, 2, 3].map(|i| (corners[(i + 1) % 4] - corners[i]).norm());
    let diagonals = [0, 1].map(|i| (corners[i + 2] - corners[i]).norm() / std::f64::consts::SQRT_2);
    let mean = edges.iter().sum::<f64>() / 4.0;
    edges.iter().chain(&diagonals).map(|e| (e / mean - 1.0).abs()).fold(0.0, f64::max)
}
