//! Limits over time: no steps, and less for a hot motor.

use super::limits::same_length;
use super::model::finite;
use crate::{Error, Result};

/// How fast limits change and what temperature takes from them.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RampOptions {
    /// A limit rises at most this fast, mA/s.
    pub rise_ma_per_s: f64,
    /// A limit falls at most this fast, mA/s.
    pub fall_ma_per_s: f64,
    /// No limit is above this, mA; a hot motor gets less.
    pub cap_ma: f64,
    /// What is left for a motor at [`RampOptions::derate_to_c`], mA: enough to hold its place.
    pub floor_ma: f64,
    /// Up to this temperature a motor may have the whole cap, °C.
    pub derate_from_c: f64,
    /// From this temperature on it may have only the floor, °C; in between the cap falls in a line.
    pub derate_to_c: f64,
}

impl Default for RampOptions {
    /// 1 A/s up, 2 A/s down, 20 to 300 mA, from 55 to 68 °C: LEAP's motors switch off at 70 °C.
    fn default() -> Self {
        Self {
            rise_ma_per_s: 1000.0,
            fall_ma_per_s: 2000.0,
            cap_ma: 300.0,
            floor_ma: 20.0,
            derate_from_c: 55.0,
            derate_to_c: 68.0,
        }
    }
}

/// The limits of the joints as they move towards what is wanted.
#[derive(Debug, Clone)]
pub struct LimitRamp {
    options: RampOptions,
    now_ma: Vec<f64>,
}

impl LimitRamp {
    /// Begins with all limits of `joints` joints at the floor.
    ///
    /// # Errors
    /// [`Error::Value`] for an option that means nothing.
    pub fn new(joints: usize, options: RampOptions) -> Result<Self> {
        let o = &options;
        let demands = [
            ("rise_ma_per_s", o.rise_ma_per_s, o.rise_ma_per_s > 0.0),
            ("fall_ma_per_s", o.fall_ma_per_s, o.fall_ma_per_s > 0.0),
            ("floor_ma", o.floor_ma, o.floor_ma >= 0.0),
            ("cap_ma", o.cap_ma, o.cap_ma >= o.floor_ma),
            ("derate_from_c", o.derate_from_c, true),
            ("derate_to_c", o.derate_to_c, o.derate_to_c > o.derate_from_c),
        ];
        if let Some((name, value, _)) = demands.into_iter().find(|(_, value, met)| !(*met && value.is_finite())) {
            return Err(Error::value(
                format!("ramp option {name} is {value}"),
                "give speeds above zero, a floor of 0 to the cap, and an end of derating above its begin",
            ));
        }
        let now_ma = vec![options.floor_ma; joints];
        Ok(Self { options, now_ma })
    }

    /// Limits, mA, after `dt_s` seconds on the way to `targets_ma`, for motors at `temperatures_c`, °C. Allocates nothing.
    ///
    /// # Errors
    /// [`Error::Value`] for numbers that are not finite, a negative time or limit, or lists of wrong length; the limits then stay as they were.
    pub fn step(&mut self, targets_ma: &[f64], temperatures_c: &[f64], dt_s: f64) -> Result<&[f64]> {
        same_length("limits", self.now_ma.len(), "targets", targets_ma.len())?;
        same_length("limits", self.now_ma.len(), "temperatures", temperatures_c.len())?;
        temperatures_c.iter().try_for_each(|t| finite(*t, "°C"))?;
        let allowed = |x: f64| x >= 0.0 && x.is_finite();
        if let Some(bad) = targets_ma.iter().chain([&dt_s]).find(|x| !allowed(**x)) {
            return Err(Error::value(format!("a limit or time step of {bad}"), "give zero or more"));
        }
        let o = &self.options;
        for ((now, target), celsius) in self.now_ma.iter_mut().zip(targets_ma).zip(temperatures_c) {
            let cool = ((o.derate_to_c - celsius) / (o.derate_to_c - o.derate_from_c)).clamp(0.0, 1.0);
            let cap = o.floor_ma + cool * (o.cap_ma - o.floor_ma);
            // Heat acts at once: only what is wanted is ramped.
            *now = target.clamp(*now - o.fall_ma_per_s * dt_s, *now + o.rise_ma_per_s * dt_s).clamp(0.0, cap);
        }
        Ok(&self.now_ma)
    }

    /// The limits as they are, mA.
    pub fn limits_ma(&self) -> &[f64] {
        &self.now_ma
    }
}
