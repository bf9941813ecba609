//! A scene around an asset: background, robot, measured pose.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use drex_core::fsutil::relative_path;
use drex_core::{ConvexPart, Error as CoreError, Pose, TriMesh};

use super::mjcf::{TABLE, defaults, free_body, header, meshes, shape};
use super::{Link, escaped, pos_quat};
use crate::Result;
use crate::asset::Asset;
use crate::io::obj_text;

/// What stands around the object in `asset/scene.xml`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SceneOptions {
    /// The static scene.
    pub background: Option<Background>,
    /// Measured pose of the object in the world. `None`: at rest over the origin.
    pub world_from_object: Option<Pose>,
    /// A robot's MJCF file. It is named, not copied: its meshes, defaults and settings stay its own, and all its names get
    /// the prefix `robot_`.
    pub robot: Option<PathBuf>,
    /// Where the robot's own world lies in this one.
    pub world_from_robot: Pose,
    /// Whether there is a table at z = 0.
    pub table: bool,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self { background: None, world_from_object: None, robot: None, world_from_robot: Pose::identity(), table: true }
    }
}

/// A static scene, in world coordinates, metres.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Background {
    /// What is seen.
    pub visual: TriMesh,
    /// What is touched: convex parts, as from [`crate::convex_parts`]; may be empty.
    pub convex_parts: Vec<ConvexPart>,
}

/// MJCF of the asset in its scene; `folder` is where the file will lie.
pub(crate) fn scene(asset: &Asset, options: &SceneOptions, folder: &Path) -> Result<String> {
    let link = Link::of("object", "", asset);
    let mut assets = meshes(&link);
    let mut world =
        if options.table { TABLE.to_string() } else { TABLE.lines().take(1).map(|l| format!("{l}\n")).collect() };
    if let Some(robot) = &options.robot {
        if !robot.is_file() {
            return Err(CoreError::io("read", robot, std::io::Error::from(std::io::ErrorKind::NotFound)).into());
        }
        let file = relative_path(robot, folder);
        let (pos, quat) = pos_quat(&options.world_from_robot);
        // Writing to a string cannot fail.
        let _ = writeln!(assets, "    <model name=\"robot\" file=\"{}\"/>", escaped(&file.to_string_lossy()));
        let _ = writeln!(
            world,
            "    <frame name=\"robot\" pos=\"{pos}\" quat=\"{quat}\">\n      <attach model=\"robot\" prefix=\"robot_\"/>\n    </frame>"
        );
    }
    if let Some(background) = &options.background {
        let _ = writeln!(world, "    <body name=\"background\">");
        let _ = writeln!(assets, "    <mesh name=\"background\" file=\"../mesh/background.obj\" inertia=\"shell\"/>");
        let _ = writeln!(world, "      <geom name=\"background\" class=\"visual\" mesh=\"background\"/>");
        for (k, part) in background.convex_parts.iter().enumerate() {
            let name = background_part(k);
            if part.primitive.is_none() {
                let _ = writeln!(assets, "    <mesh name=\"{name}\" file=\"../mesh/{name}.obj\"/>");
            }
            let _ = writeln!(world, "      <geom name=\"{name}\" class=\"collision\" {}/>", shape(&name, part));
        }
        world.push_str("    </body>\n");
    }
    let pose = options.world_from_object.unwrap_or(asset.world_from_mesh_at_rest);
    Ok(format!(
        "<mujoco model=\"scene\">\n{}{}  <asset>\n{assets}  </asset>\n  <worldbody>\n{world}{}    </body>\n  \
         </worldbody>\n</mujoco>\n",
        header(true),
        defaults(asset.friction, &asset.contact),
        free_body(&link, &pose),
    ))
}

fn background_part(k: usize) -> String {
    format!("background_collision_{k:02}")
}

/// Files of the background's meshes.
pub(crate) fn background_files(background: &Background) -> Vec<(String, Vec<u8>)> {
    let parts = background.convex_parts.iter().enumerate().map(|(k, part)| (background_part(k), &part.hull));
    std::iter::once(("background".to_owned(), &background.visual))
        .chain(parts)
        .map(|(name, mesh)| (format!("mesh/{name}.obj"), obj_text(mesh).into_bytes()))
        .collect()
}
