//! Names that come with the data and lead elsewhere: nothing is written outside of the output folder.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{drex, edit, tin_copy, tree};
use drex_splat::io::picture;

/// A folder with what must not be touched: `victim`, and whatever a test puts beside `out`.
fn sandbox() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("a/b");
    fs::create_dir_all(root.join("victim")).unwrap();
    fs::write(root.join("victim/notes.txt"), "mine").unwrap();
    (dir, root)
}

/// All files of the sandbox but those below `out`.
fn outside(dir: &tempfile::TempDir) -> BTreeMap<String, Vec<u8>> {
    tree(dir.path()).into_iter().filter(|(name, _)| !name.starts_with("a/b/out/")).collect()
}

/// A COLMAP model in text whose views have these names, with their photos where the names lead.
fn scan(root: &Path, names: &[&str]) -> PathBuf {
    let scan = root.join("scan");
    let model = scan.join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    fs::create_dir_all(scan.join("images")).unwrap();
    fs::write(model.join("cameras.txt"), "1 PINHOLE 16 12 20 20 8 6\n").unwrap();
    let mut images = String::new();
    for (i, name) in names.iter().enumerate() {
        let photo = scan.join("images").join(name);
        fs::create_dir_all(photo.parent().unwrap()).unwrap();
        picture::write_rgb(&photo, 16, 12, &[[0.5, 0.4, 0.3]; 16 * 12]).unwrap();
        images += &format!("{} 1 0 0 0 {} 0 2 1 {name}\n8 6 1\n", i + 1, 0.1 * i as f64);
    }
    fs::write(model.join("images.txt"), images).unwrap();
    fs::write(model.join("points3D.txt"), "1 0 0 0 90 90 90 0.1 1 0 2 0\n").unwrap();
    scan
}

#[test]
fn names_of_views_stay_in_the_folder() {
    let hostile: [&[&str]; 6] = [
        &["../../victim/a.png", "b.png", "c.png"],
        &["b.png", "deep/../../../victim/a.png", "c.png"],
        &["b.png", "c.png", "ABSOLUTE/victim/a.png"],
        &["..\\..\\victim\\a.png", "b.png", "c.png"],
        &["C:\\victim\\a.png", "b.png", "c.png"],
        // Two views, one file.
        &["a.png", "b.png", "A.png"],
    ];
    for names in hostile {
        let (dir, root) = sandbox();
        let names: Vec<String> = names.iter().map(|n| n.replace("ABSOLUTE", root.to_str().unwrap())).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let scan = scan(&root, &names);
        let before = outside(&dir);
        let out = root.join("out");
        let run = drex([
            "reconstruct",
            scan.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
            "--preset",
            "fast",
            "--iterations",
            "1",
        ]);
        run.fails_with(&["name"]);
        assert_eq!(outside(&dir), before, "{names:?}");
        assert!(!out.join("splat").exists(), "{names:?}: refused before anything is trained");
        assert!(run.stderr.contains("output folder") || run.stderr.contains("one file"), "{names:?}: {}", run.stderr);
    }
}

#[test]
fn pictures_of_views_are_each_a_file_of_their_own() {
    let (dir, root) = sandbox();
    let splats = root.join("splats.ply");
    let ball = drex_splat::train::from_points(&[[0.0; 3]], &[[200, 100, 50]], drex_splat::Kind::Ellipsoid, 0, 0.9);
    drex_splat::io::write_gaussians(&splats, &ball).unwrap();
    for (names, code) in [
        (["../../victim/a.png", "b.png"], 0), // folders of a name become part of the file's
        (["left/a.png", "left_a.png"], 1),
        (["a.png", "A.png"], 1),
    ] {
        let _ = fs::remove_dir_all(root.join("scan"));
        let scan = scan(&root, &names);
        let before = outside(&dir);
        let out = root.join("out");
        let run = drex([
            "render",
            splats.to_str().unwrap(),
            "--cameras",
            scan.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
        ]);
        assert_eq!(run.code, code, "{names:?}: {}", run.stderr);
        assert_eq!(outside(&dir), before, "{names:?}");
        assert_eq!(code == 1, run.stderr.contains("one file"), "{names:?}: {}", run.stderr);
    }
}

