//! Masks for the photos of a COLMAP text model, given the support plane and a box:
//!
//! ```sh
//! cargo run -p drex-sfm --example masks -- MODEL_DIR PHOTO_DIR region.json OUT_DIR [SILHOUETTE_DIR]
//! ```
//! `region.json`: `{"point": [x, y, z], "normal": [x, y, z], "x_axis": [x, y, z], "lower": [x, y, z], "upper": [x, y, z]}`:
//! a point of the plane and its normal (up) in the world, the direction of the box's first axis in the world (laid onto the
//! plane), and the corners of the box along these axes from the point. With SILHOUETTE_DIR (`PHOTO.png`, white is the
//! object) the intersection over union of each mask is printed too.

use std::collections::HashMap;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

use drex_core::Pose;
use drex_core::camera::Camera;
use drex_core::pose::pose_from_wxyz;
use drex_sfm::masks::{MaskInput, MaskOptions, MaskPoint, MaskRegion, MaskView, Photo, make_masks};
use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

#[derive(serde::Deserialize)]
struct RegionFile {
    point: [f64; 3],
    normal: [f64; 3],
    x_axis: [f64; 3],
    lower: [f64; 3],
    upper: [f64; 3],
}

impl RegionFile {
    fn region(&self) -> MaskRegion {
        let z = Vector3::from(self.normal).normalize();
        let x = Vector3::from(self.x_axis);
        let x = (x - z * z.dot(&x)).normalize();
        let rotation = Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
        MaskRegion {
            world_from_region: Pose::from_parts(
                Translation3::from(self.point),
                UnitQuaternion::from_rotation_matrix(&rotation),
            ),
            lower: self.lower.into(),
            upper: self.upper.into(),
        }
    }
}

/// Lines without comments.
fn lines(path: &Path) -> Result<Vec<String>> {
    let text = fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    Ok(text.lines().filter(|l| !l.starts_with('#')).map(str::to_string).collect())
}

fn number<T: std::str::FromStr>(words: &[&str], at: usize) -> Result<T> {
    words.get(at).and_then(|w| w.parse().ok()).ok_or_else(|| format!("no number {at} in `{}`", words.join(" ")).into())
}

/// Views and points of a text model; photos in the order of their names.
fn read_model(dir: &Path) -> Result<(Vec<MaskView>, Vec<MaskPoint>)> {
    let mut cameras = HashMap::new();
    for line in lines(&dir.join("cameras.txt"))?.iter().filter(|l| !l.trim().is_empty()) {
        let w: Vec<&str> = line.split_whitespace().collect();
        let params: Vec<f64> = (4..w.len()).map(|k| number(&w, k)).collect::<Result<_>>()?;
        let name = *w.get(1).ok_or("a camera without a model")?;
        cameras.insert(number::<u32>(&w, 0)?, Camera::from_colmap_name(name, number(&w, 2)?, number(&w, 3)?, &params)?);
    }
    let mut images = Vec::new();
    for line in lines(&dir.join("images.txt"))?.iter().step_by(2) {
        let w: Vec<&str> = line.split_whitespace().collect();
        if w.is_empty() {
            continue;
        }
        let at = |k: usize| number::<f64>(&w, k);
        let pose = pose_from_wxyz([at(5)?, at(6)?, at(7)?], [at(1)?, at(2)?, at(3)?, at(4)?])?;
        let camera = cameras.get(&number::<u32>(&w, 8)?).ok_or("an image without a camera")?.clone();
        images.push((w[9..].join(" "), number::<u32>(&w, 0)?, camera, pose));
    }
    images.sort_by(|a, b| a.0.cmp(&b.0));
    let index: HashMap<u32, u32> = images.iter().enumerate().map(|(k, i)| (i.1, k as u32)).collect();
    let mut points = Vec::new();
    for line in lines(&dir.join("points3D.txt"))?.iter().filter(|l| !l.trim().is_empty()) {
        let w: Vec<&str> = line.split_whitespace().collect();
        let position = Point3::new(number(&w, 1)?, number(&w, 2)?, number(&w, 3)?);
        let rgb = [number(&w, 4)?, number(&w, 5)?, number(&w, 6)?];
        let mut photos: Vec<u32> =
            w[8..].iter().step_by(2).filter_map(|id| index.get(&id.parse().ok()?).copied()).collect();
        photos.sort_unstable();
        photos.dedup();
        points.push(MaskPoint { position, rgb, photos });
    }
    let views = images
        .into_iter()
        .map(|(name, _, camera, camera_from_world)| MaskView { name, camera, camera_from_world })
        .collect();
    Ok((views, points))
}

fn main() -> Result<()> {
    let args: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let [model, photos, region, out, rest @ ..] = args.as_slice() else {
        return Err("give MODEL_DIR PHOTO_DIR region.json OUT_DIR [SILHOUETTE_DIR]".into());
    };
    let (views, points) = read_model(model)?;
    let region: RegionFile = serde_json::from_str(&fs::read_to_string(region)?)?;
    let load = |k: usize| -> std::result::Result<Photo, String> {
        let path = photos.join(&views[k].name);
        let image = image::open(&path).map_err(|e| format!("{}: {e}", path.display()))?.into_rgb8();
        Ok(Photo { width_px: image.width(), height_px: image.height(), rgb: image.into_raw() })
    };
    let start = Instant::now();
    let input = MaskInput { views: &views, points: &points, region: &region.region(), load: &load };
    let masks = make_masks(&input, &MaskOptions::default(), &mut |_, _| {})?;
    let seconds = start.elapsed().as_secs_f64();
    fs::create_dir_all(out)?;
    let mut scores = Vec::new();
    for (view, mask) in views.iter().zip(&masks) {
        let pixels = mask.pixels();
        let path = out.join(format!("{}.png", view.name));
        image::save_buffer(&path, &pixels, mask.width_px, mask.height_px, image::ColorType::L8)?;
        let mut line = format!("{} confidence {:.3} undecided {:.3}", view.name, mask.confidence, mask.undecided);
        if let Some(truth) = rest.first() {
            let truth = image::open(truth.join(format!("{}.png", view.name)))?.into_luma8();
            let both = pixels.iter().zip(truth.as_raw()).filter(|(a, b)| **a > 127 && **b > 127).count();
            let either = pixels.iter().zip(truth.as_raw()).filter(|(a, b)| **a > 127 || **b > 127).count();
            let iou = both as f64 / either.max(1) as f64;
            scores.push(iou);
            line += &format!(" iou {iou:.4}");
        }
        line += mask.doubt.as_deref().map(|d| format!(" ({d})")).unwrap_or_default().as_str();
        eprintln!("{line}");
    }
    let count = scores.len().max(1) as f64;
    let worst = scores.iter().copied().fold(f64::INFINITY, f64::min);
    eprintln!(
        "{} masks in {seconds:.1} s; iou mean {:.4} worst {worst:.4}",
        masks.len(),
        scores.iter().sum::<f64>() / count
    );
    Ok(())
}
