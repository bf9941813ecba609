//! `drex masks`: the demo's tin is cut out of its photos, and what a person corrects stays.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{Run, drex, tree};
use crate::sfm::photos;

fn masks(dir: &Path, options: &[&str]) -> Run {
    let (photos, out) = (dir.join("photos"), dir.join("twin"));
    let mut arguments = vec!["masks", photos.to_str().unwrap(), "--out", out.to_str().unwrap(), "--json"];
    arguments.extend(options);
    drex(arguments)
}

fn mask(dir: &Path, i: usize) -> PathBuf {
    dir.join(format!("twin/masks/{i:02}.jpg.png"))
}

/// Number of white pixels and their middle.
fn white(file: &Path) -> (f64, [f64; 2]) {
    let picture = image::open(file).unwrap().into_luma8();
    assert_eq!(picture.dimensions(), (400, 300));
    assert!(picture.pixels().all(|p| p.0 == [0] || p.0 == [255]), "{}", file.display());
    let shown = || picture.enumerate_pixels().filter(|(_, _, p)| p.0[0] == 255);
    let n = shown().count() as f64;
    let sum = shown().fold([0.0, 0.0], |s, (x, y, _)| [s[0] + f64::from(x), s[1] + f64::from(y)]);
    (n, sum.map(|v| v / n))
}

#[test]
fn the_tin_is_cut_out_and_corrections_stay() {
    let dir = photos(0..12);
    let before = tree(&dir.path().join("photos"));
    let run = masks(dir.path(), &[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert_eq!(tree(&dir.path().join("photos")), before, "nothing is written beside the photos");
    // Taken from 24 degrees above the table, 0.34 m from a place 36 mm up in the middle of the tin, with 430 px: a body 62 mm
    // wide and 64 mm high below a lid of 18 mm, seen from all sides alike.
    let shown: Vec<_> = (0..12).map(|i| white(&mask(dir.path(), i))).collect();
    let mean = shown.iter().map(|s| s.0).sum::<f64>() / 12.0;
    assert!((7500.0..9500.0).contains(&mean), "{shown:?}");
    for (pixels, [x, y]) in &shown {
        assert!((pixels / mean - 1.0).abs() < 0.05, "{shown:?}");
        assert!((x - 200.0).abs() < 4.0 && (y - 150.0).abs() < 8.0, "{shown:?}");
    }
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
    let painted = image::GrayImage::from_fn(400, 300, |x, _| image::Luma([if x < 150 { 255 } else { 0 }]));
    painted.save(mask(dir.path(), 3)).unwrap();
    for options in [&[][..], &["--object", "200,150@05.jpg"]] {
        let run = masks(dir.path(), options);
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert!(run.stderr.contains("1 masks in"), "{}", run.stderr);
        assert_eq!(white(&mask(dir.path(), 3)).0, 150.0 * 300.0);
        let corrected = |p: &serde_json::Value| p["corrected"] == true;
        let photos = run.json()["photos"].as_array().unwrap().clone();
        assert!(corrected(&photos[3]) && photos.iter().filter(|p| corrected(p)).count() == 1);
    }
    assert!((white(&mask(dir.path(), 4)).0 / mean - 1.0).abs() < 0.05, "a click on the tin is the tin");

    // One that is missing is made again, one of another size is refused.
    fs::remove_file(mask(dir.path(), 7)).unwrap();
    assert_eq!(masks(dir.path(), &[]).code, 0);
    assert!((white(&mask(dir.path(), 7)).0 / mean - 1.0).abs() < 0.05);
    image::GrayImage::new(40, 30).save(mask(dir.path(), 3)).unwrap();
    masks(dir.path(), &[]).fails_with(&["03.jpg.png has 40 x 30 pixels", "400 x 300", "or remove it"]);
    masks(dir.path(), &["--object", "1,1@99.jpg"]).fails_with(&["99.jpg", "has no camera"]);
}
