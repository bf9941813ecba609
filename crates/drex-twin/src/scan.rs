//! From a scan to a closed mesh: what fusion asks for are depth maps in metres, in the frame of the mesh, the object's box and the
//! table.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::Result;
use crate::error::{Context, refuse};
use drex_core::capture::{Capture, CaptureOptions, CaptureReport, PhotoOptions, Photos, ViewReport};
use drex_core::{Pose, PoseRecord, TriMesh, fsutil};
use drex_mesh::{
    DecimateOptions, DepthCamera, DepthMap, DepthViews, Evidence, EvidenceKind, Fused, FusionOptions, Outcome,
    RuleResult, ScanCamera, ScanEvidence, ScenePoint, Silhouette, Similarity, Support, SupportEvidence, SurfaceShares,
    TextureMap, check_scan, decimate, fuse,
};
pub use drex_mvs::TextureReport;
use drex_mvs::{Hold, MvsOptions, RefineOptions, Region, refine};
use drex_sfm::marker::Marker;
use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::Progress;
use crate::manifest::ScanPreset;
use crate::masks::{MASKS, MaskReport, Masks, made_masks_in, object_masks};
pub use crate::place::FrameOptions;
use crate::place::{self, box_around, sparse_points};
use crate::reconstruct::{Cameras, ScanInput, gpu_is_there};
use crate::records::{FrameReport, GapReport, Refinement};
use crate::scale::{DEPTH_CAMERA, Scale};
use crate::stereo::{self, DEPTH, Frame, frames};
use crate::surfels::{Drawn, Gaps};
use crate::texture::textured;

/// The mesh of a scan keeps to the fused one within this share of a voxel.
const MAX_SIMPLIFICATION_VOXELS: f64 = 0.1;
/// So many depth maps of stereo, counted by confidence, have to see through a place before it is empty: single ones are wrong here and there.
const STEREO_VOTES: f64 = 1.5;
/// Confidence of a depth that counts as much as one without.
const USUAL_CONFIDENCE: f32 = 0.45;
/// Small parts that fewer views measured, as a share of those of the largest part, are none of the object: where little is known stereo makes some up.
const STEREO_PARTS: f64 = 0.5;
/// More masks say nothing new about where the object stands, and take memory.
const MOST_SILHOUETTES: usize = 100;
/// Longest side of the masks that a mesh is held against, pixels.
const SILHOUETTE_PX: u32 = 240;
/// Where more of the surface was not measured it is worth minutes to ask surfels.
const MUCH: f64 = 0.25;
/// In the middle of a wider sector without a camera a side of the object is seen at less than 30 degrees, or not at all.
const WIDEST_GAP_DEG: f64 = 120.0;
/// Every n-th pixel of a depth map stands for the scene where there are no sparse points; both ways.
const PIXEL_STEP: usize = 12;

/// A scan that is to be meshed.
pub struct Scanning<'a> {
    /// Folder of photos or of an RGB-D recording, or a video.
    pub input: &'a Path,
    /// Folder for cameras, masks and depth maps.
    pub out: &'a Path,
    /// Folder of the masks, where it is not the scan's own.
    pub masks: Option<PathBuf>,
    /// Folder of the object's poses in an RGB-D recording.
    pub poses: Option<PathBuf>,
    /// What is known of its frame.
    pub frame: FrameOptions,
    /// Side of a voxel, metres.
    pub voxel_m: Option<f64>,
    /// A printed tag in the photos, which gives the scale.
    pub marker: Option<Marker>,
    /// The program COLMAP, where it is to find the cameras of photos that have none.
    pub colmap: Option<PathBuf>,
    /// How carefully depth is looked for, where there are no depth maps yet.
    pub preset: ScanPreset,
    /// Whether depth is looked for on the GPU, which takes the feature `wgpu`.
    pub on_gpu: bool,
    /// Of everything random.
    pub seed: u64,
    /// ffmpeg, or a step of COLMAP, is stopped after this time.
    pub tool_limit: Duration,
}

