//! What is known of a mass before a push: a guess, a material and a volume, somebody else's answer in a file, or a scale.
//!
//! What a push says does not depend on it: the two meet in [`crate::MassPosterior`].

use serde::{Deserialize, Serialize};

use crate::{MassDistribution, Result, SysidError};

/// Standard deviation of the logarithm of a mass that is a guess: right to a factor of 2.
pub const GUESS_SD_LOG: f64 = std::f64::consts::LN_2;
/// The same of a mass that was put on a scale: right to 1 %.
pub const WEIGHED_SD_LOG: f64 = 0.01;
/// Half a 95 % interval of a normal law, in standard deviations.
const HALF_INTERVAL: f64 = 1.96;

/// What is known of a mass before a push: a normal law of its logarithm, and where it comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MassPrior {
    /// Median, kg.
    pub mass_kg: f64,
    /// Standard deviation of the logarithm of the mass.
    pub sd_log: f64,
    /// Whether it was put on a scale.
    pub weighed: bool,
    /// The range that its source allows, kg; absent where the source names none.
    pub range_kg: Option<[f64; 2]>,
    /// Where it comes from, in words.
    pub source: String,
}

/// Materials of everyday objects and their densities from lightest to heaviest grade, kg/m³ (rounded handbook values at room
/// temperature; a foam or a filled bottle is as dense as a whole).
const DENSITIES: [(&str, f64, f64); 26] = [
    ("polystyrene foam", 15.0, 50.0),
    ("foam", 20.0, 150.0),
    ("cork", 120.0, 240.0),
    ("balsa", 100.0, 200.0),
    ("cardboard", 600.0, 800.0),
    ("paper", 700.0, 1100.0),
    ("softwood", 400.0, 600.0),
    ("hardwood", 600.0, 900.0),
    ("wood", 400.0, 900.0),
    ("leather", 850.0, 1000.0),
    ("wax", 880.0, 970.0),
    ("polyethylene", 910.0, 970.0),
    ("abs", 1020.0, 1080.0),
    ("pla", 1200.0, 1300.0),
    ("acrylic", 1150.0, 1200.0),
    ("plastic", 900.0, 1450.0),
    ("water", 990.0, 1000.0),
    ("food", 500.0, 1300.0),
    ("rubber", 900.0, 1500.0),
    ("ceramic", 1900.0, 2700.0),
    ("glass", 2400.0, 2600.0),
    ("stone", 2300.0, 3000.0),
    ("aluminium", 2640.0, 2810.0),
    ("steel", 7700.0, 8050.0),
    ("brass", 8400.0, 8730.0),
    ("copper", 8900.0, 8960.0),
];

/// What a file with a guess may say; other entries (an explanation, say) are ignored.
#[derive(Deserialize)]
struct Answer {
    mass_kg: Option<f64>,
    mass_g: Option<f64>,
    range_kg: Option<[f64; 2]>,
    density_kg_m3: Option<f64>,
    material: Option<String>,
}

/// The standard deviation of the logarithm for which a range is a 95 % interval.
fn sd_log_of([low, high]: [f64; 2]) -> f64 {
    (high / low).ln() / (2.0 * HALF_INTERVAL)
}

impl MassPrior {
    /// A number that somebody guesses, with a standard deviation of [`GUESS_SD_LOG`].
    ///
    /// # Errors
    /// If it is no mass.
    pub fn from_number(mass_kg: f64) -> Result<Self> {
        Self::guess(mass_kg, None, "stated".into()).checked()
    }

    /// A number that a scale shows, with a standard deviation of [`WEIGHED_SD_LOG`].
    ///
    /// # Errors
    /// If it is no mass.
    pub fn from_scale(mass_kg: f64) -> Result<Self> {
        let sd_log = WEIGHED_SD_LOG;
        Self { mass_kg, sd_log, weighed: true, range_kg: None, source: "weighed".into() }.checked()
    }

    fn guess(mass_kg: f64, range_kg: Option<[f64; 2]>, source: String) -> Self {
        Self { mass_kg, sd_log: GUESS_SD_LOG, weighed: false, range_kg, source }
    }

