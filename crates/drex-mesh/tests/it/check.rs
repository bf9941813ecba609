//! The rules: each defect is named by its rule, and an asset on disk is judged by its files.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::shapes::{flipped, sphere};
use crate::support::{cuboid, joined, shared};
use drex_core::TriMesh;
use drex_mesh::{
    AssetOptions, CheckOptions, CheckReport, Outcome, check_asset, check_file, check_mesh, read_mesh, write_obj,
};
use nalgebra::{Point3, Vector3};

fn judged(mesh: &TriMesh) -> CheckReport {
    check_mesh(mesh, &CheckOptions::default())
}

fn outcome(report: &CheckReport, rule: usize) -> Outcome {
    report.rule(rule).unwrap().outcome
}

fn block() -> TriMesh {
    cuboid([0.0, 0.0, 0.0], [0.06, 0.04, 0.02])
}

#[test]
fn a_good_mesh_passes_all_that_can_be_asked() {
    let mut options = CheckOptions::default();
    options.asset.up_in_mesh = Some(Vector3::z());
    options.asset.mass_kg = Some(0.05);
    let report = check_mesh(&block(), &options);
    assert!(report.passed(), "{report}");
    for r in &report.rules {
        let expected = if r.number == 15 || r.number > 17 { Outcome::NotApplicable } else { Outcome::Pass };
        assert_eq!(r.outcome, expected, "{report}");
    }
    let table = report.to_string();
    assert!(table.lines().count() >= 18 && table.contains("ready for simulation"), "{table}");
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!((json["rules"].as_array().unwrap().len(), json["rules"][0]["outcome"].as_str()), (23, Some("pass")));
}

#[test]
fn each_defect_is_named_by_its_rule() {
    let ball = sphere(0.05, 3);
    let mut small_hole = ball.clone();
    small_hole.faces.remove(40);
    let mut no_bottom = block();
    no_bottom.faces.drain(0..2);
    let mut mixed = ball.clone();
    mixed.faces.iter_mut().step_by(7).for_each(|f| f.swap(0, 1));
    let mut twice = ball.clone();
    twice.faces.extend_from_slice(&ball.faces[..9]);
    let crumb = cuboid([0.2, 0.0, 0.0], [0.204, 0.004, 0.004]);
    let apart = cuboid([0.2, 0.0, 0.0], [0.26, 0.04, 0.02]);
    let through = cuboid([0.02, 0.01, -0.03], [0.04, 0.03, 0.05]);
    for (what, mesh, rule, expected) in [
        ("a small hole", small_hole, 1, Outcome::Repaired),
        ("a missing side", no_bottom, 1, Outcome::Repaired),
        ("mixed winding", mixed, 2, Outcome::Repaired),
        ("inverted", flipped(&ball), 11, Outcome::Repaired),
        ("faces twice", twice, 3, Outcome::Repaired),
        ("a crumb", joined(&[block(), crumb]), 4, Outcome::Repaired),
        ("two bodies", joined(&[block(), apart]), 4, Outcome::Fail),
        ("a cavity", joined(&[ball.clone(), flipped(&sphere(0.03, 3))]), 5, Outcome::Fail),
        ("crossing parts", joined(&[block(), through]), 6, Outcome::Repaired),
        ("millimetres", ball.scaled(1000.0), 9, Outcome::Repaired),
        ("too large", ball.scaled(60.0), 9, Outcome::Fail),
        ("too small", ball.scaled(1e-3), 9, Outcome::Fail),
        ("no up given", ball.clone(), 10, Outcome::Repaired),
        ("a ball on a tilted tip", cuboid([0.0; 3], [0.01, 0.01, 0.1]), 14, Outcome::Pass),
    ] {
        let report = judged(&mesh);
        assert_eq!(outcome(&report, rule), expected, "{what}: {report}");
        assert!(report.rule(rule).unwrap().reason.len() > 3);
    }
}

#[test]
fn options_decide_mass_unit_up_and_limits() {
    let mut light = CheckOptions::default();
    light.asset.mass_kg = Some(1e-5);
    assert_eq!(outcome(&check_mesh(&block(), &light), 8), Outcome::Fail);
    let mut tilted = CheckOptions::default();
    tilted.asset.up_in_mesh = Some(Vector3::new(1.0, 0.3, 0.2));
    let report = check_mesh(&cuboid([0.0; 3], [0.01, 0.02, 0.1]), &tilted);
    assert_eq!(outcome(&report, 14), Outcome::Repaired, "{report}");
    let mut few = CheckOptions::default();
    few.most_faces = 10;
    few.most_corners = 6;
    few.asset.partition.primitive_tolerance = 0.0;
    let report = check_mesh(&block(), &few);
    assert_eq!((outcome(&report, 16), outcome(&report, 12), report.passed()), (Outcome::Fail, Outcome::Fail, false));
}

