//! The page of a batch: what failed, what stands out, how values are distributed, and a card for each item.

mod gallery;
mod measures;
mod outliers;
mod thumbnails;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use drex_core::fsutil;
use drex_core::stats::median;
use drex_trial::wilson;
use drex_twin::batch::{Batch, RESULTS, RUNS, Status, Table};

use self::measures::{Measured, digits, duration, grams, items_text, percent_between, pooled, positive};
use self::outliers::{FEWEST, LEAST_SPREAD, Outliers, Quantity};
use crate::Result;
use crate::page::Page;
use crate::picture::histogram::{binned, bins, log_bins};
use crate::picture::plot::{Bar, Plot, escape};

/// Name of the page in the folder of a batch.
const PAGE: &str = "report.html";
/// With more failures than these, those with the same reason are told together.
const MOST_ALONE: usize = 20;
/// Reasons of failures that are told, the most frequent first, and names for each.
const MOST_REASONS: usize = 100;
const MOST_NAMES: usize = 100;
/// Values whose largest is more than this many times the smallest are drawn on a logarithmic axis.
const WIDE: f64 = 8.0;

/// Writes `report.html` into the folder of the batch's results, and names it: figures, failures with their reasons, items that stand out,
/// histograms, and a card for each item with a picture of its mesh and a link to the twin's own report where there is one. `table` is what
/// [`Batch::table`] gives. Apart from what runs took, the page depends on the table and the twins alone.
///
/// # Errors
/// If the page cannot be written. A mesh that is missing or damaged has no picture.
pub fn write_batch(batch: &Batch, table: &Table) -> Result<PathBuf> {
    let path = fsutil::output_path(batch.out(), PAGE)?;
    fsutil::write_atomic(&path, page(batch, table).as_bytes())?;
    Ok(path)
}

fn page(batch: &Batch, table: &Table) -> String {
    let items = Measured::all(table);
    let outliers = outliers::find(&items);
    let mut page = Page::new(&format!("Batch of {}", items_text(items.len())));
    figures(&mut page, table, &items);
    let order = gallery::order(&items, &outliers);
    let with_card: BTreeSet<usize> = order.iter().copied().collect();
    failures(&mut page, &items, &with_card);
    standing_out(&mut page, &items, &outliers, &with_card);
    distributions(&mut page, &items);
    gallery::section(&mut page, batch, &items, &outliers, &order);
    provenance(&mut page, batch, &items);
    page.to_html()
}

