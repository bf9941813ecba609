//! The model itself: four shapes, both directions, and where it comes from.

use serde::{Deserialize, Serialize};

use super::Hysteresis;
use crate::{Error, Result};

/// Version of the file layout that this code writes and reads.
const VERSION: u32 = 1;

/// Shape of a model: torque of the joint at standstill over the magnitude of the current.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "snake_case")]
pub enum Curve {
    /// τ = kt I.
    Linear {
        /// N m per A, above zero.
        kt_nm_per_a: f64,
    },
    /// τ = k (I − i0), none below i0.
    Affine {
        /// Current at which torque begins, mA, zero or more.
        i0_ma: f64,
        /// N m per A, above zero.
        k_nm_per_a: f64,
    },
    /// τ = c √I: a current that is measured at the supply and not in the winding.
    Sqrt {
        /// N m per √A, above zero.
        c_nm_per_sqrt_a: f64,
    },
    /// Straight lines between points; no torque below the first, nothing known above the last.
    Table {
        /// Currents, mA, strictly increasing, the first zero or more.
        current_ma: Vec<f64>,
        /// Torques, N m, strictly increasing, the first zero.
        torque_nm: Vec<f64>,
    },
}

/// Where a model comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Who measured what and how, or "nominal, not calibrated: …".
    pub source: String,
    /// Day of the measurement, such as "2026-11-21".
    pub date: Option<String>,
    /// Measured pairs behind it; none for a nominal model.
    pub pairs: usize,
    /// Root mean square of torque left unexplained, N m.
    pub residual_nm: Option<f64>,
    /// The same for pairs that the fit had not seen, N m.
    pub cross_validated_nm: Option<f64>,
    /// Smallest and largest current measured, mA.
    pub range_ma: Option<[f64; 2]>,
}

/// A monotone, invertible model between the current of a motor and the torque of its joint, with its origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "File", into = "File")]
pub struct TorqueCurrentModel {
    curve: Curve,
    provenance: Provenance,
    hysteresis: Option<Hysteresis>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    version: u32,
    curve: Curve,
    provenance: Provenance,
    hysteresis: Option<Hysteresis>,
}

impl TryFrom<File> for TorqueCurrentModel {
    type Error = Error;

    fn try_from(file: File) -> Result<Self> {
        if file.version != VERSION {
            return Err(Error::value(
                format!("a torque model of version {}", file.version),
                format!("this program reads version {VERSION}; fit the model again"),
            ));
        }
        Self::new(file.curve, file.provenance, file.hysteresis)
    }
}

impl From<TorqueCurrentModel> for File {
    fn from(model: TorqueCurrentModel) -> Self {
        Self { version: VERSION, curve: model.curve, provenance: model.provenance, hysteresis: model.hysteresis }
    }
}

impl TorqueCurrentModel {
    /// A model of this shape.
    ///
    /// # Errors
    /// [`Error::Value`] for a number that means nothing, [`Error::NotMonotone`] for a table that does not rise.
    pub fn new(curve: Curve, provenance: Provenance, hysteresis: Option<Hysteresis>) -> Result<Self> {
        curve.check()?;
        if let Some(h) = &hysteresis {
            h.check()?;
        }
        Ok(Self { curve, provenance, hysteresis })
    }

    /// Torque of the joint at the magnitude of a current, N m; the sign of the current is kept.
    ///
    /// # Errors
    /// [`Error::Value`] unless the current is finite, [`Error::OutOfRange`] beyond the end of a table.
    pub fn torque_nm(&self, current_ma: f64) -> Result<f64> {
        finite(current_ma, "mA")?;
        let i = current_ma.abs();
        if i > self.max_current_ma() {
            return Err(Error::OutOfRange {
                value: i,
                unit: "mA",
                most: self.max_current_ma(),
                remedy: "calibrate up to this current",
            });
        }
        Ok(self.curve.torque(i).copysign(current_ma))
    }

    /// Current at which the joint gives a torque, mA; the sign of the torque is kept. No torque asks for the largest current that gives none.
    ///
    /// # Errors
    /// [`Error::Value`] unless the torque is finite, [`Error::OutOfRange`] beyond the end of a table.
    pub fn current_ma(&self, torque_nm: f64) -> Result<f64> {
        finite(torque_nm, "N m")?;
        let tau = torque_nm.abs();
        if tau > self.max_torque_nm() {
            return Err(Error::OutOfRange {
                value: tau,
                unit: "N m",
                most: self.max_torque_nm(),
                remedy: "ask for less, or calibrate up to this torque",
            });
        }
        let i = self.curve.current(tau);
        finite(i, "mA")?;
        Ok(i.copysign(torque_nm))
    }

    /// Largest current that the model speaks of, mA; infinite unless it is a table.
    pub fn max_current_ma(&self) -> f64 {
        match &self.curve {
            Curve::Table { current_ma, .. } => current_ma.last().copied().unwrap_or(0.0),
            _ => f64::INFINITY,
        }
    }

