//! XML text, written from the outside in.

use drex_core::Pose;
use nalgebra::Vector3;

/// Name and value.
pub(crate) type Attribute = (&'static str, String);

/// Text under construction and the tags that are open.
#[derive(Debug, Default)]
pub(crate) struct Text {
    out: String,
    open: Vec<&'static str>,
}

impl Text {
    /// `<tag attributes>`, to be closed by [`Text::close`].
    pub fn open(&mut self, tag: &'static str, attributes: &[Attribute]) {
        self.element(tag, attributes, ">");
        self.open.push(tag);
    }

    /// `<tag attributes/>`.
    pub fn leaf(&mut self, tag: &'static str, attributes: &[Attribute]) {
        self.element(tag, attributes, "/>");
    }

    /// Closes the tag opened last.
    pub fn close(&mut self) {
        if let Some(tag) = self.open.pop() {
            self.indent();
            self.out.push_str(&format!("</{tag}>\n"));
        }
    }

    /// Everything of another text, one level down.
    pub fn section(&mut self, tag: &'static str, inner: Text) {
        if inner.out.is_empty() {
            return;
        }
        self.open(tag, &[]);
        for line in inner.finish().lines() {
            self.indent();
            self.out.push_str(line);
            self.out.push('\n');
        }
        self.close();
    }

    /// The text, every tag closed.
    pub fn finish(mut self) -> String {
        while !self.open.is_empty() {
            self.close();
        }
        self.out
    }

    fn element(&mut self, tag: &str, attributes: &[Attribute], end: &str) {
        self.indent();
        self.out.push('<');
        self.out.push_str(tag);
        for (name, value) in attributes {
            let value = value.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
            self.out.push_str(&format!(" {name}=\"{value}\""));
        }
        self.out.push_str(end);
        self.out.push('\n');
    }

    fn indent(&mut self) {
        self.out.push_str(&"  ".repeat(self.open.len()));
    }
}

/// Numbers with spaces between them, each as short as it can be without losing a bit; adding zero takes signs off zeros.
pub(crate) fn list(numbers: &[f64]) -> String {
    numbers.iter().map(|x| format!("{:?}", x + 0.0)).collect::<Vec<_>>().join(" ")
}

/// A vector as an attribute.
pub(crate) fn vector(v: &Vector3<f64>) -> String {
    list(v.as_slice())
}

/// Position and orientation as attributes, quaternion scalar first.
pub(crate) fn placed(pose: &Pose) -> [Attribute; 2] {
    let q = &pose.rotation;
    [("pos", vector(&pose.translation.vector)), ("quat", list(&[q.w, q.i, q.j, q.k]))]
}
