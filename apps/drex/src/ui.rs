//! What the user sees: progress and notes on stderr, the answer on stdout.

use std::io::{IsTerminal, Write};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use drex_twin::Progress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::Serialize;
use tracing_subscriber::filter::LevelFilter;

/// Output settings of one invocation.
#[derive(Debug, Clone)]
pub struct Ui {
    json: bool,
    bars: bool,
    /// The bar of the work at hand.
    bar: Arc<Mutex<Option<ProgressBar>>>,
}

impl Ui {
    /// `json`: the answer is one JSON object. `verbose`: 0 warnings, 1 info, 2 debug.
    pub fn new(json: bool, verbose: u8) -> Self {
        let level = match verbose {
            0 => LevelFilter::WARN,
            1 => LevelFilter::INFO,
            _ => LevelFilter::DEBUG,
        };
        tracing_subscriber::fmt()
            .with_max_level(level)
            .with_target(false)
            .with_ansi(std::io::stderr().is_terminal())
            .without_time()
            .with_writer(std::io::stderr)
            .init();
        Self { json, bars: std::io::stderr().is_terminal(), bar: Arc::default() }
    }

    /// A line about what is going on, on stderr, above the bar of the work at hand.
    pub fn note(&self, text: impl AsRef<str>) {
        match &*self.bar.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(bar) => bar.suspend(|| eprintln!("{}", text.as_ref())),
            None => eprintln!("{}", text.as_ref()),
        }
    }

    /// The answer: `text` for a person, or `value` as one JSON object on stdout.
    pub fn answer(&self, value: &impl Serialize, text: impl AsRef<str>) -> anyhow::Result<()> {
        let line = if self.json { serde_json::to_string(value)? } else { text.as_ref().trim_end().to_owned() };
        // A closed pipe (`drex … | head`) is the reader's decision, not an error of ours.
        let _ = writeln!(std::io::stdout(), "{line}");
        Ok(())
    }

    /// Prints why the command failed: the message and its causes, no backtrace.
    pub fn failed(&self, error: &anyhow::Error) {
        let mut message = error.to_string();
        for cause in error.chain().skip(1).map(ToString::to_string) {
            if !message.contains(&cause) {
                message = format!("{message}: {cause}");
            }
        }
        eprintln!("error: {message}");
        if self.json {
            let _ = writeln!(std::io::stdout(), "{}", serde_json::json!({ "error": message }));
        }
    }

    /// A bar of `length` steps; invisible when stderr is no terminal.
    pub fn bar(&self, label: &str, length: u64) -> ProgressBar {
        // The template is a constant that the tests below parse.
        let style = ProgressStyle::with_template(BAR).unwrap_or_else(|_| ProgressStyle::default_bar());
        ProgressBar::with_draw_target(Some(length), self.target()).with_style(style).with_prefix(label.to_owned())
    }

    /// A spinner for work of unknown length.
    pub fn spinner(&self, label: &str) -> ProgressBar {
        let style = ProgressStyle::with_template(SPINNER).unwrap_or_else(|_| ProgressStyle::default_spinner());
        let bar = ProgressBar::with_draw_target(None, self.target()).with_style(style).with_prefix(label.to_owned());
        bar.enable_steady_tick(Duration::from_millis(120));
        bar
    }

    /// A bar for work of which parts are told; it shows up only once the work has taken a second.
    pub fn slow_bar(&self, label: &str) -> SlowBar {
        SlowBar { bar: self.bar(label, 100), begin: Instant::now() }
    }

    /// Shows this bar in place of the one before.
    fn replace(&self, bar: Option<ProgressBar>) {
        let before = std::mem::replace(&mut *self.bar.lock().unwrap_or_else(PoisonError::into_inner), bar);
        if let Some(before) = before {
            before.finish_and_clear();
        }
    }

    fn with_bar(&self, change: impl FnOnce(&ProgressBar)) {
        if let Some(bar) = &*self.bar.lock().unwrap_or_else(PoisonError::into_inner) {
            change(bar);
        }
    }

    fn target(&self) -> ProgressDrawTarget {
        if self.bars { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() }
    }
}

impl Progress for Ui {
    fn note(&self, text: &str) {
        Self::note(self, text);
    }

    fn begin(&self, label: &str, steps: Option<u64>) {
        let bar = match steps {
            Some(steps) => self.bar(label, steps),
            None => self.spinner(label),
        };
        self.replace(Some(bar));
    }

    fn at(&self, done: u64, message: &str) {
        self.with_bar(|bar| {
            bar.set_position(done);
            bar.set_message(message.to_owned());
        });
    }

    fn step(&self) {
        self.with_bar(|bar| bar.inc(1));
    }

    fn end(&self) {
        self.replace(None);
    }
}

/// See [`Ui::slow_bar`].
pub struct SlowBar {
    bar: ProgressBar,
    begin: Instant,
}

impl SlowBar {
    /// Shows that this part of the work is done, from 0 to 1.
    pub fn show(&self, part: f64) {
        if self.begin.elapsed() > Duration::from_secs(1) {
            self.bar.set_position((100.0 * part) as u64);
        }
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }
}

const BAR: &str = "{prefix:>10} [{bar:32}] {pos}/{len} {msg}";
const SPINNER: &str = "{prefix:>10} {spinner} {elapsed} {msg}";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_parse() {
        assert!(ProgressStyle::with_template(BAR).is_ok());
        assert!(ProgressStyle::with_template(SPINNER).is_ok());
    }
}
