//! The object as each stage needs it, from the files of the asset stage.

use std::path::Path;

use anyhow::{Context, Result};
use drex_mesh::{Asset, AssetOptions, build_asset};
use drex_sysid::ObjectModel;

/// The object of an identification, straight from a mesh file in metres, and the asset it came from.
pub fn object_model(mesh: &Path) -> Result<(ObjectModel, Asset)> {
    let asset = build_asset(mesh, &AssetOptions::default())?;
    Ok((model_of(&asset), asset))
}

/// Convex pieces and mass properties at one kilogram.
pub fn model_of(asset: &Asset) -> ObjectModel {
    ObjectModel {
        pieces: asset.pieces.iter().map(|p| p.vertices.clone()).collect(),
        unit: asset.properties.with_mass(1.0),
    }
}

/// The asset that an earlier stage wrote below `root`.
pub fn read_asset(root: &Path) -> Result<Asset> {
    Asset::read(root).with_context(|| format!("reading the asset in {}", root.display()))
}
