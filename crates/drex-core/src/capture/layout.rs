//! Which layout a capture's folder has: COLMAP's model, `transforms.json`, or an RGB-D recording.

use std::path::{Path, PathBuf};

use super::assemble::{load_model, models_in};
use super::colmap::Model;
use super::{Capture, CaptureOptions, refuse, rgbd, transforms};
use crate::Result;

/// Reads the capture in whichever layout the folder has.
pub(super) fn load(folder: &Path, options: &CaptureOptions) -> Result<Capture> {
    let places = places_of_models(folder);
    if !places.is_empty() {
        return load_model(folder, &places, options);
    }
    match transforms::find(folder) {
        Some(file) => transforms::load(folder, &file, options),
        None if rgbd::is_recording(folder) => rgbd::load(folder, options),
        None => refuse(
            format!("{} has no COLMAP model, no transforms.json and no cam_K.txt", folder.display()),
            "put the model into sparse/0, or let drex sfm find the cameras of the photos",
        ),
    }
}

/// Whether the folder says where its photos were taken from.
pub(super) fn has_cameras(folder: &Path) -> bool {
    !places_of_models(folder).is_empty() || transforms::find(folder).is_some() || rgbd::is_recording(folder)
}

/// The folder's usual places, as far as there is a model.
fn places_of_models(folder: &Path) -> Vec<PathBuf> {
    let mut places = models_in(&folder.join("sparse"));
    places.extend(models_in(&folder.join("colmap/sparse")));
    if Model::is_in(folder) {
        places.insert(0, folder.into());
    }
    places
}
