//! Photos straightened, scaled and kept: lenses against what a pinhole would have seen, values, memory.

use std::path::Path;
use std::sync::Arc;

use drex_core::camera::PinholeCamera;
use drex_core::camera::{Camera, CameraModel};
use drex_core::capture::{Capture, CaptureOptions, Photo, PhotoOptions, Photos};
use image::{GrayImage, ImageBuffer, Luma, Rgb, RgbImage, RgbaImage};
use nalgebra::{Point2, Point3, Vector2, Vector3};

use crate::capture_support::{grey, lens, on_disk, ring};

fn load(folder: &Path) -> Capture {
    Capture::load(folder, &CaptureOptions::default()).unwrap()
}

fn options(max_side: Option<usize>) -> PhotoOptions {
    let mut options = PhotoOptions::default();
    options.max_side = max_side;
    options
}

fn photo(capture: &Capture, max_side: Option<usize>) -> Arc<Photo> {
    Photos::new(capture, options(max_side)).unwrap().get(0).unwrap()
}

/// Directions of a square grid on the plane z = 1.
fn grid() -> Vec<Vector3<f64>> {
    let side = |i: i32| 0.12 * f64::from(i);
    (-4..=4).flat_map(|i| (-4..=4).map(move |j| Vector3::new(side(i), side(j), 1.0))).collect()
}

/// A photo, through `lens`, of a round spot at each point of the grid.
fn spots(lens: &Camera) -> RgbImage {
    RgbImage::from_fn(lens.width_px(), lens.height_px(), |x, y| {
        let ray = lens.unproject(&Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
        let bright = ray.filter(|r| r.z > 0.1).map_or(0.0, |ray| {
            let place = ray / ray.z;
            let nearest = place.map(|v| 0.12 * (v / 0.12).round().clamp(-4.0, 4.0));
            (-0.5 * (place - nearest).xy().norm_squared() / 0.02f64.powi(2)).exp()
        });
        Rgb([(255.0 * bright).round() as u8; 3])
    })
}

/// The centre of the spot near `at`, by its values.
fn centre(photo: &Photo, at: [f64; 2], radius: f64) -> Option<[f64; 2]> {
    let (mut sum, mut mean) = (0.0, [0.0; 2]);
    let range = |v: f64, size: usize| {
        let inside = v - radius >= 0.0 && v + radius < size as f64;
        inside.then(|| (v - radius).round() as usize..(v + radius).round() as usize)
    };
    let (columns, rows) = (range(at[0], photo.camera.width)?, range(at[1], photo.camera.height)?);
    for y in rows {
        for x in columns.clone() {
            let [px, py] = [x as f64 + 0.5, y as f64 + 0.5];
            if (px - at[0]).hypot(py - at[1]) < radius {
                let value = f64::from(photo.rgb[y * photo.camera.width + x][0]);
                sum += value;
                mean = [mean[0] + value * px, mean[1] + value * py];
            }
        }
    }
    Some(mean.map(|m| m / sum))
}

fn pixel(camera: &PinholeCamera, direction: &Vector3<f64>) -> [f64; 2] {
    [camera.fx * direction.x / direction.z + camera.cx, camera.fy * direction.y / direction.z + camera.cy]
}

#[test]
fn every_lens_becomes_straight() {
    for model in CameraModel::ALL {
        // Larger than the support's lens, so that a spot has enough pixels to weigh.
        let lens = lens(model).resized(320, 240).unwrap();
        let (_guard, folder) = on_disk(&ring(&lens, 1, 0));
        spots(&lens).save(folder.join("images/view 00.png")).unwrap();
        let capture = load(&folder);
        for max_side in [None, Some(250), Some(160)] {
            let photo = photo(&capture, max_side);
            assert_eq!(photo.camera, capture.pinhole(0, max_side).unwrap());
            assert!(max_side.is_none_or(|side| photo.camera.width.max(photo.camera.height) == side));
            let mut found = 0;
            for spot in grid() {
                let expected = pixel(&photo.camera, &spot);
                let Some(c) = centre(&photo, expected, 0.058 * photo.camera.fx) else { continue };
                let off = (c[0] - expected[0]).hypot(c[1] - expected[1]);
                assert!(off < 0.1, "{model}, {max_side:?}: spot {spot:?} at {c:?}, expected {expected:?}");
                found += 1;
            }
            assert!(found >= 40, "{model}: {found} spots in {:?}", photo.camera);
        }
        // Nothing of the picture is made up: its rim lies within the photo; and not much of the photo is lost.
        let camera = capture.pinhole(0, None).unwrap();
        let (w, h) = (camera.width as f64, camera.height as f64);
        let mut rim = Vec::new();
        for i in 0..=50 {
            let t = f64::from(i) / 50.0;
            rim.extend([[t * w, 0.0], [t * w, h], [0.0, t * h], [w, t * h]]);
        }
        for at in rim {
            let p = lens.project(&Point3::from(camera.ray(at))).unwrap();
            assert!((-0.02..320.02).contains(&p.x) && (-0.02..240.02).contains(&p.y), "{model}: {at:?} from {p:?}");
        }
        let pinhole = matches!(model, CameraModel::SimplePinhole | CameraModel::Pinhole);
        assert!(!pinhole || [w, h, camera.cx, camera.cy] == [320.0, 240.0, 77.0 * 2.0, 64.0 * 2.0]);
        assert!(w * h > 0.7 * 320.0 * 240.0, "{model}: {w} x {h}");
    }
}

/// As it is fitted where no point lies at the rim.
#[test]
fn a_lens_that_folds_back_within_its_photo_leaves_the_middle() {
    let numbers = [690.0, 690.0, 460.0, 370.0, 0.1, -0.47, 0.01, -0.008];
    let lens = Camera::new(CameraModel::OpenCv, 960, 720, &numbers).unwrap();
    assert!(lens.unproject(&Point2::new(959.0, 370.0)).is_none());
    let (_guard, folder) = on_disk(&ring(&lens, 1, 0));
    let camera = load(&folder).pinhole(0, None).unwrap();
    assert!(camera.width > 640 && camera.height > 480, "{camera:?}");
    for [x, y] in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
        let ray = camera.ray([x * camera.width as f64, y * camera.height as f64]);
        let corner = lens.project(&Point3::from(ray)).unwrap();
        assert!((0.0..960.0).contains(&corner.x) && (0.0..720.0).contains(&corner.y), "{corner}");
    }
}

