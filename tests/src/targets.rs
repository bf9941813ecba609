//! Every reader of foreign bytes as a function of bytes. None may panic, hang, or take memory out of all proportion.
#![allow(clippy::unwrap_used)] // where the scratch folder cannot be written, nothing can be tested

use std::hint::black_box;
use std::path::{Path, PathBuf};

use drex_core::capture::{Capture, CaptureOptions};
use drex_core::{fsutil, mesh, npy, pose};
use drex_demo::{Demonstration, LoadOptions, ManoModel};
use drex_hw::allegro::{self, AllegroVersion};
use drex_hw::{can, dynamixel};
use drex_recording::PushConfig;
use drex_recording::clock::Clock;
use drex_recording::readers::{self, BopSelection};
use drex_retarget::TargetHand;
use drex_robot::Robot;
use drex_splat::Kind;
use nalgebra::Point3;

use crate::{bytes, seeds};

/// A reader that is fed.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name, that of its seeds and of its program for libFuzzer.
    pub name: &'static str,
    /// The reader.
    pub run: fn(&[u8]),
    /// Inputs that it takes.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

const fn target(name: &'static str, run: fn(&[u8]), seeds: fn() -> Vec<Vec<u8>>) -> Target {
    Target { name, run, seeds }
}

/// All of them.
pub const TARGETS: &[Target] = &[
    target("stl", |b| drop(black_box(mesh::parse_stl(Path::new("a.stl"), b))), seeds::stl),
    target("obj", |b| drop(black_box(mesh::parse_obj(Path::new("a.obj"), b))), seeds::obj),
    target("obj_model", |b| drop(black_box(drex_mesh::read_model(&file("a.obj", b)))), seeds::obj),
    target("ply", |b| drop(black_box(drex_mesh::parse_mesh(Path::new("a.ply"), b))), seeds::ply),
    target("gltf", |b| drop(black_box(drex_mesh::parse_mesh(Path::new("a.gltf"), b))), seeds::gltf),
    target("glb", |b| drop(black_box(drex_mesh::parse_mesh(Path::new("a.glb"), b))), seeds::glb),
    target("marks", |b| drop(black_box(drex_mesh::read_marks(&file("marks.json", b)))), seeds::marks),
    target("asset_xml", asset_xml, seeds::mjcf),
    target("npy", npy_arrays, seeds::npy_arrays),
    target("csv", csv, seeds::csv),
    target("pose_log", pose_log, seeds::pose_log),
    target("grasps_json", |b| drop(black_box(readers::parse_grasp_file(Path::new("g.json"), b))), seeds::grasps_json),
    target("push_toml", |b| drop(black_box(PushConfig::read(&file("push.toml", b)))), seeds::push_toml),
    #[cfg(feature = "twin")]
    target("twin_toml", twin_toml, seeds::twin_toml),
    target("urdf", |b| drop(black_box(Robot::from_urdf(&file("a.urdf", b)))), seeds::urdf),
    target("mjcf", |b| drop(black_box(Robot::from_mjcf_str(&String::from_utf8_lossy(b), None))), seeds::mjcf),
    target(
        "gaussians_ply",
        |b| drop(black_box(drex_splat::io::ply::parse(Path::new("a.ply"), b, Kind::Surfel))),
        seeds::gaussians_ply,
    ),
    target("spz", |b| drop(black_box(drex_splat::io::spz::parse(Path::new("a.spz"), b, Kind::Surfel))), seeds::spz),
    target(
        "spz_body",
        |b| drop(black_box(drex_splat::io::spz::parse(Path::new("a.spz"), &bytes::gzip(b), Kind::Surfel))),
        seeds::spz_body,
    ),
    target(
        "splat",
        |b| drop(black_box(drex_splat::io::splat::parse(Path::new("a.splat"), b, Kind::Surfel))),
        seeds::splat,
    ),
    target("colmap_cameras", |b| colmap("cameras.bin", b), || vec![seeds::colmap().cameras]),
    target("colmap_images", |b| colmap("images.bin", b), || vec![seeds::colmap().images]),
    target("colmap_points", |b| colmap("points3D.bin", b), || vec![seeds::colmap().points]),
    target("colmap_text", colmap_text, seeds::colmap_text),
    target("transforms_json", transforms_json, seeds::transforms_json),
    target("png", png, seeds::png),
    target("demo_json", |b| demo("d.json", b), seeds::demo_json),
    target("demo_csv", |b| demo("d.csv", b), seeds::demo_csv),
    target("demo_npy", |b| demo("d.npy", b), seeds::demo_npy),
    target("demo_npz", |b| demo("d.npz", b), seeds::demo_npz),
    target(
        "hamer_npz",
        |b| demo("d.npz", &bytes::npz(&[("pred_keypoints_3d", b), ("is_right", &bytes::npy_numbers("(1,)", &[1.0]))])),
        seeds::demo_npy,
    ),
    target("mano_npz", |b| drop(black_box(ManoModel::parse_npz(Path::new("m.npz"), b))), seeds::mano_npz),
    target("points", points, seeds::points),
    target("hand_mapping", hand_mapping, seeds::hand_mapping),
    target(
        "torque_law",
        |b| drop(black_box(serde_json::from_slice::<drex_hw::torque_current::TorqueCurrentModel>(b))),
        seeds::torque_law,
    ),
    target(
        "mass_prior",
        |b| drop(black_box(drex_sysid::MassPrior::from_json(&String::from_utf8_lossy(b), Some(1e-3)))),
        seeds::mass_prior,
    ),
    target("slcan", slcan, seeds::slcan),
    target("allegro_frames", allegro_frames, seeds::allegro_frames),
    target("dynamixel", dynamixel_stream, seeds::dynamixel),
    target("dynamixel_packet", dynamixel_packet, seeds::dynamixel),
];

