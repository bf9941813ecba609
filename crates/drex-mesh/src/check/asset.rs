//! The rules for an asset on disk: what is judged is what is in the files.

use std::path::{Path, PathBuf};

use drex_core::fsutil::read_text;
use drex_core::{ConvexPart, MassProperties, Primitive, TriMesh};
use nalgebra::{Point3, Vector3};

use super::Outcome::{Fail, NotApplicable, Pass, Repaired};
use super::mjcf::{Geom, Mjcf, parse};
use super::{CheckOptions, CheckReport, ScanEvidence, hulls, rules, scan};
use crate::{Result, close_openings, read_mesh, repair, solid_properties};

/// Heights within this of the plane are on it, m.
const ON_PLANE_M: f64 = 1e-3;

/// Judges an asset: an MJCF file, or a folder with `asset/object.xml` or `object.xml` in it.
///
/// Nothing is repaired here; "repaired" says of a defect of the visual mesh that it harms neither mass nor contact.
///
/// # Errors
/// If there is no MJCF file, or it or a mesh it names cannot be read.
pub fn check_asset(path: &Path, options: &CheckOptions) -> Result<CheckReport> {
    let path = model_in(path)?;
    let model = parse(&path, &read_text(&path)?)?;
    let mut report = CheckReport::new(path.display().to_string());
    paths(&model, &mut report);
    if report.rules[14].outcome == Fail {
        return Ok(report);
    }
    let (visual, hulls) = (visual_mesh(&model)?, convex_parts(&model)?);
    right_handed(&model, &mut report);
    names(&model, &visual, options, &mut report)?;
    if visual.faces.is_empty() {
        report.set(1, Fail, "no visual mesh on a body", Some("give the body a mesh geom without contacts"));
    } else {
        surface(&visual, options, &mut report);
        mass(&model, &visual, &mut report);
    }
    hulls::evaluate(&hulls, options, &mut report);
    let size = visual.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
    if model.unclear.is_empty() {
        let closed = close_openings(&visual);
        hulls::evaluate_distance(&hulls, &closed, size, options, &mut report);
        scan::covered(&closed, &hulls, &mut report);
        pose(&model, &hulls, &mut report);
    } else {
        for rule in [10, 13, 14, 17] {
            report.set(rule, NotApplicable, format!("not judged: the model has {}", model.unclear.join(", ")), None);
        }
    }
    if let Some(evidence) = evidence_beside(&path)? {
        scan::evaluate(&in_mesh_frame(&model)?, &evidence, &mut report);
    }
    Ok(report)
}

/// What `mesh/scan.json` of the asset's folder says of the scan, if the asset was made of one.
fn evidence_beside(model: &Path) -> Result<Option<ScanEvidence>> {
    #[derive(serde::Deserialize)]
    struct ScanFile {
        evidence: Option<ScanEvidence>,
    }
    let file = model.parent().and_then(Path::parent).map(|twin| twin.join("mesh/scan.json"));
    let Some(file) = file.filter(|f| f.is_file()) else { return Ok(None) };
    let found: ScanFile = drex_core::fsutil::from_json(&file, &read_text(&file)?)?;
    Ok(found.evidence)
}

fn model_in(path: &Path) -> Result<PathBuf> {
    if !path.is_dir() {
        return Ok(path.to_path_buf());
    }
    let found = ["asset/object.xml", "object.xml"].iter().map(|n| path.join(n)).find(|p| p.is_file());
    found.ok_or_else(|| {
        let what = "there is neither asset/object.xml nor object.xml in it";
        drex_core::Error::content(path, None, what, "make the asset first, or name its MJCF file").into()
    })
}

/// Rule 15.
fn paths(model: &Mjcf, report: &mut CheckReport) {
    let fix = Some("name files relative to the model and keep them together");
    for (file, folder) in &model.files {
        // A drive letter makes a path absolute elsewhere.
        if Path::new(file).is_absolute() || file.contains(':') || file.starts_with('\\') {
            return report.set(15, Fail, format!("{file:?} is an absolute path"), fix);
        }
        if !folder.join(file).is_file() {
            return report.set(15, Fail, format!("{file:?} is not there"), fix);
        }
    }
    report.set(15, Pass, format!("{} files, relative and present", model.files.len()), None);
}

