//! transforms.json as nerfstudio, instant-ngp and the synthetic scenes write it, against the same cameras in COLMAP's form.

use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use drex_core::capture::{Capture, CaptureOptions, Photos};
use nalgebra::{Matrix4, Point3};
use serde_json::{Value, json};

use crate::capture_support::{grey, lens, on_disk, pose, ring};

fn load(folder: &Path) -> drex_core::Result<Capture> {
    Capture::load(folder, &CaptureOptions::default())
}

/// nerfstudio's turn of COLMAP's world: x, z, -y.
fn applied() -> Matrix4<f64> {
    Matrix4::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
}

/// World from camera with OpenGL axes: the second and third column change their sign.
fn matrix(camera_from_world: &Pose) -> Matrix4<f64> {
    camera_from_world.inverse().to_homogeneous() * Matrix4::from_diagonal(&[1.0, -1.0, -1.0, 1.0].into())
}

fn rows(m: &Matrix4<f64>, n: usize) -> Value {
    (0..n).map(|r| (0..4).map(|c| m[(r, c)]).collect::<Vec<_>>()).collect()
}

fn write(folder: &Path, value: &Value) {
    std::fs::write(folder.join("transforms.json"), value.to_string()).unwrap();
}

/// A folder with photos 0.png to 3.png in images.
fn photos() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    (0..4).for_each(|i| grey(&folder.path().join(format!("images/{i}.png")), 160, 120));
    let path = folder.path().to_path_buf();
    (folder, path)
}

fn frames(edit: impl Fn(usize, &mut Value)) -> Vec<Value> {
    let frame = |i: usize| {
        let mut frame = json!({
            "file_path": format!("./images/{i}.png"),
            "transform_matrix": rows(&matrix(&pose(i as f64)), 4),
        });
        edit(i, &mut frame);
        frame
    };
    (0..4).map(frame).collect()
}

fn close(a: &Pose, b: &Pose) {
    let difference = (a.to_homogeneous() - b.to_homogeneous()).abs().max();
    assert!(difference < 1e-9, "{a} {b}");
}

#[test]
fn nerfstudio_returns_to_colmaps_frame() {
    let model = ring(&lens(CameraModel::OpenCv), 4, 30);
    let (_guard, folder) = on_disk(&model);
    let colmap = load(&folder).unwrap();
    std::fs::remove_dir_all(folder.join("sparse")).unwrap();
    let frame = |view: &drex_core::capture::View| {
        json!({
            "file_path": format!("images/{}", view.name),
            "transform_matrix": rows(&(applied() * matrix(&view.camera_from_world)), 4),
            "colmap_im_id": 3,
        })
    };
    let [fx, fy, cx, cy, k1, k2, p1, p2] = *lens(CameraModel::OpenCv).params() else { panic!() };
    let frames: Vec<_> = colmap.views.iter().map(frame).collect();
    let mut file = json!({
        "w": 160, "h": 120, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "k1": k1, "k2": k2, "p1": p1, "p2": p2,
        "camera_model": "OPENCV", "frames": frames, "applied_transform": rows(&applied(), 3), "ply_file_path": "sparse.ply",
    });
    write(&folder, &file);
    let turned = colmap.points.iter().map(|p| ((applied() * Point3::from(p.position).to_homogeneous()).xyz(), p.rgb));
    let turned: Vec<_> = turned.collect();
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             property uint8 red\nproperty uint8 green\nproperty uchar blue\nend_header\n",
            turned.len()
        )
    };
    let mut ascii = head("ascii");
    let mut little = head("binary_little_endian").into_bytes();
    let mut big = head("binary_big_endian").into_bytes();
    for (p, rgb) in &turned {
        ascii += &format!("{} {} {} {} {} {}\n", p.x, p.y, p.z, rgb[0], rgb[1], rgb[2]);
        p.iter().for_each(|v| little.extend((*v as f32).to_le_bytes()));
        p.iter().for_each(|v| big.extend((*v as f32).to_be_bytes()));
        little.extend(rgb);
        big.extend(rgb);
    }
    for ply in [ascii.into_bytes(), little, big] {
        std::fs::write(folder.join("sparse.ply"), &ply).unwrap();
        let capture = load(&folder).unwrap();
        assert_eq!(capture.views.len(), 4);
        for (a, b) in capture.views.iter().zip(&colmap.views) {
            assert_eq!((&a.name, &a.lens), (&b.name, &b.lens));
            close(&a.camera_from_world, &b.camera_from_world);
        }
        assert_eq!(capture.points.len(), 30);
        for (a, b) in capture.points.iter().zip(&colmap.points) {
            assert_eq!(a.rgb, b.rgb);
            assert!((Point3::from(a.position) - Point3::from(b.position)).norm() < 1e-6);
        }
        assert!(capture.report().unwrap().to_string().contains("cameras cannot be checked"));
        // A file cut anywhere is refused by name.
        std::fs::write(folder.join("sparse.ply"), &ply[..ply.len() - 5]).unwrap();
        assert!(load(&folder).unwrap_err().to_string().contains("sparse.ply"));
    }
    file["ply_file_path"] = Value::Null;
    write(&folder, &file);
    assert!(load(&folder).unwrap().points.is_empty());
}

