//! Objects with joints: one tree in MJCF and URDF, masses shared, mistakes named.

use std::fs;

use crate::support::{hinge, stapler};
use drex_core::TriMesh;
use drex_mesh::JointConfig;
use drex_mesh::{AssetOptions, Error, Part, articulated_asset, read_mesh};
use nalgebra::Vector3;

fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().map(|n| n.parse().unwrap()).collect()
}

fn vector(node: roxmltree::Node<'_, '_>, attribute: &str) -> Vector3<f64> {
    Vector3::from_iterator(numbers(node.attribute(attribute).unwrap()))
}

#[test]
fn the_mjcf_is_one_tree_in_one_frame() {
    let folder = tempfile::tempdir().unwrap();
    let (parts, joints) = stapler();
    let mut options = AssetOptions::default();
    options.mass_kg = Some(0.3);
    let asset = articulated_asset(&parts, &joints, &options).unwrap();
    asset.write(folder.path()).unwrap();

    let xml = fs::read_to_string(folder.path().join("asset/object.xml")).unwrap();
    let document = roxmltree::Document::parse(&xml).unwrap();
    let find = |tag: &str, name: &str| {
        document.descendants().find(|n| n.has_tag_name(tag) && n.attribute("name") == Some(name)).unwrap()
    };
    // base > arm > tray, and the foot fixed to the base.
    assert_eq!(find("body", "arm").parent().unwrap().attribute("name"), Some("base"));
    assert_eq!(find("body", "tray").parent().unwrap().attribute("name"), Some("arm"));
    assert_eq!(find("body", "foot").parent().unwrap().attribute("name"), Some("base"));
    for name in ["arm", "tray", "foot"] {
        assert!(find("body", name).attribute("pos").is_none(), "all bodies share the mesh frame");
    }
    let hinge = find("joint", "hinge");
    assert_eq!(hinge.attribute("type"), Some("hinge"));
    assert!((vector(hinge, "pos") - Vector3::new(-0.05, 0.0, 0.022)).norm() < 1e-12);
    assert!((vector(hinge, "axis") - -Vector3::y()).norm() < 1e-12, "axes are unit vectors");
    assert_eq!(numbers(hinge.attribute("range").unwrap()), [0.0, 1.2]);
    assert_eq!(find("joint", "rail").attribute("type"), Some("slide"));
    assert!(document.descendants().all(|n| n.attribute("name") != Some("weld") || !n.has_tag_name("joint")));
    assert_eq!(document.descendants().filter(|n| n.has_tag_name("freejoint")).count(), 1);
    assert_eq!(document.descendants().filter(|n| n.has_tag_name("exclude")).count(), 3);
    // Keyframes have the free joint and the two that move.
    for key in document.descendants().filter(|n| n.has_tag_name("key")) {
        assert_eq!(numbers(key.attribute("qpos").unwrap()).len(), 9);
    }
    for mesh in document.descendants().filter(|n| n.has_tag_name("mesh")) {
        read_mesh(&folder.path().join("asset").join(mesh.attribute("file").unwrap())).unwrap();
    }
    // The masses: the foot's own, the rest by volume.
    let mass = |name: &str| {
        let inertial = find("body", name).children().find(|n| n.has_tag_name("inertial")).unwrap();
        numbers(inertial.attribute("mass").unwrap())[0]
    };
    let volumes = [0.12 * 0.03 * 0.02, 0.11 * 0.02 * 0.015, 0.05 * 0.01 * 0.005];
    for (name, v) in ["base", "arm", "tray"].iter().zip(volumes) {
        assert!((mass(name) - 0.28 * v / volumes.iter().sum::<f64>()).abs() < 1e-9, "{name}");
    }
    assert_eq!(mass("foot"), 0.02);
    assert!((asset.properties.mass_kg - 0.3).abs() < 1e-12);
    assert!((asset.stable_poses.iter().map(|p| p.probability).sum::<f64>() - 1.0).abs() < 1e-9);

    let glb = read_mesh(&folder.path().join("asset/object.glb")).unwrap();
    assert_eq!(glb.faces.len(), parts.iter().map(|p| p.mesh.faces.len()).sum::<usize>());
}

