//! Masks of small ray-cast scenes against their exact silhouettes, and inputs that say little or nothing.

use drex_core::camera::CameraModel;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::*;

const SIZE: [u32; 2] = [240, 180];
const BOX_HALF: Vector3<f64> = Vector3::new(0.05, 0.035, 0.03);
const BALL: (Vector3<f64>, f64) = (Vector3::new(0.015, 0.0, 0.085), 0.03);

/// A box with a ball on it on a patterned table, a lamp that casts a shadow, and a wall far away.
struct Scene {
    /// Whether the object wears the table's colours.
    same_colours: bool,
}

/// What a ray meets: its place and whether it is the object's.
struct Hit {
    at: Vector3<f64>,
    normal: Vector3<f64>,
    object: bool,
}

fn noise(x: f64, y: f64, z: f64, salt: u32) -> f64 {
    let mut h = salt.wrapping_mul(0x9E37_79B9);
    for v in [x, y, z] {
        h = (h ^ v.floor() as i32 as u32).wrapping_mul(0x85EB_CA6B);
        h ^= h >> 13;
        h = h.wrapping_mul(0xC2B2_AE35);
        h ^= h >> 16;
    }
    f64::from(h) / f64::from(u32::MAX)
}

impl Scene {
    fn object(&self, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
        let mut best: Option<(f64, Vector3<f64>)> = None;
        let from = Point3::from(*o);
        let bounds = Bounds {
            lower: Point3::new(-BOX_HALF.x, -BOX_HALF.y, 0.0),
            upper: Point3::new(BOX_HALF.x, BOX_HALF.y, 0.06),
        };
        if let Some((t, _)) = bounds.span(&from, d).filter(|(t, _)| *t > 1e-6) {
            let p = o + d * t - Vector3::new(0.0, 0.0, BOX_HALF.z);
            let k = p.component_div(&BOX_HALF).iamax();
            let mut n = Vector3::zeros();
            n[k] = p[k].signum();
            best = Some((t, n));
        }
        let to = o - BALL.0;
        let (b, c) = (to.dot(d), to.norm_squared() - BALL.1 * BALL.1);
        let root = b * b - d.norm_squared() * c;
        if root > 0.0 {
            let t = (-b - root.sqrt()) / d.norm_squared();
            if t > 1e-6 && best.is_none_or(|(other, _)| t < other) {
                best = Some((t, (to + d * t).normalize()));
            }
        }
        best
    }

