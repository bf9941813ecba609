//! A rigid asset as MJCF.

use std::fmt::Write;

use crate::asset::ContactConfig;
use drex_core::{ConvexPart, Pose, Primitive, PrimitiveShape};

use super::{Link, numbers, place, pos_quat};
use crate::asset::Asset;
use crate::rest::RestPose;

/// Stable poses that become keyframes: no more than this many, none less probable than one in two hundred.
const MOST_KEYS: usize = 16;
const LEAST_PROBABILITY: f64 = 0.005;

/// MJCF: a table, and the object as a free body whose frame is the mesh's, at rest on the table.
///
/// The inertia is written out, never inferred from the pieces (their overlaps would count twice). The visual mesh has
/// no mass and no contacts. Contact parameters sit in one default class. Stable poses are keyframes `rest_0`, `rest_1`…
pub(crate) fn mjcf(asset: &Asset) -> String {
    let link = Link::of("object", "", asset);
    format!(
        r#"<mujoco model="object">
{header}{defaults}  <asset>
{meshes}  </asset>
  <worldbody>
{table}{body}    </body>
  </worldbody>
{keys}</mujoco>
"#,
        header = header(false),
        defaults = defaults(asset.friction, &asset.contact),
        meshes = meshes(&link),
        table = TABLE,
        body = free_body(&link, &asset.world_from_mesh_at_rest),
        keys = keyframes(&asset.stable_poses, 0),
    )
}

/// Settings of the solver. With a robot or a scene around, friction must not creep: elliptic cones, and friction
/// ten times as stiff as the normal force, as the bundled hands have it.
pub(super) fn header(grasping: bool) -> String {
    let friction = if grasping { " cone=\"elliptic\" impratio=\"10\"" } else { "" };
    format!(
        "  <compiler angle=\"radian\" autolimits=\"true\"/>\n  \
         <option timestep=\"0.002\" integrator=\"implicitfast\"{friction} gravity=\"0 0 -9.81\"/>\n"
    )
}

pub(super) const TABLE: &str = r#"    <light pos="0 0 1.5" dir="0 0 -1" directional="true"/>
    <geom name="table" class="contact" type="plane" size="0.5 0.5 0.05" rgba="0.5 0.45 0.4 1"/>
"#;

pub(super) fn defaults(friction: f64, c: &ContactConfig) -> String {
    format!(
        r#"  <default>
    <default class="contact">
      <geom friction="{friction} {torsional} 0.0001" condim="4" solref="{tc} {ratio}" solimp="{d0} {d1} {width}"/>
      <default class="collision">
        <geom type="mesh" group="3" rgba="0.6 0.7 0.8 1"/>
      </default>
    </default>
    <default class="visual">
      <geom type="mesh" group="2" contype="0" conaffinity="0" mass="0" rgba="0.8 0.8 0.8 1"/>
    </default>
  </default>
"#,
        torsional = c.torsional_friction_m,
        tc = c.time_constant_s,
        ratio = c.damping_ratio,
        d0 = c.impedance[0],
        d1 = c.impedance[1],
        width = c.width_m,
    )
}

/// The mesh assets of a link, and its texture. A visual mesh may be open or thin: its inertia is never used, but must be computable.
pub(super) fn meshes(link: &Link<'_>) -> String {
    let visual = link.visual();
    let mut out = format!("    <mesh name=\"{visual}\" file=\"../mesh/{visual}.obj\" inertia=\"shell\"/>\n");
    // Writing to a string cannot fail.
    if link.textured {
        let _ = writeln!(out, "    <texture name=\"{visual}\" type=\"2d\" file=\"../mesh/{visual}.png\"/>");
        let _ = writeln!(out, "    <material name=\"{visual}\" texture=\"{visual}\" specular=\"0\" shininess=\"0\"/>");
    }
    for (name, _) in link.collisions().filter(|(_, part)| part.primitive.is_none()) {
        let _ = writeln!(out, "    <mesh name=\"{name}\" file=\"../mesh/{name}.obj\"/>");
    }
    out
}

/// A free body, still open.
pub(super) fn free_body(link: &Link<'_>, world_from_mesh: &Pose) -> String {
    let (pos, quat) = pos_quat(world_from_mesh);
    let name = link.name;
    format!(
        "    <body name=\"{name}\" pos=\"{pos}\" quat=\"{quat}\">\n      <freejoint name=\"{name}\"/>\n{}",
        link_content(link, "      ")
    )
}

/// Inertia and geoms of a link.
pub(super) fn link_content(link: &Link<'_>, indent: &str) -> String {
    let p = link.properties;
    let i = &p.inertia;
    let fullinertia = [i[(0, 0)], i[(1, 1)], i[(2, 2)], i[(0, 1)], i[(0, 2)], i[(1, 2)]];
    let mut out = format!(
        "{indent}<inertial pos=\"{}\" mass=\"{}\" fullinertia=\"{}\"/>\n",
        place(&p.center_of_mass),
        p.mass_kg,
        numbers(&fullinertia)
    );
    let visual = link.visual();
    // The class's grey would darken the picture.
    let look = if link.textured { format!(" material=\"{visual}\" rgba=\"1 1 1 1\"") } else { String::new() };
    let _ = writeln!(out, "{indent}<geom name=\"{visual}\" class=\"visual\" mesh=\"{visual}\"{look}/>");
    for (name, part) in link.collisions() {
        let _ = writeln!(out, "{indent}<geom name=\"{name}\" class=\"collision\" {}/>", shape(&name, part));
    }
    out
}

/// The attributes of a geom that say what it is: a primitive at its place, or the mesh `name`.
pub(super) fn shape(name: &str, part: &ConvexPart) -> String {
    let Some(Primitive { shape, object_from_shape }) = part.primitive else { return format!("mesh=\"{name}\"") };
    let (kind, size) = match shape {
        PrimitiveShape::Sphere { radius_m } => ("sphere", vec![radius_m]),
        PrimitiveShape::Capsule { radius_m, half_length_m } => ("capsule", vec![radius_m, half_length_m]),
        PrimitiveShape::Cylinder { radius_m, half_length_m } => ("cylinder", vec![radius_m, half_length_m]),
        PrimitiveShape::Box { half_m } => ("box", half_m.to_vec()),
    };
    let (pos, quat) = pos_quat(&object_from_shape);
    format!("type=\"{kind}\" size=\"{}\" pos=\"{pos}\" quat=\"{quat}\"", numbers(&size))
}

/// Stable poses as keyframes of a model whose first joint is the free one, the other `joints` at 0.
pub(super) fn keyframes(poses: &[RestPose], joints: usize) -> String {
    let mut out = String::from("  <keyframe>\n");
    let probable = poses.iter().take(MOST_KEYS).filter(|p| p.probability >= LEAST_PROBABILITY);
    for (k, pose) in probable.enumerate() {
        let (pos, quat) = pos_quat(&pose.world_from_mesh);
        let rest = " 0".repeat(joints);
        let _ = writeln!(out, "    <key name=\"rest_{k}\" qpos=\"{pos} {quat}{rest}\"/>");
    }
    out + "  </keyframe>\n"
}
