//! XML as an owned tree that remembers files and lines, and typed access to attributes with errors that name them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use drex_core::budget;
use nalgebra::Vector3;

use crate::error::Place;
use crate::{Error, Result};

/// Deeper files are refused, so that recursion over the tree cannot exhaust the stack.
const MAX_DEPTH: usize = 200;

/// Most files that a model may include, each counted as often as it is included.
const MAX_INCLUDES: usize = 1000;
/// Memory of an element in the parser's tree and in ours, and of its attributes, bytes.
const ELEMENT_BYTES: u64 = 256;
const ATTRIBUTE_BYTES: u64 = 640;

/// Characters of an attribute that a message quotes.
const MOST_QUOTED: usize = 200;

/// Products of a few numbers up to this size stay finite.
const LARGEST: f64 = 1e50;

/// An element of a file.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    pub tag: String,
    pub attributes: BTreeMap<String, String>,
    pub children: Vec<Node>,
    pub line: u32,
    pub path: Arc<Path>,
}

impl Node {
    /// Parses `text`, which came from `path`.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        budget::allow(path, "its elements", memory_of(text))?;
        let document = roxmltree::Document::parse(text)
            .map_err(|e| Error::document(path, e.pos().row, format!("no well-formed XML ({e})"), "repair the file"))?;
        let line_starts: Vec<usize> = std::iter::once(0)
            .chain(text.bytes().enumerate().filter(|(_, b)| *b == b'\n').map(|(i, _)| i + 1))
            .collect();
        Self::from_element(document.root_element(), &Arc::from(path), &line_starts, 0)
    }

    fn from_element(
        element: roxmltree::Node<'_, '_>,
        path: &Arc<Path>,
        line_starts: &[usize],
        depth: usize,
    ) -> Result<Self> {
        let line = line_starts.partition_point(|&start| start <= element.range().start) as u32;
        if depth > MAX_DEPTH {
            return Err(Error::document(
                path,
                line,
                format!("elements are nested more than {MAX_DEPTH} deep"),
                "flatten the file",
            ));
        }
        Ok(Self {
            tag: element.tag_name().name().to_owned(),
            attributes: element.attributes().map(|a| (a.name().to_owned(), a.value().to_owned())).collect(),
            children: element
                .children()
                .filter(roxmltree::Node::is_element)
                .map(|c| Self::from_element(c, path, line_starts, depth + 1))
                .collect::<Result<_>>()?,
            line,
            path: path.clone(),
        })
    }

    /// Replaces every `<include file="…"/>` below by the children of that file's root element.
    ///
    /// Files are looked for beside the main file (in `folder`) first, then beside the file that includes them.
    pub fn expand_includes(&mut self, folder: Option<&Path>) -> Result<()> {
        self.expand(folder, &mut Includes::default())
    }

    fn expand(&mut self, folder: Option<&Path>, includes: &mut Includes) -> Result<()> {
        let mut children = Vec::with_capacity(self.children.len());
        for mut child in std::mem::take(&mut self.children) {
            if child.tag != "include" {
                child.expand(folder, includes)?;
                children.push(child);
                continue;
            }
            let file = child.require("file")?;
            let Some(folder) = folder else {
                return Err(child.fault(
                    "file",
                    "text that came without a folder cannot include files",
                    "load the model from a file",
                ));
            };
            let beside = folder.join(file);
            let path = match child.path.parent().map(|p| p.join(file)) {
                Some(other) if !beside.is_file() => other,
                _ => beside,
            };
            if includes.open.contains(&path) {
                return Err(child.fault("file", "the file includes itself", "remove the circle"));
            }
            if includes.files >= MAX_INCLUDES || includes.open.len() > 50 {
                return Err(child.fault("file", "too many included files", "include each file once"));
            }
            includes.files += 1;
            let text = drex_core::fsutil::read_text(&path)
                .map_err(|e| child.fault("file", e.to_string(), "give a path relative to the main file"))?;
            includes.taken += memory_of(&text);
            budget::allow(&path, "all included elements", includes.taken)?;
            let mut root = Self::parse(&text, &path)?;
            includes.open.push(path);
            root.expand(Some(folder), includes)?;
            includes.open.pop();
            children.append(&mut root.children);
        }
        self.children = children;
        Ok(())
    }

    /// The attribute `name` as text.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.attributes.get(name).map(String::as_str)
    }

    /// The attribute `name`, which must be there.
    pub fn require(&self, name: &str) -> Result<&str> {
        self.get(name).ok_or_else(|| self.error(format!("the attribute \"{name}\" is missing"), "add it"))
    }

    /// The children called `tag`.
    pub fn children_called<'a>(&'a self, tag: &'a str) -> impl Iterator<Item = &'a Self> {
        self.children.iter().filter(move |c| c.tag == tag)
    }

    /// The first child called `tag`.
    pub fn child(&self, tag: &str) -> Option<&Self> {
        self.children.iter().find(|c| c.tag == tag)
    }

    /// The element as messages call it: the tag, and the name if it has one.
    pub fn title(&self) -> String {
        match self.get("name") {
            Some(name) => format!("{} name=\"{name}\"", self.tag),
            None => self.tag.clone(),
        }
    }

    fn place(&self) -> Box<Place> {
        Box::new(Place { path: self.path.to_path_buf(), line: self.line, element: self.title() })
    }

    /// An error about the element as a whole.
    pub fn error(&self, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Element { place: self.place(), what: what.into(), remedy: remedy.into() }
    }

    /// An error about one attribute.
    pub fn fault(&self, attribute: &str, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        self.fault_with(attribute, self.get(attribute).unwrap_or_default(), what, remedy)
    }

    fn fault_with(&self, attribute: &str, value: &str, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::Attribute {
            place: self.place(),
            attribute: attribute.into(),
            value: value.chars().take(MOST_QUOTED).collect(),
            what: what.into(),
            remedy: remedy.into(),
        }
    }

    /// This element with attributes that it inherits where it has none of its own.
    pub fn with_defaults<'a>(&'a self, inherited: Option<&'a BTreeMap<String, String>>) -> Attributes<'a> {
        Attributes { node: self, inherited }
    }
}