/// The closed mesh of a scan, metres.
pub struct Meshed {
    /// The depth maps in the frame of the mesh.
    pub scan: Scan,
    /// What they were fused to.
    pub fused: Fused,
    /// What shows best the part that stereo did not measure, where that is large.
    pub gaps: Option<GapReport>,
    /// How it was moved to where the photos agree, where its depth is stereo's.
    pub refinement: Option<Refinement>,
    /// The mesh that was made of it: moved, and simpler.
    pub mesh: TriMesh,
    /// What the mesh was held against.
    pub evidence: ScanEvidence,
    /// The photos with their cameras and the masks that were used.
    pub cameras: Capture,
    /// The masks that were made and used, where there were none.
    pub masks: Option<MaskReport>,
}

impl Scanning<'_> {
    /// Photos to depth maps, or depth maps as they are, to a closed mesh, which is moved to where the photos agree about it.
    ///
    /// # Errors
    /// If the scan cannot be read, has no scale or too little of the object is seen.
    pub fn mesh(&self, progress: &dyn Progress) -> Result<Meshed> {
        if self.on_gpu {
            gpu_is_there()?;
        }
        let mut within = CaptureOptions::default();
        within.masks.clone_from(&self.masks);
        within.poses.clone_from(&self.poses);
        if self.marker.is_none() && !Capture::is_in(self.input) {
            // Finding cameras takes minutes.
            Scale::check(self.input, &self.frame)?;
        }
        let input = ScanInput {
            scan: self.input,
            out: self.out,
            within,
            marker: self.marker,
            seed: self.seed,
            colmap: self.colmap.as_deref(),
            ffmpeg: Path::new("ffmpeg"),
            limit: self.tool_limit,
        };
        let Cameras { capture: mut cameras, marker, found_now, .. } = input.cameras(progress)?;
        let scale = match marker {
            Some(marker) => Scale::by_marker(marker),
            None => Scale::new(&cameras, &self.frame)?,
        };
        if found_now {
            // Depth maps of earlier cameras have another frame.
            remove_depth_maps(self.out)?;
        }
        let (masks, region) = self.make_masks(&mut cameras, progress)?;
        let made_masks = masks.is_some();
        let mut meshed = self.fused(&cameras, masks, region.as_ref(), scale.clone(), progress)?;
        let mut rules = check_scan(&meshed.mesh, &[], &meshed.evidence);
        if made_masks && meshed.masks.is_some() && rules.iter().any(at_odds_with_masks) {
            progress.note(&format!(
                "the mesh does not agree with the masks that were made: they are not used, and the object is cut out by its box; \
                 correct those in {} and give them by --masks",
                self.out.join(MASKS).display()
            ));
            cameras.views.iter_mut().for_each(|v| v.mask = None);
            remove_depth_maps(self.out)?;
            meshed = self.fused(&cameras, None, region.as_ref(), scale, progress)?;
            rules = check_scan(&meshed.mesh, &[], &meshed.evidence);
        }
        meshed.scan.frame.doubts.extend(contradictions(&rules, self.input)?);
        for doubt in &meshed.scan.frame.doubts {
            progress.note(&format!("doubt: {doubt}"));
        }
        Ok(meshed)
    }

    /// The closed mesh of photos with their cameras, and with the masks that were made of them.
    fn fused(
        &self,
        cameras: &Capture,
        masks: Option<MaskReport>,
        region: Option<&Region>,
        scale: Scale,
        progress: &dyn Progress,
    ) -> Result<Meshed> {
        let report = cameras.report()?;
        let (depths, masked, stereo) = self.depth_maps(cameras, &report, masks.is_some(), region, progress)?;
        progress.begin("fusion", None);
        let mut scan = Scan::new(cameras, &depths, masked, scale, &self.frame)?;
        // Depth maps of an earlier run may show the whole scene.
        let masks = masks.filter(|_| masked);
        if let Some(masks) = &masks {
            scan.frame.object_from = format!("masks of {}", masks.object_from);
            scan.frame.others_on_table = masks.others_on_table;
            scan.frame.doubts.extend(masks.doubts.iter().cloned());
        }
        let mut fusion = scan.fusion.clone();
        fusion.voxel_m = self.voxel_m;
        if stereo.is_some() {
            (fusion.empty_votes, fusion.least_views_share) = (STEREO_VOTES, STEREO_PARTS);
        }
        let mut fused =
            fuse(&scan, &fusion).with_context(|| format!("fusing the depth maps of {}", self.input.display()))?;
        progress.end();
        let mut gaps = None;
        if stereo.is_some() && masked && fused.report.unseen_share > MUCH {
            gaps = self.without_gaps(&depths, &mut scan, &mut fused, &fusion, progress).map_or_else(
                |e| {
                    progress.note(&format!("what stereo did not measure is left as silhouettes leave it: {e}"));
                    scan.drawn = None;
                    None
                },
                Some,
            );
        }
        if let Some(coverage) = &report.coverage {
            scan.frame.doubts.extend(one_sided(coverage.azimuth_gap_deg, fused.report.unseen_share));
        }
        let (refined, refinement) = match stereo {
            Some(options) => {
                let (mesh, refinement) = self.refined(cameras, options.max_side, &scan, &fused, progress)?;
                (mesh, Some(refinement))
            }
            None => (fused.mesh.clone(), None),
        };
        progress.begin("simpler mesh", None);
        let mut simpler = DecimateOptions::default();
        simpler.max_error_m = Some(MAX_SIMPLIFICATION_VOXELS * fused.report.voxel_m);
        let (mut mesh, _) = decimate(&refined, &simpler)?;
        if let Some(support) = &fusion.support {
            snap_to_table(&mut mesh, support, fused.report.voxel_m);
        }
        progress.end();
        let evidence = scan.evidence(fused.report.voxel_m, self.frame.region.is_some())?;
        Ok(Meshed { scan, fused, gaps, refinement, mesh, evidence, cameras: cameras.clone(), masks })
    }

    /// Fuses again with surfels in those parts that stereo did not measure and photos held out want them in.
    fn without_gaps(
        &self,
        depths: &Capture,
        scan: &mut Scan,
        fused: &mut Fused,
        fusion: &FusionOptions,
        progress: &dyn Progress,
    ) -> Result<GapReport> {
        let scan_from_mesh = scan.mesh_from_scan.inverse();
        let mesh = scan_from_mesh.mesh(&fused.mesh);
        let gaps = Gaps::new(&mesh, fused, scan_from_mesh.scale, depths);
        let drawn = gaps.drawn(self.preset.of_training(), self.seed, self.out, progress)?;
        let again = |scan: &Scan| {
            progress.begin("fusion with surfels", None);
            let again = fuse(scan, fusion);
            progress.end();
            again.with_context(|| format!("fusing the depth maps of {} with surfels", self.input.display()))
        };
        scan.drawn = Some(drawn);
        let all = again(scan)?;
        let (other, measured) = (scan_from_mesh.mesh(&all.mesh), fused.evidence_of(&all.mesh));
        let (parts, report) = gaps.better_parts(&other, &measured, progress)?;
        if let Some(drawn) = &mut scan.drawn {
            drawn.parts = Some(parts);
        }
        progress.note(&report.to_string());
        let mut chosen = again(scan)?;
        let measured = fused.evidence_of(&chosen.mesh);
        for (evidence, measured) in chosen.evidence.iter_mut().zip(measured) {
            if evidence.kind == EvidenceKind::Seen && measured.kind == EvidenceKind::Unseen {
                *evidence = Evidence { kind: EvidenceKind::Surfels, ..measured };
            }
        }
        let shares = SurfaceShares::of(&chosen.mesh, &chosen.evidence);
        (chosen.report.seen_share, chosen.report.unseen_share) = (shares.measured, shares.silhouettes);
        *fused = chosen;
        Ok(report)
    }

    /// Makes masks of photos that have none, and gives them to the views. If most of them are doubtful, the object is cut out
    /// of the scene by its box later. Also the box in which the object is, where something tells.
    fn make_masks(
        &self,
        cameras: &mut Capture,
        progress: &dyn Progress,
    ) -> Result<(Option<MaskReport>, Option<Region>)> {
        let given = self.frame.region.map(|corners| Region { box_from_world: Pose::identity(), corners });
        // Depth maps of an earlier run without made masks are gone on with as they are.
        let earlier = self.out.join(DEPTH).join("transforms.json").is_file() && !made_masks_in(self.out);
        if earlier || cameras.views.iter().any(|v| v.mask.is_some() || v.depth.is_some()) {
            return Ok((None, given));
        }
        let Masks { report, files, changed, .. } = object_masks(cameras, &self.frame, self.out, progress)?;
        if changed {
            remove_depth_maps(self.out)?;
        }
        let region = Some(stereo::region_of(&report)?);
        let doubtful = report.doubtful().len();
        if 2 * doubtful > report.photos.len() {
            progress.note(&format!(
                "masks are doubtful in {doubtful} of {} photos and not used; correct those in {} and give them by --masks",
                report.photos.len(),
                self.out.join(MASKS).display()
            ));
            return Ok((None, region));
        }
        for (view, file) in cameras.views.iter_mut().zip(files) {
            view.mask = Some(file);
        }
        Ok((Some(report), region))
    }

    /// The capture with the depth maps, made where there are none; whether these show the object alone; and of those that stereo
    /// found, how.
    fn depth_maps(
        &self,
        cameras: &Capture,
        report: &CaptureReport,
        made_masks: bool,
        region: Option<&Region>,
        progress: &dyn Progress,
    ) -> Result<(Capture, bool, Option<MvsOptions>)> {
        report.faults().iter().for_each(|fault| progress.note(fault));
        if cameras.views.iter().all(|v| v.depth.is_some()) {
            let masked = cameras.views.iter().all(|v| v.mask.is_some());
            return Ok((cameras.clone(), masked, None));
        }
        let folder = self.out.join(DEPTH);
        if folder.join("transforms.json").is_file() {
            progress.note(&format!("going on with the depth maps in {}", folder.display()));
            let maps = Capture::load(&folder, &CaptureOptions::default())?;
            // Their pictures are transparent where masks cut the object out.
            let masked = Photos::new(&maps, PhotoOptions::default())?.get(0)?.mask.is_some();
            return Ok((maps, masked, Some(self.stereo_options(cameras, region)?)));
        }
        let masked = cameras.views.iter().any(|v| v.mask.is_some());
        let options = self.stereo_options(cameras, region)?;
        let misplaced = |v: &ViewReport| v.far || v.mask.as_ref().is_some_and(|m| m.misplaced);
        let left_out: Vec<bool> = report.views.iter().map(misplaced).collect();
        stereo::write_depth_maps(cameras, &left_out, made_masks, &options, self.out, progress)?;
        Ok((Capture::load(&folder, &CaptureOptions::default())?, masked, Some(options)))
    }

    fn stereo_options(&self, cameras: &Capture, region: Option<&Region>) -> Result<MvsOptions> {
        let mut options = MvsOptions::default();
        (options.preset, options.region, options.seed) = (self.preset.of_stereo(), region.cloned(), self.seed);
        options.on_gpu = self.on_gpu;
        Ok(options.within_time(cameras)?)
    }

    /// The fused mesh where the photos, `max_side` pixels large, agree about it best.
    fn refined(
        &self,
        cameras: &Capture,
        max_side: Option<usize>,
        scan: &Scan,
        fused: &Fused,
        progress: &dyn Progress,
    ) -> Result<(TriMesh, Refinement)> {
        let scan_from_mesh = scan.mesh_from_scan.inverse();
        let hold = |e: &Evidence| match e.kind {
            EvidenceKind::Seen => Hold::Free,
            EvidenceKind::Support => Hold::Fixed,
            _ => Hold::Unseen,
        };
        let holds: Vec<Hold> = fused.evidence.iter().map(hold).collect();
        let mut options = RefineOptions::default();
        (options.preset, options.max_side) = (self.preset.of_stereo(), max_side);
        let mesh = scan_from_mesh.mesh(&fused.mesh);
        let (mesh, report) = refine(&mesh, &holds, cameras, &options, &stereo::shown(progress))?;
        progress.end();
        let refinement = Refinement {
            passes: report.passes,
            seen_share: report.seen_share,
            moved_m: report.moved.map(|d| d * scan.mesh_from_scan.scale),
            correlation: report.correlation.map(|c| Some(c).filter(|c| c.is_finite())),
        };
        progress.note(&format!(
            "photos agree about the mesh by {:.3} instead of {:.3} after it moved by {:.2} mm in the median, {:.2} mm at 95 %",
            report.correlation[1],
            report.correlation[0],
            1e3 * refinement.moved_m[0],
            1e3 * refinement.moved_m[1]
        ));
        Ok((scan.mesh_from_scan.mesh(&mesh), refinement))
    }
}

