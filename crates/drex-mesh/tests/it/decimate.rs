//! Decimation: fewer faces, the same surface and topology.

use crate::support::shapes::{divided, genus_of, sphere, torus};
use crate::support::{cuboid, joined, shared};
use drex_core::TriMesh;
use drex_mesh::{DecimateOptions, DecimateReport, RepairOptions, decimate, read_mesh, repair, self_intersections};
use proptest::prelude::*;

fn to_faces(mesh: &TriMesh, n: usize) -> (TriMesh, DecimateReport) {
    let mut options = DecimateOptions::default();
    options.target_faces = Some(n);
    decimate(mesh, &options).unwrap()
}

fn to_error(mesh: &TriMesh, error_m: f64) -> (TriMesh, DecimateReport) {
    let mut options = DecimateOptions::default();
    options.max_error_m = Some(error_m);
    decimate(mesh, &options).unwrap()
}

fn volume(mesh: &TriMesh) -> f64 {
    mesh.mass_properties(1.0).unwrap().mass_kg
}

#[test]
fn a_sphere_stays_a_sphere_with_even_vertices() {
    let mesh = sphere(0.05, 6);
    let (m, r) = to_faces(&mesh, 1000);
    assert_eq!((r.faces, r.open_edges, genus_of(&m)), (1000, 0, 0));
    // 1000 equilateral faces with their corners on the sphere lie up to 16π/(6√3 · 1000) = 0.48 % of the radius inside it.
    assert!(r.error_m < 0.05 * 4.8e-3 * 1.5, "{r:?}");
    assert!((volume(&m) / volume(&mesh) - 1.0).abs() < 6e-3, "{}", volume(&m) / volume(&mesh));
    assert!(r.least_roundness > 0.3 && r.edge_length_spread < 0.25, "{r:?}");
}

#[test]
fn a_box_divided_finely_becomes_a_box_again() {
    let mut mesh = cuboid([0.0; 3], [0.06, 0.04, 0.02]);
    for _ in 0..4 {
        mesh = divided(&mesh);
    }
    assert_eq!(mesh.faces.len(), 12 * 256);
    let (m, r) = to_error(&mesh, 1e-6);
    assert!(r.faces <= 40, "{r:?}");
    assert!((volume(&m) / volume(&mesh) - 1.0).abs() < 1e-4);
    assert_eq!((r.open_edges, genus_of(&m)), (0, 0));
}

#[test]
fn a_torus_keeps_its_hole_however_few_faces_are_wanted() {
    let mesh = torus(0.05, 0.01, 96, 32);
    for n in [1000, 100, 10] {
        let (m, r) = to_faces(&mesh, n);
        assert_eq!((r.open_edges, genus_of(&m)), (0, 1), "{r:?}");
        assert!(r.faces <= n.max(40), "{r:?}");
        assert!(volume(&m) > 0.0);
    }
}

#[test]
fn the_error_that_is_allowed_is_kept() {
    let mesh = torus(0.05, 0.01, 96, 32);
    let mut last = usize::MAX;
    for error_m in [0.05e-3, 0.2e-3, 1e-3] {
        let (m, r) = to_error(&mesh, error_m);
        assert!(r.reached && r.error_m <= error_m && r.faces < last, "{r:?}");
        assert_eq!(genus_of(&m), 1);
        last = r.faces;
    }
    assert!(last < 400, "{last}");
}

#[test]
fn the_rim_of_an_open_mesh_stays() {
    let mut mesh = sphere(0.05, 5);
    mesh.faces.retain(|f| f.iter().all(|&v| mesh.vertices[v as usize].z < 0.02));
    let (m, r) = to_faces(&mesh, 600);
    assert!(r.open_edges > 10 && r.open_edges < r.open_edges_before && r.error_m < 1e-3, "{r:?}");
    assert!(m.vertices.iter().all(|v| v.z < 0.021));
    assert_eq!(r.faces, 600);
}

