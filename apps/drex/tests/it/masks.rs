//! `drex masks`: the demo's tin is cut out of its photos, and what a person corrects stays.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{Run, drex, tree};
use crate::sfm::{photos, true_cameras};

fn masks(dir: &Path, options: &[&str]) -> Run {
    let (photos, out) = (dir.join("photos"), dir.join("twin"));
    let mut arguments = vec!["masks", photos.to_str().unwrap(), "--out", out.to_str().unwrap(), "--json"];
    arguments.extend(options);
    drex(arguments)
}

fn mask(dir: &Path, i: usize) -> PathBuf {
    dir.join(format!("twin/masks/{i:02}.jpg.png"))
}

/// The pixels of a photo that show the tin as it was rendered.
fn silhouette(i: usize) -> Vec<bool> {
    const FOCAL_PX: f64 = 600.0;
    let truth = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/demo/truth");
    let camera_from_world = true_cameras()[i].inverse();
    let mut shown = vec![false; 640 * 480];
    for part in drex_mesh::read_model(&truth.join("tin.obj")).unwrap().parts {
        let pixel = |v: &nalgebra::Point3<f64>| {
            let p = camera_from_world * v;
            [FOCAL_PX * p.x / p.z + 320.0, FOCAL_PX * p.y / p.z + 240.0]
        };
        // Each part is convex: what its hull in the picture encloses.
        let hull = hull(part.mesh.vertices.iter().map(pixel).collect());
        for (k, shown) in shown.iter_mut().enumerate() {
            let at = [(k % 640) as f64 + 0.5, (k / 640) as f64 + 0.5];
            *shown |= (0..hull.len()).all(|i| turn(&hull[i], &hull[(i + 1) % hull.len()], &at) >= 0.0);
        }
    }
    shown
}

/// Twice the area of a triangle, positive for corners that turn from x to y.
fn turn(a: &[f64; 2], b: &[f64; 2], c: &[f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Corners of the convex hull (Andrew 1979).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a.partial_cmp(b).unwrap());
    let half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut out: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while out.len() > 1 && turn(&out[out.len() - 2], &out[out.len() - 1], &p) <= 0.0 {
                out.pop();
            }
            out.push(p);
        }
        out.pop();
        out
    };
    let mut out = half(&mut points.iter().copied());
    out.extend(half(&mut points.iter().rev().copied()));
    out
}

/// Number of white pixels.
fn white(file: &Path) -> f64 {
    let picture = image::open(file).unwrap().into_luma8();
    assert_eq!(picture.dimensions(), (640, 480));
    assert!(picture.pixels().all(|p| p.0 == [0] || p.0 == [255]), "{}", file.display());
    let shown = picture.enumerate_pixels().filter(|(_, _, p)| p.0[0] == 255);
    shown.count() as f64
}

#[test]
fn the_tin_is_cut_out_and_corrections_stay() {
    let dir = photos(0..12);
    let before = tree(&dir.path().join("photos"));
    let run = masks(dir.path(), &[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(tree(&dir.path().join("photos")), before, "nothing is written beside the photos");
    let overlap = |i: usize| {
        let made = image::open(mask(dir.path(), i)).unwrap().into_luma8();
        let mut pixels = [0.0; 2];
        for (made, there) in made.pixels().map(|p| p.0[0] == 255).zip(silhouette(i)) {
            pixels[0] += f64::from(u8::from(made && there));
            pixels[1] += f64::from(u8::from(made || there));
        }
        pixels[0] / pixels[1]
    };
    let overlaps: Vec<f64> = (0..12).map(overlap).collect();
    assert!(overlaps.iter().all(|o| *o > 0.95), "{overlaps:.3?}");
    let report = run.json();
    let photos = report["photos"].as_array().unwrap();
    assert!(
        photos.len() == 12 && photos.iter().all(|p| p["confidence"].as_f64().unwrap() > 0.8 && p["corrected"] == false)
    );

    // The same again: nothing is made, all stays as it is.
    let made = tree(&dir.path().join("twin/masks"));
    let run = masks(dir.path(), &[]);
    assert!(run.code == 0 && run.stderr.contains("going on with the masks in"), "{}", run.stderr);
    assert_eq!(tree(&dir.path().join("twin/masks")), made);

    // One that a person painted over is kept, with the same options and with others.
    let painted = image::GrayImage::from_fn(640, 480, |x, _| image::Luma([if x < 150 { 255 } else { 0 }]));
    painted.save(mask(dir.path(), 3)).unwrap();
    for options in [&[][..], &["--object", "320,250@05.jpg"]] {
        let run = masks(dir.path(), options);
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert!(run.stderr.contains("1 masks in"), "{}", run.stderr);
        assert_eq!(white(&mask(dir.path(), 3)), 150.0 * 480.0);
        let corrected = |p: &serde_json::Value| p["corrected"] == true;
        let photos = run.json()["photos"].as_array().unwrap().clone();
        assert!(corrected(&photos[3]) && photos.iter().filter(|p| corrected(p)).count() == 1);
    }
    assert!(overlap(4) > 0.95, "a click on the tin is the tin: {}", overlap(4));

    // One that is missing is made again, one of another size is refused.
    fs::remove_file(mask(dir.path(), 7)).unwrap();
    assert_eq!(masks(dir.path(), &[]).code, 0);
    assert!(overlap(7) > 0.95, "{}", overlap(7));
    image::GrayImage::new(40, 30).save(mask(dir.path(), 3)).unwrap();
    masks(dir.path(), &[]).fails_with(&["03.jpg.png has 40 x 30 pixels", "640 x 480", "or remove it"]);
    masks(dir.path(), &["--object", "1,1@99.jpg"]).fails_with(&["99.jpg", "has no camera"]);
}
