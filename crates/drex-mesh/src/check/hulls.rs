//! The rules for convex parts.

use drex_core::{ConvexPart, TriMesh};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::Outcome::{Fail, Pass};
use super::{CheckOptions, CheckReport};
use crate::bvh::{Aabb, Bvh};
use crate::hull::hull_volume;
use drex_core::mesh::{convex_hull, sample_surface};

/// Hulls with less volume are refused by engines, m³.
const SLIVER_M3: f64 = 1e-12;
/// A piece may miss this share of the volume of its convex hull.
const DENT: f64 = 1e-3;
/// Tolerance of containment, and the height below which a face is too narrow to have a plane, relative to the hull's size.
const FLATNESS: f64 = 1e-5;
/// Points at which hulls and visual mesh are compared, each way.
const PROBES: usize = 16_000;

/// Rule 12.
pub(super) fn evaluate(pieces: &[ConvexPart], options: &CheckOptions, report: &mut CheckReport) {
    // A primitive has no corners to count.
    let polyhedra = pieces.iter().filter(|p| p.primitive.is_none());
    let most = polyhedra.clone().map(|p| p.corners().len()).max().unwrap_or(0);
    let fix = Some("make the convex parts again");
    for (k, ConvexPart { hull: piece, .. }) in pieces.iter().enumerate() {
        let defect = if piece.vertices.len() < 4 || !(hull_volume(piece) > SLIVER_M3) {
            format!("{:.1e} m³ from {} corners", hull_volume(piece), piece.vertices.len())
        } else if !is_convex(piece) {
            "not convex or not closed".into()
        } else {
            continue;
        };
        return report.set(12, Fail, format!("hull {k} of {}: {defect}", pieces.len()), fix);
    }
    let reason = match pieces.len() - polyhedra.clone().count() {
        0 => format!("{} hulls, at most {most} corners", pieces.len()),
        primitives if primitives == pieces.len() => format!("{primitives} primitives"),
        primitives => format!("{} parts, {primitives} of them primitives, at most {most} corners", pieces.len()),
    };
    if pieces.is_empty() {
        report.set(12, Fail, "no hulls: nothing would touch it", fix);
    } else if most > options.most_corners || pieces.len() > options.most_parts {
        let reason = format!("{reason}; {} and {} are allowed", options.most_parts, options.most_corners);
        report.set(12, Fail, reason, fix);
    } else {
        report.set(12, Pass, reason, None);
    }
}

fn is_convex(piece: &TriMesh) -> bool {
    crate::topology::Topology::new(piece).open_edges == 0
        && convex_hull(&piece.vertices).is_ok_and(|hull| hull_volume(piece) >= (1.0 - DENT) * hull_volume(&hull))
}

/// A convex mesh as the planes of its faces.
pub(super) struct Planes {
    planes: Vec<(Vector3<f64>, f64)>,
    bounds: Aabb,
    tolerance: f64,
}

impl Planes {
    pub fn new(hull: &TriMesh) -> Self {
        let bounds = Aabb::of(&hull.vertices);
        let tolerance = FLATNESS * (bounds.hi - bounds.lo).norm();
        let planes = (0..hull.faces.len()).filter_map(|f| {
            let [a, b, c] = hull.triangle(f);
            let n = (b - a).cross(&(c - a));
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            // The neighbours of a needle bound the hull just as well.
            let normal = n.try_normalize(0.0).filter(|_| n.norm() > tolerance * longest)?;
            Some((normal, normal.dot(&a.coords)))
        });
        Self { planes: planes.collect(), bounds: bounds.fattened(tolerance), tolerance }
    }

    /// Whether a point lies inside, with a little tolerance.
    pub fn contain(&self, p: &Point3<f64>) -> bool {
        self.bounds.contains(&Aabb::of(&[*p]))
            && self.planes.iter().all(|(n, d)| n.dot(&p.coords) - d <= self.tolerance)
    }
}

/// Rule 13: the surface of the union of the pieces against the closed visual mesh, both ways.
pub(super) fn evaluate_distance(
    parts: &[ConvexPart],
    visual: &TriMesh,
    size: f64,
    options: &CheckOptions,
    report: &mut CheckReport,
) {
    let pieces: Vec<&TriMesh> = parts.iter().map(|p| &p.hull).collect();
    let out = union_to_mesh(&pieces, visual);
    let missing = mesh_to_union(&pieces, visual);
    let (Some(out), Some(missing)) = (out, missing) else {
        return report.set(13, Fail, "there is no surface to compare", Some("make the convex parts again"));
    };
    let mm = |d: &Spread| format!("{:.2} mm mean, {:.2} mm for 99 %", 1e3 * d.mean, 1e3 * d.p99);
    let reason = format!("hulls to mesh {}; mesh beyond the hulls {}", mm(&out), mm(&missing));
    match out.p99.max(missing.p99) <= options.hull_distance * size {
        true => report.set(13, Pass, reason, None),
        false => report.set(13, Fail, reason, Some("allow more convex parts or a finer resolution")),
    }
}

/// Mean and 99th percentile of distances, metres.
struct Spread {
    mean: f64,
    p99: f64,
}

impl Spread {
    fn of(mut distances: Vec<f64>) -> Option<Self> {
        distances.sort_by(f64::total_cmp);
        let p99 = *distances.get(distances.len() * 99 / 100)?;
        Some(Self { mean: distances.iter().sum::<f64>() / distances.len() as f64, p99 })
    }
}

/// Distance of the surface of the union (what of each piece is in no other one) from the mesh.
fn union_to_mesh(pieces: &[&TriMesh], mesh: &TriMesh) -> Option<Spread> {
    let area: f64 = pieces.iter().map(|p| p.area()).sum();
    let (tree, planes) = (Bvh::cut(mesh), pieces.iter().map(|p| Planes::new(p)).collect::<Vec<_>>());
    let probes: Vec<(usize, Point3<f64>)> = pieces
        .iter()
        .enumerate()
        .flat_map(|(k, piece)| {
            let n = (PROBES as f64 * piece.area() / area).ceil() as usize;
            sample_surface(piece, n.min(PROBES), k as u64).into_iter().map(move |s| (k, s.point))
        })
        .collect();
    let distance = |(k, p): &(usize, Point3<f64>)| {
        let hidden = planes.iter().enumerate().any(|(i, other)| i != *k && other.contain(p));
        let near = if hidden { None } else { tree.nearest(p, f64::INFINITY) };
        near.map(|n| n.distance_squared.sqrt())
    };
    Spread::of(probes.par_iter().filter_map(distance).collect())
}

/// How far the mesh sticks out of all pieces; 0 where a piece covers it.
fn mesh_to_union(pieces: &[&TriMesh], mesh: &TriMesh) -> Option<Spread> {
    let trees: Vec<(Planes, Bvh)> = pieces.iter().map(|p| (Planes::new(p), Bvh::new(p))).collect();
    let outside = |p: &Point3<f64>| {
        if trees.iter().any(|(planes, _)| planes.contain(p)) {
            return 0.0;
        }
        let near = trees.iter().filter_map(|(_, t)| t.nearest(p, f64::INFINITY)).map(|n| n.distance_squared);
        near.fold(f64::INFINITY, f64::min).sqrt()
    };
    let probes = sample_surface(mesh, PROBES, 0);
    Spread::of(probes.par_iter().map(|s| outside(&s.point)).collect())
}