/// What in a scan makes its mesh doubtful, in sentences.
///
/// # Errors
/// If the mesh contradicts the scan.
fn contradictions(rules: &[RuleResult], input: &Path) -> Result<Vec<String>> {
    let sentence = |r: &RuleResult| {
        let fix = r.fix.as_ref().map_or(String::new(), |fix| format!(": {fix}"));
        format!("rule {} ({}): {}{fix}", r.number, r.name, r.reason)
    };
    let of = |outcome: Outcome| rules.iter().filter(|r| r.outcome == outcome).map(sentence).collect::<Vec<_>>();
    let failed = of(Outcome::Fail);
    if failed.is_empty() {
        return Ok(of(Outcome::Doubt));
    }
    refuse!("the mesh of {} contradicts its photos, no asset is made of it; {}", input.display(), failed.join("; "))
}

/// What to say of photos with such a gap between azimuths, degrees, where that much of the surface was measured by nobody.
fn one_sided([from, to]: [f64; 2], unseen_share: f64) -> Option<String> {
    (to - from > WIDEST_GAP_DEG).then(|| {
        format!(
            "no photo was taken from azimuth {from:.0} to {:.0} degrees (0 is the first photo's, counted to the left as seen from above): what the mesh shows \
             there is made up, and {:.0} % of its surface was not measured: take photos all round the object",
            to.rem_euclid(360.0),
            100.0 * unseen_share
        )
    })
}

