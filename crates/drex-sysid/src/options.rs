//! What is free, what is known, and how hard to look.

use drex_diffsim::ContactOptions;

use crate::ParameterSet;
use crate::calibrate::HandCalibration;

/// How the mass is looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Method {
    /// Scan of all masses, Levenberg-Marquardt, the posterior around the best ones by draws, interval and verdict.
    #[default]
    Lm,
    /// Adam on the logarithm of the mass alone from the first guess, as in the D-REX paper, for comparison: it tells neither an
    /// interval nor whether the recording can weigh the object at all.
    Adam,
}

/// Options of [`crate::identify`]. Build with `IdentifyOptions::default()` and change what differs.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct IdentifyOptions {
    /// What is known beforehand. A friction that is stated here, or set free, overrides that of the recording.
    pub parameters: ParameterSet,
    /// How the mass is looked for.
    pub method: Method,
    /// Range of the first scan over mass, kg; widened when the best mass is at its edge.
    pub scan_kg: [f64; 2],
    /// Points of the scan.
    pub scan_points: usize,
    /// Contact of the simulator.
    pub contact: ContactOptions,
    /// Time step of the simulator, seconds.
    pub dt_s: f64,
    /// Time step of the scan, seconds.
    pub scan_dt_s: f64,
    /// Standard deviation of the readings of a finger's encoder, metres. Where the simulation cannot follow the encoder as
    /// closely, what it misses counts.
    pub encoder_m: f64,
    /// Joint friction of the hand that pushes; without it, it is found in the free motions of the same logs.
    pub hand: Option<HandCalibration>,
    /// Seed of random draws.
    pub seed: u64,
}

impl Default for IdentifyOptions {
    fn default() -> Self {
        Self {
            parameters: ParameterSet::default(),
            method: Method::default(),
            scan_kg: [0.005, 5.0],
            scan_points: 28,
            contact: ContactOptions::default(),
            dt_s: 5e-4,
            scan_dt_s: 2e-3,
            encoder_m: 1e-4,
            hand: None,
            seed: 0,
        }
    }
}
