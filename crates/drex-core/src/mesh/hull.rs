//! Convex hulls of point sets.

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};

use super::TriMesh;

/// Points that stay within this fraction of their extent of one plane have no hull.
const FLAT: f64 = 1e-6;
/// Points nearer to a face of the hull than this fraction of the extent lie on it, for [`TriMesh::convex_hull`].
const ON_FACE: f64 = 1e-10;

/// A face of the growing hull.
struct Face {
    corners: [u32; 3],
    normal: Vector3<f64>,
    offset: f64,
}

impl TriMesh {
    /// The convex hull of `points`, outward, without the points inside it; `None` if they lie in a plane.
    pub fn convex_hull(points: &[Point3<f64>]) -> Option<Self> {
        let faces = convex_hull_faces(points, ON_FACE * extent(points)?)?;
        let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        let renumber = |v: u32| used.binary_search(&v).map_or(0, |k| k as u32);
        Some(Self {
            vertices: used.iter().map(|&v| points[v as usize]).collect(),
            faces: faces.iter().map(|f| f.map(renumber)).collect(),
        })
    }
}

/// Triangles of the convex hull of `points`, counter-clockwise from outside, as indices into `points`. A point less than
/// `tolerance_m` above a face counts as lying on it. `None` if the points lie in a plane.
///
/// Points are added one by one, each replacing the faces that it sees: meant for some thousand points.
pub fn convex_hull_faces(points: &[Point3<f64>], tolerance_m: f64) -> Option<Vec<[u32; 3]>> {
    let [a, b, c, d] = first_tetrahedron(points, tolerance_m.max(FLAT * extent(points)?))?;
    let face = |corners: [u32; 3]| {
        let [a, b, c] = corners.map(|v| points[v as usize]);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        Face { corners, normal, offset: normal.dot(&a.coords) }
    };
    let mut faces: Vec<Face> = [[a, b, c], [a, d, b], [b, d, c], [c, d, a]].into_iter().map(face).collect();
    for (i, p) in points.iter().enumerate() {
        let sees = |f: &Face| f.normal.dot(&p.coords) - f.offset > tolerance_m;
        if !faces.iter().any(sees) {
            continue;
        }
        let mut edges = BTreeSet::new();
        faces.retain(|f| {
            let seen = sees(f);
            if seen {
                let [a, b, c] = f.corners;
                edges.extend([(a, b), (b, c), (c, a)]);
            }
            !seen
        });
        // The horizon: edges of seen faces whose other side is not seen.
        faces.extend(edges.iter().filter(|(a, b)| !edges.contains(&(*b, *a))).map(|&(a, b)| face([a, b, i as u32])));
    }
    Some(faces.into_iter().map(|f| f.corners).collect())
}

/// Diagonal of the bounding box; `None` without points or with one that is not finite.
fn extent(points: &[Point3<f64>]) -> Option<f64> {
    let first = *points.first()?;
    let (lo, hi) = points.iter().fold((first, first), |(lo, hi), p| (lo.inf(p), hi.sup(p)));
    Some((hi - lo).norm()).filter(|e| e.is_finite())
}

/// Four points far apart, ordered so that the first three wind outwards; `None` if the points are flat.
fn first_tetrahedron(points: &[Point3<f64>], least: f64) -> Option<[u32; 4]> {
    let farthest = |measure: &dyn Fn(&Point3<f64>) -> f64| {
        let i = (0..points.len()).max_by(|&i, &j| measure(&points[i]).total_cmp(&measure(&points[j])))?;
        (measure(&points[i]) > least).then_some(i)
    };
    let a = 0;
    let b = farthest(&|p| (p - points[a]).norm())?;
    let along = (points[b] - points[a]).try_normalize(0.0)?;
    let c = farthest(&|p| along.cross(&(p - points[a])).norm())?;
    let normal = along.cross(&(points[c] - points[a])).try_normalize(0.0)?;
    let d = farthest(&|p| normal.dot(&(p - points[a])).abs())?;
    let below = normal.dot(&(points[d] - points[a])) < 0.0;
    let (b, c) = if below { (b, c) } else { (c, b) };
    Some([a as u32, b as u32, c as u32, d as u32])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Additive sequences: spread, reproducible, no generator needed.
    fn spread(n: usize) -> Vec<Point3<f64>> {
        let s = |k: usize, a: f64| (k as f64 * a.sqrt()).fract() - 0.5;
        (1..=n).map(|k| Point3::new(s(k, 2.0), s(k, 3.0), s(k, 5.0))).collect()
    }

    #[test]
    fn hull_of_a_filled_box_is_the_box() {
        let mut points = spread(500);
        for i in 0..8 {
            points.push(Point3::new((i & 1) as f64 - 0.5, (i >> 1 & 1) as f64 - 0.5, (i >> 2 & 1) as f64 - 0.5));
        }
        // Coplanar points on faces and edges, doubled corners.
        points.extend([Point3::new(0.5, 0.0, 0.0), Point3::new(0.5, 0.5, 0.1), Point3::new(0.5, 0.5, 0.5)]);
        let hull = TriMesh::convex_hull(&points).unwrap();
        assert!((hull.mass_properties(1.0).unwrap().mass_kg - 1.0).abs() < 1e-9);
    }

    /// A spiral on the unit ball: no two points alike.
    fn ball(n: usize) -> Vec<Point3<f64>> {
        let point = |k: usize| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / n as f64;
            let (sin, cos) = (2.4 * k as f64).sin_cos();
            Point3::from(Vector3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z))
        };
        (0..n).map(point).collect()
    }

    #[test]
    fn hull_of_points_on_a_ball_has_them_all() {
        let points: Vec<Point3<f64>> = ball(400).into_iter().map(|p| p * 0.3).collect();
        let hull = TriMesh::convex_hull(&points).unwrap();
        assert_eq!((hull.vertices.len(), hull.faces.len()), (400, 2 * 400 - 4));
        for f in 0..hull.faces.len() {
            let [a, b, c] = hull.triangle(f);
            let n = (b - a).cross(&(c - a)).normalize();
            assert!(points.iter().all(|p| n.dot(&(p - a)) < 1e-9));
        }
    }

    #[test]
    fn flat_and_empty_clouds_have_no_hull() {
        let flat: Vec<Point3<f64>> = spread(50).into_iter().map(|p| Point3::new(p.x, p.y, p.x + p.y)).collect();
        let line: Vec<Point3<f64>> = spread(50).into_iter().map(|p| Point3::new(p.x, p.x, p.x)).collect();
        for points in [flat, line, vec![], vec![Point3::origin(); 9], vec![Point3::new(f64::INFINITY, 0.0, 0.0); 5]] {
            assert!(TriMesh::convex_hull(&points).is_none());
        }
    }
}
