//! The rules for what a scan says of its mesh: an asset that contradicts its photos is refused or doubted.

use drex_core::mesh::sample_surface;
use drex_core::pose::pose_from_wxyz;
use drex_core::stats::{median, quantile};
use drex_core::{ConvexPart, Pose, PoseRecord, TriMesh};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Outcome::{Doubt, Fail, NotApplicable, Pass};
use super::{CheckReport, Outcome, RuleResult};
use crate::asset::UNCOVERED;
use crate::partition::union_distance;
use crate::sdf::MeshSdf;
use crate::sequence::unit_cube_point;
use crate::{DepthCamera, cast_depth};

/// The first rule of this file.
const FIRST: usize = 17;
/// Points of the surface and of the volume that are asked.
const SAMPLES: usize = 8000;
/// Distance of the support's points from it, root mean square, pixels: doubt, failure.
const SUPPORT_PX: [f64; 2] = [2.0, 5.0];
/// Share of the cameras below the support: doubt, failure.
const BELOW: [f64; 2] = [0.0, 0.1];
/// Share of the surface at the region's border: doubt, failure.
const BORDER: [f64; 2] = [0.0, 0.01];
/// A point is at the border within this many voxels.
const AT_BORDER: f64 = 0.75;
/// What is lower than this many voxels above the support may be at the border: the support is one.
const AT_SUPPORT: f64 = 2.0;
/// Share of the surface that too few photos have in their picture: doubt, failure.
const UNSEEN: [f64; 2] = [0.01, 0.1];
/// Photos that must have a point in their picture, at least two.
const FEW: f64 = 0.1;
/// Share of the volume outside the visual hull: doubt, failure.
const OUTSIDE: [f64; 2] = [0.03, 0.1];
/// Share of the masks that may be wrong about a point.
const WRONG_MASKS: f64 = 0.04;
/// One minus the intersection over union of silhouette and mask, median over the photos: doubt, failure.
const SILHOUETTE: [f64; 2] = [0.1, 0.3];

/// What a scan knows of its object besides the mesh; metres, frame of the mesh.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanEvidence {
    /// The plane that it stood on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub support: Option<SupportEvidence>,
    /// The cameras, without distortion.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<ScanCamera>,
    /// Lower and upper corner of the box that was meshed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region_m: Option<[[f64; 3]; 2]>,
    /// Whether a person gave that box.
    #[serde(default)]
    pub region_given: bool,
    /// Side of a voxel.
    #[serde(default)]
    pub voxel_m: f64,
    /// Silhouettes of the object; not kept in files.
    #[serde(skip)]
    pub silhouettes: Vec<Silhouette>,
}

/// The plane that an object stood on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SupportEvidence {
    /// A point of it.
    pub point_m: [f64; 3],
    /// Its upward normal.
    pub up: [f64; 3],
    /// Root mean square distance of its points, pixels; `None` if it was not found among points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rms_px: Option<f64>,
}

impl SupportEvidence {
    fn height(&self, p: &Point3<f64>) -> f64 {
        let up = Vector3::from(self.up).try_normalize(0.0).unwrap_or_default();
        up.dot(&(p - Point3::from(self.point_m)))
    }
}

/// A camera of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScanCamera {
    /// Columns of the image.
    pub width_px: u32,
    /// Rows of the image.
    pub height_px: u32,
    /// Focal lengths, pixels.
    pub focal_px: [f64; 2],
    /// Principal point, pixels.
    pub principal_px: [f64; 2],
    /// Where it stands (OpenCV axes).
    pub world_from_camera: PoseRecord,
}

/// What a mask shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Silhouette {
    /// The camera, at the mask's size.
    pub camera: DepthCamera,
    /// Where it stands.
    pub world_from_camera: Pose,
    /// Row-major: whether a pixel shows the object.
    pub mask: Vec<bool>,
    /// Name of the photo.
    pub name: String,
}

impl ScanCamera {
    fn pose(&self) -> Option<Pose> {
        pose_from_wxyz(self.world_from_camera.translation_m, self.world_from_camera.quat_wxyz).ok()
    }
}

