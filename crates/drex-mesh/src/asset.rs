//! From a mesh file to a simulation asset: visual mesh, collision pieces, mass properties, MJCF and URDF.

use std::path::Path;

use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use serde::Serialize;

use drex_core::{MassProperties, Pose, TriMesh};

use crate::bvh::Aabb;
use crate::hull::hull_volume;
use crate::io::extension;
use crate::pieces::{HowDivided, PieceOptions, divide};
use crate::repair::{RepairOptions, RepairReport, repair};
use crate::solid::{Enclosed, HowClosed};
use crate::{Error, Result, read_mesh, write};

/// The unit of length of a mesh file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LengthUnit {
    /// Metres if the mesh is then 1 mm to 2 m across, millimetres if that makes it 20 mm to 3 m, else an error; glTF: metres.
    #[default]
    Auto,
    /// Metres.
    Metre,
    /// Centimetres.
    Centimetre,
    /// Millimetres.
    Millimetre,
    /// Inches.
    Inch,
}

impl LengthUnit {
    /// Metres in one unit; `None` for [`LengthUnit::Auto`].
    pub fn in_metres(self) -> Option<f64> {
        match self {
            Self::Auto => None,
            Self::Metre => Some(1.0),
            Self::Centimetre => Some(0.01),
            Self::Millimetre => Some(0.001),
            Self::Inch => Some(0.0254),
        }
    }
}

impl std::str::FromStr for LengthUnit {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        match name {
            "auto" => Ok(Self::Auto),
            "m" => Ok(Self::Metre),
            "cm" => Ok(Self::Centimetre),
            "mm" => Ok(Self::Millimetre),
            "in" => Ok(Self::Inch),
            _ => Err(Error::value(format!("{name:?} is no unit of length"), "give m, cm, mm, in or auto")),
        }
    }
}

/// Settings of [`build_asset`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AssetOptions {
    /// Mass of the object, kg. `None`: density times volume.
    pub mass_kg: Option<f64>,
    /// Density where no mass is given, kg/m³.
    pub density_kg_m3: f64,
    /// Direction in the mesh's frame that points up when the object stands. `None`: +z, for glTF +y.
    pub up_in_mesh: Option<Vector3<f64>>,
    /// Coefficient of sliding friction of object and table.
    pub friction: f64,
    /// Unit of the mesh file.
    pub unit: LengthUnit,
    /// Settings of the repair.
    pub repair: RepairOptions,
    /// Settings of the convex pieces.
    pub pieces: PieceOptions,
}

impl Default for AssetOptions {
    fn default() -> Self {
        Self {
            mass_kg: None,
            density_kg_m3: 1000.0,
            up_in_mesh: None,
            friction: 0.5,
            unit: LengthUnit::Auto,
            repair: RepairOptions::default(),
            pieces: PieceOptions::default(),
        }
    }
}

impl AssetOptions {
    fn check(&self) -> Result<()> {
        let positive = |value: f64, name: &str| {
            if value > 0.0 && value.is_finite() {
                return Ok(());
            }
            Err(Error::value(format!("the {name} is {value}"), "give a positive number"))
        };
        positive(self.mass_kg.unwrap_or(1.0), "mass in kg")?;
        positive(self.density_kg_m3, "density in kg/m³")?;
        positive(self.friction, "friction coefficient")?;
        if self.up_in_mesh.is_some_and(|u| !(u.norm() > 1e-9 && u.norm().is_finite())) {
            return Err(Error::value("the up direction has no length", "give a direction such as 0 0 1"));
        }
        Ok(())
    }
}

/// A simulation asset. Everything is in the frame of the mesh file, in metres.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Asset {
    /// The repaired mesh as the file had it: openings stay open.
    pub visual: TriMesh,
    /// Convex collision pieces.
    pub pieces: Vec<TriMesh>,
    /// Mass properties of the enclosed solid at uniform density.
    pub properties: MassProperties,
    /// Unit direction that points up when the object stands.
    pub up_in_mesh: Unit<Vector3<f64>>,
    /// Where the object stands on the table z = 0: up is world +z, the lowest point at z = 0, the centre of mass above the
    /// origin.
    pub world_from_mesh_at_rest: Pose,
    /// Coefficient of sliding friction.
    pub friction: f64,
    /// What was found and done.
    pub report: AssetReport,
}

