//! The object with its mass as a simulation asset.

use std::path::PathBuf;

use crate::Result;

use crate::Twin;
use crate::records::MassFile;
use crate::records::{MASS, read_json};

pub(crate) fn make(twin: &Twin) -> Result<Vec<PathBuf>> {
    let mass: MassFile = read_json(&twin.path(MASS))?;
    twin.asset()?.clone().with_mass(mass.mass_kg).write(&twin.root)?;
    Ok(vec![twin.path("mesh"), twin.path("asset")])
}
