//! An articulated asset as MJCF and URDF.

use std::fmt::Write;

use nalgebra::{Point3, Vector3};

use super::mjcf::{TABLE, defaults, free_body, header, keyframes, link_content, meshes};
use super::urdf::link_element;
use super::{Link, numbers};
use crate::asset::{ArticulatedAsset, JointConfig, JointKind};

/// MJCF: one tree of bodies, all with the mesh's frame at the joints' zero, a free joint at the root.
pub(crate) fn mjcf(asset: &ArticulatedAsset) -> String {
    let prefixes: Vec<String> = asset.parts.iter().map(|(name, _)| format!("{name}_")).collect();
    let links: Vec<Link<'_>> = links(asset, &prefixes);
    let moving = asset.joints.iter().filter(|j| j.kind != JointKind::Fixed).count();
    let mut body = free_body(&links[asset.root], &asset.world_from_mesh_at_rest);
    add_children(asset, &links, asset.root, "      ", &mut body);
    let mut exclude = String::new();
    for j in &asset.joints {
        // Writing to a string cannot fail.
        let _ = writeln!(exclude, "    <exclude body1=\"{}\" body2=\"{}\"/>", j.parent, j.child);
    }
    format!(
        "<mujoco model=\"object\">\n{}{}  <asset>\n{}  </asset>\n  <worldbody>\n{TABLE}{body}    </body>\n  </worldbody>\n  \
         <contact>\n{exclude}  </contact>\n{}</mujoco>\n",
        header(false),
        defaults(asset.friction, &asset.contact),
        links.iter().map(meshes).collect::<String>(),
        keyframes(&asset.stable_poses, moving),
    )
}

fn links<'a>(asset: &'a ArticulatedAsset, prefixes: &'a [String]) -> Vec<Link<'a>> {
    asset.parts.iter().zip(prefixes).map(|((name, part), prefix)| Link::of(name, prefix, part)).collect()
}

/// The bodies that hang on a part. Joints form a tree, so this ends.
fn add_children(asset: &ArticulatedAsset, links: &[Link<'_>], at: usize, indent: &str, out: &mut String) {
    for joint in asset.joints.iter().filter(|j| j.parent == links[at].name) {
        let Some(child) = links.iter().position(|l| l.name == joint.child) else { continue };
        let deeper = format!("{indent}  ");
        let _ = writeln!(out, "{indent}<body name=\"{}\">", joint.child);
        if joint.kind != JointKind::Fixed {
            let _ = writeln!(out, "{deeper}{}", joint_element(joint));
        }
        out.push_str(&link_content(&links[child], &deeper));
        add_children(asset, links, child, &deeper, out);
        let _ = writeln!(out, "{indent}</body>");
    }
}

fn joint_element(joint: &JointConfig) -> String {
    let kind = if joint.kind == JointKind::Slide { "slide" } else { "hinge" };
    let axis = Vector3::from(joint.axis).normalize();
    let mut out = format!(
        "<joint name=\"{}\" type=\"{kind}\" pos=\"{}\" axis=\"{}\"",
        joint.name,
        numbers(&joint.origin),
        numbers(axis.as_slice())
    );
    if let Some(range) = joint.range {
        let _ = write!(out, " range=\"{}\"", numbers(&range));
    }
    for (name, value) in
        [("damping", joint.damping), ("frictionloss", joint.friction_loss), ("stiffness", joint.stiffness)]
    {
        if value > 0.0 {
            let _ = write!(out, " {name}=\"{value}\"");
        }
    }
    out + "/>"
}

/// URDF: the root link's frame is the mesh's; every other link's frame has the mesh's axes and lies at its joint.
pub(crate) fn urdf(asset: &ArticulatedAsset) -> String {
    let prefixes: Vec<String> = asset.parts.iter().map(|(name, _)| format!("{name}_")).collect();
    let origin_of =
        |part: &str| asset.joints.iter().find(|j| j.child == part).map_or(Point3::origin(), |j| Point3::from(j.origin));
    let mut out = String::from("<?xml version=\"1.0\"?>\n<robot name=\"object\">\n");
    for link in links(asset, &prefixes) {
        out.push_str(&link_element(&link, &origin_of(link.name)));
    }
    for j in &asset.joints {
        let kind = match (j.kind, j.range) {
            (JointKind::Fixed, _) => "fixed",
            (JointKind::Slide, _) => "prismatic",
            (JointKind::Hinge, Some(_)) => "revolute",
            (JointKind::Hinge, None) => "continuous",
        };
        let from_parent = origin_of(&j.child) - origin_of(&j.parent);
        let _ = writeln!(
            out,
            "  <joint name=\"{}\" type=\"{kind}\">\n    <parent link=\"{}\"/>\n    <child link=\"{}\"/>\n    <origin xyz=\"{}\" rpy=\"0 0 0\"/>",
            j.name,
            j.parent,
            j.child,
            numbers(from_parent.as_slice())
        );
        if j.kind != JointKind::Fixed {
            let axis = Vector3::from(j.axis).normalize();
            let _ = writeln!(out, "    <axis xyz=\"{}\"/>", numbers(axis.as_slice()));
            let _ = writeln!(out, "    <dynamics damping=\"{}\" friction=\"{}\"/>", j.damping, j.friction_loss);
            if let Some([lo, hi]) = j.range {
                // Nothing drives the joint: effort and velocity are required by the format and say nothing.
                let _ = writeln!(out, "    <limit lower=\"{lo}\" upper=\"{hi}\" effort=\"0\" velocity=\"0\"/>");
            }
        }
        out.push_str("  </joint>\n");
    }
    out + "</robot>\n"
}