/// The target called `name`.
pub fn find(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|t| t.name == name)
}

std::thread_local! {
    /// A folder for readers that want files, in memory where that can be had.
    static SCRATCH: tempfile::TempDir = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
}

fn scratch() -> PathBuf {
    SCRATCH.with(|s| s.path().to_path_buf())
}

/// `data` as a file in the scratch folder.
fn file(name: &str, data: &[u8]) -> PathBuf {
    let path = scratch().join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, data).unwrap();
    path
}

fn asset_xml(data: &[u8]) {
    let path = file("asset/object.xml", data);
    let _ = black_box(drex_mesh::check_asset(&path, &drex_mesh::CheckOptions::default()));
}

fn npy_arrays(data: &[u8]) {
    let path = Path::new("a.npy");
    let _ = black_box(npy::parse_npy(path, data));
    let _ = black_box(readers::parse_grasps_npy(path, data, &["a".into(), "b".into(), "c".into()]));
}

fn csv(data: &[u8]) {
    let path = Path::new("a.csv");
    let _ = black_box(readers::parse_pose_csv(path, data));
    let _ = black_box(readers::parse_force_csv(path, data, Point3::origin()));
    let _ = black_box(readers::parse_action_csv(path, data));
    let _ = black_box(readers::parse_proprio_csv(path, data));
    let _ = black_box(readers::parse_joint_log_csv(path, data, None));
    let selection = BopSelection { fps: 30.0, scene_id: None, obj_id: None };
    let _ = black_box(readers::parse_bop_csv(path, data, &selection));
}

fn pose_log(data: &[u8]) {
    let path = Path::new("poses.txt");
    let _ = black_box(readers::parse_foundation_pose_log(path, data, &Clock::LocalIso { utc_offset_minutes: -420 }));
    let _ = black_box(pose::parse_pose_matrix(path, 1, &String::from_utf8_lossy(data)));
}

#[cfg(feature = "twin")]
fn twin_toml(data: &[u8]) {
    let _ = black_box(drex_twin::manifest::TwinManifest::parse(Path::new("twin.toml"), &String::from_utf8_lossy(data)));
}

/// A capture of three photos in which one file of the model is `data`.
fn colmap(name: &str, data: &[u8]) {
    let folder = scratch().join("colmap");
    let model = seeds::colmap();
    for (file_name, own) in
        [("cameras.bin", &model.cameras), ("images.bin", &model.images), ("points3D.bin", &model.points)]
    {
        file(&format!("colmap/sparse/0/{file_name}"), if file_name == name { data } else { own });
    }
    photos("colmap");
    let _ = black_box(Capture::load(&folder, &CaptureOptions::default()));
}

