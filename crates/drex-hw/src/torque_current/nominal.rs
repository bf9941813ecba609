//! Published numbers, for want of a calibration.

use super::{Curve, Provenance, TorqueCurrentModel};
use crate::{Error, Result};

/// Which published model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Nominal {
    /// XC330-M288 (LEAP): stall torque over stall current at 5 V, 0.517 N m/A.
    Xc330Linear,
    /// XC330-M288: the stall point with torque over the root of the supply's current.
    Xc330Sqrt,
    /// XC330-M288: the shape measured on an XC330-T181, 16.1 mA and 2.23 mA per mN m.
    Xc330Affine,
    /// XL330-M288 (LEAP lite): stall torque over stall current at 5 V, 0.354 N m/A.
    Xl330Linear,
    /// XL330-M288: the stall point with torque over the root of the supply's current, as measured on that motor.
    Xl330Sqrt,
    /// Torque per current that public simulations of the LEAP hand use, 0.53 N m/A.
    LeapSimulation,
    /// Allegro V5: the vendor driver's 1430 mA per N m.
    AllegroV5,
}

impl Nominal {
    /// Published models of an XC330-M288; the first is the data sheet's.
    pub const XC330: &[Self] = &[Self::Xc330Linear, Self::Xc330Sqrt, Self::Xc330Affine, Self::LeapSimulation];
    /// Published models of an XL330-M288; the first is the data sheet's.
    pub const XL330: &[Self] = &[Self::Xl330Linear, Self::Xl330Sqrt];
    /// Published models of a joint of an Allegro V5: the vendor's driver, and the data sheet of the servo that it seems to be.
    pub const V5: &[Self] = &[Self::AllegroV5, Self::Xc330Linear];

    /// Least and largest torque, N m, that some published models give at one current, mA.
    ///
    /// # Errors
    /// As [`TorqueCurrentModel::torque_nm`], and for no models.
    pub fn spread_nm(models: &[Self], current_ma: f64) -> Result<(f64, f64)> {
        let torques: Result<Vec<f64>> =
            models.iter().map(|m| TorqueCurrentModel::nominal(*m)?.torque_nm(current_ma)).collect();
        let torques = torques?;
        let ends = torques.iter().copied().reduce(f64::min).zip(torques.iter().copied().reduce(f64::max));
        ends.ok_or_else(|| Error::value("the spread of no torque-current model", "name some"))
    }
}

impl TorqueCurrentModel {
    /// A published model; its provenance says that it is not calibrated.
    ///
    /// # Errors
    /// None with the numbers given here; those of [`TorqueCurrentModel::new`].
    pub fn nominal(which: Nominal) -> Result<Self> {
        let (curve, source) = match which {
            Nominal::Xc330Linear => {
                (Curve::Linear { kt_nm_per_a: 0.93 / 1.80 }, "XC330-M288 data sheet, stall 0.93 N m at 1.80 A, 5 V")
            }
            Nominal::Xc330Sqrt => (
                Curve::Sqrt { c_nm_per_sqrt_a: 0.93 / 1.80_f64.sqrt() },
                "XC330-M288 data sheet, stall point, root model of a current sensed at the supply",
            ),
            Nominal::Xc330Affine => (
                Curve::Affine { i0_ma: 16.1, k_nm_per_a: 1.0 / 2.23 },
                "bench of an XC330-T181 at 12 V, 8 to 50 mN m: the shape of another winding",
            ),
            Nominal::Xl330Linear => {
                (Curve::Linear { kt_nm_per_a: 0.52 / 1.47 }, "XL330-M288 data sheet, stall 0.52 N m at 1.47 A, 5 V")
            }
            Nominal::Xl330Sqrt => (
                Curve::Sqrt { c_nm_per_sqrt_a: 0.52 / 1.47_f64.sqrt() },
                "XL330-M288 data sheet, stall point, root model as in a public stall test",
            ),
            Nominal::LeapSimulation => (Curve::Linear { kt_nm_per_a: 0.53 }, "public simulations of the LEAP hand"),
            Nominal::AllegroV5 => (
                Curve::Linear { kt_nm_per_a: 1.0 / 1.43 },
                "driver of the Allegro V5; does not agree with the data sheet of a servo of its class",
            ),
        };
        let provenance = Provenance {
            source: format!("nominal, not calibrated: {source}"),
            date: None,
            pairs: 0,
            residual_nm: None,
            cross_validated_nm: None,
            range_ma: None,
        };
        Self::new(curve, provenance, None)
    }
}
