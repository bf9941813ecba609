//! What several tests share.
#![allow(dead_code, clippy::unwrap_used)] // not every test uses all of it; a failed unwrap is a failed test

pub mod rooms;
pub mod shapes;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use drex_core::camera::{Camera, CameraModel};
use drex_core::{Pose, TriMesh};
use drex_mesh::Part;
use drex_mesh::{JointConfig, JointKind, Scene, ScenePoint, SceneView};
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

/// Axis-aligned box between two corners.
pub fn cuboid(lo: [f64; 3], hi: [f64; 3]) -> TriMesh {
    let vertices = (0..8)
        .map(|i| Point3::new([lo[0], hi[0]][i & 1], [lo[1], hi[1]][i >> 1 & 1], [lo[2], hi[2]][i >> 2]))
        .collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    TriMesh { vertices, faces: quads.iter().flat_map(|&[a, b, c, d]: &[u32; 4]| [[a, b, c], [a, c, d]]).collect() }
}

/// The parts as one mesh, vertices not shared.
pub fn joined(parts: &[TriMesh]) -> TriMesh {
    let mut out = TriMesh::default();
    for part in parts {
        let base = out.vertices.len() as u32;
        out.vertices.extend(&part.vertices);
        out.faces.extend(part.faces.iter().map(|f| f.map(|v| v + base)));
    }
    out
}

pub fn hinge(name: &str, parent: &str, child: &str) -> JointConfig {
    JointConfig {
        name: name.into(),
        kind: JointKind::Hinge,
        parent: parent.into(),
        child: child.into(),
        axis: [0.0, -2.0, 0.0],
        origin: [-0.05, 0.0, 0.022],
        range: Some([0.0, 1.2]),
        damping: 0.001,
        friction_loss: 0.2,
        stiffness: 0.0,
    }
}

/// A stapler of boxes: base, arm on a hinge, tray that slides in the arm, foot fixed to the base. Metres.
pub fn stapler() -> (Vec<Part>, Vec<JointConfig>) {
    let part = |name: &str, lo, hi, mass_kg| Part { name: name.into(), mesh: cuboid(lo, hi), mass_kg };
    let parts = vec![
        part("base", [-0.06, -0.015, 0.0], [0.06, 0.015, 0.02], None),
        part("arm", [-0.05, -0.01, 0.03], [0.06, 0.01, 0.045], None),
        part("tray", [0.0, -0.005, 0.022], [0.05, 0.005, 0.027], None),
        part("foot", [-0.06, -0.02, -0.005], [-0.04, 0.02, 0.0], Some(0.02)),
    ];
    let rail = JointConfig {
        kind: JointKind::Slide,
        axis: [1.0, 0.0, 0.0],
        origin: [0.0, 0.0, 0.0245],
        range: Some([0.0, 0.03]),
        friction_loss: 1.0,
        ..hinge("rail", "arm", "tray")
    };
    let weld = JointConfig { kind: JointKind::Fixed, range: None, ..hinge("weld", "base", "foot") };
    (parts, vec![rail, hinge("hinge", "base", "arm"), weld])
}

/// As much of COLMAP's binary model as the tests need.
pub struct ColmapModel {
    /// By name of the photo: camera and world_from_camera.
    pub photos: BTreeMap<String, (Camera, Pose)>,
    pub points: Vec<Point3<f64>>,
    /// Of each point: which photos see it, by their place in the order of names.
    pub tracks: Vec<Vec<usize>>,
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
        let mut ids: BTreeMap<u32, String> = BTreeMap::new();
        let photos: BTreeMap<String, (Camera, Pose)> = (0..b.u64())
            .map(|_| {
                let id = b.u32();
                let q = [0; 4].map(|_| b.f64());
                let t = [0; 3].map(|_| b.f64());
                let camera = cameras[&b.u32()].clone();
                let name: Vec<u8> = std::iter::from_fn(|| Some(b.take::<1>()[0]).filter(|&c| c != 0)).collect();
                for _ in 0..b.u64() {
                    b.take::<24>();
                }
                let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[0], q[1], q[2], q[3]));
                let camera_from_world = Pose::from_parts(Translation3::from(t), rotation);
                let name = String::from_utf8(name).unwrap();
                ids.insert(id, name.clone());
                (name, (camera, camera_from_world.inverse()))
            })
            .collect();
        let mut b = Bytes::open(folder.join("points3D.bin"));
        let places: BTreeMap<&str, usize> = photos.keys().enumerate().map(|(i, name)| (name.as_str(), i)).collect();
        let (points, tracks) = (0..b.u64())
            .map(|_| {
                b.u64();
                let p = [0; 3].map(|_| b.f64());
                b.take::<11>();
                let seen = |b: &mut Bytes| places[ids[&b.u32()].as_str()];
                let mut track: Vec<usize> = (0..b.u64()).map(|_| (seen(&mut b), b.u32()).0).collect();
                track.sort_unstable();
                track.dedup();
                (Point3::from(p), track)
            })
            .unzip();
        Self { photos, points, tracks }
    }

    /// What was photographed from where, without masks.
    pub fn scene(&self) -> Scene {
        let point = |(p, track): (&Point3<f64>, &Vec<usize>)| ScenePoint {
            position: *p,
            views: track.clone(),
            object_share: None,
        };
        let view = |(lens, pose): &(Camera, Pose)| SceneView { lens: lens.clone(), world_from_camera: *pose };
        let points = self.points.iter().zip(&self.tracks).map(point).collect();
        Scene::new(points, self.photos.values().map(view).collect()).unwrap()
    }

    pub fn cameras(&self) -> Vec<Point3<f64>> {
        self.photos.values().map(|(_, pose)| pose.translation.vector.into()).collect()
    }
}

/// A PNG file of two by two pixels: red, green, blue, yellow.
pub const PNG: &[u8] = b"\x89PNG\x0d\x0a\x1a\x0a\x00\x00\x00\x0dIHDR\x00\x00\x00\x02\x00\x00\x00\x02\x08\x02\x00\x00\x00\xfd\xd4\x9as\x00\x00\x00\x15IDATx\xdac8!''wB\x8e\x01H\xdc\xb9c\x03\x00\x1e\xfe\x05\x01\xb8_\x86\x8c\x00\x00\x00\x00IEND\xaeB`\x82";
