//! From a model and a folder of files to a [`Capture`].

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::colmap::Model;
use super::companions::{Companions, photos_under, size_of, with_known_extension};
use super::{Capture, CaptureOptions, Keypoint, SparsePoint, View, refuse};
use crate::camera::Camera;
use crate::{Pose, Result};

/// A view before its files are looked up.
pub(super) struct Posed {
    pub(super) name: String,
    pub(super) photo: PathBuf,
    /// Files that the source names itself.
    pub(super) given: Companions,
    pub(super) lens: Camera,
    pub(super) camera_from_world: Pose,
    pub(super) keypoints: Vec<Keypoint>,
}

/// `folder` and the folders in it, as far as there is a model.
pub(super) fn models_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut places: Vec<_> = entries.map(|e| e.path()).filter(|p| p.is_dir()).collect();
    places.sort();
    places.push(folder.into());
    places.retain(|place| Model::is_in(place));
    places
}

/// The capture of the model with the most images of those in `places`.
pub(super) fn load_model(folder: &Path, places: &[PathBuf], options: &CaptureOptions) -> Result<Capture> {
    let mut models = Vec::new();
    for place in places {
        models.push((place, Model::load(place)?));
    }
    let sizes = models.iter().map(|(place, m)| format!("{} with {}", place.display(), count(m.images.len(), "image")));
    let sizes: Vec<_> = sizes.collect();
    // The first of equals.
    let Some((place, model)) = models.into_iter().rev().max_by_key(|(_, m)| m.images.len()) else {
        return refuse(format!("{} has no COLMAP model", folder.display()), "put it into sparse/0");
    };
    let mut notes = Vec::new();
    if sizes.len() > 1 {
        notes.push(format!("{} was used, the biggest of the models: {}.", place.display(), sizes.join(", ")));
    }
    from_colmap(folder, place, model, options, notes)
}

fn from_colmap(
    folder: &Path,
    place: &Path,
    model: Model,
    options: &CaptureOptions,
    mut notes: Vec<String>,
) -> Result<Capture> {
    let names: Vec<_> = model.images.iter().map(|i| i.name.as_str()).collect();
    let root = images_root(folder, place, &names, options);
    let mut by_point_id = BTreeMap::new();
    for (index, point) in model.points.iter().enumerate() {
        if by_point_id.insert(point.id, index).is_some() {
            return refuse(
                format!("{} has point {} twice", place.display(), point.id),
                "export the model again with `colmap model_converter`",
            );
        }
    }
    let (mut posed, mut ids, mut missing) = (Vec::new(), Vec::new(), Vec::new());
    for image in model.images {
        let Some(photo) = with_known_extension(&root.join(&image.name)) else {
            missing.push(image.name);
            continue;
        };
        let keypoints = image.keypoints.iter().map(|([x, y], id)| Keypoint {
            x: *x,
            y: *y,
            point: id.and_then(|id| by_point_id.get(&id).copied()),
        });
        posed.push(Posed {
            photo,
            given: Companions::default(),
            lens: image.lens,
            camera_from_world: image.camera_from_world,
            keypoints: keypoints.collect(),
            name: image.name.clone(),
        });
        ids.push((image.id, image.name));
    }
    if posed.is_empty() {
        return refuse(
            format!("none of the {} photos that {} names is in {}", missing.len(), place.display(), root.display()),
            "put the photos into the folder images, or name their folder",
        );
    }
    if !missing.is_empty() {
        missing.sort();
        notes.push(format!("{} of the model have no photo: {}.", count(missing.len(), "image"), missing.join(", ")));
    }
    let views = finish(folder, posed, options, &mut notes)?;
    let index_of = |name: &str| views.binary_search_by(|v| v.name.as_str().cmp(name)).ok();
    let view_of_id: BTreeMap<_, _> = ids.iter().filter_map(|(id, name)| Some((*id, index_of(name)?))).collect();
    let mut strays = 0;
    let points = model.points.into_iter().enumerate().map(|(index, point)| {
        // A track may name images whose photo is missing; what is left must agree with the keypoints.
        let entries = point.track.iter().filter_map(|(id, k)| Some((*view_of_id.get(id)?, *k as usize)));
        let entries: Vec<_> = entries.collect();
        let mut track = entries.clone();
        track.retain(|(view, k)| views[*view].keypoints.get(*k).is_some_and(|kp| kp.point == Some(index)));
        strays += entries.len() - track.len();
        track.sort_unstable();
        SparsePoint { position: point.position, rgb: point.rgb, error_px: point.error_px, track }
    });
    let points = points.collect();
    if strays > 0 {
        notes.push(format!(
            "{} of points name a keypoint that sees another point; left out.",
            count(strays, "sighting")
        ));
    }
    let unregistered = unregistered(&root, &views);
    Ok(Capture { folder: folder.into(), views, points, unregistered, notes })
}

