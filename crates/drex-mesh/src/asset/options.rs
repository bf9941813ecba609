//! Settings of an asset.

use nalgebra::Vector3;
use serde::Serialize;

use super::contact::ContactConfig;

use crate::partition::PartitionOptions;
use crate::repair::RepairOptions;
use crate::rest::RestOptions;
use crate::{Error, Result};

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

    /// The unit itself and metres in it; [`LengthUnit::Auto`] is decided by the largest side of the bounding box.
    pub(crate) fn settle(self, extent: f64, warnings: &mut Vec<String>) -> Result<(Self, f64)> {
        if let Some(factor) = self.in_metres() {
            return Ok((self, factor));
        }
        let refuse = |why| Err(Error::Unit { subject: "the mesh".into(), extent, why });
        match extent {
            e if !e.is_finite() => Ok((Self::Metre, 1.0)), // the repair names the vertex
            e if e < 1e-3 => refuse("less than a millimetre if it is metres"),
            e if e <= 2.0 => Ok((Self::Metre, 1.0)),
            e if e < 20.0 => refuse("too large for metres and doubtful for millimetres"),
            e if e <= 3000.0 => {
                warnings.push(format!("the mesh is {e:.1} units across: taken as millimetres"));
                Ok((Self::Millimetre, 1e-3))
            }
            _ => refuse("too large even for millimetres"),
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

/// Where the up direction of an asset comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum UpSource {
    /// It was given.
    Given,
    /// The file format says so: glTF is +y up.
    Format,
    /// Nothing says so: +z.
    Assumed,
}

/// Settings of [`crate::build_asset`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AssetOptions {
    /// Mass of the object, kg. `None`: density times volume.
    pub mass_kg: Option<f64>,
    /// Density where no mass is given, kg/m³: of the solid, or of the wall of a hollow object.
    pub density_kg_m3: f64,
    /// Wall thickness of a hollow object whose inside the mesh does not show (a can), metres. `None`: solid.
    pub wall_m: Option<f64>,
    /// Direction in the mesh's frame that points up when the object stands. `None`: +z, for glTF +y.
    pub up_in_mesh: Option<Vector3<f64>>,
    /// Coefficient of sliding friction of object and table.
    pub friction: f64,
    /// The other contact parameters.
    pub contact: ContactConfig,
    /// Unit of the mesh file.
    pub unit: LengthUnit,
    /// Where the metric scale comes from, for the report ("marks A-C, 0.12 m"). `None`: the unit.
    pub scale_source: Option<String>,
    /// Settings of the repair.
    pub repair: RepairOptions,
    /// Settings of the convex parts.
    pub partition: PartitionOptions,
    /// Settings of the stable poses.
    pub rest: RestOptions,
}

impl Default for AssetOptions {
    fn default() -> Self {
        Self {
            mass_kg: None,
            density_kg_m3: 1000.0,
            wall_m: None,
            up_in_mesh: None,
            friction: 0.5,
            contact: ContactConfig::default(),
            unit: LengthUnit::Auto,
            scale_source: None,
            repair: RepairOptions::default(),
            partition: PartitionOptions::default(),
            rest: RestOptions::default(),
        }
    }
}

impl AssetOptions {
    /// The defaults for a mesh that is known to be in metres.
    #[must_use]
    pub fn in_metres() -> Self {
        Self { unit: LengthUnit::Metre, ..Self::default() }
    }

    pub(crate) fn check(&self) -> Result<()> {
        let positive = |value: f64, name: &str| {
            if value > 0.0 && value.is_finite() {
                return Ok(());
            }
            Err(Error::value(format!("the {name} is {value}"), "give a positive number"))
        };
        positive(self.mass_kg.unwrap_or(1.0), "mass in kg")?;
        positive(self.density_kg_m3, "density in kg/m³")?;
        positive(self.wall_m.unwrap_or(1.0), "wall thickness in metres")?;
        positive(self.friction, "friction coefficient")?;
        self.contact.check()?;
        if self.up_in_mesh.is_some_and(|u| !(u.norm() > 1e-9 && u.norm().is_finite())) {
            return Err(Error::value("the up direction has no length", "give a direction such as 0 0 1"));
        }
        Ok(())
    }
}
