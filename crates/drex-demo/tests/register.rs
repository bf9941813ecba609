//! Known objects at known places, found again from noisy points.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)] // a test: a panic is the report, a line that it was skipped

use std::path::{Path, PathBuf};

use drex_core::mesh::sample_surface;
use drex_core::{Surface, TriMesh};
use drex_demo::{
    Demonstration, HandFrame, KeyPoints, Placement, RegisterOptions, Side, parse_points, read_point_frames,
    read_points, register, register_sequence,
};
use drex_mesh::{MeshSdf, RepairOptions, read_mesh, repair};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A polygon in x and y, counter-clockwise, as triangles, pulled up along z.
fn prism(outline: &[[f64; 2]], triangles: &[[u32; 3]], height: f64) -> TriMesh {
    let n = outline.len() as u32;
    let level = |z: f64| outline.iter().map(move |[x, y]| Point3::new(*x, *y, z));
    let vertices = level(0.0).chain(level(height)).collect();
    let mut faces: Vec<[u32; 3]> = triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    faces.extend(triangles.iter().map(|t| t.map(|v| v + n)));
    for i in 0..n {
        let j = (i + 1) % n;
        faces.extend([[i, j, j + n], [i, j + n, i + n]]);
    }
    TriMesh::new(vertices, faces).unwrap()
}

/// 100 x 140 x 60 mm.
fn cuboid() -> TriMesh {
    prism(&[[0.0, 0.0], [0.10, 0.0], [0.10, 0.14], [0.0, 0.14]], &[[0, 1, 2], [0, 2, 3]], 0.06)
}

/// An L of two legs, 120 and 80 mm long.
fn bracket() -> TriMesh {
    let outline = [[0.0, 0.0], [0.12, 0.0], [0.12, 0.03], [0.03, 0.03], [0.03, 0.08], [0.0, 0.08]];
    prism(&outline, &[[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]], 0.05)
}

struct Scene {
    surface: MeshSdf,
    truth: (f64, UnitQuaternion<f64>, Vector3<f64>),
    points: Vec<Point3<f64>>,
}

/// `n` points of the object at a random place, scaled; only those seen from `view` (in the object's frame), if given; with normal
/// noise (m of the mesh) and a share of outliers in a box one and a half times as large.
fn scene(mesh: &TriMesh, n: usize, view: Option<Vector3<f64>>, noise_m: f64, outliers: f64, seed: u64) -> Scene {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut unit = || -> [f64; 3] { std::array::from_fn(|_| 2.0 * rng.random::<f64>() - 1.0) };
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(unit()) * 3.0);
    let (scale, translation) = (3.7, Vector3::from(unit()) * 2.0);
    let surface = MeshSdf::new(mesh).unwrap();
    let (lo, hi) = surface.bounds();
    let view = view.map(|v| v.normalize());
    let mut points = Vec::new();
    for sample in sample_surface(mesh, 6 * n, seed) {
        let hidden = view.is_some_and(|v| {
            sample.normal.dot(&v) <= 0.05 || surface.ray_cast(&(sample.point + sample.normal * 1e-5), &v, 1.0).is_some()
        });
        if hidden || points.len() >= n {
            continue;
        }
        let mut p = sample.point.coords;
        // Sum of twelve uniform numbers: nearly normal.
        let normal: Vector3<f64> = (0..12).map(|_| Vector3::from(unit())).sum::<Vector3<f64>>() / 2.0;
        p += normal * noise_m;
        if (points.len() as f64) < outliers * n as f64 {
            p = nalgebra::center(&lo, &hi).coords + (hi - lo).component_mul(&Vector3::from(unit())) * 0.75;
        }
        points.push(Point3::from(rotation * p * scale + translation));
    }
    Scene { surface, truth: (scale, rotation, translation), points }
}

