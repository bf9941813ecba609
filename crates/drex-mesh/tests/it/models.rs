//! Files with looks: materials, texture coordinates, colours; and hostile files of every format.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use crate::support::cuboid;
use crate::support::shapes::{sphere, torus};
use drex_mesh::{
    Error, Material, Model, ModelPart, PlyFormat, Texture, parse_mesh, read_mesh, read_model, write_glb,
    write_obj_model, write_ply_as, write_stl, write_stl_text,
};
use nalgebra::Point3;
use proptest::prelude::*;

/// The first bytes of a picture are all that is looked at.
fn picture(kind: &str) -> Texture {
    let head: &[u8] = if kind == "png" { b"\x89PNG\r\n\x1a\n" } else { b"\xff\xd8\xff\xe0" };
    Texture::new([head, &[7; 21]].concat())
}

/// Two parts: a painted box with a picture and a ring with colours.
fn painted() -> Model {
    let cube = cuboid([0.0; 3], [0.5, 0.25, 0.125]);
    let uv = (0..8).map(|i| [(i & 1) as f32, i as f32 * 0.125]).collect();
    let ring = torus(0.5, 0.125, 8, 6);
    let colors = (0..ring.vertices.len()).map(|i| [i as u8, 255 - i as u8, 77]).collect();
    // Numbers that single precision holds.
    let ring = drex_core::TriMesh {
        vertices: ring.vertices.iter().map(|v| Point3::from(v.coords.map(|c| f64::from(c as f32)))).collect(),
        faces: ring.faces,
    };
    let wood = Material { name: "wood".into(), base_color: [1.0, 0.5, 0.25, 1.0], texture: Some(picture("png")) };
    let glass = Material { name: "glass".into(), base_color: [0.0, 0.5, 1.0, 0.25], texture: None };
    Model {
        parts: vec![
            ModelPart { name: "box".into(), mesh: cube, uv: Some(uv), colors: None, material: Some(0) },
            ModelPart { name: "ring".into(), mesh: ring, uv: None, colors: Some(colors), material: Some(1) },
        ],
        materials: vec![wood, glass],
    }
}

type Corner = ([f64; 3], Option<[f32; 2]>, Option<[u8; 3]>);

/// Face corners in order: OBJ numbers its vertices anew.
fn corners(part: &ModelPart) -> Vec<Corner> {
    let of = |v: &u32| {
        let v = *v as usize;
        (part.mesh.vertices[v].into(), part.uv.as_ref().map(|t| t[v]), part.colors.as_ref().map(|c| c[v]))
    };
    part.mesh.faces.iter().flatten().map(of).collect()
}

#[test]
fn glb_keeps_everything() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.glb");
    write_glb(&path, &painted()).unwrap();
    assert_eq!(read_model(&path).unwrap(), painted());
    assert_eq!(read_mesh(&path).unwrap(), painted().mesh());
}

#[test]
fn obj_keeps_everything_but_the_numbering() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a part.obj");
    let mut model = painted();
    // Colours stand behind the vertices of a file, so all parts of an OBJ have them or none.
    model.parts[0].colors = Some(vec![[1, 2, 3]; 8]);
    write_obj_model(&path, &model).unwrap();
    let back = read_model(&path).unwrap();
    assert_eq!(back.materials, model.materials);
    for (a, b) in back.parts.iter().zip(&model.parts) {
        assert_eq!((&a.name, a.material, corners(a)), (&b.name, b.material, corners(b)));
    }
    let names: Vec<String> =
        fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    assert_eq!(names.len(), 3, "{names:?}");
}

