//! Sim-ready assets from meshes: repair, convex pieces, mass properties, signed distance, MJCF and URDF.

mod asset;
mod boundary;
mod bvh;
mod caps;
mod error;
mod grid;
mod hull;
mod io;
mod model;
mod pieces;
mod repair;
mod sample;
mod sdf;
#[cfg(test)]
mod shapes;
mod solid;
mod topology;
mod write;

pub use asset::{Asset, AssetOptions, AssetReport, LengthUnit, asset_from_mesh, build_asset};
pub use caps::close_openings;
pub use error::{Error, Result};
pub use grid::{GridOptions, GridSdf};
pub use hull::{convex_hull, convex_hull_with_at_most};
pub use io::{parse_mesh, read_mesh, write_obj, write_ply, write_stl};
pub use pieces::{HowDivided, PieceOptions, convex_pieces};
pub use repair::{DroppedBit, RepairOptions, RepairReport, repair};
pub use sample::{farthest_points, sample_surface};
pub use sdf::MeshSdf;
pub use solid::{HowClosed, Solid, solid_properties};