/// Everything worth knowing about how an asset was made; written as `mesh/report.json`.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct AssetReport {
    /// Unit in which the mesh file was read.
    pub unit: LengthUnit,
    /// Sides of the bounding box, metres.
    pub size_m: [f64; 3],
    /// What the repair found and did.
    pub repair: RepairReport,
    /// How the boundary of the solid was obtained.
    pub how_closed: HowClosed,
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
    /// Density that follows, kg/m³.
    pub density_kg_m3: f64,
    /// Centre of mass in the mesh's frame, metres.
    pub center_of_mass_m: [f64; 3],
    /// Inertia about the centre of mass along the mesh's axes, kg m², rows.
    pub inertia_kg_m2: [[f64; 3]; 3],
    /// How the pieces were obtained.
    pub how_divided: HowDivided,
    /// Number of pieces.
    pub pieces: usize,
    /// Most corners of a piece.
    pub most_corners: usize,
    /// Sum of the pieces' volumes relative to the solid's (their overlaps count twice).
    pub pieces_to_solid_volume: f64,
    /// Height of the centre of mass over the table at rest, metres.
    pub rest_height_of_center_m: f64,
    /// How far the centre of mass can move sideways before the object tips, metres; negative if it does not stand.
    pub tipping_margin_m: f64,
    /// What a person should look at.
    pub warnings: Vec<String>,
}

/// Reads a mesh file and makes an asset of it.
///
/// # Errors
/// If an option is out of range, the file cannot be read or is damaged, its unit cannot be told, or it encloses no volume;
/// the message names the file and the remedy.
pub fn build_asset(mesh_path: &Path, options: &AssetOptions) -> Result<Asset> {
    options.check()?;
    let mesh = read_mesh(mesh_path)?;
    let gltf = matches!(extension(mesh_path).as_str(), "gltf" | "glb");
    let mut options = options.clone();
    if gltf {
        options.up_in_mesh = options.up_in_mesh.or(Some(Vector3::y()));
        if options.unit == LengthUnit::Auto {
            options.unit = LengthUnit::Metre;
        }
    }
    asset_from_mesh(&mesh, &options).map_err(|e| e.about(mesh_path))
}

/// Makes an asset of a mesh in memory.
///
/// # Errors
/// As [`build_asset`], without the file.
pub fn asset_from_mesh(mesh: &TriMesh, options: &AssetOptions) -> Result<Asset> {
    options.check()?;
    let mut warnings = Vec::new();
    let (unit, factor) = settle_unit(mesh, options.unit, &mut warnings)?;
    let (visual, repaired) = repair(&mesh.scaled(factor), &options.repair)?;
    let enclosed = Enclosed::new(&visual)?;
    let solid = &enclosed.solid;
    let (pieces, how_divided) = divide(&visual, &enclosed, &options.pieces)?;
    if pieces.is_empty() {
        return Err(Error::NoVolume {
            subject: "the mesh".into(),
            reason: "all its convex pieces are below 1e-12 m³".into(),
        });
    }
    let properties = solid.properties.with_mass(options.mass_kg.unwrap_or(options.density_kg_m3 * solid.volume_m3));
    let up_in_mesh = Unit::new_normalize(options.up_in_mesh.unwrap_or_else(Vector3::z));
    let (world_from_mesh_at_rest, tipping_margin_m) = rest(&pieces, &properties.center_of_mass, &up_in_mesh);
    let center = world_from_mesh_at_rest * properties.center_of_mass;
    let bounds = Aabb::of(&visual.vertices);
    let density = properties.mass_kg / solid.volume_m3;
    collect_warnings(&repaired, &enclosed, how_divided, density, tipping_margin_m, &mut warnings);
    let report = AssetReport {
        unit,
        size_m: (bounds.hi - bounds.lo).into(),
        repair: repaired,
        how_closed: solid.how_closed,
        open_edges: solid.open_edges,
        openings: solid.openings,
        widest_opening_m: solid.widest_opening_m,
        lid_area_share: solid.lid_area_share,
        closing_spread: solid.closing_spread,
        hidden_area_share: solid.hidden_area_share,
        volume_m3: solid.volume_m3,
        mass_kg: properties.mass_kg,
        density_kg_m3: density,
        center_of_mass_m: properties.center_of_mass.into(),
        inertia_kg_m2: [0, 1, 2].map(|i| [0, 1, 2].map(|j| properties.inertia[(i, j)])),
        how_divided,
        pieces: pieces.len(),
        most_corners: pieces.iter().map(|p| p.vertices.len()).max().unwrap_or(0),
        pieces_to_solid_volume: pieces.iter().map(hull_volume).sum::<f64>() / solid.volume_m3,
        rest_height_of_center_m: center.z,
        tipping_margin_m,
        warnings,
    };
    for warning in &report.warnings {
        tracing::info!("{warning}");
    }
    let friction = options.friction;
    Ok(Asset { visual, pieces, properties, up_in_mesh, world_from_mesh_at_rest, friction, report })
}