#[test]
fn names_from_a_file_never_leave_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let inner = folder.path().join("inner");
    fs::create_dir(&inner).unwrap();
    let mut model = painted();
    model.materials[0].name = "../../evil\nmap_Kd /etc/passwd".into();
    model.materials[1].name = "../../evil\nmap_Kd /etc/passwd".into();
    model.parts[0].name = "a\nf 1 2 3".into();
    write_obj_model(&inner.join("x.obj"), &model).unwrap();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    let back = read_model(&inner.join("x.obj")).unwrap();
    assert_eq!((back.parts.len(), back.materials.len(), back.mesh().faces.len()), (2, 2, model.mesh().faces.len()));

    for name in ["../x.mtl", "/etc/passwd", "C:\\x.mtl", "a/../../x.mtl"] {
        let path = inner.join("y.obj");
        fs::write(&path, format!("mtllib {name}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")).unwrap();
        let message = read_model(&path).unwrap_err().to_string();
        assert!(message.contains("y.obj") && message.contains("inside its folder"), "{message}");
        assert_eq!(read_mesh(&path).unwrap().faces.len(), 1);
        let path = inner.join("y.gltf");
        let json = format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":4,"uri":"{}"}}]}}"#,
            name.replace('\\', "\\\\")
        );
        fs::write(&path, json).unwrap();
        assert!(read_model(&path).unwrap_err().to_string().contains("inside its folder"));
    }
}

#[test]
fn an_obj_as_exporters_write_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(
        at("m.mtl"),
        "# made by hand\nnewmtl red paint\nKd 0.8 0.1 0.1\nTr 0.25\nmap_Kd -s 1 1 1 tex/a.jpg\nnewmtl other\n",
    )
    .unwrap();
    fs::create_dir(at("tex")).unwrap();
    fs::write(at("tex/a.jpg"), &picture("jpg").bytes).unwrap();
    fs::write(
        at("q.obj"),
        "mtllib m.mtl\no quad\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 0.5 0.5 0.5 # last\nvt 0 0\nvt 1 0\n\
         vt 1 1\nvn 0 0 1\nusemtl red paint\nf 1/1/1 2/2/1 3/3/1\nusemtl other\nf -4//1 -2//1 -1//1\nusemtl red paint\n\
         f 1/1 3/3 4/2\n",
    )
    .unwrap();
    let model = read_model(&at("q.obj")).unwrap();
    assert_eq!(model.materials.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(), ["red paint", "other"]);
    assert_eq!(model.materials[0].base_color, [0.8, 0.1, 0.1, 0.75]);
    assert_eq!(model.materials[0].texture.as_ref().unwrap().mime, "image/jpeg");
    assert_eq!(model.parts.len(), 2);
    assert_eq!(model.parts[0].mesh.faces.len(), 2);
    // OBJ counts v upwards, here it counts downwards.
    assert_eq!(model.parts[0].uv.as_ref().unwrap()[..3], [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]);
    assert_eq!(model.parts[0].colors.as_ref().unwrap()[1], [0, 255, 0]);
    assert_eq!(model.parts[1].uv, None);
    fs::remove_file(at("tex/a.jpg")).unwrap();
    assert_eq!(read_model(&at("q.obj")).unwrap().materials[0].texture, None);
    fs::remove_file(at("m.mtl")).unwrap();
    assert_eq!(read_model(&at("q.obj")).unwrap().materials.len(), 2);
    for (bad, line) in [("vt 0 nan\n", 1), ("v 0 0 0\nv 0 1 0\nv 1 0 0\nf 1/1 2/1 3/1\n", 4), ("f 1 2 3\n", 1)] {
        fs::write(at("bad.obj"), bad).unwrap();
        let message = read_model(&at("bad.obj")).unwrap_err().to_string();
        assert!(message.contains(&format!("bad.obj, line {line}")), "{message}");
    }
}

#[test]
fn ply_in_every_format_with_colours_and_stl_as_text() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mesh = sphere(0.05, 2);
    let colors: Vec<[u8; 3]> = (0..mesh.vertices.len()).map(|i| [i as u8, 3, 250]).collect();
    for format in [PlyFormat::Text, PlyFormat::Little, PlyFormat::Big] {
        write_ply_as(&at("a.ply"), &mesh, Some(&colors), format).unwrap();
        let model = read_model(&at("a.ply")).unwrap();
        assert_eq!((&model.parts[0].mesh, model.parts[0].colors.as_ref()), (&mesh, Some(&colors)));
        assert_eq!(read_mesh(&at("a.ply")).unwrap(), mesh);
        write_ply_as(&at("a.ply"), &mesh, None, format).unwrap();
        assert_eq!(read_model(&at("a.ply")).unwrap(), Model::plain(mesh.clone()));
    }
    assert!(write_ply_as(&at("a.ply"), &mesh, Some(&colors[1..]), PlyFormat::Text).is_err());
    write_stl_text(&at("a.stl"), &mesh).unwrap();
    let back = read_mesh(&at("a.stl")).unwrap();
    assert_eq!((back.vertices.len(), back.faces.len()), (mesh.vertices.len(), mesh.faces.len()));
    let volume = |m: &drex_core::TriMesh| m.mass_properties(1.0).unwrap().mass_kg;
    assert_eq!(volume(&back), volume(&mesh));
    let text = fs::read_to_string(at("a.stl")).unwrap();
    let cut = text.find("facet normal").map(|_| text.rfind("facet normal").unwrap()).unwrap();
    let message = parse_mesh(Path::new("cut.stl"), &text.as_bytes()[..cut]).unwrap_err().to_string();
    assert!(message.contains("cut.stl, line") && message.contains("endsolid"), "{message}");
}

