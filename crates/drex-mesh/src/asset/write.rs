//! Assets on disk.

use std::fs;
use std::path::{Path, PathBuf};

use drex_core::Error as CoreError;
use drex_core::fsutil::{output_path, temporary_path, write_atomic};
use serde::Serialize;

use super::{ArticulatedAsset, Asset, model};
use crate::Result;
use crate::io::obj_text;

/// Names, relative to the folder, and contents.
type Files = Vec<(String, Vec<u8>)>;

pub(crate) fn write_asset(asset: &Asset, scene: Option<&model::SceneOptions>, out: &Path) -> Result<()> {
    let mut files = part_files("", asset);
    files.push(report(out, &asset.report)?);
    let visual = [("object", &asset.visual, asset.colors.as_deref())];
    files.push(("asset/object.glb".into(), model::glb(&visual, &asset.world_from_mesh_at_rest)?));
    files.push(("asset/object.urdf".into(), model::urdf(asset).into()));
    files.push(("asset/object.xml".into(), model::mjcf(asset).into()));
    if let Some(scene) = scene {
        files.splice(0..0, scene.background.iter().flat_map(model::background_files));
        files.push(("asset/scene.xml".into(), model::scene(asset, scene, &out.join("asset"))?.into()));
    }
    write_files(out, &files)
}

impl ArticulatedAsset {
    /// Writes `mesh/PART_visual.obj`, `mesh/PART_collision_NN.obj`, `mesh/report.json`, `asset/object.xml` (MJCF),
    /// `asset/object.urdf` and `asset/object.glb` under `out`, as [`Asset::write`] does.
    ///
    /// # Errors
    /// If a file cannot be written; what was there before stays.
    pub fn write(&self, out: &Path) -> Result<()> {
        let mut files: Files =
            self.parts.iter().flat_map(|(name, part)| part_files(&format!("{name}_"), part)).collect();
        let parts = self.parts.iter();
        let meshes: Vec<_> = parts.map(|(name, part)| (name.as_str(), &part.visual, part.colors.as_deref())).collect();
        files.push(report(out, &self.report)?);
        files.push(("asset/object.glb".into(), model::glb(&meshes, &self.world_from_mesh_at_rest)?));
        files.push(("asset/object.urdf".into(), model::articulated_urdf(self).into()));
        files.push(("asset/object.xml".into(), model::articulated_mjcf(self).into()));
        write_files(out, &files)
    }
}

fn part_files(prefix: &str, part: &Asset) -> Files {
    let visual = (format!("mesh/{prefix}visual.obj"), obj_text(&part.visual).into_bytes());
    let pieces = part.convex_parts.iter().enumerate();
    let pieces = pieces.map(|(k, p)| (part_file(prefix, k), obj_text(p).into_bytes()));
    std::iter::once(visual).chain(pieces).collect()
}

/// Name of the file of piece `k`, from 0.
pub(crate) fn part_file(prefix: &str, k: usize) -> String {
    format!("mesh/{prefix}collision_{k:02}.obj")
}

fn report(out: &Path, report: &impl Serialize) -> Result<(String, Vec<u8>)> {
    let name = "mesh/report.json";
    let text = serde_json::to_string_pretty(report)
        .map_err(|e| CoreError::io("write", out.join(name), std::io::Error::other(e)))?;
    Ok((name.into(), (text + "\n").into()))
}

/// Writes all files into a temporary folder in `out`, then moves them into place.
fn write_files(out: &Path, files: &Files) -> Result<()> {
    // Before anything is written: a folder that is a link is no place for an asset.
    files.iter().try_for_each(|(name, _)| output_path(out, name).map(drop))?;
    let existed = out.is_dir();
    let stage = temporary_path(&out.join(".asset"));
    let written = write_staged(&stage, files).and_then(|()| move_into(out, &stage, files));
    // Leftovers of our own; that they may be gone already is no second error.
    let _ = fs::remove_dir_all(&stage);
    if written.is_err() && !existed {
        let _ = fs::remove_dir(out);
    }
    written?;
    Ok(remove_stale(&out.join("mesh"), files)?)
}

fn write_staged(stage: &Path, files: &Files) -> Result<(), CoreError> {
    files.iter().try_for_each(|(name, bytes)| write_atomic(&stage.join(name), bytes))
}

fn move_into(out: &Path, stage: &Path, files: &Files) -> Result<(), CoreError> {
    for folder in ["mesh", "asset"].map(|f| out.join(f)) {
        fs::create_dir_all(&folder).map_err(|e| CoreError::io("create", &folder, e))?;
    }
    for (name, _) in files {
        let target = out.join(name);
        fs::rename(stage.join(name), &target).map_err(|e| CoreError::io("write", &target, e))?;
    }
    Ok(())
}

/// Removes `…collision_NN.obj` files that are not among the files of this asset, and nothing else.
fn remove_stale(folder: &Path, files: &Files) -> Result<(), CoreError> {
    let entries = fs::read_dir(folder).map_err(|e| CoreError::io("read", folder, e))?;
    let stale: Vec<PathBuf> = entries
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|path| {
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let number = name.strip_suffix(".obj").and_then(|n| n.rsplit_once("collision_")).map(|(_, n)| n);
            let ours = number.is_some_and(|n| n.len() >= 2 && n.bytes().all(|b| b.is_ascii_digit()));
            ours && !files.iter().any(|(file, _)| file.strip_prefix("mesh/") == Some(&name))
        })
        .collect();
    stale.iter().try_for_each(|path| fs::remove_file(path).map_err(|e| CoreError::io("remove", path, e)))
}
