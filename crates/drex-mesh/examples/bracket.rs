//! A mesh as it comes out of a modeller, made fit for a simulator: two boxes that overlap, one wound inside out, the bottom missing.
//!
//!     cargo run --release -p drex-mesh --example bracket -- [OUT]
//!
//! Says what was found, the volume beside the true one, the convex parts and how the bracket can stand; with OUT it writes the
//! asset there (MJCF, URDF, GLB, report). `--example asset -- MESH OUT` does it for a file of your own.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::path::Path;

use drex_core::TriMesh;
use drex_core::mesh::convex_hull;
use drex_mesh::{AssetOptions, LengthUnit, asset_from_mesh};
use nalgebra::Point3;

fn main() -> Result<(), drex_mesh::Error> {
    // An L of 80 x 40 x 60 mm with walls of 10 mm; the parts share the corner of 10 x 40 x 10 mm.
    let mut foot = cuboid([0.0, 0.0, 0.0], [0.08, 0.04, 0.01])?;
    let mut wall = cuboid([0.0, 0.0, 0.0], [0.01, 0.04, 0.06])?;
    let true_m3 = 0.08 * 0.04 * 0.01 + 0.01 * 0.04 * 0.05;
    foot.faces.retain(|f| f.iter().any(|&v| foot.vertices[v as usize].z > 0.0)); // nobody scans the underside
    wall.faces.iter_mut().for_each(|f| f.swap(0, 1));
    let base = foot.vertices.len() as u32;
    foot.vertices.extend(wall.vertices);
    foot.faces.extend(wall.faces.iter().map(|f| f.map(|v| v + base)));

    let mut options = AssetOptions::default();
    options.unit = LengthUnit::Metre;
    options.mass_kg = Some(0.14);
    let asset = asset_from_mesh(&foot, &options)?;
    let report = &asset.report;
    println!("openings: {}; faces wound the wrong way: {}", report.openings, report.repair.flipped_faces);
    println!(
        "volume {:.3} cm³, in truth {:.3}; the openings can be closed in ways that differ by {:.2} % of it",
        1e6 * report.volume_m3,
        1e6 * true_m3,
        100.0 * report.closing_spread
    );
    println!("{} convex parts, together {:.3} times the solid", report.pieces, report.pieces_to_solid_volume);
    for pose in &asset.stable_poses {
        let down = pose.support_normal_in_mesh;
        println!(
            "stands on ({:.2}, {:.2}, {:.2}) with probability {:.2}, tips at a slope of {:.0} degrees",
            down.x,
            down.y,
            down.z,
            pose.probability,
            pose.tipping_angle_rad().to_degrees()
        );
    }
    for warning in &report.warnings {
        println!("look at this: {warning}");
    }
    if let Some(out) = std::env::args_os().nth(1) {
        asset.write(Path::new(&out))?;
        println!("wrote {}", Path::new(&out).join("asset/object.xml").display());
    }
    Ok(())
}

fn cuboid(lo: [f64; 3], hi: [f64; 3]) -> Result<TriMesh, drex_core::Error> {
    let corner = |i: usize| Point3::from([0, 1, 2].map(|k| if i >> k & 1 == 0 { lo[k] } else { hi[k] }));
    convex_hull(&(0..8).map(corner).collect::<Vec<_>>())
}
