//! The tree of bodies: links, joints, inertia.

use drex_core::{MassProperties, Pose};
use nalgebra::{Matrix3, Point3, Vector3};

use crate::Result;
use crate::model::{GeomRole, Joint, JointKind, Link};
use crate::shape::is_finite;
use crate::unsupported::Unsupported;
use crate::xml::Node;

use super::Builder;
use super::compiler::InertiaSource;
use super::geoms::ReadGeom;

const BODY_ATTRIBUTES: [&str; 9] =
    ["name", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "childclass", "user"];
const JOINT_ATTRIBUTES: [&str; 15] = [
    "name",
    "class",
    "group",
    "type",
    "pos",
    "axis",
    "range",
    "limited",
    "ref",
    "armature",
    "damping",
    "frictionloss",
    "actuatorfrcrange",
    "actuatorfrclimited",
    "user",
];
const GEOM_ATTRIBUTES: [&str; 21] = [
    "name",
    "class",
    "type",
    "contype",
    "conaffinity",
    "group",
    "size",
    "material",
    "friction",
    "mass",
    "density",
    "fromto",
    "pos",
    "quat",
    "axisangle",
    "xyaxes",
    "zaxis",
    "euler",
    "mesh",
    "rgba",
    "user",
];
const MESH_ATTRIBUTES: [&str; 9] = ["name", "class", "file", "vertex", "face", "scale", "refpos", "refquat", "inertia"];
const INERTIAL_ATTRIBUTES: [&str; 9] =
    ["pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "mass", "diaginertia", "fullinertia"];

/// Remarks on every attribute of a body, joint, geom, mesh or inertial element that is not read.
pub(super) fn note_unread_attributes(node: &Node, unsupported: &mut Unsupported) {
    match node.tag.as_str() {
        "body" => unsupported.attributes(node, &BODY_ATTRIBUTES),
        "joint" => unsupported.attributes(node, &JOINT_ATTRIBUTES),
        "geom" => unsupported.attributes(node, &GEOM_ATTRIBUTES),
        "mesh" => unsupported.attributes(node, &MESH_ATTRIBUTES),
        "inertial" => unsupported.attributes(node, &INERTIAL_ATTRIBUTES),
        _ => {}
    }
}

/// A child of a body with the frames around it taken into account.
struct Part<'a> {
    node: &'a Node,
    body_from_frame: Pose,
    childclass: Option<&'a str>,
}

impl Builder {
    /// Reads everything below `<worldbody>`.
    ///
    /// The base is the one body that stands on the world without a joint (or floats freely, if it is alone). Where
    /// there are several, or it moves, the world itself is the base.
    pub(super) fn read_bodies(&mut self, root: &Node) -> Result<()> {
        let mut parts = Vec::new();
        for world in root.children_called("worldbody") {
            self.gather(world, Pose::identity(), None, &mut parts)?;
        }
        let bodies: Vec<&Part<'_>> = parts.iter().filter(|p| p.node.tag == "body").collect();
        let floats = |p: &Part<'_>| joints_of(p.node).any(is_free);
        let mut robots: Vec<&Part<'_>> = bodies.iter().copied().filter(|p| !floats(p)).collect();
        if robots.is_empty() {
            robots = bodies.clone();
        } else {
            for free in bodies.iter().filter(|p| floats(p)) {
                self.unsupported.note(format!(
                    "<{}> (line {}) floats freely and is no part of the robot",
                    free.node.title(),
                    free.node.line
                ));
            }
        }
        match robots[..] {
            [] => Err(root.error("the model has no bodies", "give a model of a robot")),
            [base] if joints_of(base.node).all(is_free) => {
                let world_shapes = parts.iter().filter(|p| p.node.tag == "geom").count();
                if world_shapes > 0 {
                    self.unsupported.note(format!("{world_shapes} shapes of the world are no part of the robot"));
                }
                self.add_body(base, None)
            }
            _ => {
                let mut link = bare_link("world", None, Pose::identity());
                let geoms = self.read_geoms(&parts)?;
                link.geoms = geoms.into_iter().map(|g| g.geom).collect();
                self.link_names.insert("world", 0);
                self.links.push(link);
                for part in robots {
                    if let Some(joint) = joints_of(part.node).find(|j| is_free(j)) {
                        return Err(joint.error("several bodies float freely", "keep one robot per file"));
                    }
                    self.add_body(part, Some(0))?;
                }
                Ok(())
            }
        }
    }

