//! Where stereo found no depth: surfels, in those parts where they show photos held out better than what silhouettes leave.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use drex_core::TriMesh;
use drex_core::capture::{Capture, CaptureOptions, PhotoOptions, Photos, View};
use drex_core::fsutil::OutputFolder;
use drex_core::npy::write_npy;
use drex_mesh::{DepthMap, Evidence, EvidenceKind, Fused};
use drex_mvs::{Prediction, TextureOptions, TexturedPoint, prediction, texture, textured_points};
use drex_splat::loss::surface_depth;
use drex_splat::train::{Preset, Progress as TrainStep, SurfacePoint};
use drex_splat::{Cpu, Gaussians, Rasterizer, ReconstructOptions, RenderOptions, train_surfels};
use nalgebra::Point3;
use rayon::prelude::*;

use crate::records::GapReport;
use crate::stereo::{DEPTH, shown};
use crate::{Progress, Result};

/// Folder of the maps that surfels drew, below that of the depth maps.
const SURFELS: &str = "surfels";
/// Every so many photos one is not trained on but predicted.
const HOLD_OUT: usize = 8;
/// Surfels that are born on the mesh: more of them are rougher where little is to be seen.
const BORN: usize = 10_000;
/// Points of a mesh whose colours are compared with photos.
const COMPARED: usize = 300_000;
/// Longest side of the textures that are compared.
const TEXTURE_SIDE: usize = 1024;
/// How far a depth drawn of surfels is to be trusted, beside 1 for one that was measured well.
const TRUST: f32 = 0.3;
/// The parts between which is chosen are cubes with this share of the diagonal of the mesh as their side.
const PART: f64 = 0.1;
/// Of a part with fewer pixels in the photos held out nothing is known by itself.
const LEAST_PIXELS: f64 = 100.0;
/// Surfels are taken where their square error is less than this share of that of silhouettes: they are rougher.
const BETTER: f64 = 0.9;

/// The surface that stereo did not measure: what to draw of surfels, and which of its parts to take from them.
pub(crate) struct Gaps<'a> {
    /// Frame and unit of the scan.
    mesh: &'a TriMesh,
    evidence: &'a [Evidence],
    /// Share of it that was measured by nobody.
    share: f64,
    /// Vertices of the mesh by the cube that they are in.
    near: HashMap<[i32; 3], Vec<u32>>,
    /// Side of these cubes.
    cube: f64,
    depths: &'a Capture,
    trained: Capture,
    held_out: Capture,
}

/// Depth drawn of surfels, and where it counts.
pub(crate) struct Drawn {
    maps: Photos,
    /// Side of a part, and the parts in which it counts: all, where nothing is said.
    side: f64,
    pub parts: Option<HashSet<[i32; 3]>>,
}

impl<'a> Gaps<'a> {
    /// `mesh` is `fused` in the frame and unit of the scan; `depths` are the maps it was fused of.
    pub(crate) fn new(mesh: &'a TriMesh, fused: &'a Fused, scan_from_mesh: f64, depths: &'a Capture) -> Self {
        let of = |held: bool| {
            let views = depths.views.iter().enumerate().filter(|(i, _)| i.is_multiple_of(HOLD_OUT) == held);
            Capture { views: views.map(|(_, v)| v.clone()).collect(), ..depths.clone() }
        };
        let cube = 2.0 * scan_from_mesh * fused.report.voxel_m;
        let mut near: HashMap<_, Vec<u32>> = HashMap::new();
        for (v, p) in mesh.vertices.iter().enumerate() {
            near.entry(cell(p, cube)).or_default().push(v as u32);
        }
        Self {
            mesh,
            evidence: &fused.evidence,
            share: fused.report.unseen_share,
            near,
            cube,
            depths,
            trained: of(false),
            held_out: of(true),
        }
    }

    /// Depth of surfels that are born on the mesh, in every map where it has none and shows none of what was measured; that of an earlier run, if there is
    /// one.
    ///
    /// # Errors
    /// If a file cannot be read or written.
    pub(crate) fn drawn(&self, preset: Preset, seed: u64, out: &Path, progress: &dyn Progress) -> Result<Drawn> {
        let folder = out.join(DEPTH).join(SURFELS);
        if !folder.join("transforms.json").is_file() {
            let surfels = self.trained_surfels(preset, seed, out, progress)?;
            self.draw(&surfels, &folder)?;
        }
        let maps = Photos::new(&Capture::load(&folder, &CaptureOptions::default())?, one_at_a_time())?;
        Ok(Drawn { maps, parts: None, side: self.side() })
    }

