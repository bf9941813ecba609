use std::panic::catch_unwind;
use std::sync::Mutex;

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use drex_core::capture::{Capture, SparsePoint, View};
use drex_mvs::{DepthMap, DepthMaps, MvsOptions, Preset, Region, Step};
use image::imageops::FilterType;
use nalgebra::{Point3, Vector3};

use crate::scene::{FOCAL_PX, HEIGHT, Surface, WIDTH, photograph, ring};

/// Five photos, the first between the others, 15 degrees from it.
const CROSS: [[f64; 2]; 5] = [[0.0, 0.0], [15.0, 0.0], [-15.0, 0.0], [0.0, 15.0], [0.0, -15.0]];

fn anywhere() -> MvsOptions {
    let mut options = MvsOptions::default();
    options.on_gpu = crate::on_gpu();
    options
}

fn options(half: f64) -> MvsOptions {
    let mut options = anywhere();
    options.region = Some(Region {
        box_from_world: Pose::identity(),
        corners: [Point3::from(Vector3::repeat(-half)), Point3::from(Vector3::repeat(half))],
    });
    options
}

fn estimate(capture: &Capture, options: &MvsOptions) -> DepthMaps {
    DepthMaps::estimate(capture, options, &|_| {}).unwrap()
}

/// Errors of the depths of a map and of its normals, in degrees, where there are any; and how many pixels show the surface.
fn errors(
    map: &DepthMap,
    surface: Surface<'_>,
    normal: impl Fn(&Point3<f64>) -> Vector3<f64>,
) -> (Vec<f64>, Vec<f64>, usize) {
    let camera = &map.camera;
    let world_from_camera = camera.camera_from_world.inverse();
    let eye = camera.centre();
    let (mut depths, mut normals, mut shown) = (Vec::new(), Vec::new(), 0);
    for (i, z) in map.depth.iter().enumerate() {
        let ray = camera.ray([(i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5]);
        let Some(truth) = surface(&eye, &(world_from_camera.rotation * ray)) else { continue };
        shown += 1;
        if *z > 0.0 {
            depths.push(f64::from(*z) - truth);
            let found = world_from_camera.rotation * Vector3::from(map.normal[i].map(f64::from));
            normals.push(found.angle(&normal(&(eye + world_from_camera.rotation * ray * truth))).to_degrees());
        }
    }
    (depths, normals, shown)
}

fn median(values: &[f64]) -> f64 {
    drex_core::stats::median(values.iter().copied()).unwrap()
}

/// What a tenth of a pixel is in depth at distance `far`, 15 degrees apart.
fn tenth_of_a_pixel(far: f64) -> f64 {
    0.1 * far / FOCAL_PX / 15f64.to_radians().sin()
}

/// The normal of a plane through the origin that is turned about y.
fn normal_at(slant_deg: f64) -> Vector3<f64> {
    Vector3::new(slant_deg.to_radians().sin(), 0.0, -slant_deg.to_radians().cos())
}

/// That plane, 0.2 wide.
fn slanted(slant_deg: f64) -> impl Fn(&Point3<f64>, &Vector3<f64>) -> Option<f64> + Sync {
    let normal = normal_at(slant_deg);
    move |eye, ray| {
        let t = -normal.dot(&eye.coords) / normal.dot(ray);
        (t > 0.0 && (eye + ray * t).coords.amax() < 0.1).then_some(t)
    }
}

#[test]
fn slanted_planes_are_found_to_a_tenth_of_a_pixel() {
    for (slant_deg, preset) in [(0.0, Preset::Fast), (45.0, Preset::Default)] {
        let (normal, plane) = (normal_at(slant_deg), slanted(slant_deg));
        let dir = tempfile::tempdir().unwrap();
        let capture = photograph(dir.path(), &ring(0.4, &CROSS), &plane, 0.004, 80.0);
        let mut options = options(0.1);
        options.preset = preset;
        let maps = estimate(&capture, &options);
        let (depths, normals, shown) = errors(&maps.views[0], &plane, |_| normal);
        // Its ends are outside of some photos.
        assert!(depths.len() as f64 > 0.8 * shown as f64, "{slant_deg}: {} of {shown}", depths.len());
        let off: Vec<f64> = depths.iter().map(|e| e.abs()).collect();
        let [tenth, found] = [tenth_of_a_pixel(0.4), median(&off)];
        assert!(found < 0.5 * tenth && median(&depths).abs() < 0.1 * tenth, "{slant_deg}: {found} of {tenth}");
        assert!(median(&normals) < 2.0, "{slant_deg}: {} degrees", median(&normals));
        // The half that is trusted more is nearer, and what is trusted less than asked is left out.
        let trusted: Vec<f64> = maps.views[0].confidence.iter().filter(|c| **c > 0.0).map(|c| f64::from(*c)).collect();
        let mut half = maps.views[0].clone();
        let usual = median(&trusted) as f32;
        half.depth.iter_mut().zip(&half.confidence).filter(|(_, c)| **c < usual).for_each(|(z, _)| *z = 0.0);
        let better: Vec<f64> = errors(&half, &plane, |_| normal).0.iter().map(|e| e.abs()).collect();
        assert!(median(&better) < 0.9 * found, "{slant_deg}: {} of {found}", median(&better));
        assert!(trusted.iter().all(|c| (f64::from(options.least_confidence)..=1.0).contains(c)));

        // Cameras half a pixel beside where they are: the same numbers say so.
        let mut wrong = capture;
        for view in &mut wrong.views[1..] {
            let aside = view.camera_from_world.rotation * Vector3::new(0.0, 1.0, 0.0) * (0.5 * 0.4 / FOCAL_PX);
            view.camera_from_world.translation.vector += aside + Vector3::x() * (0.5 * 0.4 / FOCAL_PX);
        }
        let (depths, _, _) = errors(&estimate(&wrong, &options).views[0], &plane, |_| normal);
        let off: Vec<f64> = depths.iter().map(|e| e.abs()).collect();
        assert!(depths.is_empty() || median(&off) > 2.0 * found, "{slant_deg}: {} after {found}", median(&off));
    }
}

#[test]
fn a_ball_is_neither_too_near_nor_too_far() {
    const RADIUS: f64 = 0.05;
    let ball = |eye: &Point3<f64>, ray: &Vector3<f64>| {
        let (a, b, c) = (ray.norm_squared(), ray.dot(&eye.coords), eye.coords.norm_squared() - RADIUS * RADIUS);
        let root = b * b - a * c;
        (root > 0.0).then(|| (-b - root.sqrt()) / a)
    };
    let dir = tempfile::tempdir().unwrap();
    let capture = photograph(dir.path(), &ring(0.3, &CROSS), &ball, 0.004, 80.0);
    let maps = estimate(&capture, &options(0.06));
    let (depths, normals, shown) = errors(&maps.views[0], &ball, |p| p.coords.normalize());
    assert!(depths.len() as f64 > 0.9 * shown as f64, "{} of {shown}", depths.len());
    // A pixel is a millimetre; a flat window of eleven pixels finds this ball a quarter of a millimetre too far away.
    assert!(median(&depths).abs() < 1e-4, "{}", median(&depths));
    assert!(median(&normals) < 3.0, "{} degrees", median(&normals));
}

#[test]
fn large_photos_are_compared_as_small_as_the_preset_has_time_for() {
    let dir = tempfile::tempdir().unwrap();
    let mut capture = photograph(dir.path(), &ring(0.4, &CROSS[..2]), &slanted(0.0), 0.004, 80.0);
    let small = options(0.5);
    assert_eq!(small.clone().within_time(&capture).unwrap(), small);
    let [width, height, focal_px] = [6.0 * f64::from(WIDTH), 6.0 * f64::from(HEIGHT), 6.0 * FOCAL_PX];
    for view in &mut capture.views {
        let photo = image::open(&view.photo).unwrap();
        photo.resize_exact(6 * WIDTH, 6 * HEIGHT, FilterType::Nearest).save(&view.photo).unwrap();
        let params = [focal_px, focal_px, 0.5 * width, 0.5 * height];
        view.lens = Camera::new(CameraModel::Pinhole, 6 * WIDTH, 6 * HEIGHT, &params).unwrap();
    }
    // The region is in all pixels.
    for (preset, pixels) in [(Preset::Fast, Some(0.3e6)), (Preset::Default, Some(1e6)), (Preset::Best, None)] {
        let mut options = options(0.5);
        options.preset = preset;
        let found = options.clone().within_time(&capture).unwrap().max_side.unwrap() as f64;
        let expected = pixels.map_or(2000.0, |pixels: f64| width * (pixels / (width * height)).sqrt());
        assert!((found - expected).abs() <= 1.0, "{preset:?}: {found}, not {expected}");
    }
}

#[test]
fn an_interrupted_run_is_gone_on_with() {
    let dir = tempfile::tempdir().unwrap();
    let capture = photograph(dir.path(), &ring(0.4, &CROSS[..3]), &slanted(20.0), 0.004, 80.0);
    let mut options = options(0.1);
    options.preset = Preset::Fast;
    let whole = estimate(&capture, &options);
    options.work = Some(dir.path().join("work"));
    let stops = |step: Step| assert!(step.stage != "depth" || step.done < 7, "interrupted");
    let stopped = catch_unwind(|| DepthMaps::estimate(&capture, &options, &stops));
    assert!(stopped.is_err());
    let steps = Mutex::new(Vec::new());
    let goes_on = |step: Step| steps.lock().unwrap().extend((step.stage == "depth").then_some(step.done));
    assert_eq!(DepthMaps::estimate(&capture, &options, &goes_on).unwrap(), whole);
    // Three photos went through two rounds, the first one through a third.
    assert_eq!(steps.lock().unwrap()[..2], [6, 7]);
    assert_eq!(options.work.as_ref().unwrap().read_dir().unwrap().count(), 3, "what is of no use any more is gone");
    // Nothing of it serves other options.
    options.seed += 1;
    steps.lock().unwrap().clear();
    let other = DepthMaps::estimate(&capture, &options, &goes_on).unwrap();
    assert!(steps.lock().unwrap()[0] == 0 && other != whole);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let plane = slanted(20.0);
    let dir = tempfile::tempdir().unwrap();
    let capture = photograph(dir.path(), &ring(0.4, &CROSS[..3]), &plane, 0.004, 80.0);
    let mut options = options(0.1);
    options.preset = Preset::Fast;
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| estimate(&capture, &options))
    };
    let one = with(1);
    assert!(one == with(3));
    let mut other = options.clone();
    other.seed = 1;
    assert!(one != estimate(&capture, &other), "the seed is not used");
}

