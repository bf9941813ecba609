//! The object between the mesh crate and the crates that use it.

use drex_core::twin::{LengthUnit, ObjectConfig};
use drex_mesh::{Asset, AssetOptions};
use drex_sysid::ObjectModel;
use nalgebra::Vector3;

/// Convex pieces and mass properties at one kilogram, for identification.
pub fn model_of(asset: &Asset) -> ObjectModel {
    ObjectModel {
        pieces: asset.pieces.iter().map(|p| p.vertices.clone()).collect(),
        unit: asset.properties.with_mass(1.0),
    }
}

/// The manifest's object as the mesh crate takes it.
pub fn asset_options(object: &ObjectConfig, friction: f64) -> AssetOptions {
    let mut options = AssetOptions::default();
    options.unit = match object.unit {
        LengthUnit::M => drex_mesh::LengthUnit::Metre,
        LengthUnit::Cm => drex_mesh::LengthUnit::Centimetre,
        LengthUnit::Mm => drex_mesh::LengthUnit::Millimetre,
    };
    options.up_in_mesh = Some(Vector3::from(object.up_in_mesh));
    options.friction = friction;
    options.pieces.most_pieces = object.pieces.unwrap_or(options.pieces.most_pieces);
    options.contact = object.contact.clone().unwrap_or_default();
    options
}
