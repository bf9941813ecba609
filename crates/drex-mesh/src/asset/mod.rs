//! From a mesh file to a simulation asset: visual mesh, collision pieces, mass properties, MJCF and URDF.

mod articulated;
mod contact;
mod joints;
mod model;
mod object;
mod options;
mod texture;
mod write;

use std::path::Path;

use nalgebra::{Matrix3, Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

use drex_core::fsutil::{from_json, read_text};
use drex_core::{ConvexPart, MassProperties, Pose, PoseRecord, PrimitiveRecord, TriMesh};

pub use self::articulated::{ArticulatedAsset, ArticulatedReport, Part, articulated_asset};
pub use self::model::{Background, SceneOptions};
pub use self::options::{AssetOptions, LengthUnit, UpSource};
pub use contact::ContactConfig;
pub use joints::{JointConfig, JointKind, PartConfig, joint_tree};
pub use object::{read_object, solid_object};
pub use texture::TextureMap;

use crate::bvh::Aabb;
use crate::fusion::SurfaceShares;
use crate::hull::hull_volume;
use crate::io::extension;
use crate::mass::{HollowModel, check_mass_properties, principal, shell_properties};
use crate::partition::{PartitionMethod, divide, union_distance};
use crate::repair::{RepairOptions, RepairReport, repair};
use crate::rest::{RestOptions, RestPose, settled_pose, stable_poses, turn};
use crate::solid::{ClosingMethod, Enclosed};
use crate::{Error, Result, read_mesh};

/// An object whose up direction is off by no more than this settles onto its foot, radians.
const MOST_SETTLING: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// Points by which the part of the volume in no convex part is measured.
const COVER_SAMPLES: usize = 4000;

/// Share of the volume in no convex part: doubt, failure.
pub(crate) const UNCOVERED: [f64; 2] = [0.05, 0.15];

/// A simulation asset. Everything is in the frame of the mesh file, in metres.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Asset {
    /// The repaired mesh as the file had it: openings stay open.
    pub visual: TriMesh,
    /// The picture on the visual mesh; [`asset_from_mesh`] leaves it out.
    pub texture: Option<TextureMap>,
    /// Convex collision parts.
    pub convex_parts: Vec<ConvexPart>,
    /// Mass properties of the enclosed solid at uniform density.
    pub properties: MassProperties,
    /// Unit direction that points up when the object stands.
    pub up_in_mesh: Unit<Vector3<f64>>,
    /// Where the object stands on the table z = 0: settled onto its foot if `up_in_mesh` is within 5 degrees of doing so, else
    /// with `up_in_mesh` up. The lowest point is at z = 0, the centre of mass above the origin.
    pub world_from_mesh_at_rest: Pose,
    /// Poses in which the collision pieces rest on a table, the most probable first.
    pub stable_poses: Vec<RestPose>,
    /// Coefficient of sliding friction.
    pub friction: f64,
    /// The other contact parameters.
    pub contact: ContactConfig,
    /// What was found and done.
    pub report: AssetReport,
}

/// Everything worth knowing about how an asset was made; written as `mesh/report.json`.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct AssetReport {
    /// Unit in which the mesh file was read.
    pub unit: LengthUnit,
    /// Where the metric scale comes from.
    pub scale_source: String,
    /// Where the up direction comes from.
    pub up_source: UpSource,
    /// Up in the mesh's frame.
    pub up_in_mesh: [f64; 3],
    /// Sides of the bounding box, metres.
    pub size_m: [f64; 3],
    /// What the repair found and did.
    pub repair: RepairReport,
    /// How the boundary of the solid was obtained.
    #[serde(rename = "how_closed")]
    pub closing_method: ClosingMethod,
    /// Edges without a face on the other side.
    pub open_edges: usize,
    /// Openings.
    pub openings: usize,
    /// Distance across the widest opening, metres.
    pub widest_opening_m: f64,
    /// Share of the boundary that is lids over openings.
    pub lid_area_share: f64,
    /// Volume on which two ways of closing the openings disagree, relative to the volume.
    pub closing_spread: f64,
    /// Share of the mesh's area inside the solid (overlaps, inner walls).
    pub hidden_area_share: f64,
    /// Volume of the solid, m³.
    pub volume_m3: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Density that follows for a solid, kg/m³.
    pub density_kg_m3: f64,
    /// How the mass properties of a hollow object were obtained; `None` for a solid one.
    pub hollow: Option<HollowModel>,
    /// Centre of mass in the mesh's frame, metres.
    pub center_of_mass_m: [f64; 3],
    /// Inertia about the centre of mass along the mesh's axes, kg m², rows.
    pub inertia_kg_m2: [[f64; 3]; 3],
    /// Principal moments of inertia, kg m², ascending.
    pub principal_moments_kg_m2: [f64; 3],
    /// Rotation whose columns are the principal axes in the mesh's frame, quaternion w, x, y, z.
    pub mesh_from_principal_wxyz: [f64; 4],
    /// How the pieces were obtained.
    #[serde(rename = "how_divided")]
    pub partition_method: PartitionMethod,
    /// Number of pieces.
    pub pieces: usize,
    /// The primitive that each piece is, where it is one.
    pub primitives: Vec<Option<PrimitiveRecord>>,
    /// Most corners of a piece.
    pub most_corners: usize,
    /// Sum of the pieces' volumes relative to the solid's (their overlaps count twice).
    pub pieces_to_solid_volume: f64,
    /// Rest pose: where the mesh stands on the table z = 0.
    pub world_from_mesh_at_rest: PoseRecord,
    /// Height of the centre of mass over the table at rest, metres.
    pub rest_height_of_center_m: f64,
    /// How far the centre of mass can move sideways before the object tips, metres; negative if it does not stand.
    pub tipping_margin_m: f64,
    /// Poses in which the object rests on a table, the most probable first.
    pub stable_poses: Vec<RestPose>,
    /// Where the surface of a scan's mesh comes from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceShares>,
    /// What a person should look at.
    pub warnings: Vec<String>,
}