#[test]
fn intrinsics_stand_at_the_top_or_in_frames() {
    let (_guard, folder) = photos();
    let expect = |file: Value, lenses: [(CameraModel, Vec<f64>); 2]| {
        write(&folder, &file);
        let capture = load(&folder).unwrap();
        for (view, (model, params)) in capture.views.iter().zip(lenses) {
            assert_eq!(view.lens, Camera::new(model, 160, 120, &params).unwrap(), "{}", view.name);
        }
        for (i, view) in capture.views.iter().enumerate() {
            close(&view.camera_from_world, &pose(i as f64));
        }
    };
    // A field of view alone; and focal lengths of one frame.
    let angle = 2.0 * (80.0f64 / 100.0).atan();
    let f = 80.0 / (0.5 * angle).tan();
    expect(
        json!({"camera_angle_x": angle, "frames": frames(|i, frame| {
            if i == 1 {
                frame["fl_x"] = json!(90.0);
                frame["fl_y"] = json!(91.0);
                frame["cx"] = json!(70.5);
            }
        })}),
        [
            (CameraModel::OpenCv, vec![f, f, 80.0, 60.0, 0.0, 0.0, 0.0, 0.0]),
            (CameraModel::OpenCv, vec![90.0, 91.0, 70.5, 60.0, 0.0, 0.0, 0.0, 0.0]),
        ],
    );
    // Sizes as real numbers, a third coefficient, and a fisheye in one frame.
    expect(
        json!({"w": 160.0, "h": 120.0, "fl_x": 100.0, "k1": -0.1, "k3": 0.01, "aabb_scale": 16, "frames": frames(|i, frame| {
            if i == 1 {
                frame["camera_model"] = json!("OPENCV_FISHEYE");
                frame["k4"] = json!(0.001);
            }
        })}),
        [
            (CameraModel::FullOpenCv, vec![100.0, 100.0, 80.0, 60.0, -0.1, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0]),
            (CameraModel::OpenCvFisheye, vec![100.0, 100.0, 80.0, 60.0, -0.1, 0.0, 0.01, 0.001]),
        ],
    );
    // Intrinsics for photos of twice the size.
    expect(
        json!({"w": 320, "h": 240, "fl_x": 200.0, "cx": 150.0, "cy": 130.0, "frames": frames(|_, _| ())}),
        [(); 2].map(|()| (CameraModel::OpenCv, vec![100.0, 100.0, 75.0, 65.0, 0.0, 0.0, 0.0, 0.0])),
    );
}

