//! What a file has and the reader does not use, gathered so that the user sees it once and in full.

use std::collections::{BTreeMap, BTreeSet};

use crate::Error;
use crate::xml::Node;

/// Collected remarks; [`Unsupported::sentences`] turns them into text.
#[derive(Debug, Default)]
pub(crate) struct Unsupported {
    notes: Vec<String>,
    noted: BTreeSet<String>,
    missing_visuals: Vec<String>,
    open_meshes: BTreeSet<String>,
    elements: BTreeMap<String, (usize, u32)>,
    attributes: BTreeMap<(String, String), (usize, u32)>,
}

impl Unsupported {
    /// A remark in words.
    pub fn note(&mut self, sentence: impl Into<String>) {
        let sentence = sentence.into();
        if self.noted.insert(sentence.clone()) {
            self.notes.push(sentence);
        }
    }

    /// A visual shape that could not be read.
    pub fn missing_visual(&mut self, error: &Error) {
        self.missing_visuals.push(error.to_string());
    }

    /// A mesh that bounds no solid and yet gives a body its mass.
    pub fn open_mesh(&mut self, name: &str) {
        self.open_meshes.insert(name.to_owned());
    }

    /// An element that is skipped with all it contains.
    pub fn element(&mut self, node: &Node) {
        self.elements.entry(node.tag.clone()).or_insert((0, node.line)).0 += 1;
    }

    /// Every attribute of `node` that is not in `used`.
    pub fn attributes(&mut self, node: &Node, used: &[&str]) {
        for name in node.attributes.keys().filter(|a| !used.contains(&a.as_str())) {
            self.attributes.entry((node.tag.clone(), name.clone())).or_insert((0, node.line)).0 += 1;
        }
    }

    /// All remarks as sentences, in a fixed order.
    pub fn sentences(self) -> Vec<String> {
        let visuals = self.missing_visuals.first().map(|first| match self.missing_visuals.len() {
            1 => format!("a visual shape is left out: {first}"),
            n => format!("{n} visual shapes are left out; the first: {first}"),
        });
        let open = (!self.open_meshes.is_empty()).then(|| {
            let names: Vec<&str> = self.open_meshes.iter().map(String::as_str).collect();
            format!("not closed, so that their convex hulls give bodies their mass: meshes {}", names.join(", "))
        });
        let times = |n: usize| if n == 1 { "once".to_owned() } else { format!("{n} times") };
        let elements = self
            .elements
            .into_iter()
            .map(|(tag, (n, line))| format!("<{tag}> is not read ({}, first in line {line})", times(n)));
        let attributes = self.attributes.into_iter().map(|((tag, name), (n, line))| {
            format!("{name} of <{tag}> is not read ({}, first in line {line})", times(n))
        });
        self.notes.into_iter().chain(visuals).chain(open).chain(elements).chain(attributes).collect()
    }
}
