//! Fewer triangles for nearly the same surface.

mod collapse;
mod quadric;
mod track;

use nalgebra::Point3;
use rayon::prelude::*;
use serde::Serialize;

use drex_core::TriMesh;

use self::collapse::{Collapser, roundness};
use self::track::{Allowance, Tracker};
use crate::bvh::Bvh;
use crate::topology::Topology;
use crate::weld::compact;
use drex_core::mesh::sample_surface;

use crate::{Error, Result};

/// Points per direction at which the distance between input and result is measured, besides all vertices.
const PROBES: usize = 50_000;
/// Share of the allowed error that the collapses may use; the rest is for what lies between the points they watch.
const BUDGET: f64 = 0.9;
/// Radius, in allowed errors, around a point that went beyond it, in which the next try allows less.
const REACH: f64 = 4.0;
/// Attempts to keep the allowed error before the input is given back unchanged.
const TRIES: usize = 12;

/// Settings of [`decimate`]. At least one of the two targets is needed; with both, the first one reached ends it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DecimateOptions {
    /// Faces wanted. The result may have more where collapses would change the topology or flip faces.
    pub target_faces: Option<usize>,
    /// Largest distance between input and result, either way, metres.
    pub max_error_m: Option<f64>,
    /// Standard deviation of the faces' normals, radians: more gives rounder triangles and more even vertices, less follows
    /// flat parts and creases more closely.
    pub normal_noise: f64,
}

impl Default for DecimateOptions {
    fn default() -> Self {
        Self { target_faces: None, max_error_m: None, normal_noise: 1e-3 }
    }
}

/// What [`decimate`] did.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct DecimateReport {
    /// Faces in the input.
    pub faces_before: usize,
    /// Faces in the result.
    pub faces: usize,
    /// Vertices in the result.
    pub vertices: usize,
    /// Whether the targets that were given are kept: no more faces than wanted, no more error than allowed.
    pub reached: bool,
    /// Largest distance found between input and result, either way (Hausdorff, at all vertices and 50,000 random points of
    /// each), metres.
    pub error_m: f64,
    /// Mean of the mean distances at the random points, both ways, metres.
    pub mean_error_m: f64,
    /// Edges without a face on the other side, before.
    pub open_edges_before: usize,
    /// The same after.
    pub open_edges: usize,
    /// Roundness of the narrowest face, 4 √3 area / (sum of the squared sides): 1 for an equilateral one.
    pub least_roundness: f64,
    /// Standard deviation of the edges' lengths relative to their mean.
    pub edge_length_spread: f64,
}

/// Simplifies a mesh by collapsing edges in the order of their quadric error (Garland and Heckbert 1997, with the
/// probabilistic quadrics of Trettner and Kobbelt 2020), each to the point where the error is smallest.
///
/// The mesh should be welded ([`crate::repair()`]). A closed manifold mesh stays closed and manifold with the same genus
/// (link condition); rims of openings stay where they are as far as possible; no face turns over; edges with more than
/// two faces stay. With [`DecimateOptions::max_error_m`] each collapse is tested against the input: its vertices stay
/// within the allowed distance of the result, the faces of the result within that of the input, and the measured distance of
/// the result is at most that.
///
/// # Errors
/// If no target is given, a number is out of range, or the mesh is empty or refers to vertices that are not there.
pub fn decimate(mesh: &TriMesh, options: &DecimateOptions) -> Result<(TriMesh, DecimateReport)> {
    check(options)?;
    if mesh.faces.is_empty() {
        return Err(Error::Empty { subject: "the mesh".into() });
    }
    let mut input = TriMesh::new(mesh.vertices.clone(), mesh.faces.clone())?;
    compact(&mut input);
    let tree = Bvh::new(&input);
    let Some(most) = options.max_error_m else {
        let result = simplified(&input, options, None);
        let found = Distance::between(&input, &tree, &result, f64::INFINITY);
        return Ok(report(&input, result, options, &found));
    };
    let mut allowed = Allowance { mesh: &input, tree: &tree, at_face: vec![BUDGET * most; input.faces.len()] };
    for attempt in 1..=TRIES {
        let result = simplified(&input, options, Some(&allowed));
        let found = Distance::between(&input, &tree, &result, most);
        if found.beyond.is_empty() {
            return Ok(report(&input, result, options, &found));
        }
        // Where it went wrong the next try keeps much closer; elsewhere ever so slightly, as other collapses now come first.
        found.beyond.iter().for_each(|p| allowed.tighten(p, REACH * most));
        let everywhere = if attempt < TRIES / 2 { 0.97 } else { 0.7 };
        allowed.at_face.iter_mut().for_each(|a| *a *= everywhere);
    }
    let unchanged = input.clone();
    Ok(report(&input, unchanged, options, &Distance::default()))
}