/// The folder in which most of the names are files.
fn images_root(folder: &Path, place: &Path, names: &[&str], options: &CaptureOptions) -> PathBuf {
    if let Some(images) = &options.images {
        return images.clone();
    }
    let mut candidates = vec![folder.join("images"), folder.join("photos"), folder.join("input"), folder.into()];
    candidates.extend(place.ancestors().skip(1).take(2).map(|a| a.join("images")));
    let found = |root: &Path| names.iter().filter(|n| with_known_extension(&root.join(n)).is_some()).count();
    // The first of equals.
    let best = candidates.iter().rev().max_by_key(|root| found(root));
    best.unwrap_or(&candidates[0]).clone()
}

/// Looks up masks and maps, fits cameras to the photos' sizes and sorts by name.
pub(super) fn finish(
    folder: &Path,
    mut posed: Vec<Posed>,
    options: &CaptureOptions,
    notes: &mut Vec<String>,
) -> Result<Vec<View>> {
    posed.sort_by(|a, b| a.name.cmp(&b.name));
    if let Some(pair) = posed.windows(2).find(|pair| pair[0].name == pair[1].name) {
        return refuse(format!("two cameras are of the same photo, {}", pair[0].name), "keep one of them");
    }
    let mut views = Vec::with_capacity(posed.len());
    let mut scaled = Vec::new();
    for mut one in posed {
        let files = Companions::find(folder, &one.name, options);
        let size = size_of(&one.photo)?;
        let lens = lens_for(&one.name, &one.lens, size)?;
        if lens != one.lens {
            let [sx, sy] = [size[0] / one.lens.width_px() as f64, size[1] / one.lens.height_px() as f64];
            for keypoint in &mut one.keypoints {
                (keypoint.x, keypoint.y) = (keypoint.x * sx, keypoint.y * sy);
            }
            scaled.push(one.name.clone());
        }
        let mask = one.given.mask.or(files.mask);
        if let Some(mask) = &mask {
            let [w, h] = size_of(mask)?;
            if !same_aspect(size, [w, h]) {
                return refuse(
                    format!("the mask of {} has {w} x {h} pixels, the photo {} x {}", one.name, size[0], size[1]),
                    "give a mask of the photo's size, or scaled as a whole",
                );
            }
        }
        views.push(View {
            name: one.name,
            photo: one.photo,
            mask,
            depth: one.given.depth.or(files.depth),
            confidence: one.given.confidence,
            normal: one.given.normal.or(files.normal),
            lens,
            camera_from_world: one.camera_from_world,
            keypoints: one.keypoints,
        });
    }
    if !scaled.is_empty() {
        notes.push(format!(
            "{} of another size than their camera, which was scaled: {}.",
            if scaled.len() == 1 { "1 photo is".into() } else { format!("{} photos are", scaled.len()) },
            scaled.join(", ")
        ));
    }
    for (what, of) in [("mask", masks as fn(&View) -> bool), ("depth map", depths), ("normal map", normals)] {
        let without: Vec<_> = views.iter().filter(|v| !of(v)).map(|v| v.name.as_str()).collect();
        if !without.is_empty() && without.len() < views.len() {
            notes.push(format!("{} without a {what}: {}.", count(without.len(), "photo"), without.join(", ")));
        }
    }
    Ok(views)
}

fn masks(view: &View) -> bool {
    view.mask.is_some()
}

fn depths(view: &View) -> bool {
    view.depth.is_some()
}

fn normals(view: &View) -> bool {
    view.normal.is_some()
}

/// The lens for a photo of `size` pixels.
fn lens_for(name: &str, lens: &Camera, size: [f64; 2]) -> Result<Camera> {
    let camera = [f64::from(lens.width_px()), f64::from(lens.height_px())];
    if camera == size {
        return Ok(lens.clone());
    }
    if same_aspect(camera, size) {
        return lens.resized(size[0] as u32, size[1] as u32);
    }
    let turned = same_aspect([camera[1], camera[0]], size);
    refuse(
        format!("{name} has {} x {} pixels, its camera {} x {}", size[0], size[1], camera[0], camera[1]),
        if turned {
            "the photo is turned: store it as the camera saw it"
        } else {
            "give the photos that the cameras were calibrated with, or scale these as a whole"
        },
    )
}

/// Whether one image is the other scaled, with sides rounded to whole pixels either way.
pub(super) fn same_aspect(a: [f64; 2], b: [f64; 2]) -> bool {
    let (small, large) = if a[0] <= b[0] { (a, b) } else { (b, a) };
    (small[1] - large[1] * small[0] / large[0]).abs() <= 1.0 || (small[0] - large[0] * small[1] / large[1]).abs() <= 1.0
}

/// Photos under `root` that no view uses.
pub(super) fn unregistered(root: &Path, views: &[View]) -> Vec<String> {
    let mut used: Vec<_> = views.iter().map(|v| v.photo.as_path()).collect();
    used.sort_unstable();
    let all = photos_under(root);
    all.into_iter().filter(|p| used.binary_search(&p.path.as_path()).is_err()).map(|p| p.name).collect()
}

/// "1 photo", "2 photos".
pub(super) fn count(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}
