//! The rendered captures are what their truth says: where things are in the picture, on one thread as on two.

use std::collections::HashSet;
use std::sync::Arc;

use crate::capture::kinds::{Kind, Size, plan};
use crate::capture::paint::{Canvas, Picture};
use crate::capture::path::look_at;
use crate::capture::render::{Lens, Photo, Sensor, Shot, take};
use crate::capture::scene::{Lamp, Paint, Role, Room, Scene, Shape, Solid};
use crate::capture::write;
use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use image::RgbImage;
use nalgebra::{Point2, Point3, UnitQuaternion, Vector2, Vector3};

const SMALL: Size = Size { photos: 4, width_px: 160, height_px: 120 };

/// Radius of the spots: 7 to 9 pixels in these tests, so that four rays a pixel place them well.
const SPOT_M: f64 = 0.011;

fn grey(reflectance: f32) -> Arc<Picture> {
    Arc::new(Canvas::new([1.0, 1.0], 0.25, [reflectance; 3]).finish())
}

/// White flat discs, face up, that light reaches evenly, before black walls.
fn spots(at: &[Point3<f64>], radius_m: f64) -> Scene {
    let black = Paint { specular: 0.0, ..Paint::dull(grey(0.0)) };
    let white = Paint { specular: 0.0, ..Paint::dull(grey(0.8)) };
    let solids = at
        .iter()
        .map(|p| Solid {
            shape: Shape::Cylinder,
            half_m: Vector3::new(radius_m, radius_m, 2e-5),
            world_from_part: Pose::translation(p.x, p.y, p.z),
            role: Role::Object,
            paint: white.clone(),
        })
        .collect();
    let room = Room {
        low_m: Vector3::new(-2.0, -2.0, -1.0),
        high_m: Vector3::new(2.0, 2.0, 2.0),
        paints: std::array::from_fn(|_| black.clone()),
    };
    let lamp = Lamp { centre_m: Point3::new(0.0, 0.0, 1.5), radius_m: 0.1, strength: 0.0, ambient: 1.0 };
    Scene { solids, room, lamp }
}

fn still(pose: Pose) -> Shot {
    Shot { name: String::from("a.jpg"), shutter: vec![pose], camera_from_object: pose, turn_rad: 0.0, gain: 1.0 }
}

fn noiseless() -> Sensor {
    Sensor { vignetting: 0.0, blur_px: 0.5, full_well: 1e12, read_noise: 0.0, jpeg_quality: 80 }
}

/// Centre of light within `reach` pixels of `near`; the first pixel's centre is (0.5, 0.5).
fn centroid(rgb: &RgbImage, near: Point2<f64>, reach: f64) -> Point2<f64> {
    let (mut sum, mut weight) = (Vector2::zeros(), 0.0);
    for (x, y, pixel) in rgb.enumerate_pixels() {
        let at = Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        if (at - near).norm() < reach {
            let light = (f64::from(pixel[1]) / 255.0).powf(2.2);
            sum += light * at.coords;
            weight += light;
        }
    }
    assert!(weight > 5.0, "no spot near {near}");
    Point2::from(sum / weight)
}

/// Centre of the area that a disc, face up, covers in the picture: near the projection of its own centre, but not there.
fn centre_of_disc(camera: &Camera, pose: &Pose, centre: &Point3<f64>, radius_m: f64) -> Point2<f64> {
    let rim: Vec<Point2<f64>> = (0..360)
        .map(|i| {
            let (s, c) = f64::from(i).to_radians().sin_cos();
            camera.project(&(pose * (centre + Vector3::new(c, s, 0.0) * radius_m))).unwrap()
        })
        .collect();
    let (mut sum, mut area) = (Vector2::zeros(), 0.0);
    for (i, a) in rim.iter().enumerate() {
        let (a, b) = (a - rim[0], rim[(i + 1) % rim.len()] - rim[0]);
        area += a.perp(&b);
        sum += a.perp(&b) * (a + b) / 3.0;
    }
    rim[0] + sum / area
}

