//! transforms.json, as nerfstudio, instant-ngp and the synthetic NeRF scenes write it.
//!
//! `transform_matrix` is world from camera with OpenGL axes (x right, y up, z backwards). Intrinsics stand at the top or
//! in each frame. `applied_transform`, with which nerfstudio turned COLMAP's frame, is undone, in the points too.

use std::path::{Component, Path, PathBuf};

use nalgebra::{Matrix4, Point3, UnitQuaternion, Vector3};
use serde::Deserialize;

use super::assemble::{Posed, count, finish, unregistered};
use super::companions::{Companions, size_of, with_known_extension};
use super::{Capture, CaptureOptions, SparsePoint, point_cloud, refuse};
use crate::camera::{Camera, CameraModel};
use crate::fsutil::{from_json, read_text};
use crate::pose::pose_from_matrix;
use crate::{Error, Pose, Result};

#[derive(Deserialize)]
struct File {
    #[serde(flatten)]
    lens: Intrinsics,
    frames: Vec<Frame>,
    applied_transform: Option<Vec<Vec<f64>>>,
    ply_file_path: Option<PathBuf>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    mask_path: Option<PathBuf>,
    depth_file_path: Option<PathBuf>,
    confidence_file_path: Option<PathBuf>,
    #[serde(flatten)]
    lens: Intrinsics,
}

