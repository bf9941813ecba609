use std::path::Path;

use drex_core::camera::{Camera, CameraModel};
use drex_core::capture::{Capture, Keypoint, SparsePoint};
use drex_core::{Pose, TriMesh};
use drex_mvs::{Prediction, Texture, TextureOptions, prediction, texture, textured_points};
use image::{Rgb, RgbImage};
use nalgebra::{Point3, Vector3};

use crate::refinement::ball;
use crate::scene::{self, noise};

const SIZE_PX: u32 = 320;
const FOCAL_PX: f64 = 500.0;
const FAR: f64 = 0.3;
const RADIUS: f64 = 0.05;
const HALF: [f64; 3] = [0.045, 0.03, 0.035];

type Surface<'a> = &'a (dyn Fn(&Point3<f64>, &Vector3<f64>) -> Option<f64> + Sync);
/// Colour in linear light of a point of the surface, in a photo.
type Paint<'a> = &'a (dyn Fn(usize, &Point3<f64>) -> [f64; 3] + Sync);

/// Distance along a ray to the ball.
fn meets_ball(eye: &Point3<f64>, ray: &Vector3<f64>) -> Option<f64> {
    let (a, b, c) = (ray.norm_squared(), ray.dot(&eye.coords), eye.coords.norm_squared() - RADIUS * RADIUS);
    let root = b * b - a * c;
    (root > 0.0).then(|| (-b - root.sqrt()) / a)
}

