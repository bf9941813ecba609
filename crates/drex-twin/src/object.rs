//! The object of a twin, made of its mesh.

use drex_core::Object;
use drex_mesh::{Asset, build_asset, read_object, rebuild_asset};
use nalgebra::Vector3;

use crate::error::refuse;
use crate::inputs::Stage;
use crate::{Result, Twin, records as files};

/// Largest angle between the manifest's up and the scan's, rad: beyond it one of them is wrong.
const MAX_TILT_RAD: f64 = 0.1;

impl Twin {
    /// The object as a simulation asset, made of its mesh when it is first asked for.
    ///
    /// Its convex parts are those of an earlier run, where they still are what that run made of the same mesh and settings.
    ///
    /// # Errors
    /// If the mesh cannot be read or encloses no volume, or the scan's up is not the manifest's.
    pub fn asset(&self) -> Result<&Asset> {
        if let Some(asset) = self.asset.get() {
            return Ok(asset);
        }
        if self.manifest.scan.is_some() {
            self.check_up(&files::read_json(&self.path(files::SCAN))?)?;
        }
        let options = self.manifest.object.asset_options(self.friction());
        let mesh = self.path(&self.manifest.object.mesh);
        let made = self.inputs(Stage::Asset).is_ok_and(|inputs| self.lock.is_current(Stage::Asset.name(), &inputs));
        let asset = if made { rebuild_asset(&mesh, &options, &self.root)? } else { build_asset(&mesh, &options)? };
        Ok(self.asset.get_or_init(|| asset))
    }

    /// The object with exact distances, in its rest pose: read from what the stage [`Stage::Asset`] wrote, where that is up to
    /// date, else made of its mesh. Its mass is the asset's.
    ///
    /// # Errors
    /// As [`Twin::asset`].
    pub fn object(&self) -> Result<Object> {
        let name = &self.manifest.name;
        let current = self.asset.get().is_none()
            && self.inputs(Stage::Asset).is_ok_and(|inputs| self.lock.is_current(Stage::Asset.name(), &inputs));
        let mut object = match current {
            true => read_object(&self.root, name)?,
            false => self.asset()?.to_exact_object(name)?,
        };
        object.friction = self.friction();
        Ok(object)
    }

    /// The manifest's up has to be the scan's: that of an RGB-D recording is in the frame of its poses.
    fn check_up(&self, file: &files::ScanFile) -> Result<()> {
        let (found, said) = (Vector3::from(file.scan.up_in_mesh), Vector3::from(self.manifest.object.up_in_mesh));
        if found.angle(&said) > MAX_TILT_RAD {
            let [x, y, z] = file.scan.up_in_mesh;
            refuse!(
                "{}: the scan's up is [{x:.4}, {y:.4}, {z:.4}] by {}, {:.0} degrees from that of the manifest: write it as up_in_mesh under [object]",
                self.path("twin.toml").display(),
                file.scan.up_from,
                found.angle(&said).to_degrees()
            );
        }
        Ok(())
    }
}