#[test]
fn synthetic_scenes_without_extensions() {
    let folder = tempfile::tempdir().unwrap();
    for i in 0..4 {
        let cut = image::RgbaImage::from_pixel(160, 120, image::Rgba([1, 2, 3, if i == 0 { 0 } else { 255 }]));
        std::fs::create_dir_all(folder.path().join("train")).unwrap();
        cut.save(folder.path().join(format!("train/r_{i}.png"))).unwrap();
    }
    let frames = frames(|i, frame| frame["file_path"] = json!(format!("./train/r_{i}")));
    let file = json!({"camera_angle_x": 0.69, "frames": frames});
    std::fs::write(folder.path().join("transforms_train.json"), file.to_string()).unwrap();
    let capture = load(folder.path()).unwrap();
    assert_eq!(capture.views[3].name, "train/r_3.png");
    let photos = Photos::new(&capture, Default::default()).unwrap();
    assert_eq!(photos.get(0).unwrap().mask.as_ref().unwrap()[7], 0);
    assert_eq!(photos.get(1).unwrap().mask.as_ref().unwrap()[7], 255);
}

#[test]
fn named_files_and_missing_ones() {
    let (_guard, folder) = photos();
    grey(&folder.join("elsewhere/m.png"), 160, 120);
    grey(&folder.join("masks/1.png"), 160, 120);
    let file = json!({"fl_x": 100.0, "frames": frames(|i, frame| match i {
        0 => frame["mask_path"] = json!("elsewhere/m.png"),
        2 => frame["mask_path"] = json!("elsewhere/none.png"),
        3 => frame["file_path"] = json!("images/gone.png"),
        _ => (),
    })});
    write(&folder, &file);
    let capture = load(&folder).unwrap();
    let masks: Vec<_> = capture.views.iter().map(|v| v.mask.clone()).collect();
    assert_eq!(masks, [Some(folder.join("elsewhere/m.png")), Some(folder.join("masks/1.png")), None]);
    let notes = capture.notes.join("\n");
    assert!(notes.contains("none.png of 2.png does not exist") && notes.contains("images/gone.png"), "{notes}");
    assert_eq!(capture.unregistered, ["3.png"]);
}

#[test]
fn wrong_files_say_where() {
    let (_guard, folder) = photos();
    let refuse = |file: Value, reason: &str| {
        write(&folder, &file);
        let message = load(&folder).unwrap_err().to_string();
        assert!(message.contains(reason), "{message}");
    };
    let plain = |edit: &dyn Fn(&mut Value)| {
        let mut file = json!({"fl_x": 100.0, "frames": frames(|_, _| ())});
        edit(&mut file);
        file
    };
    refuse(plain(&|f| f["fl_x"] = json!(null)), "./images/0.png: no focal length");
    refuse(plain(&|f| f["fl_x"] = json!(-3.0)), "focal length");
    refuse(plain(&|f| f["camera_model"] = json!("EQUIRECTANGULAR")), "EQUIRECTANGULAR");
    refuse(plain(&|f| f["k4"] = json!(0.1)), "k4");
    refuse(plain(&|f| f["w"] = json!(1e300)), "0.png has 160 x 120 pixels, its camera");
    refuse(plain(&|f| f["applied_transform"] = json!([[1, 0, 0, 0]])), "applied_transform: the matrix has not 3 or 4");
    refuse(plain(&|f| f["frames"][2]["transform_matrix"][0][0] = json!(7.0)), "./images/2.png: the 3 x 3 block");
    refuse(plain(&|f| f["frames"][1]["file_path"] = json!("images/0.png")), "two cameras are of the same photo");
    refuse(plain(&|f| f["frames"] = json!([])), "none of the 0 photos");
    refuse(plain(&|f| f["ply_file_path"] = json!("no.ply")), "no.ply");
    refuse(json!({"fl_x": 100.0}), "frames");
}
