//! The object as it rests on the table.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use drex_core::TriMesh;

use crate::recorder::{Recorder, mesh, transform};
use crate::twin::{OBJECT_RGBA, Twin};

/// Convex pieces are seen through.
const PIECE_RGBA: [u8; 4] = [90, 140, 200, 70];

/// Records mesh and convex pieces.
pub fn record(recorder: &Recorder, twin: &Twin) -> Result<()> {
    let Some(visual) = &twin.mesh else { return Ok(()) };
    recorder.fixed(&["world", "object"], &transform(&twin.world_from_mesh))?;
    recorder.fixed(&["world", "object", "mesh"], &mesh(visual, true, OBJECT_RGBA))?;
    for file in pieces(twin)? {
        let piece = TriMesh::read(&file)?;
        let number = file.file_stem().unwrap_or_default().to_string_lossy().replace("collision_", "");
        recorder.fixed(&["world", "object", "pieces", &number], &mesh(&piece, false, PIECE_RGBA))?;
    }
    Ok(())
}

/// `mesh/collision_NN.obj`, by name.
fn pieces(twin: &Twin) -> Result<Vec<PathBuf>> {
    let folder = twin.folder.path("mesh");
    let list = fs::read_dir(&folder).with_context(|| format!("cannot list {}", folder.display()))?;
    let mut files = Vec::new();
    for entry in list {
        let file = entry.with_context(|| format!("cannot list {}", folder.display()))?.path();
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with("collision_") && name.ends_with(".obj") {
            files.push(file);
        }
    }
    files.sort();
    Ok(files)
}
