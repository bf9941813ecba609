//! The twin folder: what the stages wrote, and what all of them are placed by.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use drex_core::ASSUMED_FRICTION;
use drex_core::{Pose, TriMesh, fsutil, pose};
use drex_mesh::{MeshSdf, Similarity};
use drex_robot::Robot;
use drex_twin::manifest::TwinManifest;
use nalgebra::{Matrix4, Similarity3, Translation3};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};

/// Colour of the object.
pub const OBJECT_RGBA: [u8; 4] = [214, 170, 110, 255];
/// Length of a force's arrow, metres per newton.
pub const ARROW_M_PER_N: f64 = 0.02;

/// A twin folder.
pub struct Twin {
    /// The folder.
    pub root: PathBuf,
    /// What is given.
    pub manifest: TwinManifest,
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
        let file = if path.is_dir() { path.join("twin.toml") } else { path.to_path_buf() };
        let manifest = TwinManifest::load(&file)?;
        let root = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf();
        let mut twin =
            Self { root, manifest, world_from_mesh: Pose::identity(), mesh: None, surface: None, missing: Vec::new() };
        if let Some(model) = twin.stage("asset/object.xml", "the frame of the mesh stands for the world") {
            twin.world_from_mesh = Robot::load(&model)?.file_world_from_base;
        }
        if let Some(file) = twin.stage("mesh/visual.obj", "the object is not shown") {
            let mesh = TriMesh::read(&file)?;
            match MeshSdf::new(&mesh) {
                Ok(surface) => twin.surface = Some(surface),
                Err(e) => twin.missing.push(format!("contacts: {}: {e}", file.display())),
            }
            twin.mesh = Some(mesh);
        }
        Ok(twin)
    }

    /// A file of the twin folder.
    pub fn path(&self, relative: impl AsRef<Path>) -> PathBuf {
        self.root.join(relative)
    }

    /// A file that a stage writes; without it a remark with what follows from that.
    pub fn stage(&mut self, relative: &str, otherwise: &str) -> Option<PathBuf> {
        let file = self.path(relative);
        if file.exists() {
            return Some(file);
        }
        self.missing.push(format!("{} is not there: {otherwise}; drex run makes it", file.display()));
        None
    }

    /// What a stage wrote as JSON; none, with a remark, if it has not.
    ///
    /// # Errors
    /// If the file is damaged.
    pub fn json<T: DeserializeOwned>(&mut self, relative: &str, otherwise: &str) -> Result<Option<T>> {
        let Some(file) = self.stage(relative, otherwise) else { return Ok(None) };
        let read = serde_json::from_slice(&fsutil::read_bytes(&file)?);
        Ok(Some(read.with_context(|| {
            format!("{} is not what drex writes there; delete it and run drex run again", file.display())
        })?))
    }

    /// Friction of the object against the hand.
    pub fn friction(&self) -> f64 {
        self.manifest.object.friction.unwrap_or(ASSUMED_FRICTION)
    }
}

/// `world_from_scan` of a 4 x 4 `mesh_from_scan` by rows.
pub fn similarity(world_from_mesh: &Pose, mesh_from_scan: &[[f64; 4]; 4]) -> Result<Similarity3<f64>> {
    let s = Similarity::from_matrix(&Matrix4::from_fn(|r, c| mesh_from_scan[r][c]))?;
    Ok(world_from_mesh * Similarity3::from_parts(Translation3::from(s.translation), s.rotation, s.scale))
}

/// A pose as the stages write it.
#[derive(Debug, Clone, Copy)]
pub struct PoseRecord(pub Pose);

impl<'de> Deserialize<'de> for PoseRecord {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        struct Parts {
            translation_m: [f64; 3],
            quat_wxyz: [f64; 4],
        }
        let parts = Parts::deserialize(deserializer)?;
        pose::pose_from_wxyz(parts.translation_m, parts.quat_wxyz).map(Self).map_err(serde::de::Error::custom)
    }
}