#[test]
fn scaling_takes_the_mean_over_the_area() {
    let lens = Camera::new(CameraModel::Pinhole, 6, 4, &[5.0, 5.0, 2.5, 2.25]).unwrap();
    let (_guard, folder) = on_disk(&ring(&lens, 1, 0));
    let path = folder.join("images/view 00.png");
    let source = RgbImage::from_fn(6, 4, |x, y| Rgb([(40 * x) as u8, (60 * y) as u8, (x * y) as u8]));
    source.save(&path).unwrap();
    let capture = load(&folder);
    let whole = photo(&capture, Some(6));
    assert_eq!(whole.rgb, source.pixels().map(|p| p.0).collect::<Vec<_>>());
    let half = photo(&capture, Some(3));
    assert_eq!((half.camera.width, half.camera.height), (3, 2));
    assert_eq!((half.camera.fx, half.camera.cx, half.camera.cy), (2.5, 1.25, 1.125));
    let mean = |x: usize, y: usize, k: usize| {
        let at = |dx, dy| f64::from(source.get_pixel((2 * x + dx) as u32, (2 * y + dy) as u32).0[k]);
        (0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1)) + 0.5).floor() as u8
    };
    for (i, value) in half.rgb.iter().enumerate() {
        assert_eq!(*value, [0, 1, 2].map(|k| mean(i % 3, i / 3, k)));
    }
    // 6 to 4 columns: each takes one and a half, 4 to 3 rows: one and a third; ramps stay ramps.
    let odd = photo(&capture, Some(4));
    assert_eq!((odd.camera.width, odd.camera.height), (4, 3));
    let first = [0, 1, 2, 3].map(|x| odd.rgb[x][0]);
    assert_eq!(first, [13, 67, 133, 187]); // (0 + 40/2)/1.5, (40/2 + 80)/1.5, (120 + 160/2)/1.5, (160/2 + 200)/1.5
}

