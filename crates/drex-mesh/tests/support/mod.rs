//! What several tests share.
#![allow(dead_code)] // not every test uses all of it

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion};

/// The folder of shared data, if there is one.
pub fn shared() -> Option<PathBuf> {
    let found = std::env::var_os("DREX_SHARED").map(|d| PathBuf::from(d).join("data"));
    if found.is_none() {
        eprintln!("skipped: DREX_SHARED is not set");
    }
    found
}

pub fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// As much of COLMAP's binary model as the tests need.
pub struct ColmapModel {
    /// By name of the photo: camera and world_from_camera.
    pub photos: BTreeMap<String, (Camera, Pose)>,
    pub points: Vec<Point3<f64>>,
}

struct Bytes(Vec<u8>, usize);

impl Bytes {
    fn open(path: PathBuf) -> Self {
        Self(std::fs::read(path).unwrap(), 0)
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        self.1 += N;
        self.0[self.1 - N..self.1].try_into().unwrap()
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }
}

impl ColmapModel {
    pub fn read(folder: &Path) -> Self {
        let mut b = Bytes::open(folder.join("cameras.bin"));
        let cameras: BTreeMap<u32, Camera> = (0..b.u64())
            .map(|_| {
                let (id, model) = (b.u32(), CameraModel::from_id(b.u32() as i32).unwrap());
                let (w, h) = (b.u64() as u32, b.u64() as u32);
                let params: Vec<f64> = model.parameter_names().iter().map(|_| b.f64()).collect();
                (id, Camera::new(model, w, h, &params).unwrap())
            })
            .collect();
        let mut b = Bytes::open(folder.join("images.bin"));
        let photos = (0..b.u64())
            .map(|_| {
                b.u32();
                let q = [0; 4].map(|_| b.f64());
                let t = [0; 3].map(|_| b.f64());
                let camera = cameras[&b.u32()].clone();
                let name: Vec<u8> = std::iter::from_fn(|| Some(b.take::<1>()[0]).filter(|&c| c != 0)).collect();
                for _ in 0..b.u64() {
                    b.take::<24>();
                }
                let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
                let camera_from_world = Pose::from_parts(Translation3::from(t), rotation);
                (String::from_utf8(name).unwrap(), (camera, camera_from_world.inverse()))
            })
            .collect();
        let mut b = Bytes::open(folder.join("points3D.bin"));
        let points = (0..b.u64())
            .map(|_| {
                b.u64();
                let p = [0; 3].map(|_| b.f64());
                b.take::<11>();
                for _ in 0..b.u64() {
                    b.take::<8>();
                }
                Point3::from(p)
            })
            .collect();
        Self { photos, points }
    }

    pub fn cameras(&self) -> Vec<Point3<f64>> {
        self.photos.values().map(|(_, pose)| pose.translation.vector.into()).collect()
    }
}