/// Whether a rule says that the mesh is not the shape that the masks show.
fn at_odds_with_masks(rule: &RuleResult) -> bool {
    const OF_MASKS: [u8; 2] = [22, 23];
    OF_MASKS.contains(&rule.number) && [Outcome::Doubt, Outcome::Fail].contains(&rule.outcome)
}

/// Removes the depth maps in `out/depth` that an earlier run wrote; a folder of somebody else's stays.
pub(crate) fn remove_depth_maps(out: &Path) -> Result<()> {
    let depth = fsutil::output_path(out, DEPTH)?;
    if depth.join("transforms.json").is_file() {
        std::fs::remove_dir_all(&depth).with_context(|| format!("cannot remove {}", depth.display()))?;
    }
    Ok(())
}

/// Puts what is within a voxel of the table onto it. No photo shows the edge on which an object stands, and the fusion rounds it off; but a push that
/// tips the object over that edge weighs it by where the edge is.
fn snap_to_table(mesh: &mut TriMesh, table: &Support, voxel_m: f64) {
    for vertex in &mut mesh.vertices {
        let height_m = table.up.dot(&(*vertex - table.point));
        if height_m < voxel_m {
            *vertex -= height_m * table.up.into_inner();
        }
    }
}

/// Depth maps of one object in metres, in the frame that its mesh will have.
pub struct Scan {
    depths: Photos,
    /// Of each depth map, where it lies in its photo.
    frames: Vec<Frame>,
    /// What surfels show where they have no depth.
    drawn: Option<Drawn>,
    silhouettes: bool,
    mesh_from_scan: Similarity,
    /// Box and table for the fusion.
    pub fusion: FusionOptions,
    /// How the frame was found.
    pub frame: FrameReport,
}