/// Files included so far.
#[derive(Default)]
struct Includes {
    files: usize,
    /// Those inside which the reader stands.
    open: Vec<PathBuf>,
    /// Memory of the elements of all of them, bytes.
    taken: u64,
}

/// An upper bound of the memory that the tree of an XML text takes, bytes.
fn memory_of(text: &str) -> u64 {
    let count = |mark: u8| text.bytes().filter(|&b| b == mark).count() as u64;
    text.len() as u64 + count(b'<') * ELEMENT_BYTES + count(b'=') * ATTRIBUTE_BYTES
}

/// The attributes that describe an orientation in MJCF; giving one of them replaces an inherited one.
pub(crate) const ORIENTATION: [&str; 5] = ["quat", "axisangle", "xyaxes", "zaxis", "euler"];

/// Attributes of an element together with the defaults of its class.
#[derive(Clone, Copy)]
pub(crate) struct Attributes<'a> {
    pub node: &'a Node,
    inherited: Option<&'a BTreeMap<String, String>>,
}

impl<'a> Attributes<'a> {
    pub fn get(&self, name: &str) -> Option<&'a str> {
        if let Some(own) = self.node.get(name) {
            return Some(own);
        }
        if ORIENTATION.contains(&name) && ORIENTATION.iter().any(|o| self.node.attributes.contains_key(*o)) {
            return None;
        }
        self.inherited.and_then(|d| d.get(name)).map(String::as_str)
    }

    pub fn fault(&self, attribute: &str, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        self.node.fault_with(attribute, self.get(attribute).unwrap_or_default(), what, remedy)
    }

    /// The numbers of attribute `name`; `None` if it is absent. None of them is so large that its square overflows.
    pub fn numbers(&self, name: &str, count: std::ops::RangeInclusive<usize>) -> Result<Option<Vec<f64>>> {
        let numbers = self.any_numbers(name, count)?;
        if numbers.iter().flatten().any(|v| v.abs() > LARGEST) {
            return Err(self.fault(name, format!("a number beyond {LARGEST:e}"), "repair the model"));
        }
        Ok(numbers)
    }

    fn any_numbers(&self, name: &str, count: std::ops::RangeInclusive<usize>) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.get(name) else { return Ok(None) };
        let numbers: Vec<f64> =
            text.split_ascii_whitespace()
                .map(|word| {
                    f64::from_str(word).ok().filter(|v| v.is_finite()).ok_or_else(|| {
                        self.fault(name, format!("\"{word}\" is no finite number"), "give decimal numbers")
                    })
                })
                .collect::<Result<_>>()?;
        if !count.contains(&numbers.len()) {
            let wanted = if count.start() == count.end() {
                count.start().to_string()
            } else {
                format!("{} to {}", count.start(), count.end())
            };
            let what = format!("{} numbers where {wanted} are wanted", numbers.len());
            return Err(self.fault(name, what, "give that many"));
        }
        Ok(Some(numbers))
    }

    /// One number, however large: limits may be.
    pub fn number(&self, name: &str) -> Result<Option<f64>> {
        Ok(self.any_numbers(name, 1..=1)?.map(|v| v[0]))
    }

    pub fn vector(&self, name: &str) -> Result<Option<Vector3<f64>>> {
        Ok(self.numbers(name, 3..=3)?.map(|v| Vector3::new(v[0], v[1], v[2])))
    }

    pub fn range(&self, name: &str) -> Result<Option<(f64, f64)>> {
        let Some(v) = self.any_numbers(name, 2..=2)? else { return Ok(None) };
        if v[0] > v[1] {
            return Err(self.fault(name, "the lower bound is above the upper one", "swap them"));
        }
        Ok(Some((v[0], v[1])))
    }

    /// `true`, `false`, or `None` where the attribute is absent or `auto`.
    pub fn truth(&self, name: &str) -> Result<Option<bool>> {
        match self.get(name) {
            None | Some("auto") => Ok(None),
            Some("true") => Ok(Some(true)),
            Some("false") => Ok(Some(false)),
            Some(_) => Err(self.fault(name, "neither \"true\", \"false\" nor \"auto\"", "use one of them")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_file_line_element_and_attribute() {
        let node = Node::parse("<robot>\n  <joint name=\"a\" axis=\"0 x 1\"/>\n</robot>", Path::new("r.urdf")).unwrap();
        let message = node.children[0].with_defaults(None).vector("axis").unwrap_err().to_string();
        for part in ["r.urdf", "line 2", "joint name=\"a\"", "axis=\"0 x 1\"", "\"x\" is no finite number"] {
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn broken_xml_names_the_line() {
        let message = Node::parse("<robot>\n<a>\n</robot>", Path::new("r.urdf")).unwrap_err().to_string();
        assert!(message.contains("r.urdf, line 3"), "{message}");
    }

    #[test]
    fn deep_nesting_is_an_error_not_an_overflow() {
        let text = "<a>".repeat(5000) + &"</a>".repeat(5000);
        assert!(Node::parse(&text, Path::new("deep")).is_err());
    }
}
