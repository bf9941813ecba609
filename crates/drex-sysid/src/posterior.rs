//! One answer about a mass: what was known before, times what the pushes say.

use serde::{Deserialize, Serialize};

use crate::{Identification, MassDistribution, MassPrior, Result, SysidError, Verdict};

/// Standard deviations beyond which prior and pushes are said to contradict each other: one in twenty does by chance.
pub const CONTRADICTS_SD: f64 = 1.96;
/// Quantile of the posterior that a grasp has to carry.
const CARRIED: f64 = 0.95;

/// Where a mass comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MassSource {
    /// It was put on a scale; a push that says something is counted in.
    Weighed,
    /// The pushes identify it; a prior is counted in.
    Identified,
    /// The pushes bound it without identifying it, and the prior weighs the masses that they leave.
    Bounded,
    /// Only a prior: no push says anything.
    Prior,
}

impl MassSource {
    /// The source in words, for tables and sentences.
    pub fn text(self) -> &'static str {
        match self {
            Self::Weighed => "weighed",
            Self::Identified => "identified from the push",
            Self::Bounded => "bounded by the push, weighted by a prior",
            Self::Prior => "a prior, not confirmed by any recording",
        }
    }
}

/// The posterior of a mass: a prior as a distribution times the likelihood of the pushes.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MassPosterior {
    /// What was known before the pushes.
    pub prior: Option<MassPrior>,
    /// What the pushes alone say; absent where they say nothing.
    pub push: Option<MassDistribution>,
    /// Ends of the pushes' own 95 % interval, kg, each absent where they leave that side open; absent where they say nothing.
    pub push_ci95_kg: Option<[Option<f64>; 2]>,
    /// Both together.
    pub distribution: MassDistribution,
    /// Where it comes from.
    pub source: MassSource,
    /// How far the two contradict each other, in standard deviations ([`MassDistribution::contradiction_sd`]); absent without both.
    pub contradiction_sd: Option<f64>,
}

impl MassPosterior {
    /// The posterior of a prior and of what pushes say of the mass, if anything.
    ///
    /// # Errors
    /// Without a prior, if the pushes do not bound the mass from both sides; for a prior that is none.
    pub fn of(prior: Option<MassPrior>, pushes: Option<&Identification>) -> Result<Self> {
        let push = pushes.and_then(Identification::likelihood);
        let before = prior.as_ref().map(MassPrior::distribution).transpose()?;
        let weighed = prior.as_ref().is_some_and(|p| p.weighed);
        let identified = pushes.is_some_and(|p| p.verdict == Verdict::Identified);
        let source = match &push {
            _ if weighed => MassSource::Weighed,
            Some(_) if identified => MassSource::Identified,
            Some(_) => MassSource::Bounded,
            None => MassSource::Prior,
        };
        // As the pushes' answer states it, where that side is bounded at all.
        let push_ci95_kg = push.as_ref().zip(pushes.and_then(|p| p.ci95_kg)).map(|(push, stated)| {
            let bounds = push.bounds_kg();
            std::array::from_fn(|i| bounds[i].and(Some(stated[i])))
        });
        let contradiction_sd = before.as_ref().zip(push.as_ref()).map(|(prior, push)| prior.contradiction_sd(push));
        let distribution = match (before, &push) {
            (Some(before), Some(push)) => before.times(push),
            (Some(before), None) => before,
            (None, Some(push)) if push.bounds_kg().iter().all(Option::is_some) => push.clone(),
            (None, _) => {
                return Err(SysidError::Parameter {
                    name: "mass".into(),
                    what: format!(
                        "is not bounded from both sides by the pushes ({}), and nobody guessed one",
                        pushes.map_or("there are none", |p| p.reason.as_str())
                    ),
                    remedy: "weigh the object, or give a first guess".into(),
                });
            }
        };
        Ok(Self { prior, push, push_ci95_kg, distribution, source, contradiction_sd })
    }