    /// The same median with another standard deviation of the logarithm.
    ///
    /// # Errors
    /// If `sd_log` is not positive and finite.
    pub fn with_sd_log(self, sd_log: f64) -> Result<Self> {
        Self { sd_log, ..self }.checked()
    }

    /// The normal law of the logarithm of the mass.
    ///
    /// # Errors
    /// If the numbers are none that a constructor gives.
    pub fn distribution(&self) -> Result<MassDistribution> {
        MassDistribution::log_normal(self.mass_kg, self.sd_log)
    }

    /// Its 95 % interval, kg.
    pub fn interval95_kg(&self) -> [f64; 2] {
        [-HALF_INTERVAL, HALF_INTERVAL].map(|z| self.mass_kg * (z * self.sd_log).exp())
    }

    /// A solid of a material: the geometric mean of its densities times the volume, m³. The standard deviation is that of a guess, since
    /// nobody says that the object is solid, or what makes the densities a 95 % interval where that is larger.
    ///
    /// # Errors
    /// For a material that is not in the table (the message lists it), and for no volume.
    pub fn from_material(material: &str, volume_m3: f64) -> Result<Self> {
        let wanted = material.trim().to_lowercase();
        let wanted = if wanted == "aluminum" { "aluminium" } else { wanted.as_str() };
        let &(name, low, high) = DENSITIES.iter().find(|d| d.0 == wanted).ok_or_else(|| {
            refuse(
                format!("comes from the material `{material}`, which is not known"),
                format!("choose one of {}, or give a number", DENSITIES.map(|d| d.0).join(", ")),
            )
        })?;
        let source = format!("{:.0} cm³ of solid {name} at {low} to {high} kg/m³", 1e6 * volume_m3);
        let range_kg = [low * volume_m3, high * volume_m3];
        let guess = Self::guess((low * high).sqrt() * volume_m3, Some(range_kg), source);
        Self { sd_log: GUESS_SD_LOG.max(sd_log_of([low, high])), ..guess }.checked()
    }

    /// The answer of a person or of a vision-language model as a JSON object: `mass_kg` or `mass_g`, with `range_kg` if it likes,
    /// or else `density_kg_m3` or `material`, which need the volume, m³. A range is taken as a 95 % interval.
    ///
    /// # Errors
    /// If the text is no such object, nothing in it gives a mass, or the range does not hold the mass.
    pub fn from_json(text: &str, volume_m3: Option<f64>) -> Result<Self> {
        const REMEDY: &str = "give an object such as {\"mass_kg\": 0.5}, {\"mass_g\": 500}, {\"density_kg_m3\": 950} or {\"material\": \"wood\"}";
        let answer: Answer =
            serde_json::from_str(text).map_err(|e| refuse(format!("cannot be read: {e}"), REMEDY.into()))?;
        let volume = || {
            volume_m3.ok_or_else(|| {
                refuse("comes as a density, and the volume is not known".into(), "give mass_kg instead".into())
            })
        };
        let mass_kg = answer.mass_kg.or(answer.mass_g.map(|g| 1e-3 * g));
        let out = match (mass_kg, answer.density_kg_m3, &answer.material) {
            (Some(mass_kg), ..) => {
                let guess = Self::guess(mass_kg, answer.range_kg, "a file says so".into());
                let outside = |[low, high]: &[f64; 2]| !(*low < mass_kg && mass_kg < *high);
                if let Some([low, high]) = answer.range_kg.filter(outside) {
                    return Err(refuse(
                        format!("is {mass_kg} kg and its range {low} to {high} kg"),
                        "give a range in kilograms that holds the mass, the lower end first".into(),
                    ));
                }
                Self { sd_log: answer.range_kg.map_or(guess.sd_log, sd_log_of), ..guess }
            }
            (None, Some(density), _) => {
                let volume = volume()?;
                let source = format!("{:.0} cm³ at {density} kg/m³, as a file says", 1e6 * volume);
                Self::guess(density * volume, None, source)
            }
            (None, None, Some(material)) => Self::from_material(material, volume()?)?,
            (None, None, None) => return Err(refuse("is not in the file".into(), REMEDY.into())),
        };
        out.checked()
    }

