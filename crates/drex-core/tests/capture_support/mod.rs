//! Synthetic captures on disk: cameras on a ring, points that they see, photos, models in COLMAP's layouts.
#![allow(dead_code, clippy::unwrap_used, clippy::missing_panics_doc, missing_docs, unreachable_pub)] // shared by several test files

use std::fmt::Write;
use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

/// An image of a model, with COLMAP's ids.
#[derive(Debug, Clone)]
pub struct Image {
    pub id: u32,
    pub name: String,
    pub camera: u32,
    pub camera_from_world: Pose,
    pub keypoints: Vec<(f64, f64, i64)>,
}

/// A point of a model.
#[derive(Debug, Clone)]
pub struct Point {
    pub id: u64,
    pub position: [f64; 3],
    pub rgb: [u8; 3],
    pub error: f64,
    pub track: Vec<(u32, u32)>,
}

/// A COLMAP model.
#[derive(Debug, Clone)]
pub struct Model {
    pub cameras: Vec<(u32, Camera)>,
    pub images: Vec<Image>,
    pub points: Vec<Point>,
}

/// A lens of a model for images of 160 x 120 pixels, bent as real ones are, with the axis off the centre.
pub fn lens(model: CameraModel) -> Camera {
    let bent: &[f64] = match model {
        CameraModel::SimplePinhole | CameraModel::Pinhole => &[],
        CameraModel::SimpleRadial => &[-0.12],
        CameraModel::Radial => &[0.1, -0.05],
        CameraModel::OpenCv => &[-0.2, 0.05, 0.002, -0.003],
        CameraModel::OpenCvFisheye => &[-0.03, 0.01, -0.002, 0.001],
        CameraModel::FullOpenCv => &[-0.2, 0.06, 0.001, 0.002, -0.01, 0.02, 0.01, 0.0],
        CameraModel::Fov => &[0.9],
        CameraModel::SimpleRadialFisheye => &[-0.04],
        CameraModel::RadialFisheye => &[-0.04, 0.01],
        CameraModel::ThinPrismFisheye => &[-0.03, 0.01, 0.001, -0.001, 0.001, 0.0, 0.002, -0.001],
        other => panic!("no lens for {other}"),
    };
    let two = model.parameter_names()[1] == "fy";
    let mut params = if two { vec![130.0, 128.0, 77.0, 64.0] } else { vec![130.0, 77.0, 64.0] };
    params.extend(bent);
    Camera::new(model, 160, 120, &params).unwrap()
}

/// A camera on a ring of radius 4 that looks at the origin, z up.
pub fn pose(turn: f64) -> Pose {
    let centre = Point3::new(4.0 * turn.cos(), 4.0 * turn.sin(), 1.0);
    // Isometry3::look_at_rh looks along -z with y up; turned by half a turn round x it has OpenCV's axes.
    let opengl = Isometry3::look_at_rh(&centre, &Point3::origin(), &Vector3::z());
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI) * opengl
}