    fn hit(&self, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<Hit> {
        if let Some((t, normal)) = self.object(o, d) {
            return Some(Hit { at: o + d * t, normal, object: true });
        }
        let t = -o.z / d.z;
        (d.z < 0.0 && t > 0.0).then(|| Hit { at: o + d * t, normal: Vector3::z(), object: false })
    }

    fn colour(&self, o: &Vector3<f64>, d: &Vector3<f64>) -> [f64; 3] {
        let Some(hit) = self.hit(o, d) else {
            let v = 150.0 + 40.0 * noise(8.0 * d.x.atan2(d.y), 20.0 * d.z, 0.0, 3);
            return [v, v, 0.9 * v];
        };
        let lamp = Vector3::new(0.4, 0.3, 1.0).normalize();
        let lit = self.object(&(hit.at + 1e-6 * lamp), &lamp).is_none();
        let light = 0.35 + if lit { 0.65 * hit.normal.dot(&lamp).max(0.0) } else { 0.0 };
        let p = hit.at / 0.008;
        let (n, salt) = if hit.object { (noise(p.x, p.y, p.z + 0.5, 7), 1) } else { (noise(p.x, p.y, 0.0, 5), 0) };
        let (a, b) = match (salt, self.same_colours) {
            (1, false) => ([210.0, 190.0, 90.0], [230.0, 215.0, 150.0]),
            _ => ([60.0, 90.0, 180.0], [120.0, 150.0, 200.0]),
        };
        std::array::from_fn(|k| light * (a[k] * n + b[k] * (1.0 - n)))
    }
}

fn camera() -> Camera {
    Camera::new(CameraModel::SimpleRadial, SIZE[0], SIZE[1], &[210.0, 120.0, 90.0, -0.05]).unwrap()
}

/// Photos around, at two heights, all looking at the object.
fn views(count: usize) -> Vec<MaskView> {
    (0..count)
        .map(|k| {
            let angle = k as f64 * 2.399_963;
            let height = if k % 2 == 0 { 0.18 } else { 0.34 };
            let centre = Vector3::new(0.38 * angle.cos(), 0.38 * angle.sin(), height);
            let forward = (Vector3::new(0.0, 0.0, 0.05) - centre).normalize();
            let right = forward.cross(&Vector3::z()).normalize();
            let rotation =
                Matrix3::from_rows(&[right.transpose(), forward.cross(&right).transpose(), forward.transpose()]);
            let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
            MaskView {
                name: format!("photo {k}"),
                camera: camera(),
                camera_from_world: Pose::from_parts(Translation3::from(-(rotation * centre)), rotation),
            }
        })
        .collect()
}

fn centre_of(view: &MaskView) -> Vector3<f64> {
    view.camera_from_world.inverse().translation.vector
}

/// The photo, 2 x 2 rays a pixel, and the exact silhouette.
fn render(scene: &Scene, view: &MaskView) -> (Photo, Vec<bool>) {
    let o = centre_of(view);
    let ray = |x: f64, y: f64| {
        view.camera_from_world.rotation.inverse() * view.camera.unproject(&nalgebra::Point2::new(x, y)).unwrap()
    };
    let (mut rgb, mut silhouette) = (Vec::new(), Vec::new());
    for y in 0..SIZE[1] {
        for x in 0..SIZE[0] {
            let (x, y) = (f64::from(x), f64::from(y));
            let mut sum = [0.0; 3];
            for (dx, dy) in [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)] {
                let c = scene.colour(&o, &ray(x + dx, y + dy));
                (0..3).for_each(|k| sum[k] += 0.25 * c[k]);
            }
            rgb.extend(sum.map(|v| v.round().clamp(0.0, 255.0) as u8));
            silhouette.push(scene.object(&o, &ray(x + 0.5, y + 0.5)).is_some());
        }
    }
    (Photo { width_px: SIZE[0], height_px: SIZE[1], rgb }, silhouette)
}

/// Points where rays of some photos meet object and table, seen by the photos in which they are not hidden.
fn points(scene: &Scene, views: &[MaskView]) -> Vec<MaskPoint> {
    let mut points = Vec::new();
    for view in views {
        let o = centre_of(view);
        for k in 0..60u32 {
            let pixel = nalgebra::Point2::new(f64::from(k * 37 % SIZE[0]) + 0.5, f64::from(k * 23 % SIZE[1]) + 0.5);
            let d = view.camera_from_world.rotation.inverse() * view.camera.unproject(&pixel).unwrap();
            let Some(hit) = scene.hit(&o, &d) else { continue };
            let sees = |other: &MaskView| {
                let from = centre_of(other);
                scene.hit(&from, &(hit.at - from)).is_some_and(|h| (h.at - hit.at).norm() < 1e-6)
            };
            let photos = (0..views.len() as u32).filter(|k| sees(&views[*k as usize])).collect();
            points.push(MaskPoint { position: hit.at.into(), rgb: [0; 3], photos });
        }
    }
    points
}

fn region(tilt_deg: f64, lift: f64) -> MaskRegion {
    let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(tilt_deg.to_radians(), 0.0, 0.0));
    MaskRegion {
        world_from_region: Pose::from_parts(Translation3::new(0.0, 0.0, lift), tilt),
        lower: Point3::new(-0.057, -0.042, 0.0),
        upper: Point3::new(0.06, 0.04, 0.125),
    }
}

struct Case {
    views: Vec<MaskView>,
    points: Vec<MaskPoint>,
    photos: Vec<Photo>,
    silhouettes: Vec<Vec<bool>>,
}

fn case(scene: &Scene, count: usize) -> Case {
    let views = views(count);
    let points = points(scene, &views);
    let (photos, silhouettes) = views.par_iter().map(|v| render(scene, v)).collect::<Vec<_>>().into_iter().unzip();
    Case { views, points, photos, silhouettes }
}

impl Case {
    fn masks(&self, region: &MaskRegion) -> Vec<Mask> {
        let load = |k: usize| Ok(self.photos[k].clone());
        let input = MaskInput { views: &self.views, points: &self.points, region, load: &load };
        make_masks(&input, &MaskOptions::default(), &mut |_, _| {}).unwrap()
    }

