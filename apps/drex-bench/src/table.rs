//! Tables of an experiment: as text, CSV and a plot.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::Result;
use drex_core::fsutil;
use drex_trial::Interval;
use serde::Serialize;

use super::cell::Row;
use drex_report::picture::plot::{COLORS, escape};

/// What an experiment found.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Table {
    pub rows: Vec<Row>,
    pub comparisons: Vec<Comparison>,
    /// What has to be known to read it, one sentence each.
    pub notes: Vec<String>,
    /// How long judging took, s.
    #[serde(skip)]
    pub judging_s: f64,
}

/// Two cells on the same rollouts.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    pub what: String,
    pub difference: Interval,
}

impl Row {
    /// The row as a line of text.
    pub fn text(&self) -> String {
        let labels: Vec<String> = self.labels.iter().map(|(k, v)| format!("{k} {v}")).collect();
        let refused = counted(&self.refusals);
        let percent = |v: f64| 100.0 * v;
        format!(
            "{:52} {:4}/{:<4} {:5.1} % [{:4.1}, {:5.1}]  bound {:5.1} %  {}{}{}{}{}",
            labels.join(", "),
            self.successes,
            self.n,
            percent(self.interval.value),
            percent(self.interval.low),
            percent(self.interval.high),
            percent(self.bound),
            self.median_grip_force_n.map_or(String::new(), |n| format!("{n:5.1} N told, ")),
            self.median_delivered_n.map_or(String::new(), |n| format!("{n:.1} N held  ")),
            if refused.is_empty() { refused } else { format!("no command: {refused}  ") },
            counted(&self.failures),
            self.agreement.as_ref().map_or(String::new(), |a| {
                let others: Vec<String> = a.disagreements.iter().map(|(k, n)| format!("; {k} {n}")).collect();
                format!("  engines agree {}/{}{}", a.same, a.n, others.concat())
            })
        )
    }
}

impl Table {
    /// Rollouts per second of judging.
    pub fn rollouts_per_s(&self) -> f64 {
        self.rows.iter().map(|r| r.n).sum::<usize>() as f64 / self.judging_s.max(1e-9)
    }

    /// For a person.
    pub fn text(&self) -> String {
        let rows = self.rows.iter().map(Row::text);
        let comparisons = self.comparisons.iter().map(|c| {
            let [value, low, high] = [c.difference.value, c.difference.low, c.difference.high].map(|v| 100.0 * v);
            format!("{}: {value:+.1} points [{low:+.1}, {high:+.1}]", c.what)
        });
        rows.chain(comparisons).chain(self.notes.iter().cloned()).collect::<Vec<_>>().join("\n")
    }

    /// One line per row.
    pub fn csv(&self) -> String {
        let keys: BTreeSet<&str> = self.rows.iter().flat_map(|r| r.labels.keys().copied()).collect();
        let keys: Vec<&str> = keys.into_iter().collect();
        let mut csv =
            keys.join(",") + ",successes,n,rate,low,high,bound,median_squeeze_n,median_delivered_n,failures,refusals\n";
        for r in &self.rows {
            let labels: Vec<String> = keys.iter().map(|k| quoted(r.labels.get(k).map_or("", |v| v))).collect();
            let list = |counts: &BTreeMap<String, usize>| {
                counts.iter().map(|(k, n)| format!("{k}:{n}")).collect::<Vec<_>>().join(" ")
            };
            csv += &format!(
                "{},{},{},{},{},{},{},{},{},{},{}\n",
                labels.join(","),
                r.successes,
                r.n,
                r.interval.value,
                r.interval.low,
                r.interval.high,
                r.bound,
                r.median_grip_force_n.map_or(String::new(), |n| n.to_string()),
                r.median_delivered_n.map_or(String::new(), |n| n.to_string()),
                list(&r.failures),
                list(&r.refusals)
            );
        }
        csv
    }

