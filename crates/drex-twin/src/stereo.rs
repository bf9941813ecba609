//! Depth maps of photos by stereo, as files that a person can open and the next run goes on with.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel, PinholeCamera};
use drex_core::capture::{Capture, PhotoOptions, Photos, View};
use drex_core::fsutil::{OutputFolder, output_path};
use drex_core::npy::write_npy;
use drex_mesh::{DepthCamera, Similarity};
use drex_mvs::{DepthMap, DepthMaps, MvsOptions, Region, Step, remove_work};
use drex_splat::io::picture;
use nalgebra::{Matrix4, Point3};

use crate::masks::MaskReport;
use crate::outlines::{mend, sure_points};
use crate::progress::show_stages;
use crate::{Progress, Result};

/// Folder of the depth maps, below the output folder.
pub(crate) const DEPTH: &str = "depth";
/// Folder of work in progress, below that one.
const WORK: &str = "work";
/// The object may reach this much beyond the box that its points span, as a share of its sides.
const BOX_MARGIN: f64 = 0.1;

/// Estimates depth of every photo and writes it as the scan `out/depth`: for each photo the part that can show the object as `NAME.png`, where
/// a mask is there transparent outside, `NAME.npy` (z in the camera's frame, the capture's unit; 0 where nothing is known) and
/// `NAME.confidence.png` (how far that is to be trusted, white for fully). Photos that are `left_out` get none. Where masks were `made`, the depth of other photos
/// mends them. A run that is interrupted is gone on with.
///
/// # Errors
/// If a photo cannot be read, photos are too far apart, or a file cannot be written.
pub(crate) fn write_depth_maps(
    cameras: &Capture,
    left_out: &[bool],
    made: bool,
    options: &MvsOptions,
    out: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let mut files = OutputFolder::new(out.join(DEPTH));
    let index = files.file("transforms.json")?;
    let mut paths = Vec::with_capacity(cameras.views.len());
    for view in &cameras.views {
        let stem = Path::new(&view.name).with_extension("").to_string_lossy().replace('\\', "/");
        let mut file = |end| files.file(&format!("{stem}.{end}"));
        paths.push([file("png")?, file("npy")?, file("confidence.png")?]);
    }
    let mut options = options.clone();
    let work = output_path(&out.join(DEPTH), WORK)?;
    options.work = Some(work.clone());
    let mut one_at_a_time = PhotoOptions::default();
    (one_at_a_time.max_side, one_at_a_time.memory_bytes) = (options.max_side, 0);
    let photos = Photos::new(cameras, one_at_a_time)?;
    let masked = cameras.views.iter().any(|v| v.mask.is_some());
    let mut cuts: Vec<Option<Cut>> = Vec::with_capacity(paths.len());
    let mut take = |map: DepthMap| -> drex_core::Result<()> {
        let i = cuts.len();
        // What else a photo without a mask shows is not the object's.
        if left_out[i] || masked && photos.get(i)?.mask.is_none() {
            cuts.push(None);
            return Ok(());
        }
        let DepthMap { camera, corner, depth, confidence, .. } = map;
        let [_, npy, png] = &paths[i];
        write_npy(npy, &[camera.height, camera.width], &depth)?;
        picture::write_alpha(png, camera.width, camera.height, &confidence).map_err(not_written)?;
        let points = if made { sure_points(&camera, &depth, &confidence) } else { Vec::new() };
        cuts.push(Some(Cut { camera, corner, points }));
        Ok(())
    };
    DepthMaps::each(cameras, &options, &shown(progress), &mut take)?;
    let points: Vec<&[Point3<f32>]> = cuts.iter().flatten().map(|cut| cut.points.as_slice()).collect();
    let mut views = Vec::new();
    for (i, (view, [png, npy, confidence])) in cameras.views.iter().zip(&paths).enumerate() {
        let Some(Cut { camera: c, corner, .. }) = &cuts[i] else { continue };
        let photo = photos.get(i)?;
        let inside = || {
            let row = |y: usize| (y + corner[1]) * photo.camera.width + corner[0];
            (0..c.height).flat_map(move |y| (0..c.width).map(move |x| row(y) + x))
        };
        let mut alpha: Vec<f32> =
            inside().map(|at| photo.mask.as_ref().map_or(1.0, |mask| f32::from(mask[at]) / 255.0)).collect();
        if made {
            // Its own points are all within its mask.
            mend(&mut alpha, c, &points);
        }
        let rgb: Vec<[f32; 3]> =
            inside().zip(&alpha).map(|(at, a)| photo.rgb[at].map(|v| f32::from(v) / 255.0 * a)).collect();
        let written = match masked {
            true => picture::write_rgba(png, c.width, c.height, &rgb, &alpha),
            false => picture::write_rgb(png, c.width, c.height, &rgb),
        };
        written.map_err(not_written)?;
        views.push(View {
            photo: png.clone(),
            mask: None,
            depth: Some(npy.clone()),
            confidence: Some(confidence.clone()),
            normal: None,
            lens: Camera::new(CameraModel::Pinhole, c.width as u32, c.height as u32, &[c.fx, c.fy, c.cx, c.cy])?,
            camera_from_world: c.camera_from_world,
            keypoints: Vec::new(),
            name: view.name.clone(),
        });
    }
    progress.end();
    let maps =
        Capture { folder: out.join(DEPTH), views, points: Vec::new(), unregistered: Vec::new(), notes: Vec::new() };
    maps.write_transforms(&index)?;
    Ok(remove_work(&work)?)
}

/// What is kept of a photo's depth until that of all is known.
struct Cut {
    camera: PinholeCamera,
    corner: [usize; 2],
    points: Vec<Point3<f32>>,
}