    fn overlaps(&self, masks: &[Mask]) -> Vec<f64> {
        masks
            .iter()
            .zip(&self.silhouettes)
            .map(|(mask, truth)| {
                let pixels = mask.pixels();
                let both = pixels.iter().zip(truth).filter(|(m, t)| **m == 255 && **t).count() as f64;
                let either = pixels.iter().zip(truth).filter(|(m, t)| **m == 255 || **t).count() as f64;
                both / either
            })
            .collect()
    }
}

fn mean(all: &[f64]) -> f64 {
    all.iter().sum::<f64>() / all.len() as f64
}

#[test]
fn a_thing_on_a_table_is_cut_out_without_its_shadow() {
    let case = case(&Scene { same_colours: false }, 20);
    let overlaps = case.overlaps(&case.masks(&region(0.5, 0.001)));
    let worst = overlaps.iter().copied().fold(1.0, f64::min);
    assert!(mean(&overlaps) > 0.95 && worst > 0.9, "mean {:.3}, worst {worst:.3}: {overlaps:.3?}", mean(&overlaps));
}

#[test]
#[ignore = "not yet: 0.81 where 0.85 is asked; height alone does not tell the object from its table"]
fn a_thing_in_the_colours_of_its_table_is_told_by_its_height() {
    let case = case(&Scene { same_colours: true }, 20);
    let overlaps = case.overlaps(&case.masks(&region(0.3, -0.0005)));
    assert!(mean(&overlaps) > 0.85, "mean {:.3}: {overlaps:.3?}", mean(&overlaps));
}

#[test]
fn masks_do_not_depend_on_the_number_of_threads() {
    let case = case(&Scene { same_colours: false }, 8);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| case.masks(&region(0.0, 0.0)))
    };
    assert!(with(1) == with(3));
}

#[test]
fn little_or_odd_input_gives_masks_or_a_sentence() {
    let scene = Scene { same_colours: false };
    let full = case(&scene, 3);
    let region = region(0.0, 0.0);
    let run = |views: &[MaskView], points: &[MaskPoint], region: &MaskRegion| {
        let load = |k: usize| Ok(full.photos[k].clone());
        make_masks(&MaskInput { views, points, region, load: &load }, &MaskOptions::default(), &mut |_, _| {})
    };
    assert!(matches!(run(&[], &full.points, &region), Err(MaskError::NoPhotos)));
    assert_eq!(run(&full.views, &[], &region).unwrap().len(), 3);
    assert_eq!(run(&full.views[..1], &full.points, &region).unwrap().len(), 1);

    let mut odd = full.points.clone();
    odd[0].position.x = f64::NAN;
    odd[1].photos = vec![9999, u32::MAX];
    assert_eq!(run(&full.views, &odd, &region).unwrap().len(), 3);

    // The box behind all cameras, far away, and around a camera.
    let mut away = region.clone();
    away.world_from_region.translation.vector = centre_of(&full.views[0]) * 3.0;
    for mask in run(&full.views[..1], &full.points, &away).unwrap() {
        assert_eq!(mask.object_px(), 0);
        assert_eq!(mask.pixels(), vec![0; (SIZE[0] * SIZE[1]) as usize]);
        assert!(mask.doubt.unwrap().contains("not in the picture"));
    }
    let mut around = region.clone();
    (around.lower, around.upper) = (Point3::new(-1.0, -1.0, 0.0), Point3::new(1.0, 1.0, 1.0));
    assert_eq!(run(&full.views, &full.points, &around).unwrap().len(), 3);

    for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0] {
        let mut flat = region.clone();
        flat.upper.z = bad;
        let error = run(&full.views, &full.points, &flat).unwrap_err();
        assert!(error.to_string().contains("volume above the plane"), "{error}");
    }
    let small = |_: usize| Ok(Photo { width_px: 5, height_px: 4, rgb: vec![0; 60] });
    let missing = |_: usize| Err("no such file".to_string());
    let refused = |load: &(dyn Fn(usize) -> std::result::Result<Photo, String> + Sync)| {
        let input = MaskInput { views: &full.views[..1], points: &[], region: &region, load };
        make_masks(&input, &MaskOptions::default(), &mut |_, _| {}).unwrap_err().to_string()
    };
    assert!(refused(&small).contains("5 x 4"));
    assert!(refused(&missing).contains("photo 0 cannot be read: no such file"));
}
