//! A rigid asset as URDF.

use std::fmt::Write;

use drex_core::{Primitive, PrimitiveShape};
use nalgebra::{Point3, Vector3};

use super::{Link, numbers, place};
use crate::asset::Asset;

/// URDF: one link whose frame is the mesh's.
pub(crate) fn urdf(asset: &Asset) -> String {
    let link = Link::of("object", "", asset);
    format!("<?xml version=\"1.0\"?>\n<robot name=\"object\">\n{}</robot>\n", link_element(&link, &Point3::origin()))
}

/// A primitive at its place in a link that lies at `origin`; the format has no capsule.
fn shape(primitive: &Primitive, origin: &Point3<f64>) -> Option<String> {
    let shape = match primitive.shape {
        PrimitiveShape::Sphere { radius_m } => format!("<sphere radius=\"{radius_m}\"/>"),
        PrimitiveShape::Cylinder { radius_m, half_length_m } => {
            format!("<cylinder radius=\"{radius_m}\" length=\"{}\"/>", 2.0 * half_length_m)
        }
        PrimitiveShape::Box { half_m } => format!("<box size=\"{}\"/>", numbers(&half_m.map(|x| 2.0 * x))),
        PrimitiveShape::Capsule { .. } => return None,
    };
    let place = primitive.object_from_shape;
    let (roll, pitch, yaw) = place.rotation.euler_angles();
    let xyz = numbers((place.translation.vector - origin.coords).as_slice());
    Some(format!("<origin xyz=\"{xyz}\" rpy=\"{}\"/><geometry>{shape}</geometry>", numbers(&[roll, pitch, yaw])))
}

/// A link whose frame has the mesh's axes and lies at `origin` in it.
pub(super) fn link_element(link: &Link<'_>, origin: &Point3<f64>) -> String {
    let p = link.properties;
    let i = &p.inertia;
    let mesh_in_link = if *origin == Point3::origin() {
        String::new()
    } else {
        format!("<origin xyz=\"{}\" rpy=\"0 0 0\"/>", numbers((Vector3::zeros() - origin.coords).as_slice()))
    };
    let mut collisions = String::new();
    for (name, part) in link.collisions() {
        let shape = part.primitive.and_then(|p| shape(&p, origin));
        let shape = shape
            .unwrap_or_else(|| format!("{mesh_in_link}<geometry><mesh filename=\"../mesh/{name}.obj\"/></geometry>"));
        // Writing to a string cannot fail.
        let _ = writeln!(collisions, "    <collision name=\"{name}\">\n      {shape}\n    </collision>");
    }
    format!(
        r#"  <link name="{name}">
    <inertial>
      <origin xyz="{com}" rpy="0 0 0"/>
      <mass value="{mass}"/>
      <inertia ixx="{}" iyy="{}" izz="{}" ixy="{}" ixz="{}" iyz="{}"/>
    </inertial>
    <visual>
      {mesh_in_link}<geometry><mesh filename="../mesh/{visual}.obj"/></geometry>
    </visual>
{collisions}  </link>
"#,
        i[(0, 0)],
        i[(1, 1)],
        i[(2, 2)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 2)],
        name = link.name,
        com = place(&(p.center_of_mass - origin.coords)),
        mass = p.mass_kg,
        visual = link.visual(),
    )
}
