//! The object with its mass as a simulation asset, with the colours of its scan.

use std::path::PathBuf;

use super::scan::photos_of;
use crate::records::{SCAN, ScanFile, read_json};
use crate::texture::textured;
use crate::{Progress, Result, Twin};

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let mut asset = twin.asset()?.clone().with_mass(twin.mass()?.mass_kg);
    if twin.manifest.scan.is_some() {
        let made: ScanFile = read_json(&twin.path(SCAN))?;
        let mesh_from_scan = made.mesh_from_scan()?;
        let cameras = photos_of(twin, &made)?;
        asset.texture = textured(&asset.visual, &cameras, &mesh_from_scan, progress).map(|made| made.0);
    }
    asset.write(&twin.root)?;
    Ok(vec![twin.path("mesh"), twin.path("asset")])
}
