//! The rules for a mesh.

use drex_core::{MassProperties, TriMesh};
use nalgebra::{Point3, Vector3};

use super::Outcome::{Fail, NotApplicable, Pass, Repaired};
use super::{CheckOptions, CheckReport, hulls, scan};
use crate::topology::Topology;
use crate::{Asset, ClosingMethod, LengthUnit, RepairReport, asset_from_mesh, repair};
use drex_core::mesh::convex_hull;

/// An opening is harmless while two ways of closing it differ by less than this share of the volume.
const CLOSING_SPREAD: f64 = 0.05;
/// Hidden area below this share is a seam, above it a double skin.
const HIDDEN_AREA: f64 = 0.01;
/// Densities of solids, kg/m³: foam to the heaviest metals.
pub(super) const DENSITIES: std::ops::RangeInclusive<f64> = 20.0..=20_000.0;
/// Sizes beyond which volumes and inertias leave the range of numbers that can be compared, m.
const ANY_SIZE: std::ops::RangeInclusive<f64> = 1e-5..=1e4;
/// Sizes of things that a hand moves, m.
pub(super) const SIZES: std::ops::RangeInclusive<f64> = 1e-3..=2.0;

pub(super) fn evaluate_mesh(mesh: &TriMesh, options: &CheckOptions, report: &mut CheckReport) {
    let mut notes = Vec::new();
    let extent = mesh.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max());
    let (unit, factor) = match options.asset.unit.settle(extent, &mut notes) {
        Ok(found) => found,
        Err(e) => {
            report.set(9, Fail, e.to_string(), Some("state the unit of the file (m, cm, mm or in)"));
            (LengthUnit::Metre, 1.0)
        }
    };
    let (visual, repaired) = match repair(&mesh.scaled(factor), &options.asset.repair) {
        Ok(done) => done,
        Err(e) => {
            report.set(1, Fail, e.to_string(), Some("give a mesh of the whole surface of a solid"));
            return;
        }
    };
    scale(&visual, unit, options, &notes, report);
    surface(&visual, &repaired, report);
    report.set(15, NotApplicable, "no textures; a mesh names no other files", None);
    faces(visual.faces.len(), options, report);
    let size = visual.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max());
    if !ANY_SIZE.contains(&size) {
        return;
    }
    let mut settled = options.asset.clone();
    settled.unit = LengthUnit::Metre;
    match asset_from_mesh(&visual, &settled) {
        Ok(asset) => {
            solid(&asset, &repaired, report);
            body(&asset, options, &repaired, report);
        }
        Err(e) => report.set(1, Fail, e.to_string(), Some("give a mesh of the whole surface of a solid")),
    }
}

fn scale(visual: &TriMesh, unit: LengthUnit, options: &CheckOptions, notes: &[String], report: &mut CheckReport) {
    if report.rules[8].outcome == Fail {
        return;
    }
    let size = visual.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max());
    let across = format!("{:.1} mm across", 1e3 * size);
    if !SIZES.contains(&size) {
        report.set(9, Fail, across, Some("state another unit, or scale the mesh by a known distance"));
    } else if options.asset.unit == LengthUnit::Auto && unit != LengthUnit::Metre {
        let reason = format!("{}; then {across}", notes.join("; "));
        report.set(9, Repaired, reason, Some("write the file in metres or state its unit"));
    } else {
        report.set(9, Pass, across, None);
    }
}

