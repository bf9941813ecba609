//! The gallery: a card for each item, that a small script sorts and filters.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use drex_core::fsutil;
use drex_trial::wilson;
use drex_twin::batch::{Batch, Item, RESULTS, Status, Task};

use super::measures::{Measured, digits, duration, grams, grams_between, items_text, percent_between, positive};
use super::outliers::{Outliers, Quantity};
use super::thumbnails::{HEIGHT, Thumbnails, WIDTH};
use crate::page::{Page, source};
use crate::picture::plot::escape;

/// Items with a picture, and with a card: each picture takes 6 kB of the page, each card 0.7 kB, and browsers must hold them all.
pub const MOST_PICTURES: usize = 1000;
pub const MOST_CARDS: usize = 10_000;
/// How the cards look.
const STYLE: &str = include_str!("gallery.css");
/// Sorts and filters them.
const SCRIPT: &str = include_str!("gallery.js");
/// What cards can be sorted by: the name of the value, and what the button says.
const KEYS: [(&str, &str); 8] = [
    ("order", "failures first"),
    ("name", "name"),
    ("status", "status"),
    ("mass", "mass"),
    ("width", "interval width"),
    ("grip", "grip force"),
    ("rate", "success rate"),
    ("seconds", "seconds"),
];

/// The items that have cards, in their order: failures, outliers, names.
pub fn order(items: &[Measured<'_>], outliers: &Outliers) -> Vec<usize> {
    let stands_out: BTreeSet<usize> = outliers.found.iter().map(|o| o.row).collect();
    let mut order: Vec<usize> = (0..items.len()).collect();
    order.sort_by_key(|i| (items[*i].row.status != Status::Failed, !stands_out.contains(i), *i));
    order.truncate(MOST_CARDS);
    order
}

/// The section with all items, of which those in `order` have cards.
pub fn section(page: &mut Page, batch: &Batch, items: &[Measured<'_>], outliers: &Outliers, order: &[usize]) {
    page.section("All items");
    if items.is_empty() {
        page.paragraph("The batch has no items.");
        return;
    }
    let mut stands_out: BTreeMap<usize, Vec<Quantity>> = BTreeMap::new();
    for outlier in &outliers.found {
        stands_out.entry(outlier.row).or_default().push(outlier.quantity);
    }
    let by_name: BTreeMap<&str, &Item> = batch.items().iter().map(|item| (item.name.as_str(), item)).collect();
    let item_of = |i: usize| by_name.get(items[i].row.name.as_str()).copied();
    let pictured: BTreeSet<usize> = order.iter().copied().take(MOST_PICTURES).collect();
    let thumbnails = Thumbnails::draw(pictured.iter().filter_map(|i| item_of(*i)));
    if items.len() > MOST_PICTURES {
        let cards = if items.len() > order.len() {
            format!(" and the first {} have cards; {RESULTS} has all", order.len())
        } else {
            String::new()
        };
        page.paragraph(&format!(
            "The first {MOST_PICTURES} of {} have pictures{cards}. Failures and outliers come before others; more would make this page too large.",
            items_text(items.len())
        ));
    }
    if items.iter().any(|i| i.mass_interval_kg.is_some() || i.trials.is_some()) {
        page.paragraph(
            "The strip below a mass shows its 95 % interval on a logarithmic axis that all items share, the one below trials the interval \
             of the success rate from 0 to 100 %.",
        );
    }
    let masses = Axis::of(items);
    let cards = order.iter().map(|&i| {
        let picture = match item_of(i).filter(|_| pictured.contains(&i)) {
            Some(item) => thumbnails.get(item),
            None => None,
        };
        let link = item_of(i).and_then(|item| report_of(item, batch.out()));
        let quantities = stands_out.get(&i).map_or(&[][..], Vec::as_slice);
        card(i, &items[i], quantities, picture, link.as_deref(), &masses)
    });
    let cards: String = cards.collect();
    page.extend(STYLE, SCRIPT);
    page.html(&format!("{}<ol class=\"cards\" id=\"cards\">{cards}</ol>", tools()));
}

/// A name as markup; a long one is broken after `/` and `_` rather than elsewhere.
pub fn name_html(name: &str) -> String {
    escape(name).replace('/', "/<wbr>").replace('_', "_<wbr>")
}

/// Buttons and box of the script, which shows them.
fn tools() -> String {
    let mut html = String::from(
        "<div class=\"tools\" id=\"tools\" hidden><label>Find <input type=\"search\" autocomplete=\"off\"></label>\
         <div role=\"group\" aria-label=\"Sort by\">Sort by",
    );
    for (key, text) in KEYS {
        let pressed = key == "order";
        let _ = write!(html, "<button data-key=\"{key}\" aria-pressed=\"{pressed}\">{text}<span></span></button>");
    }
    html + "</div><output aria-live=\"polite\"></output></div>"
}

fn card(
    index: usize,
    item: &Measured<'_>,
    stands_out: &[Quantity],
    picture: Option<&[u8]>,
    link: Option<&str>,
    masses: &Axis,
) -> String {
    let row = item.row;
    let (class, status) = match row.status {
        Status::Failed => ("failed", 0),
        Status::Pending => ("pending", 1),
        Status::Done if !stands_out.is_empty() => ("outlier", 2),
        Status::Done => ("done", 2),
    };
    let mut html = format!("<li class=\"card {class}\" id=\"i{index}\" data-status=\"{status}\"");
    for (key, value) in [
        ("mass", item.mass_kg),
        ("width", item.relative_width),
        ("grip", item.grip_force_n),
        ("rate", item.success_rate()),
        ("seconds", item.seconds),
    ] {
        if let Some(value) = value {
            let _ = write!(html, " data-{key}=\"{value:.5e}\"");
        }
    }
    html.push('>');
    let _ = match picture {
        Some(picture) => write!(
            html,
            "<figure><img alt=\"\" width=\"{WIDTH}\" height=\"{HEIGHT}\" decoding=\"async\" src=\"{}\"></figure>",
            source(picture)
        ),
        None => write!(html, "<figure>no picture</figure>"),
    };
    let name = name_html(&row.name);
    let _ = match link {
        Some(link) => write!(html, "<div><a class=\"name\" href=\"{}\">{name}</a>", escape(link)),
        None => write!(html, "<div><span class=\"name\">{name}</span>"),
    };
    let tags = match row.status {
        Status::Failed => vec!["failed"],
        Status::Pending => vec!["pending"],
        Status::Done => stands_out.iter().map(|q| q.name()).collect(),
    };
    for tag in tags {
        let _ = write!(html, "<span class=\"tag\">{tag}</span>");
    }
    if row.status == Status::Failed {
        let _ = write!(html, "<p>{}</p>", escape(&row.error));
    }
    let values = values(item, masses);
    if !values.is_empty() {
        let _ = write!(html, "<dl>{values}</dl>");
    }
    html + "</div></li>"
}

/// What is known of an item, term by term.
fn values(item: &Measured<'_>, masses: &Axis) -> String {
    let row = item.row;
    let mut html = String::new();
    let mut value = |term: &str, text: String, remark: String, range: String| {
        let _ = write!(html, "<dt>{term}</dt><dd>{} <small>{}</small>{range}</dd>", escape(&text), escape(&remark));
    };
    if let Some(kg) = item.mass_kg {
        let interval = item.mass_interval_kg;
        let remark = interval.map_or_else(|| row.mass_source.clone(), grams_between);
        let range = interval.and_then(|ends| masses.range(ends, kg)).unwrap_or_default();
        value("mass", grams(kg), remark, range);
    }
    if !row.verdict.is_empty() {
        // Where the mass comes from, unless that has been said.
        let is_said = row.mass_source == row.verdict || item.mass_interval_kg.is_none();
        let source = if is_said { String::new() } else { row.mass_source.clone() };
        value("verdict", row.verdict.replace('_', " "), source, String::new());
    }
    if let Some(newtons) = item.grip_force_n {
        let per_weight = item.grip_per_weight.map_or_else(String::new, |g| format!("{} × weight", digits(g)));
        value("grip", format!("{} N", digits(newtons)), per_weight, String::new());
    }
    if let Some([held, trials]) = item.trials {
        let rate = wilson(held, trials);
        let range = bar(rate.low, rate.high, rate.value);
        value("held", format!("{held} of {trials}"), percent_between(rate.low, rate.high), range);
    }
    if let Some(seconds) = item.run.and_then(|run| positive(Some(run.seconds))) {
        value("time", duration(seconds), String::new(), String::new());
    }
    html
}

/// The logarithmic axis of masses that all cards share: logarithms of its ends.
struct Axis(f64, f64);

impl Axis {
    fn of(items: &[Measured<'_>]) -> Self {
        let ends = items.iter().filter_map(|i| i.mass_interval_kg).flatten().filter(|kg| *kg > 0.0).map(f64::ln);
        let (lo, hi) = ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), log| (lo.min(log), hi.max(log)));
        Self(lo, hi)
    }

    /// An interval on it; nothing where it has no length.
    fn range(&self, ends: [f64; 2], value: f64) -> Option<String> {
        let at = |kg: f64| ((kg.ln() - self.0) / (self.1 - self.0)).clamp(0.0, 1.0);
        (self.1 > self.0).then(|| bar(at(ends[0]), at(ends[1]), at(value)))
    }
}

/// A strip from 0 to 1 with an interval and a value.
fn bar(low: f64, high: f64, value: f64) -> String {
    let percent = |share: f64| format!("{:.1}%", 100.0 * share);
    format!(
        "<span class=\"range\"><i style=\"left:{};width:{}\"></i><b style=\"left:{}\"></b></span>",
        percent(low),
        percent(high - low),
        percent(value)
    )
}

/// Address of a twin's own report as seen from `folder`, where there is one.
fn report_of(item: &Item, folder: &Path) -> Option<String> {
    let Task::Twin(twin) = &item.task else { return None };
    let report = twin.join("report.html");
    let path = fsutil::relative_path(&report, folder);
    (report.is_file() && path.is_relative()).then(|| address(&path.to_string_lossy()))
}

/// A relative path as an address: bytes that mean something else there are written as %XX.
fn address(path: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._~/".contains(&b);
    path.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}
