//! Numbers that fill space evenly.

/// Point `i` of an additive recurrence that fills the unit cube evenly (Roberts, "The Unreasonable Effectiveness
/// of Quasirandom Sequences", 2018: steps are powers of the inverse of the root of x⁴ = x + 1).
pub(crate) fn unit_cube_point(i: usize) -> [f64; 3] {
    const ROOT: f64 = 1.220_744_084_605_76;
    let step = 1.0 / ROOT;
    [step, step * step, step * step * step].map(|s| (0.5 + s * i as f64).fract())
}
