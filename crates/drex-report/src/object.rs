//! The object: pictures, pieces, mass properties, what was mended.

use crate::Result;
use drex_core::{Pose, TriMesh};
use drex_mesh::{Asset, AssetReport, ClosingMethod};

use super::page::Page;
use super::viewer::{Look, Scene};
use crate::picture::raster::{Part, View, render_png};
use drex_twin::records::MassFile;

/// The object in every picture.
pub const OBJECT_COLOR: [f64; 3] = [0.86, 0.55, 0.30];
/// Faces of a mesh that can be turned.
pub const MESH_FACES: usize = 12_000;
/// Faces of one convex piece that can be turned.
const PIECE_FACES: usize = 600;
/// Colours of neighbouring pieces.
const PIECE_COLORS: [[f64; 3]; 6] = [
    [0.86, 0.55, 0.30],
    [0.30, 0.58, 0.76],
    [0.45, 0.68, 0.42],
    [0.74, 0.50, 0.68],
    [0.84, 0.72, 0.34],
    [0.50, 0.54, 0.60],
];

/// How the solid was obtained, in a few words.
pub fn closing_text(report: &AssetReport) -> String {
    match report.closing_method {
        ClosingMethod::Exact => "closed mesh, exact".to_owned(),
        ClosingMethod::Union => "closed shells as one solid, exact union".to_owned(),
        _ => format!(
            "open scan, {} open edges closed by flat lids; two ways of closing differ by {:.1} %",
            report.open_edges,
            100.0 * report.closing_spread
        ),
    }
}

/// "1 convex piece", "12 convex pieces".
pub fn pieces_text(asset: &Asset) -> String {
    let n = asset.convex_parts.len();
    format!("{n} convex piece{}", if n == 1 { "" } else { "s" })
}

/// The section on the object.
pub fn section(page: &mut Page, asset: &Asset, mass: &MassFile) -> Result<()> {
    page.section("Object");
    let pose = asset.world_from_mesh_at_rest;
    let (azimuth, elevation) = (-0.7, 0.35);
    let mut whole = Scene::new(azimuth, elevation).linked("object").on_table(0.0);
    if let Some(mesh) = whole.mesh(&asset.visual, MESH_FACES) {
        whole.part(mesh, Look::Solid, OBJECT_COLOR, &[pose.into()])?;
    }
    let mut divided = Scene::new(azimuth, elevation).linked("object").on_table(0.0);
    for (piece, color) in asset.convex_parts.iter().zip(PIECE_COLORS.iter().cycle()) {
        if let Some(mesh) = divided.mesh(&piece.hull, PIECE_FACES) {
            divided.part(mesh, Look::Solid, *color, &[pose.into()])?;
        }
    }
    let pieces: Vec<Part<'_>> = asset
        .convex_parts
        .iter()
        .zip(PIECE_COLORS.iter().cycle())
        .map(|(piece, &color)| Part { mesh: &piece.hull, world_from_mesh: pose, color, texture: None })
        .collect();
    page.viewers(&[
        (whole, still(&asset.visual, &pose, azimuth, elevation)?, "the mesh".to_owned()),
        (divided, render_png(&pieces, &view(azimuth, elevation))?, pieces_text(asset)),
    ]);

    let r = &asset.report;
    let body = asset.properties.with_mass(mass.mass_kg);
    // Adding zero turns -0.00 into 0.00.
    let mm = |v: f64| format!("{:.2}", (1e5 * v).round() / 1e2 + 0.0);
    let c = body.center_of_mass;
    let i = body.inertia;
    // What is only rounding of a symmetric object's zero is printed as zero.
    let product = |v: f64| if v.abs() < 1e-9 * i.trace() { "0".to_owned() } else { format!("{v:.2e}") };
    let rows = [
        ("size, mm", r.size_m.map(mm).join(" × ")),
        ("volume, cm³", format!("{:.2}", 1e6 * r.volume_m3)),
        ("solid", closing_text(r)),
        ("mass, g", format!("{:.1} ({})", 1e3 * mass.mass_kg, mass.source.text())),
        ("density, kg/m³", format!("{:.0}, taken as uniform", mass.mass_kg / r.volume_m3)),
        ("centre of mass in the mesh frame, mm", format!("{}, {}, {}", mm(c.x), mm(c.y), mm(c.z))),
        ("inertia about it, kg m² (xx yy zz)", format!("{:.3e}, {:.3e}, {:.3e}", i[(0, 0)], i[(1, 1)], i[(2, 2)])),
        ("inertia (xy xz yz)", [i[(0, 1)], i[(0, 2)], i[(1, 2)]].map(product).join(", ")),
        (
            "convex pieces",
            format!(
                "{}, at most {} corners, together {:.3} of the volume",
                r.pieces, r.most_corners, r.pieces_to_solid_volume
            ),
        ),
    ];
    let rows: Vec<Vec<String>> = rows.into_iter().map(|(k, v)| vec![k.to_owned(), v]).collect();
    page.table(&["property", "value"], &rows);
    page.list(&r.warnings);
    page.paragraph("Simulation asset: asset/object.xml (MJCF) and asset/object.urdf, in the twin folder.");
    Ok(())
}

/// The object alone, on its table.
pub fn still(mesh: &TriMesh, world_from_mesh: &Pose, azimuth: f64, elevation: f64) -> Result<Vec<u8>> {
    still_of(Part { mesh, world_from_mesh: *world_from_mesh, color: OBJECT_COLOR, texture: None }, azimuth, elevation)
}

/// A part alone, on its table.
pub fn still_of(part: Part<'_>, azimuth: f64, elevation: f64) -> Result<Vec<u8>> {
    render_png(&[part], &view(azimuth, elevation))
}

fn view(azimuth: f64, elevation: f64) -> View {
    View { width: 420, height: 340, azimuth, elevation, table_height_m: Some(0.0) }
}
