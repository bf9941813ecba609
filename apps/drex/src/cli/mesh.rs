//! Arguments of `mesh`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use drex_mesh::LengthUnit;

use super::values::positive;

/// `drex mesh`.
#[derive(Debug, Subcommand)]
pub enum MeshCommand {
    /// Judge a mesh file, or a written asset (its folder or MJCF), by the rules of simulation; exit status 1 if one fails.
    Check(MeshCheckArgs),
    /// Repair, simplify if asked, and write in another format (by the name's ending).
    Convert(MeshConvertArgs),
    /// Draw meshes into a PNG, each in a colour of its own.
    Picture(MeshPictureArgs),
}

/// `drex mesh check`.
#[derive(Debug, Args)]
pub struct MeshCheckArgs {
    /// Mesh file, folder of an asset, or its object.xml.
    pub file: PathBuf,
    /// Unit of a mesh file: m, cm, mm, in, or auto (told by the size).
    #[arg(long, value_name = "UNIT", default_value = "auto")]
    pub unit: LengthUnit,
}

/// `drex mesh convert`.
#[derive(Debug, Args)]
pub struct MeshConvertArgs {
    /// STL, OBJ, PLY, GLTF or GLB file.
    pub input: PathBuf,
    /// File to write: .obj, .stl, .ply or .glb.
    pub output: PathBuf,
    /// Faces wanted.
    #[arg(long, value_name = "N")]
    pub faces: Option<usize>,
    /// Largest distance between the simplified and the given surface, in the file's unit.
    #[arg(long, value_name = "LENGTH", value_parser = positive)]
    pub max_error: Option<f64>,
}

/// `drex mesh picture`.
#[derive(Debug, Args)]
pub struct MeshPictureArgs {
    /// STL, OBJ, PLY, GLTF or GLB files.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// PNG file to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Pixels of each side.
    #[arg(long, value_name = "PX", default_value_t = 640, value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub size: u32,
    /// Direction of the eye from +x towards +y, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 35.0, allow_hyphen_values = true)]
    pub azimuth: f64,
    /// Height of the eye over the horizon, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 25.0, allow_hyphen_values = true)]
    pub elevation: f64,
}
