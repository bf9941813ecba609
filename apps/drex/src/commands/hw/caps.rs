//! How hard the joints of a hand may press, in words: the cap in force, what is recommended, and what a current means.

use drex_hw::leap::table::MotorModel;
use serde_json::{Value, json};

use super::Driver;

impl Driver {
    /// The cap in force and what it is measured by.
    pub fn cap_text(&mut self) -> String {
        let model = self.model();
        let hand = self.hand();
        let (low, high) = range(hand.effort_caps());
        let unit = super::unit(hand);
        let each = if low == high { format!("{high} {unit}") } else { format!("{low:.3} to {high:.3} {unit}") };
        match model {
            Some(model) => format!(
                "{each} per joint ({}: start with {} mA, the authors of LEAP recommend at most {} mA, it stalls at {} mA)",
                model.name(),
                model.gentle_cap_ma(),
                model.recommended_cap_ma(),
                model.peak_ma()
            ),
            None => format!("{each} per joint"),
        }
    }

    /// What is to be said of a cap above what is recommended.
    pub fn cap_warning(&mut self) -> Option<String> {
        let model = self.model()?;
        let (_, cap) = range(self.hand().effort_caps());
        above_recommended(model, cap)
    }

    /// The cap in force for programs.
    pub fn cap_json(&mut self) -> Value {
        let motor = self.model().map(MotorModel::name);
        let hand = self.hand();
        json!({ "per_joint": hand.effort_caps(), "unit": super::unit(hand), "motor": motor })
    }

    /// The motors of a LEAP hand.
    pub fn model(&self) -> Option<MotorModel> {
        match self {
            Self::Leap(hand) => Some(hand.model()),
            Self::Allegro(_) => None,
        }
    }
}

/// What is to be said of a cap, mA, above what the authors of LEAP recommend.
pub fn above_recommended(model: MotorModel, cap_ma: f64) -> Option<String> {
    (cap_ma > model.recommended_cap_ma()).then(|| {
        format!(
            "warning: the cap of {cap_ma} mA is above the {} mA that the authors of LEAP recommend for the {}: it overheats or stops with an overload",
            model.recommended_cap_ma(),
            model.name()
        )
    })
}

fn range(caps: &[f64]) -> (f64, f64) {
    (caps.iter().copied().fold(f64::INFINITY, f64::min), caps.iter().copied().fold(0.0, f64::max))
}
