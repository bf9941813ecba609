//! A random object as files: its mesh, and what is known of it.

use std::path::Path;

use drex_core::fsutil::{output_path, write_atomic};
use drex_core::{Error, PrimitiveRecord};
use drex_mesh::write_obj;
use serde::Serialize;

use super::{MassDistribution, RandomObject};

/// `object.json`.
#[derive(Serialize)]
struct Record<'a> {
    name: &'a str,
    kind: &'static str,
    solids: Vec<PrimitiveRecord>,
    mass_kg: f64,
    friction: f64,
    first_guess_kg: f64,
    center_of_mass_m: [f64; 3],
    /// About the centre of mass, along the object's axes, row by row.
    inertia_kg_m2: [[f64; 3]; 3],
    mass_distribution: DistributionRecord,
}

#[derive(Serialize)]
#[serde(tag = "class", rename_all = "snake_case")]
enum DistributionRecord {
    Solid,
    Hollow { wall_m: f64, open_top: bool, cavities: Vec<PrimitiveRecord> },
    OffCentre { insert: PrimitiveRecord, insert_kg: f64 },
}

impl RandomObject {
    /// Writes the mesh as `NAME/object.obj` (metres) and everything else as `NAME/object.json` (SI units) below `folder`, both in the
    /// object's frame.
    ///
    /// # Errors
    /// If a file cannot be written; an old one stays.
    pub fn write(&self, folder: &Path) -> drex_mesh::Result<()> {
        let file = |name: &str| output_path(folder, &format!("{}/{name}", self.name));
        write_obj(&file("object.obj")?, &self.to_object()?.mesh)?;
        let path = file("object.json")?;
        let mut text = serde_json::to_string_pretty(&self.record())
            .map_err(|e| Error::content(&path, None, format!("cannot be made: {e}"), "report this"))?;
        text.push('\n');
        Ok(write_atomic(&path, text.as_bytes())?)
    }

    fn record(&self) -> Record<'_> {
        let m = &self.mass_properties;
        Record {
            name: &self.name,
            kind: self.kind.as_str(),
            solids: self.solids.iter().map(PrimitiveRecord::from).collect(),
            mass_kg: m.mass_kg,
            friction: self.friction,
            first_guess_kg: self.first_guess_kg,
            center_of_mass_m: m.center_of_mass.into(),
            // The tensor is symmetric: its columns are its rows.
            inertia_kg_m2: m.inertia.into(),
            mass_distribution: match &self.mass_distribution {
                MassDistribution::Solid => DistributionRecord::Solid,
                MassDistribution::Hollow { wall_m, open_top, cavities } => DistributionRecord::Hollow {
                    wall_m: *wall_m,
                    open_top: *open_top,
                    cavities: cavities.iter().map(PrimitiveRecord::from).collect(),
                },
                MassDistribution::OffCentre { insert, insert_kg } => {
                    DistributionRecord::OffCentre { insert: insert.into(), insert_kg: *insert_kg }
                }
            },
        }
    }
}