    fn checked(self) -> Result<Self> {
        let numbers = std::iter::once(self.mass_kg).chain(self.range_kg.into_iter().flatten());
        if let Some(bad) = numbers.into_iter().find(|m| !(*m > 0.0 && m.is_finite())) {
            return Err(refuse(format!("is {bad} kg"), "give a positive number of kilograms".into()));
        }
        if !(self.sd_log > 0.0 && self.sd_log.is_finite()) {
            return Err(refuse(
                format!("has the standard deviation {} of its logarithm", self.sd_log),
                "give a positive number: 0.69 is a factor of 2 either way".into(),
            ));
        }
        Ok(self)
    }
}

fn refuse(what: String, remedy: String) -> SysidError {
    SysidError::Parameter { name: "mass: the first guess".into(), what, remedy }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decilitre_of_each_material_weighs_what_it_should() {
        let steel = MassPrior::from_material("Steel", 1e-4).unwrap();
        assert!((steel.mass_kg - 0.787).abs() < 0.002 && steel.source.contains("100 cm³"), "{steel:?}");
        for (name, low, high) in DENSITIES {
            let m = MassPrior::from_material(name, 1e-4).unwrap();
            let [a, b] = m.range_kg.unwrap();
            assert!(low < high && a < m.mass_kg && m.mass_kg < b && m.sd_log >= GUESS_SD_LOG);
        }
        let message = MassPrior::from_material("unobtainium", 1e-4).unwrap_err().to_string();
        assert!(message.contains("unobtainium") && message.contains("hardwood"), "{message}");
    }

    #[test]
    fn answers_in_files_are_read_and_nonsense_is_named() {
        let of = |text: &str, volume| MassPrior::from_json(text, volume);
        assert_eq!(of(r#"{"mass_g": 500, "why": "it looks heavy"}"#, None).unwrap().mass_kg, 0.5);
        let ranged = of(r#"{"mass_kg": 0.5, "range_kg": [0.25, 1]}"#, None).unwrap();
        assert_eq!(ranged.range_kg, Some([0.25, 1.0]));
        // A stated range is the prior's 95 % interval.
        assert!(ranged.interval95_kg().iter().zip([0.25, 1.0]).all(|(a, b)| (a / b - 1.0).abs() < 1e-12));
        assert_eq!(of(r#"{"density_kg_m3": 500}"#, Some(1e-3)).unwrap().mass_kg, 0.5);
        assert!(of(r#"{"material": "glass"}"#, Some(1e-4)).unwrap().source.contains("glass"));
        for (text, what) in [
            (r#"{"material": "glass"}"#, "volume"),
            (r#"{"mass_kg": -1}"#, "-1 kg"),
            (r#"{"mass_kg": 0.5, "range_kg": [0.6, 1]}"#, "holds the mass"),
            (r#"{"mass_kg": 0.5, "range_kg": [1, 0.2]}"#, "holds the mass"),
            (r#"{"weight": 3}"#, "not in the file"),
            ("500 g", "cannot be read"),
        ] {
            let message = of(text, None).unwrap_err().to_string();
            assert!(message.contains(what), "{message}");
        }
    }

    #[test]
    fn a_guess_is_right_to_a_factor_of_two_and_a_scale_to_a_percent() {
        let guess = MassPrior::from_number(0.5).unwrap();
        assert_eq!((guess.sd_log, guess.weighed), (2.0_f64.ln(), false));
        let scale = MassPrior::from_scale(0.5).unwrap();
        assert_eq!((scale.sd_log, scale.weighed), (0.01, true));
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let message = guess.clone().with_sd_log(bad).unwrap_err().to_string();
            assert!(message.contains("standard deviation") && message.contains("factor of 2"), "{message}");
        }
    }
}
