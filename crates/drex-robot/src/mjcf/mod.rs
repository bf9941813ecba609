//! MJCF, MuJoCo's model format, as far as kinematics, inertia, contact shapes and drives go.

mod actuators;
mod assets;
mod bodies;
mod compiler;
mod defaults;
mod geoms;

use std::collections::BTreeMap;
use std::path::Path;

use drex_core::Pose;

use crate::Result;
use crate::model::{Joint, Link, Robot};
use crate::unsupported::Unsupported;
use crate::xml::Node;

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

    let mut unsupported = Unsupported::default();
    let compiler = Compiler::read(&root, &mut unsupported)?;
    let defaults = Defaults::read(&root, &mut unsupported)?;
    let assets = Assets::read(&root, &defaults, &compiler, folder, &mut unsupported)?;
    let mut builder = Builder {
        compiler,
        defaults,
        assets,
        unsupported,
        links: Vec::new(),
        link_names: Names::default(),
        joints: Vec::new(),
        joint_names: Names::default(),
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
    unsupported: Unsupported,
    links: Vec<Link>,
    link_names: Names,
    joints: Vec<Joint>,
    joint_names: Names,
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
                            self.unsupported.element(child);
                        }
                    }
                }
                "actuator" => {
                    for child in &section.children {
                        actuators.extend(self.read_actuator(child)?);
                    }
                }
                tag if OTHER_SECTIONS.contains(&tag) => self.unsupported.element(section),
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
            unsupported: self.unsupported.sentences(),
        })
    }

    fn read_exclude(&mut self, node: &Node) -> Result<Option<(usize, usize)>> {
        let mut pair = [0; 2];
        for (slot, attribute) in pair.iter_mut().zip(["body1", "body2"]) {
            let name = node.require(attribute)?;
            match self.link_names.get(name) {
                Some(i) => *slot = i,
                None if name == "world" => {
                    self.unsupported.note("contact exclusions with the world are not read".to_owned());
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
        self.joint_names.get(name).ok_or_else(|| {
            const MOST: usize = 40;
            let known = self.joints.iter().map(|j| j.name.as_str());
            let more = (self.joints.len() > MOST).then_some("…");
            let known: Vec<&str> = known.take(MOST).chain(more).collect();
            node.fault(attribute, "there is no such joint", format!("the model's joints are {}", known.join(", ")))
        })
    }
}

/// The names of links or of joints, each with its number.
#[derive(Default)]
struct Names {
    number_of: BTreeMap<String, usize>,
    /// For elements without a name: where the search for a free one goes on, by what the name begins with.
    free_from: BTreeMap<String, usize>,
}

impl Names {
    fn get(&self, name: &str) -> Option<usize> {
        self.number_of.get(name).copied()
    }

    /// Notes a name; of equal ones the first counts.
    fn insert(&mut self, name: &str, number: usize) {
        self.number_of.entry(name.to_owned()).or_insert(number);
    }

    /// The name of `node`, an error where it is used twice. An element without one is called by the first free name that
    /// `fallback` gives for the numbers from `from` on; names with one `base` are searched with ascending `from`.
    fn unique(&mut self, node: &Node, base: &str, from: usize, fallback: impl Fn(usize) -> String) -> Result<String> {
        match node.get("name").filter(|n| !n.is_empty()) {
            Some(name) if self.number_of.contains_key(name) => {
                Err(node.fault("name", "the name is used twice", "names are unique"))
            }
            Some(name) => Ok(name.to_owned()),
            None => {
                // Names are never given back: what was taken once need not be tried again.
                let free_from = self.free_from.entry(base.to_owned()).or_default();
                let mut i = from.max(*free_from);
                let mut name = fallback(i);
                while self.number_of.contains_key(&name) {
                    i += 1;
                    name = fallback(i);
                }
                *free_from = i;
                Ok(name)
            }
        }
    }
}