/// Reads a mesh file and makes an asset of it.
///
/// # Errors
/// If an option is out of range, the file cannot be read or is damaged, its unit cannot be told, or it encloses no volume;
/// the message names the file and the remedy.
pub fn build_asset(mesh_path: &Path, options: &AssetOptions) -> Result<Asset> {
    of_file(mesh_path, options, None)
}

/// As [`build_asset`] of the same mesh and options, but with the convex parts that [`Asset::write`] wrote into the folder
/// `out`, to the same bits: they take most of the time.
///
/// # Errors
/// As [`build_asset`], and if `out` holds no whole asset.
pub fn rebuild_asset(mesh_path: &Path, options: &AssetOptions, out: &Path) -> Result<Asset> {
    #[derive(Deserialize)]
    struct Divided {
        #[serde(rename = "how_divided")]
        partition_method: PartitionMethod,
        primitives: Vec<Option<PrimitiveRecord>>,
    }
    let report = out.join("mesh/report.json");
    let Divided { partition_method, primitives } = from_json(&report, &read_text(&report)?)?;
    of_file(mesh_path, options, Some((write::read_parts(out, &primitives)?, partition_method)))
}

fn of_file(
    mesh_path: &Path,
    options: &AssetOptions,
    divided: Option<(Vec<ConvexPart>, PartitionMethod)>,
) -> Result<Asset> {
    options.check()?;
    let mesh = read_mesh(mesh_path)?;
    let gltf = matches!(extension(mesh_path).as_str(), "gltf" | "glb");
    let mut options = options.clone();
    let by_format = gltf && options.up_in_mesh.is_none();
    if gltf {
        options.up_in_mesh = options.up_in_mesh.or(Some(Vector3::y()));
        if options.unit == LengthUnit::Auto {
            options.unit = LengthUnit::Metre;
        }
    }
    let mut asset = of_mesh(&mesh, &options, divided).map_err(|e| e.about(mesh_path))?;
    if by_format {
        asset.report.up_source = UpSource::Format;
    }
    Ok(asset)
}

/// Reads a mesh file as the surface of an object in metres, repaired, without dividing or weighing it; with remarks, one
/// sentence each.
///
/// # Errors
/// If the file cannot be read or is damaged, or its unit cannot be told; the message names the file and the remedy.
pub fn metric_mesh(mesh_path: &Path, unit: LengthUnit) -> Result<(TriMesh, Vec<String>)> {
    let mesh = read_mesh(mesh_path)?;
    let gltf = matches!(extension(mesh_path).as_str(), "gltf" | "glb");
    let unit = if gltf && unit == LengthUnit::Auto { LengthUnit::Metre } else { unit };
    let extent = mesh.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max());
    let mut warnings = Vec::new();
    let (_, factor) = unit.settle(extent, &mut warnings).map_err(|e| e.about(mesh_path))?;
    let (mesh, _) = repair(&mesh.scaled(factor), &RepairOptions::default()).map_err(|e| e.about(mesh_path))?;
    Ok((mesh, warnings))
}