    fn trained_surfels(&self, preset: Preset, seed: u64, out: &Path, progress: &dyn Progress) -> Result<Gaussians> {
        let mut options = ReconstructOptions::default();
        (options.preset, options.seed, options.hold_out) = (preset, seed, Some(HOLD_OUT));
        options.born = self.colored(self.mesh, BORN, progress)?.iter().map(born_at).collect();
        let steps = steps(preset);
        options.iterations = Some(steps);
        progress.begin("surfels", Some(u64::from(steps)));
        let mut step = |p: &TrainStep, _, _: f64| progress.at(u64::from(p.step), &format!("{:.1} dB", p.psnr));
        let (surfels, _) = train_surfels(self.depths, &self.depths.report()?, &Cpu, out, &options, &mut step)?;
        progress.end();
        Ok(surfels)
    }

    /// Writes what surfels show of the part that was not measured.
    fn draw(&self, surfels: &Gaussians, folder: &Path) -> Result<()> {
        let mut files = OutputFolder::new(folder.to_path_buf());
        let index = files.file("transforms.json")?;
        let maps = Photos::new(self.depths, one_at_a_time())?;
        let mut views = Vec::with_capacity(maps.len());
        for (i, view) in self.depths.views.iter().enumerate() {
            let map = maps.get(i)?;
            let drawn = Cpu.forward(surfels, &map.camera, &RenderOptions::default())?.0;
            let mut depth = surface_depth(&drawn, 1.0, 0.5)?;
            let (width, world_from_camera) = (map.camera.width, map.camera.camera_from_world.inverse());
            depth.par_iter_mut().enumerate().for_each(|(at, z)| {
                let known = map.depth.as_ref().is_some_and(|d| d[at] > 0.0);
                let beside = map.mask.as_ref().is_some_and(|m| m[at] < 128);
                let pixel = [(at % width) as f64 + 0.5, (at / width) as f64 + 0.5];
                let point = world_from_camera * Point3::from(map.camera.ray(pixel) * f64::from(*z));
                if known || beside || *z <= 0.0 || self.is_measured(&point) {
                    *z = 0.0;
                }
            });
            let stem = Path::new(&view.name).with_extension("").to_string_lossy().replace('\\', "/");
            let npy = files.file(&format!("{stem}.npy"))?;
            write_npy(&npy, &[map.camera.height, width], &depth)?;
            views.push(View { depth: Some(npy), confidence: None, ..view.clone() });
        }
        Ok(Capture { views, ..self.depths.clone() }.write_transforms(&index)?)
    }

