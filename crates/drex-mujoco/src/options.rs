//! Settings of MuJoCo that a model of ours does not have.

use crate::{Error, Result};

/// How MuJoCo moves velocities forward.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Integrator {
    /// Semi-implicit Euler, implicit in joint damping.
    Euler,
    /// Implicit in all forces that depend on velocity but for Coriolis terms.
    ImplicitFast,
    /// Implicit in all of them.
    #[default]
    Implicit,
}

impl Integrator {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Euler => "Euler",
            Self::ImplicitFast => "implicitfast",
            Self::Implicit => "implicit",
        }
    }
}

/// Settings of MuJoCo that a model of ours does not have. The defaults are for judging: stiff contact, elliptic cones
/// and the solver pass that removes creep.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MjcfOptions {
    /// Time step, seconds; `None` takes the model's.
    pub dt_s: Option<f64>,
    /// Integrator.
    pub integrator: Integrator,
    /// Elliptic friction cones; pyramids otherwise.
    pub elliptic: bool,
    /// How much stiffer friction is than normal force. Contacts creep in proportion to its inverse.
    pub impratio: f64,
    /// Passes of the solver that takes the softness of friction away; 0 leaves MuJoCo's convex problem as it is.
    pub noslip_iterations: u32,
    /// Time constant of contact, seconds, at least two steps; `None` takes four, stiff without bouncing.
    pub contact_time_s: Option<f64>,
    /// Damping ratio of contact.
    pub damping_ratio: f64,
    /// Impedance of contact: at zero depth, at full depth, and the depth that counts as full, metres.
    pub impedance: [f64; 3],
    /// Several points per pair of convex shapes, so that faces rest on faces.
    pub multiccd: bool,
    /// Bound on the iterations of the solver.
    pub iterations: u32,
    /// Improvement, scaled, below which the solver stops.
    pub tolerance: f64,
}

impl Default for MjcfOptions {
    fn default() -> Self {
        Self {
            dt_s: None,
            integrator: Integrator::default(),
            elliptic: true,
            impratio: 10.0,
            noslip_iterations: 3,
            contact_time_s: None,
            damping_ratio: 1.0,
            impedance: [0.9, 0.95, 1e-3],
            multiccd: true,
            iterations: 100,
            tolerance: 1e-10,
        }
    }
}

impl MjcfOptions {
    /// The time step for a model whose own is `model_dt_s`.
    pub(crate) fn step_s(&self, model_dt_s: f64) -> f64 {
        self.dt_s.unwrap_or(model_dt_s)
    }

    /// The time constant of contact at a step.
    pub(crate) fn contact_s(&self, dt_s: f64) -> f64 {
        self.contact_time_s.unwrap_or(4.0 * dt_s)
    }

    /// Refuses what MuJoCo would change without a word.
    pub(crate) fn check(&self, model_dt_s: f64) -> Result<()> {
        let dt_s = self.step_s(model_dt_s);
        let positive = |x: f64| x > 0.0 && x.is_finite();
        let [lowest, highest, width] = self.impedance;
        let demands = [
            (positive(dt_s), "the time step is not a positive number"),
            (positive(self.impratio), "impratio is not a positive number"),
            (positive(self.damping_ratio), "damping_ratio is not a positive number"),
            (lowest > 0.0 && lowest <= highest && highest < 1.0, "impedance is not 0 < first <= full < 1"),
            (positive(width), "the depth of full impedance is not a positive number"),
            (self.contact_s(dt_s) >= 2.0 * dt_s, "contact_time_s is less than two steps"),
            (self.tolerance >= 0.0, "tolerance is negative or no number"),
        ];
        match demands.iter().find(|(met, _)| !met) {
            Some((_, what)) => Err(Error::Options { what }),
            None => Ok(()),
        }
    }
}