fn bent_camera() -> Camera {
    let parameters = [300.0, 300.0, 163.0, 118.0, -0.12, 0.04, 0.0015, -0.001];
    Camera::new(CameraModel::OpenCv, 320, 240, &parameters).unwrap()
}

#[test]
fn a_bright_spot_is_where_the_truth_projects_it() {
    let places: Vec<Point3<f64>> = (0..9)
        .map(|i| {
            Point3::new(0.07 * f64::from(i % 3 - 1) + 0.003, 0.06 * f64::from(i / 3 - 1), 0.008 * f64::from(i % 4))
        })
        .collect();
    let scene = spots(&places, SPOT_M);
    let lens = Lens::new(bent_camera()).unwrap();
    let pose = look_at(&Point3::new(0.25, -0.2, 0.3), &Point3::new(0.01, 0.0, 0.02), 0.2);
    let photo = take(&scene, &lens, &noiseless(), &still(pose), 5);
    let (mut seen, mut offset) = (0, Vector2::zeros());
    for place in &places {
        let truth = centre_of_disc(&lens.camera, &pose, place, SPOT_M);
        if !(14.0..306.0).contains(&truth.x) || !(14.0..226.0).contains(&truth.y) {
            continue;
        }
        seen += 1;
        let error = centroid(&photo.rgb, truth, 14.0) - truth;
        assert!(error.norm() < 0.05, "spot at {truth}: centre of light {error} off");
        offset += error;
        let (x, y) = (truth.x as u32, truth.y as u32);
        assert_eq!(photo.mask.get_pixel(x, y)[0], 255, "the silhouette has a hole at {truth}");
    }
    assert!(seen >= 6, "only {seen} of 9 spots in the picture");
    // A convention that is wrong by half a pixel would move all spots the same way.
    assert!((offset / f64::from(seen)).norm() < 0.02, "all spots {} off", offset / f64::from(seen));
}

#[test]
fn a_turned_disc_is_a_camera_that_went_the_other_way() {
    let place = Point3::new(0.06, -0.03, 0.02);
    let scene = spots(&[place, Point3::new(-0.06, 0.05, 0.04)], SPOT_M);
    let lens = Lens::new(bent_camera()).unwrap();
    let pose = look_at(&Point3::new(0.3, 0.05, 0.2), &Point3::origin(), 0.0);
    for turn_rad in [0.4, 2.0, -1.1] {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad);
        let shot = Shot { turn_rad, camera_from_object: pose * turn, ..still(pose) };
        let photo = take(&scene, &lens, &noiseless(), &shot, 5);
        let truth = centre_of_disc(&lens.camera, &shot.camera_from_object, &place, SPOT_M);
        let error = (centroid(&photo.rgb, truth, 14.0) - truth).norm();
        assert!(error < 0.05, "turned by {turn_rad}: {error} px off");
    }
}

#[test]
fn motion_blur_is_centred_on_the_true_pose() {
    let place = Point3::new(0.01, 0.0, 0.02);
    let scene = spots(&[place], 0.005);
    let lens = Lens::new(bent_camera()).unwrap();
    let pose = look_at(&Point3::new(0.3, 0.05, 0.2), &Point3::origin(), 0.0);
    let turned = |k: f64| UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.003 * k) * pose;
    let shot = Shot { shutter: (0..16).map(|k| turned(f64::from(k) - 7.5)).collect(), ..still(pose) };
    let photo = take(&scene, &lens, &noiseless(), &shot, 5);
    let truth = lens.camera.project(&(pose * place)).unwrap();
    let error = (centroid(&photo.rgb, truth, 20.0) - truth).norm();
    assert!(error < 0.1, "{error} px off");
}

fn bytes(photo: &Photo) -> Vec<u8> {
    [photo.rgb.as_raw().as_slice(), photo.mask.as_raw().as_slice()].concat()
}