    /// The children of `node`, those inside `<frame>` elements included.
    fn gather<'a>(
        &mut self,
        node: &'a Node,
        body_from_frame: Pose,
        childclass: Option<&'a str>,
        parts: &mut Vec<Part<'a>>,
    ) -> Result<()> {
        for child in &node.children {
            match child.tag.as_str() {
                "frame" => {
                    let pose = self.compiler.pose(&child.with_defaults(None))?;
                    self.gather(child, body_from_frame * pose, child.get("childclass").or(childclass), parts)?;
                }
                "replicate" | "attach" => {
                    return Err(child.error(
                        "generated bodies are not read",
                        "save the compiled model (MuJoCo's mj_saveLastXML) and load that",
                    ));
                }
                "body" | "geom" | "joint" | "freejoint" | "inertial" => {
                    parts.push(Part { node: child, body_from_frame, childclass });
                }
                _ => self.unsupported.element(child),
            }
        }
        Ok(())
    }

    fn add_body(&mut self, part: &Part<'_>, parent: Option<usize>) -> Result<()> {
        let node = part.node;
        note_unread_attributes(node, &mut self.unsupported);
        let childclass = node.get("childclass").or(part.childclass);
        let name = self.link_names.unique(node, "body_", self.links.len(), |i| format!("body_{i}"))?;
        let mut pose = part.body_from_frame * self.compiler.pose(&node.with_defaults(None))?;
        let mut parent = parent;
        if parent.is_none() {
            self.file_world_from_base = pose;
            pose = Pose::identity();
        }
        let mut parts = Vec::new();
        self.gather(node, Pose::identity(), childclass, &mut parts)?;

        let joints: Vec<&Part<'_>> = parts.iter().filter(|p| p.node.tag == "joint" && !is_free(p.node)).collect();
        if parent.is_some()
            && let Some(free) = parts.iter().find(|p| is_free(p.node))
        {
            return Err(free.node.error("a body inside another cannot float freely", "use hinges and slides"));
        }
        // One link per joint; the last is the body itself.
        for (k, joint_part) in joints.iter().enumerate() {
            let link = self.links.len();
            let joint = self.read_joint(joint_part, link, &name)?;
            let last = k + 1 == joints.len();
            let link_name = if last { name.clone() } else { format!("{name}:{}", joint.name) };
            let mut new = bare_link(&link_name, parent, pose);
            new.joints.push(self.joints.len());
            self.joint_names.insert(&joint.name, self.joints.len());
            self.joints.push(joint);
            self.link_names.insert(&link_name, link);
            self.links.push(new);
            (parent, pose) = (Some(link), Pose::identity());
        }
        if joints.is_empty() {
            self.link_names.insert(&name, self.links.len());
            self.links.push(bare_link(&name, parent, pose));
        }
        let link = self.links.len() - 1;
        let geoms = self.read_geoms(&parts)?;
        self.links[link].inertial = self.read_inertia(node, &parts, &geoms)?;
        let discard = self.compiler.discard_visual;
        self.links[link].geoms =
            geoms.into_iter().map(|g| g.geom).filter(|g| !(discard && g.role == GeomRole::Visual)).collect();
        for child in parts.iter().filter(|p| p.node.tag == "body") {
            self.add_body(child, Some(link))?;
        }
        Ok(())
    }

    fn read_geoms(&mut self, parts: &[Part<'_>]) -> Result<Vec<ReadGeom>> {
        let mut geoms = Vec::new();
        for part in parts.iter().filter(|p| p.node.tag == "geom") {
            note_unread_attributes(part.node, &mut self.unsupported);
            geoms.extend(self.read_geom(part.node, &part.body_from_frame, part.childclass)?);
        }
        Ok(geoms)
    }

    fn read_joint(&mut self, part: &Part<'_>, link: usize, body: &str) -> Result<Joint> {
        let node = part.node;
        note_unread_attributes(node, &mut self.unsupported);
        let fallback = |i: usize| if i == 0 { format!("{body}_joint") } else { format!("{body}_joint_{i}") };
        let name = self.joint_names.unique(node, body, 0, fallback)?;
        let a = self.defaults.resolve(node, part.childclass)?;
        let kind = match a.get("type").unwrap_or("hinge") {
            "hinge" => JointKind::Revolute,
            "slide" => JointKind::Prismatic,
            "ball" => return Err(node.error("ball joints are not read", "use three hinges")),
            _ => return Err(a.fault("type", "no type of joint", "use hinge or slide")),
        };
        let unit = |v: f64| if kind == JointKind::Revolute { self.compiler.angle(v) } else { v };
        let axis = a.vector("axis")?.unwrap_or_else(Vector3::z);
        let Some(axis) = (part.body_from_frame.rotation * axis).try_normalize(1e-12) else {
            return Err(a.fault("axis", "an axis of length zero", "give a direction"));
        };
        let limited = a.truth("limited")?.unwrap_or(self.compiler.auto_limits);
        let effort_limited = a.truth("actuatorfrclimited")?.unwrap_or(self.compiler.auto_limits);
        let effort = a.range("actuatorfrcrange")?.filter(|_| effort_limited).map(|(lo, hi)| lo.abs().max(hi.abs()));
        Ok(Joint {
            name,
            kind,
            link,
            axis,
            anchor: part.body_from_frame * Point3::from(a.vector("pos")?.unwrap_or_default()),
            limits: a.range("range")?.filter(|_| limited).map(|(lo, hi)| (unit(lo), unit(hi))),
            reference: unit(a.number("ref")?.unwrap_or(0.0)),
            armature: not_negative(a.number("armature")?.unwrap_or(0.0), node, "armature")?,
            damping: not_negative(a.numbers("damping", 1..=3)?.map_or(0.0, |v| v[0]), node, "damping")?,
            friction_loss: not_negative(a.number("frictionloss")?.unwrap_or(0.0), node, "frictionloss")?,
            mimic: None,
            effort_limit: effort,
            velocity_limit: None,
        })
    }

    fn read_inertia(&mut self, body: &Node, parts: &[Part<'_>], geoms: &[ReadGeom]) -> Result<Option<MassProperties>> {
        let explicit = parts.iter().find(|p| p.node.tag == "inertial");
        let source = self.compiler.inertia_source;
        let mut properties = match explicit {
            Some(part) if source != InertiaSource::Shapes => {
                note_unread_attributes(part.node, &mut self.unsupported);
                self.read_inertial(part)?
            }
            _ if source == InertiaSource::Explicit => None,
            _ => {
                if geoms.len() < parts.iter().filter(|p| p.node.tag == "geom").count() {
                    self.unsupported.note(format!(
                        "the mass of <{}> (line {}) comes from its shapes, of which some are left out",
                        body.title(),
                        body.line
                    ));
                }
                let (lo, hi) = self.compiler.inertia_groups;
                let masses: Vec<MassProperties> =
                    geoms.iter().filter(|g| (lo..=hi).contains(&g.group)).filter_map(|g| self.mass_of(g)).collect();
                MassProperties::combined(&masses)
            }
        };
        if properties.is_some_and(|p| !is_finite(&p)) {
            return Err(body.error("the inertia is not finite", "repair sizes, mass and density"));
        }
        if let Some(p) = &mut properties {
            if p.mass_kg < self.compiler.least_mass_kg {
                p.mass_kg = self.compiler.least_mass_kg;
            }
            if self.compiler.least_inertia > 0.0 || self.compiler.balance_inertia {
                self.bound_inertia(p);
            }
        }
        Ok(properties)
    }

    /// `boundinertia` and `balanceinertia` of the compiler section.
    fn bound_inertia(&self, p: &mut MassProperties) {
        let eigen = p.inertia.symmetric_eigen();
        let mut moments = eigen.eigenvalues.map(|m| m.max(self.compiler.least_inertia));
        if self.compiler.balance_inertia && 2.0 * moments.max() > moments.sum() {
            moments = Vector3::repeat(moments.mean());
        }
        p.inertia = eigen.eigenvectors * Matrix3::from_diagonal(&moments) * eigen.eigenvectors.transpose();
    }

    fn read_inertial(&self, part: &Part<'_>) -> Result<Option<MassProperties>> {
        let node = part.node;
        let a = node.with_defaults(None);
        node.require("mass")?;
        let mass_kg = not_negative(a.number("mass")?.unwrap_or(0.0), node, "mass")?;
        let pose = part.body_from_frame * self.compiler.pose(&a)?;
        let local = if let Some(f) = a.numbers("fullinertia", 6..=6)? {
            Matrix3::new(f[0], f[3], f[4], f[3], f[1], f[5], f[4], f[5], f[2])
        } else {
            Matrix3::from_diagonal(&a.vector("diaginertia")?.unwrap_or_default())
        };
        let least = local.symmetric_eigenvalues().min();
        if least < -1e-9 * local.abs().max() {
            return Err(
                node.error(format!("the inertia has a negative principal moment ({least:.3e})"), "repair the model")
            );
        }
        let r = pose.rotation.to_rotation_matrix();
        Ok((mass_kg > 0.0).then(|| MassProperties {
            mass_kg,
            center_of_mass: Point3::from(pose.translation.vector),
            inertia: r.matrix() * local * r.matrix().transpose(),
        }))
    }
}

fn bare_link(name: &str, parent: Option<usize>, parent_from_link: Pose) -> Link {
    Link { name: name.to_owned(), parent, joints: Vec::new(), parent_from_link, inertial: None, geoms: Vec::new() }
}

/// The joints directly in a body, those in frames included.
fn joints_of(node: &Node) -> impl Iterator<Item = &Node> {
    let mut stack = vec![node];
    let mut joints = Vec::new();
    while let Some(at) = stack.pop() {
        for child in &at.children {
            match child.tag.as_str() {
                "joint" | "freejoint" => joints.push(child),
                "frame" => stack.push(child),
                _ => {}
            }
        }
    }
    joints.into_iter()
}

fn is_free(node: &Node) -> bool {
    node.tag == "freejoint" || (node.tag == "joint" && node.get("type") == Some("free"))
}

fn not_negative(value: f64, node: &Node, attribute: &str) -> Result<f64> {
    if value < 0.0 {
        return Err(node.fault(attribute, "a negative number", "give a number that is not negative"));
    }
    Ok(value)
}
