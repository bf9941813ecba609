//! The rules for convex pieces.

use drex_core::TriMesh;
use nalgebra::Point3;

use super::Outcome::{Fail, Pass};
use super::{CheckOptions, CheckReport};
use crate::bvh::Bvh;
use crate::hull::hull_volume;
use crate::sample_surface;

/// Hulls with less volume are refused by engines, m³.
const SLIVER_M3: f64 = 1e-12;
/// A corner may stick out of the hull's planes by this share of the hull's size.
const FLATNESS: f64 = 1e-6;
/// Points per hull at which the distance to the visual mesh is measured.
const PROBES: usize = 4000;

/// Rule 12.
pub(super) fn judge(pieces: &[TriMesh], options: &CheckOptions, report: &mut CheckReport) {
    let most = pieces.iter().map(|p| p.vertices.len()).max().unwrap_or(0);
    let fix = Some("make the convex pieces again");
    for (k, piece) in pieces.iter().enumerate() {
        let defect = if piece.vertices.len() < 4 || !(hull_volume(piece) > SLIVER_M3) {
            format!("{:.1e} m³ from {} corners", hull_volume(piece), piece.vertices.len())
        } else if !is_convex(piece) {
            "not convex or not closed".into()
        } else {
            continue;
        };
        return report.set(12, Fail, format!("hull {k} of {}: {defect}", pieces.len()), fix);
    }
    let reason = format!("{} hulls, at most {most} corners", pieces.len());
    if pieces.is_empty() {
        report.set(12, Fail, "no hulls: nothing would touch it", fix);
    } else if most > options.most_corners || pieces.len() > options.most_pieces {
        let reason = format!("{reason}; {} and {} are allowed", options.most_pieces, options.most_corners);
        report.set(12, Fail, reason, fix);
    } else {
        report.set(12, Pass, reason, None);
    }
}

fn is_convex(piece: &TriMesh) -> bool {
    let size = piece.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
    crate::topology::Topology::new(piece).open_edges == 0
        && piece.vertices.iter().all(|v| height_over(piece, v) <= FLATNESS * size)
}

/// Whether a point lies in a convex mesh, with a little tolerance.
pub(super) fn contains(hull: &TriMesh, p: &Point3<f64>) -> bool {
    let size = hull.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
    height_over(hull, p) <= FLATNESS * size
}

/// Largest signed distance of a point from the planes of a convex mesh: negative inside.
fn height_over(hull: &TriMesh, p: &Point3<f64>) -> f64 {
    (0..hull.faces.len())
        .filter_map(|f| {
            let [a, b, c] = hull.triangle(f);
            Some((p - a).dot(&(b - a).cross(&(c - a)).try_normalize(0.0)?))
        })
        .fold(f64::NEG_INFINITY, f64::max)
}

/// Rule 13: the surface of the union of the pieces against the closed visual mesh, both ways.
pub(super) fn judge_distance(
    pieces: &[TriMesh],
    visual: &TriMesh,
    size: f64,
    options: &CheckOptions,
    report: &mut CheckReport,
) {
    let out = union_to_mesh(pieces, visual);
    let missing = mesh_to_union(pieces, visual);
    let (Some(out), Some(missing)) = (out, missing) else {
        return report.set(13, Fail, "there is no surface to compare", Some("make the convex pieces again"));
    };
    let mm = |d: &Spread| format!("{:.2} mm mean, {:.2} mm for 99 %", 1e3 * d.mean, 1e3 * d.p99);
    let reason = format!("hulls to mesh {}; mesh beyond the hulls {}", mm(&out), mm(&missing));
    match out.p99.max(missing.p99) <= options.hull_distance * size {
        true => report.set(13, Pass, reason, None),
        false => report.set(13, Fail, reason, Some("allow more convex pieces or a finer resolution")),
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
fn union_to_mesh(pieces: &[TriMesh], mesh: &TriMesh) -> Option<Spread> {
    let area: f64 = pieces.iter().map(TriMesh::area).sum();
    let tree = Bvh::new(mesh);
    let mut distances = Vec::new();
    for (k, piece) in pieces.iter().enumerate() {
        let n = (PROBES as f64 * pieces.len() as f64 * piece.area() / area).ceil() as usize;
        for s in sample_surface(piece, n.min(PROBES * 4), k as u64) {
            let hidden = pieces.iter().enumerate().any(|(i, p)| i != k && contains(p, &s.point));
            if !hidden && let Some(near) = tree.nearest(&s.point, f64::INFINITY) {
                distances.push(near.distance_squared.sqrt());
            }
        }
    }
    Spread::of(distances)
}

/// How far the mesh sticks out of all pieces; 0 where a piece covers it.
fn mesh_to_union(pieces: &[TriMesh], mesh: &TriMesh) -> Option<Spread> {
    let trees: Vec<Bvh> = pieces.iter().map(Bvh::new).collect();
    let outside = |p: &Point3<f64>| {
        if pieces.iter().any(|piece| contains(piece, p)) {
            return 0.0;
        }
        let near = trees.iter().filter_map(|t| t.nearest(p, f64::INFINITY)).map(|n| n.distance_squared);
        near.fold(f64::INFINITY, f64::min).sqrt()
    };
    Spread::of(sample_surface(mesh, 4 * PROBES, 0).iter().map(|s| outside(&s.point)).collect())
}
