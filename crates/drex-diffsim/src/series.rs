//! Checks of sampled data.

use crate::{Error, Result};

/// One value per time, times that increase.
pub(crate) fn check_series(what: &str, times_s: &[f64], values: usize) -> Result<()> {
    if times_s.is_empty() || times_s.len() != values {
        return Err(Error::Series {
            what: format!("{what}: {} times but {values} values", times_s.len()),
            remedy: "give one value per time, at least one".into(),
        });
    }
    if let Some(i) = (1..times_s.len()).find(|&i| times_s[i].is_nan() || times_s[i] <= times_s[i - 1]) {
        return Err(Error::Series {
            what: format!("{what}: time {i} ({} s) is not after the one before", times_s[i]),
            remedy: "sort the samples by time and drop repeated ones".into(),
        });
    }
    if !(times_s[0].is_finite() && times_s[times_s.len() - 1].is_finite()) {
        return Err(Error::NotFinite { what: format!("a time of the {what}") });
    }
    Ok(())
}
