//! MJCF, MuJoCo's model format, as far as kinematics, inertia, contact shapes and drives go.

mod actuators;
mod assets;
mod bodies;
mod compiler;
mod defaults;
mod geoms;

use std::path::Path;

use drex_core::Pose;

use crate::model::{Joint, Link, Robot};
use crate::unread::Unread;
use crate::xml::Node;
use crate::{Error, Result};

use assets::Assets;
use compiler::Compiler;
use defaults::Defaults;

/// Sections of the file that are read.
const READ_SECTIONS: [&str; 6] = ["compiler", "default", "asset", "worldbody", "contact", "actuator"];
/// Sections of the file that say nothing about a robot's body.
const OTHER_SECTIONS: [&str; 13] = [
    "option",
    "size",
    "visual",
    "statistic",
    "custom",
    "sensor",
    "keyframe",
    "tendon",
    "equality",
    "deformable",
    "extension",
    "plugin",
    "skin",
];

/// Reads MJCF text. `path` names it in messages; `folder` is where its files are.
pub(crate) fn read(xml: &str, path: &Path, folder: Option<&Path>) -> Result<Robot> {
    let mut root = Node::parse(xml, path)?;
    if root.tag != "mujoco" {
        return Err(root.error("this is no MJCF model", "the root element must be <mujoco>"));
    }
    root.expand_includes(folder)?;
    if let Some(odd) = root
        .children
        .iter()
        .find(|c| !READ_SECTIONS.contains(&c.tag.as_str()) && !OTHER_SECTIONS.contains(&c.tag.as_str()))
    {
        return Err(odd.error("no section of an MJCF model", "check the spelling"));
    }

    let mut unread = Unread::default();
    let compiler = Compiler::read(&root, &mut unread)?;
    let defaults = Defaults::read(&root, &mut unread)?;
    let assets = Assets::read(&root, &defaults, &compiler, folder, &mut unread)?;
    let mut builder = Builder {
        compiler,
        defaults,
        assets,
        unread,
        links: Vec::new(),
        joints: Vec::new(),
        file_world_from_base: Pose::identity(),
    };
    builder.read_bodies(&root)?;
    builder.read_contacts_and_drives(root)
}

/// The model while it is being put together.
struct Builder {
    compiler: Compiler,
    defaults: Defaults,
    assets: Assets,
    unread: Unread,
    links: Vec<Link>,
    joints: Vec<Joint>,
    file_world_from_base: Pose,
}

impl Builder {
    fn read_contacts_and_drives(mut self, root: Node) -> Result<Robot> {
        let mut excluded_pairs = Vec::new();
        let mut actuators = Vec::new();
        for section in &root.children {
            match section.tag.as_str() {
                "contact" => {
                    for child in &section.children {
                        if child.tag == "exclude" {
                            excluded_pairs.extend(self.read_exclude(child)?);
                        } else {
                            self.unread.element(child);
                        }
                    }
                }
                "actuator" => {
                    for child in &section.children {
                        actuators.extend(self.read_actuator(child)?);
                    }
                }
                tag if OTHER_SECTIONS.contains(&tag) => self.unread.element(section),
                _ => {}
            }
        }
        excluded_pairs.sort_unstable();
        excluded_pairs.dedup();
        for actuator in &actuators {
            let joint = &mut self.joints[actuator.joint];
            if let (None, Some((lo, hi))) = (joint.effort_limit, actuator.force_range) {
                joint.effort_limit = Some(lo.abs().max(hi.abs()) * actuator.gear.abs());
            }
        }
        self.scale_to_total_mass();
        Ok(Robot {
            name: root.get("model").unwrap_or("robot").to_owned(),
            links: self.links,
            joints: self.joints,
            actuators,
            excluded_pairs,
            file_world_from_base: self.file_world_from_base,
            unread: self.unread.sentences(),
        })
    }

    fn read_exclude(&mut self, node: &Node) -> Result<Option<(usize, usize)>> {
        let mut pair = [0; 2];
        for (slot, attribute) in pair.iter_mut().zip(["body1", "body2"]) {
            let name = node.require(attribute)?;
            match self.links.iter().position(|l| l.name == name) {
                Some(i) => *slot = i,
                None if name == "world" => {
                    self.unread.note("contact exclusions with the world are not read".to_owned());
                    return Ok(None);
                }
                None => return Err(node.fault(attribute, "there is no such body", "name a body of the model")),
            }
        }
        Ok(Some((pair[0].min(pair[1]), pair[0].max(pair[1]))))
    }

    fn scale_to_total_mass(&mut self) {
        let Some(wanted) = self.compiler.total_mass_kg else { return };
        let total: f64 = self.links.iter().filter_map(|l| l.inertial.as_ref()).map(|m| m.mass_kg).sum();
        if total > 0.0 {
            for body in self.links.iter_mut().filter_map(|l| l.inertial.as_mut()) {
                *body = body.with_mass(body.mass_kg * wanted / total);
            }
        }
    }

    fn joint_by_name(&self, node: &Node, attribute: &str, name: &str) -> Result<usize> {
        self.joints.iter().position(|j| j.name == name).ok_or_else(|| {
            let known: Vec<&str> = self.joints.iter().map(|j| j.name.as_str()).collect();
            node.fault(attribute, "there is no such joint", format!("the model's joints are {}", known.join(", ")))
        })
    }
}

/// A name for an element that has none, or an error where a name is used twice.
fn unique_name(node: &Node, taken: impl Fn(&str) -> bool, fallback: impl Fn(usize) -> String) -> Result<String> {
    match node.get("name").filter(|n| !n.is_empty()) {
        Some(name) if taken(name) => Err(node.fault("name", "the name is used twice", "names are unique")),
        Some(name) => Ok(name.to_owned()),
        None => {
            let mut i = 0;
            let mut name = fallback(i);
            while taken(&name) {
                i += 1;
                name = fallback(i);
            }
            Ok(name)
        }
    }
}

/// An error of the mesh reader, seen from the element that names the file.
fn in_element(node: &Node, error: &Error) -> Error {
    node.fault("file", error.to_string(), "repair or replace the file")
}
