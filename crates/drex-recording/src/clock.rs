//! Clocks: what the time stamps of a file count, and how two recordings are brought to one time.
//!
//! A stamp is always turned into seconds. Files of one recording share a clock or say how theirs differs:
//! `common time = file time + offset_s`, with the offset an explicit number.

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::Offset;
use serde::{Deserialize, Serialize};

use drex_core::{Error, Result};

/// What the stamps of a file count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
#[non_exhaustive]
pub enum Clock {
    /// Seconds since 1970-01-01 UTC.
    Unix,
    /// ISO 8601 date and time of day without a zone, at a fixed offset from UTC.
    LocalIso {
        /// Local time minus UTC, minutes (UTC-07:00 is -420).
        utc_offset_minutes: i32,
    },
    /// Seconds since a start that only this recording knows.
    Relative,
}

impl Clock {
    /// Seconds of the stamp `text` on this clock: since 1970 for [`Clock::Unix`] and [`Clock::LocalIso`], as written
    /// for [`Clock::Relative`]. An ISO stamp that carries its own zone (`Z`, `-07:00`) keeps it.
    ///
    /// # Errors
    /// If the text is no stamp of this clock, or no finite number.
    pub fn parse(&self, text: &str) -> Result<f64> {
        let text = text.trim();
        match self {
            Self::Unix | Self::Relative => match text.parse::<f64>() {
                Ok(t) if t.is_finite() => Ok(t),
                _ => Err(Error::value(
                    format!("`{text}` is not a time in seconds"),
                    "give seconds, or name the clock that the stamps come from",
                )),
            },
            Self::LocalIso { utc_offset_minutes } => parse_iso(text, *utc_offset_minutes),
        }
    }

    /// Whether stamps become seconds since 1970, so that files with such clocks need no offset between them.
    pub fn is_absolute(&self) -> bool {
        !matches!(self, Self::Relative)
    }
}

/// Seconds since 1970 of an ISO 8601 stamp; `utc_offset_minutes` applies where the stamp itself names no zone.
///
/// # Errors
/// If the text is not such a stamp or the offset is beyond ±24 h.
pub fn parse_iso(text: &str, utc_offset_minutes: i32) -> Result<f64> {
    let timestamp = match text.parse::<Timestamp>() {
        Ok(t) => t,
        Err(_) => {
            let local: DateTime = text.parse().map_err(|_| {
                Error::value(
                    format!("`{text}` is not an ISO 8601 date and time"),
                    "write stamps like 2025-04-17T18:59:37.970819",
                )
            })?;
            let offset =
                utc_offset_minutes.checked_mul(60).and_then(|s| Offset::from_seconds(s).ok()).ok_or_else(|| {
                    Error::value(
                        format!("a UTC offset of {utc_offset_minutes} min is beyond a day"),
                        "give local time minus UTC, such as -07:00",
                    )
                })?;
            offset
                .to_timestamp(local)
                .map_err(|_| Error::value(format!("`{text}` is outside the calendar"), "check the stamp"))?
        }
    };
    Ok(timestamp.as_second() as f64 + f64::from(timestamp.subsec_nanosecond()) * 1e-9)
}

/// Minutes of a UTC offset such as `-07:00`, `+0530`, `UTC-7`, `Z`; leading words are skipped up to `UTC` or the sign.
///
/// # Errors
/// If there is no offset in the text or it is beyond ±18 h.
pub fn parse_utc_offset(text: &str) -> Result<i32> {
    let refuse = || {
        Error::value(format!("`{text}` names no UTC offset"), "write local time minus UTC as ±hh:mm, such as -07:00")
    };
    let tail = text.rsplit_once("UTC").map_or(text, |(_, tail)| tail).trim();
    if matches!(tail, "Z" | "z") || (tail.is_empty() && text.contains("UTC")) {
        return Ok(0);
    }
    let (sign, digits) = match tail.strip_prefix('-').or_else(|| tail.strip_prefix('\u{2212}')) {
        Some(rest) => (-1, rest),
        None => (1, tail.strip_prefix('+').ok_or_else(refuse)?),
    };
    let (hours, minutes) = match digits.split_once(':') {
        Some((h, m)) => (h, m),
        None if digits.len() == 4 && digits.is_ascii() => digits.split_at(2),
        None => (digits, "0"),
    };
    let (h, m): (i32, i32) = (hours.parse().map_err(|_| refuse())?, minutes.parse().map_err(|_| refuse())?);
    if !(0..=18).contains(&h) || !(0..60).contains(&m) {
        return Err(refuse());
    }
    Ok(sign * (60 * h + m))
}