    /// A table of Markdown, then what it comes to, then what has to be known to read it.
    pub fn markdown(&self) -> String {
        let keys: BTreeSet<&str> = self.rows.iter().flat_map(|r| r.labels.keys().copied()).collect();
        let compared = self.rows.iter().any(|r| r.agreement.is_some());
        let mut columns: Vec<&str> = keys.iter().copied().collect();
        columns.extend(["held", "95 %", "no command", "failed", "grip force assumed / delivered", "bound"]);
        columns.extend(compared.then_some("engines agree"));
        let mut lines = vec![markdown_line(&columns), format!("|{}", "---|".repeat(columns.len()))];
        for r in &self.rows {
            let mut cells: Vec<String> = keys.iter().map(|k| r.labels.get(k).cloned().unwrap_or_default()).collect();
            let newtons = |n: Option<f64>| n.map_or("-".to_owned(), |n| format!("{n:.1}"));
            cells.extend([
                format!("{} of {}", r.successes, r.n),
                format!("{} to {} %", percent(r.interval.low), percent(r.interval.high)),
                counted(&r.refusals),
                counted(&r.failures),
                format!("{} / {} N", newtons(r.median_grip_force_n), newtons(r.median_delivered_n)),
                format!("{} %", percent(r.bound)),
            ]);
            cells.extend(r.agreement.as_ref().map(|a| format!("{} of {}", a.same, a.n)));
            lines.push(markdown_line(&cells));
        }
        let mut text = lines.join("\n") + "\n";
        if !self.comparisons.is_empty() {
            text += "\n| difference | points | 95 % |\n|---|---|---|\n";
            for Comparison { what, difference: d } in &self.comparisons {
                let [value, low, high] = [d.value, d.low, d.high].map(|v| format!("{:+.1}", 100.0 * v));
                text += &format!("| {what} | {value} | {low} to {high} |\n");
            }
        }
        for note in &self.notes {
            text += &format!("\n- {note}");
        }
        text + "\n"
    }

    /// A bar per row: the rate with its interval, and the bound as a tick. Colours follow the page.
    pub fn svg(&self, title: &str) -> String {
        const LABEL: f64 = 330.0;
        const BAR: f64 = 300.0;
        const LINE: f64 = 20.0;
        const TOP: f64 = 44.0;
        let x = |share: f64| LABEL + BAR * share;
        let height = TOP + LINE * self.rows.len() as f64 + 12.0;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {height}\" role=\"img\" aria-label=\"{title}\" font-family=\"system-ui,sans-serif\" font-size=\"11\" fill=\"currentColor\">\n<text x=\"8\" y=\"16\" font-size=\"13\">{title}: rollouts that hold, 95 % interval; line: what the hand can hold at all</text>\n",
            LABEL + BAR + 60.0
        );
        for percent in [0, 25, 50, 75, 100] {
            let at = x(f64::from(percent) / 100.0);
            svg += &format!(
                "<text x=\"{at}\" y=\"{}\" text-anchor=\"middle\">{percent} %</text><path d=\"M{at} {TOP}V{height}\" stroke=\"currentColor\" opacity=\".15\"/>\n",
                TOP - 6.0
            );
        }
        for (i, row) in self.rows.iter().enumerate() {
            let middle = TOP + LINE * (i as f64 + 0.5);
            let labels: Vec<String> = row.labels.iter().map(|(k, v)| format!("{k} {v}")).collect();
            let Interval { value, low, high } = row.interval;
            svg += &format!(
                "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text><rect x=\"{LABEL}\" y=\"{}\" width=\"{:.1}\" height=\"10\" fill=\"{}\" opacity=\".7\"/><path d=\"M{:.1} {middle}H{:.1}\" stroke=\"currentColor\"/><path d=\"M{:.1} {}v16\" stroke=\"{}\" stroke-width=\"2\"/><text x=\"{}\" y=\"{}\">{:.0} %</text>\n",
                LABEL - 8.0,
                middle + 4.0,
                escape(&labels.join(", ")),
                middle - 5.0,
                BAR * value,
                COLORS[0],
                x(low),
                x(high),
                x(row.bound),
                middle - 8.0,
                COLORS[1],
                LABEL + BAR + 12.0,
                middle + 4.0,
                100.0 * value
            );
        }
        svg + "</svg>\n"
    }

    /// NAME.csv, NAME.svg and NAME.txt in `out`.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, out: &Path, name: &str) -> Result<()> {
        fsutil::write_atomic(&out.join(format!("{name}.csv")), self.csv().as_bytes())?;
        fsutil::write_atomic(&out.join(format!("{name}.svg")), self.svg(name).as_bytes())?;
        fsutil::write_atomic(&out.join(format!("{name}.txt")), (self.text() + "\n").as_bytes())?;
        Ok(())
    }
}

/// A row of a table of Markdown.
pub fn markdown_line(cells: &[impl AsRef<str>]) -> String {
    cells.iter().fold("|".to_owned(), |line, cell| format!("{line} {} |", cell.as_ref().replace('|', "/")))
}

/// Counts by name, the most frequent first.
pub fn counted(counts: &BTreeMap<String, usize>) -> String {
    let mut counts: Vec<(&String, &usize)> = counts.iter().collect();
    counts.sort_by(|a, b| b.1.cmp(a.1));
    counts.iter().map(|(name, n)| format!("{n} {}", name.replace('_', " "))).collect::<Vec<_>>().join(", ")
}

/// A share with one digit, as per cent.
pub fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

/// A field of a CSV file.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}
