//! Small files that ask for much: buffers are shared, what cannot be is refused with the limit and the option that raises it.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

use std::f64::consts::TAU;
use std::path::Path;

use allocation_counter::measure;
use drex_core::TriMesh;
use drex_mesh::{CheckOptions, ClosingMethod, check_mesh, parse_mesh, read_model, repair, solid_properties};
use nalgebra::Point3;

/// A picture in a GLB, bytes.
const PICTURE: usize = 4_000_000;

/// A triangle, and materials that show one of some pictures, all with the same bytes.
fn glb(materials: usize, images: usize, nodes: usize) -> Vec<u8> {
    let list = |n: usize, item: &dyn Fn(usize) -> String| (0..n).map(item).collect::<Vec<_>>().join(",");
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[{}]}}],"nodes":[{}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],"materials":[{}],"textures":[{}],"images":[{}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}],
"bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":{PICTURE}}}],"buffers":[{{"byteLength":{}}}]}}"#,
        list(nodes, &|k| k.to_string()),
        list(nodes, &|_| r#"{"mesh":0}"#.to_owned()),
        list(materials, &|k| format!(r#"{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":{k}}}}}}}"#)),
        list(materials, &|k| format!(r#"{{"source":{}}}"#, k % images)),
        list(images, &|_| r#"{"bufferView":1,"mimeType":"image/png"}"#.to_owned()),
        PICTURE + 36
    );
    let mut text = json.into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut binary: Vec<u8> =
        [0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|c| c.to_le_bytes()).collect();
    binary.resize(PICTURE + 36, 7);
    let mut out = b"glTF".to_vec();
    for word in [2, 12 + 8 + text.len() + 8 + binary.len(), text.len()] {
        out.extend((word as u32).to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(text);
    out.extend((binary.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(binary);
    out
}

#[test]
fn materials_share_the_bytes_of_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    std::fs::write(&path, glb(500, 1, 1)).unwrap();
    let mut model = None;
    let used = measure(|| model = Some(read_model(&path).unwrap()));
    let textures: Vec<_> = model.as_ref().unwrap().materials.iter().map(|m| m.texture.as_ref().unwrap()).collect();
    assert_eq!((textures.len(), textures[499].bytes.len()), (500, PICTURE));
    assert!(textures.iter().all(|t| std::sync::Arc::ptr_eq(&t.bytes, &textures[0].bytes)));
    // The file, its binary part, the picture.
    assert!(used.bytes_max < 6 * PICTURE as u64, "{}", used.bytes_max);
}

#[test]
fn a_scene_that_repeats_itself_beyond_the_limit_is_refused() {
    let bytes = glb(2000, 2000, 1);
    let mut message = String::new();
    let used = measure(|| message = parse_mesh(Path::new("a.glb"), &bytes).unwrap_err().to_string());
    assert!(message.contains("limit is 4295 MB") && message.contains("--max-memory"), "{message}");
    assert!(used.bytes_max < 4500 << 20, "{}", used.bytes_max);
    // Few bytes that say the same again and again are no more than what they make.
    let mesh = parse_mesh(Path::new("a.glb"), &glb(1, 1, 1000)).unwrap();
    assert_eq!((mesh.vertices.len(), mesh.faces.len()), (3000, 1000));
}

fn rim(n: usize, k: usize, z: f64) -> Point3<f64> {
    let (sin, cos) = (TAU * k as f64 / n as f64).sin_cos();
    Point3::new(0.05 * cos, 0.05 * sin, z)
}

/// A cylinder whose ends are polygons, divided by `triangles`.
fn cylinder(n: usize, triangles: impl Fn(usize) -> Vec<[usize; 3]>) -> TriMesh {
    let vertices = [0.0, 0.05].into_iter().flat_map(|z| (0..n).map(move |k| rim(n, k, z))).collect();
    let mut faces = Vec::new();
    for [a, b, c] in triangles(n) {
        faces.extend([[a, c, b], [n + a, n + b, n + c]]);
    }
    for k in 0..n {
        let next = (k + 1) % n;
        faces.extend([[k, next, n + next], [k, n + next, n + k]]);
    }
    TriMesh { vertices, faces: faces.into_iter().map(|f| f.map(|v| v as u32)).collect() }
}

fn fan(n: usize) -> Vec<[usize; 3]> {
    (2..n).map(|k| [0, k - 1, k]).collect()
}

#[test]
fn ends_with_thousands_of_corners_are_as_exact_as_others() {
    for n in [2000, 2001] {
        let truth = 0.5 * n as f64 * (TAU / n as f64).sin() * 0.05_f64.powi(3);
        for mesh in [cylinder(n, drex_core::mesh::polygon_triangles), cylinder(n, fan)] {
            let solid = solid_properties(&mesh).unwrap();
            assert_eq!(solid.closing_method, ClosingMethod::Exact);
            assert!((solid.volume_m3 / truth - 1.0).abs() < 1e-12, "{n}: {} {truth}", solid.volume_m3);
            assert!((solid.properties.center_of_mass - Point3::new(0.0, 0.0, 0.025)).norm() < 1e-12);
        }
    }
    let report = check_mesh(&cylinder(2000, fan), &CheckOptions::default());
    assert!(report.passed(), "{report}");
}

#[test]
fn an_open_bowl_with_a_ragged_rim_of_1500_edges_has_its_mass_in_it() {
    const RIM: usize = 1500;
    const RINGS: usize = 6;
    let noise = |k: usize| ((k * 7919 + 13) % 1009) as f64 / 1009.0 - 0.5;
    for (ragged, most) in [(0.0, 1e-3), (0.1, 0.03)] {
        let mut vertices = vec![Point3::new(0.0, 0.0, -0.05)];
        for ring in 1..=RINGS {
            let (sin, cos) = (TAU / 4.0 * ring as f64 / RINGS as f64).sin_cos();
            for k in 0..RIM {
                let off = if ring == RINGS { ragged * noise(k) } else { 0.0 };
                vertices.push(
                    Point3::from(rim(RIM, k, 0.0).coords * (sin + off))
                        - nalgebra::Vector3::z() * (0.05 * (cos - noise(k + 1) * off)),
                );
            }
        }
        let at = |ring: usize, k: usize| (1 + (ring - 1) * RIM + k % RIM) as u32;
        let mut faces = Vec::new();
        for k in 0..RIM {
            faces.push([0, at(1, k + 1), at(1, k)]);
            for ring in 1..RINGS {
                faces.push([at(ring, k), at(ring, k + 1), at(ring + 1, k + 1)]);
                faces.push([at(ring, k), at(ring + 1, k + 1), at(ring + 1, k)]);
            }
        }
        let (mesh, report) = repair(&TriMesh { vertices, faces }, &Default::default()).unwrap();
        assert_eq!(report.open_edges, RIM);
        let solid = solid_properties(&mesh).unwrap();
        // Half a ball of six rings.
        let center = solid.properties.center_of_mass;
        assert!(center.x.hypot(center.y) < most * 0.05 && (-0.025..-0.015).contains(&center.z), "{center}");
        assert!(solid.properties.is_physical() && (2.2e-4..2.7e-4).contains(&solid.volume_m3), "{}", solid.volume_m3);
    }
}
