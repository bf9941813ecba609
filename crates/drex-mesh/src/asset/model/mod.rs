//! Assets as text and bytes of other programs: MJCF, URDF, GLB.

mod articulated;
mod glb;
mod mjcf;
mod scene;
mod urdf;

use drex_core::{ConvexPart, MassProperties, Pose};
use nalgebra::Point3;

use crate::asset::Asset;

pub(crate) use articulated::{mjcf as articulated_mjcf, urdf as articulated_urdf};
pub(crate) use glb::glb;
pub(crate) use mjcf::mjcf;
pub use scene::{Background, SceneOptions};
pub(crate) use scene::{background_files, scene};
pub(crate) use urdf::urdf;

/// A rigid part as the models see it: its files lie in `mesh/`, its frame is the mesh's.
pub(crate) struct Link<'a> {
    /// Name of the body.
    pub name: &'a str,
    /// What the names of its meshes and geoms start with: empty, or the name and `_`.
    pub prefix: &'a str,
    pub convex_parts: &'a [ConvexPart],
    /// Whether the visual mesh has a picture on it.
    pub textured: bool,
    pub properties: &'a MassProperties,
}

impl<'a> Link<'a> {
    fn of(name: &'a str, prefix: &'a str, part: &'a Asset) -> Self {
        Self {
            name,
            prefix,
            convex_parts: &part.convex_parts,
            textured: part.texture.is_some(),
            properties: &part.properties,
        }
    }

    /// The convex parts with their names, which are those of their meshes without extension.
    fn collisions(&self) -> impl Iterator<Item = (String, &'a ConvexPart)> + '_ {
        self.convex_parts.iter().enumerate().map(|(k, part)| (format!("{}collision_{k:02}", self.prefix), part))
    }

    fn visual(&self) -> String {
        format!("{}visual", self.prefix)
    }
}

/// Numbers with spaces between them, in the shortest form that reads back to the same bits.
fn numbers(values: &[f64]) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

fn place(p: &Point3<f64>) -> String {
    numbers(p.coords.as_slice())
}

/// Position and quaternion of a pose as MJCF writes them.
fn pos_quat(pose: &Pose) -> (String, String) {
    let (t, q) = drex_core::pose::to_wxyz(pose);
    (numbers(&t), numbers(&q))
}

/// Text as the value of an attribute.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
