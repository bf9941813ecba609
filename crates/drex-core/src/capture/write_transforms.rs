//! Writes a capture as `transforms.json`, the form that nerfstudio, instant-ngp and Gaussian trainers read.

use std::path::Path;

use serde::Serialize;

use super::{Capture, SparsePoint, View, refuse};
use crate::camera::{Camera, CameraModel};
use crate::fsutil::{relative_path, write_atomic};
use crate::{Error, Pose, Result};

/// The sparse points beside the file, under nerfstudio's name for them.
const POINTS: &str = "sparse_pc.ply";

#[derive(Serialize)]
struct File<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_model: Option<&'static str>,
    /// What all frames share.
    #[serde(flatten)]
    lens: Option<Intrinsics>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ply_file_path: Option<&'a str>,
    frames: Vec<Frame>,
}

#[derive(Serialize)]
struct Frame {
    file_path: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    mask_path: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    depth_file_path: Option<String>,
    /// Not of nerfstudio, which passes over what it does not know.
    #[serde(skip_serializing_if = "Option::is_none")]
    confidence_file_path: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    camera_model: Option<&'static str>,
    #[serde(flatten)]
    lens: Option<Intrinsics>,
    /// World from camera, OpenGL axes (x right, y up, z backwards), row by row.
    transform_matrix: [[f64; 4]; 4],
}

/// Pixels; coefficients of OpenCV's lens, or of its fisheye (k1 to k4).
#[derive(Serialize, Clone, PartialEq)]
struct Intrinsics {
    w: u32,
    h: u32,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    k1: f64,
    k2: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    k3: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k4: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p2: Option<f64>,
}

