//! `[scan]`: what the object's mesh is made of, where none is given.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use drex_core::{Error, Result};
#[cfg(feature = "stages")]
use drex_sfm::marker::Marker;

use super::ObjectClick;

/// Photos, or a recording of a depth camera. The mesh that `[object]` names is made of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScanConfig {
    /// Folder of photos, with their cameras (COLMAP's model or transforms.json) or without, or of an RGB-D recording; or a video.
    pub photos: PathBuf,
    /// Metres per unit of the scan.
    pub scale: Option<f64>,
    /// Known distances between two marks, metres, by their names: `"A-C" = 0.12`. Their pixels are in `marks.json` of the scan.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub distances_m: BTreeMap<String, f64>,
    /// A printed AprilTag in the photos and the width of its black border in metres: `"tag36h11:11:0.06"`.
    pub marker: Option<String>,
    /// Folder of the masks (white is the object); `masks` in the folder of the photos if left out.
    pub masks: Option<PathBuf>,
    /// How much time depth, mesh and Gaussians may take; fast if left out.
    #[serde(default)]
    pub preset: ScanPreset,
    /// Steps of each set of Gaussians instead of the preset's.
    pub iterations: Option<u32>,
    /// Lower and upper corner of the object's box in the frame and unit of the scan, where it does not stand alone.
    pub region: Option<[[f64; 3]; 2]>,
    /// A pixel that shows the object, `"X,Y@PHOTO"`, where several things stand on the table.
    pub object: Option<ObjectClick>,
}

/// How much time depth, mesh and Gaussians may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScanPreset {
    /// A minute or two.
    #[default]
    Fast,
    /// Several minutes.
    Default,
    /// As long as it takes.
    Best,
}

#[cfg(feature = "stages")]
impl ScanPreset {
    pub(crate) fn of_stereo(self) -> drex_mvs::Preset {
        match self {
            Self::Fast => drex_mvs::Preset::Fast,
            Self::Default => drex_mvs::Preset::Default,
            Self::Best => drex_mvs::Preset::Best,
        }
    }

    pub(crate) fn of_training(self) -> drex_splat::train::Preset {
        match self {
            Self::Fast => drex_splat::train::Preset::Fast,
            Self::Default => drex_splat::train::Preset::Default,
            Self::Best => drex_splat::train::Preset::Best,
        }
    }
}

impl ScanConfig {
    /// The known distances: names of the two marks, metres.
    pub fn distances(&self) -> impl Iterator<Item = (&str, &str, f64)> {
        self.distances_m.iter().filter_map(|(pair, m)| pair.split_once('-').map(|(a, b)| (a, b, *m)))
    }

    /// The marker.
    #[cfg(feature = "stages")]
    pub fn marker(&self) -> Option<Marker> {
        // It was checked when the manifest was read.
        self.marker.as_ref().and_then(|m| m.parse().ok())
    }

    pub(super) fn check(&self) -> Result<()> {
        let refuse = |what: String, remedy: &str| Err(Error::value(what, remedy));
        if let Some(scale) = self.scale
            && !(scale > 0.0 && scale.is_finite())
        {
            return refuse(format!("[scan] scale = {scale}"), "give metres per unit of the scan, a positive number");
        }
        let sources = [
            ("scale", self.scale.is_some()),
            ("distances_m", !self.distances_m.is_empty()),
            ("marker", self.marker.is_some()),
        ];
        let given: Vec<&str> = sources.into_iter().filter(|(_, given)| *given).map(|(name, _)| name).collect();
        if given.len() > 1 {
            return refuse(format!("[scan] has {}, which all give the scale", given.join(" and ")), "keep one of them");
        }
        // Without the stages nobody looks for it.
        #[cfg(feature = "stages")]
        if let Some(Err(error)) = self.marker.as_ref().map(|m| m.parse::<Marker>()) {
            return Err(error);
        }
        for (pair, metres) in &self.distances_m {
            let marks = pair.split_once('-').filter(|(a, b)| !a.is_empty() && !b.is_empty() && a != b);
            if marks.is_none() || !(*metres > 0.0 && metres.is_finite()) {
                return refuse(
                    format!("[scan] distances_m: \"{pair}\" = {metres}"),
                    "name two marks and their distance in metres, such as \"A-C\" = 0.12",
                );
            }
        }
        if self.iterations == Some(0) {
            return refuse("[scan] iterations = 0".into(), "give a positive number or leave it out");
        }
        if let Some([lo, hi]) = self.region
            && !(0..3).all(|i| lo[i] < hi[i])
        {
            return refuse("[scan] region is empty".into(), "give the lower corner first: [[x, y, z], [x, y, z]]");
        }
        if self.region.is_some() && self.object.is_some() {
            return refuse("[scan] has both region and object".into(), "keep one of them");
        }
        Ok(())
    }
}
