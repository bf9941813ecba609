//! Why photos have no cameras, in one sentence with a remedy.

use std::fmt;

/// Why there is no model.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// What kind of cause.
    pub cause: Cause,
    /// What was seen, with numbers and names of photos.
    pub what: String,
    /// What to do.
    pub remedy: String,
}

/// The causes that are told apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Cause {
    /// There are no photos, or too few of them can be read.
    TooFewPhotos,
    /// An option or a file that was named cannot be used.
    Input,
    /// The photos are smeared or out of focus.
    Blur,
    /// Too little texture, or gloss and glass: few points on what the photos (or the masks) show.
    TooFewPoints,
    /// The photos show different places.
    NoOverlap,
    /// The camera turned about its centre: nothing has a distance.
    OnlyTurned,
    /// A pattern that repeats: photos match in ways that contradict each other.
    Repeating,
    /// A model was found that contradicts itself.
    Inconsistent,
}

impl Verdict {
    pub(crate) fn new(cause: Cause, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { cause, what: what.into(), remedy: remedy.into() }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.remedy)
    }
}

impl std::error::Error for Verdict {}

/// Some names, and how many more there are.
pub(crate) fn list(names: &[&str]) -> String {
    const MOST: usize = 8;
    match names.len() {
        0 => "none".into(),
        n if n <= MOST => names.join(", "),
        n => format!("{} and {} more", names[..MOST].join(", "), n - MOST),
    }
}

/// "1 photo", "2 photos".
pub(crate) fn count(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}