fn check(options: &DecimateOptions) -> Result<()> {
    let remedy = "give a number of faces, a largest error in metres, or both";
    match (options.target_faces, options.max_error_m) {
        (None, None) => return Err(Error::value("decimation has no target", remedy)),
        (_, Some(e)) if !(e > 0.0 && e.is_finite()) => {
            return Err(Error::value(format!("the largest error is {e} m"), remedy));
        }
        _ => {}
    }
    if !(1e-6..=1.0).contains(&options.normal_noise) {
        return Err(Error::value(format!("the noise of the normals is {}", options.normal_noise), "give 1e-6 to 1"));
    }
    Ok(())
}

fn simplified(input: &TriMesh, options: &DecimateOptions, allowed: Option<&Allowance<'_>>) -> TriMesh {
    // Quadrics lose digits far from the origin.
    let Some((lo, hi)) = input.bounds() else { return input.clone() };
    let middle = nalgebra::center(&lo, &hi).coords;
    let mut centred = input.clone();
    centred.vertices.iter_mut().for_each(|v| *v -= middle);
    let mut tracker = allowed.map(|a| Tracker::new(a, middle));
    let mut collapser = Collapser::new(centred, options.normal_noise);
    collapser.run(options.target_faces.unwrap_or(0), tracker.as_mut());
    let mut out = collapser.mesh();
    out.vertices.iter_mut().for_each(|v| *v += middle);
    compact(&mut out);
    out
}

/// How far two meshes are from each other.
#[derive(Default)]
struct Distance {
    worst: f64,
    mean: f64,
    /// Points that are farther than allowed from the other mesh.
    beyond: Vec<Point3<f64>>,
}

impl Distance {
    /// At the vertices of both meshes (for the worst) and at random points.
    fn between(a: &TriMesh, tree_a: &Bvh, b: &TriMesh, most: f64) -> Self {
        let tree_b = Bvh::new(b);
        let mut out = Self::default();
        for (from, to) in [(a, &tree_b), (b, tree_a)] {
            let probes: Vec<Point3<f64>> = sample_surface(from, PROBES, 0).iter().map(|s| s.point).collect();
            for (points, share) in [(&from.vertices, 0.0), (&probes, 0.5 / probes.len().max(1) as f64)] {
                let distances: Vec<f64> = points
                    .par_iter()
                    .map(|p| to.nearest(p, f64::INFINITY).map_or(0.0, |n| n.distance_squared.sqrt()))
                    .collect();
                out.worst = distances.iter().copied().fold(out.worst, f64::max);
                out.mean += share * distances.iter().sum::<f64>();
                out.beyond.extend(points.iter().zip(&distances).filter(|(_, d)| **d > most).map(|(p, _)| *p));
            }
        }
        out
    }
}

fn report(input: &TriMesh, mesh: TriMesh, options: &DecimateOptions, found: &Distance) -> (TriMesh, DecimateReport) {
    let mut lengths = Vec::with_capacity(3 * mesh.faces.len());
    let mut least_roundness = 1.0_f64;
    for f in 0..mesh.faces.len() {
        let t = mesh.triangle(f);
        least_roundness = least_roundness.min(roundness(&t));
        lengths.extend((0..3).map(|k| (t[(k + 1) % 3] - t[k]).norm()));
    }
    let mean = lengths.iter().sum::<f64>() / lengths.len().max(1) as f64;
    let variance = lengths.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / lengths.len().max(1) as f64;
    let report = DecimateReport {
        faces_before: input.faces.len(),
        faces: mesh.faces.len(),
        vertices: mesh.vertices.len(),
        reached: options.target_faces.is_none_or(|n| mesh.faces.len() <= n)
            && options.max_error_m.is_none_or(|e| found.worst <= e),
        error_m: found.worst,
        mean_error_m: found.mean,
        open_edges_before: Topology::new(input).open_edges,
        open_edges: Topology::new(&mesh).open_edges,
        least_roundness,
        edge_length_spread: if mean > 0.0 { variance.sqrt() / mean } else { 0.0 },
    };
    (mesh, report)
}