#[test]
fn a_ply_that_was_cut_off_behind_its_faces_is_noticed() {
    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                  element face 1\nproperty list uchar int vertex_indices\nelement edge 2\nproperty int vertex1\n\
                  property int vertex2\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n0 1\n";
    let parse = |text: &str| parse_mesh(Path::new("a.ply"), text.as_bytes());
    let message = parse(header).unwrap_err().to_string();
    assert!(message.contains("a.ply") && message.contains("2 rows of edge"), "{message}");
    assert_eq!(parse(&format!("{header}1 2\n")).unwrap().faces, [[0, 1, 2]]);
}

#[test]
fn writers_refuse_what_no_reader_could_use() {
    let folder = tempfile::tempdir().unwrap();
    let good = painted();
    let broken: [fn(&mut Model); 6] = [
        |m| m.parts[0].mesh.faces[0][0] = 99,
        |m| m.parts[0].mesh.vertices[0].x = f64::NAN,
        |m| m.parts[0].uv = Some(vec![[0.0; 2]]),
        |m| m.parts[1].colors = Some(Vec::new()),
        |m| m.parts[1].material = Some(2),
        |m| m.parts.clear(),
    ];
    for harm in broken {
        let mut model = good.clone();
        harm(&mut model);
        assert!(write_glb(&folder.path().join("x.glb"), &model).is_err());
        assert!(write_obj_model(&folder.path().join("x.obj"), &model).is_err());
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_scene_that_repeats_itself_is_refused_at_once() {
    // 60 nodes with the next one as child twice: 2^60 visits if it were followed.
    let nodes: Vec<String> =
        (0..60).map(|i| if i < 59 { format!(r#"{{"children":[{0},{0}]}}"#, i + 1) } else { "{}".into() }).collect();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{}]}}"#,
        nodes.join(",")
    );
    let message = parse_mesh(Path::new("bomb.gltf"), json.as_bytes()).unwrap_err().to_string();
    assert!(message.contains("bomb.gltf") && message.contains("node"), "{message}");
    let looped =
        r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"children":[1]},{"children":[0]}]}"#;
    assert!(parse_mesh(Path::new("loop.gltf"), looped.as_bytes()).unwrap_err().to_string().contains("nested"));
}

#[test]
fn counts_beyond_the_file_are_refused_before_they_are_believed() {
    let mut stl = vec![0; 84];
    stl[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    let ply = |vertices: u64, list: &str| {
        format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty char x\nproperty char y\nproperty char z\n\
             element face 1\nproperty list {list} uchar vertex_indices\nend_header\n\0\0\0\0\0\0\u{7f}\u{7f}\u{7f}\u{7f}"
        )
    };
    let accessor = r#"{"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":4000000000,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}],
        "bufferViews":[{"buffer":0,"byteLength":16}],
        "buffers":[{"byteLength":16,"uri":"data:;base64,AAAAAAAAAAAAAAAAAAAAAA=="}]}"#;
    for (name, bytes) in [
        ("huge.stl", stl),
        ("huge.ply", ply(18_446_744_073_709_551_615, "uchar").into_bytes()),
        ("rows.ply", ply(90, "uchar").into_bytes()),
        ("list.ply", ply(2, "uint").into_bytes()),
        ("huge.gltf", accessor.as_bytes().to_vec()),
        ("huge.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n".to_vec()),
    ] {
        let message = parse_mesh(Path::new(name), &bytes).unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    }
}

