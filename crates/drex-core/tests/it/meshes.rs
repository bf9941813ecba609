//! Mesh files and mass properties against exact shapes.

use std::path::Path;

use drex_core::mesh::{parse_obj, parse_stl};
use drex_core::{MassProperties, TriMesh};
use nalgebra::{Matrix3, Point3, Vector3};

use crate::shared;

const BOX: &str = "v 0 0 0\nv 0.4 0 0\nv 0.4 0.3 0\nv 0 0.3 0\nv 0 0 0.2\nv 0.4 0 0.2\nv 0.4 0.3 0.2\nv 0 0.3 0.2\n\
    f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

fn check_box(p: &MassProperties) {
    let (m, [a, b, c]) = (0.4 * 0.3 * 0.2 * 500.0, [0.4f64, 0.3, 0.2].map(|l| l * l));
    assert!((p.mass_kg / m - 1.0).abs() < 1e-12);
    assert!((p.center_of_mass - Point3::new(0.2, 0.15, 0.1)).norm() < 1e-12);
    let inertia = Matrix3::from_diagonal(&Vector3::new(b + c, a + c, a + b)) * (m / 12.0);
    assert!((p.inertia - inertia).norm() < 1e-12 * inertia.norm());
    assert!(p.is_physical());
}

#[test]
fn a_box_has_the_textbook_inertia_wherever_it_is() {
    let mesh = parse_obj(Path::new("box.obj"), BOX.as_bytes()).unwrap();
    assert_eq!((mesh.vertices.len(), mesh.faces.len()), (8, 12));
    check_box(&mesh.mass_properties(500.0).unwrap());
    let far = drex_core::Pose::translation(100.0, -50.0, 20.0);
    let p = mesh.transformed(&far).mass_properties(500.0).unwrap().transformed(&far.inverse());
    assert!((p.mass_kg / 12.0 - 1.0).abs() < 1e-10);
    let halves = mesh.mass_properties(250.0).unwrap();
    check_box(&MassProperties::combined(&[halves, halves]).unwrap());
    // A millimetre mesh brought to metres.
    let mm = mesh.scaled(1000.0).scaled(0.001);
    assert!((mm.mass_properties(500.0).unwrap().mass_kg / 12.0 - 1.0).abs() < 1e-12);
}

