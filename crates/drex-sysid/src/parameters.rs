//! What a push is simulated with: which numbers are estimated, which are taken as stated, and which are known roughly.

use std::collections::BTreeMap;
use std::str::FromStr;

use drex_core::ASSUMED_FRICTION;
use drex_recording::{PushRecording, StatedParameter};
use serde::{Deserialize, Serialize};

use crate::{Result, SysidError};

/// A coefficient of friction that nobody states: of dry solids, 0.13 to 2 (95 %).
const UNKNOWN_FRICTION: Knowledge = Knowledge::Prior { mean: ASSUMED_FRICTION, sd: 0.7 };

/// What follows from the shape of the object.
const OF_THE_SHAPE: [Parameter; 7] = [
    Parameter::CenterX,
    Parameter::CenterY,
    Parameter::CenterZ,
    Parameter::StartX,
    Parameter::StartY,
    Parameter::StartZ,
    Parameter::ContactHeight,
];

/// A number that a push depends on.
///
/// Numbers that are positive by nature are estimated by their logarithm. Up to [`Parameter::JointFriction`] a new value
/// needs a new simulation; the others describe errors of the track and never do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Parameter {
    /// Mass of the object, kg.
    Mass,
    /// Friction of the object on its support (a coefficient).
    Friction,
    /// Friction of the fingertip on the object (a coefficient); where the support's is larger, that one counts.
    FingerFriction,
    /// Centre of mass against that of a uniform solid along x of the mesh frame, m.
    CenterX,
    /// The same along y.
    CenterY,
    /// The same along z.
    CenterZ,
    /// Factor on the inertia per mass about x of the mesh frame; products of inertia scale with its square root.
    InertiaX,
    /// The same about y.
    InertiaY,
    /// The same about z.
    InertiaZ,
    /// Factor on the stiffness of contact.
    ContactStiffness,
    /// Factor on the damping of contact (its relaxation time).
    ContactDamping,
    /// Start position against the stated one along the world's x, m.
    StartX,
    /// The same along y.
    StartY,
    /// The same along z.
    StartZ,
    /// Start orientation against the stated one about the vertical, rad.
    StartYaw,
    /// Height at which force or finger really act above the stated one, m.
    ContactHeight,
    /// Factor on the recorded force.
    ForceGain,
    /// Factor on the stiffness of the finger's drives.
    ActuatorStiffness,
    /// Factor on the damping of the finger's drives.
    ActuatorDamping,
    /// Factor on what the finger moves: tip and drives.
    FingerInertia,
    /// Dry friction in each joint of the finger, N.
    JointFriction,
    /// Clock of the track minus clock of force or finger, s.
    ClockOffset,
    /// Constant error of the tracked position along the world's x, m.
    BiasX,
    /// The same along y.
    BiasY,
    /// The same along z.
    BiasZ,
    /// Constant error of the tracked rotation about the mesh's x, rad.
    TurnX,
    /// The same about y.
    TurnY,
    /// The same about z.
    TurnZ,
    /// Drift of the tracked height, m/s.
    HeightSlope,
}

/// What is known about a parameter before a push is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Knowledge {
    /// Nothing: it is estimated.
    Free,
    /// It has this value.
    Fixed(f64),
    /// It is estimated, with this expectation and standard deviation; the latter is that of the logarithm for numbers that are
    /// positive by nature (0.1: known to 10 %).
    Prior {
        /// Expected value.
        mean: f64,
        /// Standard deviation.
        sd: f64,
    },
}

/// What is known beforehand about each parameter; those without an entry have their default: the mass is free, friction is
/// as the recording states it (free if it does not), errors of the track have priors, everything else is as stated.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ParameterSet {
    entries: BTreeMap<Parameter, Knowledge>,
}

/// What is expected of an error of the track.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Expected {
    pub mean: f64,
    /// Standard deviation; half the width at half the height of a heavy-tailed one.
    pub sd: f64,
    /// Follows Cauchy's law: most likely small, but it may be anything.
    pub heavy: bool,
}

