//! Points spread over a surface.

use nalgebra::Point3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{SurfacePoint, TriMesh};

/// `n` points spread over the mesh uniformly by area, with the normals of their faces. The same seed gives the same points.
///
/// A mesh without area gives no points.
pub fn sample_surface(mesh: &TriMesh, n: usize, seed: u64) -> Vec<SurfacePoint> {
    let mut sum = 0.0;
    let cumulative: Vec<f64> = (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.triangle(f);
            sum += (b - a).cross(&(c - a)).norm();
            sum
        })
        .collect();
    if !(sum > 0.0 && sum.is_finite()) {
        return Vec::new();
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n)
        .map(|_| {
            let pick = rng.random::<f64>() * sum;
            let f = cumulative.partition_point(|&c| c <= pick).min(mesh.faces.len() - 1);
            let [a, b, c] = mesh.triangle(f);
            // Uniform in a triangle: Osada et al., "Shape Distributions", 2002, section 4.1.
            let (r, s) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
            let point = Point3::from(a.coords * (1.0 - r) + b.coords * (r * (1.0 - s)) + c.coords * (r * s));
            SurfacePoint { point, normal: (b - a).cross(&(c - a)).normalize() }
        })
        .collect()
}

/// Indices of `n` of the points, each the farthest from those before it (Gonzalez 1985), starting with the one
/// farthest from their mean. All of them if there are no more than `n`.
pub fn farthest_points(points: &[Point3<f64>], n: usize) -> Vec<usize> {
    let n = n.min(points.len());
    if n == 0 {
        return Vec::new();
    }
    let mean = points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / points.len() as f64;
    let mut distance: Vec<f64> = points.iter().map(|p| (p.coords - mean).norm_squared()).collect();
    let mut chosen = Vec::with_capacity(n);
    let mut next = first_largest(&distance);
    distance.fill(f64::INFINITY);
    while chosen.len() < n {
        chosen.push(next);
        for (d, p) in distance.iter_mut().zip(points) {
            *d = d.min((p - points[next]).norm_squared());
        }
        next = first_largest(&distance);
    }
    chosen
}

fn first_largest(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, i| if values[i] > values[best] { i } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cuboid(lo: [f64; 3], hi: [f64; 3]) -> TriMesh {
        let corners = (0..8).map(|k| Point3::from([0, 1, 2].map(|a| if k >> a & 1 == 1 { hi[a] } else { lo[a] })));
        super::super::convex_hull(&corners.collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn samples_lie_on_the_surface_in_proportion_to_area() {
        let m = cuboid([0.0; 3], [1.0, 2.0, 3.0]);
        let s = sample_surface(&m, 20_000, 7);
        assert_eq!(s, sample_surface(&m, 20_000, 7));
        let top = s.iter().filter(|p| p.normal.z > 0.5).count() as f64 / 20_000.0;
        assert!((top - 2.0 / 22.0).abs() < 0.01, "{top}");
        assert!(s.iter().filter(|p| p.normal.z > 0.5).all(|p| (p.point.z - 3.0).abs() < 1e-12));
    }

    #[test]
    fn farthest_points_are_spread() {
        let points: Vec<_> = sample_surface(&cuboid([0.0; 3], [1.0; 3]), 2000, 1).iter().map(|s| s.point).collect();
        let chosen = farthest_points(&points, 60);
        let gap = |i: usize, from: &[usize]| {
            from.iter().map(|&j| (points[i] - points[j]).norm()).fold(f64::INFINITY, f64::min)
        };
        let gaps: Vec<f64> = (1..60).map(|k| gap(chosen[k], &chosen[..k])).collect();
        assert!(gaps.windows(2).all(|g| g[0] >= g[1]));
        // Every other point is closer to a chosen one than the last chosen one was.
        assert!((0..points.len()).all(|i| gap(i, &chosen) <= gaps[58]));
        assert_eq!(farthest_points(&points[..5], 9).len(), 5);
    }

    #[test]
    fn nothing_in_nothing_out() {
        assert!(sample_surface(&TriMesh::default(), 5, 0).is_empty());
        assert!(farthest_points(&[], 5).is_empty());
    }
}
