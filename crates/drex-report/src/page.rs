//! The frame of a report: one HTML page with everything inside it.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::viewer::Scene;
use crate::picture::plot::escape;

const STYLE: &str = include_str!("style.css");
const VIEWER: &str = include_str!("viewer.js");
/// The browser itself refuses whatever is not in the page.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";

/// A page that is being written, top to bottom.
pub struct Page {
    title: String,
    body: String,
    headings: Vec<String>,
    viewers: usize,
    style: &'static str,
    script: &'static str,
}

/// The address of a PNG or JPEG picture that is written into the page.
pub fn source(picture: &[u8]) -> String {
    let kind = if picture.starts_with(&[0xff, 0xd8]) { "jpeg" } else { "png" };
    format!("data:image/{kind};base64,{}", STANDARD.encode(picture))
}

impl Page {
    /// An empty page.
    pub fn new(title: &str) -> Self {
        Self { title: title.to_owned(), body: String::new(), headings: Vec::new(), viewers: 0, style: "", script: "" }
    }

    /// Gives the page rules of style and a script beside those that every page has.
    pub fn extend(&mut self, style: &'static str, script: &'static str) {
        (self.style, self.script) = (style, script);
    }

    /// Markup that is taken as it is: whoever wrote it has escaped the text in it.
    pub fn html(&mut self, html: &str) {
        self.body.push_str(html);
    }

    /// Starts a section.
    pub fn section(&mut self, heading: &str) {
        self.headings.push(heading.to_owned());
        let _ = write!(self.body, "<h2 id=\"s{}\">{}</h2>", self.headings.len(), escape(heading));
    }

    /// Starts a part of a section.
    pub fn subsection(&mut self, heading: &str) {
        let _ = write!(self.body, "<h3>{}</h3>", escape(heading));
    }

    /// A paragraph of plain text.
    pub fn paragraph(&mut self, text: &str) {
        let _ = write!(self.body, "<p>{}</p>", escape(text));
    }

    /// A paragraph of plain text that nobody should miss.
    pub fn warning(&mut self, text: &str) {
        let _ = write!(self.body, "<p class=\"warning\" role=\"alert\">{}</p>", escape(text));
    }

    /// Preformatted text.
    pub fn code(&mut self, text: &str) {
        let _ = write!(self.body, "<pre>{}</pre>", escape(text));
    }

    /// A list of plain text lines.
    pub fn list(&mut self, lines: &[String]) {
        if lines.is_empty() {
            return;
        }
        self.body.push_str("<ul>");
        for line in lines {
            let _ = write!(self.body, "<li>{}</li>", escape(line));
        }
        self.body.push_str("</ul>");
    }

    /// The numbers that matter, each with its name and a remark.
    pub fn figures(&mut self, figures: &[(String, String, String)]) {
        self.body.push_str("<div class=\"figures\">");
        for (value, name, remark) in figures {
            let _ = write!(
                self.body,
                "<div><b>{}</b><span>{}</span><small>{}</small></div>",
                escape(value),
                escape(name),
                escape(remark)
            );
        }
        self.body.push_str("</div>");
    }

    /// PNG or JPEG pictures side by side, each with a caption.
    pub fn pictures(&mut self, pictures: &[(Vec<u8>, String)]) {
        if pictures.is_empty() {
            return;
        }
        self.body.push_str("<div class=\"grid\">");
        for (picture, caption) in pictures {
            let _ = write!(
                self.body,
                "<figure><img alt=\"{0}\" src=\"{1}\"><figcaption>{0}</figcaption></figure>",
                escape(caption),
                source(picture)
            );
        }
        self.body.push_str("</div>");
    }

    /// Scenes side by side, each with the picture that stands for it where it cannot be drawn, and a caption. Gives the name of
    /// the first one, for [`Page::plots_of`].
    pub fn viewers(&mut self, scenes: &[(Scene, Vec<u8>, String)]) -> String {
        let first = format!("v{}", self.viewers + 1);
        let class = if scenes.len() == 1 { "views one" } else { "views" };
        let _ = write!(self.body, "<div class=\"{class}\">");
        for (scene, picture, caption) in scenes {
            self.viewers += 1;
            let (number, caption, picture) = (self.viewers, escape(caption), source(picture));
            let image = format!("<img alt=\"{caption}\" src=\"{picture}\">");
            let _ = match scene.to_json() {
                Some(json) => write!(
                    self.body,
                    "<figure class=\"view\" id=\"v{number}\" data-label=\"{caption}\"><div class=\"stage\">{image}</div>\
                     <figcaption>{caption}</figcaption><script type=\"application/json\">{json}</script></figure>"
                ),
                None => write!(self.body, "<figure>{image}<figcaption>{caption}</figcaption></figure>"),
            };
        }
        self.body.push_str("</div>");
        first
    }