/// Rule 11.
fn right_handed(model: &Mjcf, report: &mut CheckReport) {
    match model.meshes.iter().find(|(_, m)| !(m.scale.product() > 0.0)) {
        None => report.set(11, Pass, "rotations are quaternions, no scale mirrors a mesh", None),
        Some((name, m)) => {
            let reason = format!("mesh {name:?} is scaled by {} {} {}", m.scale.x, m.scale.y, m.scale.z);
            report.set(11, Fail, reason, Some("mirror the mesh file itself and turn its faces"));
        }
    }
}

/// Rule 16.
fn names(model: &Mjcf, visual: &TriMesh, options: &CheckOptions, report: &mut CheckReport) -> Result<()> {
    let mut largest = visual.faces.len();
    for g in &model.geoms {
        largest = largest.max(read(model, g)?.faces.len());
    }
    rules::faces(largest, options, report);
    if !model.repeated.is_empty() {
        let reason = format!("twice the same name: {}", model.repeated.join(", "));
        report.set(16, Fail, reason, Some("give each element a name of its own"));
    }
    Ok(())
}

/// Rules 1 to 6 and 9, on the visual mesh.
fn surface(visual: &TriMesh, options: &CheckOptions, report: &mut CheckReport) {
    let Ok((_, found)) = repair(visual, &options.asset.repair) else {
        return report.set(1, Fail, "the visual mesh has no area", Some("make the asset again"));
    };
    let twisted = found.flipped_faces;
    rules::surface(visual, &found, report);
    let again = Some("make the asset again from the repaired mesh");
    if found.open_edges_before > 0 {
        let reason =
            format!("{} open edges in the visual mesh; mass and hulls are of their own", found.open_edges_before);
        report.set(1, Repaired, reason, None);
    }
    if twisted > 0 {
        report.set(2, Fail, format!("{twisted} faces of the visual mesh are wound the wrong way"), again);
    }
    if found.degenerate_faces + found.duplicate_faces > 0 {
        let reason = format!("{} degenerate, {} duplicate faces", found.degenerate_faces, found.duplicate_faces);
        report.set(3, Fail, reason, again);
    } else if found.crowded_edges + found.split_vertices > 0 {
        let reason = format!("sheets of the visual mesh meet at {} edges", found.crowded_edges);
        report.set(3, Repaired, reason, None);
    }
    if !found.dropped.is_empty() {
        report.set(4, Fail, format!("{} loose components in the visual mesh", found.dropped.len()), again);
    }
    match found.cavities {
        0 => report.set(5, Pass, "no cavities", None),
        n => report.set(5, Fail, format!("{n} closed shells inside another one"), again),
    }
    let size = visual.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max());
    let across = format!("{:.1} mm across", 1e3 * size);
    match rules::SIZES.contains(&size) {
        true => report.set(9, Pass, across, None),
        false => report.set(9, Fail, across, Some("make the asset again with the right unit")),
    }
}

/// Rules 7 and 8: every body with meshes has its own inertia, and all together the density of a solid.
fn mass(model: &Mjcf, visual: &TriMesh, report: &mut CheckReport) {
    let mut total = 0.0;
    for (k, body) in model.bodies.iter().enumerate() {
        let geoms: Vec<&Geom> = model.geoms.iter().filter(|g| g.body == k).collect();
        if geoms.is_empty() {
            continue;
        }
        let Some(p) = body.inertial else {
            let reason = format!("body {:?} has no <inertial>: it would be inferred from overlapping hulls", body.name);
            report.set(7, NotApplicable, reason.clone(), None);
            return report.set(8, Fail, reason, Some("write mass, centre and inertia of the solid"));
        };
        total += p.mass_kg;
        let inverse = body.world_from_body.inverse();
        let corners: Vec<Point3<f64>> = visual.vertices.iter().map(|v| inverse * v).collect();
        if report.rules[6].outcome != Fail {
            rules::inertia(&p, &corners, report);
        }
    }
    let Ok(solid) = solid_properties(visual) else {
        return report.set(8, Fail, "the visual mesh encloses no volume", Some("make the asset again"));
    };
    let density = total / solid.volume_m3;
    let reason = format!("{:.1} g, {density:.0} kg/m³, written out", 1e3 * total);
    match rules::DENSITIES.contains(&density) {
        true => report.set(8, Pass, reason, None),
        false => report.set(8, Fail, reason, Some("check the mass and the unit of length")),
    }
}