impl DepthViews for Scan {
    fn len(&self) -> usize {
        self.depths.len()
    }

    fn view(&self, i: usize) -> drex_mesh::Result<DepthMap> {
        let mut map = depth_map(&self.depths, i, self.silhouettes)?;
        if let Some(drawn) = &self.drawn {
            drawn.fill(i, &mut map)?;
        }
        let map = self.frames[i].around(map);
        let scale = self.mesh_from_scan.scale as f32;
        Ok(DepthMap {
            world_from_camera: self.mesh_from_scan.pose(&map.world_from_camera),
            depth_m: map.depth_m.iter().map(|z| z * scale).collect(),
            ..map
        })
    }
}

impl Scan {
    /// `cameras` has lenses and sparse points, `depths` the depth maps; both in one frame, and often the same.
    /// `masked`: the maps show the object alone.
    pub(crate) fn new(
        cameras: &Capture,
        depths: &Capture,
        masked: bool,
        scale: Scale,
        options: &FrameOptions,
    ) -> Result<Self> {
        // Depth in the scan's unit; 16-bit maps are millimetres.
        let mut one_at_a_time = PhotoOptions::default();
        one_at_a_time.memory_bytes = 0;
        let depths = Photos::new(depths, one_at_a_time)?;
        let points = if cameras.points.is_empty() { points_of(&depths, cameras)? } else { sparse_points(cameras) };
        let Scale { metres_per_unit, from: scale_from, distances, marker, marks } = scale;
        let object: Vec<Point3<f64>> = match masked {
            true => points_of(&depths, cameras)?.iter().map(|p| p.position).collect(),
            false => Vec::new(),
        };
        let frames = frames(cameras, &depths)?;
        let silhouette = |(i, frame): (usize, &Frame)| {
            let DepthMap { camera, world_from_camera, mask, .. } = frame.around(depth_map(&depths, i, true)?);
            Ok(mask.map(|mask| Silhouette { camera, world_from_camera, mask, name: depths.name(i).to_owned() }))
        };
        let silhouettes: Vec<Silhouette> = match masked {
            true => {
                let some = frames.iter().enumerate().step_by(frames.len().div_ceil(MOST_SILHOUETTES).max(1));
                some.filter_map(|f| silhouette(f).transpose()).collect::<Result<_>>()?
            }
            false => Vec::new(),
        };
        let place = place::find(cameras, points, &object, &silhouettes, metres_per_unit, options)?;
        let (table, up_from) = (&place.table, place.up_from);
        // Recorded poses are poses of the frame that the recording has already.
        let mesh_from_scan = if scale_from == DEPTH_CAMERA { IDENTITY } else { place.table_from_scan };
        let up_in_mesh = mesh_from_scan.rotation * table.up;

        let mut fusion = FusionOptions::default();
        fusion.background_is_empty = masked;
        if ["table", place::PARALLEL, place::ALL_ROUND].contains(&up_from) || !masked {
            fusion.support = Some(Support { point: mesh_from_scan.point(&table.point), up: up_in_mesh });
        }
        let mesh_from_table = mesh_from_scan.after(&place.table_from_scan.inverse());
        let region = options.region.map(|region| (region, mesh_from_scan));
        let region = region.or(place.object.map(|object| (object, mesh_from_table)));
        fusion.region = region.map(|(region, mesh_from)| box_around(&region, &mesh_from));
        let corners = |b: (Point3<f64>, Point3<f64>)| [b.0.into(), b.1.into()];
        let matrix = mesh_from_scan.to_matrix();
        let frame = FrameReport {
            scan: fsutil::absolute(&cameras.folder).file_name().unwrap_or_default().to_string_lossy().into_owned(),
            metres_per_unit,
            scale_from: scale_from.to_owned(),
            distances,
            marker,
            marks_m: marks.into_iter().map(|(name, p)| (name, mesh_from_scan.point(&p).into())).collect(),
            up_from: up_from.to_owned(),
            up_in_mesh: up_in_mesh.into_inner().into(),
            table_points: (up_from == "table").then_some(table.inliers),
            table_rms_m: (up_from == "table").then_some(table.rms * metres_per_unit),
            table_rms_px: (up_from == "table").then_some(table.rms_px),
            table_score: place.score,
            other_planes: place.runners_up,
            mesh_from_scan: [0, 1, 2, 3].map(|r| [0, 1, 2, 3].map(|c| matrix[(r, c)])),
            region_m: fusion.region.map(corners),
            object_from: place.object_from.to_owned(),
            others_on_table: place.others.len(),
            others_m: place.others.iter().map(|other| corners(box_around(other, &mesh_from_table))).collect(),
            doubts: place.doubts,
        };
        Ok(Self { depths, frames, drawn: None, silhouettes: masked, mesh_from_scan, fusion, frame })
    }
}

