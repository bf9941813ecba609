//! First guesses of a mass: a number, a material and a volume, or somebody else's answer in a file.
//!
//! A guess is printed as a guess. It takes part in an estimate only where [`crate::Knowledge::Prior`] says so.

use serde::{Deserialize, Serialize};

use crate::{Result, SysidError};

/// A first guess of a mass and where it comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MassPrior {
    /// The guess, kg.
    pub mass_kg: f64,
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

impl MassPrior {
    /// A number that somebody states.
    ///
    /// # Errors
    /// If it is no mass.
    pub fn from_number(mass_kg: f64) -> Result<Self> {
        Self { mass_kg, range_kg: None, source: "stated".into() }.checked()
    }

    /// A solid of a material: the geometric mean of its densities times the volume, m³.
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
        Self {
            mass_kg: (low * high).sqrt() * volume_m3,
            range_kg: Some([low * volume_m3, high * volume_m3]),
            source: format!("{:.0} cm³ of solid {name} at {low} to {high} kg/m³", 1e6 * volume_m3),
        }
        .checked()
    }

    /// The answer of a person or of a vision-language model as a JSON object: `mass_kg` or `mass_g`, with `range_kg` if it likes,
    /// or else `density_kg_m3` or `material`, which need the volume, m³.
    ///
    /// # Errors
    /// If the text is no such object, or nothing in it gives a mass.
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
            (Some(mass_kg), ..) => Self { mass_kg, range_kg: answer.range_kg, source: "a file says so".into() },
            (None, Some(density), _) => {
                let volume = volume()?;
                let source = format!("{:.0} cm³ at {density} kg/m³, as a file says", 1e6 * volume);
                Self { mass_kg: density * volume, range_kg: None, source }
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
            assert!(low < high && a < m.mass_kg && m.mass_kg < b);
        }
        let message = MassPrior::from_material("unobtainium", 1e-4).unwrap_err().to_string();
        assert!(message.contains("unobtainium") && message.contains("hardwood"), "{message}");
    }

    #[test]
    fn answers_in_files_are_read_and_nonsense_is_named() {
        let of = |text: &str, volume| MassPrior::from_json(text, volume);
        assert_eq!(of(r#"{"mass_g": 500, "why": "it looks heavy"}"#, None).unwrap().mass_kg, 0.5);
        assert_eq!(of(r#"{"mass_kg": 0.5, "range_kg": [0.2, 1]}"#, None).unwrap().range_kg, Some([0.2, 1.0]));
        assert_eq!(of(r#"{"density_kg_m3": 500}"#, Some(1e-3)).unwrap().mass_kg, 0.5);
        assert!(of(r#"{"material": "glass"}"#, Some(1e-4)).unwrap().source.contains("glass"));
        for (text, what) in [
            (r#"{"material": "glass"}"#, "volume"),
            (r#"{"mass_kg": -1}"#, "-1 kg"),
            (r#"{"weight": 3}"#, "not in the file"),
            ("500 g", "cannot be read"),
        ] {
            let message = of(text, None).unwrap_err().to_string();
            assert!(message.contains(what), "{message}");
        }
    }
}