    /// The mass to grasp for, kg, with a grip-force policy whose `margin` (at least 1) also covers errors of the mass: the median, or more
    /// where the margin on top of that would not carry the 95 % quantile.
    pub fn grip_kg(&self, margin: f64) -> f64 {
        self.distribution.median_kg().max(self.distribution.quantile_kg(CARRIED) / margin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contradicts(posterior: &MassPosterior) -> bool {
        posterior.contradiction_sd.is_some_and(|sd| sd > CONTRADICTS_SD)
    }

    #[test]
    fn a_mass_that_could_not_be_simulated_survives_the_file() {
        let mut of = answer(serde_json::json!({ "profile": [[0.1, 1.0], [0.2, 2.0]] }));
        of.profile[1].1 = f64::INFINITY;
        let read: Identification = serde_json::from_str(&serde_json::to_string(&of).unwrap()).unwrap();
        assert_eq!(read.profile, [(0.1, 1.0), (0.2, f64::INFINITY)]);
    }

    /// An answer of pushes of a hand: a normal law of ln m, or that law as a bound from above.
    fn hand(median_kg: f64, sd_log: f64, from_above: bool) -> Identification {
        let cost =
            |m: f64| if from_above && m < median_kg { 0.0 } else { 0.5 * ((m / median_kg).ln() / sd_log).powi(2) };
        let masses = (0..=84).map(|k| 0.005 * 1000.0_f64.powf(f64::from(k) / 84.0));
        let profile: Vec<(f64, f64)> = masses.map(|m| (m, cost(m))).collect();
        let [low, high] = [-1.96, 1.96].map(|z| median_kg * (z * sd_log).exp());
        answer(serde_json::json!({ "ci95_kg": [if from_above { 0.005 } else { low }, high], "profile": profile }))
    }

    /// An answer with these fields.
    fn answer(fields: serde_json::Value) -> Identification {
        let mut all = serde_json::json!({
            "verdict": "not_identifiable", "reason": "too wide", "seconds": 0.0, "simulations": 0, "sensitivities": [],
            "assumptions": [], "profile": [], "pushes": [],
        });
        let (Some(all_fields), serde_json::Value::Object(fields)) = (all.as_object_mut(), fields) else {
            unreachable!()
        };
        all_fields.extend(fields);
        serde_json::from_value(all).unwrap()
    }

    #[test]
    fn a_push_that_bounds_the_mass_moves_a_guess_into_its_bounds() {
        let guess = MassPrior::from_number(0.5).unwrap();
        let push = hand(0.147, 0.43, false);
        let both = MassPosterior::of(Some(guess.clone()), Some(&push)).unwrap();
        let [low, high] = push.ci95_kg.unwrap();
        let median_kg = both.distribution.median_kg();
        assert!(low < median_kg && median_kg < high && median_kg > 0.147, "{median_kg}");
        assert_eq!((both.source, contradicts(&both)), (MassSource::Bounded, false));
        // The 95 % quantile is carried, by the margin or beyond it.
        let carried = both.distribution.quantile_kg(0.95);
        assert!((1.25 * both.grip_kg(1.25) / carried - 1.0).abs() < 1e-12 && both.grip_kg(3.0) == median_kg);

        let heavy = MassPosterior::of(Some(MassPrior::from_number(5.0).unwrap()), Some(&push)).unwrap();
        assert!(contradicts(&heavy), "{:?}", heavy.contradiction_sd);
        let bound = hand(0.12, 0.1, true);
        let light = MassPosterior::of(Some(guess), Some(&bound)).unwrap();
        assert!(contradicts(&light) && light.distribution.median_kg() < 0.13, "{:?}", light.contradiction_sd);
        assert_eq!(light.push_ci95_kg, bound.ci95_kg.map(|[_, high]| [None, Some(high)]));
    }

    #[test]
    fn a_push_that_says_nothing_leaves_the_prior() {
        let guess = MassPrior::from_number(0.5).unwrap();
        let nothing = answer(serde_json::json!({ "profile": [[0.1, 1.0], [1.0, 2.0]], "sd_log_mass": 2.0 }));
        for pushes in [None, Some(&nothing)] {
            let p = MassPosterior::of(Some(guess.clone()), pushes).unwrap();
            assert_eq!(p.distribution, guess.distribution().unwrap());
            assert_eq!((p.source, p.contradiction_sd, p.push), (MassSource::Prior, None, None));
            let message = MassPosterior::of(None, pushes).unwrap_err().to_string();
            assert!(message.contains("nobody guessed"), "{message}");
        }
        // Half a bound is too little without a prior, a whole one is enough.
        assert!(MassPosterior::of(None, Some(&hand(0.12, 0.1, true))).is_err());
        let alone = MassPosterior::of(None, Some(&hand(0.147, 0.43, false))).unwrap();
        assert!((alone.distribution.median_kg() / 0.147 - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_simulated_push_counts_with_its_stated_interval_and_a_scale_with_a_percent() {
        let profile: Vec<(f64, f64)> =
            (-25..=25).map(|k| 0.2 * f64::from(k)).map(|z| (0.2 * (0.05 * z).exp(), 0.5 * z * z)).collect();
        let push = answer(serde_json::json!({
            "verdict": "identified", "mass_kg": 0.2, "sd_log_mass": 0.05, "ci95_kg": [0.181, 0.2206], "profile": profile,
        }));
        let guessed = MassPosterior::of(Some(MassPrior::from_number(0.5).unwrap()), Some(&push)).unwrap();
        assert_eq!(guessed.source, MassSource::Identified);
        assert_eq!(guessed.push_ci95_kg, Some([Some(0.181), Some(0.2206)]), "as the answer states it");
        assert!((guessed.distribution.sd_log() / 0.05 - 1.0).abs() < 0.01);
        assert!((guessed.distribution.median_kg() / 0.2 - 1.0).abs() < 0.01);
        let weighed = MassPosterior::of(Some(MassPrior::from_scale(0.3).unwrap()), Some(&push)).unwrap();
        assert_eq!((weighed.source, contradicts(&weighed)), (MassSource::Weighed, true));
        assert!((0.27..0.3).contains(&weighed.distribution.median_kg()));
    }
}