#[test]
fn masks_follow_the_photo() {
    for model in [CameraModel::Pinhole, CameraModel::OpenCv, CameraModel::OpenCvFisheye] {
        let lens = lens(model);
        let (_guard, folder) = on_disk(&ring(&lens, 1, 0));
        // The object is what lies right of x = 0.1 z; the photo shows the same as the mask.
        let white = |x: u32, y: u32, k: f64| {
            let at = Point2::new((f64::from(x) + 0.5) * k, (f64::from(y) + 0.5) * k);
            if lens.unproject(&at).unwrap().x > 0.1 * lens.unproject(&at).unwrap().z { 255 } else { 0 }
        };
        let path = folder.join("images/view 00.png");
        let mask = folder.join("masks/view 00.png");
        RgbImage::from_fn(160, 120, |x, y| Rgb([white(x, y, 1.0); 3])).save(&path).unwrap();
        std::fs::create_dir(folder.join("masks")).unwrap();
        GrayImage::from_fn(160, 120, |x, y| Luma([white(x, y, 1.0)])).save(&mask).unwrap();
        let same = photo(&load(&folder), Some(120));
        let values = same.mask.as_ref().unwrap();
        assert!(same.rgb.iter().zip(values).all(|(rgb, m)| rgb[0] == *m));
        // A mask of half the size lies in the same place, to its own pixels; one of zeros and ones as well.
        GrayImage::from_fn(80, 60, |x, y| Luma([white(x, y, 2.0)])).save(&mask).unwrap();
        let half = photo(&load(&folder), None);
        let edge = pixel(&half.camera, &Vector3::new(0.1, 0.0, 1.0))[0];
        let [mut inside, mut outside] = [0, 0];
        for (i, m) in half.mask.as_ref().unwrap().iter().enumerate() {
            let x = (i % half.camera.width) as f64 + 0.5;
            inside += usize::from(x > edge + 2.5 && *m < 255);
            outside += usize::from(x < edge - 2.5 && *m > 0);
        }
        assert_eq!([inside, outside], [0, 0], "{model}");
        GrayImage::from_fn(160, 120, |x, y| Luma([white(x, y, 1.0) / 255])).save(&mask).unwrap();
        assert_eq!(photo(&load(&folder), Some(120)).mask, same.mask);
        // No mask but a photo that is cut out.
        std::fs::remove_file(&mask).unwrap();
        assert_eq!(photo(&load(&folder), None).mask, None);
        let cut = RgbaImage::from_fn(160, 120, |x, y| image::Rgba([9, 8, 7, white(x, y, 1.0)]));
        cut.save(&path).unwrap();
        let cut = photo(&load(&folder), Some(120));
        assert_eq!(cut.mask, same.mask);
        assert!(cut.rgb.iter().all(|rgb| *rgb == [9, 8, 7]));
    }
}

