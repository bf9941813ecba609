//! How well convex parts stand for a solid.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

use drex_core::{ConvexPart, Surface, TriMesh};

use crate::bvh::Aabb;
use crate::hull::planes;
use crate::sdf::MeshSdf;
use crate::sequence::unit_cube_point;
use crate::{Error, Result};
use drex_core::mesh::sample_surface;

/// What [`union_distance`] measures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct UnionDistance {
    /// Mean distance from the surface of the pieces' union to the surface of the solid, metres.
    pub mean_m: f64,
    /// 99th percentile of that distance, metres.
    pub p99_m: f64,
    /// Largest distance sampled, metres.
    pub max_m: f64,
    /// Share of the solid's volume that is in no piece.
    pub uncovered_share: f64,
    /// Volume of the union relative to the solid's.
    pub volume_ratio: f64,
}

/// Compares the union of convex parts with the solid that `mesh` encloses (its boundary with lids over openings and
/// without walls inside).
///
/// `samples` points are spread by area over all pieces; those in another piece, or within 1e-5 of the diagonal of one, are no
/// surface of the union and do not count. As many points, spread evenly through the common bounding box, give the
/// volumes. The pieces must be convex and wound outwards. The same seed gives the same numbers.
///
/// # Errors
/// If there are no pieces or no samples, or the mesh encloses no volume.
pub fn union_distance(mesh: &TriMesh, parts: &[ConvexPart], samples: usize, seed: u64) -> Result<UnionDistance> {
    let solid = MeshSdf::new(mesh)?;
    let pieces: Vec<&TriMesh> = parts.iter().map(|p| &p.hull).collect();
    let area: f64 = pieces.iter().map(|p| p.area()).sum();
    if samples == 0 || !(area > 0.0) {
        return Err(Error::value("there is no union to measure", "give at least one piece and one sample"));
    }
    let (lo, hi) = solid.bounds();
    let bounds = pieces.iter().fold(Aabb { lo, hi }, |b, p| b.union(&Aabb::of(&p.vertices)));
    let size = bounds.hi - bounds.lo;
    let solids: Vec<Convex> = pieces.iter().map(|p| Convex::new(p, 1e-5 * size.norm())).collect();

    let points: Vec<(Point3<f64>, usize)> = pieces
        .iter()
        .enumerate()
        .flat_map(|(i, piece)| {
            let n = (samples as f64 * piece.area() / area).ceil() as usize;
            sample_surface(piece, n, seed.wrapping_add(i as u64)).into_iter().map(move |s| (s.point, i))
        })
        .collect();
    let mut distances: Vec<f64> = points
        .par_iter()
        .filter(|(p, own)| !solids.iter().enumerate().any(|(i, s)| i != *own && s.contains(p)))
        .map(|(p, _)| (solid.nearest(p).point - p).norm())
        .collect();
    distances.sort_by(f64::total_cmp);
    let n = distances.len();
    if n == 0 {
        return Err(Error::value("no sample lies on the surface of the union", "take more samples"));
    }

    let counts = (0..samples)
        .into_par_iter()
        .map(|i| {
            let p = bounds.lo + size.component_mul(&Vector3::from(unit_cube_point(i)));
            let (inside, covered) = (solid.contains(&p), solids.iter().any(|s| s.contains(&p)));
            [usize::from(inside), usize::from(covered), usize::from(inside && !covered)]
        })
        .reduce(|| [0; 3], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
    let share = |k: usize| counts[k] as f64 / counts[0].max(1) as f64;
    Ok(UnionDistance {
        mean_m: distances.iter().sum::<f64>() / n as f64,
        p99_m: distances[(0.99 * n as f64) as usize],
        max_m: distances[n - 1],
        uncovered_share: share(2),
        volume_ratio: share(1),
    })
}

/// A convex solid with its box.
struct Convex {
    bounds: Aabb,
    planes: Vec<(Vector3<f64>, f64)>,
    /// Points this far outside count as inside, metres.
    hair: f64,
}

impl Convex {
    fn new(hull: &TriMesh, hair: f64) -> Self {
        Self { bounds: Aabb::of(&hull.vertices).fattened(hair), planes: planes(hull), hair }
    }

    fn contains(&self, p: &Point3<f64>) -> bool {
        (0..3).all(|k| self.bounds.lo[k] <= p[k] && p[k] <= self.bounds.hi[k])
            && self.planes.iter().all(|(n, d)| n.dot(&p.coords) - d <= self.hair)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::cuboid;

    #[test]
    fn a_box_too_large_and_a_box_cut_in_two_have_known_scores() {
        let mesh = cuboid([0.0; 3], [0.1; 3]);
        let exact = [cuboid([0.0; 3], [0.04, 0.1, 0.1]), cuboid([0.04, 0.0, 0.0], [0.1; 3])].map(ConvexPart::of_hull);
        let d = union_distance(&mesh, &exact, 20_000, 3).unwrap();
        // The common face is no surface of the union.
        assert!(d.max_m < 1e-9 && d.uncovered_share == 0.0 && (d.volume_ratio - 1.0).abs() < 1e-3, "{d:?}");
        // One face 1 cm out, the frame around it on average half of that.
        let long = [ConvexPart::of_hull(cuboid([0.0; 3], [0.11, 0.1, 0.1]))];
        let d = union_distance(&mesh, &long, 50_000, 3).unwrap();
        let mean = (0.01 * 0.01 + 4.0 * 0.001 * 0.005) / (0.02 + 0.044);
        assert!((d.mean_m / mean - 1.0).abs() < 0.03, "{} {mean}", d.mean_m);
        assert!((d.max_m - 0.01).abs() < 1e-9 && (d.volume_ratio - 1.1).abs() < 0.01, "{d:?}");
        let half = union_distance(&mesh, &exact[1..], 20_000, 3).unwrap();
        assert!((half.uncovered_share - 0.4).abs() < 0.01 && (half.max_m - 0.04).abs() < 1e-3, "{half:?}");
    }

    #[test]
    fn nothing_to_measure_is_refused() {
        let mesh = cuboid([0.0; 3], [0.1; 3]);
        assert!(union_distance(&mesh, &[], 100, 0).is_err());
        assert!(union_distance(&mesh, &[ConvexPart::of_hull(mesh.clone())], 0, 0).is_err());
    }
}