/// Distance along a ray to the box.
fn meets_box(eye: &Point3<f64>, ray: &Vector3<f64>) -> Option<f64> {
    let (mut near, mut far) = (0.0f64, f64::INFINITY);
    for k in 0..3 {
        let [a, b] = [-1.0, 1.0].map(|side| (side * HALF[k] - eye[k]) / ray[k]);
        (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
    }
    (near < far).then_some(near)
}

fn box_mesh() -> TriMesh {
    let corner = |k: usize| Point3::from([0, 1, 2].map(|a| if k >> a & 1 == 1 { HALF[a] } else { -HALF[a] }));
    drex_core::mesh::convex_hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap()
}

/// What is painted on things, linear light.
fn albedo(p: &Point3<f64>) -> [f64; 3] {
    [0.0, 40.0, 80.0].map(|shift| 0.3 + 0.2 * noise(&(p / 0.012 + Vector3::repeat(shift))))
}

/// Two rings of cameras round the origin, none of which sees the underside.
fn cameras() -> Vec<Pose> {
    let camera = |k: usize| {
        let (turn, height) = (k as f64 * 0.61, if k.is_multiple_of(2) { 0.35f64 } else { 0.95 });
        let eye = Point3::new(height.cos() * turn.cos(), height.cos() * turn.sin(), height.sin()) * FAR;
        Pose::face_towards(&eye, &Point3::origin(), &-Vector3::z()).inverse()
    };
    (0..20).map(camera).collect()
}

fn srgb(c: f64) -> f64 {
    255.0 * if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

fn photograph(folder: &Path, cameras: &[Pose], surface: Surface<'_>, paint: Paint<'_>) -> Capture {
    let middle = 0.5 * f64::from(SIZE_PX);
    let lens = Camera::new(CameraModel::Pinhole, SIZE_PX, SIZE_PX, &[FOCAL_PX, FOCAL_PX, middle, middle]).unwrap();
    let view = |(i, pose): (usize, &Pose)| {
        let world_from_camera = pose.inverse();
        let eye = Point3::from(world_from_camera.translation.vector);
        let photo = folder.join(format!("{i:02}.png"));
        RgbImage::from_fn(SIZE_PX, SIZE_PX, |u, v| {
            // Four rays a pixel, as a sensor averages.
            let mut sum = [0.0; 3];
            for (dx, dy) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                let at = |pixel: u32, within: f64| (f64::from(pixel) + within - middle) / FOCAL_PX;
                let ray = world_from_camera.rotation * Vector3::new(at(u, dx), at(v, dy), 1.0);
                // A background unlike anything on the object.
                let colour = surface(&eye, &ray).map_or([0.9, 0.0, 0.9], |t| paint(i, &(eye + ray * t)));
                (0..3).for_each(|k| sum[k] += 0.25 * colour[k]);
            }
            Rgb(sum.map(|c| srgb(c).round().clamp(0.0, 255.0) as u8))
        })
        .save(&photo)
        .unwrap();
        scene::view(format!("{i:02}.png"), photo, &lens, pose)
    };
    let views = cameras.iter().enumerate().map(view).collect();
    Capture { folder: folder.to_owned(), views, points: Vec::new(), unregistered: Vec::new(), notes: Vec::new() }
}

fn textured(mesh: &TriMesh, capture: &Capture) -> Texture {
    texture(mesh, capture, &TextureOptions::default(), &|_| {}).unwrap()
}

/// Points of the mesh with the texture's colours there, as a renderer reads them.
fn read_back(mesh: &TriMesh, texture: &Texture, count: usize) -> Vec<(Point3<f64>, [f64; 3])> {
    let picture = image::load_from_memory(&texture.png).unwrap().into_rgb8();
    let total = mesh.area();
    let mut out = Vec::new();
    let mut next = 0.5 / count as f64 * total;
    let (mut passed, mut k) = (0.0, 0);
    for f in 0..mesh.faces.len() {
        let [a, b, c] = mesh.triangle(f);
        passed += 0.5 * (b - a).cross(&(c - a)).norm();
        while next < passed {
            next += total / count as f64;
            k += 1;
            // A low-discrepancy sequence over the triangle.
            let [mut s, mut t] = [(k as f64 * 0.754_877_666).fract(), (k as f64 * 0.569_840_291).fract()];
            if s + t > 1.0 {
                (s, t) = (1.0 - s, 1.0 - t);
            }
            let weights = [1.0 - s - t, s, t];
            let uv = [0, 1].map(|k| (0..3).map(|i| weights[i] * f64::from(texture.uv[f][i][k])).sum::<f64>());
            let point = a.coords * weights[0] + b.coords * weights[1] + c.coords * weights[2];
            out.push((Point3::from(point), bilinear(&picture, uv)));
        }
    }
    out
}

fn bilinear(picture: &RgbImage, uv: [f64; 2]) -> [f64; 3] {
    let x = uv[0] * f64::from(picture.width()) - 0.5;
    let y = uv[1] * f64::from(picture.height()) - 0.5;
    let (tx, ty) = (x - x.floor(), y - y.floor());
    let mut sum = [0.0; 3];
    for (dx, dy, w) in
        [(0, 0, (1.0 - tx) * (1.0 - ty)), (1, 0, tx * (1.0 - ty)), (0, 1, (1.0 - tx) * ty), (1, 1, tx * ty)]
    {
        let at = |v: f64, d: i64, size: u32| (v.floor() as i64 + d).clamp(0, i64::from(size) - 1) as u32;
        let pixel = picture.get_pixel(at(x, dx, picture.width()), at(y, dy, picture.height()));
        (0..3).for_each(|k| sum[k] += w * f64::from(pixel[k]));
    }
    sum
}

/// Root mean square and 99 % of the differences from what is painted, 8-bit levels, of the points that `which` picks.
fn off(points: &[(Point3<f64>, [f64; 3])], which: impl Fn(&Point3<f64>) -> bool) -> [f64; 2] {
    let picked = points.iter().filter(|(p, _)| which(p));
    let mut all: Vec<f64> = picked
        .flat_map(|(p, c)| {
            let truth = albedo(p).map(srgb);
            [0, 1, 2].map(|k| (c[k] - truth[k]).abs())
        })
        .collect();
    all.sort_by(f64::total_cmp);
    let rms = (all.iter().map(|d| d * d).sum::<f64>() / all.len() as f64).sqrt();
    [rms, all[all.len() * 99 / 100]]
}

#[test]
fn a_ball_has_the_colours_that_are_painted_on_it() {
    let dir = tempfile::tempdir().unwrap();
    // Exposures from 0.6 to 1.6 and a white balance, both with a geometric mean of 1; a hand before one photo, a highlight in another.
    let stops: Vec<f64> = (0..20).map(|i| ((i * 7 % 20) as f64 - 9.5) / 19.0).collect();
    let gain = |i: usize| [stops[i].exp(), stops[i].exp(), (-0.4 * stops[i]).exp()];
    let hand = Point3::new(0.035, 0.0, 0.035);
    let lamp = Point3::new(-0.01, 0.03, 0.04);
    let capture = photograph(dir.path(), &cameras(), &meets_ball, &|i, p| {
        let colour = match i {
            3 if (p - hand).norm() < 0.015 => [0.5, 0.2, 0.1],
            6 => albedo(p).map(|c| c + 0.5 * (-((p - lamp).norm() / 0.01).powi(2)).exp()),
            _ => albedo(p),
        };
        let gain = gain(i);
        [0, 1, 2].map(|k| gain[k] * colour[k])
    });
    let mesh = ball(RADIUS, 5);
    let result = textured(&mesh, &capture);
    let points = read_back(&mesh, &result, 40_000);
    let [rms, most] = off(&points, |p| p.z > -0.01);
    let near_hand = off(&points, |p| (p - hand).norm() < 0.02)[0];
    let near_lamp = off(&points, |p| (p - lamp).norm() < 0.02)[0];
    let report = &result.report;
    println!("ball: rms {rms:.2}, 99 % {most:.1}, hand {near_hand:.2}, lamp {near_lamp:.2} levels");
    println!(
        "{:?} {} charts, {} bytes, used {:.2}, seen {:.2}, outliers {:.3}",
        report.size_px, report.charts, report.bytes, report.used_share, report.seen_share, report.outlier_share
    );
    assert!(rms < 1.5 && most < 4.0, "rms {rms}, 99 % {most}");
    assert!(near_hand < 1.5 && near_lamp < 1.5, "{near_hand} {near_lamp}");
    for (i, photo) in report.photos.iter().enumerate() {
        let off = (0..3).map(|k| (photo.gain[k] / gain(i)[k] - 1.0).abs()).fold(0.0, f64::max);
        assert!(off < 0.03, "{}: {:?} instead of {:?}", photo.name, photo.gain, gain(i));
    }
    assert!(report.seen_share > 0.6 && report.seen_share < 0.95);
    // What nobody saw is filled from its rim: of colours that there are, never black and never the background.
    for (p, c) in points.iter().filter(|(p, _)| p.z < -0.03) {
        assert!(c.iter().all(|v| (80.0..220.0).contains(v)), "{p} {c:?}");
    }
}

#[test]
fn a_mesh_of_the_right_shape_predicts_photos_that_it_has_not_seen() {
    let dir = tempfile::tempdir().unwrap();
    let gain = |photo: usize| if photo == 4 { 0.6 } else { 1.0 };
    let all = photograph(dir.path(), &cameras(), &meets_ball, &|photo, p| albedo(p).map(|c| c * gain(photo)));
    let some = |held: bool| {
        let views = all.views.iter().enumerate().filter(|(i, _)| (i % 8 == 4) == held).map(|(_, v)| v.clone());
        Capture { views: views.collect(), ..all.clone() }
    };
    let (trained, held_out) = (some(false), some(true));
    let predicts = |mesh: &TriMesh| -> Vec<Prediction> {
        let texture = textured(mesh, &trained);
        let (size, rgb) = texture.pixels().unwrap();
        let points = textured_points(mesh, &texture.uv, (size, &rgb), 60_000);
        // The halves on both sides of x = 0; of what is near it nothing is asked.
        let side = |f: usize| mesh.triangle(f).map(|p| p.x);
        let region_of: Vec<Option<usize>> = (0..mesh.faces.len())
            .map(|f| match side(f) {
                x if x.iter().all(|x| *x > 0.01) => Some(0),
                x if x.iter().all(|x| *x < -0.01) => Some(1),
                _ => None,
            })
            .collect();
        prediction(mesh, &points, &region_of, 3, &held_out).unwrap()
    };
    let right = ball(RADIUS, 5);
    // Too large by 3 mm on one side alone.
    let swell = |p: &Point3<f64>| p * (1.0 + 0.06 * (p.x / 0.02).clamp(0.0, 1.0));
    let wrong = TriMesh { vertices: right.vertices.iter().map(swell).collect(), faces: right.faces.clone() };
    let (right, wrong) = (predicts(&right), predicts(&wrong));
    let rms = |p: &Prediction| (p.square_error / p.pixels).sqrt() * 255.0;
    println!("right {:.2} {:.2}, wrong {:.2} {:.2}", rms(&right[0]), rms(&right[1]), rms(&wrong[0]), rms(&wrong[1]));
    assert!(right.iter().chain(&wrong).take(2).all(|p| p.pixels > 3000.0), "{right:?}");
    assert_eq!(right[2], Prediction::default());
    // Its exposure is not held against the photo.
    assert!(rms(&right[0]) < 4.0 && rms(&right[1]) < 4.0, "{right:?}");
    assert!(rms(&wrong[0]) > 2.0 * rms(&right[0]) && rms(&wrong[1]) < 1.5 * rms(&right[1]), "{wrong:?}");
}

#[test]
fn a_sheen_on_the_object_is_no_exposure_where_the_table_says_otherwise() {
    let dir = tempfile::tempdir().unwrap();
    let table = |eye: &Point3<f64>, ray: &Vector3<f64>| (ray.z < 0.0).then(|| (-RADIUS - eye.z) / ray.z);
    let scene = |eye: &Point3<f64>, ray: &Vector3<f64>| meets_ball(eye, ray).or_else(|| table(eye, ray));
    // One photo has 1.3 of the light, in another the ball, and nothing else, shines blue.
    let gain = |i: usize| if i == 2 { 1.3 } else { 1.0 };
    let mut capture = photograph(dir.path(), &cameras(), &scene, &|i, p| {
        let sheen = if i == 5 && p.coords.norm() < RADIUS + 1e-6 { 1.4 } else { 1.0 };
        let [r, g, b] = albedo(p).map(|c| c * gain(i));
        [r, g, sheen * b]
    });
    for k in 0..400 {
        let at = |k: usize| 0.01 * k as f64 - 0.095;
        let point = Point3::new(at(k % 20), at(k / 20), -RADIUS);
        capture.points.push(SparsePoint { position: point.into(), rgb: [0; 3], error_px: 0.0, track: Vec::new() });
        for view in &mut capture.views {
            let eye = Point3::from(view.camera_from_world.inverse().translation.vector);
            if meets_ball(&eye, &(point - eye)).is_none() {
                view.keypoints.push(Keypoint { x: 0.0, y: 0.0, point: Some(k) });
            }
        }
    }
    let mesh = ball(RADIUS, 5);
    let result = textured(&mesh, &capture);
    let mean = (0..20).map(|i| gain(i).ln()).sum::<f64>() / 20.0;
    for (i, photo) in result.report.photos.iter().enumerate() {
        let truth = gain(i) / mean.exp();
        assert!(
            photo.gain.iter().all(|g| (g / truth - 1.0).abs() < 0.03),
            "{}: {:?} for {truth}",
            photo.name,
            photo.gain
        );
    }
    let [rms, most] = off(&read_back(&mesh, &result, 40_000), |p| p.z > -0.01);
    println!("sheen: rms {rms:.2}, 99 % {most:.1} levels");
    assert!(rms < 2.0 && most < 8.0, "rms {rms}, 99 % {most}");
}

#[test]
fn a_box_of_twelve_faces_has_sharp_edges_and_no_seams() {
    let dir = tempfile::tempdir().unwrap();
    // Each photo darker towards one side, as no gain explains.
    let capture = photograph(dir.path(), &cameras(), &meets_box, &|i, p| {
        let shade = 1.0 + 2.0 * (p.x * (i as f64).sin() + p.y * (i as f64).cos());
        albedo(p).map(|c| shade * c)
    });
    let mesh = box_mesh();
    let result = textured(&mesh, &capture);
    let points = read_back(&mesh, &result, 40_000);
    let [rms, most] = off(&points, |p| p.z > -0.99 * HALF[2]);
    println!("box: rms {rms:.2}, 99 % {most:.1} levels; {:?} {} charts", result.report.size_px, result.report.charts);
    assert!(rms < 3.0 && most < 8.0, "rms {rms}, 99 % {most}");
    // Seams: at edges of the box charts meet, and both sides of each have the same colour.
    let picture = image::load_from_memory(&result.png).unwrap().into_rgb8();
    let (mut sum, mut count) = (0.0, 0.0);
    for (f, face) in mesh.faces.iter().enumerate() {
        for (g, other) in mesh.faces.iter().enumerate().filter(|(g, _)| *g > f) {
            let shared: Vec<u32> = face.iter().copied().filter(|v| other.contains(v)).collect();
            let &[a, b] = &shared[..] else { continue };
            if [a, b].iter().any(|v| mesh.vertices[*v as usize].z < 0.0) {
                continue;
            }
            for s in (1..50).map(|s| f64::from(s) / 50.0) {
                let colour = |f: usize| {
                    let uv = |v: u32| result.uv[f][mesh.faces[f].iter().position(|c| *c == v).unwrap()].map(f64::from);
                    let (a, b) = (uv(a), uv(b));
                    bilinear(&picture, [0, 1].map(|k| a[k] + s * (b[k] - a[k])))
                };
                let (one, two) = (colour(f), colour(g));
                (0..3).for_each(|k| sum += (one[k] - two[k]).powi(2));
                count += 3.0;
            }
        }
    }
    let seam = f64::sqrt(sum / count);
    println!("seams: rms {seam:.2} levels");
    assert!(seam < 3.5, "{seam}");
}

#[test]
fn charts_do_not_overlap_and_the_file_is_small_and_the_same_with_any_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let capture = photograph(dir.path(), &cameras()[..6], &meets_ball, &|_, p| albedo(p));
    let mesh = ball(RADIUS, 4);
    let mut options = TextureOptions::default();
    options.max_bytes = 60_000;
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| texture(&mesh, &capture, &options, &|_| {}).unwrap())
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(one, three);
    assert!(one.png.len() <= 60_000 && one.png.len() > 20_000, "{}", one.png.len());
    let [width, height] = one.report.size_px;
    // Each sample of a grid four times as fine as the texels, a little inside of the faces.
    let mut owners = vec![0u8; 16 * width * height];
    for uv in &one.uv {
        let size = [width, height].map(|s| 4.0 * s as f64);
        let p = uv.map(|c| [f64::from(c[0]) * size[0], f64::from(c[1]) * size[1]]);
        let side =
            |a: [f64; 2], b: [f64; 2], x: [f64; 2]| (b[0] - a[0]) * (x[1] - a[1]) - (b[1] - a[1]) * (x[0] - a[0]);
        let area = side(p[0], p[1], p[2]);
        let range = |k: usize| {
            let at = p.map(|c| c[k]);
            at.iter().copied().fold(f64::INFINITY, f64::min) as usize
                ..at.iter().copied().fold(0.0, f64::max) as usize + 1
        };
        for y in range(1) {
            for x in range(0) {
                let at = [x as f64 + 0.5, y as f64 + 0.5];
                if (0..3).all(|k| side(p[k], p[(k + 1) % 3], at) / area > 1e-3) {
                    owners[y * 4 * width + x] += 1;
                }
            }
        }
    }
    assert!(owners.iter().filter(|n| **n == 1).count() > 4 * width * height, "little of the picture is used");
    assert_eq!(owners.iter().filter(|n| **n > 1).count(), 0);
}