#[test]
fn depth_and_normals_are_not_mixed() {
    let lens = lens(CameraModel::SimpleRadial);
    let (_guard, folder) = on_disk(&ring(&lens, 1, 0));
    for kind in ["depths", "normals"] {
        std::fs::create_dir(folder.join(kind)).unwrap();
    }
    let depth = |x: u32| if x < 80 { 1500u16 } else { 0 };
    let png = ImageBuffer::<Luma<u16>, Vec<u16>>::from_fn(160, 120, |x, _| Luma([depth(x)]));
    png.save(folder.join("depths/view 00.png")).unwrap();
    // Left a wall in front, (0, 0, -1); right nothing is known.
    let normal = |x: u32| if x < 80 { Rgb([128, 128, 0]) } else { Rgb([0; 3]) };
    RgbImage::from_fn(160, 120, |x, _| normal(x)).save(folder.join("normals/view 00.png")).unwrap();
    let capture = load(&folder);
    let mut options = options(Some(90));
    let get = |options: &PhotoOptions| Photos::new(&capture, options.clone()).unwrap().get(0);
    let photo = get(&options).unwrap();
    let (depths, normals) = (photo.depth.as_ref().unwrap(), photo.normal.as_ref().unwrap());
    assert!(depths.iter().all(|d| [0.0, 1.5].contains(d)) && depths.contains(&0.0) && depths[0] == 1.5);
    assert!((normals[0][2] + 1.0).abs() < 1e-4 && normals[0][0].abs() < 0.01);
    assert!(normals.iter().zip(depths).all(|(n, d)| (n[2] != 0.0) == (*d > 0.0)));
    (options.depth_scale, options.flip_normals) = (0.01, [false, true, true]);
    let turned = get(&options).unwrap();
    assert_eq!(turned.depth.as_ref().unwrap()[0], 15.0);
    assert_eq!(turned.normal.as_ref().unwrap()[0][2], -normals[0][2]);

    // The same map as npy, in scene units.
    std::fs::remove_file(folder.join("depths/view 00.png")).unwrap();
    let header = |descr: &str, shape: &str| {
        let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        [b"\x93NUMPY\x01\x00".as_slice(), &(text.len() as u16).to_le_bytes(), text.as_bytes()].concat()
    };
    let values = (0..160 * 120).flat_map(|i| (f32::from(depth(i % 160)) / 1000.0).to_le_bytes()).collect::<Vec<_>>();
    let file = folder.join("depths/view 00.npy");
    std::fs::write(&file, [header("<f4", "(120, 160)"), values.clone()].concat()).unwrap();
    let capture = load(&folder);
    let get = |options: &PhotoOptions| Photos::new(&capture, options.clone()).unwrap().get(0);
    assert_eq!(get(&options).unwrap().depth, photo.depth);
    for (bytes, reason) in [
        ([header("<f4", "(120, 161)"), values.clone()].concat(), "do not make"),
        ([header("<f4", "(99999999999, 99999999999)"), values.clone()].concat(), "do not make"),
        ([header("<f4", "(19200,)"), values.clone()].concat(), "two dimensions"),
        ([header("<i4", "(120, 160)"), values.clone()].concat(), "float32 or float64"),
        ([header("<f4", "(160, 120)"), values.clone()].concat(), "aspect"),
        (b"\x93NUMPY\x01\x00\xff\xff{".to_vec(), "no npy array"),
        (b"PNG".to_vec(), "no npy array"),
    ] {
        std::fs::write(&file, bytes).unwrap();
        let message = get(&options).unwrap_err().to_string();
        assert!(message.contains(reason) && message.contains("view 00"), "{message}");
    }
}

#[test]
fn memory_is_bounded_and_changes_nothing() {
    let lens = lens(CameraModel::Radial);
    let model = ring(&lens, 12, 0);
    let (_guard, folder) = on_disk(&model);
    for (i, image) in model.images.iter().enumerate() {
        let picture = RgbImage::from_fn(160, 120, |x, y| Rgb([x as u8, y as u8, 20 * i as u8]));
        picture.save(folder.join("images").join(&image.name)).unwrap();
    }
    let capture = load(&folder);
    let all = Photos::new(&capture, options(Some(100))).unwrap();
    let one = {
        let camera = all.camera(0);
        camera.width * camera.height * 3
    };
    let mut tight = options(Some(100));
    tight.memory_bytes = 3 * one;
    let few = Photos::new(&capture, tight).unwrap();
    // Four threads in different orders: everyone gets the same pictures.
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let (all, few) = (&all, &few);
            scope.spawn(move || {
                for i in 0..36 {
                    let view = (i * (2 * thread + 1) + thread) % 12;
                    let photo = few.get(view).unwrap();
                    assert_eq!(photo, all.get(view).unwrap());
                    assert_eq!(photo.camera, *few.camera(view));
                }
            });
        }
    });
    // Three kept, one just put in, and in each thread one that is being read: the decoded photo twice and the result.
    let reading = 4 * (6 * 160 * 120 + one);
    assert!(few.peak_bytes() <= 4 * one + reading, "{} of {}", few.peak_bytes(), 4 * one + reading);
    assert!(all.peak_bytes() >= 12 * one);
    assert!(few.get(12).is_err());
}

