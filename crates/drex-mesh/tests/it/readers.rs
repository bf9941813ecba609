//! Mesh files in and out: every format gives the same mesh, damage is named, nothing panics.

use std::fs;
use std::path::Path;

use base64::Engine;
use drex_core::TriMesh;
use drex_mesh::{Error, parse_mesh, read_mesh, write_obj, write_ply, write_stl};
use nalgebra::Point3;
use proptest::prelude::*;

fn tetrahedron() -> TriMesh {
    let vertices = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]].map(Point3::from).to_vec();
    TriMesh { vertices, faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] }
}

fn volume(mesh: &TriMesh) -> f64 {
    mesh.mass_properties(1.0).unwrap().mass_kg
}

/// A glTF document of the tetrahedron under two nodes: moved and scaled by 2, then mirrored along x.
fn gltf_json(uri: Option<&str>, bytes: usize) -> String {
    let uri = uri.map(|u| format!("\"uri\":\"{u}\",")).unwrap_or_default();
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"translation":[1,2,3],"scale":[2,2,2],"children":[1]}},
                 {{"matrix":[-1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1],"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[0.1,0.2,0.3]}},
                     {{"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":24}}],
        "buffers":[{{{uri}"byteLength":{bytes}}}]}}"#
    )
}

fn gltf_buffer() -> Vec<u8> {
    let m = tetrahedron();
    let mut bytes: Vec<u8> =
        m.vertices.iter().flat_map(|v| v.iter().flat_map(|c| (*c as f32).to_le_bytes()).collect::<Vec<_>>()).collect();
    bytes.extend(m.faces.iter().flatten().flat_map(|&v| (v as u16).to_le_bytes()));
    bytes
}

fn glb(json: &str, bin: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().div_ceil(4) * 4, b' ');
    let total = 12 + 8 + json.len() + 8 + bin.len();
    let mut out = b"glTF".to_vec();
    for word in [2, total as u32, json.len() as u32] {
        out.extend(word.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(json);
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(bin);
    out
}

fn check_gltf(mesh: &TriMesh) {
    assert_eq!((mesh.vertices.len(), mesh.faces.len()), (4, 4));
    // Mirrored first, then scaled and moved; the winding stays outwards.
    assert!((mesh.vertices[1] - Point3::new(0.8, 2.0, 3.0)).norm() < 1e-6);
    assert!((volume(mesh) - 8.0 * volume(&tetrahedron())).abs() < 1e-8);
}

#[test]
fn what_is_written_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = tetrahedron();
    let at = |name: &str| folder.path().join(name);
    write_obj(&at("a.obj"), &mesh).unwrap();
    write_ply(&at("a.PLY"), &mesh).unwrap();
    write_stl(&at("a.stl"), &mesh).unwrap();
    assert_eq!(read_mesh(&at("a.obj")).unwrap(), mesh);
    assert_eq!(read_mesh(&at("a.PLY")).unwrap(), mesh);
    assert!((volume(&read_mesh(&at("a.stl")).unwrap()) - volume(&mesh)).abs() < 1e-9);
}

#[test]
fn ply_in_text_and_big_endian_with_other_properties() {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment made by hand\nelement vertex 4\nproperty uchar red\nproperty float x\n\
             property float y\nproperty double z\nelement edge 1\nproperty int a\nelement face 2\n\
             property list uchar int vertex_index\nproperty float quality\nend_header\n"
        )
    };
    let square = [[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [1.0, 1.0, 0.5], [0.0, 1.0, 0.5]];
    let mut text = header("ascii");
    let mut big = header("binary_big_endian").into_bytes();
    for [x, y, z] in square {
        text += &format!("255 {x} {y} {z}\n");
        big.push(255);
        big.extend((x as f32).to_be_bytes());
        big.extend((y as f32).to_be_bytes());
        big.extend(f64::to_be_bytes(z));
    }
    text += "7\n4 0 1 2 3 0.5\n3 2 1 0 0.25\n";
    big.extend(7i32.to_be_bytes());
    for (corners, quality) in [(&[0i32, 1, 2, 3][..], 0.5f32), (&[2, 1, 0], 0.25)] {
        big.push(corners.len() as u8);
        corners.iter().for_each(|c| big.extend(c.to_be_bytes()));
        big.extend(quality.to_be_bytes());
    }
    for bytes in [text.as_bytes(), &big] {
        let m = parse_mesh(Path::new("square.ply"), bytes).unwrap();
        assert_eq!(m.faces, [[0, 1, 2], [0, 2, 3], [2, 1, 0]]);
        assert_eq!(m.vertices, square.map(Point3::from));
    }
    let broken = text.replace("4 0 1 2 3", "4 0 1 2 x");
    let message = parse_mesh(Path::new("square.ply"), broken.as_bytes()).unwrap_err().to_string();
    assert!(message.contains("square.ply, line 20") && message.contains("face 0"), "{message}");
}

