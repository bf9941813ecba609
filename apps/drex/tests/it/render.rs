//! `drex render`: pictures, maps and moving objects from the command line.

use std::fs;
use std::path::Path;

use crate::common::{Run, drex, shared_data};
use drex_splat::io::write_gaussians;
use drex_splat::{Gaussians, Kind, Label};

/// One grey-free splat of this colour at `mean`, 0.1 units wide.
fn splat(kind: Kind, mean: [f32; 3], colour: [f32; 3]) -> Gaussians {
    let mut g = Gaussians::new(kind, 0);
    g.means.push(mean);
    g.rotations.push([1.0, 0.0, 0.0, 0.0]);
    g.log_scales.push([0.1f32.ln(); 3]);
    g.logit_opacities.push(6.0);
    g.sh.extend(colour.map(|c| (c - 0.5) / 0.282_094_8));
    g.labels.push(Label::BACKGROUND);
    g
}

fn render(folder: &Path, options: &[&str]) -> Run {
    let mut arguments = vec!["render".to_owned(), folder.join("scene.ply").display().to_string()];
    arguments.extend(["--json".into(), "--out".into(), folder.join("out").display().to_string()]);
    arguments.extend(options.iter().map(|o| o.replace("@", folder.to_str().unwrap())));
    drex(arguments)
}

/// Width, height and red, green, blue of a picture.
fn picture(path: &Path) -> (usize, usize, Vec<[u8; 3]>) {
    let image = image::open(path).unwrap().to_rgb8();
    let pixels = image.pixels().map(|p| p.0).collect();
    (image.width() as usize, image.height() as usize, pixels)
}

/// Centre of the pixels in which `channel` is bright.
fn bright(path: &Path, channel: usize) -> [f64; 2] {
    let (width, _, pixels) = picture(path);
    let of: Vec<usize> = (0..pixels.len()).filter(|&i| pixels[i][channel] > 100).collect();
    assert!(!of.is_empty(), "nothing bright in {}", path.display());
    let mean = |f: &dyn Fn(usize) -> usize| of.iter().map(|&i| f(i) as f64 + 0.5).sum::<f64>() / of.len() as f64;
    [mean(&|i| i % width), mean(&|i| i / width)]
}

fn npy(path: &Path) -> drex_core::npy::NpyArray {
    drex_core::npy::parse_npy(path, &fs::read(path).unwrap()).unwrap()
}