#[test]
fn what_cannot_be_read_is_named() {
    let (_guard, folder) = on_disk(&ring(&lens(CameraModel::Pinhole), 2, 0));
    let capture = load(&folder);
    let photos = Photos::new(&capture, options(None)).unwrap();
    grey(&folder.join("images/view 00.png"), 80, 60);
    assert!(photos.get(0).unwrap_err().to_string().contains("view 00.png has changed its size"));
    std::fs::write(folder.join("images/view 01.png"), b"no picture").unwrap();
    assert!(photos.get(1).unwrap_err().to_string().contains("cannot read the picture"));
    assert!(photos.get(1).unwrap_err().to_string().contains("view 01.png"));
    assert!(Capture::load(&folder, &CaptureOptions::default()).unwrap_err().to_string().contains("view 01.png"));
    for bad in [Some(0), Some(usize::MAX)] {
        assert_eq!(Photos::new(&capture, options(bad)).is_err(), bad == Some(0));
    }
    // A lens that folds before its picture begins.
    let folded = Camera::new(CameraModel::SimpleRadial, 160, 120, &[130.0, 1e7, 60.0, 5.0]).unwrap();
    let mut capture = capture;
    capture.views[0].lens = folded;
    assert!(Photos::new(&capture, options(None)).unwrap_err().to_string().contains("view 00.png"));
}

#[test]
fn real_photos_are_straight() {
    let Some(scans) = crate::shared("scans") else { return };
    let capture = load(&scans.join("flowerpot"));
    let photos = Photos::new(&capture, options(None)).unwrap();
    let [mut moved, mut unmoved, mut n] = [0.0, 0.0, 0.0];
    for (i, view) in capture.views.iter().enumerate().step_by(11) {
        let photo = photos.get(i).unwrap();
        assert!(photo.camera.width.max(photo.camera.height) > 940, "{:?}", photo.camera);
        let original = image::open(&view.photo).unwrap().to_rgb8();
        let value = |x: f64, y: f64| photo.rgb.get(y as usize * photo.camera.width + x as usize);
        for keypoint in view.keypoints.iter().filter(|k| k.point.is_some()) {
            // What the lens saw along this ray lies where the pinhole sees it, and not where it would if nothing were bent.
            let ray = view.lens.unproject(&Point2::new(keypoint.x, keypoint.y)).unwrap();
            if (ray / ray.z).xy().norm() < 0.4 {
                continue;
            }
            let [x, y] = pixel(&photo.camera, &ray);
            let shift = view.lens.principal_point_px() - Vector2::new(photo.camera.cx, photo.camera.cy);
            let seen = original.get_pixel(keypoint.x as u32, keypoint.y as u32).0;
            let distance = |v: &[u8; 3]| v.iter().zip(seen).map(|(a, b)| f64::from(a.abs_diff(b))).sum::<f64>();
            if let (Some(a), Some(b)) = (value(x, y), value(keypoint.x - shift.x, keypoint.y - shift.y)) {
                moved += distance(a);
                unmoved += distance(b);
                n += 1.0;
            }
        }
    }
    assert!(n > 100.0 && moved < 0.5 * unmoved, "{} {} {n}", moved / n, unmoved / n);
}
