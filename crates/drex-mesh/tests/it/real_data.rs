//! Exact shapes and real scans, found through the environment variable DREX_SHARED.

use crate::support::{json, shared};
use drex_core::{SignedDistance, Surface};
use drex_mesh::{
    AssetOptions, ClosingMethod, GridSdf, MeshSdf, RepairOptions, build_asset, read_mesh, repair, solid_properties,
};
use nalgebra::{Matrix3, Point3, Vector3};

fn vector(v: &serde_json::Value) -> Vector3<f64> {
    Vector3::from_iterator(v.as_array().unwrap().iter().map(|c| c.as_f64().unwrap()))
}

fn matrix(v: &serde_json::Value) -> Matrix3<f64> {
    Matrix3::from_rows(&[0, 1, 2].map(|i| vector(&v[i]).transpose()))
}

#[test]
fn exact_shapes_have_their_exact_inertia() {
    let Some(data) = shared() else { return };
    let golden = data.join("golden/mesh");
    let truth = json(&golden.join("inertia.json"));
    for (name, t) in truth["shapes"].as_object().unwrap() {
        let mesh = read_mesh(&golden.join(t["file"].as_str().unwrap())).unwrap();
        let (mesh, _) = repair(&mesh, &RepairOptions::default()).unwrap();
        let s = solid_properties(&mesh).unwrap();
        assert_eq!(s.closing_method, ClosingMethod::Exact, "{name}");
        let v = t["volume_m3"].as_f64().unwrap();
        let i = matrix(&t["inertia_about_com_kgm2"]);
        assert!((s.volume_m3 - v).abs() < 1e-10 * v, "{name}");
        assert!((s.properties.center_of_mass.coords - vector(&t["com_m"])).norm() < 1e-12, "{name}");
        assert!((s.properties.inertia * 1000.0 - i).norm() < 1e-10 * i.norm(), "{name}");
    }
}

#[test]
fn real_scans_enclose_the_volume_of_the_reference() {
    let Some(data) = shared() else { return };
    let golden = data.join("golden/mesh");
    let truth = json(&golden.join("real_objects.json"));
    for (name, t) in truth["objects"].as_object().unwrap() {
        let mesh = read_mesh(&golden.join(t["file"].as_str().unwrap())).unwrap();
        let (mesh, _) = repair(&mesh, &RepairOptions::default()).unwrap();
        let s = solid_properties(&mesh).unwrap();
        let r = &t["reference"];
        let tolerance = t["suggested_tolerance_pct"].as_f64().unwrap() / 100.0;
        let dv = s.volume_m3 / r["volume_m3"].as_f64().unwrap() - 1.0;
        let dc = (s.properties.center_of_mass.coords - vector(&r["com_m"])).norm();
        let i = matrix(&r["inertia_about_com_unit_density_m5"]);
        let di = (s.properties.inertia - i).norm() / i.norm();
        eprintln!(
            "{name}: volume {:+.3} %, centre {:.3} mm, inertia {:.2} %, spread {:.2} %",
            100.0 * dv,
            1e3 * dc,
            100.0 * di,
            100.0 * s.closing_spread
        );
        assert!(dv.abs() < tolerance && dc < 1e-3 && di < 2.0 * tolerance, "{name}: {dv} {dc} {di}");
        assert_eq!(s.closed, name == "bluelego_convex");
    }
}

#[test]
fn touching_and_overlapping_shells_of_simulated_objects() {
    let Some(data) = shared() else { return };
    for (name, pieces) in [("letter_t", 2), ("letter_l", 2), ("brick", 1), ("can", 1)] {
        let asset =
            build_asset(&data.join("push_mujoco").join(name).join("object.obj"), &AssetOptions::default()).unwrap();
        assert_eq!(
            (asset.convex_parts.len(), asset.report.open_edges, asset.report.repair.bodies),
            (pieces, 0, 1),
            "{name}"
        );
    }
}

#[test]
fn the_distance_grid_of_a_scan_is_close_to_the_exact_distance() {
    let Some(data) = shared() else { return };
    let mesh = read_mesh(&data.join("drex_real/objects/cookie.stl")).unwrap();
    let (mesh, _) = repair(&mesh, &RepairOptions::default()).unwrap();
    let exact = MeshSdf::new(&mesh).unwrap();
    let grid = GridSdf::new(exact.clone()).unwrap();
    let (lo, hi) = exact.bounds();
    let mut errors: Vec<f64> = drex_core::mesh::sample_surface(exact.boundary(), 1500, 3)
        .iter()
        .enumerate()
        .map(|(k, s)| s.point + s.normal * ((k % 21) as f64 - 10.0) * 1e-3)
        .map(|p| (exact.signed_distance(&p).distance_m - grid.signed_distance(&p).distance_m).abs())
        .collect();
    errors.sort_by(f64::total_cmp);
    let share = |s: f64| 1e3 * errors[(s * errors.len() as f64) as usize];
    eprintln!(
        "grid {:.2} mm: error median {:.3}, 95 % {:.3}, worst {:.3} mm",
        1e3 * grid.spacing_m(),
        share(0.5),
        share(0.95),
        share(0.999)
    );
    assert!(share(0.95) < 0.5e3 * grid.spacing_m());
    let middle = nalgebra::center(&lo, &hi);
    assert!(grid.signed_distance(&middle).distance_m < -0.01);
    assert!(grid.signed_distance(&(middle + Vector3::x())).distance_m > 0.5);
    assert!(grid.ray_cast(&Point3::new(middle.x, middle.y, hi.z + 0.1), &-Vector3::z(), 0.5).is_some());
}
