//! The object with its mass as a simulation asset, with the colours of its scan.

use std::path::PathBuf;

use drex_mesh::Similarity;
use nalgebra::Matrix4;

use crate::cameras::cameras_of;
use crate::records::{MASS, MassFile, SCAN, ScanFile, read_json};
use crate::texture::textured;
use crate::{Progress, Result, Twin};

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let mass: MassFile = read_json(&twin.path(MASS))?;
    let mut asset = twin.asset()?.clone().with_mass(mass.mass_kg);
    if let Some(config) = &twin.manifest.scan {
        let matrix = read_json::<ScanFile>(&twin.path(SCAN))?.scan.mesh_from_scan;
        let mesh_from_scan = Similarity::from_matrix(&Matrix4::from_fn(|r, c| matrix[r][c]))?;
        let cameras = cameras_of(&twin.path(&config.photos), &twin.root)?;
        asset.texture = textured(&asset.visual, &cameras, &mesh_from_scan, progress).map(|made| made.0);
    }
    asset.write(&twin.root)?;
    Ok(vec![twin.path("mesh"), twin.path("asset")])
}