    /// The parts in which photos held out look more like `other`, the mesh with all that surfels show. `measured` is what the first mesh knows of its
    /// vertices.
    ///
    /// # Errors
    /// If a photo cannot be read.
    pub(crate) fn better_parts(
        &self,
        other: &TriMesh,
        measured: &[Evidence],
        progress: &dyn Progress,
    ) -> Result<(HashSet<[i32; 3]>, GapReport)> {
        let side = self.side();
        let parts_of = |mesh: &TriMesh, evidence: &[Evidence]| -> Vec<Option<[i32; 3]>> {
            let part = |face: &[u32; 3]| {
                let unknown = face.iter().all(|v| evidence[*v as usize].kind == EvidenceKind::Unseen);
                unknown.then(|| cell(&mesh.vertices[face[0] as usize], side))
            };
            mesh.faces.iter().map(part).collect()
        };
        let own = parts_of(self.mesh, self.evidence);
        let others = parts_of(other, measured);
        let mut cells: Vec<[i32; 3]> = own.iter().chain(&others).flatten().copied().collect();
        cells.sort_unstable();
        cells.dedup();
        let predicts = |mesh: &TriMesh, parts: &[Option<[i32; 3]>]| -> Result<Vec<Prediction>> {
            let region_of: Vec<_> = parts.iter().map(|p| p.and_then(|p| cells.binary_search(&p).ok())).collect();
            let points = self.colored(mesh, COMPARED, progress)?;
            Ok(prediction(mesh, &points, &region_of, cells.len(), &self.held_out)?)
        };
        let (silhouettes, surfels) = (predicts(self.mesh, &own)?, predicts(other, &others)?);
        let all = |of: &[Prediction]| {
            let (error, pixels) = of.iter().fold((0.0, 0.0), |(e, n), p| (e + p.square_error, n + p.pixels));
            (error / f64::max(pixels, 1.0), pixels)
        };
        let (by_silhouettes, by_surfels) = (all(&silhouettes), all(&surfels));
        let is_better = |k: &usize| {
            let (one, other) = (&surfels[*k], &silhouettes[*k]);
            match one.pixels.min(other.pixels) < LEAST_PIXELS {
                true => by_surfels.0 < BETTER * by_silhouettes.0,
                false => one.square_error / one.pixels < BETTER * other.square_error / other.pixels,
            }
        };
        let taken: HashSet<_> = (0..cells.len()).filter(is_better).map(|k| cells[k]).collect();
        let db = |error: f64| -10.0 * error.max(1e-12).log10();
        let report = GapReport {
            share: self.share,
            photos: self.held_out.views.len(),
            pixels: by_silhouettes.1,
            silhouettes_db: db(by_silhouettes.0),
            surfels_db: db(by_surfels.0),
            parts: [taken.len(), cells.len()],
        };
        Ok((taken, report))
    }

    /// The side of a part.
    fn side(&self) -> f64 {
        PART * self.mesh.bounds().map_or(1.0, |(lo, hi)| (hi - lo).norm())
    }

    /// Whether the vertex of the mesh next to a place was measured; not where there is none.
    fn is_measured(&self, point: &Point3<f64>) -> bool {
        let own = cell(point, self.cube);
        let cubes = (0..27).map(|k| [own[0] + k % 3 - 1, own[1] + k / 3 % 3 - 1, own[2] + k / 9 - 1]);
        let vertices = cubes.filter_map(|c| self.near.get(&c)).flatten();
        let away = |v: &u32| (self.mesh.vertices[*v as usize] - point).norm_squared();
        let nearest = vertices.min_by(|a, b| away(a).total_cmp(&away(b)));
        nearest.is_some_and(|v| self.evidence[*v as usize].kind != EvidenceKind::Unseen)
    }

    /// A mesh in the colours of the photos that are trained on.
    fn colored(&self, mesh: &TriMesh, count: usize, progress: &dyn Progress) -> Result<Vec<TexturedPoint>> {
        let mut options = TextureOptions::default();
        options.max_side = TEXTURE_SIDE;
        let texture = texture(mesh, &self.trained, &options, &shown(progress))?;
        progress.end();
        let (size, rgb) = texture.pixels()?;
        Ok(textured_points(mesh, &texture.uv, (size, &rgb), count))
    }
}

impl Drawn {
    /// Fills up map `i`, frame and unit of the scan.
    ///
    /// # Errors
    /// If what was drawn cannot be read.
    pub(crate) fn fill(&self, i: usize, map: &mut DepthMap) -> drex_mesh::Result<()> {
        let drawn = self.maps.get(i).map_err(|e| drex_mesh::Error::View(Box::new(e)))?;
        let Some(depth) = drawn.depth.as_ref().filter(|d| d.len() == map.depth_m.len()) else { return Ok(()) };
        let width = map.camera.width_px as usize;
        let DepthMap { camera, world_from_camera, depth_m, trust, .. } = map;
        let trust = trust.get_or_insert_with(|| vec![1.0; depth_m.len()]);
        for (at, z) in depth.iter().enumerate().filter(|(_, z)| **z > 0.0) {
            let ray = camera.ray((at % width) as u32, (at / width) as u32);
            let point = *world_from_camera * Point3::from(ray * f64::from(*z));
            if self.parts.as_ref().is_none_or(|parts| parts.contains(&cell(&point, self.side))) {
                (depth_m[at], trust[at]) = (*z, TRUST);
            }
        }
        Ok(())
    }
}