#[test]
fn nothing_at_all_fails_with_a_reason() {
    let mut flat = block();
    flat.vertices.iter_mut().for_each(|v| v.z = 0.0);
    let mut broken = block();
    broken.vertices[2].x = f64::NAN;
    let point = TriMesh { vertices: vec![Point3::origin(); 3], faces: vec![[0, 1, 2]] };
    for mesh in [TriMesh::default(), flat, broken, point] {
        let report = judged(&mesh);
        assert!(!report.passed() && outcome(&report, 1) == Outcome::Fail, "{report}");
        assert!(report.to_string().contains("not ready"));
    }
}

#[test]
fn files_are_judged_with_their_textures() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.obj");
    write_obj(&path, &block()).unwrap();
    assert_eq!(outcome(&check_file(&path, &CheckOptions::default()).unwrap(), 15), Outcome::NotApplicable);
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, format!("mtllib ../m.mtl\n{text}")).unwrap();
    let report = check_file(&path, &CheckOptions::default()).unwrap();
    assert_eq!(outcome(&report, 15), Outcome::Fail, "{report}");
    assert!(check_file(&folder.path().join("absent.obj"), &CheckOptions::default()).is_err());
}

/// An asset of a letter T, written out: of hulls, or with a tolerance of boxes.
fn asset(folder: &Path, primitive_tolerance: f64) -> PathBuf {
    let t = joined(&[cuboid([-0.05, 0.0, 0.0], [0.05, 0.02, 0.03]), cuboid([-0.01, -0.06, 0.0], [0.01, 0.0, 0.03])]);
    let mut options = AssetOptions::default();
    options.mass_kg = Some(0.08);
    options.partition.primitive_tolerance = primitive_tolerance;
    drex_mesh::asset_from_mesh(&t, &options).unwrap().write(folder).unwrap();
    folder.join("asset/object.xml")
}

#[test]
fn boxes_of_a_model_are_checked_as_hulls_are() {
    let folder = tempfile::tempdir().unwrap();
    let xml = asset(folder.path(), AssetOptions::default().partition.primitive_tolerance);
    let good = check_asset(folder.path(), &CheckOptions::default()).unwrap();
    assert!(good.passed(), "{good}");
    let text = fs::read_to_string(&xml).unwrap();
    let geom = text.lines().find(|l| l.contains("collision_01") && l.contains("type=\"box\"")).unwrap();
    let size = &geom[geom.find("size=\"").unwrap()..geom.find("\" pos=").unwrap()];
    fs::write(&xml, text.replace(geom, &geom.replace(size, "size=\"0.09 0.06 0.03"))).unwrap();
    let report = check_asset(folder.path(), &CheckOptions::default()).unwrap();
    assert_eq!(outcome(&report, 13), Outcome::Fail, "{report}");
}

