//! What is known of an object before it is grasped, and what to grip it for at a risk.

use drex_core::stats::upper_median;
use drex_grasp::GripForcePolicy;

use crate::assumed::check_mass_and_friction;
use crate::{Assumed, Error, Result};

/// Halvings of an interval until nothing is left of it.
const HALVINGS: usize = 60;

/// What is known of an object before it is grasped: masses that are equally likely, and two ends between which its friction is as likely anywhere.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    masses_kg: Vec<f64>,
    friction: (f64, f64),
    /// The mass of the pairs that are assumed.
    mass_kg: f64,
}

impl Uncertainty {
    /// The risk at which hands grip: five in a hundred objects like this ask for more.
    pub const RISK: f64 = 0.05;
    /// Friction of a hand on an object of which nothing is known: the range of the protocol.
    pub const ANY_FRICTION: (f64, f64) = (0.3, 0.8);

    /// Of masses that are equally likely, such as draws of a posterior, and the ends of an interval of friction, which may be the same.
    ///
    /// # Errors
    /// Without a mass; for a mass or a friction that is none; if the interval ends before it begins.
    pub fn new(masses_kg: Vec<f64>, friction: (f64, f64)) -> Result<Self> {
        let (low, high) = friction;
        if masses_kg.is_empty() || low > high {
            let what = format!("{} masses and a friction of {low} to {high}", masses_kg.len());
            return Err(Error::value(what, "give at least one mass, and the lower end of the friction first"));
        }
        for mass_kg in &masses_kg {
            check_mass_and_friction(*mass_kg, low)?;
        }
        check_mass_and_friction(masses_kg[0], high)?;
        let mass_kg = upper_median(masses_kg.iter().copied()).unwrap_or_default();
        Ok(Self { masses_kg, friction, mass_kg })
    }

    /// The same, spoken for by another mass than the median, such as the one that everything else is planned for, kg.
    ///
    /// # Errors
    /// For a mass that is none.
    pub fn spoken_for_by(self, mass_kg: f64) -> Result<Self> {
        check_mass_and_friction(mass_kg, self.friction.0)?;
        Ok(Self { mass_kg, ..self })
    }