/// Makes an asset of a mesh in memory.
///
/// # Errors
/// As [`build_asset`], without the file.
pub fn asset_from_mesh(mesh: &TriMesh, options: &AssetOptions) -> Result<Asset> {
    options.check()?;
    of_mesh(mesh, options, None)
}

/// The asset, with these pieces where they are known.
fn of_mesh(
    mesh: &TriMesh,
    options: &AssetOptions,
    divided: Option<(Vec<ConvexPart>, PartitionMethod)>,
) -> Result<Asset> {
    let mut warnings = Vec::new();
    let extent = mesh.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max());
    let (unit, factor) = options.unit.settle(extent, &mut warnings)?;
    let (visual, repaired) = repair(&mesh.scaled(factor), &options.repair)?;
    let enclosed = Enclosed::new(&visual)?;
    let solid = &enclosed.solid;
    let (pieces, partition_method) = match divided {
        Some(divided) => divided,
        None => divide(&visual, &enclosed, &options.partition)?,
    };
    if pieces.is_empty() {
        return Err(Error::NoVolume {
            subject: "the mesh".into(),
            reason: "all its convex parts are below 1e-12 m³".into(),
        });
    }
    let uncovered = uncovered(&visual, &pieces)?;
    let (unit_density, hollow) = match options.wall_m {
        Some(wall_m) => shell_properties(&visual, wall_m).map(|h| (h.properties, Some(h.model)))?,
        None => (solid.properties, None),
    };
    let properties = unit_density.with_mass(options.mass_kg.unwrap_or(options.density_kg_m3 * unit_density.mass_kg));
    let center = &properties.center_of_mass;
    check_mass_properties(&properties, &visual.vertices)?;
    let up_in_mesh = Unit::new_normalize(options.up_in_mesh.unwrap_or_else(Vector3::z));
    // What rests in a simulator is the pieces; should they miss the centre (a wafer), the mesh itself.
    let of_pieces: Vec<Point3<f64>> = pieces.iter().flat_map(ConvexPart::corners).copied().collect();
    let (corners, stable_poses) = match stable_poses(&of_pieces, center, &options.rest) {
        Ok(poses) => (&of_pieces, poses),
        Err(_) => (&visual.vertices, stable_poses(&visual.vertices, center, &options.rest)?),
    };
    let (world_from_mesh_at_rest, tipping_margin_m) = rest_on_table(corners, center, &up_in_mesh, &options.rest)?;
    let center = world_from_mesh_at_rest * center;
    let bounds = Aabb::of(&visual.vertices);
    let density = properties.mass_kg / solid.volume_m3;
    let material = properties.mass_kg / unit_density.mass_kg;
    collect_warnings(&repaired, &enclosed, partition_method, material, tipping_margin_m, &mut warnings);
    warnings.extend(uncovered);
    let (moments, axes) = principal(&properties);
    let report = AssetReport {
        unit,
        scale_source: options.scale_source.clone().unwrap_or_else(|| "the unit of the file".into()),
        up_source: if options.up_in_mesh.is_some() { UpSource::Given } else { UpSource::Assumed },
        up_in_mesh: up_in_mesh.into_inner().into(),
        size_m: (bounds.hi - bounds.lo).into(),
        repair: repaired,
        closing_method: solid.closing_method,
        open_edges: solid.open_edges,
        openings: solid.openings,
        widest_opening_m: solid.widest_opening_m,
        lid_area_share: solid.lid_area_share,
        closing_spread: solid.closing_spread,
        hidden_area_share: solid.hidden_area_share,
        volume_m3: solid.volume_m3,
        mass_kg: properties.mass_kg,
        density_kg_m3: density,
        hollow,
        center_of_mass_m: properties.center_of_mass.into(),
        inertia_kg_m2: rows(&properties.inertia),
        principal_moments_kg_m2: moments.into(),
        mesh_from_principal_wxyz: [axes.w, axes.i, axes.j, axes.k],
        partition_method,
        pieces: pieces.len(),
        primitives: pieces.iter().map(|p| p.primitive.as_ref().map(PrimitiveRecord::from)).collect(),
        most_corners: pieces.iter().map(|p| p.corners().len()).max().unwrap_or(0),
        pieces_to_solid_volume: pieces.iter().map(|p| hull_volume(&p.hull)).sum::<f64>() / solid.volume_m3,
        world_from_mesh_at_rest: PoseRecord::from(&world_from_mesh_at_rest),
        rest_height_of_center_m: center.z,
        tipping_margin_m,
        stable_poses: stable_poses.clone(),
        surface: None,
        warnings,
    };
    for warning in &report.warnings {
        tracing::info!("{warning}");
    }
    Ok(Asset {
        visual,
        texture: None,
        convex_parts: pieces,
        properties,
        up_in_mesh,
        world_from_mesh_at_rest,
        stable_poses,
        friction: options.friction,
        contact: options.contact.clone(),
        report,
    })
}

