//! How far two surfaces are apart: accuracy, completeness, F-score.

use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use drex_core::TriMesh;

use crate::bvh::Bvh;
use crate::{Error, Result};
use drex_core::mesh::sample_surface;

/// Settings of [`compare_surfaces`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CompareOptions {
    /// Points on each of the two surfaces.
    pub samples: usize,
    /// Seed of the points.
    pub seed: u64,
    /// Distances at which the F-score is taken, metres.
    pub taus_m: Vec<f64>,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { samples: 100_000, seed: 0, taus_m: vec![0.5e-3, 1e-3, 2e-3] }
    }
}

/// Distances between a result and the truth, metres.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SurfaceComparison {
    /// Mean distance from points of the result to the truth.
    pub accuracy_m: f64,
    /// Mean distance from points of the truth to the result.
    pub completeness_m: f64,
    /// Half the sum of the two (Chamfer distance, L1).
    pub chamfer_m: f64,
    /// Distance that 99 % of the points of the result keep to the truth.
    pub accuracy_p99_m: f64,
    /// Distance that 99 % of the points of the truth keep to the result.
    pub completeness_p99_m: f64,
    /// Per tau: tau in metres and 2 p r / (p + r), where p is the share of points of the result closer than tau to the
    /// truth and r the share of points of the truth closer than tau to the result (Knapitsch et al., "Tanks and Temples", 2017).
    pub f_score: Vec<(f64, f64)>,
}

/// Compares two surfaces by points spread over each and their exact distances to the other. Nothing is aligned.
///
/// # Errors
/// If one of the meshes has no area, or no points are asked for.
pub fn compare_surfaces(result: &TriMesh, truth: &TriMesh, options: &CompareOptions) -> Result<SurfaceComparison> {
    let to_truth = distances(result, truth, options.samples, options.seed, "the result")?;
    let to_result = distances(truth, result, options.samples, options.seed.wrapping_add(1), "the truth")?;
    let mean = |d: &[f64]| d.iter().sum::<f64>() / d.len() as f64;
    let (accuracy_m, completeness_m) = (mean(&to_truth), mean(&to_result));
    let closer = |d: &[f64], tau: f64| d.partition_point(|&x| x < tau) as f64 / d.len() as f64;
    let f_score = options
        .taus_m
        .iter()
        .map(|&tau| {
            let (p, r) = (closer(&to_truth, tau), closer(&to_result, tau));
            (tau, if p + r > 0.0 { 2.0 * p * r / (p + r) } else { 0.0 })
        })
        .collect();
    Ok(SurfaceComparison {
        accuracy_m,
        completeness_m,
        chamfer_m: 0.5 * (accuracy_m + completeness_m),
        accuracy_p99_m: to_truth[to_truth.len() * 99 / 100],
        completeness_p99_m: to_result[to_result.len() * 99 / 100],
        f_score,
    })
}

/// Distances of `samples` points of one surface to another, ascending.
fn distances(from: &TriMesh, to: &TriMesh, samples: usize, seed: u64, name: &str) -> Result<Vec<f64>> {
    let points: Vec<Point3<f64>> = sample_surface(from, samples, seed).into_iter().map(|s| s.point).collect();
    if points.is_empty() {
        return Err(Error::value(
            format!("{samples} points cannot be spread over {name}"),
            "compare meshes that have area, with at least one point",
        ));
    }
    let tree = Bvh::new(to);
    let distance = |p| tree.nearest(p, f64::INFINITY).map_or(f64::INFINITY, |n| n.distance_squared.sqrt());
    let mut distances: Vec<f64> = points.par_iter().map(distance).collect();
    distances.sort_by(f64::total_cmp);
    Ok(distances)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, sphere};

    #[test]
    fn concentric_spheres_are_their_radii_apart() {
        let options = CompareOptions { samples: 5000, ..Default::default() };
        let c = compare_surfaces(&sphere(0.0508, 5), &sphere(0.05, 5), &options).unwrap();
        assert!((c.chamfer_m - 0.8e-3).abs() < 1e-5, "{c:?}");
        let f: Vec<f64> = c.f_score.iter().map(|f| f.1).collect();
        assert_eq!(f, [0.0, 1.0, 1.0]);
    }

    #[test]
    fn a_missing_part_costs_completeness_alone() {
        let whole = cuboid([0.0; 3], [0.1, 0.1, 0.1]);
        let mut part = whole.clone();
        part.faces.truncate(10); // without one of the six sides
        let c = compare_surfaces(&part, &whole, &CompareOptions { samples: 20_000, ..Default::default() }).unwrap();
        assert!(c.accuracy_m < 1e-12 && c.completeness_m > 1e-3);
        // Points of the missing side closer than tau to its rim: 1 - (1 - 2 tau / side)².
        let recall = |tau: f64| (5.0 + 1.0 - (1.0 - 20.0 * tau).powi(2)) / 6.0;
        for (tau, f) in c.f_score {
            let r = recall(tau);
            assert!((f - 2.0 * r / (1.0 + r)).abs() < 0.005, "{tau} {f}");
        }
        assert!(compare_surfaces(&TriMesh::default(), &whole, &CompareOptions::default()).is_err());
    }
}
