//! The rules and times of the protocol.

use drex_grasp::GripForcePolicy;

use crate::{Error, Result};

/// Options of a [`Trial`](crate::Trial).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TrialOptions {
    /// How much harder than just enough it grips.
    pub law: GripForcePolicy,
    /// Acceleration of the shakes, m/s².
    pub shake_m_s2: f64,
    /// Time step of both engines, 1e-4 to 0.004 s.
    pub dt_s: f64,
}

impl Default for TrialOptions {
    fn default() -> Self {
        Self { law: GripForcePolicy::default(), shake_m_s2: 0.5 * 9.81, dt_s: 2e-3 }
    }
}

impl TrialOptions {
    pub(crate) fn check(&self) -> Result<()> {
        let demands = [
            ("shake_m_s2", self.shake_m_s2, self.shake_m_s2 >= 0.0),
            ("dt_s", self.dt_s, (1e-4..=0.004).contains(&self.dt_s)),
        ];
        match demands.into_iter().find(|(_, value, met)| !(*met && value.is_finite())) {
            Some((name, value, _)) => {
                Err(Error::value(format!("option {name} is {value}"), "start from TrialOptions::default()"))
            }
            None => Ok(()),
        }
    }
}
