//! How much a gearbox keeps back on the way up and on the way down.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Half of the difference between letting go and pressing harder at the same current: `offset_nm + share · τ`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hysteresis {
    /// Part that does not depend on the load, N m.
    pub offset_nm: f64,
    /// Part of the load.
    pub share: f64,
}

impl Hysteresis {
    /// Half of the width at a torque, N m.
    pub fn half_width_nm(&self, torque_nm: f64) -> f64 {
        self.offset_nm + self.share * torque_nm.abs()
    }

    pub(super) fn check(&self) -> Result<()> {
        match [self.offset_nm, self.share].iter().all(|x| x.is_finite() && *x >= 0.0) {
            true => Ok(()),
            false => Err(Error::value(
                format!("a hysteresis of {} N m and {} of the load", self.offset_nm, self.share),
                "give zero or more",
            )),
        }
    }

    /// From the signed half widths of pairs at their torques: least squares with both parts at least zero; `None` without
    /// pairs.
    pub(super) fn from_half_widths(pairs: &[(f64, f64)]) -> Option<Self> {
        if pairs.is_empty() {
            return None;
        }
        let sum = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
        let (n, st, sh) = (pairs.len() as f64, sum(&|p| p.0), sum(&|p| p.1));
        let (stt, sth) = (sum(&|p| p.0 * p.0), sum(&|p| p.0 * p.1));
        let det = n * stt - st * st;
        let both = (det > 1e-9 * n * stt).then(|| ((sh * stt - sth * st) / det, (n * sth - st * sh) / det));
        let (offset_nm, share) = match both {
            Some((offset, share)) if offset >= 0.0 && share >= 0.0 => (offset, share),
            Some((offset, _)) if offset < 0.0 => (0.0, (sth / stt).max(0.0)),
            _ => ((sh / n).max(0.0), 0.0),
        };
        Some(Self { offset_nm, share })
    }
}
