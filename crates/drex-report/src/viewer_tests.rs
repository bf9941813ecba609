//! What the scenes embed is what was put in, within the steps that are stated, and not too large.

use drex_splat::{Kind, Label};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::*;

/// A sphere of `rings` rings, with `2 rings (rings - 1)` vertices or so.
fn sphere(rings: u32, radius: f64) -> TriMesh {
    let around = 2 * rings;
    let mut vertices = vec![Point3::new(0.0, 0.0, -radius)];
    for i in 1..rings {
        let (z, r) = (std::f64::consts::PI * f64::from(i) / f64::from(rings)).sin_cos();
        for k in 0..around {
            let (s, c) = (std::f64::consts::TAU * f64::from(k) / f64::from(around)).sin_cos();
            vertices.push(Point3::new(radius * z * c, radius * z * s, -radius * r));
        }
    }
    vertices.push(Point3::new(0.0, 0.0, radius));
    let last = vertices.len() as u32 - 1;
    let at = |ring: u32, k: u32| 1 + ring * around + k % around;
    let mut faces = Vec::new();
    for k in 0..around {
        faces.push([0, at(0, k + 1), at(0, k)]);
        faces.push([last, at(rings - 2, k), at(rings - 2, k + 1)]);
        for ring in 0..rings - 2 {
            faces.push([at(ring, k), at(ring, k + 1), at(ring + 1, k + 1)]);
            faces.push([at(ring, k), at(ring + 1, k + 1), at(ring + 1, k)]);
        }
    }
    TriMesh::new(vertices, faces).unwrap()
}

fn parsed(scene: &Scene) -> Value {
    serde_json::from_str(&scene.to_json().unwrap()).unwrap()
}

fn raw(value: &Value) -> Vec<u8> {
    STANDARD.decode(value.as_str().unwrap()).unwrap()
}

fn u16s(value: &Value) -> Vec<u16> {
    raw(value).chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
}

fn f32s(value: &Value) -> Vec<f32> {
    raw(value).chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn triple(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|k| value[k].as_f64().unwrap())
}

/// Gaussians at these places, one colour, opacity and size each.
fn gaussians(of: &[([f32; 3], f32, f32)]) -> Gaussians {
    let mut g = Gaussians::new(Kind::Ellipsoid, 0);
    for (mean, logit, size) in of {
        g.means.push(*mean);
        g.rotations.push([0.5, -0.5, 0.5, 0.5]);
        g.log_scales.push([size.ln(), (0.5 * size).ln(), (0.25 * size).ln()]);
        g.logit_opacities.push(*logit);
        g.sh.extend([1.0, 0.0, -1.0]);
        g.labels.push(Label::OBJECT);
    }
    g
}

#[test]
fn a_mesh_comes_back_within_a_step_of_its_box() {
    let mesh = sphere(10, 0.05);
    let mut scene = Scene::new(0.3, 0.4).on_table(-0.05);
    let number = scene.mesh(&mesh, 5000).unwrap();
    scene.part(number, Look::Solid, [0.5; 3], &[Pose::identity().into()]).unwrap();
    let scene = parsed(&scene);
    let m = &scene["meshes"][0];
    let (lo, step) = (triple(&m["lo"]), triple(&m["step"]));
    let places = u16s(&m["v"]);
    assert_eq!(places.len(), 3 * mesh.vertices.len());
    for (cell, vertex) in places.chunks_exact(3).zip(&mesh.vertices) {
        for k in 0..3 {
            let back = lo[k] + step[k] * f64::from(cell[k]);
            assert!((back - vertex[k]).abs() <= 0.5001 * step[k], "{back} for {}", vertex[k]);
        }
    }
    let faces: Vec<u32> = u16s(&m["f"]).into_iter().map(u32::from).collect();
    assert_eq!(faces, mesh.faces.iter().flatten().copied().collect::<Vec<_>>());
    assert_eq!(m["wide"], false);
    assert_eq!(scene["table"], -0.05);
    assert!(scene["times"].is_null() && scene["splats"].is_null() && scene["follow"].is_null());
}