#[test]
fn an_orbit_gives_pictures_and_maps() {
    let dir = tempfile::tempdir().unwrap();
    write_gaussians(&dir.path().join("scene.ply"), &splat(Kind::Surfel, [0.2, 0.1, 0.3], [0.9, 0.2, 0.1])).unwrap();
    let options = ["--orbit", "3", "--radius", "2", "--size", "60x40", "--elevation", "60", "--background", "0,0,1"];
    let run = render(dir.path(), &[&options[..], &["--depth", "npy", "--normal", "exr"]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    let json = run.json();
    assert_eq!((json["gaussians"].as_u64(), json["kind"].as_str()), (Some(1), Some("surfel")));
    let frames = json["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 3);
    for frame in frames {
        let path = Path::new(frame["picture"].as_str().unwrap());
        let (width, height, pixels) = picture(path);
        assert_eq!((width, height, pixels[0]), (60, 40, [0, 0, 255]));
        let [x, y] = bright(path, 0);
        assert!((x - 30.0).abs() < 0.6 && (y - 20.0).abs() < 0.6, "{x} {y}");
        // The ray through the middle of a disc in the plane z = 0.3 meets it at the radius.
        let depth = npy(Path::new(frame["depth"].as_str().unwrap()));
        assert_eq!(depth.shape, [40, 60]);
        assert!(
            (depth.numbers().unwrap()[20 * 60 + 30] - 2.0).abs() < 0.03,
            "{}",
            depth.numbers().unwrap()[20 * 60 + 30]
        );
        assert!(
            Path::new(frame["normal"].as_str().unwrap()).ends_with(path.with_extension("exr").file_name().unwrap())
        );
    }
    assert_eq!(fs::read_dir(dir.path().join("out/normal")).unwrap().count(), 3);
    let normal = render(dir.path(), &[&options[..], &["--normal", "npy"]].concat()).json();
    let normal = npy(Path::new(normal["frames"][1]["normal"].as_str().unwrap()));
    // Up in the world, seen from 60 degrees above: towards the camera and up in the picture.
    let n = &normal.numbers().unwrap()[3 * (20 * 60 + 30)..][..3];
    assert!(n[0].abs() < 1e-5 && (n[1] + 0.5).abs() < 1e-5 && (n[2] + 0.75f64.sqrt()).abs() < 1e-5, "{n:?}");
}

#[test]
fn an_object_moves_over_the_scene() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    write_gaussians(&at("scene.ply"), &splat(Kind::Ellipsoid, [0.0; 3], [0.0, 0.0, 0.8])).unwrap();
    // Trained in decimetres: 0.3 m beside its own origin.
    let mut object = splat(Kind::Ellipsoid, [0.0, 3.0, 0.0], [0.8, 0.0, 0.0]);
    object.log_scales[0] = [0.5f32.ln(); 3];
    write_gaussians(&at("object.ply"), &object).unwrap();
    // Before the scene, from the left to the right of the camera, which looks along -x with y to the right.
    fs::write(at("poses.csv"), "t,x,y,z,qw,qx,qy,qz\n2.0,0.5,-1,0,1,0,0,0\n3.0,0.5,0.4,0,1,0,0,0\n").unwrap();
    let options = [
        "--object",
        "@/object.ply",
        "--trajectory",
        "@/poses.csv",
        "--object-from-splat",
        "0.1",
        "--fps",
        "4",
        "--orbit",
        "1",
        "--center",
        "0,0,0",
        "--radius",
        "3",
        "--elevation",
        "0",
        "--size",
        "90x60",
    ];
    let run = render(dir.path(), &options);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let frames = run.json()["frames"].as_array().unwrap().clone();
    let times: Vec<f64> = frames.iter().map(|f| f["time_s"].as_f64().unwrap()).collect();
    assert_eq!(times, [2.0, 2.25, 2.5, 2.75, 3.0]);
    let focal = 45.0 / 25f64.to_radians().tan();
    for (frame, t) in frames.iter().zip(&times) {
        let path = Path::new(frame["picture"].as_str().unwrap());
        let y = -1.0 + 1.4 * (t - 2.0) + 0.3;
        let [u, v] = bright(path, 0);
        assert!((u - (45.0 + focal * y / 2.5)).abs() < 1.0 && (v - 30.0).abs() < 0.6, "{t}: {u} {v}");
        // The scene stands still; where the object passes, it is covered.
        if y.abs() > 0.4 {
            assert!((bright(path, 2)[0] - 45.0).abs() < 0.6);
        }
    }
}

#[test]
fn cameras_of_a_scan_are_used() {
    let Some(data) = shared_data("cameras_of_a_scan_are_used") else { return };
    let dir = tempfile::tempdir().unwrap();
    write_gaussians(&dir.path().join("scene.ply"), &splat(Kind::Ellipsoid, [0.0; 3], [0.9; 3])).unwrap();
    let scan = data.join("scans/mouse56");
    let run = render(dir.path(), &["--cameras", scan.to_str().unwrap(), "--size", "48x36"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let frames = run.json()["frames"].as_array().unwrap().clone();
    assert_eq!(frames.len(), 56);
    assert_eq!(frames[0]["width"], 48);
    let name = Path::new(frames[7]["picture"].as_str().unwrap()).file_stem().unwrap().to_string_lossy().into_owned();
    assert!(fs::read_dir(&scan).unwrap().flatten().any(|d| d.path().join(format!("{name}.jpg")).exists()), "{name}");
    render(dir.path(), &["--cameras", scan.to_str().unwrap(), "--view", "nowhere"]).fails_with(&["nowhere", "56"]);
}

#[test]
fn what_cannot_be_drawn_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("scene.ply");
    render(dir.path(), &[]).fails_with(&["scene.ply"]);
    fs::write(&scene, "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n").unwrap();
    render(dir.path(), &[]).fails_with(&["scene.ply, line 3", "property y"]);
    write_gaussians(&scene, &Gaussians::new(Kind::Ellipsoid, 0)).unwrap();
    render(dir.path(), &[]).fails_with(&["no Gaussians to look at"]);
    write_gaussians(&scene, &splat(Kind::Ellipsoid, [0.0; 3], [0.9; 3])).unwrap();
    render(dir.path(), &["--normal", "npy"]).fails_with(&["surfels", "scene.ply"]);
    render(dir.path(), &["--elevation", "95"]).fails_with(&["1.658", "89 degrees"]);
    render(dir.path(), &["--cameras", "@"]).fails_with(&["COLMAP"]);
    render(dir.path(), &["--object", "@/scene.ply", "--trajectory", "@/no.csv"]).fails_with(&["no.csv"]);
    for options in
        [&["--object", "x.ply"][..], &["--size", "640"], &["--background", "1,2"], &["--object-from-splat", "-1"]]
    {
        assert_eq!(render(dir.path(), options).code, 2, "{options:?}");
    }
    assert!(!dir.path().join("out").exists(), "nothing half-written");
}
