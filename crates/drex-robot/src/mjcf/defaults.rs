//! Default classes: nested, each inheriting what its parent set.

use std::collections::BTreeMap;

use drex_core::budget;

use crate::Result;
use crate::unsupported::Unsupported;
use crate::xml::{Attributes, Node, ORIENTATION};

use super::actuators::{self, Settings};

/// Name of the class that holds for elements without one.
const MAIN: &str = "main";

/// Most memory of an attribute in a map apart from its text, bytes.
const ENTRY_BYTES: u64 = 160;

/// One class with everything inherited already in it.
#[derive(Debug, Clone, Default)]
pub(super) struct Class {
    attributes: BTreeMap<String, BTreeMap<String, String>>,
    /// All drive elements share one set of defaults, as in MuJoCo.
    pub actuator: Settings,
}

/// All classes of the file.
#[derive(Debug, Clone)]
pub(super) struct Defaults {
    classes: BTreeMap<String, Class>,
    /// Memory of the attributes of all classes, bytes: each has a copy of what it inherits.
    taken: u64,
}

impl Defaults {
    pub fn read(root: &Node, unsupported: &mut Unsupported) -> Result<Self> {
        let mut defaults = Self { classes: BTreeMap::from([(MAIN.to_owned(), Class::default())]), taken: 0 };
        for node in root.children_called("default") {
            // The outermost class is the main one whatever it is called; later sections add to it.
            let name = node.get("class").unwrap_or(MAIN);
            let main = defaults.classes.get(MAIN).cloned().unwrap_or_default();
            defaults.read_class(node, name, main, unsupported)?;
            if name != MAIN
                && let Some(class) = defaults.classes.get(name).cloned()
            {
                defaults.classes.insert(MAIN.to_owned(), class);
            }
        }
        Ok(defaults)
    }

    fn read_class(&mut self, node: &Node, name: &str, mut class: Class, unsupported: &mut Unsupported) -> Result<()> {
        for child in node.children.iter().filter(|c| c.tag != "default") {
            if actuators::is_drive(&child.tag) {
                class.actuator.apply(child, unsupported)?;
                continue;
            }
            if !["joint", "geom", "mesh", "material"].contains(&child.tag.as_str()) {
                unsupported.element(child);
                continue;
            }
            let slot = class.attributes.entry(child.tag.clone()).or_default();
            if child.attributes.keys().any(|k| ORIENTATION.contains(&k.as_str())) {
                slot.retain(|k, _| !ORIENTATION.contains(&k.as_str()));
            }
            slot.extend(child.attributes.iter().map(|(k, v)| (k.clone(), v.clone())));
            super::bodies::note_unread_attributes(child, unsupported);
        }
        let attributes = || class.attributes.values().flatten();
        self.taken += attributes().map(|(k, v)| (k.len() + v.len()) as u64 + ENTRY_BYTES).sum::<u64>();
        budget::allow(&node.path, "the attributes of all default classes", self.taken)?;
        self.classes.insert(name.to_owned(), class.clone());
        for child in node.children_called("default") {
            let name = child.require("class")?;
            if self.classes.contains_key(name) {
                return Err(child.fault("class", "the class is defined twice", "names of classes are unique"));
            }
            self.read_class(child, name, class.clone(), unsupported)?;
        }
        Ok(())
    }

    /// The class that holds for `node` inside bodies with `childclass`.
    pub fn class(&self, node: &Node, childclass: Option<&str>) -> Result<&Class> {
        let attribute = if node.get("class").is_some() { "class" } else { "childclass" };
        let name = node.get("class").or(childclass).unwrap_or(MAIN);
        self.classes.get(name).ok_or_else(|| {
            let known: Vec<&str> = self.classes.keys().map(String::as_str).collect();
            node.fault(
                attribute,
                format!("there is no default class \"{name}\""),
                format!("use one of {}", known.join(", ")),
            )
        })
    }

    /// The attributes of `node` with its class behind them.
    pub fn resolve<'a>(&'a self, node: &'a Node, childclass: Option<&str>) -> Result<Attributes<'a>> {
        Ok(node.with_defaults(self.class(node, childclass)?.attributes.get(&node.tag)))
    }
}