#[test]
fn many_vertices_get_wider_indices() {
    let mesh = sphere(200, 0.05);
    assert!(mesh.vertices.len() > 65536);
    let mut scene = Scene::new(0.0, 0.0);
    let number = scene.mesh(&mesh, mesh.faces.len()).unwrap();
    scene.part(number, Look::Solid, [0.5; 3], &[Pose::identity().into()]).unwrap();
    let m = &parsed(&scene)["meshes"][0];
    let faces: Vec<u32> = raw(&m["f"]).chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    assert_eq!(m["wide"], true);
    assert_eq!(faces, mesh.faces.iter().flatten().copied().collect::<Vec<_>>());
}

#[test]
fn poses_and_times_come_back_and_the_scene_frames_all_of_them() {
    let mesh = sphere(6, 0.1);
    let times = [0.0, 0.5, 2.0];
    let mut scene =
        Scene::new(0.0, 0.0).timed(&times, Some(0.5)).unwrap().phases([(0.0, "still"), (0.5, "away </script>")]);
    let number = scene.mesh(&mesh, 1000).unwrap();
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7);
    let places = [0.0, 1.0, 3.0].map(|x| Placed::from(Pose::from_parts(Translation3::new(x, 0.0, 0.0), turned)));
    scene.part(number, Look::Wire, [0.1, 0.2, 0.3], &places).unwrap();
    scene.follow_last();
    let text = scene.to_json().unwrap();
    assert!(!text.contains("</script"), "text must not end the script it stands in");
    let scene: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(scene["phases"][1][1], "away </script>");
    assert_eq!(f32s(&scene["times"]), [0.0, 0.5, 2.0]);
    assert_eq!(scene["start"], 0.5);
    let part = &scene["parts"][0];
    assert_eq!((&part["look"], &scene["follow"]), (&json!("wire"), &json!(0)));
    let poses = f32s(&part["poses"]);
    assert_eq!(poses.len(), 24);
    assert_eq!((poses[16], poses[23]), (3.0, 1.0));
    assert!((poses[3] - (0.35f32).cos()).abs() < 1e-6 && (poses[6] - (0.35f32).sin()).abs() < 1e-6);
    let (centre, radius) = (triple(&scene["centre"]), scene["radius"].as_f64().unwrap());
    assert!((centre[0] - 1.5).abs() < 1e-9 && radius > 1.6 && radius < 1.75, "{centre:?} {radius}");
}

#[test]
fn what_is_not_finite_or_does_not_match_is_refused() {
    let mesh = sphere(6, 0.1);
    assert!(Scene::new(0.0, 0.0).timed(&[0.0, 0.0], None).is_err());
    assert!(Scene::new(0.0, 0.0).timed(&[0.0, f64::NAN], None).is_err());
    let mut scene = Scene::new(0.0, 0.0).timed(&[0.0, 1.0, 2.0], None).unwrap();
    assert!(scene.part(0, Look::Solid, [0.0; 3], &[Pose::identity().into()]).is_err(), "there is no mesh yet");
    let number = scene.mesh(&mesh, 1000).unwrap();
    assert!(scene.part(number, Look::Solid, [0.0; 3], &[Pose::identity().into(); 2]).is_err());
    let lost = Pose::translation(f64::NAN, 0.0, 0.0);
    assert!(scene.part(number, Look::Solid, [0.0; 3], &[lost.into()]).is_err());
    assert!(scene.mesh(&TriMesh::default(), 1000).is_none());
    assert!(scene.to_json().is_none(), "nothing was placed");
}

#[test]
fn gaussians_come_back_and_those_outside_faint_or_huge_do_not() {
    let set = gaussians(&[
        ([0.01, 0.02, 0.03], 2.0, 0.004),
        ([0.5, 0.0, 0.0], 2.0, 0.004),
        ([0.0, 0.0, 0.0], -9.0, 0.004),
        ([0.0, 0.0, 0.0], 2.0, 5.0),
        ([-0.05, 0.05, -0.05], 0.0, 0.008),
        ([f32::NAN, 0.0, 0.0], 2.0, 0.004),
    ]);
    let (lo, hi) = (Point3::new(-0.1, -0.1, -0.1), Point3::new(0.1, 0.1, 0.1));
    let mut scene = Scene::new(0.0, 0.0);
    assert_eq!(scene.splats(&set, (lo, hi)), (2, 2));
    let scene = parsed(&scene);
    let s = &scene["splats"];
    // The larger one first: it covers more in spite of its lower opacity.
    let (corner, step) = (triple(&s["lo"]), triple(&s["step"]));
    let places: Vec<f64> =
        u16s(&s["p"]).iter().enumerate().map(|(i, c)| corner[i % 3] + step[i % 3] * f64::from(*c)).collect();
    for (back, given) in places.iter().zip([-0.05, 0.05, -0.05, 0.01, 0.02, 0.03]) {
        assert!((back - given).abs() < 2e-6, "{places:?}");
    }
    let (least, step) = (s["size_lo"].as_f64().unwrap(), s["size_step"].as_f64().unwrap());
    let sizes: Vec<f64> = raw(&s["s"]).iter().map(|b| (least + step * f64::from(*b)).exp()).collect();
    for (back, given) in sizes.iter().zip([0.008, 0.004, 0.002, 0.004, 0.002, 0.001]) {
        assert!((back / given - 1.0).abs() < 0.01, "{sizes:?}");
    }
    let turn: Vec<i8> = raw(&s["q"]).iter().map(|b| *b as i8).collect();
    assert_eq!(turn[..4], [127, -127, 127, 127]);
    // 0.5 ± 0.282 of 255, opacity 1/2.
    assert_eq!(raw(&s["c"])[..4], [199, 128, 56, 128]);
}

