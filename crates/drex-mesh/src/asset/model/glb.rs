//! An asset as binary glTF 2.0, for viewers.

use drex_core::Pose;
use nalgebra::{UnitQuaternion, Vector3};

use crate::Result;
use crate::asset::Asset;
use crate::io::{Model, ModelPart, glb_bytes};

/// The visual meshes of named parts as they stand at rest, one node each, the world's +z turned to glTF's +y.
pub(crate) fn glb(parts: &[(&str, &Asset)], world_from_mesh: &Pose) -> Result<Vec<u8>> {
    let gltf_from_world = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let gltf_from_mesh = gltf_from_world * world_from_mesh;
    let mut model = Model::default();
    for (name, part) in parts {
        let mesh = part.visual.transformed(&gltf_from_mesh);
        match &part.texture {
            Some(texture) => texture.add_to(&mut model, name, &mesh),
            None => model.parts.push(ModelPart { name: (*name).to_owned(), mesh, ..ModelPart::default() }),
        }
    }
    glb_bytes(&model)
}