    /// SVG plots side by side.
    pub fn plots(&mut self, svgs: &[String]) {
        self.plots_of("", svgs);
    }

    /// SVG plots side by side over the time of a scene: a line in them shows where it is.
    pub fn plots_of(&mut self, viewer: &str, svgs: &[String]) {
        if svgs.is_empty() {
            return;
        }
        let _ = write!(self.body, "<div class=\"grid wide\" data-follows=\"{viewer}\">");
        for svg in svgs {
            let _ = write!(self.body, "<figure>{svg}</figure>");
        }
        self.body.push_str("</div>");
    }

    /// A table of plain text below its head.
    pub fn table(&mut self, head: &[&str], rows: &[Vec<String>]) {
        let escaped = |row: &Vec<String>| row.iter().map(|cell| escape(cell)).collect();
        self.table_of_html(head, &rows.iter().map(escaped).collect::<Vec<_>>());
    }

    /// A table of markup, taken as it is, below its head of plain text.
    pub fn table_of_html(&mut self, head: &[&str], rows: &[Vec<String>]) {
        self.body.push_str("<div class=\"scroll\"><table><thead><tr>");
        for cell in head {
            let _ = write!(self.body, "<th>{}</th>", escape(cell));
        }
        self.body.push_str("</tr></thead><tbody>");
        for row in rows {
            self.body.push_str("<tr>");
            for cell in row {
                let _ = write!(self.body, "<td>{cell}</td>");
            }
            self.body.push_str("</tr>");
        }
        self.body.push_str("</tbody></table></div>");
    }

    /// The whole page.
    pub fn to_html(&self) -> String {
        let mut contents = String::new();
        for (i, heading) in self.headings.iter().enumerate() {
            let _ = write!(contents, "<a href=\"#s{}\">{}</a>", i + 1, escape(heading));
        }
        let viewer = if self.viewers > 0 { VIEWER } else { "" };
        let scripts = [viewer, self.script].into_iter().filter(|s| !s.is_empty());
        let scripts: String = scripts.map(|s| format!("<script>{s}</script>")).collect();
        format!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
             <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\"><link rel=\"icon\" href=\"data:,\">\
             <title>{0}</title><style>{STYLE}{2}</style></head><body><main><h1>{0}</h1>\
             <nav aria-label=\"Contents\">{contents}</nav>{1}</main>{scripts}</body></html>\n",
            escape(&self.title),
            self.body,
            self.style
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::{Pose, TriMesh};
    use nalgebra::Point3;

    use crate::viewer::Look;

    fn triangle() -> TriMesh {
        let corners = vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
        TriMesh::new(corners, vec![[0, 1, 2]]).unwrap()
    }

    #[test]
    fn every_section_is_in_the_contents_and_text_stays_text() {
        let mut page = Page::new("a < b");
        page.section("Mass & \"more\"");
        page.section("Object");
        page.paragraph("<script>alert(1)</script>");
        let html = page.to_html();
        assert!(html.contains("<a href=\"#s2\">Object</a>") && html.contains("<h2 id=\"s2\">Object</h2>"));
        assert!(html.contains("<title>a &lt; b</title>") && !html.contains("<script>"));
    }

    #[test]
    fn a_scene_has_its_picture_and_one_without_content_is_only_that() {
        let mut full = Scene::new(0.0, 0.0);
        let number = full.mesh(&triangle(), 10).unwrap();
        full.part(number, Look::Solid, [0.5; 3], &[Pose::identity().into()]).unwrap();
        let mut page = Page::new("scenes");
        let picture = vec![0xff, 0xd8, 0xff];
        let first = page.viewers(&[
            (full, picture.clone(), "full".to_owned()),
            (Scene::new(0.0, 0.0), picture, "empty".to_owned()),
        ]);
        assert_eq!(first, "v1");
        let html = page.to_html();
        assert_eq!(html.matches("<figure class=\"view\"").count(), 1);
        assert_eq!(html.matches("src=\"data:image/jpeg;base64,").count(), 2);
        assert_eq!(html.matches("type=\"application/json\"").count(), 1);
    }

    #[test]
    fn nothing_in_the_frame_of_the_page_is_fetched() {
        let mut page = Page::new("offline");
        page.viewers(&[(Scene::new(0.0, 0.0), Vec::new(), String::new())]);
        let html = page.to_html();
        for word in ["http://", "https://", "src=\"/", "url(", "@import"] {
            assert!(!html.contains(word), "{word}");
        }
        assert!(html.contains("default-src 'none'"));
    }
}