impl Asset {
    /// Writes `mesh/visual.obj`, with a texture also `mesh/visual.mtl` and `mesh/visual.png`, `mesh/collision_NN.obj`,
    /// `mesh/report.json`, `asset/object.xml` (MJCF), `asset/object.urdf` and `asset/object.glb` under `out`. Paths inside the models
    /// are relative.
    ///
    /// Everything is written into a temporary folder first and moved at the end, the models last; collision pieces and textures of
    /// an earlier asset that are no longer used are removed.
    ///
    /// # Errors
    /// If the texture does not fit the mesh or a file cannot be written; what was there before stays.
    pub fn write(&self, out: &Path) -> Result<()> {
        write::write_asset(self, None, out)
    }

    /// As [`Asset::write`], and `asset/scene.xml`: the object at its measured pose, with a background and a robot.
    ///
    /// # Errors
    /// As [`Asset::write`]; also if the robot's file does not exist.
    pub fn write_with_scene(&self, scene: &SceneOptions, out: &Path) -> Result<()> {
        write::write_asset(self, Some(scene), out)
    }

    /// The body's mass at another value, as after weighing or identification; the inertia scales along.
    pub fn with_mass(mut self, mass_kg: f64) -> Self {
        self.properties = self.properties.with_mass(mass_kg);
        self.report.mass_kg = mass_kg;
        self.report.density_kg_m3 = mass_kg / self.report.volume_m3;
        self.report.inertia_kg_m2 = rows(&self.properties.inertia);
        self.report.principal_moments_kg_m2 = principal(&self.properties).0.into();
        self
    }
}

/// A remark if the convex parts leave out some of the solid.
///
/// # Errors
/// If they leave out much: what a simulator touches is not the object.
fn uncovered(visual: &TriMesh, pieces: &[ConvexPart]) -> Result<Option<String>> {
    let [doubt, fail] = UNCOVERED;
    // What encloses no volume by this measure was weighed by another one.
    let Ok(found) = union_distance(visual, pieces, COVER_SAMPLES, 0) else { return Ok(None) };
    let share = found.uncovered_share;
    let what = format!("{:.1} % of the volume is in no convex part", 100.0 * share);
    if share > fail {
        return Err(Error::value(what, "make the convex parts again, with more of them"));
    }
    Ok((share > doubt).then(|| format!("{what}: a simulator does not touch it there; allow more of them")))
}

fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)]))
}

/// How the object stands with `up` up on the table z = 0: settled onto the face below if that takes no more than a few
/// degrees (the up of a scan is no better), else just put down, with a negative tipping margin.
fn rest_on_table(
    corners: &[Point3<f64>],
    center: &Point3<f64>,
    up: &Unit<Vector3<f64>>,
    options: &RestOptions,
) -> Result<(Pose, f64)> {
    let settled = settled_pose(corners, center, up, options)?;
    if settled.support_normal_in_mesh.angle(&-up.into_inner()) <= MOST_SETTLING {
        return Ok((settled.world_from_mesh, settled.tipping_margin_m));
    }
    let rotation = turn(up, &Vector3::z());
    let c = rotation * center;
    let lowest = corners.iter().map(|p| rotation * p).fold(c, |low, p| if p.z < low.z { p } else { low });
    let pose = Pose::from_parts(Vector3::new(-c.x, -c.y, -lowest.z).into(), rotation);
    Ok((pose, -(lowest - c).xy().norm()))
}

