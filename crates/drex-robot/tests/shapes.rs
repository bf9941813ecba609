//! Shapes: mass properties, distances and samples against each other.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test that fails by panic is what tests are")]

use std::sync::Arc;

use drex_core::TriMesh;
use drex_robot::{Robot, Shape};
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;

fn shapes() -> Vec<Shape> {
    let tetrahedron = TriMesh::new(
        vec![Point3::origin(), Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.2, 0.0), Point3::new(0.0, 0.0, 0.15)],
        vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    );
    vec![
        Shape::Sphere { radius: 0.07 },
        Shape::Capsule { radius: 0.03, half_length: 0.05 },
        Shape::Cylinder { radius: 0.04, half_length: 0.02 },
        Shape::Box { half: Vector3::new(0.02, 0.05, 0.08) },
        Shape::Ellipsoid { radii: Vector3::new(0.05, 0.03, 0.02) },
        Shape::Mesh(Arc::new(tetrahedron.unwrap())),
    ]
}

#[test]
fn closed_forms_agree_with_fine_meshes() {
    for shape in shapes() {
        let exact = shape.mass_properties(700.0).unwrap();
        let fine = shape.to_mesh(400).unwrap();
        assert!(Shape::Mesh(Arc::new(fine.clone())).is_closed(), "{shape:?}");
        let mesh = fine.mass_properties(700.0).unwrap();
        assert!((mesh.mass_kg / exact.mass_kg - 1.0).abs() < 3e-4, "{shape:?}: {} {}", mesh.mass_kg, exact.mass_kg);
        assert!((mesh.center_of_mass - exact.center_of_mass).norm() < 1e-6);
        assert!((mesh.inertia - exact.inertia).abs().max() < 6e-4 * exact.inertia.abs().max(), "{shape:?}");
    }
}

#[test]
fn an_open_mesh_has_the_mass_of_its_hull() {
    let full = shapes().pop().unwrap();
    let Shape::Mesh(mesh) = &full else { panic!() };
    let open = Shape::Mesh(Arc::new(TriMesh { vertices: mesh.vertices.clone(), faces: mesh.faces[..3].to_vec() }));
    assert!(full.is_closed() && !open.is_closed());
    let (a, b) = (full.mass_properties(1.0).unwrap(), open.mass_properties(1.0).unwrap());
    assert!((a.mass_kg - b.mass_kg).abs() < 1e-15 && (a.inertia - b.inertia).abs().max() < 1e-15);
    // Wound inwards: the same solid.
    let inward = Shape::Mesh(Arc::new(TriMesh {
        vertices: mesh.vertices.clone(),
        faces: mesh.faces.iter().map(|f| [f[0], f[2], f[1]]).collect(),
    }));
    assert!((inward.mass_properties(1.0).unwrap().mass_kg - a.mass_kg).abs() < 1e-15);
    let flat = Shape::Mesh(Arc::new(TriMesh { vertices: mesh.vertices[..3].to_vec(), faces: vec![[0, 1, 2]] }));
    assert!(flat.mass_properties(1.0).is_none());
}

#[test]
fn samples_lie_on_the_surface_and_point_outwards() {
    for shape in shapes() {
        // Close to the edges of a mesh the distance has a kink.
        let h = if matches!(shape, Shape::Mesh(_)) { 1e-8 } else { 1e-5 };
        let area = shape.to_mesh(400).unwrap().area();
        let spacing = 0.004;
        let samples = shape.surface_samples(spacing);
        assert_eq!(samples, shape.surface_samples(spacing));
        let per_area = samples.len() as f64 * spacing * spacing / area;
        // The ellipsoid takes more where it is narrow.
        assert!((0.9..1.25).contains(&per_area) || matches!(shape, Shape::Ellipsoid { .. }), "{shape:?}: {per_area}");
        for (p, n) in &samples {
            assert!((n.norm() - 1.0).abs() < 1e-12);
            assert!(shape.signed_distance(p).abs() < 1e-9, "{shape:?} {p}");
            let slope = (shape.signed_distance(&(p + n * h)) - shape.signed_distance(&(p - n * h))) / (2.0 * h);
            assert!((slope - 1.0).abs() < 2e-3, "{shape:?} {p} {slope}");
        }
        assert!(shape.surface_samples(0.0).is_empty() && shape.surface_samples(f64::NAN).is_empty());
        assert!(!shape.surface_samples(10.0).is_empty() && shape.surface_samples(1e-9).len() < 2_000_000);
    }
    assert!(Shape::Plane.surface_samples(0.01).is_empty());
}

#[test]
fn samples_of_a_link_are_not_inside_its_other_shapes() {
    let robot = Robot::bundled("leap_right").unwrap();
    let tip = robot.require_link("index_tip").unwrap();
    let samples = robot.surface_samples(tip, 0.001);
    assert!(samples.len() > 1000, "{}", samples.len());
    for (p, _) in &samples {
        for g in &robot.links[tip].geoms {
            assert!(g.shape.signed_distance(&g.link_from_geom.inverse_transform_point(p)) > -2e-6);
        }
    }
    assert!(robot.surface_samples(999, 0.001).is_empty());
}

proptest! {
    /// Distances of primitives against those of their fine meshes.
    #[test]
    fn signed_distances_agree_with_meshes(x in -0.15..0.15f64, y in -0.15..0.15f64, z in -0.15..0.15f64) {
        let p = Point3::new(x, y, z);
        for shape in shapes().into_iter().take(4) {
            let mesh = Shape::Mesh(Arc::new(shape.to_mesh(64).unwrap()));
            let (a, b) = (shape.signed_distance(&p), mesh.signed_distance(&p));
            prop_assert!((a - b).abs() < 3e-4, "{shape:?} {a} {b}");
        }
    }
}
