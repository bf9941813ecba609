//! Mesh to repaired, decomposed object with mass properties.

use std::path::PathBuf;

use anyhow::Result;
use drex_mesh::{AssetOptions, build_asset};

use super::Twin;
use crate::ui::Ui;

pub fn make(twin: &Twin, ui: &Ui) -> Result<Vec<PathBuf>> {
    let spinner = ui.spinner("asset");
    let asset = build_asset(&twin.path(&twin.manifest.object.mesh), &options(twin))?;
    asset.write_meshes(&twin.root)?;
    spinner.finish_and_clear();
    Ok(vec![twin.path("mesh")])
}

/// The manifest's object as the mesh crate takes it.
pub fn options(twin: &Twin) -> AssetOptions {
    let object = &twin.manifest.object;
    AssetOptions::default()
        .with_unit_m(object.unit.in_metres())
        .with_up_in_mesh(object.up_in_mesh)
        .with_friction(twin.friction())
}