    /// Largest torque that the model speaks of, N m; infinite unless it is a table.
    pub fn max_torque_nm(&self) -> f64 {
        match &self.curve {
            Curve::Table { torque_nm, .. } => torque_nm.last().copied().unwrap_or(0.0),
            _ => f64::INFINITY,
        }
    }

    /// The shape.
    pub fn curve(&self) -> &Curve {
        &self.curve
    }

    /// Where it comes from; belongs into the log of every run.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// How much the torque differs between pressing harder and letting go, where it was measured.
    pub fn hysteresis(&self) -> Option<&Hysteresis> {
        self.hysteresis.as_ref()
    }

    /// Whether somebody measured it.
    pub fn is_calibrated(&self) -> bool {
        self.provenance.pairs > 0
    }
}

impl Curve {
    /// Torque, N m, at a current of zero or more, mA; a table ends at its last point.
    pub(super) fn torque(&self, i_ma: f64) -> f64 {
        match self {
            Self::Linear { kt_nm_per_a } => kt_nm_per_a * i_ma * 1e-3,
            Self::Affine { i0_ma, k_nm_per_a } => k_nm_per_a * (i_ma - i0_ma).max(0.0) * 1e-3,
            Self::Sqrt { c_nm_per_sqrt_a } => c_nm_per_sqrt_a * (i_ma * 1e-3).sqrt(),
            Self::Table { current_ma, torque_nm } => interpolate(current_ma, torque_nm, i_ma),
        }
    }

    /// Current, mA, at a torque of zero or more, N m.
    fn current(&self, tau_nm: f64) -> f64 {
        match self {
            Self::Linear { kt_nm_per_a } => tau_nm / kt_nm_per_a * 1e3,
            Self::Affine { i0_ma, k_nm_per_a } => i0_ma + tau_nm / k_nm_per_a * 1e3,
            Self::Sqrt { c_nm_per_sqrt_a } => (tau_nm / c_nm_per_sqrt_a).powi(2) * 1e3,
            Self::Table { current_ma, torque_nm } => interpolate(torque_nm, current_ma, tau_nm),
        }
    }

    fn check(&self) -> Result<()> {
        let slope = |name: &str, value: f64| match value > 0.0 && value.is_finite() {
            true => Ok(()),
            false => {
                Err(Error::value(format!("a torque model with {name} = {value}"), "give a finite number above zero"))
            }
        };
        match self {
            Self::Linear { kt_nm_per_a } => slope("kt_nm_per_a", *kt_nm_per_a),
            Self::Affine { i0_ma, k_nm_per_a } => {
                if !(*i0_ma >= 0.0 && i0_ma.is_finite()) {
                    return Err(Error::value(format!("a torque model that begins at {i0_ma} mA"), "give zero or more"));
                }
                slope("k_nm_per_a", *k_nm_per_a)
            }
            Self::Sqrt { c_nm_per_sqrt_a } => slope("c_nm_per_sqrt_a", *c_nm_per_sqrt_a),
            Self::Table { current_ma, torque_nm } => check_table(current_ma, torque_nm),
        }
    }
}

fn check_table(current_ma: &[f64], torque_nm: &[f64]) -> Result<()> {
    if current_ma.len() != torque_nm.len() || current_ma.len() < 2 {
        return Err(Error::value(
            format!("a table of {} currents and {} torques", current_ma.len(), torque_nm.len()),
            "give two or more of each",
        ));
    }
    if !current_ma.iter().chain(torque_nm).all(|x| x.is_finite()) {
        return Err(Error::value("a table with numbers that are not finite", "give mA and N m"));
    }
    if !(current_ma[0] >= 0.0 && torque_nm[0] == 0.0) {
        return Err(Error::value(
            format!("a table that begins with {} N m at {} mA", torque_nm[0], current_ma[0]),
            "begin with no torque at zero or more mA",
        ));
    }
    for (name, values) in [("the currents of the table", current_ma), ("the torques of the table", torque_nm)] {
        if let Some(w) = values.windows(2).find(|w| !(w[1] > w[0])) {
            return Err(Error::NotMonotone {
                what: format!("{name} ({} after {})", w[1], w[0]),
                remedy: "sort the points and drop those that do not rise".into(),
            });
        }
    }
    Ok(())
}

/// Straight lines between points; constant before the first and after the last.
fn interpolate(x: &[f64], y: &[f64], at: f64) -> f64 {
    let right = x.partition_point(|v| *v <= at);
    match (right.checked_sub(1), x.get(right)) {
        (None, _) => y.first().copied().unwrap_or(0.0),
        (Some(left), None) => y[left],
        (Some(left), Some(_)) => {
            // From the nearer end, so that going there and back again keeps the last digits.
            let s = (at - x[left]) / (x[right] - x[left]);
            if s < 0.5 {
                y[left] + s * (y[right] - y[left])
            } else {
                y[right] - (x[right] - at) / (x[right] - x[left]) * (y[right] - y[left])
            }
        }
    }
}

pub(super) fn finite(value: f64, unit: &str) -> Result<()> {
    match value.is_finite() {
        true => Ok(()),
        false => Err(Error::value(format!("{value} {unit}"), "give a finite number")),
    }
}