/// Asks what a scan says of its mesh: rules 17 to 23 of a [`CheckReport`], in order.
///
/// `mesh` is the visual mesh, `parts` its convex parts (none: rule 17 is not asked); both in metres in the frame of `evidence`.
pub fn check_scan(mesh: &TriMesh, parts: &[ConvexPart], evidence: &ScanEvidence) -> Vec<RuleResult> {
    let mut report = CheckReport::new("the scan");
    covered(mesh, parts, &mut report);
    evaluate(mesh, evidence, &mut report);
    report.rules.split_off(FIRST - 1)
}

/// What a share means: nothing, a doubt or a contradiction.
fn grade(value: f64, [doubt, fail]: [f64; 2]) -> Outcome {
    match value {
        v if !(v <= fail) => Fail,
        v if v > doubt => Doubt,
        _ => Pass,
    }
}

/// Rule 17: the convex parts are what touches; they must be where the mesh is.
pub(super) fn covered(mesh: &TriMesh, parts: &[ConvexPart], report: &mut CheckReport) {
    if parts.is_empty() {
        return report.set(17, NotApplicable, "there are no convex parts", None);
    }
    match union_distance(mesh, parts, SAMPLES, 0) {
        Err(e) => report.set(17, NotApplicable, format!("not measured: {e}"), None),
        Ok(d) => report.set(
            17,
            grade(d.uncovered_share, UNCOVERED),
            format!("{:.1} % of the volume is in no convex part", 100.0 * d.uncovered_share),
            (d.uncovered_share > UNCOVERED[0]).then_some("make the convex parts again, with more of them"),
        ),
    }
}

/// Rules 18 to 23.
pub(super) fn evaluate(mesh: &TriMesh, evidence: &ScanEvidence, report: &mut CheckReport) {
    let surface: Vec<Point3<f64>> = sample_surface(mesh, SAMPLES, 0).into_iter().map(|s| s.point).collect();
    if surface.is_empty() {
        return;
    }
    support(evidence, report);
    border(&surface, evidence, report);
    seen(mesh, &surface, evidence, report);
    if evidence.silhouettes.is_empty() {
        for rule in [22, 23] {
            report.set(rule, NotApplicable, "there are no masks to ask", None);
        }
    } else {
        visual_hull(mesh, &evidence.silhouettes, report);
        silhouettes(mesh, &evidence.silhouettes, report);
    }
}

/// Rules 18 and 19.
fn support(evidence: &ScanEvidence, report: &mut CheckReport) {
    let Some(support) = &evidence.support else {
        for rule in [18, 19] {
            report.set(rule, NotApplicable, "no support was found among the points", None);
        }
        return;
    };
    match support.rms_px {
        None => report.set(18, NotApplicable, "the support was not found among points", None),
        Some(px) => {
            let reason = format!("its points lie {px:.2} px off it (root mean square)");
            let fix = "photograph the object on a flat surface with texture, state up with --up, or give masks";
            report.set(18, grade(px, SUPPORT_PX), reason, (!(px <= SUPPORT_PX[0])).then_some(fix));
        }
    }
    let poses: Vec<Pose> = evidence.cameras.iter().filter_map(ScanCamera::pose).collect();
    if poses.is_empty() {
        return report.set(19, NotApplicable, "no cameras are recorded", None);
    }
    let below = poses.iter().filter(|p| !(support.height(&p.translation.vector.into()) > 0.0)).count();
    let share = below as f64 / poses.len() as f64;
    let reason = format!("{below} of {} cameras are below it", poses.len());
    let fix = "the plane taken for the table is not what the object stood on: state up with --up, or give masks";
    report.set(19, grade(share, BELOW), reason, (below > 0).then_some(fix));
}