#[test]
fn a_wall_without_paint_gives_next_to_no_depth() {
    let plane = slanted(0.0);
    let dir = tempfile::tempdir().unwrap();
    let capture = photograph(dir.path(), &ring(0.4, &CROSS), &plane, 0.004, 0.0);
    let mut options = options(0.1);
    options.preset = Preset::Fast;
    let map = &estimate(&capture, &options).views[0];
    // The wall's rim is seen.
    let middle = |i: usize| {
        let (x, y) = (i % map.camera.width, i / map.camera.width);
        (map.camera.cx - x as f64).abs().max((map.camera.cy - y as f64).abs()) < 55.0
    };
    let all: Vec<usize> = (0..map.depth.len()).filter(|i| middle(*i)).collect();
    let found = all.iter().filter(|i| map.depth[**i] > 0.0).count();
    assert!(all.len() > 10_000 && (found as f64) < 0.05 * all.len() as f64, "{found} of {}", all.len());
}

#[test]
fn shading_alone_tells_little_depth_and_that_to_the_pixel_that_is_claimed() {
    let plane = slanted(0.0);
    let dir = tempfile::tempdir().unwrap();
    // What is painted changes over more than a window's width, by far more than the noise.
    let capture = photograph(dir.path(), &ring(0.4, &CROSS), &plane, 0.15, 80.0);
    let mut options = options(0.1);
    options.preset = Preset::Fast;
    let map = &estimate(&capture, &options).views[0];
    let middle = |i: usize| {
        let (x, y) = (i % map.camera.width, i / map.camera.width);
        (map.camera.cx - x as f64).abs().max((map.camera.cy - y as f64).abs()) < 50.0
    };
    let all: Vec<usize> = (0..map.depth.len()).filter(|i| middle(*i)).collect();
    // A pixel of disparity in photos 15 degrees apart.
    let pixel_m = 0.4 / FOCAL_PX / 15f64.to_radians().sin();
    let found = all.iter().map(|i| f64::from(map.depth[*i])).filter(|z| *z > 0.0);
    let off: Vec<f64> = found.map(|z| (z - 0.4).abs() / pixel_m).collect();
    assert!(all.len() > 9_000 && (off.len() as f64) < 0.2 * all.len() as f64, "{} of {}", off.len(), all.len());
    let far = off.iter().filter(|px| **px > 1.0).count();
    assert!((far as f64) < 0.01 * off.len() as f64, "{far} of {} are off by more than a pixel", off.len());
}

