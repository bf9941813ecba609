//! The twin folder with its object placed in the world, and what of it is not there.

use std::path::{Path, PathBuf};

use anyhow::Result;
use drex_core::{Pose, TriMesh};
use drex_mesh::MeshSdf;
use drex_robot::Robot;
use drex_twin::records::read_json;
use serde::de::DeserializeOwned;

/// Colour of the object.
pub const OBJECT_RGBA: [u8; 4] = [214, 170, 110, 255];
/// Length of a force's arrow, metres per newton.
pub const ARROW_M_PER_N: f64 = 0.02;

/// A twin folder and its object.
pub struct Twin {
    /// The folder: what is given, and where things lie.
    pub folder: drex_twin::Twin,
    /// How the object rests on the table: world from the mesh's frame.
    pub world_from_mesh: Pose,
    /// The mended mesh, metres, in its own frame.
    pub mesh: Option<TriMesh>,
    /// Distances to that mesh, for contacts.
    pub surface: Option<MeshSdf>,
    /// What is not there to be recorded, one sentence each.
    pub missing: Vec<String>,
}

impl Twin {
    /// Opens the twin at `path`: a `twin.toml` or the folder that holds it.
    ///
    /// # Errors
    /// If there is no manifest, or it or the asset is damaged. What no stage has made yet is remarked.
    pub fn open(path: &Path) -> Result<Self> {
        let folder = drex_twin::Twin::open(path)?;
        let mut twin =
            Self { folder, world_from_mesh: Pose::identity(), mesh: None, surface: None, missing: Vec::new() };
        if let Some(model) = twin.made("asset/object.xml", "the frame of the mesh stands for the world") {
            twin.world_from_mesh = Robot::load(&model)?.file_world_from_base;
        }
        if let Some(file) = twin.made("mesh/visual.obj", "the object is not shown") {
            let mesh = TriMesh::read(&file)?;
            match MeshSdf::new(&mesh) {
                Ok(surface) => twin.surface = Some(surface),
                Err(e) => twin.missing.push(format!("contacts: {}: {e}", file.display())),
            }
            twin.mesh = Some(mesh);
        }
        Ok(twin)
    }

    /// A file that a stage writes; without it a remark with what follows from that.
    pub fn made(&mut self, relative: &str, otherwise: &str) -> Option<PathBuf> {
        let file = self.folder.path(relative);
        if file.exists() {
            return Some(file);
        }
        self.missing.push(format!("{} is not there: {otherwise}; drex run makes it", file.display()));
        None
    }

    /// The record that a stage wrote; none, with a remark, if it has not.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn record<T: DeserializeOwned>(&mut self, relative: &str, otherwise: &str) -> Result<Option<T>> {
        Ok(self.made(relative, otherwise).map(|file| read_json(&file)).transpose()?)
    }
}