/// Rules 2, 3, 4 and 6, and rule 1 for a mesh that was closed from the start.
pub(super) fn surface(visual: &TriMesh, r: &RepairReport, report: &mut CheckReport) {
    match r.open_edges_before {
        0 => report.set(1, Pass, format!("{} faces, every edge has one on both sides", r.faces), None),
        n => report.set(1, Repaired, format!("{n} open edges; {} small openings filled", r.filled_holes), None),
    }
    let twisted = Topology::new(visual).misaligned;
    match (twisted, r.flipped_faces) {
        (0, 0) => report.set(2, Pass, "all faces agree", None),
        (0, n) => report.set(2, Repaired, format!("{n} of {} faces turned round", r.faces), None),
        (n, _) => {
            let reason = format!("the surface has one side only: {n} edges whose faces disagree");
            report.set(2, Fail, reason, Some("cut the surface where it is twisted"));
        }
    }
    let counts = [
        (r.degenerate_faces, "degenerate faces removed"),
        (r.duplicate_faces, "duplicate faces removed"),
        (r.crowded_edges, "edges with more than two faces split"),
        (r.split_vertices, "vertices doubled where sheets meet"),
    ];
    let found: Vec<String> = counts.iter().filter(|c| c.0 > 0).map(|(n, what)| format!("{n} {what}")).collect();
    match found.is_empty() {
        true => report.set(3, Pass, "no such edge, vertex or face", None),
        false => report.set(3, Repaired, found.join(", "), None),
    }
    let lost: f64 = r.dropped.iter().map(|d| d.volume_share.unwrap_or(d.area_share)).sum();
    match (r.bodies, r.dropped.len()) {
        (1, 0) if r.shells > 1 => {
            report.set(
                4,
                Pass,
                format!("{} shells that touch, overlap or contain each other: one body", r.shells),
                None,
            );
        }
        (1, 0) => report.set(4, Pass, "one shell", None),
        (1, n) => report.set(4, Repaired, format!("{n} loose components with {:.2} % dropped", 100.0 * lost), None),
        (n, _) => report.set(4, Fail, format!("{n} separate bodies"), Some("give each body a file of its own")),
    }
    match r.self_intersections {
        0 => report.set(6, Pass, "no faces cross or touch", None),
        n => report.set(
            6,
            Repaired,
            format!("{n} pairs of faces cross or touch; volume and inertia are those of the union, the visual mesh keeps them"),
            None,
        ),
    }
}

/// Rules 1 (openings), 5 and 7.
fn solid(asset: &Asset, repaired: &RepairReport, report: &mut CheckReport) {
    let r = &asset.report;
    if r.open_edges > 0 {
        let reason = format!(
            "{} open edges; {} small openings filled, {} with flat lids ({:.0} % of the surface, {:.1} % of the volume depends on it)",
            repaired.open_edges_before,
            repaired.filled_holes,
            r.openings,
            100.0 * r.lid_area_share,
            100.0 * r.closing_spread
        );
        let fix = Some("scan the missing side, or close it in a mesh editor");
        report.set(1, if r.closing_spread > CLOSING_SPREAD { Fail } else { Repaired }, reason, fix);
    }
    match (repaired.cavities, r.hidden_area_share) {
        (0, hidden) if hidden <= HIDDEN_AREA => report.set(5, Pass, "none", None),
        (0, hidden) => report.set(
            5,
            Repaired,
            format!("{:.1} % of the surface lies inside the solid; it does not count", 100.0 * hidden),
            None,
        ),
        (n, _) => report.set(
            5,
            Fail,
            format!("{n} closed shells wound inwards inside another one"),
            Some("remove the inner shells if the object is solid; if it is hollow, state its mass"),
        ),
    }
    let corners: Vec<Point3<f64>> = asset.visual.vertices.clone();
    inertia(&asset.properties, &corners, report);
    if matches!(r.closing_method, ClosingMethod::Union) {
        report.rules[6].reason += "; of the union of overlapping parts";
    }
}

/// Rule 7.
pub(super) fn inertia(p: &MassProperties, surface: &[Point3<f64>], report: &mut CheckReport) {
    let moments = p.inertia.symmetric_eigenvalues();
    let shown = format!(
        "principal moments {:.3e}, {:.3e}, {:.3e} kg m²",
        moments.min(),
        moments.sum() - moments.min() - moments.max(),
        moments.max()
    );
    let inside = convex_hull(surface).is_ok_and(|hull| hulls::Planes::new(&hull).contain(&p.center_of_mass));
    let fix = Some("check that the mesh is closed and wound outwards");
    match (p.is_physical(), inside) {
        (true, true) => report.set(7, Pass, shown, None),
        (false, _) => report.set(7, Fail, format!("{shown}: not those of a body"), fix),
        (true, false) => {
            report.set(7, Fail, format!("the centre of mass {} is outside the hull", p.center_of_mass), fix);
        }
    }
}