impl Asset {
    /// Writes `mesh/visual.obj`, `mesh/collision_NN.obj`, `mesh/report.json`, `asset/object.xml` (MJCF) and
    /// `asset/object.urdf` under `out`. Paths inside the models are relative.
    ///
    /// Everything is written into a temporary folder first and moved at the end, the models last; collision pieces of
    /// an earlier asset that are no longer used are removed.
    ///
    /// # Errors
    /// If a file cannot be written; what was there before stays.
    pub fn write(&self, out: &Path) -> Result<()> {
        write::write_asset(self, out)
    }

    /// The body's mass at another value, as after weighing or identification; the inertia scales along.
    pub fn with_mass(mut self, mass_kg: f64) -> Self {
        self.properties = self.properties.with_mass(mass_kg);
        self.report.mass_kg = mass_kg;
        self.report.density_kg_m3 = mass_kg / self.report.volume_m3;
        self.report.inertia_kg_m2 = [0, 1, 2].map(|i| [0, 1, 2].map(|j| self.properties.inertia[(i, j)]));
        self
    }
}

fn settle_unit(mesh: &TriMesh, unit: LengthUnit, warnings: &mut Vec<String>) -> Result<(LengthUnit, f64)> {
    if let Some(factor) = unit.in_metres() {
        return Ok((unit, factor));
    }
    let extent = mesh.bounds().map_or(0.0, |(lo, hi)| (hi - lo).max());
    let refuse = |why| Err(Error::Unit { subject: "the mesh".into(), extent, why });
    match extent {
        e if !e.is_finite() => Ok((LengthUnit::Metre, 1.0)), // the repair names the vertex
        e if e < 1e-3 => refuse("less than a millimetre if it is metres"),
        e if e <= 2.0 => Ok((LengthUnit::Metre, 1.0)),
        e if e < 20.0 => refuse("too large for metres and doubtful for millimetres"),
        e if e <= 3000.0 => {
            warnings.push(format!("the mesh is {e:.1} units across: taken as millimetres"));
            Ok((LengthUnit::Millimetre, 1e-3))
        }
        _ => refuse("too large even for millimetres"),
    }
}

/// The pose at rest and how far inside the support polygon the centre of mass is.
fn rest(pieces: &[TriMesh], center: &Point3<f64>, up: &Unit<Vector3<f64>>) -> (Pose, f64) {
    // Opposite directions have no unique turn between them; any half turn about a horizontal axis does.
    let rotation = UnitQuaternion::rotation_between_axis(up, &Vector3::z_axis())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let points: Vec<Point3<f64>> = pieces.iter().flat_map(|p| &p.vertices).map(|v| rotation * v).collect();
    let lowest = points.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    let c = rotation * center;
    let pose = Pose::from_parts(Vector3::new(-c.x, -c.y, -lowest).into(), rotation);
    let bounds = Aabb::of(&points);
    // Scans are not flat: an object that settles by a degree or so stands.
    let size = bounds.hi - bounds.lo;
    let foot = lowest + 0.02 * size.x.hypot(size.y);
    let feet: Vec<[f64; 2]> = points.iter().filter(|p| p.z <= foot).map(|p| [p.x - c.x, p.y - c.y]).collect();
    (pose, margin_inside_hull(&feet))
}

/// Distance of the origin from the border of the convex hull of points in the plane, negative outside.
fn margin_inside_hull(points: &[[f64; 2]]) -> f64 {
    let nearest = points.iter().map(|p| p[0].hypot(p[1])).fold(f64::INFINITY, f64::min);
    // Support in every direction: the least reach over directions is the margin (1/4 degree steps suffice here).
    let steps = 1440;
    let reach = (0..steps)
        .map(|k| {
            let a = std::f64::consts::TAU * f64::from(k) / f64::from(steps);
            points.iter().map(|p| p[0] * a.cos() + p[1] * a.sin()).fold(f64::NEG_INFINITY, f64::max)
        })
        .fold(f64::INFINITY, f64::min);
    if reach < 0.0 { -(-reach).min(nearest) } else { reach }
}

fn collect_warnings(
    repaired: &RepairReport,
    enclosed: &Enclosed,
    how_divided: HowDivided,
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
            "{} loose bits with {:.2} % of the area were dropped",
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
        how_divided == HowDivided::HullAsLastResort,
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
