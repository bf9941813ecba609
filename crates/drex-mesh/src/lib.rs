//! From depth maps to closed meshes, and from meshes to sim-ready assets: fusion, repair, convex parts, mass properties, stable
//! poses, signed distance, MJCF and URDF.
//!
//! [`build_asset`] does the whole way from a file to an [`Asset`]; its steps can be used alone:
//! [`fuse`], [`read_mesh`], [`repair()`], [`decimate`], [`solid_properties`], [`convex_parts`], [`stable_poses`], [`MeshSdf`] and its fast
//! sibling [`GridSdf`]. [`check_mesh`] judges a mesh by 17 rules, [`check_scan`] by what its scan says of it.
//!
//! ```
//! use drex_core::mesh::convex_hull;
//! use drex_mesh::{RepairOptions, repair, solid_properties};
//! use nalgebra::Point3;
//!
//! let tip = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]].map(Point3::from);
//! let mut mesh = convex_hull(&tip)?;
//! mesh.faces.iter_mut().for_each(|f| f.swap(0, 1)); // wound inwards
//! let (mesh, report) = repair(&mesh, &RepairOptions::default())?;
//! assert_eq!(report.flipped_faces, 4);
//! let solid = solid_properties(&mesh)?;
//! assert!((solid.volume_m3 - 1e-3 / 6.0).abs() < 1e-15);
//! # Ok::<(), drex_mesh::Error>(())
//! ```
//!
//! Conventions: metres, the frame of the mesh file, faces counter-clockwise seen from outside, distances negative inside.

mod asset;
mod boundary;
mod bvh;
mod caps;
mod check;
mod compare;
mod decimate;
mod depth;
mod error;
mod fill;
mod fusion;
mod grid;
mod hull;
mod intersect;
mod io;
mod mass;
mod orient;
mod partition;
mod primitive;
mod repair;
mod rest;
mod scale;
mod scene;
mod sdf;
mod sequence;
#[cfg(test)]
mod shapes;
mod solid;
mod topology;
mod weld;

pub use asset::{
    ArticulatedAsset, ArticulatedReport, Asset, AssetOptions, AssetReport, Background, ContactConfig, JointConfig,
    JointKind, LengthUnit, Part, PartConfig, SceneOptions, TextureMap, UpSource, articulated_asset, asset_from_mesh,
    build_asset, joint_tree, metric_mesh, read_object, rebuild_asset, solid_object,
};
pub use check::{
    CheckOptions, CheckReport, Outcome, RuleResult, ScanCamera, ScanEvidence, Silhouette, SupportEvidence, check_asset,
    check_file, check_mesh, check_scan,
};
pub use compare::{CompareOptions, SurfaceComparison, compare_surfaces};
pub use decimate::{DecimateOptions, DecimateReport, decimate};
pub use depth::{DepthCamera, DepthMap, DepthViews, cast_depth};
pub use error::{Error, Result};
pub use fill::close_openings;
pub use fusion::{
    DroppedPart, Evidence, EvidenceKind, Fused, FusionOptions, FusionReport, Support, SurfaceShares, fuse,
    write_evidence,
};
pub use grid::{GridOptions, GridSdf};
pub use hull::convex_hull_with_at_most;
pub use intersect::self_intersections;
pub use io::{
    Material, Model, ModelPart, PlyFormat, Texture, parse_mesh, read_mesh, read_model, write_glb, write_mesh,
    write_obj, write_obj_model, write_ply, write_ply_as, write_stl, write_stl_text,
};
pub use mass::{Hollow, HollowModel, check_mass_properties, principal, shell_properties};
pub use partition::{PartitionMethod, PartitionOptions, UnionDistance, convex_parts, union_distance};
pub use primitive::primitive;
pub use repair::{DroppedComponent, RepairOptions, RepairReport, repair};
pub use rest::{RestOptions, RestPose, settled_pose, stable_poses};
pub use scale::{
    DistanceResidual, KnownDistance, Marks, ScaleFit, Sighting, Similarity, TablePlane, Triangulated, read_marks,
    scale_from_distances, sheet_from_marks, triangulate, triangulate_marks,
};
pub use scene::{
    Choice, Click, Found, ObjectGroup, PlaneCandidate, Scene, ScenePoint, SceneView, Scores, SupportChoice,
    SupportOptions, UpPrior, find_objects, silhouette_base, support_plane,
};
pub use sdf::MeshSdf;
pub use solid::{ClosingMethod, Solid, solid_properties};

/// The examples of the README are compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