/// Rules 8 and 10 to 14.
fn body(asset: &Asset, options: &CheckOptions, repaired: &RepairReport, report: &mut CheckReport) {
    let (mass, density) = (asset.properties.mass_kg, asset.report.density_kg_m3);
    let what = if options.asset.mass_kg.is_some() { "stated" } else { "from an assumed density" };
    let reason = format!("{:.1} g {what}, {density:.0} kg/m³; written out as inertia", 1e3 * mass);
    match DENSITIES.contains(&density) {
        true => report.set(8, Pass, reason, None),
        false => report.set(8, Fail, reason, Some("check the mass and the unit of length")),
    }
    let up = asset.up_in_mesh;
    let direction = format!("up is ({}, {}, {}) in the mesh", up.x, up.y, up.z);
    match options.asset.up_in_mesh {
        Some(_) => report.set(10, Pass, format!("{direction}; the pose at rest puts the lowest point at z = 0"), None),
        None => report.set(
            10,
            Repaired,
            format!("{direction} by assumption; the pose at rest puts the lowest point at z = 0"),
            Some("state the direction that points up"),
        ),
    }
    match repaired.flipped_faces == repaired.faces && repaired.faces > 0 {
        true => report.set(
            11,
            Repaired,
            "every face was wound inwards: turned round, but the shape may be a mirror image",
            Some("check that the export did not mirror an axis"),
        ),
        false => report.set(11, Pass, "no transform mirrors it", None),
    }
    hulls::evaluate(&asset.convex_parts, options, report);
    let size = asset.visual.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
    let closed = crate::close_openings(&asset.visual);
    hulls::evaluate_distance(&asset.convex_parts, &closed, size, options, report);
    scan::covered(&closed, &asset.convex_parts, report);
    let margin = asset.report.tipping_margin_m;
    rest(margin, report);
}

/// Rule 14, by how far inside the support polygon the centre of mass is.
pub(super) fn rest(margin_m: f64, report: &mut CheckReport) {
    let reason = format!(
        "by statics, not simulation: the centre of mass is {:.1} mm inside the support polygon",
        1e3 * margin_m
    );
    match margin_m > 0.0 {
        true => report.set(14, Pass, reason, None),
        false => report.set(
            14,
            Repaired,
            "by statics: it does not stand with this side up and will settle on another",
            Some("choose as up a direction in which it stands"),
        ),
    }
}

/// Rule 16 for one mesh.
pub(super) fn faces(n: usize, options: &CheckOptions, report: &mut CheckReport) {
    match n <= options.most_faces {
        true => report.set(16, Pass, format!("{n} faces"), None),
        false => {
            report.set(16, Fail, format!("{n} faces, more than {}", options.most_faces), Some("decimate the mesh"))
        }
    }
}

/// How far inside the support polygon of `points` (under gravity against `up`) the point `center` is, metres; negative outside.
/// Points up to a fiftieth of the width above the lowest one count: scans are not flat.
pub(super) fn support_margin(points: &[Point3<f64>], center: &Point3<f64>, up: &Vector3<f64>) -> f64 {
    let (side, height) = (up.cross(&Vector3::ith(up.iamin(), 1.0)).normalize(), |p: &Point3<f64>| p.coords.dot(up));
    let other = up.cross(&side);
    let lowest = points.iter().map(height).fold(f64::INFINITY, f64::min);
    let flat = |p: &Point3<f64>| [(p - center).dot(&side), (p - center).dot(&other)];
    let width = points.iter().map(flat).map(|[x, y]| x.hypot(y)).fold(0.0, f64::max);
    let feet: Vec<[f64; 2]> = points.iter().filter(|p| height(p) <= lowest + 0.02 * width).map(flat).collect();
    // The least reach over all directions.
    (0..720)
        .map(|k| {
            let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 720.0).sin_cos();
            feet.iter().map(|[x, y]| x * cos + y * sin).fold(f64::NEG_INFINITY, f64::max)
        })
        .fold(f64::INFINITY, f64::min)
}
