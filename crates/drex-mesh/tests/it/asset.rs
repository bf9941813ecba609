//! The asset on disk: what is in it, that it is whole or not there, that it is the same every time.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use drex_core::TriMesh;
use drex_mesh::{AssetOptions, Error, Texture, TextureMap, build_asset, read_mesh, read_model, write_obj};

use crate::support::PNG;
use nalgebra::{Matrix3, Point3};

fn cuboid(lo: [f64; 3], hi: [f64; 3]) -> TriMesh {
    let vertices = (0..8)
        .map(|i| Point3::new([lo[0], hi[0]][i & 1], [lo[1], hi[1]][i >> 1 & 1], [lo[2], hi[2]][i >> 2]))
        .collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    TriMesh { vertices, faces: quads.iter().flat_map(|&[a, b, c, d]: &[u32; 4]| [[a, b, c], [a, c, d]]).collect() }
}

/// A letter T, flat on the table, of two boxes that overlap by 10 mm.
fn letter_t(folder: &Path) -> PathBuf {
    let mut t = cuboid([-0.05, 0.0, 0.0], [0.05, 0.02, 0.03]);
    let stem = cuboid([-0.01, -0.06, 0.0], [0.01, 0.01, 0.03]);
    t.vertices.extend(&stem.vertices);
    t.faces.extend(stem.faces.iter().map(|f| f.map(|v| v + 8)));
    let path = folder.join("t.obj");
    write_obj(&path, &t).unwrap();
    path
}

fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().map(|n| n.parse().unwrap()).collect()
}

fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut out = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(at) = open.pop() {
        for entry in fs::read_dir(&at).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                out.insert(path.strip_prefix(folder).unwrap().to_path_buf(), fs::read(&path).unwrap());
            }
        }
    }
    out
}

#[test]
fn the_mjcf_says_what_the_asset_is() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("twin");
    let mut options = AssetOptions::default();
    options.mass_kg = Some(0.171);
    let asset = build_asset(&letter_t(folder.path()), &options).unwrap();
    asset.write(&out).unwrap();

    let xml = fs::read_to_string(out.join("asset/object.xml")).unwrap();
    let document = roxmltree::Document::parse(&xml).unwrap();
    let find = |tag: &str| document.descendants().filter(|n| n.has_tag_name(tag)).collect::<Vec<_>>();
    let inertial = find("inertial")[0];
    // By hand: the bar, and the part of the stem below it.
    let (bar, stem) = (0.1 * 0.02 * 0.03, 0.02 * 0.06 * 0.03);
    let y = (bar * 0.01 - stem * 0.03) / (bar + stem);
    let com = numbers(inertial.attribute("pos").unwrap());
    assert!(com[0].abs() < 1e-5 && (com[1] - y).abs() < 1e-5 && (com[2] - 0.015).abs() < 1e-5, "{com:?}");
    assert_eq!(inertial.attribute("mass").unwrap(), "0.171");
    let box_inertia = |m: f64, [x, y, z]: [f64; 3]| {
        Matrix3::from_diagonal(&nalgebra::Vector3::new(y * y + z * z, x * x + z * z, x * x + y * y)) * (m / 12.0)
    };
    let shift = |m: f64, d: f64| Matrix3::from_diagonal(&nalgebra::Vector3::new(d * d, 0.0, d * d)) * m;
    let density = 0.171 / (bar + stem);
    let truth = box_inertia(bar * density, [0.1, 0.02, 0.03])
        + shift(bar * density, 0.01 - y)
        + box_inertia(stem * density, [0.02, 0.06, 0.03])
        + shift(stem * density, -0.03 - y);
    let i = numbers(inertial.attribute("fullinertia").unwrap());
    let read = Matrix3::new(i[0], i[3], i[4], i[3], i[1], i[5], i[4], i[5], i[2]);
    assert!((read - truth).norm() < 1e-3 * truth.norm(), "{read} {truth}");

    let meshes = find("mesh");
    assert_eq!(meshes.len(), 1, "the visual mesh; boxes need none");
    for mesh in meshes {
        let file = mesh.attribute("file").unwrap();
        assert!(Path::new(file).is_relative());
        read_mesh(&out.join("asset").join(file)).unwrap();
    }
    let boxes: Vec<_> = find("geom").into_iter().filter(|g| g.attribute("type") == Some("box")).collect();
    let volumes = boxes.iter().map(|g| 8.0 * numbers(g.attribute("size").unwrap()).iter().product::<f64>());
    // The stem goes on into the bar.
    let whole_stem = 0.02 * 0.07 * 0.03;
    assert!(boxes.len() == 2 && (volumes.sum::<f64>() - bar - whole_stem).abs() < 2e-4 * bar);
    assert_eq!(find("freejoint").len(), 1);
    assert!(find("geom").iter().any(|g| g.attribute("type") == Some("plane")));
    let body = numbers(find("body")[0].attribute("pos").unwrap());
    assert!((body[2]).abs() < 1e-12 && (body[1] + y).abs() < 1e-5);
    let urdf = fs::read_to_string(out.join("asset/object.urdf")).unwrap();
    assert_eq!(
        roxmltree::Document::parse(&urdf).unwrap().descendants().filter(|n| n.has_tag_name("collision")).count(),
        2
    );
    let report: serde_json::Value = serde_json::from_slice(&fs::read(out.join("mesh/report.json")).unwrap()).unwrap();
    assert_eq!(report["how_closed"], "union");
    assert!((report["volume_m3"].as_f64().unwrap() - bar - stem).abs() < 2e-4 * bar);
}

