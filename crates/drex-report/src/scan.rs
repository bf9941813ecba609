//! The scan: photos, the mesh made of them, the Gaussians born on it, scale and frame.

use std::path::{Path, PathBuf};

use crate::Result;
use drex_core::Pose;
use drex_core::camera::PinholeCamera;
use drex_mesh::{Asset, Similarity};
use drex_splat::Kind;
use drex_splat::io::read_gaussians;
use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
use nalgebra::{Matrix4, Similarity3, Translation3, Vector3};

use super::object::{MESH_FACES, OBJECT_COLOR, still, still_of};
use super::page::Page;
use super::viewer::{Look, MOST_SPLATS, Scene};
use crate::picture::raster::{encode_png, render_from};
use crate::picture::surface::{Surface, close_up, resampled};
use drex_twin::cameras::cameras_of;
use drex_twin::records::{HELD_OUT, ScanFile, SplatReport};
use drex_twin::{Twin, records as files};

/// Photos that are shown; as many held-out ones beside what the Gaussians make of them.
const PHOTOS: usize = 4;
/// Size of the picture of the mesh beside a photo, pixels.
const BESIDE: [usize; 2] = [420, 380];
/// Longest side of a photo, pixels.
const PHOTO_SIDE: u32 = 400;
/// The Gaussians are cut this far around the object, as a share of the diagonal of its box.
const MARGIN: f64 = 0.2;
/// What stands behind a rendered picture where nothing is.
const BEHIND: [u8; 3] = [200, 204, 210];

/// The section on the scan.
pub fn section(page: &mut Page, twin: &Twin, asset: &Asset, photos: &Path) -> Result<()> {
    let file: ScanFile = files::read_json(&twin.path(files::SCAN))?;
    page.section("Scan");
    let surface = textured(twin)?;
    if let Some(surface) = &surface
        && let Some(pair) = beside_a_photo(twin, surface)?
    {
        let nothing = || Scene::new(0.0, 0.0);
        let captions =
            [format!("photo {}", pair.photo), "the mesh from there, with the colours of the photos".to_owned()];
        let [photo, mesh] = pair.pictures.map(|picture| encode_png(&picture));
        let [of_photo, of_mesh] = captions;
        page.viewers(&[(nothing(), photo?, of_photo), (nothing(), mesh?, of_mesh)]);
    }
    let trained: Option<SplatReport> = files::read_json_if_there(&twin.path(files::SPLAT_REPORT))?;
    let views: Vec<(String, PathBuf)> = match cameras_of(&twin.path(photos), &twin.root) {
        Ok(capture) => capture.views.into_iter().map(|v| (v.name, v.photo)).collect(),
        Err(_) => Vec::new(),
    };
    page.pictures(&shown(&views));
    if let Some(trained) = &trained {
        of_training(page, twin, trained, &views);
    }
    scenes(page, twin, asset, surface.as_ref(), &file)?;
    of_frame(page, &file);
    Ok(())
}

/// The mesh of the asset with the picture on it; `None` where the photos gave none.
///
/// # Errors
/// If what the stage asset wrote cannot be read.
pub fn textured(twin: &Twin) -> Result<Option<Surface>> {
    let surfaces = Surface::read(&twin.path("mesh/visual.obj"))?;
    Ok(surfaces.into_iter().find(|s| s.texture.is_some()))
}

/// A photo of the object, and its mesh as seen from there.
pub struct Beside {
    /// Name of the photo.
    pub photo: String,
    /// The photo without the distortion of its lens, and the mesh, of the same size.
    pub pictures: [RgbImage; 2],
}

impl Beside {
    /// Both beside each other.
    pub fn sheet(&self) -> RgbImage {
        let [photo, mesh] = &self.pictures;
        RgbImage::from_fn(photo.width() + mesh.width(), photo.height().max(mesh.height()), |x, y| {
            let there = if x < photo.width() {
                photo.get_pixel_checked(x, y)
            } else {
                mesh.get_pixel_checked(x - photo.width(), y)
            };
            there.copied().unwrap_or(Rgb(BEHIND))
        })
    }
}

/// Of the photos that show all of the object the one that shows it largest, and the surface as seen from there; `None` if none does.
///
/// # Errors
/// If the records of the scan cannot be read.
pub fn beside_a_photo(twin: &Twin, surface: &Surface) -> Result<Option<Beside>> {
    let Some(config) = &twin.manifest.scan else { return Ok(None) };
    let Ok(capture) = cameras_of(&twin.path(&config.photos), &twin.root) else { return Ok(None) };
    let file: ScanFile = files::read_json(&twin.path(files::SCAN))?;
    let scan_from_mesh = mesh_from_scan(&file)?.inverse();
    let in_scan = Surface { mesh: scan_from_mesh.mesh(&surface.mesh), texture: surface.texture.clone() };
    let mut closest: Option<(f64, &drex_core::capture::View, PinholeCamera)> = None;
    for view in &capture.views {
        if let Some((camera, pixels)) = close_up(&in_scan.mesh.vertices, &view.lens, &view.camera_from_world, BESIDE)
            && closest.as_ref().is_none_or(|best| pixels > best.0)
        {
            closest = Some((pixels, view, camera));
        }
    }
    let Some((_, view, camera)) = closest else { return Ok(None) };
    let Ok(photo) = image::open(&view.photo) else { return Ok(None) };
    let mesh = render_from(&[in_scan.part(Pose::identity(), OBJECT_COLOR)], &camera);
    Ok(Some(Beside { photo: view.name.clone(), pictures: [resampled(&photo.to_rgb8(), &view.lens, &camera), mesh] }))
}