/// Steps in which surfels that are born where they belong move to where the photos want them.
fn steps(preset: Preset) -> u32 {
    match preset {
        Preset::Fast => 800,
        Preset::Default => 2000,
        Preset::Best => 5000,
    }
}

/// Where a Gaussian is born.
pub(crate) fn born_at(point: &TexturedPoint) -> SurfacePoint {
    SurfacePoint { position: point.position.into(), normal: point.normal.into(), rgb: point.rgb }
}

/// The cube of this side that a point is in.
fn cell(point: &Point3<f64>, side: f64) -> [i32; 3] {
    [0, 1, 2].map(|k| (point[k] / side).floor() as i32)
}

fn one_at_a_time() -> PhotoOptions {
    let mut options = PhotoOptions::default();
    options.memory_bytes = 0;
    options
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::Pose;
    use drex_core::camera::{Camera, CameraModel};
    use drex_mesh::{DepthCamera, DepthViews, FusionOptions, fuse};
    use nalgebra::Vector3;

    const SIZE: usize = 120;
    const FOCAL: f64 = 190.0;
    /// A ball with a dent, where another ball was pressed into it.
    const BALL: f64 = 0.05;
    const DENT: (f64, f64) = (0.068, 0.025);

    /// Where a ray meets it first, and whether that is in the dent.
    fn meets(eye: &Point3<f64>, ray: &Vector3<f64>) -> Option<(f64, bool)> {
        let ends = |centre: Point3<f64>, radius: f64| {
            let from = eye - centre;
            let (a, b, c) = (ray.norm_squared(), ray.dot(&from), from.norm_squared() - radius * radius);
            let root = b * b - a * c;
            (root > 0.0).then(|| [(-b - root.sqrt()) / a, (-b + root.sqrt()) / a])
        };
        let ball = ends(Point3::origin(), BALL)?;
        let dent = ends(Point3::new(DENT.0, 0.0, 0.0), DENT.1);
        match dent.filter(|d| d[0] < ball[0] && ball[0] < d[1]) {
            Some(dent) => (dent[1] < ball[1]).then_some((dent[1], true)),
            None => Some((ball[0], false)),
        }
    }

    fn colour(p: &Point3<f64>) -> [u8; 3] {
        let wave = |k: f64, shift: f64| ((p.x * k + shift).sin() + (p.y * k).sin() + (p.z * k - shift).sin()) / 3.0;
        [wave(400.0, 0.0), wave(300.0, 1.0), wave(250.0, 2.0)].map(|w| (128.0 + 90.0 * w) as u8)
    }

    /// Maps with the exact depth of all but the dent.
    fn photographed(folder: &Path) -> Capture {
        let middle = 0.5 * SIZE as f64;
        let lens =
            Camera::new(CameraModel::Pinhole, SIZE as u32, SIZE as u32, &[FOCAL, FOCAL, middle, middle]).unwrap();
        let view = |k: usize| {
            // All round, and more of them where the dent is.
            let turn = if k < 12 { k as f64 * 0.52 } else { 0.22 * (k as f64 - 15.5) };
            let height = [0.1, 0.5, -0.3, 0.9][k % 4];
            let eye =
                Point3::new(turn.cos() * f64::cos(height), turn.sin() * f64::cos(height), f64::sin(height)) * 0.22;
            let world_from_camera = Pose::face_towards(&eye, &Point3::origin(), &-Vector3::z());
            let (mut rgb, mut alpha, mut depth) = (Vec::new(), Vec::new(), Vec::new());
            for at in 0..SIZE * SIZE {
                let [u, v] = [at % SIZE, at / SIZE].map(|p| (p as f64 + 0.5 - middle) / FOCAL);
                let ray = world_from_camera.rotation * Vector3::new(u, v, 1.0);
                let met = meets(&eye, &ray);
                rgb.push(met.map_or([0.0; 3], |(t, _)| colour(&(eye + ray * t)).map(|c| f32::from(c) / 255.0)));
                alpha.push(if met.is_some() { 1.0 } else { 0.0 });
                depth.push(met.filter(|m| !m.1).map_or(0.0, |m| m.0 as f32));
            }
            let [photo, npy] = ["png", "npy"].map(|end| folder.join(format!("{k:02}.{end}")));
            drex_splat::io::picture::write_rgba(&photo, SIZE, SIZE, &rgb, &alpha).unwrap();
            write_npy(&npy, &[SIZE, SIZE], &depth).unwrap();
            View {
                name: format!("{k:02}.png"),
                photo,
                mask: None,
                depth: Some(npy),
                confidence: None,
                normal: None,
                lens: lens.clone(),
                camera_from_world: world_from_camera.inverse(),
                keypoints: Vec::new(),
            }
        };
        let views = (0..20).map(view).collect();
        let whole = Capture { folder: folder.to_owned(), views, points: vec![], unregistered: vec![], notes: vec![] };
        whole.write_transforms(&folder.join("transforms.json")).unwrap();
        Capture::load(folder, &CaptureOptions::default()).unwrap()
    }

    struct Maps(Photos, Option<Drawn>);

    impl DepthViews for Maps {
        fn len(&self) -> usize {
            self.0.len()
        }

        fn view(&self, i: usize) -> drex_mesh::Result<DepthMap> {
            let photo = self.0.get(i).unwrap();
            let c = &photo.camera;
            let [width_px, height_px] = [c.width as u32, c.height as u32];
            let camera = DepthCamera { width_px, height_px, fx_px: c.fx, fy_px: c.fy, cx_px: c.cx, cy_px: c.cy };
            let mut map = DepthMap {
                camera,
                world_from_camera: c.camera_from_world.inverse(),
                depth_m: photo.depth.clone().unwrap(),
                mask: photo.mask.as_ref().map(|m| m.iter().map(|m| *m >= 128).collect()),
                trust: None,
            };
            self.1.iter().try_for_each(|drawn| drawn.fill(i, &mut map))?;
            Ok(map)
        }
    }

    struct Silent;

    impl Progress for Silent {
        fn note(&self, _: &str) {}
    }

    #[test]
    fn surfels_find_a_dent_that_no_silhouette_shows_and_photos_held_out_choose_them() {
        let folder = tempfile::tempdir().unwrap();
        let depths = photographed(folder.path());
        let mut maps = Maps(Photos::new(&depths, one_at_a_time()).unwrap(), None);
        let mut options = FusionOptions::default();
        options.background_is_empty = true;
        let fused = fuse(&maps, &options).unwrap();
        // How far the middle of the dent is from where it should be, along the axis of the dent.
        let floor = DENT.0 - DENT.1;
        let off = |mesh: &TriMesh| {
            let near = mesh.vertices.iter().filter(|p| p.x > 0.0 && p.y.hypot(p.z) < 0.006);
            let x: Vec<f64> = near.map(|p| p.x).collect();
            (x.iter().sum::<f64>() / x.len() as f64 - floor).abs()
        };
        let before = off(&fused.mesh);
        assert!(before > 0.004, "silhouettes show the dent: {before}");
        let gaps = Gaps::new(&fused.mesh, &fused, 1.0, &depths);
        assert!(
            gaps.is_measured(&Point3::new(-BALL, 0.0, 0.0)) && !gaps.is_measured(&Point3::new(BALL - 0.003, 0.0, 0.0))
        );
        let out = tempfile::tempdir().unwrap();
        maps.1 = Some(gaps.drawn(Preset::Fast, 3, out.path(), &Silent).unwrap());
        let all = fuse(&maps, &options).unwrap();
        let measured = fused.evidence_of(&all.mesh);
        let (parts, report) = gaps.better_parts(&all.mesh, &measured, &Silent).unwrap();
        assert!(report.surfels_db > report.silhouettes_db + 1.0 && report.photos == 3, "{report}");
        assert!(!parts.is_empty() && report.parts[0] == parts.len());
        maps.1.as_mut().unwrap().parts = Some(parts);
        let after = off(&fuse(&maps, &options).unwrap().mesh);
        assert!(after < 0.25 * before, "{after} of {before}");
        // Where no part is taken all stays as it was.
        maps.1.as_mut().unwrap().parts = Some(HashSet::new());
        assert!((off(&fuse(&maps, &options).unwrap().mesh) - before).abs() < 1e-9);
    }
}
