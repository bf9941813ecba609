use std::collections::BTreeMap;

use drex_core::TriMesh;
use drex_mvs::{Hold, Preset, RefineOptions, refine};
use nalgebra::{Point3, Vector3};

use crate::scene::{FOCAL_PX, photograph, ring};

const RADIUS: f64 = 0.05;
const FAR: f64 = 0.3;

/// A ball of this radius round the origin; each halving quadruples the eight faces of an octahedron.
pub fn ball(radius: f64, halvings: usize) -> TriMesh {
    let mut vertices: Vec<Point3<f64>> =
        [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]
            .map(Point3::from)
            .into();
    let mut faces: Vec<[u32; 3]> =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..halvings {
        let mut halves: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        let mut next = Vec::with_capacity(4 * faces.len());
        for [a, b, c] in faces {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
                *halves.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    let middle = nalgebra::center(&vertices[p as usize], &vertices[q as usize]);
                    vertices.push(Point3::from(middle.coords.normalize()));
                    vertices.len() as u32 - 1
                })
            });
            next.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        faces = next;
    }
    vertices.iter_mut().for_each(|v| v.coords *= radius);
    TriMesh { vertices, faces }
}

/// Distances from the ball of what the first camera sees well.
fn off(mesh: &TriMesh) -> Vec<f64> {
    mesh.vertices.iter().filter(|v| v.z < -0.6 * RADIUS).map(|v| v.coords.norm() - RADIUS).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn a_dented_ball_becomes_round_where_photos_see_it() {
    let surface = |eye: &Point3<f64>, ray: &Vector3<f64>| {
        let (a, b, c) = (ray.norm_squared(), ray.dot(&eye.coords), eye.coords.norm_squared() - RADIUS * RADIUS);
        let root = b * b - a * c;
        (root > 0.0).then(|| (-b - root.sqrt()) / a)
    };
    let around = [[0.0, 0.0], [15.0, 0.0], [-15.0, 0.0], [0.0, 15.0], [0.0, -15.0]];
    let dir = tempfile::tempdir().unwrap();
    let capture = photograph(dir.path(), &ring(FAR, &around), &surface, 0.004, 80.0);
    // Half a pixel too large, with dents of as much a centimetre across: a pixel is a millimetre.
    let pixel = FAR / FOCAL_PX;
    let mut mesh = ball(RADIUS, 6);
    for v in &mut mesh.vertices {
        let dent = (600.0 * v.x).sin() * (600.0 * v.y).cos();
        *v += v.coords.normalize() * (0.5 * pixel * (1.0 + dent));
    }
    let behind: Vec<Hold> = mesh.vertices.iter().map(|v| if v.z > 0.02 { Hold::Fixed } else { Hold::Free }).collect();
    let mut options = RefineOptions::default();
    options.preset = Preset::Fast;
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| refine(&mesh, &behind, &capture, &options, &|_| {}).unwrap())
    };
    let (refined, report) = on(1);
    let (before, after) = (off(&mesh), off(&refined));
    assert!(rms(&after) < 0.2 * rms(&before), "{} after {}", rms(&after), rms(&before));
    let mean = after.iter().sum::<f64>() / after.len() as f64;
    assert!(mean.abs() < 0.05 * pixel, "{mean} of {pixel}");
    assert!(report.correlation[1] > report.correlation[0] && report.seen_share > 0.2, "{report:?}");
    assert!(report.moved[1] > 0.5 * pixel && report.passes >= 2, "{report:?}");
    for ((hold, a), b) in behind.iter().zip(&mesh.vertices).zip(&refined.vertices) {
        assert!(*hold == Hold::Free || a == b, "a vertex that stays moved from {a} to {b}");
    }
    assert!((refined, report) == on(3), "the number of threads changes the mesh");

    // A prior so stiff that passes take an exact ball away from what photos show: the best of them is none.
    let mut stiff = options.clone();
    stiff.stiffness = 1e5;
    let exact = ball(RADIUS, 5);
    let (kept, report) = refine(&exact, &[], &capture, &stiff, &|_| {}).unwrap();
    assert!(report.passes >= 2 && report.correlation[1] >= report.correlation[0], "{report:?}");
    assert!(rms(&off(&kept)) < 0.02 * pixel, "{} of {pixel}", rms(&off(&kept)));

    let refused = |mesh: &TriMesh, holds: &[Hold], options: &RefineOptions, words: &str| {
        let error = refine(mesh, holds, &capture, options, &|_| {}).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    };
    refused(&mesh, &behind[1..], &options, "is said of");
    refused(&TriMesh { faces: Vec::new(), ..mesh.clone() }, &[], &options, "without faces");
    let mut wrong = mesh.clone();
    wrong.faces[3][1] = mesh.vertices.len() as u32;
    refused(&wrong, &[], &options, "face 3 names a vertex");
    wrong = mesh.clone();
    wrong.vertices[5].y = f64::NAN;
    refused(&wrong, &[], &options, "vertex 5 is not finite");
    wrong = mesh.clone();
    wrong.vertices.iter_mut().for_each(|v| v.x += 5.0);
    refused(&wrong, &[], &options, "show the same part of the mesh");
    stiff.stiffness = f64::NAN;
    refused(&mesh, &[], &stiff, "a stiffness of NaN");
}