/// Photos spread over the capture.
fn shown(views: &[(String, PathBuf)]) -> Vec<(Vec<u8>, String)> {
    let step = views.len().div_ceil(PHOTOS).max(1);
    views
        .iter()
        .skip(step / 2)
        .step_by(step)
        .filter_map(|(name, photo)| Some((small(photo)?, format!("photo {name}"))))
        .collect()
}

/// A picture as JPEG, scaled down; `None` if it cannot be read. What is transparent shows what stands behind it.
fn small(path: &Path) -> Option<Vec<u8>> {
    let picture = image::open(path).ok()?.resize(PHOTO_SIDE, PHOTO_SIDE, image::imageops::FilterType::Triangle);
    let flat = match picture {
        DynamicImage::ImageRgba8(rgba) => RgbImage::from_fn(rgba.width(), rgba.height(), |x, y| {
            let p = rgba.get_pixel(x, y).0;
            let mix =
                |k: usize| (u32::from(p[k]) * u32::from(p[3]) + u32::from(BEHIND[k]) * (255 - u32::from(p[3]))) / 255;
            // A mean of two bytes is a byte.
            Rgb([0, 1, 2].map(|k| mix(k) as u8))
        }),
        other => other.to_rgb8(),
    };
    let mut jpeg = std::io::Cursor::new(Vec::new());
    flat.write_to(&mut jpeg, ImageFormat::Jpeg).ok()?;
    Some(jpeg.into_inner())
}

fn of_training(page: &mut Page, twin: &Twin, trained: &SplatReport, views: &[(String, PathBuf)]) {
    page.paragraph(&format!(
        "Of {} photos {} were trained on; {} were held out and are compared with what the Gaussians show from there. The mesh on which these are born \
         is of all photos, so the scores are too good as a forecast for new ones.",
        trained.photos_trained + trained.photos_held_out,
        trained.photos_trained,
        trained.photos_held_out
    ));
    let rendered = |name: &str| twin.path(HELD_OUT).join(Path::new(name).with_extension("png"));
    let mut pairs = Vec::new();
    for row in trained.appearance.held_out.rows.iter().take(PHOTOS / 2) {
        let photo = views.iter().find(|(name, _)| *name == row.name).and_then(|(_, photo)| small(photo));
        if let (Some(photo), Some(made)) = (photo, small(&rendered(&row.name))) {
            pairs.push((photo, format!("{}, held out: the photo", row.name)));
            let score = row.psnr.map_or(String::new(), |p| format!(", PSNR {p:.1} dB"));
            pairs.push((made, format!("{}: the Gaussians from there{score}", row.name)));
        }
    }
    page.pictures(&pairs);
    let told = |mean: Option<f64>, digits: usize| mean.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    let set = &trained.appearance;
    let rows = [vec![
        set.gaussians.to_string(),
        set.iterations.to_string(),
        told(set.held_out.mean(|r| r.psnr), 1),
        told(set.held_out.mean(|r| r.ssim), 3),
    ]];
    page.table(&["Gaussians", "steps", "PSNR of photos held out, dB (mean)", "SSIM (mean)"], &rows);
}

/// The Gaussians beside the mesh, turned together.
fn scenes(page: &mut Page, twin: &Twin, asset: &Asset, textured: Option<&Surface>, file: &ScanFile) -> Result<()> {
    let pose = asset.world_from_mesh_at_rest;
    let world = asset.visual.transformed(&pose);
    let Some((lo, hi)) = world.bounds() else { return Ok(()) };
    let around = Vector3::repeat(MARGIN * (hi - lo).norm());
    let (azimuth, elevation) = (-0.7, 0.35);
    let picture = || still(&asset.visual, &pose, azimuth, elevation);
    let mut shown = Vec::new();
    let looks = twin.path("splat/appearance.ply");
    if looks.exists() {
        let gaussians = read_gaussians(&looks, Kind::Ellipsoid)?;
        let moved = gaussians.transformed(&similarity(file, &pose)?)?;
        let mut scene = Scene::new(azimuth, elevation).linked("scan").framed((lo, hi));
        let (found, taken) = scene.splats(&moved, (lo - around, hi + around));
        let how =
            if taken < found { format!("the {MOST_SPLATS} strongest of {found}") } else { format!("all {found}") };
        if taken > 0 {
            let caption = format!("Gaussians around the object: {how}, each in its mean colour");
            shown.push((scene, picture_of_gaussians(twin).map_or_else(picture, Ok)?, caption));
        }
    }
    let mut scene = Scene::new(azimuth, elevation).linked("scan").framed((lo, hi)).on_table(0.0);
    let embedded = textured.and_then(|surface| scene.textured(surface));
    if let Some(mesh) = embedded.or_else(|| scene.mesh(&asset.visual, MESH_FACES)) {
        scene.part(mesh, Look::Solid, OBJECT_COLOR, &[pose.into()])?;
    }
    let still = match textured {
        Some(surface) => still_of(surface.part(pose, OBJECT_COLOR), azimuth, elevation)?,
        None => picture()?,
    };
    shown.push((scene, still, "the mesh made of the photos".to_owned()));
    page.viewers(&shown);
    Ok(())
}