#[test]
fn the_mesh_of_a_scan_stays_in_the_twin() {
    for (mesh, word) in [
        ("../../victim/notes.obj", "leads upwards"),
        ("ABSOLUTE/victim/notes.obj", "is absolute"),
        ("linked/notes.obj", "is a link"),
        ("twin.toml", "makes an OBJ file"),
    ] {
        let (dir, root) = sandbox();
        let twin = root.join("twin");
        let photos = scan(&twin, &["a.png", "b.png", "c.png"]);
        assert!(photos.is_dir());
        #[cfg(unix)]
        std::os::unix::fs::symlink(root.join("victim"), twin.join("linked")).unwrap();
        let mesh = mesh.replace("ABSOLUTE", root.to_str().unwrap());
        let manifest = format!(
            "schema = 1\nname = \"x\"\n[scan]\nphotos = \"scan\"\nscale = 1.0\n[object]\nmesh = \"{mesh}\"\n[mass]\nweighed_kg = 0.1\n"
        );
        fs::write(twin.join("twin.toml"), manifest).unwrap();
        let before = outside(&dir);
        drex(["run", twin.to_str().unwrap()]).fails_with(&[word]);
        assert_eq!(outside(&dir), before, "{mesh}");
    }
}

/// Whatever file or folder of a twin is a link to somewhere else, nothing is written through it.
#[cfg(unix)]
#[test]
fn no_stage_writes_through_a_link() {
    let (_dir, twin) = tin_copy();
    let manifest = fs::read_to_string(twin.join("twin.toml")).unwrap();
    fs::write(twin.join("twin.toml"), manifest.split("[grasps]").next().unwrap()).unwrap();
    edit(&twin.join("twin.toml"), "prior_kg = 0.5", "weighed_kg = 0.24");
    edit(&twin.join("twin.toml"), "identify = [\"push/tilt\"]\n", "");
    let elsewhere = tempfile::tempdir().unwrap();
    fs::write(elsewhere.path().join("file"), "mine").unwrap();
    fs::write(elsewhere.path().join("collision_99.obj"), "mine too").unwrap();
    let before = tree(elsewhere.path());
    let links = [
        ("mass.json", "file"),
        ("mesh", ""),
        ("asset", ""),
        ("mesh/visual.obj", "file"),
        ("report.html", "file"),
        ("timings.json", "file"),
        ("twin.lock", "file"),
    ];
    for (link, target) in links {
        let path = twin.join(link);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let _ = fs::remove_dir_all(&path);
        let _ = fs::remove_file(&path);
        let target = if target.is_empty() { elsewhere.path().to_path_buf() } else { elsewhere.path().join(target) };
        std::os::unix::fs::symlink(target, &path).unwrap();
        drex(["report", twin.to_str().unwrap()]).fails_with(&["this is a link", link]);
        assert_eq!(tree(elsewhere.path()), before, "{link}");
        fs::remove_file(&path).unwrap();
    }
    let run = drex(["run", twin.to_str().unwrap()]);
    assert_eq!(run.code, 0, "{}", run.stderr);
}

#[test]
fn imported_names_stay_in_the_folder() {
    let (dir, root) = sandbox();
    let run_folder = root.join("runs/r1");
    fs::create_dir_all(&run_folder).unwrap();
    for object in ["", ".", "..", "../victim", "a\\\\b", "C:x", "nul", "x\\u0000y", "/victim"] {
        fs::write(run_folder.join("run.json"), format!("{{\"object\": \"{object}\"}}")).unwrap();
        let before = outside(&dir);
        let out = root.join("out");
        let run = drex(["import", "d-rex", root.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        run.fails_with(&["name"]);
        assert_eq!(outside(&dir), before, "{object}");
        assert!(!out.exists(), "{object}");
    }
}
