//! Tables of an experiment: as text, CSV and a plot.

use std::path::Path;

use anyhow::Result;
use drex_core::fsutil;
use drex_trial::Interval;
use serde::Serialize;

use super::cell::Row;
use crate::picture::plot::{COLORS, Plot, Series};

/// What an experiment found.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Table {
    pub rows: Vec<Row>,
    pub comparisons: Vec<Comparison>,
    /// What has to be known to read it, one sentence each.
    pub notes: Vec<String>,
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
        let failures: Vec<String> = self.failures.iter().map(|(k, n)| format!("{k} {n}")).collect();
        let percent = |v: f64| 100.0 * v;
        format!(
            "{:52} {:4}/{:<4} {:5.1} % [{:4.1}, {:5.1}]  bound {:5.1} %  {}{}{}",
            labels.join(", "),
            self.successes,
            self.n,
            percent(self.interval.value),
            percent(self.interval.low),
            percent(self.interval.high),
            percent(self.bound),
            self.median_squeeze_n.map_or(String::new(), |n| format!("{n:5.1} N  ")),
            failures.join(", "),
            self.agreement.as_ref().map_or(String::new(), |a| {
                let others: Vec<String> = a.disagreements.iter().map(|(k, n)| format!("; {k} {n}")).collect();
                format!("  engines agree {}/{}{}", a.same, a.n, others.concat())
            })
        )
    }
}

impl Table {
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
        let keys: Vec<&str> = self.rows.first().map(|r| r.labels.keys().copied().collect()).unwrap_or_default();
        let mut csv = keys.join(",") + ",successes,n,rate,low,high,bound,median_squeeze_n,failures\n";
        for r in &self.rows {
            let labels: Vec<String> = keys.iter().map(|k| quoted(r.labels.get(k).map_or("", |v| v))).collect();
            let failures: Vec<String> = r.failures.iter().map(|(k, n)| format!("{k}:{n}")).collect();
            csv += &format!(
                "{},{},{},{},{},{},{},{},{}\n",
                labels.join(","),
                r.successes,
                r.n,
                r.interval.value,
                r.interval.low,
                r.interval.high,
                r.bound,
                r.median_squeeze_n.map_or(String::new(), |n| n.to_string()),
                failures.join(" ")
            );
        }
        csv
    }

    /// Rates with their intervals and bounds, in the order of the rows.
    pub fn svg(&self, title: &str) -> String {
        let x: Vec<f64> = (1..=self.rows.len()).map(|i| i as f64).collect();
        let of = |value: &dyn Fn(&Row) -> f64| self.rows.iter().map(|r| 100.0 * value(r)).collect::<Vec<f64>>();
        let (rate, bound) = (of(&|r| r.interval.value), of(&|r| r.bound));
        // Intervals are strokes: a line from low to high, broken between rows.
        let ends = |v: &f64| [*v, *v, f64::NAN];
        let bars_x: Vec<f64> = x.iter().flat_map(ends).collect();
        let bars_y: Vec<f64> =
            self.rows.iter().flat_map(|r| [100.0 * r.interval.low, 100.0 * r.interval.high, f64::NAN]).collect();
        let series = |label, x, y, color, dots| Series { label, x, y, color, dots };
        let plot = Plot {
            title,
            x_label: "row of the table",
            y_label: "rollouts that hold, %",
            series: vec![
                series("held", &x, &rate, COLORS[0], true),
                series("", &bars_x, &bars_y, COLORS[0], false),
                series("bound", &x, &bound, COLORS[1], true),
            ],
            ..Plot::default()
        };
        plot.to_svg().replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" ", 1)
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

/// A field of a CSV file.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}
