//! What the stage scan writes: where the mesh of the photos is, how it came about, how well Gaussians match them.

use std::collections::BTreeMap;
use std::fmt;

use drex_mesh::{FusionReport, ScaleFit, ScanEvidence, Similarity};
use nalgebra::Matrix4;
use serde::{Deserialize, Serialize};

use crate::Result;

/// Where the mesh of a scan is, and how it came about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScanFile {
    /// Scale, table, box; maps the scan onto the mesh.
    pub scan: FrameReport,
    /// Whether masks were made of the photos and used.
    #[serde(default)]
    pub made_masks: bool,
    /// The depth maps as they were fused.
    pub fusion: FusionReport,
    /// What shows best the surface that stereo did not measure, where that is much of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gaps: Option<GapReport>,
    /// How the photos moved the mesh; absent where its depth is not stereo's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refinement: Option<Refinement>,
    /// What the mesh was held against, masks left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub evidence: Option<ScanEvidence>,
}

impl ScanFile {
    /// The map from the frame and unit of the scan to metres in the frame of the mesh.
    ///
    /// # Errors
    /// If the matrix in the file is not a scale, a rotation and a translation.
    pub fn mesh_from_scan(&self) -> Result<Similarity> {
        let rows = &self.scan.mesh_from_scan;
        Ok(Similarity::from_matrix(&Matrix4::from_fn(|r, c| rows[r][c]))?)
    }
}

/// How a scan's frame was found; written as `mesh/scan.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameReport {
    /// Name of the folder of the scan.
    pub scan: String,
    /// Metres per unit of the scan.
    pub metres_per_unit: f64,
    /// Where the scale is from.
    pub scale_from: String,
    /// Known distances, as given and in the scaled scan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distances: Option<ScaleFit>,
    /// The marker that gave the scale; not read without the feature `stages`, whose crates look for markers.
    #[cfg(feature = "stages")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub marker: Option<drex_sfm::MarkerReport>,
    /// Marks in the frame of the mesh, metres.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub marks_m: BTreeMap<String, [f64; 3]>,
    /// Where up is from.
    pub up_from: String,
    /// Points that show the table.
    pub table_points: Option<usize>,
    /// Their root mean square distance from it, metres.
    pub table_rms_m: Option<f64>,
    /// The same in pixels: each distance divided by what a pixel of noise does to its point.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table_rms_px: Option<f64>,
    /// How much speaks for the table, from 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table_score: Option<f64>,
    /// What else the table could have been, best first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub other_planes: Vec<OtherPlane>,
    /// Up in the frame of the mesh.
    pub up_in_mesh: [f64; 3],
    /// Maps points of the scan to metres in the frame of the mesh; rows of a 4 x 4 matrix. Photos: the frame of the table,
    /// z up, the table z = 0; RGB-D recordings: the frame of the recording's poses.
    pub mesh_from_scan: [[f64; 4]; 4],
    /// Box that was meshed, metres, frame of the mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region_m: Option<[[f64; 3]; 2]>,
    /// What says which thing the object is.
    #[serde(default)]
    pub object_from: String,
    /// Other things that stand on the table.
    pub others_on_table: usize,
    /// Their boxes, metres, frame of the mesh.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub others_m: Vec<[[f64; 3]; 2]>,
    /// Why table or object may be the wrong one, in sentences.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub doubts: Vec<String>,
}

/// A plane that could have been the table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OtherPlane {
    /// Angle to the one taken, degrees.
    pub tilt_deg: f64,
    /// Height above the one taken, below the point that the cameras look at; metres.
    pub above_m: f64,
    /// Its score, from 0 to 1.
    pub score: f64,
}

/// What shows best the surface that stereo did not measure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GapReport {
    /// Its share of the mesh of stereo and silhouettes.
    pub share: f64,
    /// Photos that were held out.
    pub photos: usize,
    /// Their pixels that show it.
    pub pixels: f64,
    /// Peak signal-to-noise ratio there, dB, of what silhouettes leave of space,
    pub silhouettes_db: f64,
    /// and of what surfels show.
    pub surfels_db: f64,
    /// Parts of it in which surfels were taken, and all parts.
    pub parts: [usize; 2],
}

impl fmt::Display for GapReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { share, photos, silhouettes_db, surfels_db, parts: [taken, parts], .. } = self;
        write!(
            f,
            "stereo did not measure {:.0} % of the surface; there {photos} photos held out look like what silhouettes leave by {silhouettes_db:.1} dB, like \
             what surfels show by {surfels_db:.1} dB; surfels are taken in {taken} of {parts} parts",
            100.0 * share
        )
    }
}

/// How the photos moved the fused mesh to where they agree about it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Refinement {
    /// Passes that were made until it stopped.
    pub passes: usize,
    /// Share of the vertices that photos had a say in.
    pub seen_share: f64,
    /// How far vertices moved: median and 95 %, metres.
    pub moved_m: [f64; 2],
    /// Mean correlation of the photos' windows at full size, before and after.
    pub correlation: [Option<f64>; 2],
}

/// The part of `splat/report.json` that the report shows.
#[derive(Debug, Clone, Deserialize)]
pub struct SplatReport {
    /// Number of photos that the Gaussians learned from.
    pub photos_trained: usize,
    /// Number of photos that they were compared with.
    pub photos_held_out: usize,
    /// Ellipsoids, for looks.
    pub appearance: SplatSet,
}

/// A set of Gaussians.
#[derive(Debug, Clone, Deserialize)]
pub struct SplatSet {
    /// How many there are.
    pub gaussians: usize,
    /// Steps of the training.
    pub iterations: u32,
    /// Scores on the photos held out.
    pub held_out: SplatScores,
}

/// Scores on photos that were held out.
#[derive(Debug, Clone, Deserialize)]
pub struct SplatScores {
    /// One per photo.
    pub rows: Vec<SplatScore>,
}

/// How well a photo is matched.
#[derive(Debug, Clone, Deserialize)]
pub struct SplatScore {
    /// The photo.
    pub name: String,
    /// Peak signal-to-noise ratio, dB; not a number in the file where two pictures are equal.
    pub psnr: Option<f64>,
    /// Structural similarity, at most 1; not a number in the file where it is not defined.
    pub ssim: Option<f64>,
}

impl SplatScores {
    /// The mean over the photos that have a score.
    pub fn mean(&self, score: impl Fn(&SplatScore) -> Option<f64>) -> Option<f64> {
        let all: Vec<f64> = self.rows.iter().filter_map(score).collect();
        (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
    }
}
