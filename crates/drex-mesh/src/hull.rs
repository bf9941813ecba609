//! Hulls of few corners, and what is measured on hulls.

use drex_core::TriMesh;
use drex_core::mesh::convex_hull;
use nalgebra::{Point3, Vector3};

use crate::bvh::Aabb;
use crate::{Error, Result};

/// A hull with at most `most` corners, all of them points of the full hull: from the points farthest out along the
/// axes, the point that sticks out farthest is added until none does or the bound is reached. It lies inside the full hull.
///
/// # Errors
/// As [`convex_hull`]; also if `most` is less than 4.
pub fn convex_hull_with_at_most(points: &[Point3<f64>], most: usize) -> Result<TriMesh> {
    if most < 4 {
        return Err(Error::value(format!("a hull cannot have only {most} corners"), "allow at least 4"));
    }
    let full = convex_hull(points)?;
    if full.vertices.len() <= most {
        return Ok(full);
    }
    let v = &full.vertices;
    let mut chosen: Vec<usize> = Vec::new();
    let far = |score: &dyn Fn(&Point3<f64>) -> f64| {
        (0..v.len()).fold(0, |best, i| if score(&v[i]) > score(&v[best]) { i } else { best })
    };
    for k in [2, 0, 1] {
        for s in [1.0, -1.0] {
            let i = far(&|p: &Point3<f64>| s * p[k]);
            if !chosen.contains(&i) && chosen.len() < most {
                chosen.push(i);
            }
        }
    }
    loop {
        let points: Vec<_> = chosen.iter().map(|&i| v[i]).collect();
        let next = match convex_hull(&points) {
            Ok(hull) => {
                let planes = planes(&hull);
                let out = |p: &Point3<f64>| {
                    planes.iter().map(|(n, d)| n.dot(&p.coords) - d).fold(f64::NEG_INFINITY, f64::max)
                };
                let i = far(&out);
                if chosen.len() >= most || chosen.contains(&i) || out(&v[i]) <= 0.0 {
                    return Ok(hull);
                }
                i
            }
            // The first corners may lie in one plane: the point farthest from them leads out of it.
            Err(_) => {
                let nearest =
                    |p: &Point3<f64>| points.iter().map(|q| (p - q).norm_squared()).fold(f64::INFINITY, f64::min);
                let i = far(&nearest);
                if chosen.len() >= most || chosen.contains(&i) {
                    return Ok(full);
                }
                i
            }
        };
        chosen.push(next);
    }
}

/// Planes n·x = d of the facets, n outwards and of unit length.
///
/// The normal of a thin facet is at the mercy of rounding: its plane is moved out until no corner is in front of it.
pub(crate) fn planes(hull: &TriMesh) -> Vec<(Vector3<f64>, f64)> {
    let bounds = Aabb::of(&hull.vertices);
    let size = (bounds.hi - bounds.lo).norm();
    let mut planes = Vec::with_capacity(hull.faces.len());
    for f in 0..hull.faces.len() {
        let [a, b, c] = hull.triangle(f);
        let n = (b - a).cross(&(c - a));
        let height = n.norm() / (b - a).norm().max((c - b).norm()).max((a - c).norm());
        if !(height > 1e-6 * size) {
            continue;
        }
        let n = n.normalize();
        let d = if height > 1e-3 * size {
            n.dot(&a.coords)
        } else {
            hull.vertices.iter().map(|p| n.dot(&p.coords)).fold(f64::NEG_INFINITY, f64::max)
        };
        planes.push((n, d));
    }
    planes
}

/// Volume of a hull around its own middle, m³.
pub(crate) fn hull_volume(hull: &TriMesh) -> f64 {
    hull.mass_properties(1.0).map_or(0.0, |m| m.mass_kg)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::sphere;

    #[test]
    fn a_hull_of_few_corners_fills_most_of_the_full_one() {
        let m = sphere(1.0, 4);
        let hull = convex_hull(&m.vertices).unwrap();
        assert_eq!((hull.vertices.len(), hull.faces.len()), (m.vertices.len(), m.faces.len()));
        let few = convex_hull_with_at_most(&m.vertices, 64).unwrap();
        assert_eq!(few.vertices.len(), 64);
        assert!(hull_volume(&few) > 0.87 * hull_volume(&hull), "{}", hull_volume(&few) / hull_volume(&hull));
        assert!(convex_hull_with_at_most(&sphere(1.0, 1).vertices, 3).is_err());
    }
}