impl Expected {
    /// Minus the logarithm of the density, up to a constant.
    pub(crate) fn cost(&self, x: f64) -> f64 {
        let square = ((x - self.mean) / self.sd).powi(2);
        if self.heavy { square.ln_1p() } else { 0.5 * square }
    }

    /// The precision of the normal law that has the same slope at `x`.
    pub(crate) fn precision(&self, x: f64) -> f64 {
        let plain = 1.0 / (self.sd * self.sd);
        if self.heavy { 2.0 * plain / (1.0 + (x - self.mean).powi(2) * plain) } else { plain }
    }
}

/// Simulated parameters.
pub(crate) const SIMULATED: usize = Parameter::JointFriction as usize + 1;
/// Errors of the track.
pub(crate) const NUISANCES: usize = Parameter::HeightSlope as usize + 1 - SIMULATED;

impl Parameter {
    /// All parameters, in the order of their declaration.
    pub const ALL: [Self; SIMULATED + NUISANCES] = [
        Self::Mass,
        Self::Friction,
        Self::FingerFriction,
        Self::CenterX,
        Self::CenterY,
        Self::CenterZ,
        Self::InertiaX,
        Self::InertiaY,
        Self::InertiaZ,
        Self::ContactStiffness,
        Self::ContactDamping,
        Self::StartX,
        Self::StartY,
        Self::StartZ,
        Self::StartYaw,
        Self::ContactHeight,
        Self::ForceGain,
        Self::ActuatorStiffness,
        Self::ActuatorDamping,
        Self::FingerInertia,
        Self::JointFriction,
        Self::ClockOffset,
        Self::BiasX,
        Self::BiasY,
        Self::BiasZ,
        Self::TurnX,
        Self::TurnY,
        Self::TurnZ,
        Self::HeightSlope,
    ];

    /// Its name on the command line and in files.
    pub fn as_str(self) -> &'static str {
        const NAMES: [&str; SIMULATED + NUISANCES] = [
            "mass",
            "friction",
            "finger_friction",
            "center_x",
            "center_y",
            "center_z",
            "inertia_x",
            "inertia_y",
            "inertia_z",
            "contact_stiffness",
            "contact_damping",
            "start_x",
            "start_y",
            "start_z",
            "start_yaw",
            "contact_height",
            "force_gain",
            "actuator_stiffness",
            "actuator_damping",
            "finger_inertia",
            "joint_friction",
            "clock_offset",
            "bias_x",
            "bias_y",
            "bias_z",
            "turn_x",
            "turn_y",
            "turn_z",
            "height_slope",
        ];
        NAMES[self as usize]
    }

    /// Whether it is positive by nature and estimated by its logarithm.
    pub fn is_logarithmic(self) -> bool {
        use Parameter::*;
        matches!(self, Mass | Friction | FingerFriction | InertiaX | InertiaY | InertiaZ | ContactStiffness)
            || matches!(self, ContactDamping | ForceGain | ActuatorStiffness | ActuatorDamping | FingerInertia)
    }

    /// Whether each push has its own value even where several are evaluated together.
    pub(crate) fn is_of_push(self) -> bool {
        use Parameter::*;
        matches!(self, StartX | StartY | StartZ | StartYaw | ContactHeight) || self as usize >= SIMULATED
    }

    /// The number that is estimated for a value.
    pub(crate) fn to_coordinate(self, value: f64) -> f64 {
        if self.is_logarithmic() { value.ln() } else { value }
    }

    /// The value of an estimated number.
    pub(crate) fn of_coordinate(self, coordinate: f64) -> f64 {
        if self.is_logarithmic() { coordinate.exp() } else { coordinate }
    }

    /// The value where nothing is stated.
    pub(crate) fn nominal(self) -> f64 {
        match self {
            Self::Mass => 0.2,
            Self::Friction => 0.5,
            _ if self.is_logarithmic() => 1.0,
            _ => 0.0,
        }
    }

    /// A change in its coordinate that matters: a span for slopes where nothing better is known.
    pub(crate) fn scale(self) -> f64 {
        use Parameter::*;
        match self {
            CenterX | CenterY | CenterZ | StartX | StartY | StartZ | ContactHeight => 1e-3,
            StartYaw => 0.01,
            JointFriction => 0.01,
            _ => 0.03,
        }
    }

    /// Expected error of the track, from what trackers are known to do.
    fn nuisance_sd(self) -> f64 {
        use Parameter::*;
        match self {
            ClockOffset => 0.005,
            BiasX | BiasY | BiasZ => 0.01,
            TurnX | TurnY | TurnZ => 0.02,
            _ => 0.002,
        }
    }
}