impl Capture {
    /// Writes the capture as a `transforms.json`, replaced as a whole, that [`Capture::load`] and nerfstudio read: world
    /// from camera with OpenGL axes, paths of photos, masks and depth maps relative to the file, and the lens as OpenCV's
    /// (k1, k2, p1, p2 and, if need be, k3) or its fisheye's, once where all views share it. The sparse points lie beside
    /// it as `sparse_pc.ply`; the format has no keypoints. nerfstudio wants masks, and depth maps, for all views or for
    /// none. The same capture makes the same bytes.
    ///
    /// # Errors
    /// If there is no view, a lens has no such form (FOV, thin prism, rational OpenCV), a number is not finite, a path is
    /// not UTF-8, or a file cannot be written.
    pub fn write_transforms(&self, file: &Path) -> Result<()> {
        let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let lenses =
            self.views.iter().map(|v| Ok((model_name(&v.lens), intrinsics(v)?))).collect::<Result<Vec<_>>>()?;
        let Some((model, lens)) = lenses.first().cloned() else {
            return refuse("the capture has no view", "write one whose photos have cameras");
        };
        let one_model = lenses.iter().all(|(m, _)| *m == model);
        let one_lens = one_model && lenses.iter().all(|(_, l)| *l == lens);
        let frame = |(view, (model, lens)): (&View, (&'static str, Intrinsics))| frame(folder, view, model, lens);
        let mut frames = self.views.iter().zip(lenses).map(frame).collect::<Result<Vec<_>>>()?;
        for frame in &mut frames {
            frame.camera_model = frame.camera_model.filter(|_| !one_model);
            frame.lens = frame.lens.take().filter(|_| !one_lens);
        }
        let has_points = !self.points.is_empty();
        let whole = File {
            camera_model: one_model.then_some(model),
            lens: one_lens.then_some(lens),
            ply_file_path: has_points.then_some(POINTS),
            frames,
        };
        let mut text = serde_json::to_string_pretty(&whole).map_err(|e| Error::value(e.to_string(), "report this"))?;
        text.push('\n');
        if has_points {
            write_atomic(&folder.join(POINTS), &ply(&self.points)?)?;
        }
        write_atomic(file, text.as_bytes())
    }
}

fn frame(folder: &Path, view: &View, model: &'static str, lens: Intrinsics) -> Result<Frame> {
    let beside = |path: &Path| match path.to_str() {
        Some(_) => Ok(relative_path(path, folder).to_string_lossy().into_owned()),
        None => refuse(format!("the name of {} is not UTF-8", path.display()), "rename it"),
    };
    let transform_matrix = opengl_matrix(&view.camera_from_world);
    if transform_matrix.iter().flatten().any(|v| !v.is_finite()) {
        return refuse(format!("the pose of {} is not finite", view.name), "leave the view out");
    }
    Ok(Frame {
        file_path: beside(&view.photo)?,
        mask_path: view.mask.as_deref().map(beside).transpose()?,
        depth_file_path: view.depth.as_deref().map(beside).transpose()?,
        confidence_file_path: view.confidence.as_deref().map(beside).transpose()?,
        camera_model: Some(model),
        lens: Some(lens),
        transform_matrix,
    })
}

/// World from camera with y up and z backwards in the camera.
fn opengl_matrix(camera_from_world: &Pose) -> [[f64; 4]; 4] {
    let m = camera_from_world.inverse().to_homogeneous();
    // 0.0 - x has no negative zeros, which would only look odd.
    std::array::from_fn(|r| std::array::from_fn(|c| if c == 1 || c == 2 { 0.0 - m[(r, c)] } else { m[(r, c)] }))
}

fn model_name(lens: &Camera) -> &'static str {
    match lens.model() {
        CameraModel::OpenCvFisheye | CameraModel::SimpleRadialFisheye | CameraModel::RadialFisheye => "OPENCV_FISHEYE",
        _ => "OPENCV",
    }
}

fn intrinsics(view: &View) -> Result<Intrinsics> {
    let (lens, focal, centre) = (&view.lens, view.lens.focal_px(), view.lens.principal_point_px());
    let bent = &lens.params()[if lens.model().parameter_names()[1] == "fy" { 4 } else { 3 }..];
    let plane = |k1, k2, p1, p2, k3| ([k1, k2], [k3, None], [Some(p1), Some(p2)]);
    let fisheye = |k1, k2, k3, k4| ([k1, k2], [Some(k3), Some(k4)], [None; 2]);
    let ([k1, k2], [k3, k4], [p1, p2]) = match (lens.model(), bent) {
        (CameraModel::SimplePinhole | CameraModel::Pinhole, _) => plane(0.0, 0.0, 0.0, 0.0, None),
        (CameraModel::SimpleRadial, &[k]) => plane(k, 0.0, 0.0, 0.0, None),
        (CameraModel::Radial, &[k1, k2]) => plane(k1, k2, 0.0, 0.0, None),
        (CameraModel::OpenCv, &[k1, k2, p1, p2]) => plane(k1, k2, p1, p2, None),
        (CameraModel::FullOpenCv, &[k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]) => plane(k1, k2, p1, p2, Some(k3)),
        (CameraModel::SimpleRadialFisheye, &[k]) => fisheye(k, 0.0, 0.0, 0.0),
        (CameraModel::RadialFisheye, &[k1, k2]) => fisheye(k1, k2, 0.0, 0.0),
        (CameraModel::OpenCvFisheye, &[k1, k2, k3, k4]) => fisheye(k1, k2, k3, k4),
        _ => {
            let what = format!("the {} lens of {} has no form in transforms.json", lens.model(), view.name);
            return refuse(what, "write a COLMAP model, or fit a lens with k1, k2, p1, p2");
        }
    };
    let (w, h) = (lens.width_px(), lens.height_px());
    Ok(Intrinsics { w, h, fl_x: focal.x, fl_y: focal.y, cx: centre.x, cy: centre.y, k1, k2, k3, k4, p1, p2 })
}

/// Positions and colours, binary.
fn ply(points: &[SparsePoint]) -> Result<Vec<u8>> {
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", points.len());
    ["x", "y", "z"].iter().for_each(|axis| header.push_str(&format!("property double {axis}\n")));
    ["red", "green", "blue"].iter().for_each(|channel| header.push_str(&format!("property uchar {channel}\n")));
    let mut out = header.into_bytes();
    out.extend(b"end_header\n");
    for (i, point) in points.iter().enumerate() {
        if point.position.iter().any(|v| !v.is_finite()) {
            return refuse(format!("the position of point {i} is not finite"), "leave the point out");
        }
        out.extend(point.position.iter().flat_map(|v| v.to_le_bytes()));
        out.extend(point.rgb);
    }
    Ok(out)
}