/// Rules 10 and 14, in the world frame: MJCF's up is +z.
fn pose(model: &Mjcf, hulls: &[ConvexPart], report: &mut CheckReport) {
    let points: Vec<Point3<f64>> = hulls.iter().flat_map(ConvexPart::corners).copied().collect();
    let lowest = points.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    let parts: Vec<MassProperties> = model
        .bodies
        .iter()
        .enumerate()
        .filter(|(k, _)| model.geoms.iter().any(|g| g.body == *k))
        .filter_map(|(_, b)| b.inertial.map(|p| p.transformed(&b.world_from_body)))
        .collect();
    let Some(all) = MassProperties::combined(&parts) else { return };
    let centred = all.center_of_mass.coords.norm() <= ON_PLANE_M;
    let height = format!("+z is up, the lowest point is at z = {:.2} mm", 1e3 * lowest);
    match lowest.abs() <= ON_PLANE_M || centred {
        true => report.set(10, Pass, height, None),
        false => {
            report.set(10, Fail, height, Some("put the object on the plane z = 0, or its centre of mass at the origin"))
        }
    }
    if lowest < -ON_PLANE_M {
        let reason = format!("by statics: it begins {:.2} mm inside the plane z = 0", -1e3 * lowest);
        return report.set(14, Fail, reason, Some("raise the body"));
    }
    rules::rest(rules::support_margin(&points, &all.center_of_mass, &Vector3::z()), report);
}

fn primitive(model: &Mjcf, geom: &Geom) -> Option<Primitive> {
    let object_from_shape = model.bodies[geom.body].world_from_body * geom.body_from_geom;
    geom.shape.map(|shape| Primitive { shape, object_from_shape })
}

/// The surface of a geom in the world frame.
fn read(model: &Mjcf, geom: &Geom) -> Result<TriMesh> {
    if let Some(primitive) = primitive(model, geom) {
        return Ok(primitive.hull()?);
    }
    let Some(file) = model.meshes.get(&geom.mesh) else {
        let what = format!("a geom names the mesh {:?}, which is not among the assets", geom.mesh);
        return Err(crate::Error::value(what, "add it to <asset>"));
    };
    let mut mesh = read_mesh(&file.path)?;
    let world_from_geom = model.bodies[geom.body].world_from_body * geom.body_from_geom;
    mesh.vertices.iter_mut().for_each(|v| *v = world_from_geom * Point3::from(v.coords.component_mul(&file.scale)));
    Ok(mesh)
}

/// What touches, in the world frame.
fn convex_parts(model: &Mjcf) -> Result<Vec<ConvexPart>> {
    let part = |geom: &Geom| Ok(ConvexPart { hull: read(model, geom)?, primitive: primitive(model, geom) });
    model.geoms.iter().filter(|g| g.collides).map(part).collect()
}

/// Visual meshes in the frame of the first one's body, which is the mesh's frame in an asset of one body.
fn in_mesh_frame(model: &Mjcf) -> Result<TriMesh> {
    let visual = visual_mesh(model)?;
    let first = model.geoms.iter().find(|g| !g.collides).map(|g| model.bodies[g.body].world_from_body);
    Ok(first.map_or_else(TriMesh::default, |world_from_body| visual.transformed(&world_from_body.inverse())))
}

/// Visual meshes in the world frame as one mesh.
fn visual_mesh(model: &Mjcf) -> Result<TriMesh> {
    let mut out = TriMesh::default();
    for geom in model.geoms.iter().filter(|g| !g.collides) {
        out.append(&read(model, geom)?);
    }
    Ok(out)
}
