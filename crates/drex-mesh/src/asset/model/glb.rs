//! An asset as binary glTF 2.0, for viewers.

use drex_core::{Pose, TriMesh};
use nalgebra::{UnitQuaternion, Vector3};

use crate::Result;
use crate::io::{Model, ModelPart, glb_bytes};

/// A mesh, its name and the colours of its vertices.
type Named<'a> = (&'a str, &'a TriMesh, Option<&'a [[u8; 3]]>);

/// The meshes as they stand at rest, one node each, the world's +z turned to glTF's +y.
pub(crate) fn glb(meshes: &[Named<'_>], world_from_mesh: &Pose) -> Result<Vec<u8>> {
    let gltf_from_world = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let gltf_from_mesh = gltf_from_world * world_from_mesh;
    let part = |(name, mesh, colors): &Named<'_>| ModelPart {
        name: name.to_string(),
        mesh: mesh.transformed(&gltf_from_mesh),
        colors: colors.map(<[_]>::to_vec),
        ..ModelPart::default()
    };
    glb_bytes(&Model { parts: meshes.iter().map(part).collect(), materials: Vec::new() })
}