/// Pixels and radians; what a frame does not say, the top says.
#[derive(Deserialize)]
struct Intrinsics {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// The file in `folder`, if there is one.
pub(super) fn find(folder: &Path) -> Option<PathBuf> {
    ["transforms.json", "transforms_train.json"].map(|n| folder.join(n)).into_iter().find(|p| p.is_file())
}

pub(super) fn load(folder: &Path, path: &Path, options: &CaptureOptions) -> Result<Capture> {
    let mut notes = Vec::new();
    let file: File = from_json(path, &read_text(path)?)?;
    let colmap_from_saved = match &file.applied_transform {
        Some(rows) => pose(rows).map_err(|e| at(path, "applied_transform", e))?.inverse(),
        None => Pose::identity(),
    };
    let (mut posed, mut missing) = (Vec::new(), Vec::new());
    for frame in &file.frames {
        let Some(photo) = photo_of(folder, frame, options) else {
            missing.push(frame.file_path.clone());
            continue;
        };
        let name = name_of(&frame.file_path, &photo);
        let world_from_camera = pose(&frame.transform_matrix).map_err(|e| at(path, &frame.file_path, e))?;
        let opengl_from_opencv = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let world_from_camera = colmap_from_saved * world_from_camera * opengl_from_opencv;
        let mut existing = |given: &Option<PathBuf>, what: &str| {
            let file = folder.join(given.as_ref()?);
            if !file.is_file() {
                notes.push(format!("The {what} {} of {name} does not exist.", file.display()));
            }
            file.is_file().then_some(file)
        };
        let given = Companions {
            mask: existing(&frame.mask_path, "mask"),
            depth: existing(&frame.depth_file_path, "depth map"),
            confidence: existing(&frame.confidence_file_path, "confidence"),
            normal: None,
        };
        let size = size_of(&photo)?;
        let lens = lens(&frame.lens, &file.lens, size).map_err(|e| at(path, &frame.file_path, e))?;
        let camera_from_world = world_from_camera.inverse();
        posed.push(Posed { name, photo, given, lens, camera_from_world, keypoints: Vec::new() });
    }
    if posed.is_empty() {
        return refuse(
            format!("none of the {} photos that {} names exists", missing.len(), path.display()),
            "put the photos beside it as its file_path entries say",
        );
    }
    if !missing.is_empty() {
        notes.push(format!(
            "{} of {} have no photo: {}.",
            count(missing.len(), "frame"),
            path.display(),
            missing.join(", ")
        ));
    }
    let root = posed.iter().find_map(|p| p.photo.parent()).unwrap_or(folder).to_path_buf();
    let views = finish(folder, posed, options, &mut notes)?;
    let mut points = match &file.ply_file_path {
        Some(ply) => point_cloud::load(&folder.join(ply))?,
        None => Vec::new(),
    };
    for SparsePoint { position, .. } in &mut points {
        *position = (colmap_from_saved * Point3::from(*position)).into();
    }
    let unregistered = unregistered(&root, &views);
    Ok(Capture { folder: folder.into(), views, points, unregistered, notes })
}

fn photo_of(folder: &Path, frame: &Frame, options: &CaptureOptions) -> Option<PathBuf> {
    let given = Path::new(&frame.file_path);
    let elsewhere = options.images.as_ref().and_then(|images| {
        let inner = given.strip_prefix("./images").or(given.strip_prefix("images")).unwrap_or(given);
        with_known_extension(&images.join(inner))
    });
    elsewhere.or_else(|| with_known_extension(&folder.join(given)))
}

/// The name within the folder of photos, with the extension of the file, as COLMAP would name it.
fn name_of(file_path: &str, photo: &Path) -> String {
    let parts = Path::new(file_path).components().filter_map(|c| match c {
        Component::Normal(part) => Some(part.to_string_lossy().into_owned()),
        _ => None,
    });
    let mut parts: Vec<_> = parts.collect();
    if parts.len() > 1 && parts[0] == "images" {
        parts.remove(0);
    }
    if let (Some(last), Some(file)) = (parts.last_mut(), photo.file_name()) {
        *last = file.to_string_lossy().into_owned();
    }
    parts.join("/")
}

/// A pose from the upper three rows of a matrix, or all four.
fn pose(rows: &[Vec<f64>]) -> Result<Pose> {
    if !(3..=4).contains(&rows.len()) || rows.iter().any(|row| row.len() != 4) {
        return Err(Error::value("the matrix has not 3 or 4 rows of 4 numbers", "write it row by row"));
    }
    pose_from_matrix(&Matrix4::from_fn(|r, c| match rows.get(r) {
        Some(row) => row[c],
        None => f64::from(u8::from(c == 3)),
    }))
}

/// `error` with the place in the file.
fn at(path: &Path, place: &str, error: Error) -> Error {
    match error {
        Error::Value { what, remedy } => Error::content(path, None, format!("{place}: {what}"), remedy),
        other => other,
    }
}

/// The lens of a frame whose photo has `size` pixels.
fn lens(frame: &Intrinsics, top: &Intrinsics, size: [f64; 2]) -> Result<Camera> {
    let get = |field: fn(&Intrinsics) -> Option<f64>| field(frame).or(field(top));
    let zero = |field: fn(&Intrinsics) -> Option<f64>| get(field).unwrap_or(0.0);
    let (w, h) = (get(|l| l.w).unwrap_or(size[0]).round(), get(|l| l.h).unwrap_or(size[1]).round());
    let focal = |side: f64, angle: f64| 0.5 * side / (0.5 * angle).tan();
    let along_x = |l: &Intrinsics| l.fl_x.or(l.camera_angle_x.map(|angle| focal(w, angle)));
    let along_y = |l: &Intrinsics| l.fl_y.or(l.camera_angle_y.map(|angle| focal(h, angle)));
    let Some(fx) = along_x(frame).or(along_x(top)) else {
        return Err(Error::value("no focal length", "give fl_x in pixels or camera_angle_x in radians"));
    };
    let fy = along_y(frame).or(along_y(top)).unwrap_or(fx);
    let (cx, cy) = (get(|l| l.cx).unwrap_or(0.5 * w), get(|l| l.cy).unwrap_or(0.5 * h));
    let [k1, k2, k3, k4] = [zero(|l| l.k1), zero(|l| l.k2), zero(|l| l.k3), zero(|l| l.k4)];
    let (p1, p2) = (zero(|l| l.p1), zero(|l| l.p2));
    let model = frame.camera_model.as_deref().or(top.camera_model.as_deref()).unwrap_or("OPENCV");
    let fisheye = frame.is_fisheye.or(top.is_fisheye) == Some(true) || model.contains("FISHEYE");
    let known = ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV"];
    if !fisheye && !known.contains(&model) {
        let remedy = "use OPENCV, OPENCV_FISHEYE or PINHOLE";
        return Err(Error::value(format!("camera model `{model}` is no lens with a plane image"), remedy));
    }
    let (model, params) = if fisheye {
        (CameraModel::OpenCvFisheye, vec![fx, fy, cx, cy, k1, k2, k3, k4])
    } else if k4 != 0.0 {
        return Err(Error::value("k4 is given for a lens that is no fisheye", "fit a lens with k1, k2, p1, p2, k3"));
    } else if k3 != 0.0 {
        (CameraModel::FullOpenCv, vec![fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0])
    } else {
        (CameraModel::OpenCv, vec![fx, fy, cx, cy, k1, k2, p1, p2])
    };
    Camera::new(model, w as u32, h as u32, &params)
}