/// Error of a placement: scale (relative), turn (degrees), place of the middle (m of the mesh).
fn error(p: &Placement, scene: &Scene) -> (f64, f64, f64) {
    let (scale, rotation, translation) = scene.truth;
    let (lo, hi) = scene.surface.bounds();
    let middle = nalgebra::center(&lo, &hi);
    let at = rotation * middle.coords * scale + translation;
    (
        (p.scale / scale - 1.0).abs(),
        p.rotation.angle_to(&rotation).to_degrees(),
        (p.point(&middle).coords - at).norm() / scale,
    )
}

/// The best placement, or one of those that look the same, is the true one.
fn assert_found(scene: &Scene, limits: (f64, f64, f64), name: &str) {
    let found = register(&scene.points, &scene.surface, &RegisterOptions::default()).unwrap();
    let all: Vec<_> = std::iter::once(&found.placement).chain(&found.alternatives).map(|p| error(p, scene)).collect();
    println!(
        "{name}: best {:?} of {} rms {:.2} mm inliers {:.2} covered {:.2}",
        all[0],
        all.len(),
        1e3 * found.rms_m,
        found.inlier_share,
        found.covered_share
    );
    let good = all.iter().any(|e| e.0 < limits.0 && e.1 < limits.1 && e.2 < limits.2);
    assert!(good, "{name}: {all:?}");
    assert!(all[0].0 < limits.0, "{name}: the scale is right whichever of the same looks is taken");
}

const FINE: (f64, f64, f64) = (0.01, 2.0, 0.002);

#[test]
fn whole_clouds_are_found() {
    for seed in 0..2 {
        assert_found(&scene(&cuboid(), 1500, None, 0.001, 0.0, seed), FINE, "box, whole");
        assert_found(&scene(&bracket(), 1500, None, 0.001, 0.0, seed), FINE, "bracket, whole");
    }
}

#[test]
fn one_side_is_enough_for_pose_and_scale() {
    for (seed, view) in [[1.0, 0.7, 0.8], [-0.8, 0.9, 0.6], [0.9, -1.0, -0.7]].into_iter().enumerate() {
        let view = Some(Vector3::from(view));
        assert_found(&scene(&cuboid(), 1500, view, 0.0005, 0.0, seed as u64), FINE, "box, one side");
        assert_found(&scene(&bracket(), 1500, view, 0.0005, 0.0, seed as u64), FINE, "bracket, one side");
    }
}

#[test]
fn a_fifth_of_rubbish_does_no_harm() {
    let view = Some(Vector3::new(1.0, 0.7, 0.8));
    assert_found(&scene(&cuboid(), 1500, None, 0.001, 0.2, 1), FINE, "box, outliers");
    assert_found(&scene(&bracket(), 1500, view, 0.0005, 0.2, 2), FINE, "bracket, one side, outliers");
}

#[test]
fn a_box_looks_the_same_four_ways() {
    let scene = scene(&cuboid(), 1500, None, 0.0005, 0.0, 5);
    let found = register(&scene.points, &scene.surface, &RegisterOptions::default()).unwrap();
    assert_eq!(found.alternatives.len(), 3, "{:?}", found.alternatives);
    let bracket = self::scene(&bracket(), 1500, None, 0.0005, 0.0, 5);
    let found = register(&bracket.points, &bracket.surface, &RegisterOptions::default()).unwrap();
    assert!(found.inlier_share > 0.9 && found.covered_share > 0.95, "{found:?}");
    // Turned upside down about the middle of its height the bracket is another one.
    assert!(found.alternatives.is_empty(), "{:?}", found.alternatives);
}

#[test]
fn a_known_scale_is_kept_and_bad_input_refused() {
    let scene = scene(&bracket(), 800, None, 0.0005, 0.0, 3);
    let mut options = RegisterOptions::default();
    options.scale = Some(3.7);
    let found = register(&scene.points, &scene.surface, &options).unwrap();
    assert_eq!(found.placement.scale, 3.7);
    assert!(error(&found.placement, &scene).1 < 2.0);
    options.scale = Some(-1.0);
    assert!(register(&scene.points, &scene.surface, &options).unwrap_err().to_string().contains("scale"));
    let default = RegisterOptions::default();
    assert!(register(&scene.points[..10], &scene.surface, &default).unwrap_err().to_string().contains("too few"));
    let one = vec![Point3::new(1.0, 2.0, 3.0); 100];
    assert!(register(&one, &scene.surface, &default).unwrap_err().to_string().contains("one place"));
    let line: Vec<_> = (0..100).map(|i| Point3::new(f64::from(i), 0.0, f64::NAN)).collect();
    assert!(register(&line, &scene.surface, &default).is_err());
    let line: Vec<_> = (0..100).map(|i| Point3::new(f64::from(i), 0.0, 0.0)).collect();
    let _ = register(&line, &scene.surface, &default);
}