    /// Mass and friction to grip for, so that mass over friction, to which the force of a pinch is in proportion, is higher with the probability
    /// `risk` alone. Of all pairs with that ratio it is the one with the median of the masses (or [`Uncertainty::spoken_for_by`]), or, where that would
    /// take a friction outside of the interval, the one with its end. A `law` takes friction for lower than assumed by its uncertainty; that is in the interval already, so what is to be
    /// assumed is higher by as much.
    pub fn at_risk(&self, risk: f64, law: &GripForcePolicy) -> Assumed {
        let (low, high) = self.friction;
        let lightest = self.masses_kg.iter().copied().fold(f64::INFINITY, f64::min);
        let heaviest = self.masses_kg.iter().copied().fold(0.0, f64::max);
        let (mut below, mut above) = (lightest / high, heaviest / low);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (below + above);
            match self.exceeds(middle) > risk {
                true => below = middle,
                false => above = middle,
            }
        }
        let friction = self.mass_kg / above;
        let (mass_kg, friction) = match (low..=high).contains(&friction) {
            true => (self.mass_kg, friction),
            false => (above * friction.clamp(low, high), friction.clamp(low, high)),
        };
        Assumed { mass_kg, friction: friction / (1.0 - law.friction_uncertainty) }
    }

    /// What to assume in turn for [`GraspPath::plan_in_turn`](crate::GraspPath::plan_in_turn), with the risk: [`Uncertainty::RISK`], then 10, 20, 35 and 50 %.
    pub fn in_turn(&self, law: &GripForcePolicy) -> [(f64, Assumed); 5] {
        [Self::RISK, 0.1, 0.2, 0.35, 0.5].map(|risk| (risk, self.at_risk(risk, law)))
    }

    /// Probability that mass over friction exceeds a ratio, kg.
    fn exceeds(&self, ratio_kg: f64) -> f64 {
        let (low, high) = self.friction;
        let smoother = |mass_kg: &f64| {
            let friction = mass_kg / ratio_kg;
            match high > low {
                true => ((friction - low) / (high - low)).clamp(0.0, 1.0),
                false => f64::from(u8::from(friction > low)),
            }
        };
        self.masses_kg.iter().map(smoother).sum::<f64>() / self.masses_kg.len() as f64
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    /// What is assumed by a law that takes friction for what it is.
    fn exact(uncertainty: &Uncertainty, risk: f64) -> Assumed {
        uncertainty.at_risk(risk, &GripForcePolicy::default().with_friction_uncertainty(0.0))
    }

    #[test]
    fn of_a_known_mass_the_friction_is_the_quantile_of_the_interval() {
        let uncertainty = Uncertainty::new(vec![0.2], (0.3, 0.8)).unwrap();
        for (risk, friction) in [(0.0, 0.3), (0.05, 0.325), (0.5, 0.55), (1.0, 0.8)] {
            let assumed = exact(&uncertainty, risk);
            assert!((assumed.friction - friction).abs() < 1e-9 && (assumed.mass_kg - 0.2).abs() < 1e-9, "{assumed:?}");
        }
        let lower = uncertainty.at_risk(0.5, &GripForcePolicy::default());
        assert!((0.9 * lower.friction - 0.55).abs() < 1e-9 && (lower.mass_kg - 0.2).abs() < 1e-9, "{lower:?}");
        let known = exact(&Uncertainty::new(vec![0.2], (0.5, 0.5)).unwrap(), 0.05);
        assert!((known.friction - 0.5).abs() < 1e-9 && (known.mass_kg - 0.2).abs() < 1e-9);
    }

    #[test]
    fn of_a_known_friction_the_mass_is_the_quantile() {
        let masses: Vec<f64> = (1..=100).map(|i| 1e-3 * f64::from(100 + i)).collect();
        let assumed = exact(&Uncertainty::new(masses, (0.5, 0.5)).unwrap(), 0.05);
        assert!((assumed.friction - 0.5).abs() < 1e-9 && (assumed.mass_kg - 0.195).abs() < 1.1e-3, "{assumed:?}");
    }

    #[test]
    fn what_is_none_is_refused() {
        let refused = |masses: &[f64], friction| Uncertainty::new(masses.to_vec(), friction).unwrap_err().to_string();
        assert!(refused(&[], (0.3, 0.8)).contains("0 masses"));
        assert!(refused(&[0.1], (0.8, 0.3)).contains("0.8 to 0.3"));
        assert!(refused(&[0.1, -0.1], (0.3, 0.8)).contains("-0.1 kg"));
        assert!(refused(&[0.1], (0.3, f64::INFINITY)).contains("friction"));
        assert!(refused(&[0.1], (f64::NAN, 0.8)).contains("friction"));
    }

    proptest! {
        /// Of draws of mass and friction the share that asks for more than what is gripped for is the risk.
        #[test]
        fn the_share_that_asks_for_more_is_the_risk(
            spread in 0.01..0.4_f64, low in 0.2..0.6_f64, width in 0.01..0.5_f64, risk in 0.02..0.6_f64,
        ) {
            let masses: Vec<f64> = (0..200).map(|i| 0.1 * (spread * (f64::from(i) / 100.0 - 1.0)).exp()).collect();
            let assumed = exact(&Uncertainty::new(masses.clone(), (low, low + width)).unwrap(), risk);
            prop_assert!(assumed.friction >= low && assumed.friction <= low + width);
            let more = masses.iter().flat_map(|m| (0..500).map(move |j| m / (low + width * (f64::from(j) + 0.5) / 500.0)));
            let share = more.filter(|r| *r > assumed.mass_kg / assumed.friction).count() as f64 / 1e5;
            prop_assert!((share - risk).abs() < 6e-3, "{share} {risk}");
            // Whatever mass speaks for it, what is asked for is the same.
            let other = Uncertainty::new(masses, (low, low + width)).unwrap().spoken_for_by(0.11).unwrap();
            let other = exact(&other, risk);
            prop_assert!((other.mass_kg / other.friction / (assumed.mass_kg / assumed.friction) - 1.0).abs() < 1e-9);
            prop_assert!(other.mass_kg == 0.11 || other.friction == low || other.friction == low + width);
        }
    }
}
