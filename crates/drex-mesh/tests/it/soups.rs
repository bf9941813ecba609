//! Triangle soups with faces missing, flipped or doubled: the truth comes out, or a named error.

use crate::support::shapes::{divided, soup, sphere, torus};
use crate::support::{cuboid, shared};
use drex_core::TriMesh;
use drex_mesh::{
    CheckOptions, DecimateOptions, Error, RepairOptions, RepairReport, check_mesh, close_openings, decimate, read_mesh,
    repair, self_intersections, solid_properties,
};
use nalgebra::Point3;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn volume(mesh: &TriMesh) -> f64 {
    mesh.mass_properties(1.0).unwrap().mass_kg
}

/// A soup of the mesh without a share of its faces, and with another share turned over.
fn damaged(mesh: &TriMesh, missing: f64, flipped: f64, seed: u64) -> TriMesh {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = mesh.clone();
    out.faces.retain(|_| rng.random::<f64>() >= missing);
    for f in &mut out.faces {
        if rng.random::<f64>() < flipped {
            f.swap(0, 1);
        }
    }
    soup(&out)
}

/// Relative error of the volume after repair.
fn repaired(mesh: &TriMesh, truth: f64) -> (f64, RepairReport) {
    let (fixed, report) = repair(mesh, &RepairOptions::default()).unwrap();
    (solid_properties(&fixed).unwrap().volume_m3 / truth - 1.0, report)
}

#[test]
fn a_tenth_missing_or_flipped_hardly_changes_the_volume() {
    for (name, mesh) in [("sphere", sphere(0.05, 4)), ("ring", torus(0.05, 0.015, 64, 24))] {
        let truth = volume(&mesh);
        for (missing, flipped) in [(0.1, 0.0), (0.0, 0.1), (0.1, 0.1)] {
            let (error, report) = repaired(&damaged(&mesh, missing, flipped, 7), truth);
            assert!(error.abs() < if missing > 0.0 { 0.02 } else { 1e-12 }, "{name}: {error} {report:?}");
            assert_eq!(report.filled_holes > 0, missing > 0.0, "{name}");
            assert_eq!(report.flipped_faces > 0, flipped > 0.0, "{name}");
        }
    }
}

#[test]
fn golden_shapes_survive_the_loss_of_a_tenth() {
    let Some(data) = shared() else { return };
    for name in ["bottle", "bracket", "mug"] {
        let mesh = read_mesh(&data.join(format!("golden/mesh/{name}.obj"))).unwrap();
        for (missing, flipped) in [(0.0, 0.1), (0.1, 0.1)] {
            let (error, report) = repaired(&damaged(&mesh, missing, flipped, 3), volume(&mesh));
            eprintln!("{name}: {missing} missing, {flipped} flipped: volume {:+.3} %", 100.0 * error);
            let tolerance = if missing > 0.0 { 0.01 } else { 1e-10 };
            assert!(error.abs() < tolerance, "{name}: {error} {report:?}");
        }
    }
}

#[test]
fn closing_leaves_no_open_edge() {
    let mesh = damaged(&divided(&divided(&cuboid([0.0; 3], [0.06, 0.04, 0.02]))), 0.1, 0.0, 5);
    let (fixed, report) = repair(&mesh, &RepairOptions::default()).unwrap();
    let closed = close_openings(&fixed);
    let (_, after) = repair(&closed, &RepairOptions::default()).unwrap();
    assert_eq!(after.open_edges_before, 0, "{report:?}");
    assert!((volume(&closed) / 4.8e-5 - 1.0).abs() < 0.05);
}

#[test]
fn what_cannot_be_saved_is_refused_by_name() {
    let mesh = damaged(&sphere(0.05, 3), 0.9, 0.5, 1);
    let outcome = repair(&mesh, &RepairOptions::default()).and_then(|(m, _)| solid_properties(&m));
    match outcome {
        Ok(solid) => assert!(solid.volume_m3 > 0.0 && solid.closing_spread > 0.05),
        Err(e) => assert!(matches!(e, Error::NoVolume { .. }), "{e}"),
    }
}

#[test]
fn options_turn_filling_and_splitting_off() {
    let mesh = damaged(&sphere(0.05, 3), 0.05, 0.0, 2);
    let mut options = RepairOptions::default();
    options.fill_narrower_m = Some(0.0);
    let (_, report) = repair(&mesh, &options).unwrap();
    assert!(report.filled_holes == 0 && report.open_edges > 0 && report.open_edges == report.open_edges_before);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn coordinates_of_any_size_are_survived(
        scale in prop::sample::select(vec![1e-310, 1e-200, 1e-30, 1e-9, 1.0, 1e9, 1e30, 1e150, 1e300]),
        offset in prop::sample::select(vec![0.0, 1.0, 1e6, 1e17]),
        vertices in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 4..12),
        faces in prop::collection::vec(prop::array::uniform3(0u32..12), 1..30),
    ) {
        let n = vertices.len() as u32;
        let mesh = TriMesh {
            vertices: vertices.iter().map(|v| Point3::from(v.map(|c| (c + offset) * scale))).collect(),
            faces: faces.iter().map(|f| f.map(|v| v % n)).collect(),
        };
        let _ = self_intersections(&mesh);
        let _ = close_openings(&mesh);
        let mut options = DecimateOptions::default();
        options.target_faces = Some(4);
        if let Ok((simple, _)) = decimate(&mesh, &options) {
            prop_assert!(simple.vertices.iter().all(|v| v.iter().all(|c| c.is_finite())));
        }
        if let Ok((fixed, _)) = repair(&mesh, &RepairOptions::default()) {
            prop_assert!(fixed.faces.iter().flatten().all(|&v| (v as usize) < fixed.vertices.len()));
        }
        prop_assert_eq!(check_mesh(&mesh, &CheckOptions::default()).rules.len(), 23);
    }
}
