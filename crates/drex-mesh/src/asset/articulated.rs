//! Objects of several parts with joints between them.

use std::path::Path;

use nalgebra::{Point3, Unit, Vector3};
use serde::Serialize;

use super::contact::ContactConfig;
use super::joints::{JointConfig, joint_tree};
use drex_core::{ConvexPart, MassProperties, Pose, TriMesh};

use super::{Asset, AssetOptions, AssetReport, asset_from_mesh, rest_on_table, rows};
use crate::bvh::Aabb;
use crate::rest::{RestPose, stable_poses};
use crate::{Error, Result};

/// A rigid part of an articulated object.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Name of the part.
    pub name: String,
    /// Its mesh, in the frame and unit that all parts share, at the joints' zero.
    pub mesh: TriMesh,
    /// Its mass, kg, if it is known alone.
    pub mass_kg: Option<f64>,
}

/// A simulation asset of several parts. Everything is in the frame that the parts' meshes share, in metres.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ArticulatedAsset {
    /// Name and asset of each part, as given.
    pub parts: Vec<(String, Asset)>,
    /// The part that carries the others.
    pub root: usize,
    /// The joints, from the root outwards.
    pub joints: Vec<JointConfig>,
    /// Mass properties of the whole at the joints' zero.
    pub properties: MassProperties,
    /// Where the object stands on the table z = 0 with its joints at 0.
    pub world_from_mesh_at_rest: Pose,
    /// Poses in which it rests on a table with its joints held at 0, the most probable first.
    pub stable_poses: Vec<RestPose>,
    /// Coefficient of sliding friction.
    pub friction: f64,
    /// The other contact parameters.
    pub contact: ContactConfig,
    /// What was found and done.
    pub report: ArticulatedReport,
}

/// Everything worth knowing about how an articulated asset was made; written as `mesh/report.json`.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct ArticulatedReport {
    /// Names of the parts and their own reports.
    pub parts: Vec<(String, AssetReport)>,
    /// The part that carries the others.
    pub root: String,
    /// The joints, from the root outwards.
    pub joints: Vec<JointConfig>,
    /// Mass of the whole, kg.
    pub mass_kg: f64,
    /// Its centre of mass at the joints' zero, metres.
    pub center_of_mass_m: [f64; 3],
    /// Its inertia about that, kg m², rows.
    pub inertia_kg_m2: [[f64; 3]; 3],
    /// How far the centre of mass can move sideways before the object tips, metres; negative if it does not stand.
    pub tipping_margin_m: f64,
    /// Poses in which it rests with its joints held at 0.
    pub stable_poses: Vec<RestPose>,
}

/// Makes one asset of the parts of an object and the joints between them.
///
/// Each part is repaired, closed, weighed and divided on its own, as by [`asset_from_mesh`]; the unit is settled for all
/// together. [`AssetOptions::mass_kg`] is the mass of the whole: what the parts with a mass of their own leave of it
/// is shared by the others in proportion to their volumes. Parts that are joined do not touch each other in the
/// simulation.
///
/// # Errors
/// If the joints are no tree over the parts ([`joint_tree`]), a part has no volume (the message names it), or the masses
/// of the parts exceed that of the whole.
pub fn articulated_asset(parts: &[Part], joints: &[JointConfig], options: &AssetOptions) -> Result<ArticulatedAsset> {
    options.check()?;
    let names: Vec<&str> = parts.iter().map(|p| p.name.as_str()).collect();
    let (root, joints) = joint_tree(&names, joints)?;
    let corners: Vec<Point3<f64>> = parts.iter().flat_map(|p| &p.mesh.vertices).copied().collect();
    let bounds = Aabb::of(&corners);
    let mut options = options.clone();
    let whole_mass = options.mass_kg.take();
    options.unit = options.unit.settle((bounds.hi - bounds.lo).max(), &mut Vec::new())?.0;

    let mut built = parts
        .iter()
        .map(|part| {
            let mut own = options.clone();
            own.mass_kg = part.mass_kg;
            let asset = asset_from_mesh(&part.mesh, &own).map_err(|e| e.about(Path::new(&part.name)))?;
            Ok((part.name.clone(), asset))
        })
        .collect::<Result<Vec<(String, Asset)>>>()?;
    if let Some(mass_kg) = whole_mass {
        share(mass_kg, parts, &mut built)?;
    }

    let each: Vec<MassProperties> = built.iter().map(|(_, a)| a.properties).collect();
    let properties = MassProperties::combined(&each)
        .ok_or_else(|| Error::value("the parts have no mass", "give a positive mass or density"))?;
    let corners: Vec<Point3<f64>> =
        built.iter().flat_map(|(_, a)| &a.convex_parts).flat_map(ConvexPart::corners).copied().collect();
    let up = Unit::new_normalize(options.up_in_mesh.unwrap_or_else(Vector3::z));
    let stable_poses = stable_poses(&corners, &properties.center_of_mass, &options.rest)?;
    let (world_from_mesh_at_rest, tipping_margin_m) =
        rest_on_table(&corners, &properties.center_of_mass, &up, &options.rest)?;
    let report = ArticulatedReport {
        parts: built.iter().map(|(name, asset)| (name.clone(), asset.report.clone())).collect(),
        root: names[root].into(),
        joints: joints.clone(),
        mass_kg: properties.mass_kg,
        center_of_mass_m: properties.center_of_mass.into(),
        inertia_kg_m2: rows(&properties.inertia),
        tipping_margin_m,
        stable_poses: stable_poses.clone(),
    };
    Ok(ArticulatedAsset {
        parts: built,
        root,
        joints,
        properties,
        world_from_mesh_at_rest,
        stable_poses,
        friction: options.friction,
        contact: options.contact,
        report,
    })
}

/// Gives the parts without a mass of their own the rest of the whole's, by volume.
fn share(whole_kg: f64, parts: &[Part], built: &mut [(String, Asset)]) -> Result<()> {
    let own: f64 = parts.iter().filter_map(|p| p.mass_kg).sum();
    // At the density of the options, masses are volumes but for a factor.
    let free: f64 =
        built.iter().zip(parts).filter(|(_, p)| p.mass_kg.is_none()).map(|((_, a), _)| a.properties.mass_kg).sum();
    let rest = whole_kg - own;
    let agrees = if free > 0.0 { rest > 0.0 } else { rest.abs() <= 1e-6 * whole_kg };
    if !agrees {
        return Err(Error::value(
            format!("the parts weigh {own} kg, the whole {whole_kg} kg"),
            "give the mass of the whole, or of the parts, or leave a part without mass for what remains",
        ));
    }
    for ((_, asset), part) in built.iter_mut().zip(parts) {
        if part.mass_kg.is_none() {
            let mass_kg = rest * asset.properties.mass_kg / free;
            *asset = asset.clone().with_mass(mass_kg);
        }
    }
    Ok(())
}

impl ArticulatedAsset {
    /// The object with another mass of the whole, as after weighing or identification: every part scales along.
    pub fn with_mass(mut self, mass_kg: f64) -> Self {
        let factor = mass_kg / self.properties.mass_kg;
        for ((_, part), (_, report)) in self.parts.iter_mut().zip(&mut self.report.parts) {
            *part = part.clone().with_mass(factor * part.properties.mass_kg);
            report.clone_from(&part.report);
        }
        self.properties = self.properties.with_mass(mass_kg);
        self.report.mass_kg = mass_kg;
        self.report.inertia_kg_m2 = rows(&self.properties.inertia);
        self
    }
}