#[test]
fn a_scene_stays_small_whatever_goes_in() {
    let many: Vec<([f32; 3], f32, f32)> = (0..60_000u32)
        .map(|i| {
            let [a, b, c] = [7, 11, 13].map(|k| ((i * k % 1009) as f32 / 1009.0 - 0.5) * 0.1);
            ([a, b, c], 1.0, 0.001 + 1e-8 * i as f32)
        })
        .collect();
    let (lo, hi) = (Point3::new(-0.1, -0.1, -0.1), Point3::new(0.1, 0.1, 0.1));
    let mut scene = Scene::new(0.0, 0.0);
    assert_eq!(scene.splats(&gaussians(&many), (lo, hi)), (60_000, MOST_SPLATS));
    let fine = sphere(120, 0.1);
    let number = scene.mesh(&fine, 4000).unwrap();
    scene.part(number, Look::Solid, [0.5; 3], &[Pose::identity().into()]).unwrap();
    let text = scene.to_json().unwrap();
    assert!(text.len() < 700_000, "{} bytes", text.len());
    let faces = u16s(&parsed(&scene)["meshes"][0]["f"]).len() / 3;
    assert!((2000..=4000).contains(&faces), "{} of {} faces", faces, fine.faces.len());
}

#[test]
fn the_script_needs_no_network_and_ends_nowhere_early() {
    let script = include_str!("viewer.js");
    for word in ["http:", "https:", "</", "import ", "fetch(", "eval("] {
        assert!(!script.contains(word), "{word}");
    }
}

#[test]
fn a_surface_with_a_picture_is_embedded_as_it_is_and_one_that_is_too_large_is_not() {
    let mesh = sphere(60, 0.05);
    let uv: Vec<[f32; 2]> = (0..mesh.vertices.len()).map(|i| [i as f32 / mesh.vertices.len() as f32, 0.25]).collect();
    let picture = image::RgbImage::from_pixel(16, 8, image::Rgb([200, 40, 10]));
    let surface = |mesh: &TriMesh| Surface { mesh: mesh.clone(), texture: Some((uv.clone(), picture.clone())) };
    let mut scene = Scene::new(0.0, 0.0);
    let number = scene.textured(&surface(&mesh)).unwrap();
    scene.part(number, Look::Solid, [0.5; 3], &[Pose::identity().into()]).unwrap();
    let looks = &parsed(&scene)["meshes"][0]["looks"];
    let places = u16s(&looks["uv"]);
    assert_eq!(places.len(), 2 * uv.len());
    for (back, there) in places.iter().zip(uv.iter().flatten()) {
        assert!((f64::from(*back) / 65535.0 - f64::from(*there)).abs() < 1e-5);
    }
    let jpeg = looks["picture"].as_str().unwrap().strip_prefix("data:image/jpeg;base64,").unwrap();
    let read = image::load_from_memory(&STANDARD.decode(jpeg).unwrap()).unwrap().to_rgb8();
    assert!(read.get_pixel(7, 3).0.iter().zip([200, 40, 10]).all(|(a, b)| a.abs_diff(b) < 8), "{read:?}");

    let large = sphere(250, 0.05);
    assert!(large.faces.len() > MOST_TEXTURED);
    assert!(scene.textured(&surface(&large)).is_none());
    assert!(scene.textured(&Surface { mesh, texture: None }).is_none());
}
