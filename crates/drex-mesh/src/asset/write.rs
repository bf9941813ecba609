//! Assets on disk.

use std::fs;
use std::path::{Path, PathBuf};

use drex_core::fsutil::{output_path, temporary_path, write_atomic};
use drex_core::{ConvexPart, Error as CoreError, PrimitiveRecord};
use serde::Serialize;

use super::{ArticulatedAsset, Asset, TextureMap, model};
use crate::io::obj_text;
use crate::{Result, read_mesh};

/// Names, relative to the folder, and contents.
type Files = Vec<(String, Vec<u8>)>;

pub(crate) fn write_asset(asset: &Asset, scene: Option<&model::SceneOptions>, out: &Path) -> Result<()> {
    let mut files = part_files("", asset)?;
    files.push(report(out, &asset.report)?);
    files.push(("asset/object.glb".into(), model::glb(&[("object", asset)], &asset.world_from_mesh_at_rest)?));
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
        let mut files = Files::new();
        for (name, part) in &self.parts {
            files.extend(part_files(&format!("{name}_"), part)?);
        }
        let parts: Vec<_> = self.parts.iter().map(|(name, part)| (name.as_str(), part)).collect();
        files.push(report(out, &self.report)?);
        files.push(("asset/object.glb".into(), model::glb(&parts, &self.world_from_mesh_at_rest)?));
        files.push(("asset/object.urdf".into(), model::articulated_urdf(self).into()));
        files.push(("asset/object.xml".into(), model::articulated_mjcf(self).into()));
        write_files(out, &files)
    }
}

fn part_files(prefix: &str, part: &Asset) -> Result<Files> {
    let name = format!("{prefix}visual");
    let mut files = Files::new();
    let visual = match &part.texture {
        Some(texture) => {
            texture.check(&part.visual)?;
            files.push((format!("mesh/{name}.png"), texture.picture.bytes.to_vec()));
            files.push((format!("mesh/{name}.mtl"), TextureMap::mtl(&name).into_bytes()));
            texture.obj(&part.visual, &name)
        }
        None => obj_text(&part.visual),
    };
    files.push((format!("mesh/{name}.obj"), visual.into_bytes()));
    let pieces = part.convex_parts.iter().enumerate();
    files.extend(pieces.map(|(k, p)| (part_file(prefix, k), obj_text(&p.hull).into_bytes())));
    Ok(files)
}

/// The convex parts that an asset was written with into `out`.
pub(crate) fn read_parts(out: &Path, primitives: &[Option<PrimitiveRecord>]) -> Result<Vec<ConvexPart>> {
    let part = |(k, record): (usize, &Option<PrimitiveRecord>)| {
        let hull = read_mesh(&out.join(part_file("", k)))?;
        Ok(ConvexPart { hull, primitive: record.map(PrimitiveRecord::to_primitive).transpose()? })
    };
    primitives.iter().enumerate().map(part).collect()
}

/// Name of the file of piece `k`, from 0.
fn part_file(prefix: &str, k: usize) -> String {
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

/// Removes `…collision_NN.obj` files, and the material and the picture of a visual mesh, that are not among the files of this asset, and
/// nothing else.
fn remove_stale(folder: &Path, files: &Files) -> Result<(), CoreError> {
    let entries = fs::read_dir(folder).map_err(|e| CoreError::io("read", folder, e))?;
    let stale: Vec<PathBuf> = entries
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|path| {
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let number = name.strip_suffix(".obj").and_then(|n| n.rsplit_once("collision_")).map(|(_, n)| n);
            let piece = number.is_some_and(|n| n.len() >= 2 && n.bytes().all(|b| b.is_ascii_digit()));
            let written = |file: &str| files.iter().any(|(name, _)| name.strip_prefix("mesh/") == Some(file));
            let texture = name.strip_suffix(".mtl").or(name.strip_suffix(".png"));
            let texture = texture.is_some_and(|n| n.ends_with("visual") && written(&format!("{n}.obj")));
            let ours = piece || texture;
            ours && !written(&name)
        })
        .collect();
    stale.iter().try_for_each(|path| fs::remove_file(path).map_err(|e| CoreError::io("remove", path, e)))
}