#[test]
fn the_urdf_puts_every_mesh_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let (parts, joints) = stapler();
    articulated_asset(&parts, &joints, &AssetOptions::default()).unwrap().write(folder.path()).unwrap();
    let urdf = fs::read_to_string(folder.path().join("asset/object.urdf")).unwrap();
    let document = roxmltree::Document::parse(&urdf).unwrap();
    let child = |n: roxmltree::Node<'_, '_>, tag: &str| n.children().find(|c| c.has_tag_name(tag)).map(|c| c.id());
    let node = |id| document.get_node(id).unwrap();
    let joint_of = |link: &str| {
        document
            .descendants()
            .filter(|n| n.has_tag_name("joint"))
            .find(|n| node(child(*n, "child").unwrap()).attribute("link") == Some(link))
    };
    for part in &parts {
        // Down the chain of joints, then into the mesh's own offset.
        let mut place = Vector3::zeros();
        let mut link = part.name.clone();
        while let Some(joint) = joint_of(&link) {
            place += vector(node(child(joint, "origin").unwrap()), "xyz");
            link = node(child(joint, "parent").unwrap()).attribute("link").unwrap().to_string();
        }
        let element =
            document.descendants().find(|n| n.has_tag_name("link") && n.attribute("name") == Some(&part.name));
        for visual in element.unwrap().children().filter(|n| n.has_tag_name("visual") || n.has_tag_name("collision")) {
            let offset = child(visual, "origin").map_or(Vector3::zeros(), |o| vector(node(o), "xyz"));
            // A mesh is in the frame of all, a box has its own in its middle.
            let (lo, hi) = part.mesh.bounds().unwrap();
            let (own, to) = match visual.descendants().find(|n| n.has_tag_name("box")) {
                Some(cuboid) => {
                    let sorted = |v: Vector3<f64>| {
                        let mut v: [f64; 3] = v.into();
                        v.sort_by(f64::total_cmp);
                        Vector3::from(v)
                    };
                    let apart = sorted(vector(cuboid, "size")) - sorted(hi - lo);
                    assert!(apart.norm() < 1e-9, "{}", part.name);
                    (nalgebra::center(&lo, &hi).coords, 1e-9)
                }
                None => (Vector3::zeros(), 1e-15),
            };
            assert!((place + offset - own).norm() < to, "{}", part.name);
        }
        let inertial = node(child(element.unwrap(), "inertial").unwrap());
        let com = place + vector(node(child(inertial, "origin").unwrap()), "xyz");
        let (lo, hi) = part.mesh.bounds().unwrap();
        assert!((com - nalgebra::center(&lo, &hi).coords).norm() < 1e-9, "{}", part.name);
    }
    let kinds: Vec<_> =
        document.descendants().filter(|n| n.has_tag_name("joint")).map(|n| n.attribute("type").unwrap()).collect();
    assert_eq!(kinds, ["revolute", "fixed", "prismatic"]);
}

#[test]
fn mistakes_are_named() {
    let (parts, joints) = stapler();
    let options = AssetOptions::default();
    let refused = |parts: &[Part], joints: &[JointConfig], options: &AssetOptions, word: &str| {
        let e = articulated_asset(parts, joints, options).unwrap_err();
        assert!(e.to_string().contains(word), "{e}");
        e
    };
    refused(&parts, &joints[1..], &options, "not joined");
    refused(&[], &[], &options, "no parts");
    let mut circle = joints.clone();
    circle.push(hinge("back", "tray", "base"));
    refused(&parts, &circle, &options, "circle");
    let mut flat = parts.clone();
    flat[1].mesh.faces.truncate(2);
    let e = refused(&flat, &joints, &options, "arm");
    assert!(matches!(e, Error::NoVolume { .. }), "{e}");
    let mut light = options.clone();
    light.mass_kg = Some(0.01);
    refused(&parts, &joints, &light, "the parts weigh 0.02 kg, the whole 0.01 kg");
    let mut heavy = parts.clone();
    heavy[0].mass_kg = Some(f64::NAN);
    refused(&heavy, &joints, &options, "mass");
    let empty = Part { name: "arm".into(), mesh: TriMesh::default(), mass_kg: None };
    let mut hollow = parts.clone();
    hollow[1] = empty;
    refused(&hollow, &joints, &options, "no triangles");
}

#[test]
fn millimetres_are_told_from_all_parts_together() {
    let (mut parts, joints) = stapler();
    for part in &mut parts {
        part.mesh = part.mesh.scaled(1000.0);
    }
    let asset = articulated_asset(&parts, &joints, &AssetOptions::default()).unwrap();
    // The tray alone, 5 mm high, would be doubtful.
    let (lo, hi) = asset.parts[2].1.visual.bounds().unwrap();
    assert!(((hi - lo) - Vector3::new(0.05, 0.01, 0.005)).norm() < 1e-9);
}

#[test]
fn the_same_bytes_every_time_and_nothing_stale() {
    let folder = tempfile::tempdir().unwrap();
    let (parts, joints) = stapler();
    let write = |name: &str| {
        let asset = articulated_asset(&parts, &joints, &AssetOptions::default()).unwrap();
        asset.write(&folder.path().join(name)).unwrap();
    };
    write("a");
    fs::write(folder.path().join("a/mesh/arm_collision_07.obj"), "stale").unwrap();
    fs::write(folder.path().join("a/mesh/notes.obj"), "mine").unwrap();
    write("a");
    write("b");
    assert!(!folder.path().join("a/mesh/arm_collision_07.obj").exists());
    assert!(folder.path().join("a/mesh/notes.obj").exists());
    for file in ["asset/object.xml", "asset/object.urdf", "asset/object.glb", "mesh/report.json", "mesh/arm_visual.obj"]
    {
        let read = |name: &str| fs::read(folder.path().join(name).join(file)).unwrap();
        assert!(read("a") == read("b"), "{file}");
    }
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join("a/mesh/report.json")).unwrap()).unwrap();
    assert_eq!((&report["root"], &report["joints"][0]["kind"]), (&"base".into(), &"hinge".into()));
}
