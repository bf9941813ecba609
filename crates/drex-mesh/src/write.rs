//! The asset on disk.

use std::fs;
use std::path::{Path, PathBuf};

use drex_core::Error as CoreError;

use crate::Result;
use crate::asset::Asset;
use crate::io::obj_text;
use crate::model::{mjcf, urdf};

/// Writes all files into a temporary folder in `out`, then moves them into place.
pub(crate) fn write_asset(asset: &Asset, out: &Path) -> Result<()> {
    let pieces = (0..asset.pieces.len()).map(collision_name).zip(&asset.pieces);
    let mut files = vec![("mesh/visual.obj".to_string(), obj_text(&asset.visual))];
    files.extend(pieces.map(|(name, piece)| (format!("mesh/{name}"), obj_text(piece))));
    let report = serde_json::to_string_pretty(&asset.report)
        .map_err(|e| CoreError::io("write", out.join("mesh/report.json"), std::io::Error::other(e)))?;
    files.push(("mesh/report.json".into(), report + "\n"));
    files.push(("asset/object.urdf".into(), urdf(asset)));
    files.push(("asset/object.xml".into(), mjcf(asset)));

    let existed = out.is_dir();
    let stage = out.join(format!(".asset.{}.tmp", std::process::id()));
    let written = write_staged(&stage, &files).and_then(|()| move_into(out, &stage, &files));
    // Leftovers of our own; that they may be gone already is no second error.
    let _ = fs::remove_dir_all(&stage);
    if written.is_err() && !existed {
        let _ = fs::remove_dir(out);
    }
    written?;
    Ok(remove_stale(&out.join("mesh"), asset.pieces.len())?)
}

pub(crate) fn collision_name(piece: usize) -> String {
    format!("collision_{piece:02}.obj")
}

fn write_staged(stage: &Path, files: &[(String, String)]) -> Result<(), CoreError> {
    files.iter().try_for_each(|(name, text)| drex_core::fsutil::write_atomic(&stage.join(name), text.as_bytes()))
}

fn move_into(out: &Path, stage: &Path, files: &[(String, String)]) -> Result<(), CoreError> {
    for folder in ["mesh", "asset"].map(|f| out.join(f)) {
        fs::create_dir_all(&folder).map_err(|e| CoreError::io("create", &folder, e))?;
    }
    for (name, _) in files {
        let target = out.join(name);
        fs::rename(stage.join(name), &target).map_err(|e| CoreError::io("write", &target, e))?;
    }
    Ok(())
}

/// Removes `collision_NN.obj` files beyond the pieces of this asset.
fn remove_stale(folder: &Path, pieces: usize) -> Result<(), CoreError> {
    let entries = fs::read_dir(folder).map_err(|e| CoreError::io("read", folder, e))?;
    let stale: Vec<PathBuf> = entries
        .filter_map(|e| e.ok().map(|e| e.path()))
        .filter(|path| {
            let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let number = name.strip_prefix("collision_").and_then(|n| n.strip_suffix(".obj"));
            number.and_then(|n| n.parse::<usize>().ok()).is_some_and(|n| n >= pieces && name == collision_name(n))
        })
        .collect();
    stale.iter().try_for_each(|path| fs::remove_file(path).map_err(|e| CoreError::io("remove", path, e)))
}