fn not_written(e: impl std::fmt::Display) -> drex_core::Error {
    drex_core::Error::value(e.to_string(), "see that the folder can be written to")
}

/// Shows the steps of stereo as work of its stages.
pub(crate) fn shown(progress: &dyn Progress) -> impl Fn(Step) + Sync + '_ {
    let show = show_stages(progress);
    move |step: Step| show(step.stage, step.done, step.total)
}

/// The box in which masks found the object, with a margin.
///
/// # Errors
/// If the report's matrix is no rigid motion.
pub(crate) fn region_of(masks: &MaskReport) -> Result<Region> {
    let table_from_scan = Similarity::from_matrix(&Matrix4::from_fn(|r, c| masks.table_from_scan[r][c]))?;
    let [lo, hi] = masks.object_box.map(Point3::from);
    let margin = BOX_MARGIN * (hi - lo);
    Ok(Region {
        box_from_world: Pose::from_parts(table_from_scan.translation.into(), table_from_scan.rotation),
        corners: [lo - margin, hi + margin],
    })
}

/// Where in a photo's picture a depth map lies that is cut out of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Frame {
    /// Columns and rows of the whole picture, in pixels of the map.
    size: [usize; 2],
    /// The map's first column and row.
    corner: [usize; 2],
}

/// The frames of depth maps; of those whose view `cameras` does not have, the map itself.
///
/// # Errors
/// If the photos cannot be read.
pub(crate) fn frames(cameras: &Capture, depths: &Photos) -> Result<Vec<Frame>> {
    let whole = Photos::new(cameras, PhotoOptions::default())?;
    // Maps are named after their photos, whatever kind of picture these are.
    let stem = |name: &str| Path::new(name).with_extension("");
    let by_stem: BTreeMap<PathBuf, &PinholeCamera> =
        (0..whole.len()).map(|i| (stem(whole.name(i)), whole.camera(i))).collect();
    let frame = |i: usize| {
        let map = depths.camera(i);
        let of = |k: usize| {
            let (own, focal, centre) = ([map.width, map.height][k], [map.fx, map.fy][k], [map.cx, map.cy][k]);
            let photo = by_stem.get(&stem(depths.name(i)))?;
            let scale = focal / [photo.fx, photo.fy][k];
            let size = (scale * [photo.width, photo.height][k] as f64).round() as usize;
            let corner = (scale * [photo.cx, photo.cy][k] - centre).round().max(0.0) as usize;
            (corner + own <= size).then_some((size, corner))
        };
        match (of(0), of(1)) {
            (Some((width, left)), Some((height, top))) => Frame { size: [width, height], corner: [left, top] },
            _ => Frame { size: [map.width, map.height], corner: [0, 0] },
        }
    };
    Ok((0..depths.len()).map(frame).collect())
}

impl Frame {
    /// The map with what is beside it in the whole picture: nothing of the object.
    pub(crate) fn around(&self, map: drex_mesh::DepthMap) -> drex_mesh::DepthMap {
        let own = map.camera.width_px as usize;
        if self.size == [own, map.camera.height_px as usize] {
            return map;
        }
        let [left, top] = self.corner;
        let camera = DepthCamera {
            width_px: self.size[0] as u32,
            height_px: self.size[1] as u32,
            cx_px: map.camera.cx_px + left as f64,
            cy_px: map.camera.cy_px + top as f64,
            ..map.camera
        };
        let depth_m = self.filled(&map.depth_m, own, 0.0);
        let mask = map.mask.map(|mask| self.filled(&mask, own, false));
        let trust = map.trust.map(|trust| self.filled(&trust, own, 0.0));
        drex_mesh::DepthMap { camera, depth_m, mask, trust, ..map }
    }

    /// What is known of the map's pixels, row by row of `width`, with `beside` in the rest of the whole picture.
    pub(crate) fn filled<T: Copy>(&self, map: &[T], width: usize, beside: T) -> Vec<T> {
        let mut whole = vec![beside; self.size[0] * self.size[1]];
        let rows = whole.chunks_exact_mut(self.size[0].max(1)).skip(self.corner[1]);
        for (to, from) in rows.zip(map.chunks_exact(width.max(1))) {
            to[self.corner[0]..self.corner[0] + width].copy_from_slice(from);
        }
        whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_that_is_cut_out_lies_where_it_was_in_its_photo() {
        let frame = Frame { size: [4, 3], corner: [1, 2] };
        assert_eq!(frame.filled(&[7, 8], 2, 0), [0, 0, 0, 0, 0, 0, 0, 0, 0, 7, 8, 0]);
        let camera = DepthCamera { width_px: 2, height_px: 1, fx_px: 5.0, fy_px: 5.0, cx_px: 0.5, cy_px: -1.0 };
        let world_from_camera = Pose::identity();
        let map = drex_mesh::DepthMap {
            camera,
            world_from_camera,
            depth_m: vec![1.0, 2.0],
            mask: Some(vec![true, false]),
            trust: Some(vec![0.25, 0.5]),
        };
        let whole = frame.around(map.clone());
        assert_eq!([whole.camera.cx_px, whole.camera.cy_px], [1.5, 1.0]);
        assert_eq!((whole.depth_m[9], whole.depth_m[10], whole.depth_m.iter().sum::<f32>()), (1.0, 2.0, 3.0));
        assert_eq!(whole.trust.unwrap()[8..11], [0.0, 0.25, 0.5]);
        assert_eq!(whole.mask.unwrap().iter().filter(|m| **m).count(), 1);
        // One that is whole stays as it is.
        assert_eq!(Frame { size: [2, 1], corner: [0, 0] }.around(map.clone()), map);
    }
}