#[test]
fn a_clip_goes_on_from_the_frame_before() {
    let mut truth = scene(&bracket(), 600, None, 0.0005, 0.0, 7);
    let step = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, 0.05, -0.03));
    let mut frames = vec![truth.points.clone()];
    for _ in 0..4 {
        let next = frames.last().unwrap().iter().map(|p| step * p + Vector3::new(0.02, 0.0, 0.01)).collect();
        frames.push(next);
    }
    frames[2].clear();
    let found = register_sequence(&frames, &truth.surface, &RegisterOptions::default());
    assert!(found[2].is_err());
    for i in [0, 1, 3, 4] {
        let (scale, mut rotation, mut translation) = truth.truth;
        for _ in 0..i {
            (rotation, translation) = (step * rotation, step * translation + Vector3::new(0.02, 0.0, 0.01));
        }
        let here = std::mem::replace(&mut truth.truth, (scale, rotation, translation));
        let e = error(&found[i].as_ref().unwrap().placement, &truth);
        truth.truth = here;
        assert!(e.0 < FINE.0 && e.1 < FINE.1 && e.2 < FINE.2, "frame {i}: {e:?}");
    }
}

#[test]
fn a_demonstration_becomes_metric_by_its_object() {
    let scene = scene(&bracket(), 600, None, 0.0005, 0.0, 11);
    let (scale, rotation, translation) = scene.truth;
    // Hand points 0.2 m from the object's origin, in the reconstruction's units.
    let hand: KeyPoints = std::array::from_fn(|i| {
        let in_object = Point3::new(0.2, 0.01 * i as f64, 0.0);
        Some(Point3::from(rotation * in_object.coords * scale + translation))
    });
    let mut frames: Vec<HandFrame> = (0..3).map(|i| HandFrame::new(i as f64, hand)).collect();
    frames.iter_mut().enumerate().for_each(|(i, f)| f.index = 10 + i);
    let mut demo = Demonstration::new("test", Side::Right, frames);
    let clouds = vec![(10, scene.points.clone()), (12, scene.points.clone()), (13, vec![])];
    let found = demo.register_object(&clouds, &scene.surface, &RegisterOptions::default()).unwrap();
    assert!(found[0].is_ok() && found[2].is_err() && demo.frames[1].source_from_object.is_none());
    for frame in [&demo.frames[0], &demo.frames[2]] {
        let object_from_source = frame.source_from_object.unwrap().inverse();
        for i in [0, 20] {
            let p = object_from_source * frame.points[i].unwrap();
            assert!((p - Point3::new(0.2, 0.01 * f64::from(i as u8), 0.0)).norm() < 0.003, "{p}");
        }
    }
    assert!(demo.notes[0].contains("2 of 3 frames"), "{:?}", demo.notes);
    assert!(demo.register_object(&clouds[2..], &scene.surface, &RegisterOptions::default()).is_err());
}