const IDENTITY: Similarity = Similarity {
    scale: 1.0,
    rotation: UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(1.0, 0.0, 0.0, 0.0)),
    translation: Vector3::new(0.0, 0.0, 0.0),
};

impl Meshed {
    /// Colours the mesh, or another in its frame, by the photos; the report's texel is in metres. `None` where no photo shows it or one cannot be
    /// read, which a note says.
    pub fn textured(&self, mesh: &TriMesh, progress: &dyn Progress) -> Option<(TextureMap, TextureReport)> {
        textured(mesh, &self.cameras, &self.scan.mesh_from_scan, progress)
    }
}

impl Scan {
    /// What the mesh is held against.
    ///
    /// # Errors
    /// If a mask cannot be read.
    pub fn evidence(&self, voxel_m: f64, region_given: bool) -> Result<ScanEvidence> {
        let mut out = ScanEvidence { voxel_m, region_given, region_m: self.frame.region_m, ..ScanEvidence::default() };
        let support = |s: &Support| SupportEvidence {
            point_m: s.point.into(),
            up: s.up.into_inner().into(),
            rms_px: self.frame.table_rms_px,
        };
        out.support = self.fusion.support.as_ref().map(support);
        for i in 0..self.depths.len() {
            let c = self.depths.camera(i);
            let world_from_camera = self.mesh_from_scan.pose(&c.camera_from_world.inverse());
            out.cameras.push(ScanCamera {
                width_px: c.width as u32,
                height_px: c.height as u32,
                focal_px: [c.fx, c.fy],
                principal_px: [c.cx, c.cy],
                world_from_camera: PoseRecord::from(&world_from_camera),
            });
            if self.silhouettes {
                let map = self.frames[i].around(depth_map(&self.depths, i, true)?);
                let Some(mask) = &map.mask else { continue };
                let (camera, mask) = thinned(&map.camera, mask);
                out.silhouettes.push(Silhouette {
                    camera,
                    world_from_camera,
                    mask,
                    name: self.depths.name(i).to_owned(),
                });
            }
        }
        Ok(out)
    }
}