#[test]
fn what_is_outside_of_a_mask_is_not_looked_at() {
    let plane = slanted(0.0);
    let dir = tempfile::tempdir().unwrap();
    let mut capture = photograph(dir.path(), &ring(0.4, &CROSS[..3]), &plane, 0.004, 80.0);
    let mut mask = image::GrayImage::new(WIDTH, HEIGHT);
    mask.enumerate_pixels_mut().for_each(|(x, _, p)| p.0 = [if x < WIDTH / 2 { 255 } else { 0 }]);
    let file = dir.path().join("mask.png");
    mask.save(&file).unwrap();
    capture.views[0].mask = Some(file);
    let mut options = options(0.1);
    options.preset = Preset::Fast;
    let map = &estimate(&capture, &options).views[0];
    let column = |i: usize| i % map.camera.width + map.corner[0];
    let found: Vec<usize> = (0..map.depth.len()).filter(|i| map.depth[*i] > 0.0).map(column).collect();
    let last = WIDTH as usize / 2 + options.mask_margin_px;
    assert!(found.len() > 5000 && found.iter().all(|x| *x < last), "{} up to {:?}", found.len(), found.iter().max());
}

#[test]
fn an_object_is_looked_for_where_its_masks_show_points_and_not_in_the_room_behind() {
    let plane = slanted(20.0);
    let dir = tempfile::tempdir().unwrap();
    let mut capture = photograph(dir.path(), &ring(0.4, &CROSS), &plane, 0.004, 80.0);
    let pinhole = |view: &View, place: Point3<f64>| {
        let p = view.camera_from_world * place;
        let [u, v] = [p.x, p.y].map(|x| FOCAL_PX * x / p.z);
        let [x, y] = [u + 0.5 * f64::from(WIDTH), v + 0.5 * f64::from(HEIGHT)];
        (p.z > 0.0 && x >= 0.0 && y >= 0.0 && x < f64::from(WIDTH) && y < f64::from(HEIGHT)).then_some([x, y])
    };
    let shows = |view: &View, [x, y]: [f64; 2]| {
        let world_from_camera = view.camera_from_world.inverse();
        let ray = Vector3::new((x - 0.5 * f64::from(WIDTH)) / FOCAL_PX, (y - 0.5 * f64::from(HEIGHT)) / FOCAL_PX, 1.0);
        plane(&Point3::from(world_from_camera.translation.vector), &(world_from_camera.rotation * ray)).is_some()
    };
    for (i, view) in capture.views.iter_mut().enumerate() {
        let mask = image::GrayImage::from_fn(WIDTH, HEIGHT, |x, y| {
            image::Luma([if shows(view, [f64::from(x) + 0.5, f64::from(y) + 0.5]) { 255 } else { 0 }])
        });
        let file = dir.path().join(format!("{i}.mask.png"));
        mask.save(&file).unwrap();
        view.mask = Some(file);
    }
    let on_plane = |x: f64, y: f64| Point3::new(x, y, x * 20f64.to_radians().tan());
    let object = (0..64).map(|i| (on_plane(f64::from(i % 8 - 4) * 0.015, f64::from(i / 8 - 4) * 0.015), true));
    let room = (0..900).map(|i| {
        let away = 3.0 + f64::from(i % 7);
        (Point3::new(f64::from(i % 30 - 15) * 0.02, f64::from(i / 30 - 15) * 0.02, 1.0) * away, false)
    });
    for (place, is_object) in object.chain(room) {
        let seen = |view: &View| pinhole(view, place).is_some_and(|pixel| shows(view, pixel) == is_object);
        let track: Vec<(usize, usize)> =
            capture.views.iter().enumerate().filter(|(_, view)| seen(view)).map(|(i, _)| (i, 0)).collect();
        capture.points.push(SparsePoint { position: place.coords.into(), rgb: [0; 3], error_px: 0.0, track });
    }
    let of_room = capture.points[64..].iter().filter(|p| p.track.iter().any(|(view, _)| *view == 0)).count();
    assert!(of_room > 50, "{of_room} points of the room in the first photo");
    let mut options = anywhere();
    options.preset = Preset::Fast;
    let (depths, _, shown) = errors(&estimate(&capture, &options).views[0], &plane, |_| normal_at(20.0));
    assert!(depths.len() as f64 > 0.7 * shown as f64, "{} of {shown}", depths.len());
    let off: Vec<f64> = depths.iter().map(|e| e.abs()).collect();
    assert!(median(&off) < 0.5 * tenth_of_a_pixel(0.4), "{}", median(&off));
}

