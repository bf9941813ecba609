//! Convex pieces: shapes with a known best answer, real objects through the environment variable DREX_SHARED.

use crate::support::shared;
use drex_core::{ConvexPart, TriMesh};
use drex_mesh::{PartitionOptions, UnionDistance, convex_parts, read_mesh, repair, union_distance};
use nalgebra::Point3;
use proptest::prelude::*;

/// A solid of revolution about z whose outline (r, z) runs counter-clockwise around the material.
fn revolved(outline: &[[f64; 2]], sectors: usize) -> TriMesh {
    let mut mesh = TriMesh::default();
    for s in 0..sectors {
        let (sin, cos) = (std::f64::consts::TAU * s as f64 / sectors as f64).sin_cos();
        mesh.vertices.extend(outline.iter().map(|[r, z]| Point3::new(r * cos, r * sin, *z)));
    }
    let n = outline.len();
    let at = |s: usize, k: usize| ((s % sectors) * n + k % n) as u32;
    for s in 0..sectors {
        for k in 0..n {
            let (a, b, c, d) = (at(s, k), at(s + 1, k), at(s + 1, k + 1), at(s, k + 1));
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    repair(&mesh, &Default::default()).unwrap().0
}

/// A cup: radius 35 mm, wall and floor 4 mm, 60 mm tall.
fn cup(sectors: usize) -> TriMesh {
    let outline = [[0.0, 0.0], [0.035, 0.0], [0.035, 0.06], [0.031, 0.06], [0.031, 0.004], [0.0, 0.004]];
    revolved(&outline, sectors)
}

fn check(pieces: &[ConvexPart], options: &PartitionOptions) {
    assert!(!pieces.is_empty() && pieces.len() <= options.most_parts, "{} pieces", pieces.len());
    for piece in pieces {
        assert!((4..=options.most_corners).contains(&piece.corners().len()));
        assert!(piece.hull.mass_properties(1.0).unwrap().mass_kg > 1e-12);
    }
}

fn divided(mesh: &TriMesh, most_parts: usize) -> (Vec<ConvexPart>, UnionDistance) {
    let mut options = PartitionOptions::default();
    options.most_parts = most_parts;
    let pieces = convex_parts(mesh, &options).unwrap();
    check(&pieces, &options);
    let distance = union_distance(mesh, &pieces, 20_000, 5).unwrap();
    eprintln!("{} pieces: {distance:?}", pieces.len());
    (pieces, distance)
}

#[test]
fn a_cup_comes_close_to_equal_sectors_and_a_floor() {
    // The best 13 pieces: 12 sectors of 30 degrees, whose chords are 1.06 mm inside the inner wall, and the floor.
    let (pieces, d) = divided(&cup(48), 13);
    let chord = 0.031 * (1.0 - (std::f64::consts::PI / 12.0).cos());
    assert!(d.max_m < 2.5 * chord && d.p99_m < 1.7 * chord && d.mean_m < 0.6 * chord, "{chord}");
    assert!(d.uncovered_share < 2e-3);
    // Hollow: a ball of 20 mm in the middle touches no piece.
    let free = pieces.iter().flat_map(ConvexPart::corners).map(|v| v.x.hypot(v.y).max((0.034 - v.z).abs()));
    assert!(free.fold(f64::INFINITY, f64::min) > 0.02);
}

#[test]
fn the_same_pieces_with_any_number_of_threads() {
    let mesh = cup(16);
    let mut options = PartitionOptions::default();
    options.most_parts = 6;
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| convex_parts(&mesh, &options).unwrap())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn more_shells_than_pieces_are_joined() {
    let bar = |k: usize| {
        let x = 0.02 * k as f64;
        let corner = |i: usize| Point3::new(x + [0.0, 0.01][i & 1], [0.0, 0.05][i >> 1 & 1], [0.0, 0.01][i >> 2]);
        drex_core::mesh::convex_hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap()
    };
    let mut mesh = TriMesh::default();
    for k in 0..5 {
        let base = mesh.vertices.len() as u32;
        let b = bar(k);
        mesh.vertices.extend(b.vertices);
        mesh.faces.extend(b.faces.iter().map(|f| f.map(|v| v + base)));
    }
    assert_eq!(divided(&mesh, 5).0.len(), 5);
    assert!(divided(&mesh, 2).0.len() <= 2);
}

#[test]
fn the_mug_stays_hollow_with_20_pieces() {
    let Some(data) = shared() else { return };
    let mesh = repair(&read_mesh(&data.join("golden/mesh/mug.obj")).unwrap(), &Default::default()).unwrap().0;
    let (_, d) = divided(&mesh, 20);
    assert!(d.mean_m <= 0.38e-3 && d.p99_m <= 1.9e-3 && d.uncovered_share < 2e-3, "{d:?}");
}

#[test]
#[ignore = "minutes: every object of the shared data"]
fn every_object_is_divided() {
    let Some(data) = shared() else { return };
    let folders = ["golden/mesh", "objects", "drex_real/objects", "push_mujoco/bottle", "push_mujoco/letter_t"];
    for folder in folders {
        let mut files: Vec<_> = std::fs::read_dir(data.join(folder)).unwrap().map(|e| e.unwrap().path()).collect();
        files.sort();
        for file in files.iter().filter(|f| f.extension().is_some_and(|e| e == "obj" || e == "stl")) {
            let mesh = repair(&read_mesh(file).unwrap(), &Default::default()).unwrap().0;
            eprint!("{}: ", file.display());
            let (_, d) = divided(&mesh, 32);
            assert!(d.uncovered_share < 0.01, "{}", file.display());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any soup is divided or refused by name.
    #[test]
    fn soups_never_panic(points in prop::collection::vec(prop::array::uniform3(-0.1..0.1), 6..40), flat: bool) {
        let vertices: Vec<_> = points.iter().map(|&[x, y, z]| Point3::new(x, y, if flat { 0.0 } else { z })).collect();
        let n = vertices.len() as u32;
        let faces = (0..n).map(|i| [i, (i * 7 + 1) % n, (i * 3 + 2) % n]).collect();
        let mut options = PartitionOptions::default();
        options.most_parts = 5;
        if let Ok(pieces) = convex_parts(&TriMesh { vertices, faces }, &options) {
            prop_assert!(pieces.len() <= 5);
        }
    }
}