/// Cameras, images and points as text, divided by lines of `%`.
fn colmap_text(data: &[u8]) {
    let mut parts = data.split(|&b| b == b'%');
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        file(&format!("colmap_text/sparse/0/{name}"), parts.next().unwrap_or_default());
    }
    photos("colmap_text");
    let _ = black_box(Capture::load(&scratch().join("colmap_text"), &CaptureOptions::default()));
}

fn photos(folder: &str) {
    for name in ["0.png", "1.png", "2.png"] {
        let path = format!("{folder}/images/{name}");
        if !scratch().join(&path).is_file() {
            file(&path, &seeds::picture(32, 24));
        }
    }
}

fn transforms_json(data: &[u8]) {
    file("transforms/transforms.json", data);
    photos("transforms");
    let _ = black_box(Capture::load(&scratch().join("transforms"), &CaptureOptions::default()));
}

/// Photo, mask, depth and normal map of one view.
fn png(data: &[u8]) {
    file("png/transforms.json", &seeds::one_view());
    for folder in ["images", "masks", "depths", "normals"] {
        file(&format!("png/{folder}/0.png"), data);
    }
    let Ok(capture) = Capture::load(&scratch().join("png"), &CaptureOptions::default()) else { return };
    let photos = drex_core::capture::Photos::new(&capture, drex_core::capture::PhotoOptions::default());
    let _ = black_box(photos.and_then(|photos| photos.get(0)));
}

fn demo(name: &str, data: &[u8]) {
    let _ = black_box(Demonstration::parse(Path::new(name), data, &LoadOptions::default()));
}

fn points(data: &[u8]) {
    for name in ["p.obj", "p.ply", "p.npy", "p.xyz"] {
        let _ = black_box(drex_demo::parse_points(Path::new(name), data));
    }
}

fn hand_mapping(data: &[u8]) {
    std::thread_local! {
        static LEAP: Robot = Robot::bundled("leap_right").unwrap();
    }
    let robot = LEAP.with(Clone::clone);
    let _ = black_box(TargetHand::with_mapping(robot, Path::new("hand.toml"), &String::from_utf8_lossy(data)));
}

fn slcan(data: &[u8]) {
    let mut parser = can::SlcanParser::default();
    for &byte in data {
        black_box(parser.push(byte));
    }
    black_box(parser.ignored());
}

fn allegro_frames(data: &[u8]) {
    for chunk in data.chunks(10) {
        let Some((id, rest)) = chunk.split_first_chunk::<2>() else { continue };
        let Ok(frame) = can::CanFrame::data_frame(u16::from_le_bytes(*id), rest) else { continue };
        for version in [AllegroVersion::V4, AllegroVersion::V5] {
            black_box(allegro::AllegroReport::decode(version, &frame));
            black_box(allegro::AllegroCommand::decode(version, &frame));
        }
    }
}

fn dynamixel_stream(data: &[u8]) {
    let mut parser = dynamixel::Parser::new();
    let mut rest = data;
    while !rest.is_empty() {
        let taken = parser.push(rest);
        rest = &rest[taken..];
        while let Some(packet) = parser.next_packet() {
            black_box(packet.params.len());
        }
        if let Some(reply) = parser.fast_reply(64) {
            black_box(dynamixel::fast_blocks(reply, 4).count());
        }
        if taken == 0 && !parser.give_up() {
            break;
        }
    }
}

/// Packets whose CRC is right, with `data` inside.
fn dynamixel_packet(data: &[u8]) {
    let mut buffer = [0; 512];
    let (id, instruction) = (data.first().copied().unwrap_or(1), data.get(1).copied().unwrap_or(0x55));
    let params = data.get(2..).unwrap_or_default();
    if let Ok(length) = dynamixel::encode(&mut buffer, id, instruction, &params[..params.len().min(300)]) {
        dynamixel_stream(&buffer[..length]);
    }
}

/// Reads a text as a JSON or TOML file of no particular shape; for hostile nesting.
pub fn any_text(data: &[u8]) {
    let text = String::from_utf8_lossy(data);
    let _ = black_box(fsutil::from_json::<serde_json::Value>(Path::new("a.json"), &text));
    let _ = black_box(fsutil::from_toml::<std::collections::BTreeMap<String, f64>>(Path::new("a.toml"), &text));
}
