//! Controls of actuators over time.

use crate::series::check_series;
use crate::{Error, Result};

/// Controls of the actuators of one articulation, in the order of its actuators; each row holds until the next.
#[derive(Debug, Clone, PartialEq)]
pub struct Control {
    times_s: Vec<f64>,
    rows: Vec<Vec<f64>>,
}

impl Control {
    /// The same controls for all time.
    ///
    /// # Errors
    /// If a number is not finite.
    pub fn constant(values: &[f64]) -> Result<Self> {
        Self::sampled(&[0.0], vec![values.to_vec()])
    }

    /// Rows that hold from their time to the next; the first also holds before.
    ///
    /// # Errors
    /// If the numbers of samples differ, times do not increase, rows differ in length or a number is not finite.
    pub fn sampled(times_s: &[f64], rows: Vec<Vec<f64>>) -> Result<Self> {
        check_series("control", times_s, rows.len())?;
        if let Some(i) = rows.iter().position(|r| r.len() != rows[0].len()) {
            return Err(Error::Series {
                what: format!("control row {i} has {} values, the first {}", rows[i].len(), rows[0].len()),
                remedy: "give one value per actuator in every row".into(),
            });
        }
        for (i, row) in rows.iter().enumerate() {
            if let Some(j) = row.iter().position(|x| !x.is_finite()) {
                return Err(Error::NotFinite { what: format!("control {j} of row {i} (t = {} s)", times_s[i]) });
            }
        }
        Ok(Self { times_s: times_s.to_vec(), rows })
    }

    /// The controls at time t.
    pub fn at(&self, t: f64) -> &[f64] {
        let k = self.times_s.partition_point(|&s| s <= t + 1e-12);
        &self.rows[k.saturating_sub(1)]
    }
}