/// Every k-th row and column of a mask, so that no side is longer than [`SILHOUETTE_PX`].
fn thinned(camera: &DepthCamera, mask: &[bool]) -> (DepthCamera, Vec<bool>) {
    let step = camera.width_px.max(camera.height_px).div_ceil(SILHOUETTE_PX).max(1);
    let (width_px, height_px) = (camera.width_px / step, camera.height_px / step);
    let k = f64::from(step);
    // The pixel in the middle of each block stands for it.
    let row = |r: u32| (r * step + step / 2) as usize * camera.width_px as usize;
    let pixel = |r: u32| (0..width_px).map(move |c| mask[row(r) + (c * step + step / 2) as usize]);
    let thin = (0..height_px).flat_map(pixel).collect();
    let camera = DepthCamera {
        width_px,
        height_px,
        fx_px: camera.fx_px / k,
        fy_px: camera.fy_px / k,
        cx_px: camera.cx_px / k,
        cy_px: camera.cy_px / k,
    };
    (camera, thin)
}

/// Depth map `i` in the scan's frame and unit.
fn depth_map(depths: &Photos, i: usize, silhouettes: bool) -> drex_mesh::Result<DepthMap> {
    let photo = depths.get(i).map_err(|e| drex_mesh::Error::View(Box::new(e)))?;
    let Some(depth) = &photo.depth else {
        let why = format!("{} has no depth map", depths.name(i));
        return Err(drex_mesh::Error::View(why.into()));
    };
    let c = &photo.camera;
    Ok(DepthMap {
        camera: DepthCamera {
            width_px: c.width as u32,
            height_px: c.height as u32,
            fx_px: c.fx,
            fy_px: c.fy,
            cx_px: c.cx,
            cy_px: c.cy,
        },
        world_from_camera: c.camera_from_world.inverse(),
        depth_m: depth.clone(),
        mask: photo.mask.as_ref().filter(|_| silhouettes).map(|m| m.iter().map(|&v| v >= 128).collect()),
        trust: photo
            .confidence
            .as_ref()
            .map(|c| c.iter().map(|&v| f32::from(v) / (255.0 * USUAL_CONFIDENCE)).collect()),
    })
}

