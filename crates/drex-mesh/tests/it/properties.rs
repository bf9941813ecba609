//! What must hold for any mesh of a kind.

use drex_core::TriMesh;
use drex_core::mesh::convex_hull;
use drex_mesh::{RepairOptions, repair, solid_properties};
use nalgebra::Point3;
use proptest::prelude::*;

fn hull_of(points: Vec<[f64; 3]>) -> Option<TriMesh> {
    convex_hull(&points.into_iter().map(Point3::from).collect::<Vec<_>>()).ok()
}

fn points() -> impl Strategy<Value = Vec<[f64; 3]>> {
    prop::collection::vec(prop::array::uniform3(-0.1..0.1), 8..60)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn repair_undoes_soup_shuffle_duplicates_and_flips(points in points(), seed: u64, invert: bool) {
        let Some(good) = hull_of(points) else { return Ok(()) };
        let v = good.mass_properties(1.0).unwrap().mass_kg;
        prop_assume!(v > 1e-5);
        let mut bad = TriMesh::default();
        let mut order: Vec<usize> = (0..good.faces.len()).collect();
        let mut state = seed | 1;
        let mut next = || { state ^= state << 13; state ^= state >> 7; state ^= state << 17; state };
        for i in (1..order.len()).rev() {
            order.swap(i, next() as usize % (i + 1));
        }
        for f in order {
            for _ in 0..1 + next() % 2 {
                let base = bad.vertices.len() as u32;
                bad.vertices.extend(good.triangle(f));
                let turn = (next() % 3) as u32;
                let mut face = [0, 1, 2].map(|k| base + (k + turn) % 3);
                if invert {
                    face.swap(0, 1);
                }
                bad.faces.push(face);
            }
        }
        let (fixed, report) = repair(&bad, &RepairOptions::default()).unwrap();
        prop_assert_eq!(report.open_edges, 0);
        prop_assert_eq!((fixed.vertices.len(), fixed.faces.len()), (good.vertices.len(), good.faces.len()));
        let solid = solid_properties(&fixed).unwrap();
        prop_assert!((solid.volume_m3 - v).abs() < 1e-9 * v);
        prop_assert!(solid.properties.is_physical());
    }

    #[test]
    fn two_overlapping_hulls_are_at_least_the_larger_and_at_most_the_sum(a in points(), b in points(), shift in 0.0..0.15) {
        let (Some(a), Some(mut b)) = (hull_of(a), hull_of(b)) else { return Ok(()) };
        b.vertices.iter_mut().for_each(|p| p.x += shift);
        let (va, vb) = (a.mass_properties(1.0).unwrap().mass_kg, b.mass_properties(1.0).unwrap().mass_kg);
        prop_assume!(va > 1e-4 && vb > 1e-4);
        let mut both = a.clone();
        both.vertices.extend(&b.vertices);
        both.faces.extend(b.faces.iter().map(|f| f.map(|v| v + a.vertices.len() as u32)));
        let (fixed, _) = repair(&both, &RepairOptions::default()).unwrap();
        let v = solid_properties(&fixed).unwrap().volume_m3;
        let hull = convex_hull(&both.vertices).unwrap().mass_properties(1.0).unwrap().mass_kg;
        prop_assert!(v > va.max(vb) * 0.999 && v < (va + vb).min(hull) * 1.001, "{} of {} and {}, hull {}", v, va, vb, hull);
    }

    #[test]
    fn any_triangles_are_repaired_or_refused(
        vertices in prop::collection::vec(prop::array::uniform3(-2i8..3), 3..12),
        faces in prop::collection::vec(prop::array::uniform3(0u32..12), 1..30),
    ) {
        let n = vertices.len() as u32;
        let mesh = TriMesh {
            vertices: vertices.iter().map(|v| Point3::from(v.map(|c| f64::from(c) * 0.01))).collect(),
            faces: faces.iter().map(|f| f.map(|v| v % n)).collect(),
        };
        if let Ok((fixed, _)) = repair(&mesh, &RepairOptions::default())
            && let Ok(solid) = solid_properties(&fixed)
        {
            prop_assert!(solid.volume_m3 > 0.0 && solid.volume_m3 < 1e-4);
        }
    }
}