#[test]
fn same_bytes_on_one_thread_and_on_two() {
    let photos = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let capture = plan(Kind::Turntable, 3, &SMALL).unwrap();
            (0..2).flat_map(|i| bytes(&capture.take(i))).collect::<Vec<u8>>()
        })
    };
    assert!(photos(1) == photos(2));
}

#[test]
fn every_kind_shows_its_object_and_other_seeds_show_others() {
    for (name, kind) in Kind::ALL {
        let first = plan(kind, 1, &SMALL).unwrap();
        let photo = first.take(0);
        let share = photo.mask.pixels().filter(|p| p[0] == 255).count() as f64 / f64::from(160 * 120);
        // Where the camera turns on its spot the object may be out of view.
        assert!(kind == Kind::Spin || (0.01..0.7).contains(&share), "{name}: the object covers {share} of the photo");
        let colours: HashSet<[u8; 3]> = photo.rgb.pixels().map(|p| p.0).collect();
        assert!(colours.len() > 500, "{name}: {} colours", colours.len());
        let other = plan(kind, 2, &SMALL).unwrap();
        assert_ne!(bytes(&photo), bytes(&other.take(0)), "{name}: two seeds, one photo");
        let names: HashSet<&str> = first.shots.iter().map(|(_, s)| s.name.as_str()).collect();
        assert_eq!(names.len(), SMALL.photos, "{name}");
        for (_, shot) in &first.shots {
            let eye = shot.shutter[0].inverse().translation;
            assert!(eye.z > 0.0, "{name}: {} is taken from below the table", shot.name);
        }
    }
}

#[test]
fn exif_stands_behind_the_start_of_the_jpeg() {
    let exif = write::Exif {
        make: String::from("Lumenworks"),
        model: String::from("Field 3"),
        focal_35mm: 27,
        focal_tenths_mm: 43,
    };
    let rgb = RgbImage::from_pixel(32, 24, image::Rgb([90, 120, 30]));
    let file = write::jpeg(&rgb, 80, Some(&exif)).unwrap();
    let back = image::load_from_memory(&file).unwrap().to_rgb8();
    assert_eq!((back.width(), back.height()), (32, 24));
    let segment = exif.segment();
    assert_eq!(&file[2..2 + segment.len()], &segment[..]);
    assert_eq!(usize::from(u16::from_be_bytes([segment[2], segment[3]])), segment.len() - 2);
    // The focal length's entry, by its tag.
    let at = segment.windows(2).position(|w| w == [0xa4, 0x05]).unwrap();
    assert_eq!(u16::from_be_bytes([segment[at + 8], segment[at + 9]]), 27);
}

#[test]
fn truth_is_written_in_the_layout_of_colmap() {
    let capture = plan(Kind::Two, 4, &SMALL).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let shots: Vec<&Shot> = capture.shots.iter().filter(|(s, _)| *s == 1).map(|(_, shot)| shot).collect();
    assert_eq!(shots.len(), 2);
    write::truth(folder.path(), &capture.lens.camera, &shots).unwrap();
    let cameras = std::fs::read_to_string(folder.path().join("cameras.txt")).unwrap();
    let words: Vec<&str> = cameras.lines().nth(1).unwrap().split(' ').collect();
    assert_eq!(words[..4], ["1", "OPENCV", "160", "120"]);
    assert_eq!(words.len(), 12);
    let images = std::fs::read_to_string(folder.path().join("images.txt")).unwrap();
    let lines: Vec<&str> = images.lines().skip(1).collect();
    for (i, shot) in shots.iter().enumerate() {
        let words: Vec<&str> = lines[2 * i].split(' ').collect();
        let number = |k: usize| words[k].parse::<f64>().unwrap();
        let pose = drex_core::pose::pose_from_wxyz(
            [number(5), number(6), number(7)],
            [number(1), number(2), number(3), number(4)],
        )
        .unwrap();
        assert!(drex_core::pose::pose_difference(&pose, &shot.camera_from_object).norm() < 1e-8);
        assert_eq!(words[9], shot.name);
        assert_eq!(lines[2 * i + 1], "");
    }
}