impl FromStr for Parameter {
    type Err = SysidError;

    fn from_str(s: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|p| p.as_str() == s).ok_or_else(|| SysidError::Parameter {
            name: s.into(),
            what: "is not known".into(),
            remedy: format!("choose one of {}", Self::ALL.map(Self::as_str).join(", ")),
        })
    }
}

impl ParameterSet {
    /// States what is known about a parameter.
    ///
    /// # Errors
    /// For a value that the parameter cannot have, a standard deviation that is not positive, or a mass that is fixed.
    pub fn set(&mut self, parameter: Parameter, knowledge: Knowledge) -> Result<()> {
        let refuse = |what: String, remedy: &str| {
            Err(SysidError::Parameter { name: parameter.as_str().into(), what, remedy: remedy.into() })
        };
        let value = match knowledge {
            Knowledge::Free => None,
            Knowledge::Fixed(value) | Knowledge::Prior { mean: value, .. } => Some(value),
        };
        if let Some(v) = value.filter(|v| !v.is_finite() || (parameter.is_logarithmic() && *v <= 0.0)) {
            return refuse(format!("cannot be {v}"), "give a finite number, positive where nature demands it");
        }
        if let Knowledge::Prior { sd, .. } = knowledge
            && !(sd > 0.0 && sd.is_finite())
        {
            return refuse(format!("has a standard deviation of {sd}"), "give a positive number");
        }
        self.entries.insert(parameter, knowledge);
        Ok(())
    }

    /// What a push states about its parameters.
    ///
    /// # Errors
    /// For names that no parameter has, and values that it cannot have.
    pub fn of_recording(recording: &PushRecording) -> Result<Self> {
        let mut out = Self::default();
        for (name, stated) in &recording.parameters {
            out.set(
                name.parse()?,
                match *stated {
                    StatedParameter::Free(_) => Knowledge::Free,
                    StatedParameter::Value(value) => Knowledge::Fixed(value),
                    StatedParameter::Expected { mean, sd } => Knowledge::Prior { mean, sd },
                },
            )?;
        }
        Ok(out)
    }

    /// What holds of a mesh that is not exact: where the weight acts, where the object stands and how high the push acts is expected within
    /// the error of the mesh.
    pub(crate) fn of_mesh(recording: &PushRecording) -> Self {
        let sd = recording.mesh_sd_m.filter(|sd| *sd > 0.0);
        let entries = sd.map(|sd| OF_THE_SHAPE.map(|p| (p, Knowledge::Prior { mean: 0.0, sd })));
        Self { entries: entries.into_iter().flatten().collect() }
    }

    /// What holds of a start that nobody states. The tracked place is that of the object by definition, since no push tells a
    /// constant error of it; `place` is whether the place matters, because a finger or an edge of the support is somewhere.
    pub(crate) fn of_unknown_start(place: bool) -> Self {
        let mut entries = BTreeMap::new();
        let roughly = |sd| Knowledge::Prior { mean: 0.0, sd };
        entries.insert(Parameter::StartYaw, roughly(Parameter::TurnZ.nuisance_sd()));
        if place {
            for (start, bias) in [(Parameter::StartX, Parameter::BiasX), (Parameter::StartY, Parameter::BiasY)] {
                entries.insert(start, roughly(bias.nuisance_sd()));
                entries.insert(bias, Knowledge::Fixed(0.0));
            }
        }
        Self { entries }
    }