#[test]
fn gltf_embedded_beside_and_binary() {
    let folder = tempfile::tempdir().unwrap();
    let buffer = gltf_buffer();
    let embedded =
        format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(&buffer));
    let path = folder.path().join("t.gltf");
    fs::write(&path, gltf_json(Some(&embedded), buffer.len())).unwrap();
    check_gltf(&read_mesh(&path).unwrap());
    fs::write(folder.path().join("t 1.bin"), &buffer).unwrap();
    fs::write(&path, gltf_json(Some("t%201.bin"), buffer.len())).unwrap();
    check_gltf(&read_mesh(&path).unwrap());
    check_gltf(&parse_mesh(Path::new("t.glb"), &glb(&gltf_json(None, buffer.len()), &buffer)).unwrap());

    fs::remove_file(folder.path().join("t 1.bin")).unwrap();
    assert!(read_mesh(&path).unwrap_err().to_string().contains("t 1.bin"));
    fs::write(folder.path().join("t 1.bin"), &buffer[..40]).unwrap();
    assert!(read_mesh(&path).unwrap_err().to_string().contains("40 bytes"));
    let beyond = gltf_json(Some(&embedded), buffer.len()).replace("\"count\":12", "\"count\":13");
    assert!(parse_mesh(Path::new("t.gltf"), beyond.as_bytes()).is_err());
}

/// Without a panic on the way: the library that reads glTF indexes out of bounds here.
#[test]
fn a_mesh_without_its_accessor_is_named() {
    let text = gltf_json(None, 72).replace("\"POSITION\":0", "\"POSITION\":7");
    let hook = std::panic::take_hook();
    let panics = std::sync::Arc::new(std::sync::atomic::AtomicUsize::new(0));
    let count = panics.clone();
    let own = std::thread::current().id();
    std::panic::set_hook(Box::new(move |info| {
        count.fetch_add(usize::from(std::thread::current().id() == own), std::sync::atomic::Ordering::Relaxed);
        hook(info);
    }));
    let message = parse_mesh(Path::new("a.gltf"), text.as_bytes()).unwrap_err().to_string();
    assert!(message.contains("a.gltf: mesh 0 refers to accessor 7, there are 2"), "{message}");
    assert_eq!(panics.load(std::sync::atomic::Ordering::Relaxed), 0);
}

#[test]
fn damaged_files_are_named_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    assert!(read_mesh(&at("absent.stl")).unwrap_err().to_string().contains("absent.stl"));
    assert!(matches!(read_mesh(&at("photo.jpeg")), Err(Error::UnknownExtension { .. })));
    write_stl(&at("whole.stl"), &tetrahedron()).unwrap();
    let bytes = fs::read(at("whole.stl")).unwrap();
    for cut in [10, 83, 100, bytes.len() - 1] {
        let message = parse_mesh(Path::new("cut.stl"), &bytes[..cut]).unwrap_err().to_string();
        assert!(message.contains("cut.stl"), "{message}");
    }
    for (name, text) in [
        ("nan.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n"),
        ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("nothing.obj", "# only a comment\n"),
        (
            "points.ply",
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
        ),
        ("no_end.ply", "ply\nformat ascii 1.0\n"),
        ("huge.ply", "ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n"),
        (
            "list.ply",
            "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_index\nend_header\n-3 1 2\n",
        ),
        ("text.gltf", "{}"),
    ] {
        let message = parse_mesh(Path::new(name), text.as_bytes()).unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        for name in ["x.stl", "x.obj", "x.ply", "x.gltf", "x.glb"] {
            let _ = parse_mesh(Path::new(name), &bytes);
        }
    }

    #[test]
    fn a_changed_byte_or_a_cut_never_panics(at in 0usize..2000, value: u8, keep in 0usize..2000) {
        let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                   element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
        let binary = glb(&gltf_json(None, 72), &gltf_buffer());
        let embedded = gltf_json(Some(&format!(
            "data:;base64,{}", base64::engine::general_purpose::STANDARD.encode(gltf_buffer()))), 72);
        for (name, whole) in [("x.ply", ply.as_bytes()), ("x.glb", &binary), ("x.gltf", embedded.as_bytes())] {
            let mut bytes = whole.to_vec();
            let n = bytes.len();
            bytes[at % n] = value;
            let _ = parse_mesh(Path::new(name), &bytes);
            bytes.truncate(keep % (n + 1));
            let _ = parse_mesh(Path::new(name), &bytes);
        }
    }
}