/// What stands for the Gaussians where they cannot be drawn: one of the pictures of them from where a photo was held out.
fn picture_of_gaussians(twin: &Twin) -> Option<Vec<u8>> {
    let mut pictures: Vec<PathBuf> = std::fs::read_dir(twin.path(HELD_OUT))
        .ok()?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|p| p.extension().is_some_and(|e| e == "png"))
        .collect();
    pictures.sort();
    small(pictures.first()?)
}

/// world_from_scan.
fn similarity(file: &ScanFile, world_from_mesh: &drex_core::Pose) -> Result<Similarity3<f64>> {
    let s = mesh_from_scan(file)?;
    let mesh_from_scan = Similarity3::from_parts(Translation3::from(s.translation), s.rotation, s.scale);
    Ok(world_from_mesh * mesh_from_scan)
}

fn mesh_from_scan(file: &ScanFile) -> Result<Similarity> {
    let m = &file.scan.mesh_from_scan;
    Ok(Similarity::from_matrix(&Matrix4::from_fn(|r, c| m[r][c]))?)
}

fn of_frame(page: &mut Page, file: &ScanFile) {
    let (frame, fusion) = (&file.scan, &file.fusion);
    let mm = |m: f64| format!("{:.2} mm", 1e3 * m);
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let mut rows = vec![vec![
        "scale".to_owned(),
        format!("{:.5} m per unit of the scan, from {}", frame.metres_per_unit, frame.scale_from),
    ]];
    for d in frame.distances.iter().flat_map(|d| &d.distances) {
        let text = format!("given {}, in the scaled scan {}", mm(d.given_m), mm(d.model_m));
        rows.push(vec![format!("distance {}\u{2013}{}", d.from, d.to), text]);
    }
    let px = frame.table_rms_px.map_or(String::new(), |px| format!(", {px:.2} px"));
    let table = frame.table_rms_m.map_or(String::new(), |rms| format!(", its points within {}{px} (rms)", mm(rms)));
    rows.push(vec!["up".to_owned(), format!("from {}{table}", frame.up_from)]);
    if frame.others_on_table > 0 {
        rows.push(vec!["other things on the table".to_owned(), frame.others_on_table.to_string()]);
    }
    rows.push(vec!["depth maps fused".to_owned(), format!("{} of {}", fusion.used_views, fusion.views)]);
    rows.push(vec!["voxel".to_owned(), mm(fusion.voxel_m)]);
    rows.push(vec!["scatter of the depths about a surface".to_owned(), mm(fusion.spread_m)]);
    rows.push(vec!["volume".to_owned(), format!("{:.1} cm³", 1e6 * fusion.volume_m3)]);
    rows.push(vec![
        "surface".to_owned(),
        format!(
            "{} seen, {} made up, {} cut at the table",
            percent(fusion.seen_share),
            percent(fusion.unseen_share),
            percent(fusion.support_share)
        ),
    ]);
    if let Some(g) = &file.gaps {
        let [taken, parts] = g.parts;
        let text =
            format!("of surfels in {taken} of {parts} parts, where they show photos held out better than silhouettes");
        rows.push(vec!["what was not measured".to_owned(), text]);
    }
    if let Some(r) = &file.refinement {
        let text = format!("by {} in the median, {} at 95 %", mm(r.moved_m[0]), mm(r.moved_m[1]));
        rows.push(vec!["moved to where the photos agree".to_owned(), text]);
    }
    page.table(&["scale and fusion", "value"], &rows);
    for doubt in &frame.doubts {
        page.paragraph(&format!("In doubt: {doubt}"));
    }
    if frame.distances.as_ref().is_some_and(|d| d.distances.len() == 1) {
        page.paragraph("One distance gives the scale and cannot contradict it; a second one would check it.");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_scaled_and_what_is_transparent_shows_the_ground() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("half.png");
        let half = image::RgbaImage::from_fn(800, 400, |x, _| image::Rgba([255, 0, 0, if x < 400 { 255 } else { 0 }]));
        half.save(&path).unwrap();
        let small = image::load_from_memory(&small(&path).unwrap()).unwrap().to_rgb8();
        assert_eq!(small.dimensions(), (PHOTO_SIDE, PHOTO_SIDE / 2));
        let (left, right) = (small.get_pixel(40, 100).0, small.get_pixel(360, 100).0);
        assert!(left[0] > 240 && left[1] < 20, "{left:?}");
        assert!(right.iter().zip(BEHIND).all(|(a, b)| a.abs_diff(b) < 6), "{right:?}");
        assert!(super::small(&dir.path().join("missing.png")).is_none());
    }
}