#[test]
fn photos_that_cannot_be_compared_are_refused() {
    let plane = slanted(0.0);
    let dir = tempfile::tempdir().unwrap();
    let capture = photograph(dir.path(), &ring(0.4, &CROSS[..2]), &plane, 0.004, 80.0);
    let refused = |capture: &Capture, options: &MvsOptions, words: &str| {
        let error = DepthMaps::estimate(capture, options, &|_| {}).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    };
    let mut one = capture.clone();
    one.views.truncate(1);
    refused(&one, &options(0.1), "at least two photos");
    let mut same = capture.clone();
    same.views[1].camera_from_world = same.views[0].camera_from_world;
    refused(&same, &options(0.1), "from 3 to 45 degrees apart");
    refused(&capture, &options(-0.1), "a box of finite size");
    refused(&capture, &options(f64::NAN), "a box of finite size");
    refused(&capture, &anywhere(), "shows no sparse point");
    let mut sure = options(0.1);
    sure.least_confidence = 1.5;
    refused(&capture, &sure, "a least confidence of 1.5");
    let mut lost = capture.clone();
    lost.views[1].photo = dir.path().join("lost.png");
    refused(&lost, &options(0.1), "lost.png");
    if !cfg!(feature = "wgpu") {
        let mut on_gpu = options(0.1);
        on_gpu.on_gpu = true;
        refused(&capture, &on_gpu, "build it with `--features wgpu`");
    }
    // Two are enough.
    let maps = estimate(&capture, &options(0.1));
    assert!(maps.views[0].depth.iter().filter(|z| **z > 0.0).count() > 5000);
}