#[test]
fn stable_poses_are_keyframes_and_in_the_report() {
    let folder = tempfile::tempdir().unwrap();
    let asset = build_asset(&letter_t(folder.path()), &AssetOptions::default()).unwrap();
    let out = folder.path().join("twin");
    asset.write(&out).unwrap();
    let xml = fs::read_to_string(out.join("asset/object.xml")).unwrap();
    let document = roxmltree::Document::parse(&xml).unwrap();
    let keys: Vec<_> = document.descendants().filter(|n| n.has_tag_name("key")).collect();
    assert_eq!(keys.len(), asset.stable_poses.len());
    for (key, pose) in keys.iter().zip(&asset.stable_poses) {
        let q = numbers(key.attribute("qpos").unwrap());
        let read = drex_core::pose::pose_from_wxyz([q[0], q[1], q[2]], [q[3], q[4], q[5], q[6]]).unwrap();
        assert!(drex_core::pose::pose_difference(&read, &pose.world_from_mesh).norm() < 1e-12);
        let lowest = asset.visual.vertices.iter().map(|v| (read * v).z).fold(f64::INFINITY, f64::min);
        assert!(lowest.abs() < 1e-12, "{lowest}");
    }
    let report: serde_json::Value = serde_json::from_slice(&fs::read(out.join("mesh/report.json")).unwrap()).unwrap();
    let sum: f64 = report["stable_poses"].as_array().unwrap().iter().map(|p| p["probability"].as_f64().unwrap()).sum();
    assert!((sum - 1.0).abs() < 1e-9);
    assert_eq!((&report["up_source"], &report["scale_source"]), (&"assumed".into(), &"the unit of the file".into()));
    let moments = &report["principal_moments_kg_m2"];
    assert!(moments[0].as_f64().unwrap() <= moments[1].as_f64().unwrap());
}

#[test]
fn the_glb_stands_upright() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = AssetOptions::default();
    options.up_in_mesh = Some(nalgebra::Vector3::y());
    let asset = build_asset(&letter_t(folder.path()), &options).unwrap();
    let out = folder.path().join("twin");
    asset.write(&out).unwrap();
    let glb = read_mesh(&out.join("asset/object.glb")).unwrap();
    assert_eq!((glb.vertices.len(), glb.faces.len()), (asset.visual.vertices.len(), asset.visual.faces.len()));
    for (a, b) in glb.vertices.iter().zip(&asset.visual.vertices) {
        // World +z is glTF +y, world +y is glTF -z.
        let w = asset.world_from_mesh_at_rest * b;
        assert!((a - Point3::new(w.x, w.z, -w.y)).norm() < 1e-8, "{a} {w}");
    }
    // The asset of the GLB is the asset of the mesh: +y is up without being told.
    let again = build_asset(&out.join("asset/object.glb"), &AssetOptions::default()).unwrap();
    assert!((again.report.volume_m3 / asset.report.volume_m3 - 1.0).abs() < 1e-5);
    assert!((again.report.rest_height_of_center_m - asset.report.rest_height_of_center_m).abs() < 1e-6);
}

