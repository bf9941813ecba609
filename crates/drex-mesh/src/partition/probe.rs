//! How much free space a hull fills, measured by rays that leave the solid along its normals.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use drex_core::{Surface, TriMesh};

use crate::bvh::Aabb;
use crate::hull::planes;
use crate::sdf::MeshSdf;
use drex_core::mesh::sample_surface;

/// A point of the solid's surface that looks outwards.
#[derive(Debug, Clone)]
pub(super) struct Probe {
    pub point: Point3<f64>,
    pub normal: Vector3<f64>,
    /// Free way along the normal up to the next surface, metres; infinite if there is none.
    free: f64,
}

/// Free space inside a hull.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fill {
    /// ∫ t + t³/τ² over the surface of the solid inside the hull, m³; t is the way along the normal that is inside the
    /// hull and outside the solid, τ the tolerance. The first term is the volume filled (where it is thin), the second weighs
    /// what is deep.
    pub cost: f64,
    /// Largest t, metres.
    pub depth: f64,
}

/// A cost is negligible if so much of the surface with depths of the tolerance causes it.
const NEGLIGIBLE_SHARE: f64 = 1e-3;

impl Fill {
    pub const NONE: Self = Self { cost: 0.0, depth: 0.0 };
}

/// Probes spread evenly over the surface of a solid.
#[derive(Debug, Clone)]
pub(super) struct Probes {
    pub all: Vec<Probe>,
    /// Area that each stands for, m².
    area: f64,
    tolerance: f64,
    /// Points this far outside a hull count as inside, metres.
    hair: f64,
}

impl Probes {
    pub fn new(solid: &MeshSdf, count: usize, tolerance: f64, seed: u64) -> Self {
        let (lo, hi) = solid.bounds();
        let size = (hi - lo).norm();
        let samples = sample_surface(solid.boundary(), count, seed);
        let area = solid.boundary().area() / samples.len().max(1) as f64;
        let all = samples
            .into_par_iter()
            .filter_map(|s| {
                // Faces of scans that look into the solid say nothing about free space.
                let start = s.point + s.normal * (1e-5 * size);
                let hit =
                    || solid.ray_cast(&start, &s.normal, size).map_or(f64::INFINITY, |h| (h.point - start).norm());
                (!solid.contains(&start)).then(|| Probe { point: s.point, normal: s.normal, free: hit() })
            })
            .collect();
        Self { all, area, tolerance, hair: 1e-5 * size }
    }

    /// The probes inside the box of a hull.
    pub fn near(&self, hull: &TriMesh) -> Vec<u32> {
        let b = Aabb::of(&hull.vertices).fattened(self.hair);
        let inside = |p: &Point3<f64>| (0..3).all(|k| b.lo[k] <= p[k] && p[k] <= b.hi[k]);
        (0..self.all.len() as u32).filter(|&i| inside(&self.all[i as usize].point)).collect()
    }

    /// A cost that says nothing: scans have crumbs and folds.
    pub fn negligible(&self) -> f64 {
        NEGLIGIBLE_SHARE * self.area * self.all.len() as f64 * self.tolerance
    }

    /// Free space that a hull fills, as seen by some of the probes.
    pub fn fill(&self, hull: &TriMesh, probes: &[u32]) -> Fill {
        let planes = planes(hull);
        let mut depths = Vec::with_capacity(probes.len());
        'probes: for &i in probes {
            let probe = &self.all[i as usize];
            let mut depth = probe.free;
            for (n, d) in &planes {
                let below = d - n.dot(&probe.point.coords);
                if below < -self.hair {
                    continue 'probes;
                }
                let rate = n.dot(&probe.normal);
                if depth * rate > below {
                    depth = below.max(0.0) / rate;
                }
            }
            // A probe in no facet's way is a hull without facets.
            depths.push(if depth.is_finite() { depth } else { 0.0 });
        }
        let cost = depths.iter().map(|t| t + t.powi(3) / self.tolerance.powi(2)).sum::<f64>() * self.area;
        Fill { cost, depth: depths.into_iter().fold(0.0, f64::max) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, joined};
    use drex_core::mesh::convex_hull;

    #[test]
    fn a_hull_over_a_slot_fills_as_deep_as_the_slot_is_wide_or_deep() {
        // Two blocks 2 cm apart: the rays go from one to the other.
        let blocks = joined(&[cuboid([0.0; 3], [0.04, 0.1, 0.1]), cuboid([0.06, 0.0, 0.0], [0.1, 0.1, 0.1])]);
        let solid = MeshSdf::new(&blocks).unwrap();
        let probes = Probes::new(&solid, 2000, 0.02, 1);
        let hull = convex_hull(&blocks.vertices).unwrap();
        let fill = probes.fill(&hull, &probes.near(&hull));
        assert!((fill.depth - 0.02).abs() < 1e-5, "{fill:?}");
        // Both walls of 100 cm² see 2 cm: t + t³/τ² is 4 cm there.
        let share = 0.02 / blocks.area();
        let sampling = 3.0 * (share * (1.0 - share) / 2000.0_f64).sqrt() * blocks.area() * 0.04;
        assert!((fill.cost - 0.02 * 0.04).abs() < sampling, "{fill:?} {sampling}");
        // A block alone fills nothing.
        let one = cuboid([0.0; 3], [0.04, 0.1, 0.1]);
        assert!(probes.fill(&one, &probes.near(&one)).cost < 1e-12);
    }
}