/// Rule 20: what reaches the border of the box was cut there.
fn border(surface: &[Point3<f64>], evidence: &ScanEvidence, report: &mut CheckReport) {
    let Some([lo, hi]) = evidence.region_m.map(|r| r.map(Point3::from)) else {
        return report.set(20, NotApplicable, "the mesh was not cut by a region", None);
    };
    let near = AT_BORDER * evidence.voxel_m;
    let at_border = |p: &&Point3<f64>| {
        let inside = (*p - lo).inf(&(hi - *p)).min();
        let standing = evidence.support.is_none_or(|s| s.height(p) > AT_SUPPORT * evidence.voxel_m);
        inside <= near && standing
    };
    let share = surface.iter().filter(at_border).count() as f64 / surface.len() as f64;
    let mut outcome = grade(share, BORDER);
    // A person may want to cut.
    if evidence.region_given && outcome == Fail {
        outcome = Doubt;
    }
    let reason = format!("{:.1} % of the surface is at the border of the region", 100.0 * share);
    let fix = "what is meshed goes on outside the box: name the object with --object or give a larger --region";
    report.set(20, outcome, reason, (outcome != Pass).then_some(fix));
}

/// Rule 21: nobody saw what no photo has in its picture, and cameras stand outside of what they show.
fn seen(mesh: &TriMesh, surface: &[Point3<f64>], evidence: &ScanEvidence, report: &mut CheckReport) {
    let cameras: Vec<(&ScanCamera, Pose)> = evidence.cameras.iter().filter_map(|c| Some((c, c.pose()?))).collect();
    let Some((lo, hi)) = mesh.bounds().filter(|_| cameras.len() >= 2) else {
        return report.set(21, NotApplicable, "no cameras are recorded", None);
    };
    let fix = Some(
        "the mesh is larger than what was photographed: name the object with --object, or give its --region or masks",
    );
    let within = |p: &Point3<f64>| (0..3).all(|k| lo[k] <= p[k] && p[k] <= hi[k]);
    let inside = cameras.iter().filter(|(_, pose)| within(&pose.translation.vector.into())).count();
    if inside > 0 {
        return report.set(21, Fail, format!("{inside} of {} cameras are inside its bounding box", cameras.len()), fix);
    }
    let least = ((FEW * cameras.len() as f64).ceil() as usize).max(2);
    let shows = |p: &Point3<f64>, (c, pose): &(&ScanCamera, Pose)| {
        let q = pose.inverse_transform_point(p);
        let at = |k: usize| c.focal_px[k] * q[k] / q.z + c.principal_px[k];
        q.z > 0.0 && (0.0..f64::from(c.width_px)).contains(&at(0)) && (0.0..f64::from(c.height_px)).contains(&at(1))
    };
    let unseen = surface.par_iter().filter(|p| cameras.iter().filter(|c| shows(p, c)).count() < least).count();
    let share = unseen as f64 / surface.len() as f64;
    let reason = format!("{:.1} % of the surface is in the picture of fewer than {least} photos", 100.0 * share);
    let outcome = grade(share, UNSEEN);
    report.set(21, outcome, reason, fix.filter(|_| outcome != Pass));
}

impl Silhouette {
    /// Whether the mask has the object within a pixel of a point's; `None` if the point is not in the picture.
    pub(crate) fn shows(&self, p: &Point3<f64>) -> Option<bool> {
        let (c, q) = (&self.camera, self.world_from_camera.inverse_transform_point(p));
        let (x, y) = (c.fx_px * q.x / q.z + c.cx_px, c.fy_px * q.y / q.z + c.cy_px);
        let (w, h) = (c.width_px as usize, c.height_px as usize);
        if !(q.z > 0.0 && x >= 0.0 && y >= 0.0 && x < w as f64 && y < h as f64) || self.mask.len() != w * h {
            return None;
        }
        let (x, y) = (x as usize, y as usize);
        let (columns, rows) = (x.saturating_sub(1)..(x + 2).min(w), y.saturating_sub(1)..(y + 2).min(h));
        Some(rows.into_iter().any(|r| columns.clone().any(|c| self.mask[r * w + c])))
    }

