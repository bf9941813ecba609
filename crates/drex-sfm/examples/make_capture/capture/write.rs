//! Files: JPEG with EXIF, masks, truth as COLMAP's text model, solids as JSON.

use std::fmt::Write as _;
use std::path::Path;

use drex_core::camera::Camera;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder as _, RgbImage};
use serde_json::json;

use super::Outcome;
use super::render::Shot;
use super::scene::{Role, Scene, Shape};
use super::tag::Marker;

/// What a photo's EXIF says.
#[derive(Debug, Clone, PartialEq)]
pub struct Exif {
    /// Maker of the camera.
    pub make: String,
    /// Its name.
    pub model: String,
    /// Focal length of the same view on 35 mm film, whole millimetres.
    pub focal_35mm: u16,
    /// Focal length, tenths of a millimetre.
    pub focal_tenths_mm: u32,
}

/// A JPEG file's bytes.
///
/// # Errors
/// If the picture is too large for the format.
pub fn jpeg(rgb: &RgbImage, quality: u8, exif: Option<&Exif>) -> Outcome<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
    encoder.write_image(rgb, rgb.width(), rgb.height(), ExtendedColorType::Rgb8)?;
    if let Some(exif) = exif {
        // Behind the two bytes of the start marker.
        bytes.splice(2..2, exif.segment());
    }
    Ok(bytes)
}

impl Exif {
    /// The APP1 segment: a big-endian TIFF of two directories (Exif 2.32, 4.6).
    #[must_use]
    pub fn segment(&self) -> Vec<u8> {
        const ASCII: u16 = 2;
        const SHORT: u16 = 3;
        const LONG: u16 = 4;
        const RATIONAL: u16 = 5;
        let text = |s: &str| [s.as_bytes(), &[0]].concat();
        let (make, model) = (text(&self.make), text(&self.model));
        // Header 8; first directory 2 + 3 x 12 + 4; its texts; second directory 2 + 2 x 12 + 4; its fraction.
        let texts_at = 8 + 42;
        let second_at = texts_at + make.len() + model.len();
        let fraction_at = second_at + 30;
        let mut tiff = Vec::new();
        tiff.extend_from_slice(b"MM\0\x2a\0\0\0\x08");
        let entry = |tiff: &mut Vec<u8>, tag: u16, kind: u16, count: usize, value: u32| {
            tiff.extend_from_slice(&tag.to_be_bytes());
            tiff.extend_from_slice(&kind.to_be_bytes());
            tiff.extend_from_slice(&(count as u32).to_be_bytes());
            tiff.extend_from_slice(&value.to_be_bytes());
        };
        tiff.extend_from_slice(&3u16.to_be_bytes());
        // Texts of up to four bytes would stand in the entry itself; makers' names here are longer.
        entry(&mut tiff, 0x010f, ASCII, make.len(), texts_at as u32);
        entry(&mut tiff, 0x0110, ASCII, model.len(), (texts_at + make.len()) as u32);
        entry(&mut tiff, 0x8769, LONG, 1, second_at as u32);
        tiff.extend_from_slice(&[0; 4]);
        tiff.extend_from_slice(&make);
        tiff.extend_from_slice(&model);
        tiff.extend_from_slice(&2u16.to_be_bytes());
        entry(&mut tiff, 0x920a, RATIONAL, 1, fraction_at as u32);
        entry(&mut tiff, 0xa405, SHORT, 1, u32::from(self.focal_35mm) << 16);
        tiff.extend_from_slice(&[0; 4]);
        tiff.extend_from_slice(&self.focal_tenths_mm.to_be_bytes());
        tiff.extend_from_slice(&10u32.to_be_bytes());
        let length = (2 + 6 + tiff.len()) as u16;
        [&[0xff, 0xe1][..], &length.to_be_bytes(), b"Exif\0\0", &tiff].concat()
    }
}

/// Writes `cameras.txt`, `images.txt`, `points3D.txt` of one camera and its shots.
///
/// # Errors
/// If a file cannot be written.
pub fn truth(folder: &Path, camera: &Camera, shots: &[&Shot]) -> Outcome<()> {
    std::fs::create_dir_all(folder)?;
    let parameters: Vec<String> = camera.params().iter().map(f64::to_string).collect();
    let cameras = format!(
        "# truth: camera id, model, width, height, fx fy cx cy k1 k2 p1 p2\n1 {} {} {} {}\n",
        camera.model().name(),
        camera.width_px(),
        camera.height_px(),
        parameters.join(" ")
    );
    std::fs::write(folder.join("cameras.txt"), cameras)?;
    let mut images = String::from(
        "# truth, metres: image id, qw qx qy qz tx ty tz (camera from world), camera id, name; second line of each image empty\n",
    );
    for (i, shot) in shots.iter().enumerate() {
        let (t, q) = drex_core::pose::to_wxyz(&shot.camera_from_object);
        write!(images, "{}", i + 1)?;
        for value in q.iter().chain(&t) {
            write!(images, " {value:.10}")?;
        }
        writeln!(images, " 1 {}\n", shot.name)?;
    }
    std::fs::write(folder.join("images.txt"), images)?;
    std::fs::write(folder.join("points3D.txt"), "# no points\n")?;
    Ok(())
}

/// The solids of the object as JSON.
#[must_use]
pub fn object(scene: &Scene, floor_m: f64) -> serde_json::Value {
    let parts: Vec<_> = scene
        .solids
        .iter()
        .filter(|s| s.role == Role::Object)
        .map(|s| {
            let kind = match s.shape {
                Shape::Box => "box",
                Shape::Ellipsoid => "ellipsoid",
                Shape::Cylinder => "cylinder",
            };
            let r = s.world_from_part.rotation.to_rotation_matrix().into_inner();
            let rows: Vec<[f64; 3]> = r.row_iter().map(|row| [row[0], row[1], row[2]]).collect();
            let centre: [f64; 3] = s.world_from_part.translation.vector.into();
            let half: [f64; 3] = s.half_m.into();
            json!({"kind": kind, "centre_m": centre, "half_m": half, "world_from_part": rows})
        })
        .collect();
    let what = "union of solids; box and ellipsoid by half axes, cylinder along its z";
    json!({"what": what, "floor_m": floor_m, "parts": parts})
}

/// The description of a printed tag as JSON.
#[must_use]
pub fn marker(marker: &Marker) -> serde_json::Value {
    json!({
        "family": "tag36h11",
        "id": marker.id,
        "side_m": marker.side_m,
        "side": "edge of the black border, outside",
        "centre_world_m": marker.centre_m,
        "yaw_rad": marker.yaw_rad,
    })
}