#[test]
fn a_textured_asset_keeps_its_mesh_and_carries_its_picture_everywhere() {
    let folder = tempfile::tempdir().unwrap();
    let mut asset = build_asset(&letter_t(folder.path()), &AssetOptions::default()).unwrap();
    let out = folder.path().join("twin");
    // Every face has a place of its own: all its corners differ from those of the faces beside it.
    let place = |f: usize, k: usize| [f as f32 / 64.0, [0.25, 0.5, 0.75][k]];
    let uv: Vec<_> = (0..asset.visual.faces.len()).map(|f| [0, 1, 2].map(|k| place(f, k))).collect();
    asset.texture = Some(TextureMap { uv: uv.clone(), picture: Texture::new(PNG) });
    asset.write(&out).unwrap();
    assert_eq!(read_mesh(&out.join("mesh/visual.obj")).unwrap(), asset.visual);
    for (file, parts) in [("mesh/visual.obj", 1), ("asset/object.glb", 1)] {
        let model = read_model(&out.join(file)).unwrap();
        assert_eq!((model.parts.len(), model.materials.len()), (parts, 1), "{file}");
        assert_eq!(&model.materials[0].texture.as_ref().unwrap().bytes[..], PNG, "{file}");
        let part = &model.parts[0];
        assert_eq!(part.material, Some(0));
        let coordinates = part.uv.as_ref().unwrap();
        for (face, corners) in part.mesh.faces.iter().zip(&uv) {
            for (v, uv) in face.iter().zip(corners) {
                let found = coordinates[*v as usize];
                assert!((0..2).all(|k| (found[k] - uv[k]).abs() < 1e-6), "{file}: {found:?} {uv:?}");
            }
        }
    }
    let xml = fs::read_to_string(out.join("asset/object.xml")).unwrap();
    for part in [
        r#"<texture name="visual" type="2d" file="../mesh/visual.png"/>"#,
        r#"<material name="visual" texture="visual""#,
        r#"mesh="visual" material="visual" rgba="1 1 1 1"/>"#,
    ] {
        assert!(xml.contains(part), "{part}\n{xml}");
    }
    // Without it nothing of it is left, and what others put there stays.
    fs::write(out.join("mesh/photo.png"), PNG).unwrap();
    asset.texture = None;
    asset.write(&out).unwrap();
    let names: Vec<_> = files(&out.join("mesh")).into_keys().map(|p| p.display().to_string()).collect();
    assert!(names.contains(&"photo.png".to_owned()), "{names:?}");
    assert!(!names.iter().any(|n| n == "visual.png" || n == "visual.mtl"), "{names:?}");
    assert!(!fs::read_to_string(out.join("asset/object.xml")).unwrap().contains("<texture"));
    assert_eq!(read_mesh(&out.join("mesh/visual.obj")).unwrap(), asset.visual);

    let refused = |uv: &[[[f32; 2]; 3]], picture: &[u8], what: &str| {
        let mut asset = asset.clone();
        asset.texture = Some(TextureMap { uv: uv.to_vec(), picture: Texture::new(picture) });
        let message = asset.write(&out).unwrap_err().to_string();
        assert!(message.contains(what), "{message}");
    };
    refused(&uv[1..], PNG, "faces with texture coordinates");
    refused(&uv, &[0xff, 0xd8, 0xff, 0xe0], "a texture of type image/jpeg");
    let mut endless = uv.clone();
    endless[2][1][0] = f32::NAN;
    refused(&endless, PNG, "is not finite");
}

#[test]
fn a_hollow_object_weighs_its_wall() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("can.obj");
    write_obj(&path, &cuboid([0.0; 3], [0.06, 0.06, 0.1])).unwrap();
    let mut options = AssetOptions::default();
    options.wall_m = Some(0.002);
    options.density_kg_m3 = 2700.0;
    let can = build_asset(&path, &options).unwrap();
    let wall = 0.06 * 0.06 * 0.1 - 0.056 * 0.056 * 0.096;
    assert!((can.report.mass_kg / (2700.0 * wall) - 1.0).abs() < 5e-3, "{}", can.report.mass_kg / (2700.0 * wall));
    assert!(can.report.warnings.is_empty(), "{:?}", can.report.warnings);
    // Of the same mass, the hollow one is harder to turn.
    options.mass_kg = Some(0.1);
    let hollow = build_asset(&path, &options).unwrap();
    options.wall_m = None;
    let solid = build_asset(&path, &options).unwrap();
    assert!(hollow.properties.inertia[(2, 2)] > 1.3 * solid.properties.inertia[(2, 2)]);
    assert_eq!(hollow.report.mass_kg, 0.1);
    options.wall_m = Some(-0.001);
    assert!(build_asset(&path, &options).unwrap_err().to_string().contains("wall thickness"));
}

#[test]
fn the_same_bytes_every_time_and_nothing_stale() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = letter_t(folder.path());
    let write = |threads: usize, name: &str| {
        let out = folder.path().join(name);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| build_asset(&mesh, &AssetOptions::default()).unwrap().write(&out).unwrap());
        out
    };
    let first = write(1, "one");
    fs::write(first.join("mesh/collision_02.obj"), "stale").unwrap();
    fs::write(first.join("mesh/collision_notes.obj"), "mine").unwrap();
    write(3, "one");
    assert!(!first.join("mesh/collision_02.obj").exists());
    fs::remove_file(first.join("mesh/collision_notes.obj")).unwrap();
    let (a, b) = (files(&first), files(&write(2, "two")));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    assert_eq!(a.len(), 7);
    assert_eq!(a, b);
}

#[test]
fn an_output_that_cannot_be_written_is_named_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let asset = build_asset(&letter_t(folder.path()), &AssetOptions::default()).unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "in the way").unwrap();
    let message = asset.write(&file).unwrap_err().to_string();
    assert!(message.contains("file"), "{message}");
    assert_eq!(fs::read_to_string(&file).unwrap(), "in the way");
    // "mesh" is in the way, so nothing may appear under "out" but it.
    let out = folder.path().join("out");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("mesh"), "in the way").unwrap();
    assert!(asset.write(&out).is_err());
    assert_eq!(files(&out).len(), 1);
}

#[test]
fn a_mesh_without_volume_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sheet.obj");
    let mut sheet = cuboid([0.0; 3], [0.1, 0.1, 0.1]);
    sheet.faces.truncate(2);
    write_obj(&path, &sheet).unwrap();
    let e = build_asset(&path, &AssetOptions::default()).unwrap_err();
    assert!(matches!(e, Error::NoVolume { .. }));
    let message = e.to_string();
    assert!(message.contains("sheet.obj") && message.contains("thickness"), "{message}");
}