#[test]
fn an_asset_is_judged_by_what_is_on_disk() {
    let folder = tempfile::tempdir().unwrap();
    let xml = asset(folder.path(), 0.0);
    let options = CheckOptions::default();
    let good = check_asset(folder.path(), &options).unwrap();
    assert!(good.passed(), "{good}");
    assert_eq!(good.rules, check_asset(&xml, &options).unwrap().rules);
    let text = fs::read_to_string(&xml).unwrap();
    let mass = text.split("mass=\"0.08\"").count();
    assert_eq!(mass, 2, "{text}");

    // Each change breaks the rule beside it.
    let cases: [(&str, &str, usize); 7] = [
        ("mass=\"0.08\"", "mass=\"80\"", 8),
        ("<inertial ", "<site ", 8),
        ("file=\"../mesh/collision_00.obj\"", "file=\"../mesh/absent.obj\"", 15),
        ("file=\"../mesh/visual.obj\"", "file=\"/home/me/visual.obj\"", 15),
        ("file=\"../mesh/collision_01.obj\"", "file=\"../mesh/collision_01.obj\" scale=\"-1 1 1\"", 11),
        ("<geom name=\"collision_01\"", "<geom name=\"collision_00\"", 16),
        ("<geom name=\"collision_01\"", "<geom name=\"collision_01\" pos=\"0 0 -0.02\"", 14),
    ];
    for (from, to, rule) in cases {
        assert!(text.contains(from), "{from} in {text}");
        fs::write(&xml, text.replace(from, to)).unwrap();
        let report = check_asset(folder.path(), &options).unwrap();
        assert_eq!(outcome(&report, rule), Outcome::Fail, "{to}: {report}");
    }
    // Inertia that no body has: the triangle inequality.
    let start = text.find("fullinertia=\"").unwrap();
    let end = start + 13 + text[start + 13..].find('"').unwrap();
    fs::write(&xml, format!("{}fullinertia=\"1e-5 1e-5 9e-5 0 0 0{}", &text[..start], &text[end..])).unwrap();
    assert_eq!(outcome(&check_asset(&xml, &options).unwrap(), 7), Outcome::Fail);
    // A body off the table.
    let start = text.find("<body name=\"object\" pos=\"").unwrap() + 25;
    let end = start + text[start..].find('"').unwrap();
    fs::write(&xml, format!("{}0 0 0.3{}", &text[..start], &text[end..])).unwrap();
    assert_eq!(outcome(&check_asset(&xml, &options).unwrap(), 10), Outcome::Fail);

    // Files behind an unchanged model.
    fs::write(&xml, &text).unwrap();
    let hull = folder.path().join("mesh/collision_01.obj");
    let whole = read_mesh(&hull).unwrap();
    let mut dented = whole.clone();
    let middle = dented.vertices.iter().map(|v| v.coords).sum::<Vector3<f64>>() / dented.vertices.len() as f64;
    dented.vertices[0] = middle.into();
    write_obj(&hull, &dented).unwrap();
    assert_eq!(outcome(&check_asset(&xml, &options).unwrap(), 12), Outcome::Fail);
    write_obj(&hull, &cuboid([-0.09, -0.06, 0.0], [0.09, 0.0, 0.03])).unwrap();
    assert_eq!(outcome(&check_asset(&xml, &options).unwrap(), 13), Outcome::Fail);
    write_obj(&hull, &whole).unwrap();
    let visual = folder.path().join("mesh/visual.obj");
    write_obj(&visual, &flipped(&read_mesh(&visual).unwrap())).unwrap();
    assert_eq!(outcome(&check_asset(&xml, &options).unwrap(), 2), Outcome::Fail);
    fs::write(&visual, "v 0 0 0\n").unwrap();
    assert!(check_asset(&xml, &options).unwrap_err().to_string().contains("visual.obj"));
}

#[test]
fn damaged_models_are_named_with_their_line() {
    let folder = tempfile::tempdir().unwrap();
    let xml = asset(folder.path(), 0.0);
    let text = fs::read_to_string(&xml).unwrap();
    for (broken, word) in [
        (text.replace("</worldbody>", ""), "line"),
        (text.replace("quat=\"", "quat=\"x "), "no list of numbers"),
        ("<robot/>".to_string(), "not <mujoco>"),
        (text.replace("mesh=\"visual\"", "mesh=\"nothing\""), "nothing"),
    ] {
        fs::write(&xml, broken).unwrap();
        let message = check_asset(&xml, &CheckOptions::default()).unwrap_err().to_string();
        assert!(message.contains(word), "{message}");
    }
    let empty = tempfile::tempdir().unwrap();
    assert!(check_asset(empty.path(), &CheckOptions::default()).unwrap_err().to_string().contains("object.xml"));
}

#[test]
fn golden_shapes_pass_and_real_scans_say_what_is_wrong() {
    let Some(data) = shared() else { return };
    for name in ["box", "bracket"] {
        let path = data.join(format!("golden/mesh/{name}.obj"));
        let report = check_file(&path, &CheckOptions::default()).unwrap();
        assert!(report.passed(), "{report}");
        for rule in 1..=9 {
            assert_eq!(outcome(&report, rule), Outcome::Pass, "{report}");
        }
    }
    let convex = check_file(&data.join("drex_real/objects/bluelego_convex.stl"), &CheckOptions::default()).unwrap();
    assert!(convex.passed() && outcome(&convex, 1) == Outcome::Pass, "{convex}");
    let open = check_file(&data.join("drex_real/objects/domino.stl"), &CheckOptions::default()).unwrap();
    assert_eq!(outcome(&open, 1), Outcome::Repaired, "{open}");
}
