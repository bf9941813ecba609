//! Tags in rendered photos with known corners, and in hostile bytes.

use std::f64::consts::TAU;

use crate::tag_renderer::{Random, Tag, Taking, camera, looking, render, true_corners};
use drex_core::Pose;
use drex_core::camera::Camera;
use drex_sfm::marker::{Detection, Family, Marker, detect, detect_all, refine};
use nalgebra::{Point2, Point3};
use proptest::prelude::*;

const SIZE: (usize, usize) = (400, 300);

fn marker(id: u32) -> Marker {
    Marker::new(Family::Tag36h11, id, 0.06).unwrap()
}

struct Photo {
    camera: Camera,
    pose: Pose,
    tag: Tag,
    pixels: Vec<u8>,
}

impl Photo {
    /// A photo of a tag from some side, up to 60 degrees from above.
    fn random(seed: u64, k1: f64) -> Self {
        let mut r = Random(seed);
        let ids = [0, 11, 12, 200, 586];
        let tag = Tag {
            id: ids[(seed % 5) as usize],
            side_m: 0.06,
            centre: [r.uniform(-0.02, 0.02), r.uniform(-0.02, 0.02)],
            yaw_rad: r.uniform(0.0, TAU),
        };
        let (lean, turn, away) = (r.uniform(0.05, 1.05), r.uniform(0.0, TAU), r.uniform(0.25, 0.55));
        let eye = Point3::new(lean.sin() * turn.cos(), lean.sin() * turn.sin(), lean.cos()) * away;
        let target = Point3::new(r.uniform(-0.05, 0.05), r.uniform(-0.05, 0.05), 0.0);
        let pose = looking(eye, target, r.uniform(-0.5, 0.5));
        let camera = camera(SIZE.0 as u32, SIZE.1 as u32, 400.0, k1);
        let taking = Taking {
            blur_px: r.uniform(0.5, 1.1),
            noise: r.uniform(1.0, 4.0),
            exposure: r.uniform(0.25, 0.9),
            ink_m: 0.0,
        };
        let pixels = render(&camera, &pose, &[tag], &taking, seed);
        Self { camera, pose, tag, pixels }
    }

    fn errors(&self, found: &Detection) -> [f64; 4] {
        let truth = true_corners(&self.camera, &self.pose, &self.tag);
        [0, 1, 2, 3].map(|k| (Point2::from(found.corners[k]) - Point2::from(truth[k])).norm())
    }

    /// Relative error of the mean length of the edges.
    fn size_error(&self, found: &Detection) -> f64 {
        let length = |c: &[[f64; 2]; 4]| -> f64 {
            (0..4).map(|k| (Point2::from(c[k]) - Point2::from(c[(k + 1) % 4])).norm()).sum()
        };
        length(&found.corners) / length(&true_corners(&self.camera, &self.pose, &self.tag)) - 1.0
    }
}

fn quantile(values: &[f64], share: f64) -> f64 {
    drex_core::stats::quantile(values.iter().copied(), share).unwrap()
}

#[test]
fn corners_of_rendered_tags() {
    let (mut errors, mut sizes, mut refined, mut missed) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for seed in SEEDS {
        let photo = Photo::random(seed, -0.08);
        let marker = marker(photo.tag.id);
        let Some(found) = detect(&photo.pixels, SIZE.0, SIZE.1, &marker) else {
            missed.push(seed);
            continue;
        };
        errors.extend(photo.errors(&found));
        sizes.push(photo.size_error(&found));
        let again = refine(&photo.pixels, SIZE.0, SIZE.1, &marker, &found, &photo.camera).expect("it was found");
        refined.extend(photo.errors(&again));
    }
    let size = sizes.iter().sum::<f64>() / sizes.len() as f64;
    let [median, most, median_refined, most_refined] =
        [(&errors, 0.5), (&errors, 0.95), (&refined, 0.5), (&refined, 0.95)].map(|(e, q)| quantile(e, q));
    let report = format!(
        "missed {missed:?}; corners {median:.3} px, 95 % {most:.3}; with the lens {median_refined:.3}, {most_refined:.3}; size \
         {:.3} %",
        100.0 * size
    );
    eprintln!("{report}");
    assert!(missed.len() <= 1, "{report}");
    assert!(median < 0.1 && most < 0.3 && size.abs() < 1e-3, "{report}");
    assert!(median_refined < 0.1 && most_refined < 0.3, "{report}");
}

/// Seeds that nothing was tuned on.
const SEEDS: std::ops::Range<u64> = 1000..1040;

#[test]
fn a_bent_lens_is_followed_when_it_is_known() {
    let (mut plain, mut refined) = (Vec::new(), Vec::new());
    for seed in 1100..1112 {
        let photo = Photo::random(seed, -0.4);
        let marker = marker(photo.tag.id);
        let Some(found) = detect(&photo.pixels, SIZE.0, SIZE.1, &marker) else { continue };
        let again = refine(&photo.pixels, SIZE.0, SIZE.1, &marker, &found, &photo.camera).expect("it was found");
        plain.extend(photo.errors(&found));
        refined.extend(photo.errors(&again));
    }
    let report = format!("median {:.3} px, with the lens {:.3} px", quantile(&plain, 0.5), quantile(&refined, 0.5));
    eprintln!("{report}");
    assert!(plain.len() >= 40 && quantile(&refined, 0.5) < 0.5 * quantile(&plain, 0.5), "{report}");
}