/// One small file of every format.
static SAMPLES: LazyLock<Vec<(&str, Vec<u8>)>> = LazyLock::new(samples);

fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mesh = cuboid([0.0; 3], [0.5; 3]);
    let colors = vec![[1, 2, 3]; 8];
    write_stl(&at("a.stl"), &mesh).unwrap();
    write_stl_text(&at("b.stl"), &mesh).unwrap();
    write_ply_as(&at("a.ply"), &mesh, Some(&colors), PlyFormat::Text).unwrap();
    write_ply_as(&at("b.ply"), &mesh, Some(&colors), PlyFormat::Little).unwrap();
    write_ply_as(&at("c.ply"), &mesh, None, PlyFormat::Big).unwrap();
    write_glb(&at("a.glb"), &painted()).unwrap();
    write_obj_model(&at("a.obj"), &painted()).unwrap();
    ["a.stl", "b.stl", "a.ply", "b.ply", "c.ply", "a.glb", "a.obj"]
        .map(|name| (name, fs::read(at(name)).unwrap()))
        .to_vec()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_give_an_error_or_a_mesh(
        flips in prop::collection::vec((any::<u32>(), any::<u8>()), 0..6),
        cut in prop::option::of(any::<u32>()),
        copy in prop::option::of((any::<u32>(), any::<u32>(), 1u32..64)),
    ) {
        let folder = tempfile::tempdir().unwrap();
        for (name, whole) in SAMPLES.iter() {
            let mut bytes = whole.clone();
            for (at, value) in &flips {
                let n = bytes.len();
                bytes[*at as usize % n] = *value;
            }
            if let Some((from, to, length)) = copy {
                let n = bytes.len();
                let piece: Vec<u8> = bytes.iter().copied().skip(from as usize % n).take(length as usize).collect();
                bytes.splice(to as usize % n..to as usize % n, piece);
            }
            if let Some(cut) = cut {
                bytes.truncate(cut as usize % (bytes.len() + 1));
            }
            let path = folder.path().join(name);
            fs::write(&path, &bytes).unwrap();
            for mesh in [read_mesh(&path).ok(), read_model(&path).ok().map(|m| m.mesh())].into_iter().flatten() {
                prop_assert!(mesh.vertices.iter().all(|v| v.iter().all(|c| c.is_finite())));
                prop_assert!(mesh.faces.iter().flatten().all(|&v| (v as usize) < mesh.vertices.len()));
                prop_assert!(mesh.faces.len() <= bytes.len());
            }
            if let Err(e) = read_mesh(&path) {
                let named = matches!(e, Error::Core(_) | Error::Empty { .. });
                prop_assert!(named && e.to_string().contains(name), "{}", e);
            }
        }
    }

    #[test]
    fn random_headers_never_panic(
        counts in prop::array::uniform4(any::<u64>()), kinds in prop::array::uniform3(0usize..8), body in prop::collection::vec(any::<u8>(), 0..200)
    ) {
        let types = ["char", "uchar", "short", "ushort", "int", "uint", "float", "double"];
        let [a, b, c] = kinds.map(|k| types[k]);
        for count in counts.map(|c| c % 50).iter().chain(&counts) {
            for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
                let mut bytes = format!(
                    "ply\nformat {format} 1.0\nelement vertex {count}\nproperty {a} x\nproperty {a} y\nproperty {b} z\n\
                     element face {}\nproperty list {c} {b} vertex_indices\nend_header\n", counts[0] % 7).into_bytes();
                bytes.extend(&body);
                let _ = parse_mesh(Path::new("x.ply"), &bytes);
            }
            let mut stl = body.clone();
            stl.resize(84.max(stl.len()), 0);
            stl[80..84].copy_from_slice(&(*count as u32).to_le_bytes());
            let _ = parse_mesh(Path::new("x.stl"), &stl);
            let mut glb = b"glTF\x02\0\0\0".to_vec();
            glb.extend((counts[1] as u32).to_le_bytes());
            glb.extend((counts[2] as u32 % 300).to_le_bytes());
            glb.extend(b"JSON");
            glb.extend(&body);
            let _ = parse_mesh(Path::new("x.glb"), &glb);
        }
    }
}