fn collect_warnings(
    repaired: &RepairReport,
    enclosed: &Enclosed,
    partition_method: PartitionMethod,
    density: f64,
    tipping_margin_m: f64,
    warnings: &mut Vec<String>,
) {
    let solid = &enclosed.solid;
    let mut warn = |condition: bool, text: String| {
        if condition {
            warnings.push(text);
        }
    };
    warn(
        solid.closing_spread > 0.01,
        format!("closing the openings one way or another changes {:.1} % of the volume", 100.0 * solid.closing_spread),
    );
    warn(
        solid.lid_area_share > 0.2,
        format!("{:.0} % of the surface is lids over openings", 100.0 * solid.lid_area_share),
    );
    warn(
        !repaired.dropped.is_empty(),
        format!(
            "{} loose components with {:.2} % of the area were dropped",
            repaired.dropped.len(),
            100.0 * repaired.dropped.iter().map(|d| d.area_share).sum::<f64>()
        ),
    );
    warn(repaired.bodies > 1, format!("the mesh has {} separate bodies, here rigidly joined", repaired.bodies));
    warn(
        !(20.0..=20_000.0).contains(&density),
        format!("a density of {density:.3} kg/m³ is not that of a solid: check mass and unit"),
    );
    warn(
        partition_method == PartitionMethod::HullAsLastResort,
        "the convex decomposition failed: one hull fills the concavities".into(),
    );
    warn(tipping_margin_m < 0.0, "the object does not stand with this side up: it will tip over".into());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::cuboid;

    #[test]
    fn the_unit_is_told_or_asked_for() {
        let mm = cuboid([0.0; 3], [80.0, 40.0, 20.0]);
        let asset = asset_from_mesh(&mm, &AssetOptions::default()).unwrap();
        assert_eq!(asset.report.unit, LengthUnit::Millimetre);
        assert!((asset.properties.mass_kg - 0.064).abs() < 1e-12);
        assert!(asset.report.warnings[0].contains("millimetres"));
        let doubtful = mm.scaled(0.1);
        assert!(
            asset_from_mesh(&doubtful, &AssetOptions::default()).unwrap_err().to_string().contains("state the unit")
        );
        let cm = AssetOptions { unit: LengthUnit::Centimetre, ..AssetOptions::default() };
        assert!((asset_from_mesh(&doubtful, &cm).unwrap().properties.mass_kg - 0.064).abs() < 1e-12);
    }

    #[test]
    fn a_rebuilt_asset_is_the_same_to_the_last_bit() {
        let dir = tempfile::tempdir().unwrap();
        let (file, out) = (dir.path().join("cup.obj"), dir.path().join("out"));
        // Two boxes that meet at a corner of an L are no hull.
        let mut mesh = cuboid([0.0; 3], [0.1, 0.03, 0.02]);
        let other = cuboid([0.0, 0.0, 0.02], [0.03, 0.03, 0.1 / 3.0]);
        mesh.append(&other);
        crate::io::write_obj(&file, &mesh).unwrap();
        let built = build_asset(&file, &AssetOptions::default()).unwrap();
        built.clone().with_mass(0.3).write(&out).unwrap();
        let again = rebuild_asset(&file, &AssetOptions::default(), &out).unwrap();
        assert!(built.convex_parts.len() > 1);
        assert_eq!(format!("{built:?}"), format!("{again:?}"));
        std::fs::remove_file(out.join("mesh/collision_01.obj")).unwrap();
        let message = rebuild_asset(&file, &AssetOptions::default(), &out).unwrap_err().to_string();
        assert!(message.contains("collision_01.obj"), "{message}");
    }

    #[test]
    fn it_stands_on_the_side_that_is_asked_for() {
        let mesh = cuboid([0.0; 3], [0.02, 0.04, 0.1]);
        for (up, height) in [(Vector3::z(), 0.05), (-Vector3::z(), 0.05), (Vector3::x(), 0.01), (-Vector3::y(), 0.02)] {
            let options = AssetOptions { up_in_mesh: Some(up * 3.0), ..AssetOptions::default() };
            let asset = asset_from_mesh(&mesh, &options).unwrap();
            assert!((asset.report.rest_height_of_center_m - height).abs() < 1e-12);
            assert!((asset.world_from_mesh_at_rest * up - Vector3::z()).norm() < 1e-12);
            let lowest = mesh.vertices.iter().map(|v| (asset.world_from_mesh_at_rest * v).z).fold(1.0, f64::min);
            assert!(lowest.abs() < 1e-12);
            assert!(asset.report.tipping_margin_m > 0.009);
        }
        let corner = AssetOptions { up_in_mesh: Some(Vector3::new(1.0, 0.2, 0.1)), ..AssetOptions::default() };
        assert!(asset_from_mesh(&mesh, &corner).unwrap().report.warnings.iter().any(|w| w.contains("tip over")));
    }

    #[test]
    fn impossible_options_are_refused() {
        let mesh = cuboid([0.0; 3], [0.1; 3]);
        for options in [
            AssetOptions { mass_kg: Some(0.0), ..AssetOptions::default() },
            AssetOptions { density_kg_m3: f64::NAN, ..AssetOptions::default() },
            AssetOptions { friction: -0.1, ..AssetOptions::default() },
            AssetOptions { up_in_mesh: Some(Vector3::zeros()), ..AssetOptions::default() },
        ] {
            assert!(matches!(asset_from_mesh(&mesh, &options), Err(Error::Value { .. })));
        }
    }
}
