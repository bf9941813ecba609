//! What a simulation refuses, and why it stops.

/// Result of this crate.
pub type Result<T, E = SimError> = std::result::Result<T, E>;

/// Errors of models, scenes and rollouts. Each names what was wrong, where, and what to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// The mass is zero, negative or not finite.
    #[error("body {body}: mass {mass_kg} kg is not a positive number; give the mass in kilograms")]
    Mass {
        /// Index of the body in the model.
        body: usize,
        /// The value given.
        mass_kg: f64,
    },
    /// No real body has this inertia.
    #[error(
        "body {body}: principal moments {moments:?} (per kg, m²) are no rigid body's (positive, none above the sum of the others); \
         check the mesh, its scale and its winding"
    )]
    Inertia {
        /// Index of the body in the model.
        body: usize,
        /// Principal moments per kilogram, m².
        moments: [f64; 3],
    },
    /// A number that should be finite is not.
    #[error("{what} is not finite; check the input")]
    NotFinite {
        /// Which quantity.
        what: String,
    },
    /// The points of a convex piece span no volume.
    #[error(
        "a convex piece of {points} points spans no volume; give at least four points that do not lie in one plane"
    )]
    FlatPiece {
        /// Number of points given.
        points: usize,
    },
    /// The time step is not positive or too long to notice contact in time.
    #[error("time step {dt_s} s is outside (0, {limit_s}] s; half a millisecond is usual")]
    TimeStep {
        /// The step asked for.
        dt_s: f64,
        /// The longest accepted one.
        limit_s: f64,
    },
    /// The state stopped being finite or left every reasonable range.
    #[error(
        "body {body}: the motion diverged at t = {time_s:.4} s (speed {speed:.3e} m/s); take a shorter step, or check forces and masses"
    )]
    Diverged {
        /// Index of the body in the model.
        body: usize,
        /// Simulated time.
        time_s: f64,
        /// Last speed seen.
        speed: f64,
    },
    /// The start state penetrates its support deeper than a quarter of the body.
    #[error(
        "body {body}: it starts {depth_m:.4} m inside {support}, which is more than a quarter of its size; check pose, frame and units"
    )]
    StartsInside {
        /// Index of the body in the model.
        body: usize,
        /// Depth.
        depth_m: f64,
        /// "the table" or "box i".
        support: String,
    },
    /// Lengths that should agree do not, or times do not increase.
    #[error("{what}; {remedy}")]
    Series {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A shape that no body can have.
    #[error("{what}; {remedy}")]
    Shape {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
}
