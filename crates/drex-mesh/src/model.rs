//! The asset as MJCF and URDF text.

use std::fmt::Write;

use crate::asset::Asset;
use crate::write::collision_name;

/// MJCF: a table, and the object as a free body whose frame is the mesh's, at rest on the table.
///
/// The inertia is written out, never inferred from the pieces (their overlaps would count twice). The visual mesh has
/// no mass and no contacts. Contact parameters sit in one default class.
pub(crate) fn mjcf(asset: &Asset) -> String {
    let p = &asset.properties;
    let (t, q) = drex_core::pose::to_wxyz(&asset.world_from_mesh_at_rest);
    let i = &p.inertia;
    let fullinertia = [i[(0, 0)], i[(1, 1)], i[(2, 2)], i[(0, 1)], i[(0, 2)], i[(1, 2)]];
    let mut meshes = String::new();
    let mut geoms = String::new();
    for k in 0..asset.pieces.len() {
        // Writing to a string cannot fail.
        let _ = writeln!(meshes, "    <mesh name=\"collision_{k:02}\" file=\"../mesh/{}\"/>", collision_name(k));
        let _ =
            writeln!(geoms, "      <geom name=\"collision_{k:02}\" class=\"collision\" mesh=\"collision_{k:02}\"/>");
    }
    format!(
        r#"<mujoco model="object">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast" gravity="0 0 -9.81"/>
  <default>
    <default class="contact">
      <geom friction="{friction} 0.005 0.0001" condim="4" solref="0.004 1" solimp="0.95 0.99 0.001"/>
      <default class="collision">
        <geom type="mesh" group="3" rgba="0.6 0.7 0.8 1"/>
      </default>
    </default>
    <default class="visual">
      <geom type="mesh" group="2" contype="0" conaffinity="0" mass="0" rgba="0.8 0.8 0.8 1"/>
    </default>
  </default>
  <asset>
    <mesh name="visual" file="../mesh/visual.obj" inertia="shell"/>
{meshes}  </asset>
  <worldbody>
    <light pos="0 0 1.5" dir="0 0 -1" directional="true"/>
    <geom name="table" class="contact" type="plane" size="0.5 0.5 0.05" rgba="0.5 0.45 0.4 1"/>
    <body name="object" pos="{pos}" quat="{quat}">
      <freejoint name="object"/>
      <inertial pos="{com}" mass="{mass}" fullinertia="{inertia}"/>
      <geom name="visual" class="visual" mesh="visual"/>
{geoms}    </body>
  </worldbody>
</mujoco>
"#,
        friction = asset.friction,
        pos = numbers(&t),
        quat = numbers(&q),
        com = numbers(p.center_of_mass.coords.as_slice()),
        mass = p.mass_kg,
        inertia = numbers(&fullinertia),
    )
}

/// URDF: one link whose frame is the mesh's.
pub(crate) fn urdf(asset: &Asset) -> String {
    let p = &asset.properties;
    let i = &p.inertia;
    let mut collisions = String::new();
    for k in 0..asset.pieces.len() {
        let _ = writeln!(
            collisions,
            "    <collision name=\"collision_{k:02}\">\n      <geometry><mesh filename=\"../mesh/{}\"/></geometry>\n    </collision>",
            collision_name(k)
        );
    }
    format!(
        r#"<?xml version="1.0"?>
<robot name="object">
  <link name="object">
    <inertial>
      <origin xyz="{com}" rpy="0 0 0"/>
      <mass value="{mass}"/>
      <inertia ixx="{}" iyy="{}" izz="{}" ixy="{}" ixz="{}" iyz="{}"/>
    </inertial>
    <visual>
      <geometry><mesh filename="../mesh/visual.obj"/></geometry>
    </visual>
{collisions}  </link>
</robot>
"#,
        i[(0, 0)],
        i[(1, 1)],
        i[(2, 2)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 2)],
        com = numbers(p.center_of_mass.coords.as_slice()),
        mass = p.mass_kg,
    )
}

/// Numbers with spaces between them, in the shortest form that reads back to the same bits.
fn numbers(values: &[f64]) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}