#[test]
fn a_fine_sphere_approaches_the_ball() {
    // Rings of latitude; the error of an inscribed polyhedron falls with the square of the step.
    let (n, r) = (200u32, 0.05);
    let mut text = String::from("v 0 0 0.05\n");
    for i in 1..n {
        let polar = std::f64::consts::PI * f64::from(i) / f64::from(n);
        for j in 0..2 * n {
            let az = std::f64::consts::PI * f64::from(j) / f64::from(n);
            text += &format!("v {} {} {}\n", r * polar.sin() * az.cos(), r * polar.sin() * az.sin(), r * polar.cos());
        }
    }
    text += "v 0 0 -0.05\n";
    let at = |i: u32, j: u32| 2 + (i - 1) * 2 * n + j % (2 * n);
    let last = 2 + (n - 1) * 2 * n;
    for j in 0..2 * n {
        text += &format!("f 1 {} {}\nf {last} {} {}\n", at(1, j), at(1, j + 1), at(n - 1, j + 1), at(n - 1, j));
        for i in 1..n - 1 {
            text += &format!("f {} {} {} {}\n", at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
        }
    }
    let p = parse_obj(Path::new("ball.obj"), text.as_bytes()).unwrap().mass_properties(1000.0).unwrap();
    let mass = 4.0 / 3.0 * std::f64::consts::PI * r.powi(3) * 1000.0;
    assert!((p.mass_kg / mass - 1.0).abs() < 5e-4 && p.center_of_mass.coords.norm() < 1e-15);
    for k in 0..3 {
        assert!((p.inertia[(k, k)] / (0.4 * mass * r * r) - 1.0).abs() < 1e-3);
    }
}

#[test]
fn stl_in_both_forms_is_the_same_mesh() {
    let mesh = parse_obj(Path::new("box.obj"), BOX.as_bytes()).unwrap();
    let mut text = String::from("solid box\n");
    let mut binary = b"solid misleading name".to_vec();
    binary.resize(80, b' ');
    binary.extend(12u32.to_le_bytes());
    for f in 0..12 {
        text += "facet normal 0 0 0\nouter loop\n";
        binary.extend([0; 12]);
        for p in mesh.triangle(f) {
            text += &format!("vertex {} {} {}\n", p.x as f32, p.y as f32, p.z as f32);
            binary.extend(p.iter().flat_map(|c| (*c as f32).to_le_bytes()));
        }
        text += "endloop\nendfacet\n";
        binary.extend([0; 2]);
    }
    text += "endsolid\n";
    let a = parse_stl(Path::new("a.stl"), text.as_bytes()).unwrap();
    let b = parse_stl(Path::new("b.stl"), &binary).unwrap();
    assert_eq!(a.vertices.len(), 8);
    assert_eq!(a.faces, b.faces);
    assert!((a.mass_properties(1.0).unwrap().mass_kg / 0.024 - 1.0).abs() < 1e-6);
    let cut = parse_stl(Path::new("b.stl"), &binary[..binary.len() - 7]).unwrap_err().to_string();
    assert!(cut.contains("12 triangles need 684"), "{cut}");
}

#[test]
fn broken_meshes_are_refused_with_their_place() {
    let obj = |text: &str| parse_obj(Path::new("x.obj"), text.as_bytes()).unwrap_err().to_string();
    assert!(obj("v 0 0 0\nv 1 0\n").contains("line 2"));
    assert!(obj("v 0 0 nan\n").contains("not finite"));
    assert!(obj("v 0 0 0\nv 1 0 0\nf 1 2 3\n").contains("line 3"));
    assert!(obj("v 0 0 0\n").contains("no faces"));
    let message = TriMesh::read(Path::new("x.step")).unwrap_err().to_string();
    assert!(message.contains(".stl and .obj"), "{message}");
    assert!(TriMesh::read(Path::new("no-such.stl")).unwrap_err().to_string().contains("cannot read no-such.stl"));
    let flat = parse_obj(Path::new("x.obj"), b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 3 2\n").unwrap();
    assert!(flat.mass_properties(1.0).unwrap_err().to_string().contains("no volume"));
}

#[test]
fn golden_inertias_are_met() {
    let Some(root) = shared("golden/mesh") else { return };
    let golden: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(root.join("inertia.json")).unwrap()).unwrap();
    let density = golden["density_kgm3"].as_f64().unwrap();
    let shapes = golden["shapes"].as_object().unwrap();
    assert!(shapes.len() >= 4);
    for (name, shape) in shapes {
        let mesh = TriMesh::read(&root.join(shape["file"].as_str().unwrap())).unwrap();
        assert_eq!(mesh.vertices.len() as u64, shape["vertices"].as_u64().unwrap());
        assert_eq!(mesh.faces.len() as u64, shape["faces"].as_u64().unwrap());
        let p = mesh.mass_properties(density).unwrap();
        let com = Point3::from(Vector3::from_fn(|i, _| shape["com_m"][i].as_f64().unwrap()));
        let inertia = Matrix3::from_fn(|i, j| shape["inertia_about_com_kgm2"][i][j].as_f64().unwrap());
        assert!((p.mass_kg / shape["mass_kg"].as_f64().unwrap() - 1.0).abs() < 1e-10, "{name}");
        assert!((p.center_of_mass - com).norm() < 1e-12, "{name}");
        assert!((p.inertia - inertia).norm() < 1e-10 * inertia.norm(), "{name}");
        assert!((mesh.area() / shape["area_m2"].as_f64().unwrap() - 1.0).abs() < 1e-10, "{name}");
    }
}

#[test]
fn real_scans_are_read() {
    let Some(root) = shared("drex_real/objects") else { return };
    let mut seen = 0;
    for entry in std::fs::read_dir(root).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "stl") {
            let mesh = TriMesh::read(&path).unwrap();
            let (lo, hi) = mesh.bounds().unwrap();
            let size = (hi - lo).amax();
            assert!((0.05..0.4).contains(&size), "{}: {size} m", path.display());
            seen += 1;
        }
    }
    assert!(seen >= 7);
}