#[test]
fn what_cannot_be_textured_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let capture = photograph(dir.path(), &cameras()[..2], &meets_ball, &|_, p| albedo(p));
    let refused = |mesh: &TriMesh, capture: &Capture, options: &TextureOptions, what: &str| {
        let message = texture(mesh, capture, options, &|_| {}).unwrap_err().to_string();
        assert!(message.contains(what), "{message}");
    };
    let (mesh, options) = (ball(RADIUS, 2), TextureOptions::default());
    refused(&TriMesh::default(), &capture, &options, "a mesh without faces");
    let torn = TriMesh { vertices: mesh.vertices.clone(), faces: vec![[0, 1, 9999]] };
    refused(&torn, &capture, &options, "face 0");
    let mut none = capture.clone();
    none.views.clear();
    refused(&mesh, &none, &options, "none of the 0 photos");
    let mut behind = mesh.clone();
    behind.vertices.iter_mut().for_each(|v| v.z += 5.0);
    refused(&behind, &capture, &options, "none of the 2 photos");
    let mut tiny = TextureOptions::default();
    tiny.max_side = 3;
    refused(&mesh, &capture, &tiny, "sides up to 3");
    // A photo that became another one.
    RgbImage::new(5, 7).save(&capture.views[1].photo).unwrap();
    refused(&mesh, &capture, &options, "01.png");
}