/// The row of figures at the head of the page.
fn figures(page: &mut Page, table: &Table, items: &[Measured<'_>]) {
    let count = |status| items.iter().filter(|i| i.row.status == status).count();
    let [done, failed, pending] = [Status::Done, Status::Failed, Status::Pending].map(count);
    let mut all = vec![(
        format!("{done} of {}", items.len()),
        "items done".to_owned(),
        format!("{failed} failed, {pending} pending"),
    )];

    let runs = || table.runs.values().map(|(_, run)| run);
    let core_seconds: Vec<f64> = runs().filter_map(|run| positive(run.core_seconds)).collect();
    let hosts: BTreeSet<&str> = runs().map(|run| run.host.as_str()).collect();
    let wall: f64 = runs().filter_map(|run| positive(Some(run.seconds))).sum();
    let last = match table.runs.len() {
        0 => "nothing has run".to_owned(),
        n => format!(
            "last runs of {}: {} one after the other, on {} machine{}",
            items_text(n),
            duration(wall),
            hosts.len(),
            if hosts.len() == 1 { "" } else { "s" }
        ),
    };
    let total: f64 = core_seconds.iter().sum();
    let total = if core_seconds.is_empty() { "-".to_owned() } else { digits(total) };
    all.push((total, "core-seconds".to_owned(), last));

    let widths: Vec<f64> = items.iter().filter_map(|i| i.relative_width).collect();
    let mut verdicts: BTreeMap<String, usize> = BTreeMap::new();
    for item in items.iter().filter(|i| !i.row.verdict.is_empty()) {
        *verdicts.entry(item.row.verdict.replace('_', " ")).or_default() += 1;
    }
    let verdicts: Vec<String> = verdicts.into_iter().map(|(verdict, n)| format!("{n} {verdict}")).collect();
    all.push((
        median(widths.iter().copied()).map_or("-".to_owned(), |w| format!("{} %", digits(100.0 * w))),
        "width of the mass interval (median)".to_owned(),
        format!("95 % interval, of the mass; {} with one; {}", items_text(widths.len()), verdicts.join(", "))
            .trim_end_matches("; ")
            .to_owned(),
    ));

    let [held, trials] = pooled(items);
    let rate = wilson(held, trials);
    let (value, remark) = if trials == 0 {
        ("-".to_owned(), "no item was tried".to_owned())
    } else {
        let interval = percent_between(rate.low, rate.high);
        (format!("{held} of {trials}"), format!("{:.1} %; 95 % interval {interval}", 100.0 * rate.value))
    };
    all.push((value, "simulated trials that held".to_owned(), remark));
    page.figures(&all);
}

/// The name of an item, as a link to its card where it has one.
fn card_link(index: usize, name: &str, with_card: &BTreeSet<usize>) -> String {
    let name = gallery::name_html(name);
    if with_card.contains(&index) { format!("<a href=\"#i{index}\">{name}</a>") } else { name }
}

/// What failed, and why.
fn failures(page: &mut Page, items: &[Measured<'_>], with_card: &BTreeSet<usize>) {
    page.section("Failures");
    let failed: Vec<(usize, &Measured<'_>)> =
        items.iter().enumerate().filter(|(_, i)| i.row.status == Status::Failed).collect();
    if failed.is_empty() {
        page.paragraph("No item failed.");
        return;
    }
    page.paragraph(&format!(
        "{} of {} failed. drex batch --retry-failed tries them again.",
        failed.len(),
        items_text(items.len())
    ));
    if failed.len() <= MOST_ALONE {
        let row = |(i, item): &(usize, &Measured<'_>)| {
            vec![card_link(*i, &item.row.name, with_card), escape(&item.row.error)]
        };
        page.table_of_html(&["item", "why it failed"], &failed.iter().map(row).collect::<Vec<_>>());
        return;
    }
    let mut reasons: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (i, item) in failed {
        let reason = without_name(&item.row.error, &item.row.name);
        reasons.entry(reason).or_default().push(card_link(i, &item.row.name, with_card));
    }
    let mut reasons: Vec<_> = reasons.into_iter().collect();
    reasons.sort_by_key(|(_, names)| std::cmp::Reverse(names.len()));
    if reasons.len() > MOST_REASONS {
        page.paragraph(&format!("The {MOST_REASONS} most frequent of {} reasons; {RESULTS} has all.", reasons.len()));
    }
    let row = |(reason, names): (String, Vec<String>)| {
        let more = names.len().saturating_sub(MOST_NAMES);
        let more = if more > 0 { format!(" and {more} more, which {RESULTS} names") } else { String::new() };
        vec![names.len().to_string(), escape(&reason), names[..names.len().min(MOST_NAMES)].join(", ") + &more]
    };
    let rows: Vec<_> = reasons.into_iter().take(MOST_REASONS).map(row).collect();
    page.table_of_html(&["items", "why they failed", "which"], &rows);
}

/// A reason with NAME in place of the item's name, so that the same reason reads the same for all items.
fn without_name(reason: &str, name: &str) -> String {
    let mut out = String::new();
    let mut rest = reason;
    while let Some((before, after)) = rest.split_once(name).filter(|_| !name.is_empty()) {
        let inside = |c: char| c.is_alphanumeric() || "/_-.".contains(c);
        let whole = !before.ends_with(inside) && !after.starts_with(|c: char| c != '/' && inside(c));
        out += before;
        out += if whole { "NAME" } else { name };
        rest = after;
    }
    out + rest
}

/// What stands out.
fn standing_out(page: &mut Page, items: &[Measured<'_>], outliers: &Outliers, with_card: &BTreeSet<usize>) {
    page.section("Outliers");
    let few = |(task, quantity, n): &(String, Quantity, usize)| {
        format!("{}: too few to tell, only {} of the task \"{task}\" with a value", quantity.name(), items_text(*n))
    };
    if outliers.compared.is_empty() {
        page.paragraph(&format!(
            "Too few items to tell what is usual: it takes {FEWEST} of the same task that are done."
        ));
    } else if outliers.found.is_empty() {
        let names: Vec<&str> = outliers.compared.iter().map(|q| q.name()).collect();
        page.paragraph(&format!("No item stands out in {}.", names.join(", ")));
    } else {
        let row = |o: &outliers::Outlier| {
            let name = card_link(o.row, &items[o.row].row.name, with_card);
            let host = match (o.quantity, items[o.row].run) {
                (Quantity::Seconds, Some(run)) => {
                    format!(" on {}, {} thread{}", run.host, run.threads, if run.threads == 1 { "" } else { "s" })
                }
                _ => String::new(),
            };
            [o.quantity.name(), &(o.value.clone() + &host), &o.usual, &o.distance].iter().fold(
                vec![name],
                |mut row, text| {
                    row.push(escape(text));
                    row
                },
            )
        };
        page.table_of_html(
            &["item", "stands out in", "value", "usual", "by how much"],
            &outliers.found.iter().map(row).collect::<Vec<_>>(),
        );
    }
    page.list(&outliers.too_few.iter().map(few).collect::<Vec<_>>());
    if !outliers.compared.is_empty() {
        page.paragraph(&format!(
            "Compared are items of the same task. An item stands out in the width of its mass interval, its grip force per weight or (only \
             upwards) its seconds if the logarithm lies more than 5 + 30/n spreads from the median of n items, which is {:.1} spreads for \
             {FEWEST} items and {:.1} for {}; a spread is 1.4826 times the median distance from the median, and at least {:.0} %. It stands \
             out in its success rate if the 95 % interval (Wilson) lies below the rate of all, and lies so low by chance in fewer than 1 of \
             100 batches of n like items (Fisher's exact test).",
            outliers::threshold(FEWEST),
            outliers::threshold(items.len().max(FEWEST)),
            items.len().max(FEWEST),
            100.0 * LEAST_SPREAD
        ));
    }
}

/// A histogram of what the items have of a value.
struct Histogram<'a> {
    title: &'a str,
    /// What is on the axis, with its unit.
    label: &'a str,
    values: Vec<f64>,
    /// The middle one as it is written.
    text: fn(f64) -> String,
    axis: Axis,
}

/// How values lie on an axis.
#[derive(PartialEq)]
enum Axis {
    /// Logarithmically.
    Log,
    /// Logarithmically where they are far apart.
    AsTheyAre,
    /// From 0 to 100.
    Percent,
}

impl Histogram<'_> {
    /// The plot; `None` without values.
    fn to_svg(&self) -> Option<String> {
        let middle = median(self.values.iter().copied())?;
        let (lo, hi) = self.values.iter().fold((f64::MAX, 0.0_f64), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
        let log_x = self.axis == Axis::Log || self.axis == Axis::AsTheyAre && hi > WIDE * lo;
        let bars: Vec<Bar> = match self.axis {
            Axis::Percent => binned(&self.values, 0.0, 5.0, 20),
            _ if log_x => log_bins(&self.values),
            _ => bins(&self.values),
        };
        let marks = vec![(middle, format!("median {}", (self.text)(middle)))];
        let x_label = if log_x { format!("{} (logarithmic)", self.label) } else { self.label.to_owned() };
        let plot =
            Plot { title: self.title, x_label: &x_label, y_label: "items", bars, log_x, marks, ..Plot::default() };
        Some(plot.to_svg())
    }
}

/// How the values of the items are distributed.
fn distributions(page: &mut Page, items: &[Measured<'_>]) {
    page.section("Distributions");
    let values = |value: &dyn Fn(&Measured<'_>) -> Option<f64>| items.iter().filter_map(value).collect();
    let of = |title, label, values, text, axis| Histogram { title, label, values, text, axis };
    let percent = |v: f64| format!("{} %", digits(v));
    let plots = [
        of(
            "Mass",
            "mass, g",
            values(&|i| Some(1e3 * i.mass_kg?)),
            (|g| grams(1e-3 * g)) as fn(f64) -> String,
            Axis::Log,
        ),
        of(
            "Width of the mass interval",
            "width of the 95 % interval, % of the mass",
            values(&|i| Some(100.0 * i.relative_width?)),
            percent,
            Axis::AsTheyAre,
        ),
        of("Grip force", "grip force, N", values(&|i| i.grip_force_n), |n| format!("{} N", digits(n)), Axis::AsTheyAre),
        of("Success rate", "trials that held, %", values(&|i| Some(100.0 * i.success_rate()?)), percent, Axis::Percent),
        of("Seconds", "wall time, s", values(&|i| i.seconds), duration, Axis::AsTheyAre),
    ];
    let plots: Vec<String> = plots.iter().filter_map(Histogram::to_svg).collect();
    if plots.is_empty() {
        page.paragraph("No item has a value to draw.");
    }
    page.plots(&plots);
}

/// Where the numbers are, and who made them.
fn provenance(page: &mut Page, batch: &Batch, items: &[Measured<'_>]) {
    page.section("How this was made");
    let files: Vec<&str> = [RESULTS, RUNS].into_iter().filter(|file| batch.out().join(file).is_file()).collect();
    let mut lines: Vec<String> = Vec::new();
    if !files.is_empty() {
        lines.push(format!("All numbers are in {}, beside this page.", files.join(" and ")));
    }
    let programs: BTreeSet<&str> = items.iter().map(|i| i.row.program.as_str()).collect();
    let programs: Vec<&str> = programs.into_iter().collect();
    if !programs.is_empty() {
        lines.push(format!("Made by {}.", programs.join(", ")));
    }
    if programs.len() > 1 {
        lines.push("Items of different versions are not comparable in every number.".to_owned());
    }
    page.list(&lines);
}

#[cfg(test)]
mod tests;