    /// Everything that `self` states, and what only `others` state.
    pub fn or(&self, others: &Self) -> Self {
        let mut entries = others.entries.clone();
        entries.extend(self.entries.iter().map(|(p, k)| (*p, *k)));
        Self { entries }
    }

    /// What was stated about a parameter, if anything.
    pub fn get(&self, parameter: Parameter) -> Option<Knowledge> {
        self.entries.get(&parameter).copied()
    }

    /// What holds for a simulated parameter whose stated value in the recording is `stated`.
    pub(crate) fn of(&self, parameter: Parameter, stated: Option<f64>) -> Knowledge {
        self.get(parameter).unwrap_or(match (parameter, stated) {
            (Parameter::Mass, _) => Knowledge::Free,
            (Parameter::Friction, None) => UNKNOWN_FRICTION,
            (_, value) => Knowledge::Fixed(value.unwrap_or(parameter.nominal())),
        })
    }

    /// What is expected of each error of the track; a vanishing deviation fixes one.
    pub(crate) fn nuisances(&self) -> [Expected; NUISANCES] {
        std::array::from_fn(|i| {
            let parameter = Parameter::ALL[SIMULATED + i];
            let sd = parameter.nuisance_sd();
            let normal = |mean, sd| Expected { mean, sd, heavy: false };
            match self.get(parameter) {
                // Clocks agree, or they do not.
                None => Expected { mean: 0.0, sd, heavy: parameter == Parameter::ClockOffset },
                // A flat prior, to the eye of any track.
                Some(Knowledge::Free) => normal(0.0, 1e3 * sd),
                Some(Knowledge::Fixed(value)) => normal(value, 1e-6 * sd),
                Some(Knowledge::Prior { mean, sd }) => normal(mean, sd),
            }
        })
    }

    /// What was stated, one sentence per entry.
    pub(crate) fn sentences(&self) -> Vec<String> {
        self.entries
            .iter()
            .map(|(p, k)| match k {
                Knowledge::Free => format!("{} is free", p.as_str()),
                Knowledge::Fixed(v) => format!("{} is {v}", p.as_str()),
                Knowledge::Prior { mean, sd } if p.is_logarithmic() => {
                    format!("{} is {mean}, known to {:.0} %", p.as_str(), 100.0 * sd)
                }
                Knowledge::Prior { mean, sd } => format!("{} is {mean} with a standard deviation of {sd}", p.as_str()),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_names_and_numbers_agree() {
        for (i, p) in Parameter::ALL.into_iter().enumerate() {
            assert_eq!(p as usize, i);
            assert_eq!(p.as_str().parse::<Parameter>().unwrap(), p);
            assert_eq!(serde_json::to_value(p).unwrap(), p.as_str());
            let x = p.to_coordinate(if p.is_logarithmic() { 0.7 } else { -0.7 });
            assert!((p.of_coordinate(x).abs() - 0.7).abs() < 1e-15);
        }
        assert!("weight".parse::<Parameter>().unwrap_err().to_string().contains("mass, friction"));
    }

    #[test]
    fn impossible_values_are_refused() {
        let mut set = ParameterSet::default();
        assert!(set.set(Parameter::Friction, Knowledge::Fixed(-0.1)).is_err());
        assert!(set.set(Parameter::Mass, Knowledge::Prior { mean: 0.2, sd: 0.0 }).is_err());
        assert!(set.set(Parameter::StartX, Knowledge::Fixed(f64::NAN)).is_err());
        assert!(set.set(Parameter::StartX, Knowledge::Fixed(-0.001)).is_ok());
        assert_eq!(set.get(Parameter::StartX), Some(Knowledge::Fixed(-0.001)));
    }
}
