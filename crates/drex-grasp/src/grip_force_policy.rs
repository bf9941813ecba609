//! From contacts and a mass to the force to command.

use crate::loads::{bounded, required};
use crate::{Distribution, GraspError, GripForceError, GripForceProblem, distribute, shake_loads};

/// The force at which the paper's normalised number is one, N.
pub const PAPER_FORCE_LIMIT_N: f64 = 5.0;

/// How much harder than just enough a hand grips, and why.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct GripForcePolicy {
    /// Factor on the grip force required under the loads: covers errors of mass, contact points and joint torques.
    pub margin: f64,
    /// Friction is assumed to be at least the contacts' coefficients times one minus this.
    pub friction_uncertainty: f64,
    /// Accelerations the grasp has to survive, m/s², in every direction; see [`shake_loads`].
    pub shake_m_s2: f64,
    /// Least sum of normal forces, N: a light object is still held firmly enough to know where it is.
    pub floor_n: f64,
    /// Damage limit: largest normal force of one contact, N. The problem's own limit holds as well.
    pub max_contact_n: Option<f64>,
}

impl Default for GripForcePolicy {
    /// Margin 1.25, friction known to 10 %, shakes of half of gravity, at least 1 N in all, no damage limit.
    fn default() -> Self {
        Self { margin: 1.25, friction_uncertainty: 0.1, shake_m_s2: 0.5 * 9.81, floor_n: 1.0, max_contact_n: None }
    }
}

/// The force to command.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ForceCommand {
    /// Sum of the normal forces to command, N.
    pub total_n: f64,
    /// The sum that just survives the loads at the lowest friction assumed, N.
    pub required_n: f64,
    /// Which of [`shake_loads`] asks for it.
    pub binding_load: usize,
    /// Where limits leave less than was wanted: the largest sum, N, with which every load can be carried within torque and
    /// damage limits.
    pub largest_n: Option<f64>,
    /// The margin there is: `total_n` over `required_n`. Less than [`GripForcePolicy::margin`] where the limits leave less, more
    /// where the floor asks for more.
    pub margin: f64,
    /// How the grip force is shared when the object rests, for the lowest friction assumed.
    pub distribution: Distribution,
    /// The same demand as the paper's label, [`paper_force`]; it knows neither friction nor geometry.
    pub paper_force: f64,
}

impl GripForcePolicy {
    /// Share of the true friction cone, if friction is as assumed, that this law's grip force uses at the contact nearest to slipping under
    /// the worst load: (1 − uncertainty) / margin. Forces learned from measured slip aim at it, so as to mean the same.
    pub fn friction_share(&self) -> f64 {
        (1.0 - self.friction_uncertainty) / self.margin
    }

    /// The same with the factor `margin`.
    pub fn with_margin(mut self, margin: f64) -> Self {
        self.margin = margin;
        self
    }

    /// The same with friction known to within the fraction `friction_uncertainty`.
    pub fn with_friction_uncertainty(mut self, friction_uncertainty: f64) -> Self {
        self.friction_uncertainty = friction_uncertainty;
        self
    }

    /// The same for shakes of `shake_m_s2`, m/s².
    pub fn with_shake_m_s2(mut self, shake_m_s2: f64) -> Self {
        self.shake_m_s2 = shake_m_s2;
        self
    }

    /// The same with at least `floor_n` newtons in all.
    pub fn with_floor_n(mut self, floor_n: f64) -> Self {
        self.floor_n = floor_n;
        self
    }

    /// The same with at most `max_contact_n` newtons at each contact.
    pub fn with_max_contact_n(mut self, max_contact_n: f64) -> Self {
        self.max_contact_n = Some(max_contact_n);
        self
    }

    /// The force for the problem's contacts, mass and gravity: the minimum grip force that survives rest and shakes at the lowest
    /// friction assumed, times the margin, at least the floor, at most what the limits allow; shared by [`distribute`]
    /// for the object at rest. The problem's `gamma` scales the mass in all loads, its `extra_wrench` acts in all of them.
    ///
    /// # Errors
    /// [`GripForceError::Load`] if a load cannot be carried even without the margin; [`GripForceError::Input`] if a number of the
    /// law or of the problem makes no sense.
    pub fn command(&self, problem: &GripForceProblem) -> Result<ForceCommand, GripForceError> {
        self.check()?;
        let mut problem = problem.clone();
        problem.contacts.iter_mut().for_each(|c| c.friction *= 1.0 - self.friction_uncertainty);
        if let Some(most) = self.max_contact_n {
            problem.max_normal_n = Some(problem.max_normal_n.map_or(most, |m| m.min(most)));
        }
        let mut loads = shake_loads(problem.mass_kg * problem.gamma, self.shake_m_s2, &problem.gravity);
        loads.iter_mut().for_each(|l| *l += problem.extra_wrench);
        // Rest is half-way between two shakes and so never asks for most.
        let required = required(&problem, &loads[1..]).map_err(after_rest)?;
        let (binding_load, required_n) = (required.binding + 1, required.total_n);
        let wanted = (self.margin * required_n).max(self.floor_n);
        let largest_n =
            bounded(&problem, &loads[1..], &required, wanted).map_err(after_rest)?.map(|(_, largest_n)| largest_n);
        // A hair inside the edge, where the programme still has room to solve.
        let total_n = largest_n.map_or(wanted, |l| required_n.max(l * (1.0 - 1e-4)));
        let distribution = distribute(&problem, total_n)?;
        Ok(ForceCommand {
            total_n,
            required_n,
            binding_load,
            largest_n,
            margin: if required_n > 0.0 { total_n / required_n } else { f64::INFINITY },
            distribution,
            paper_force: paper_force(problem.mass_kg, problem.gravity.norm(), problem.contacts.len()),
        })
    }

    fn check(&self) -> Result<(), GraspError> {
        let bad = |what: String, remedy| Err(GraspError::value(what, remedy));
        if !(self.margin >= 1.0 && self.margin.is_finite()) {
            return bad(format!("a force margin of {}", self.margin), "give one or more, such as 1.25");
        }
        if !(0.0..1.0).contains(&self.friction_uncertainty) {
            return bad(
                format!("a friction uncertainty of {}", self.friction_uncertainty),
                "give a fraction of 0 to below 1, such as 0.1",
            );
        }
        if !(self.shake_m_s2 >= 0.0 && self.shake_m_s2.is_finite() && self.floor_n >= 0.0 && self.floor_n.is_finite()) {
            return bad(
                format!("shakes of {} m/s² and a floor of {} N", self.shake_m_s2, self.floor_n),
                "give zero or more",
            );
        }
        if self.max_contact_n.is_some_and(|m| !(m > 0.0)) {
            return bad(format!("a damage limit of {:?} N", self.max_contact_n), "give newtons above zero");
        }
        Ok(())
    }
}

/// Counts the load of an error from rest on, as [`shake_loads`] does.
fn after_rest(error: GripForceError) -> GripForceError {
    match error {
        GripForceError::Load { load, force_n, torque_nm, reason } => {
            GripForceError::Load { load: load + 1, force_n, torque_nm, reason }
        }
        other => other,
    }
}

/// The paper's normalised force: min(1, m g n / f_max) with n contacts and f_max = [`PAPER_FORCE_LIMIT_N`] (its algorithm 2).
pub fn paper_force(mass_kg: f64, gravity_m_s2: f64, contacts: usize) -> f64 {
    (mass_kg * gravity_m_s2 * contacts as f64 / PAPER_FORCE_LIMIT_N).min(1.0)
}
