//! The mass in words: the posterior, and apart from it the prior and what the pushes alone say.

use drex_sysid::{CONTRADICTS_SD, MassPrior};

use drex_twin::records::MassFile;

/// "205.6 g (95 %: 101.0 to 417.6 g), bounded by the push, weighted by a prior".
pub fn posterior_text(mass: &MassFile) -> String {
    format!("{:.1} g (95 %: {}), {}", 1e3 * mass.mass_kg, grams(mass.ci95_kg), mass.source.text())
}

/// "500.0 g (95 %: 128.5 to 1945.3 g), stated".
pub fn prior_text(prior: &MassPrior) -> String {
    format!("{:.1} g (95 %: {}), {}", 1e3 * prior.mass_kg, grams(prior.interval95_kg()), prior.source)
}

/// "63.6 to 340.1 g", "at most 139.0 g", "at least 20.0 g".
pub fn bounds_text(bounds_kg: [Option<f64>; 2]) -> String {
    match bounds_kg {
        [Some(low), Some(high)] => grams([low, high]),
        [None, Some(high)] => format!("at most {:.1} g", 1e3 * high),
        [Some(low), None] => format!("at least {:.1} g", 1e3 * low),
        [None, None] => "any mass".to_owned(),
    }
}

/// A standard deviation in grams, to two digits at least: one that is not zero is not printed as zero.
pub fn deviation_text(sd_kg: f64) -> String {
    let grams = 1e3 * sd_kg;
    let digits = (1.0 - grams.log10().floor()).clamp(1.0, 12.0) as usize;
    format!("{grams:.digits$} g")
}

/// What to grasp for, where that is more than the median.
pub fn grip_text(mass: &MassFile) -> Option<String> {
    (mass.grip_kg > mass.mass_kg).then(|| {
        format!(
            "for {:.1} g: with the margin of the grip-force policy, 95 % of the masses that are likely are held",
            1e3 * mass.grip_kg
        )
    })
}

/// That prior and push contradict each other, and what to do; `None` where they do not.
pub fn contradiction_text(mass: &MassFile) -> Option<String> {
    let sd = mass.contradiction_sd.filter(|sd| *sd > CONTRADICTS_SD)?;
    let (prior, push) = (mass.prior.as_ref()?, mass.push_ci95_kg?);
    let what = if prior.weighed { "the scale" } else { "the prior" };
    Some(format!(
        "{what} and the push contradict each other by {sd:.1} standard deviations (beyond {CONTRADICTS_SD} is chance once in twenty): {what} says {}, \
         the push alone {}. One of them is wrong, and every number here mixes both: {}",
        prior_text(prior),
        bounds_text(push),
        if prior.weighed {
            "weigh the object again, or check the push (its force, its frames, the mesh it names)"
        } else {
            "weigh the object and write weighed_kg into twin.toml; or correct the prior (prior_kg, a larger prior_sd_log) or the push (its \
             force, its frames, the mesh it names)"
        }
    ))
}

fn grams([low, high]: [f64; 2]) -> String {
    format!("{:.1} to {:.1} g", 1e3 * low, 1e3 * high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_and_deviations_are_said_as_they_are() {
        assert_eq!(bounds_text([Some(0.0636), Some(0.3401)]), "63.6 to 340.1 g");
        assert_eq!(bounds_text([None, Some(0.139)]), "at most 139.0 g");
        assert_eq!(bounds_text([Some(0.02), None]), "at least 20.0 g");
        assert_eq!(deviation_text(0.0808), "80.8 g");
        assert_eq!(deviation_text(0.000_02), "0.020 g");
    }
}