/// Deterministic numbers in -1 to 1.
pub fn noise(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// `views` cameras round `points` points in a ball of radius 0.8, all seen by all where they fall into the image; ids have
/// gaps.
pub fn ring(lens: &Camera, views: usize, points: usize) -> Model {
    let mut seed = 7;
    let mut position = || loop {
        let p = [noise(&mut seed), noise(&mut seed), noise(&mut seed)].map(|v| 0.8 * v);
        if Vector3::from(p).norm() < 0.8 {
            return p;
        }
    };
    let point = |i: usize| Point {
        id: 3 * i as u64 + 5,
        position: position(),
        rgb: [i as u8, 100, 200],
        error: 0.25,
        track: Vec::new(),
    };
    let mut points: Vec<_> = (0..points).map(point).collect();
    let images = (0..views).map(|i| {
        let id = 4 * i as u32 + 9;
        let camera_from_world = pose(i as f64 / views as f64 * std::f64::consts::TAU);
        // A keypoint that saw no point comes first.
        let mut keypoints = vec![(1.5, 2.5, -1)];
        for point in &mut points {
            let pixel = lens.project(&(camera_from_world * Point3::from(point.position))).unwrap();
            if lens.contains(&pixel) {
                point.track.push((id, keypoints.len() as u32));
                keypoints.push((pixel.x, pixel.y, point.id as i64));
            }
        }
        Image { id, name: format!("view {i:02}.png"), camera: 2, camera_from_world, keypoints }
    });
    Model { images: images.collect(), cameras: vec![(2, lens.clone())], points }
}

impl Model {
    pub fn write_bin(&self, folder: &Path) {
        std::fs::create_dir_all(folder).unwrap();
        let mut out = Bytes::default();
        out.u64(self.cameras.len() as u64);
        for (id, camera) in &self.cameras {
            out.u32(*id).u32(camera.model() as u32);
            out.u64(u64::from(camera.width_px())).u64(u64::from(camera.height_px()));
            out.numbers(camera.params());
        }
        out.write(&folder.join("cameras.bin"));
        out.u64(self.images.len() as u64);
        for image in &self.images {
            out.u32(image.id);
            out.numbers(&wxyz_xyz(&image.camera_from_world));
            out.u32(image.camera);
            out.0.extend(image.name.as_bytes());
            out.0.push(0);
            out.u64(image.keypoints.len() as u64);
            for (x, y, id) in &image.keypoints {
                out.numbers(&[*x, *y]).u64(*id as u64);
            }
        }
        out.write(&folder.join("images.bin"));
        out.u64(self.points.len() as u64);
        for point in &self.points {
            out.u64(point.id);
            out.numbers(&point.position);
            out.0.extend(point.rgb);
            out.numbers(&[point.error]).u64(point.track.len() as u64);
            for (image, k) in &point.track {
                out.u32(*image).u32(*k);
            }
        }
        out.write(&folder.join("points3D.bin"));
        // Newer versions write these too; what is in them does not matter here.
        std::fs::write(folder.join("rigs.bin"), b"rigs").unwrap();
        std::fs::write(folder.join("frames.bin"), b"frames").unwrap();
    }

    pub fn write_txt(&self, folder: &Path) {
        std::fs::create_dir_all(folder).unwrap();
        let join = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
        let mut text = "# Camera list with one line of data per camera:\n".to_owned();
        for (id, c) in &self.cameras {
            writeln!(text, "{id} {} {} {} {}", c.model(), c.width_px(), c.height_px(), join(c.params())).unwrap();
        }
        std::fs::write(folder.join("cameras.txt"), text).unwrap();
        let mut text = "# Image list with two lines of data per image:\n".to_owned();
        for image in &self.images {
            let pose = join(&wxyz_xyz(&image.camera_from_world));
            writeln!(text, "{} {pose} {} {}", image.id, image.camera, image.name).unwrap();
            let keypoints = image.keypoints.iter().map(|(x, y, id)| format!("{x} {y} {id}"));
            writeln!(text, "{}", keypoints.collect::<Vec<_>>().join(" ")).unwrap();
        }
        std::fs::write(folder.join("images.txt"), text).unwrap();
        let mut text = "# 3D point list\n".to_owned();
        for p in &self.points {
            let track = p.track.iter().map(|(i, k)| format!(" {i} {k}")).collect::<String>();
            let [r, g, b] = p.rgb;
            writeln!(text, "{} {} {r} {g} {b} {}{track}", p.id, join(&p.position), p.error).unwrap();
        }
        std::fs::write(folder.join("points3D.txt"), text).unwrap();
    }

    /// A flat grey photo of each camera's size for each image.
    pub fn write_photos(&self, images: &Path) {
        for image in &self.images {
            let (_, camera) = self.cameras.iter().find(|(id, _)| *id == image.camera).unwrap();
            grey(&images.join(&image.name), camera.width_px(), camera.height_px());
        }
    }
}

/// A grey picture.
pub fn grey(path: &Path, width: u32, height: u32) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::RgbImage::from_pixel(width, height, image::Rgb([90, 120, 150])).save(path).unwrap();
}

/// A capture of `model` in a new folder: binary model and photos.
pub fn on_disk(model: &Model) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_path_buf();
    model.write_bin(&path.join("sparse/0"));
    model.write_photos(&path.join("images"));
    (folder, path)
}

fn wxyz_xyz(pose: &Pose) -> [f64; 7] {
    let (t, [w, x, y, z]) = drex_core::pose::to_wxyz(pose);
    [w, x, y, z, t[0], t[1], t[2]]
}

/// Little-endian bytes.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    fn u32(&mut self, v: u32) -> &mut Self {
        self.0.extend(v.to_le_bytes());
        self
    }

    fn u64(&mut self, v: u64) -> &mut Self {
        self.0.extend(v.to_le_bytes());
        self
    }

    fn numbers(&mut self, values: &[f64]) -> &mut Self {
        self.0.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        self
    }

    fn write(&mut self, path: &Path) {
        std::fs::write(path, std::mem::take(&mut self.0)).unwrap();
    }
}