#[test]
fn one_thread_or_two_give_the_same() {
    let scene = scene(&bracket(), 500, None, 0.001, 0.1, 9);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| register(&scene.points, &scene.surface, &RegisterOptions::default()).unwrap())
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn real_objects_are_found() {
    let Some(shared) = std::env::var_os("DREX_SHARED").map(PathBuf::from) else {
        println!("skipped: DREX_SHARED is not set");
        return;
    };
    for name in ["006_mustard_bottle", "043_phillips_screwdriver", "010_potted_meat_can"] {
        let mesh = read_mesh(&shared.join(format!("data/objects/{name}.obj"))).unwrap();
        let mesh = repair(&mesh, &RepairOptions::default()).unwrap().0;
        let scene = scene(&mesh, 1500, None, 0.001, 0.1, 4);
        let started = std::time::Instant::now();
        let found = register(&scene.points, &scene.surface, &RegisterOptions::default()).unwrap();
        let e = error(&found.placement, &scene);
        println!(
            "{name}: {e:?} rms {:.2} mm, {} alternatives, {:?}",
            1e3 * found.rms_m,
            found.alternatives.len(),
            started.elapsed()
        );
        // A can may be turned about its axis and a bottle about itself: the scale and the distance tell.
        assert!(e.0 < 0.01 && found.rms_m < 0.002, "{name}: {e:?} {found:?}");
        assert!(e.2 < 0.003, "{name}: {e:?}");
    }
}

#[test]
fn points_are_read_from_what_reconstructions_write() {
    let read = |name: &str, bytes: &[u8]| parse_points(Path::new(name), bytes);
    let expected = vec![Point3::new(1.0, 2.0, 3.0), Point3::new(-1.0, 0.5, 0.25)];
    let obj = b"# made by hand\nv 1 2 3 0.5 0.5 0.5\nvn 0 0 1\nv -1 0.5 0.25\nv nan 0 0\nf 1 2 3\n";
    assert_eq!(read("a.obj", obj).unwrap(), expected);
    assert_eq!(read("a.xyz", b"# x y z\n1 2 3\n\n-1,0.5,0.25\n").unwrap(), expected);
    let head =
        "element vertex 2\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nend_header\n";
    let ascii = format!("ply\nformat ascii 1.0\n{head}1 2 3 9\n-1 0.5 0.25 9\n");
    assert_eq!(read("a.ply", ascii.as_bytes()).unwrap(), expected);
    for (form, big) in [("binary_little_endian", false), ("binary_big_endian", true)] {
        let mut bytes = format!("ply\nformat {form} 1.0\n{head}").into_bytes();
        for p in &expected {
            for c in p.iter().map(|c| *c as f32) {
                bytes.extend(if big { c.to_be_bytes() } else { c.to_le_bytes() });
            }
            bytes.push(7);
        }
        assert_eq!(read("a.ply", &bytes).unwrap(), expected);
        bytes.pop();
        assert!(
            read("a.ply", &bytes)
                .unwrap_err()
                .to_string()
                .contains("2 rows of vertex are announced, but the file ends before number 1")
        );
    }
    assert!(read("a.obj", b"v 1 2\n").unwrap_err().to_string().contains("line 1"));
    assert!(read("a.obj", b"").unwrap_err().to_string().contains("no points"));
    assert!(read("a.stl", b"").unwrap_err().to_string().contains(".stl"));
    assert!(read("a.ply", b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n").is_err());
    assert!(read_points(Path::new("/no/such/file.obj")).is_err());
    let folder = tempfile::tempdir().unwrap();
    for (name, x) in [("out_10_object.obj", 10), ("out_9_object.obj", 9)] {
        std::fs::write(folder.path().join(name), format!("v {x} 0 0\n")).unwrap();
    }
    std::fs::write(folder.path().join("readme.md"), "points").unwrap();
    let frames = read_point_frames(folder.path()).unwrap();
    assert_eq!(frames.iter().map(|(n, p)| (*n, p[0].x)).collect::<Vec<_>>(), [(9, 9.0), (10, 10.0)]);
    std::fs::write(folder.path().join("out_9_hand.obj"), "v 0 0 0\n").unwrap();
    assert!(read_point_frames(folder.path()).unwrap_err().to_string().contains("two files of frame 9"));
}

proptest::proptest! {
    #[test]
    fn no_bytes_make_the_point_reader_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..300), format in 0..4usize) {
        let head = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
        let name = ["a.obj", "a.ply", "a.npy", "a.xyz"][format];
        let bytes = if format == 1 { [&head[..], &bytes].concat() } else { bytes };
        let _ = parse_points(Path::new(name), &bytes);
    }
}
