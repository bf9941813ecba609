//! Scale, up and origin from corners in synthetic photos.

use std::f64::consts::TAU;

use crate::tag_renderer::{Random, Tag, Taking, camera, looking, render, true_corners};
use drex_core::Pose;
use drex_sfm::marker::{Family, Marker, MarkerFit, Sighting, detect_all, metric};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

/// Scene units per metre, and where the scene's origin and axes are: as free as a reconstruction has them.
const UNITS_PER_M: f64 = 7.3;

fn marker() -> Marker {
    Marker::new(Family::Tag36h11, 11, 0.06).unwrap()
}

fn tag_at(x: f64) -> Tag {
    Tag { id: 11, side_m: 0.06, centre: [x, -0.11], yaw_rad: 0.4 }
}

fn scene_from_world() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_euler_angles(0.4, -1.1, 2.0);
    Isometry3::from_parts(Translation3::new(3.0, -2.0, 5.0), turn)
}

/// A pose in metres as a pose in the scene.
fn in_scene(camera_from_world: &Pose) -> Pose {
    let world_from_camera = camera_from_world.inverse();
    let mut scaled = world_from_camera;
    scaled.translation.vector *= UNITS_PER_M;
    (scene_from_world() * scaled).inverse()
}

/// Photos of a tag from a half sphere with noise on the corners, pixels.
fn sightings(photos: usize, noise_px: f64, tag: &Tag, random: &mut Random) -> Vec<Sighting> {
    let camera = camera(800, 600, 640.0, -0.06);
    (0..photos)
        .map(|_| {
            let (lean, turn) = (random.uniform(0.2, 1.0), random.uniform(0.0, TAU));
            let away = random.uniform(0.4, 0.6);
            let eye = Point3::new(lean.sin() * turn.cos(), lean.sin() * turn.sin(), lean.cos()) * away;
            let target = Point3::new(random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05), 0.0);
            let pose = looking(eye, target, random.uniform(-0.3, 0.3));
            let mut corners = true_corners(&camera, &pose, tag);
            corners.iter_mut().flatten().for_each(|v| *v += noise_px * random.normal());
            Sighting { camera: camera.clone(), camera_from_world: in_scene(&pose), corners }
        })
        .collect()
}

fn refusal(sightings: &[Sighting]) -> String {
    metric(sightings, &marker()).map(|f| f.scale).unwrap_err().to_string()
}

/// Where the fit puts the corners of the true tag, beside where they belong in the metric frame.
fn frame_error(fit: &MarkerFit, tag: &Tag) -> f64 {
    let h = 0.5 * tag.side_m;
    let there = [(-h, h), (h, h), (h, -h), (-h, -h)].map(|(x, y)| Point3::new(x, y, 0.0));
    let in_scene = tag.corners().map(|c| scene_from_world() * (c * UNITS_PER_M));
    there.iter().zip(in_scene).map(|(t, s)| (fit.metric_from_scene * s - t).norm()).fold(0.0, f64::max)
}

#[test]
fn exact_corners_give_the_exact_scale() {
    for seed in 0..20 {
        let tag = tag_at(0.12);
        let fit = metric(&sightings(3 + seed as usize % 9, 0.0, &tag, &mut Random(seed)), &marker()).unwrap();
        assert!((fit.scale * UNITS_PER_M - 1.0).abs() < 1e-9, "{}", fit.scale);
        assert!(fit.scale_sigma < 1e-9 && fit.rms_px < 1e-7 && fit.spread < 1e-7 && fit.warning.is_none(), "{fit:?}");
        assert!(frame_error(&fit, &tag) < 1e-9);
        let up = scene_from_world() * Vector3::z();
        assert!((fit.up.into_inner() - up).norm() < 1e-9);
        let centre = scene_from_world() * (Point3::new(0.12, -0.11, 0.0) * UNITS_PER_M);
        assert!((fit.centre - centre).norm() < 1e-8);
    }
}