#[test]
fn edges_with_more_than_two_faces_stay() {
    let two = joined(&[cuboid([0.0; 3], [1.0; 3]), cuboid([0.0, 0.0, 1.0], [1.0, 1.0, 2.0])]);
    let mut options = RepairOptions::default();
    options.split_pinched = false;
    let (welded, report) = repair(&divided(&divided(&two)), &options).unwrap();
    assert!(report.crowded_edges > 0);
    let (m, r) = to_faces(&welded, 150);
    assert!(r.faces < welded.faces.len() && r.open_edges == 0 && (volume(&m) - 2.0).abs() < 0.02, "{r:?}");
}

#[test]
fn impossible_targets_are_refused() {
    let mesh = cuboid([0.0; 3], [0.1; 3]);
    assert!(decimate(&mesh, &DecimateOptions::default()).unwrap_err().to_string().contains("no target"));
    for e in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut options = DecimateOptions::default();
        options.max_error_m = Some(e);
        assert!(decimate(&mesh, &options).is_err());
    }
    let mut options = DecimateOptions::default();
    options.target_faces = Some(4);
    assert!(decimate(&TriMesh::default(), &options).is_err());
    let mut broken = mesh.clone();
    broken.faces[3][1] = 99;
    assert!(decimate(&broken, &options).is_err());
    let (m, r) = to_faces(&mesh, 1_000_000);
    assert_eq!((m.vertices.len(), m.faces.len(), r.faces), (8, 12, 12));
    assert!(r.error_m < 1e-15 && r.reached);
}

#[test]
fn the_golden_shapes_keep_their_form() {
    let Some(data) = shared() else { return };
    for (name, genus) in [("mug", 1), ("bracket", 1), ("bottle", 0), ("box", 0)] {
        let mesh = read_mesh(&data.join(format!("golden/mesh/{name}.obj"))).unwrap();
        let (m, r) = to_error(&mesh, 0.5e-3);
        assert!(r.error_m <= 0.5e-3 && r.open_edges == 0 && genus_of(&m) == genus, "{name}: {r:?}");
        assert!((volume(&m) / volume(&mesh) - 1.0).abs() < 0.03, "{name}");
        assert_eq!(self_intersections(&m).len(), 0, "{name}");
    }
}

#[test]
fn the_same_bytes_every_time() {
    let mesh = torus(0.05, 0.01, 60, 20);
    let one = rayon_pool(1).install(|| to_error(&mesh, 2e-4));
    let four = rayon_pool(4).install(|| to_error(&mesh, 2e-4));
    assert_eq!(one, four);
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_triangles_are_simplified_or_refused(
        vertices in prop::collection::vec(prop::array::uniform3(-2i8..3), 3..14),
        faces in prop::collection::vec(prop::array::uniform3(0u32..14), 1..40),
        target in 0usize..20,
    ) {
        let n = vertices.len() as u32;
        let mesh = TriMesh {
            vertices: vertices.iter().map(|v| nalgebra::Point3::from(v.map(|c| f64::from(c) * 0.01))).collect(),
            faces: faces.iter().map(|f| f.map(|v| v % n)).collect(),
        };
        let mut options = DecimateOptions::default();
        options.target_faces = Some(target);
        options.max_error_m = Some(0.005);
        let (m, r) = decimate(&mesh, &options).unwrap();
        prop_assert!(m.faces.len() <= mesh.faces.len() && r.error_m <= 0.005);
    }

    #[test]
    fn bumpy_closed_surfaces_stay_closed_within_the_error(bumps in prop::collection::vec(0.8f64..1.2, 258), error_mm in 0.05f64..3.0) {
        let mut mesh = sphere(0.05, 3);
        mesh.vertices.iter_mut().zip(&bumps).for_each(|(v, b)| v.coords *= *b);
        let (m, r) = to_error(&mesh, error_mm * 1e-3);
        prop_assert!(r.reached && r.error_m <= error_mm * 1e-3);
        prop_assert_eq!((r.open_edges, genus_of(&m)), (0, 0));
    }
}