/// `-07:00` for -420 minutes.
pub fn format_utc_offset(minutes: i32) -> String {
    let sign = if minutes < 0 { '-' } else { '+' };
    format!("{sign}{:02}:{:02}", minutes.unsigned_abs() / 60, minutes.unsigned_abs() % 60)
}

/// A named time span, seconds, for messages about two recordings that should meet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span<'a> {
    /// What it is the span of ("pose track").
    pub what: &'a str,
    /// First time.
    pub first_s: f64,
    /// Last time.
    pub last_s: f64,
}

/// The time that two spans share, as (first, last).
///
/// # Errors
/// If they share none: the message gives both spans, the gap, and what to check.
pub fn overlap(a: Span<'_>, b: Span<'_>) -> Result<(f64, f64)> {
    let (first, last) = (a.first_s.max(b.first_s), a.last_s.min(b.last_s));
    if first <= last {
        return Ok((first, last));
    }
    let gap = first - last;
    let hint = if (gap / 900.0).round() >= 1.0 && (gap % 900.0 < 120.0 || gap % 900.0 > 780.0) {
        " (near a multiple of a quarter hour: a wrong time zone looks like this)"
    } else {
        ""
    };
    Err(Error::value(
        format!(
            "the {} ({:.3} to {:.3} s) and the {} ({:.3} to {:.3} s) do not overlap: {gap:.3} s lie between them{hint}",
            a.what, a.first_s, a.last_s, b.what, b.first_s, b.last_s
        ),
        "check that both files are of the same run, and the clock, time zone and offset given for each",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn local_time_is_brought_to_unix_seconds() {
        // 2025-04-18T01:59:37.970819Z, by `date -d`.
        let t = Clock::LocalIso { utc_offset_minutes: -420 }.parse("2025-04-17T18:59:37.970819").unwrap();
        assert!((t - 1_744_941_577.970_819).abs() < 1e-6, "{t}");
        assert!((parse_iso("2025-04-17T18:59:37.970819-07:00", 0).unwrap() - t).abs() < 1e-6);
        assert!((parse_iso("2025-04-18T01:59:37.970819Z", -420).unwrap() - t).abs() < 1e-6);
    }

    #[test]
    fn offsets_are_read_in_the_usual_spellings() {
        for (text, minutes) in
            [("local time, UTC-07:00", -420), ("-07:00", -420), ("+0530", 330), ("UTC", 0), ("UTC+2", 120), ("Z", 0)]
        {
            assert_eq!(parse_utc_offset(text).unwrap(), minutes, "{text}");
        }
        for text in ["", "local", "7", "-99:00", "UTC-x", "+1:77"] {
            assert!(parse_utc_offset(text).is_err(), "{text}");
        }
        assert_eq!(format_utc_offset(-450), "-07:30");
        assert_eq!(parse_utc_offset(&format_utc_offset(345)).unwrap(), 345);
    }

    #[test]
    fn spans_that_do_not_meet_are_refused_with_the_gap() {
        let a = Span { what: "pose track", first_s: 0.0, last_s: 10.0 };
        let b = Span { what: "joint log", first_s: 25200.0, last_s: 25210.0 };
        let message = overlap(a, b).unwrap_err().to_string();
        assert!(message.contains("25190.000 s") && message.contains("time zone"), "{message}");
        assert_eq!(overlap(a, Span { what: "x", first_s: 4.0, last_s: 90.0 }).unwrap(), (4.0, 10.0));
    }
}