    /// Column and row of its pixels that lie beside one that does not show the object; none of a malformed mask.
    pub(crate) fn rim(&self) -> Vec<(u32, u32)> {
        let (w, h) = (self.camera.width_px as usize, self.camera.height_px as usize);
        let inner = self.mask.len() == w * h && w > 2 && h > 2;
        let at = |x: usize, y: usize| self.mask[y * w + x];
        let pixels = (1..h.saturating_sub(1)).flat_map(|y| (1..w.saturating_sub(1)).map(move |x| (x, y)));
        pixels
            .filter(|_| inner)
            .filter(|&(x, y)| at(x, y) && !(at(x - 1, y) && at(x + 1, y) && at(x, y - 1) && at(x, y + 1)))
            .map(|(x, y)| (x as u32, y as u32))
            .collect()
    }
}

impl Silhouette {
    /// Intersection over union of the mesh's silhouette and the mask; `None` if neither shows anything.
    fn overlap(&self, mesh: &TriMesh) -> Option<f64> {
        if self.mask.len() != self.camera.pixels() {
            return None;
        }
        let depth = cast_depth(mesh, &self.camera, &self.world_from_camera).depth_m;
        let pairs = || self.mask.iter().zip(&depth).map(|(m, z)| (*m, *z > 0.0));
        let both = pairs().filter(|(a, b)| *a && *b).count();
        let either = pairs().filter(|(a, b)| *a || *b).count();
        (either > 0).then(|| both as f64 / either as f64)
    }
}

/// Rule 22: the object is in the cone of every mask.
fn visual_hull(mesh: &TriMesh, masks: &[Silhouette], report: &mut CheckReport) {
    let Ok(solid) = MeshSdf::new(mesh) else {
        return report.set(22, NotApplicable, "the mesh encloses no volume", None);
    };
    let (lo, hi) = mesh.bounds().unwrap_or_default();
    let allowed = (WRONG_MASKS * masks.len() as f64).ceil() as usize;
    let in_hull = |p: &Point3<f64>| masks.iter().filter(|m| m.shows(p) == Some(false)).count() <= allowed;
    let [inside, outside, hull] = (0..SAMPLES)
        .into_par_iter()
        .map(|i| {
            let p = lo + (hi - lo).component_mul(&Vector3::from(unit_cube_point(i)));
            let (solid, hull) = (solid.contains(&p), in_hull(&p));
            [usize::from(solid), usize::from(solid && !hull), usize::from(hull)]
        })
        .reduce(|| [0; 3], |a, b| [0, 1, 2].map(|k| a[k] + b[k]));
    let share = outside as f64 / inside.max(1) as f64;
    let cm3 = 1e6 * (hi - lo).product() / SAMPLES as f64;
    let reason = format!(
        "{:.1} % of the volume ({:.1} cm3) is outside the visual hull of {} masks ({:.1} cm3 in the mesh's box)",
        100.0 * share,
        cm3 * inside as f64,
        masks.len(),
        cm3 * hull as f64
    );
    let outcome = grade(share, OUTSIDE);
    let fix =
        "the mesh holds what is not the object, or masks or cameras are wrong: look at the photos named in rule 23";
    report.set(22, outcome, reason, (outcome != Pass).then_some(fix));
}

/// Rule 23: photos see the mesh where they see the object.
fn silhouettes(mesh: &TriMesh, masks: &[Silhouette], report: &mut CheckReport) {
    let overlaps: Vec<(f64, &str)> = masks.iter().filter_map(|m| Some((m.overlap(mesh)?, m.name.as_str()))).collect();
    let Some(typical) = median(overlaps.iter().map(|o| o.0)) else {
        return report.set(23, NotApplicable, "no mask shows anything", None);
    };
    let low = quantile(overlaps.iter().map(|o| o.0), 0.1).unwrap_or(0.0);
    let worst = overlaps.iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or("", |o| o.1);
    let reason = format!(
        "intersection over union of silhouette and mask {typical:.3} (median of {} photos), {low:.3} for one in ten, worst in {worst}",
        overlaps.len()
    );
    let outcome = grade(1.0 - typical, SILHOUETTE);
    let fix = "mesh and photos disagree: check masks and cameras, the scale of the voxels, and the region";
    report.set(23, outcome, reason, (outcome != Pass).then_some(fix));
}
