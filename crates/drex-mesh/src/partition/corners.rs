//! Hulls with few corners.

use nalgebra::{Point3, Vector3};

use drex_core::TriMesh;
use drex_core::mesh::nearest_on_triangle;

use crate::Result;
use crate::hull::convex_hull_with_at_most;
use drex_core::mesh::{convex_hull, sample_surface};

/// Points of the full hull to which a hull of few corners is fitted.
const SAMPLES: usize = 1500;
/// Steps of the fit.
const STEPS: usize = 6;

/// A hull of at most `most` corners that lies on the hull of the points as closely as that many corners allow.
///
/// The corners are first those points that stick out farthest ([`convex_hull_with_at_most`]); that hull lies inside the full
/// one. Its corners then move along the error seen from samples of the full hull, so that what sticks out and what is left
/// out balance.
///
/// # Errors
/// As [`convex_hull_with_at_most`].
pub(super) fn bounded_hull(points: &[Point3<f64>], most: usize) -> Result<TriMesh> {
    let full = convex_hull(points)?;
    if full.vertices.len() <= most {
        return Ok(full);
    }
    let mut best = convex_hull_with_at_most(&full.vertices, most)?;
    let samples: Vec<Point3<f64>> = sample_surface(&full, SAMPLES, 1).iter().map(|s| s.point).collect();
    let mut least = fit(&best, &samples).0;
    let mut hull = best.clone();
    for _ in 0..STEPS {
        let (_, moves) = fit(&hull, &samples);
        let moved: Vec<Point3<f64>> = hull.vertices.iter().zip(moves).map(|(p, m)| p + m).collect();
        hull = convex_hull(&moved)?;
        let error = fit(&hull, &samples).0;
        if error >= least {
            break;
        }
        (best, least) = (hull.clone(), error);
    }
    Ok(best)
}

/// Sum of squared distances of the samples from a hull's surface, and how far each corner should move: the mean offset of
/// the samples near it, weighted by barycentric coordinates.
fn fit(hull: &TriMesh, samples: &[Point3<f64>]) -> (f64, Vec<Vector3<f64>>) {
    let mut moves = vec![(Vector3::zeros(), 0.0); hull.vertices.len()];
    let mut sum = 0.0;
    for p in samples {
        let mut nearest = (f64::INFINITY, 0, *p);
        for f in 0..hull.faces.len() {
            let q = nearest_on_triangle(p, &hull.triangle(f));
            let d = (p - q).norm_squared();
            if d < nearest.0 {
                nearest = (d, f, q);
            }
        }
        let (d, f, q) = nearest;
        sum += d;
        let [a, b, c] = hull.triangle(f);
        let area = |u: Point3<f64>, v: Point3<f64>| (u - q).cross(&(v - q)).norm();
        let weights = [area(b, c), area(c, a), area(a, b)];
        let total: f64 = weights.iter().sum();
        if !(total > 0.0) {
            continue;
        }
        for (&v, w) in hull.faces[f].iter().zip(weights) {
            moves[v as usize].0 += (p - q) * (w / total);
            moves[v as usize].1 += w / total;
        }
    }
    (sum, moves.into_iter().map(|(m, w)| if w > 0.0 { m / w } else { m }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hull::hull_volume;
    use crate::shapes::sphere;

    #[test]
    fn few_corners_are_fitted_so_that_errors_balance() {
        let ball = sphere(0.05, 4);
        let inner = convex_hull_with_at_most(&ball.vertices, 64).unwrap();
        let fitted = bounded_hull(&ball.vertices, 64).unwrap();
        assert!(fitted.vertices.len() <= 64);
        let error = |h: &TriMesh| (hull_volume(h) / hull_volume(&ball) - 1.0).abs();
        assert!(error(&inner) > 0.05 && error(&fitted) < 0.02, "{} {}", error(&inner), error(&fitted));
        let few = sphere(0.05, 1);
        assert_eq!(bounded_hull(&few.vertices, 64).unwrap().vertices.len(), 18);
    }
}
