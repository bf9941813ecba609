//! What is free, what is known, and how hard to look.

use drex_diffsim::ContactOptions;

/// Options of [`crate::identify`]. Build with `IdentifyOptions::default()` and change what differs.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct IdentifyOptions {
    /// Estimate the friction against the support even where the recording states it.
    pub free_friction: bool,
    /// Take the force of a compliant fingertip from its command and encoder and weigh with it. Off by default: where the
    /// tip chatters while it pushes fast, the mass comes out up to 6 % low, and the interval allows for that.
    pub finger_force: bool,
    /// Range of the first scan over mass, kg; widened when the best mass is at its edge.
    pub scan_kg: [f64; 2],
    /// Points of the scan.
    pub scan_points: usize,
    /// Contact of the simulator.
    pub contact: ContactOptions,
    /// Time step of the simulator, seconds.
    pub dt_s: f64,
    /// Prior standard deviation of a constant error of the tracked position along each axis, metres.
    pub position_bias_m: f64,
    /// Prior standard deviation of a constant error of the tracked orientation about each axis, radians.
    pub rotation_bias_rad: f64,
    /// Prior standard deviation of the offset between the clocks of track and force, seconds.
    pub clock_offset_s: f64,
    /// Seed of the draws that carry the noise of the force into the interval.
    pub seed: u64,
}

impl Default for IdentifyOptions {
    fn default() -> Self {
        Self {
            free_friction: false,
            finger_force: false,
            scan_kg: [0.02, 2.0],
            scan_points: 25,
            contact: ContactOptions::default(),
            dt_s: 5e-4,
            position_bias_m: 0.01,
            rotation_bias_rad: 0.02,
            clock_offset_s: 0.035,
            seed: 0,
        }
    }
}