/// The error of the scale over its stated standard error is a number of variance one: over many seeds neither too small nor too
/// large.
#[test]
fn the_stated_error_is_the_error() {
    for (photos, low, high) in [(4, 0.5, 1.3), (12, 0.7, 1.15), (40, 0.7, 1.15)] {
        let z: Vec<f64> = (0..200)
            .map(|seed| {
                let seen = sightings(photos, 0.3, &tag_at(0.12), &mut Random(7000 + seed));
                let fit = metric(&seen, &marker()).unwrap();
                (fit.scale - 1.0 / UNITS_PER_M) / fit.scale_sigma
            })
            .collect();
        let rms = (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt();
        let mean = z.iter().sum::<f64>() / z.len() as f64;
        let beyond = z.iter().filter(|z| z.abs() > 2.0).count();
        eprintln!("{photos} photos: rms {rms:.2}, mean {mean:.2}, {beyond} of 200 beyond two");
        assert!((low..high).contains(&rms) && mean.abs() < 0.3 && beyond <= 20, "{photos}: {rms} {mean} {beyond}");
    }
}

#[test]
fn photos_that_show_it_elsewhere_are_left_out() {
    let random = &mut Random(5);
    let mut seen = sightings(12, 0.3, &tag_at(0.12), random);
    seen.extend(sightings(2, 0.3, &tag_at(-0.12), random));
    seen.push(Sighting { corners: [[f64::NAN; 2]; 4], ..seen[0].clone() });
    seen.push(Sighting { corners: [[100.0, 100.0]; 4], ..seen[0].clone() });
    let fit = metric(&seen, &marker()).unwrap();
    assert_eq!(fit.used, (0..12).collect::<Vec<_>>());
    assert!((fit.scale * UNITS_PER_M - 1.0).abs() < 0.005);
}

#[test]
fn two_places_are_refused() {
    let random = &mut Random(6);
    let mut seen = sightings(12, 0.3, &tag_at(0.12), random);
    seen.extend(sightings(6, 0.3, &tag_at(-0.12), random));
    let error = refusal(&seen);
    assert!(error.contains("12 photos") && error.contains("6 at another"), "{error}");
}

#[test]
fn too_few_photos_are_counted() {
    for (photos, text) in [(0, "0 photos see"), (1, "1 photo sees"), (2, "2 photos see")] {
        let error = refusal(&sightings(photos, 0.0, &tag_at(0.12), &mut Random(1)));
        assert!(error.contains(text) && error.contains("tag36h11:11:0.06"), "{error}");
    }
    let mut scattered = sightings(4, 0.0, &tag_at(0.12), &mut Random(1));
    for (k, sighting) in scattered.iter_mut().enumerate() {
        sighting.corners.iter_mut().for_each(|c| c[1] += 60.0 * k as f64);
    }
    let error = refusal(&scattered);
    assert!(error.contains("of 4 photos") && error.contains("agree"), "{error}");
}

#[test]
fn mirrored_corners_are_refused() {
    let mut seen = sightings(10, 0.1, &tag_at(0.12), &mut Random(2));
    for sighting in &mut seen {
        sighting.corners.reverse();
    }
    let error = refusal(&seen);
    assert!(error.contains("10 of 10 photos see its back"), "{error}");
}

/// From one place a square far away and a large one look alike, and a leaning one has a twin that leans the other way.
#[test]
fn photos_from_one_place_are_refused() {
    let camera = camera(800, 600, 640.0, -0.06);
    for apart_m in [0.0, 1e-4, 2e-3] {
        let mut random = Random(3);
        let seen: Vec<Sighting> = (0..8)
            .map(|k| {
                let eye = Point3::new(0.1 + apart_m * f64::from(k % 3), -0.5, 0.2 + apart_m * f64::from(k % 2));
                let pose = looking(eye, Point3::new(0.01 * f64::from(k), 0.0, 0.0), 0.0);
                let mut corners = true_corners(&camera, &pose, &tag_at(0.12));
                corners.iter_mut().flatten().for_each(|v| *v += 0.3 * random.normal());
                Sighting { camera: camera.clone(), camera_from_world: in_scene(&pose), corners }
            })
            .collect();
        let error = refusal(&seen);
        assert!(error.contains("places farther apart"), "{error}");
    }
}

#[test]
fn a_stretched_print_is_warned_of() {
    let random = &mut Random(4);
    let camera = camera(800, 600, 640.0, -0.06);
    let seen: Vec<Sighting> = sightings(12, 0.1, &tag_at(0.12), random)
        .into_iter()
        .map(|s| {
            let corners = tag_at(0.0).corners().map(|c| {
                // 4 % longer along x than along y.
                let stretched = Point3::new(1.02 * c.x, 0.98 * (c.y + 0.11) - 0.11, 0.0);
                camera
                    .project(&(s.camera_from_world * (scene_from_world() * (stretched * UNITS_PER_M))))
                    .unwrap()
                    .into()
            });
            Sighting { corners, ..s }
        })
        .collect();
    let fit = metric(&seen, &marker()).unwrap();
    assert!(fit.spread > 0.01);
    let warning = fit.warning.expect("it is no square");
    assert!(warning.contains("off a square"), "{warning}");
}

/// From rendered photos to the scale, without a true pixel in between.
#[test]
fn scale_from_rendered_photos() {
    let camera = camera(480, 360, 420.0, -0.06);
    let tags = [Tag { id: 11, side_m: 0.06, centre: [0.05, -0.04], yaw_rad: 0.4 }];
    let mut random = Random(2024);
    let mut seen = Vec::new();
    for seed in 0..12 {
        let (lean, turn) = (random.uniform(0.2, 0.9), random.uniform(0.0, TAU));
        let eye = Point3::new(lean.sin() * turn.cos(), lean.sin() * turn.sin(), lean.cos()) * random.uniform(0.3, 0.45);
        let pose = looking(eye, Point3::origin(), random.uniform(-0.3, 0.3));
        let pixels =
            render(&camera, &pose, &tags, &Taking { blur_px: 0.8, noise: 3.0, ..Taking::default() }, 50 + seed);
        for (id, found) in detect_all(&pixels, 480, 360, Family::Tag36h11) {
            assert_eq!(id, 11);
            seen.push(Sighting { camera: camera.clone(), camera_from_world: in_scene(&pose), corners: found.corners });
        }
    }
    let fit = metric(&seen, &marker()).unwrap();
    let off = fit.scale * UNITS_PER_M - 1.0;
    eprintln!(
        "{} photos: scale off by {:.4} %, {:.4} % stated",
        seen.len(),
        100.0 * off,
        100.0 * fit.scale_sigma / fit.scale
    );
    assert!(seen.len() >= 11 && off.abs() < 0.002 && frame_error(&fit, &tags[0]) < 0.5e-3, "{off}");
}
