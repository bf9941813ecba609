//! The frame of the report: one HTML page with everything inside it.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use crate::picture::plot::escape;

/// A page that is being written, top to bottom.
pub struct Page {
    title: String,
    body: String,
}

impl Page {
    /// An empty page.
    pub fn new(title: &str) -> Self {
        Self { title: title.to_owned(), body: String::new() }
    }

    /// Starts a section.
    pub fn section(&mut self, heading: &str) {
        let _ = write!(self.body, "<h2>{}</h2>", escape(heading));
    }

    /// A paragraph of plain text.
    pub fn paragraph(&mut self, text: &str) {
        let _ = write!(self.body, "<p>{}</p>", escape(text));
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

    /// PNG pictures side by side, each with a caption.
    pub fn pictures(&mut self, pictures: &[(Vec<u8>, String)]) {
        self.body.push_str("<div class=\"grid\">");
        for (png, caption) in pictures {
            let _ = write!(
                self.body,
                "<figure><img alt=\"{0}\" src=\"data:image/png;base64,{1}\"><figcaption>{0}</figcaption></figure>",
                escape(caption),
                STANDARD.encode(png)
            );
        }
        self.body.push_str("</div>");
    }

    /// SVG plots side by side.
    pub fn plots(&mut self, svgs: &[String]) {
        self.body.push_str("<div class=\"grid wide\">");
        for svg in svgs {
            let _ = write!(self.body, "<figure>{svg}</figure>");
        }
        self.body.push_str("</div>");
    }

    /// A table; the first row is the head.
    pub fn table(&mut self, head: &[&str], rows: &[Vec<String>]) {
        self.body.push_str("<div class=\"scroll\"><table><thead><tr>");
        for cell in head {
            let _ = write!(self.body, "<th>{}</th>", escape(cell));
        }
        self.body.push_str("</tr></thead><tbody>");
        for row in rows {
            self.body.push_str("<tr>");
            for cell in row {
                let _ = write!(self.body, "<td>{}</td>", escape(cell));
            }
            self.body.push_str("</tr>");
        }
        self.body.push_str("</tbody></table></div>");
    }

    /// The whole page.
    pub fn to_html(&self) -> String {
        format!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
             <title>{0}</title><style>{STYLE}</style></head><body><main><h1>{0}</h1>{1}</main></body></html>\n",
            escape(&self.title),
            self.body
        )
    }
}

const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#1c2430;--soft:#5b6675;--page:#fbfbfc;--panel:#f4f5f7;--line:#dfe3e8}\
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ee;--soft:#9aa6b5;--page:#14181e;--panel:#1d232b;--line:#303843}}\
*{box-sizing:border-box}body{margin:0;background:var(--page);color:var(--ink);font:15px/1.55 system-ui,sans-serif}\
main{max-width:1180px;margin:0 auto;padding:24px 18px 60px}h1{font-size:26px;margin:.2em 0 .6em}\
h2{font-size:19px;margin:2em 0 .6em;padding-top:.7em;border-top:1px solid var(--line)}p{max-width:76ch;margin:.5em 0}\
ul{max-width:90ch;padding-left:1.2em;color:var(--soft)}\
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(190px,1fr));gap:12px}\
.figures div{background:var(--panel);border-radius:10px;padding:14px 16px;display:flex;flex-direction:column}\
.figures b{font-size:24px;font-weight:650}.figures small{color:var(--soft)}\
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(230px,1fr));gap:12px;margin:14px 0}\
.grid.wide{grid-template-columns:repeat(auto-fit,minmax(min(100%,430px),1fr))}.grid.wide figure{max-width:640px}\
figure{margin:0;background:var(--panel);border-radius:10px;padding:10px;min-width:0}\
figure img{width:100%;height:auto;border-radius:6px;display:block}figure svg{width:100%;height:auto;display:block}\
figcaption{font-size:13px;color:var(--soft);padding-top:6px}\
pre{background:var(--panel);border-radius:10px;padding:12px 14px;overflow-x:auto;font-size:13px}\
.scroll{overflow-x:auto}table{border-collapse:collapse;margin:10px 0;font-variant-numeric:tabular-nums}\
th,td{text-align:left;padding:5px 14px 5px 0;border-bottom:1px solid var(--line);vertical-align:top}\
th{font-weight:600;color:var(--soft)}";