#[test]
fn ink_that_spreads_does_not_change_the_size() {
    let mut sizes = Vec::new();
    for seed in 1200..1206 {
        let mut photo = Photo::random(seed, 0.0);
        let taking = Taking { ink_m: 0.0006, ..Taking::default() };
        photo.pixels = render(&photo.camera, &photo.pose, &[photo.tag], &taking, seed);
        let found = detect(&photo.pixels, SIZE.0, SIZE.1, &marker(photo.tag.id)).expect("a clear photo");
        sizes.push(photo.size_error(&found));
    }
    let mean = sizes.iter().sum::<f64>() / sizes.len() as f64;
    // The outer edges are 1.2 mm of 60 mm farther apart: 2 %.
    assert!(mean.abs() < 0.003, "{sizes:?}");
}

#[test]
fn another_id_a_mirrored_photo_and_two_of_one_id() {
    let tag = |id, x| Tag { id, side_m: 0.06, centre: [x, 0.0], yaw_rad: 0.3 };
    let camera = camera(SIZE.0 as u32, SIZE.1 as u32, 400.0, -0.05);
    let pose = looking(Point3::new(0.05, -0.2, 0.35), Point3::origin(), 0.0);
    let photo = |tags: &[Tag]| render(&camera, &pose, tags, &Taking::default(), 7);
    let ids = |pixels: &[u8]| -> Vec<u32> {
        detect_all(pixels, SIZE.0, SIZE.1, Family::Tag36h11).iter().map(|(id, _)| *id).collect()
    };

    let one = photo(&[tag(11, -0.05), tag(12, 0.05)]);
    assert_eq!(ids(&one), [11, 12]);
    assert!(detect(&one, SIZE.0, SIZE.1, &marker(200)).is_none());
    assert!(detect(&one, SIZE.0, SIZE.1, &marker(11)).is_some());

    let mirrored: Vec<u8> = one.chunks(SIZE.0).flat_map(|row| row.iter().rev().copied()).collect();
    assert_eq!(ids(&mirrored), [0_u32; 0]);

    let two = photo(&[tag(11, -0.05), tag(11, 0.05)]);
    assert_eq!(ids(&two), [11, 11]);
    assert!(detect(&two, SIZE.0, SIZE.1, &marker(11)).is_none(), "which one has the known size?");
}

#[test]
fn tags_from_small_to_large() {
    let camera = camera(SIZE.0 as u32, SIZE.1 as u32, 400.0, 0.0);
    for (away, largest_error) in [(1.0, 0.5), (0.5, 0.2), (0.2, 0.2), (0.12, 0.4)] {
        let pose = looking(Point3::new(0.02, -0.05, away), Point3::origin(), 0.2);
        let tag = Tag { id: 11, side_m: 0.06, centre: [0.0, 0.0], yaw_rad: 1.0 };
        let pixels = render(&camera, &pose, &[tag], &Taking::default(), 3);
        let photo = Photo { camera: camera.clone(), pose, tag, pixels };
        let found = detect(&photo.pixels, SIZE.0, SIZE.1, &marker(11)).unwrap_or_else(|| panic!("at {away} m"));
        let worst = photo.errors(&found).into_iter().fold(0.0, f64::max);
        eprintln!("{away} m: {worst:.3} px");
        assert!(worst < largest_error, "{worst} px at {away} m");
    }
}

#[test]
fn markers_of_the_command_line() {
    let marker: Marker = "tag36h11:11:0.06".parse().unwrap();
    assert_eq!((marker.family, marker.id, marker.side_m), (Family::Tag36h11, 11, 0.06));
    assert_eq!(marker.to_string().parse::<Marker>().unwrap(), marker);
    for (text, part) in [
        ("", "1 parts"),
        ("tag36h11:11", "2 parts"),
        ("tag36h11:11:0.06:1", "4 parts"),
        ("tag25h9:11:0.06", "print a tag of tag36h11"),
        ("tag36h11:x:0.06", "`x` is not a whole number"),
        ("tag36h11:-1:0.06", "`-1` is not a whole number"),
        ("tag36h11:587:0.06", "0 to 586"),
        ("tag36h11:11:60mm", "`60mm` is not a number of metres"),
        ("tag36h11:11:60", "such as 0.06 for 60 mm"),
        ("tag36h11:11:0", "in metres"),
        ("tag36h11:11:NaN", "in metres"),
        ("tag36h11:11:-0.06", "in metres"),
    ] {
        let error = text.parse::<Marker>().unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
        assert!(error.contains(&format!("`{text}`")), "{text}: {error}");
    }
}

#[test]
fn sizes_that_are_no_photos() {
    let marker = marker(11);
    for (w, h) in [(0, 0), (1, 1), (0, 5), (1, 100_000), (100_000, 1), (19, 4000), (20, 20), (4000, 21), (64, 64)] {
        for value in [0, 128, 255] {
            assert!(detect(&vec![value; w * h], w, h, &marker).is_none());
        }
    }
    assert!(detect(&[0; 100], 400, 300, &marker).is_none());
    assert!(detect(&[0; 100], usize::MAX, 2, &marker).is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Random blocks of black and white, large enough to be taken for tags, never panic and are no tags.
    #[test]
    fn arbitrary_bytes(
        w in 0_usize..160,
        h in 0_usize..160,
        block in 1_usize..24,
        values in proptest::collection::vec(any::<u8>(), 1..512),
        corners in proptest::array::uniform4(proptest::array::uniform2(-1e3..1e3_f64)),
        k1 in -2.0..2.0_f64,
    ) {
        let pixels: Vec<u8> = (0..w * h)
            .map(|k| values[((k % w) / block + 31 * (k / w / block)) % values.len()])
            .collect();
        prop_assert!(detect_all(&pixels, w, h, Family::Tag36h11).is_empty());
        let camera = camera(100, 100, 80.0, k1);
        let _ = refine(&pixels, w, h, &marker(11), &Detection { corners }, &camera);
    }
}