/// Some of the points that the depth maps show, in the scan's frame, each seen by its map's view.
fn points_of(depths: &Photos, cameras: &Capture) -> Result<Vec<ScenePoint>> {
    let views: BTreeMap<&str, usize> = cameras.views.iter().enumerate().map(|(i, v)| (v.name.as_str(), i)).collect();
    let mut points = Vec::new();
    for i in 0..depths.len() {
        let map = depth_map(depths, i, true)?;
        let view = views.get(depths.name(i)).copied();
        let (width, height) = (map.camera.width_px as usize, map.camera.height_px as usize);
        for row in (0..height).step_by(PIXEL_STEP) {
            for column in (0..width).step_by(PIXEL_STEP) {
                let z = map.depth_m[row * width + column];
                if z > 0.0 && map.mask.as_ref().is_none_or(|m| m[row * width + column]) {
                    let ray = map.camera.ray(column as u32, row as u32);
                    let p = map.world_from_camera * Point3::from(ray * f64::from(z));
                    points.push(ScenePoint { views: view.into_iter().collect(), ..ScenePoint::at(p) });
                }
            }
        }
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Unit;

    #[test]
    fn what_is_within_a_voxel_of_the_table_lies_on_it() {
        let up = Unit::new_normalize(Vector3::new(0.1, -0.2, 1.0));
        let table = Support { point: Point3::new(0.3, 0.1, -0.2), up };
        let heights = [-0.0004, 0.0, 0.0016, 0.0018, 0.05];
        let aside = up.cross(&Vector3::x()) * 0.04;
        let vertices = heights.iter().map(|h| table.point + aside + up.into_inner() * *h).collect();
        let mut mesh = TriMesh { vertices, faces: vec![[0, 1, 2], [2, 3, 4]] };
        snap_to_table(&mut mesh, &table, 0.0017);
        let after: Vec<f64> = mesh.vertices.iter().map(|v| up.dot(&(v - table.point))).collect();
        for (height, expected) in after.iter().zip([0.0, 0.0, 0.0, 0.0018, 0.05]) {
            assert!((height - expected).abs() < 1e-12, "{after:?}");
        }
        assert!(mesh.vertices.iter().all(|v| ((v - table.point).dot(&aside.normalize()) - aside.norm()).abs() < 1e-12));
    }

    #[test]
    fn photos_from_one_side_are_doubted_and_photos_all_round_are_not() {
        assert_eq!(one_sided([340.0, 415.0], 0.1), None);
        let doubt = one_sided([290.0, 500.0], 0.53).unwrap();
        assert!(doubt.contains("from azimuth 290 to 140 degrees") && doubt.contains("53 % of its surface"), "{doubt}");
    }

    #[test]
    fn a_mesh_that_contradicts_its_photos_is_refused_and_doubts_are_sentences() {
        let corner = |k: usize| Point3::new([-0.03, 0.03][k & 1], [-0.02, 0.02][k >> 1 & 1], [0.0, 0.05][k >> 2]);
        let mesh = drex_core::mesh::convex_hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
        let camera = |k: usize| {
            let (sin, cos) = (k as f64).sin_cos();
            let eye = Point3::new(0.3 * cos, 0.3 * sin, 0.2);
            let world_from_camera = drex_core::Pose::face_towards(&eye, &Point3::new(0.0, 0.0, 0.02), &-Vector3::z());
            ScanCamera {
                width_px: 160,
                height_px: 120,
                focal_px: [140.0; 2],
                principal_px: [80.0, 60.0],
                world_from_camera: PoseRecord::from(&world_from_camera),
            }
        };
        let input = Path::new("photos of a tin");
        let support = SupportEvidence { point_m: [0.0; 3], up: [0.0, 0.0, 1.0], rms_px: Some(0.4) };
        let mut evidence =
            ScanEvidence { support: Some(support), cameras: (0..7).map(camera).collect(), ..ScanEvidence::default() };
        assert!(contradictions(&check_scan(&mesh, &[], &evidence), input).unwrap().is_empty());
        evidence.support = Some(SupportEvidence { rms_px: Some(3.0), ..support });
        let doubts = contradictions(&check_scan(&mesh, &[], &evidence), input).unwrap();
        assert!(
            doubts.len() == 1 && doubts[0].starts_with("rule 18 (support fits its points): its points lie 3.00 px")
        );
        // A wall taken for the table: half of the cameras are behind it.
        evidence.support = Some(SupportEvidence { up: [1.0, 0.0, 0.0], ..support });
        let message = contradictions(&check_scan(&mesh, &[], &evidence), input).unwrap_err().to_string();
        for part in ["photos of a tin", "no asset is made", "rule 19", "--up"] {
            assert!(message.contains(part), "{message}");
        }
    }
}
