//! What a simulation refuses, and why it stops.

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Errors of models, scenes and rollouts. Each names what was wrong, where, and what to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
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
    /// The points of a convex polyhedron span no volume.
    #[error(
        "a convex polyhedron of {points} points spans no volume; give at least four points that do not lie in one plane"
    )]
    FlatPolyhedron {
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
    #[cfg(feature = "ablation")]
    /// The contact is too stiff for the penalty scheme at this step.
    #[error(
        "a step of {dt_s} s needs {substeps:.0} substeps at this contact stiffness; take softer contact or a step near {limit_s:.1e} s"
    )]
    Stiff {
        /// The step asked for.
        dt_s: f64,
        /// Substeps it would need.
        substeps: f64,
        /// A step that is stable by itself.
        limit_s: f64,
    },
    #[cfg(feature = "ablation")]
    /// Explicit Euler has no damping of its own.
    #[error(
        "explicit Euler grows on contact without damping; give relaxation_s and tangential_relaxation_s above zero"
    )]
    Undamped,
    #[cfg(feature = "ablation")]
    /// The method does not simulate articulations.
    #[error("this method steps free bodies only; use Method::SemiImplicit for models with articulations")]
    Method,
    /// The state stopped being finite or left every reasonable range.
    #[error(
        "{body}: the motion diverged at t = {time_s:.4} s (speed {speed:.3e}); take a shorter step, or check forces and masses"
    )]
    Diverged {
        /// Which body or articulation.
        body: String,
        /// Simulated time.
        time_s: f64,
        /// Last speed seen, m/s or rad/s.
        speed: f64,
    },
    /// Something starts deeper inside something else than a quarter of its size.
    #[error(
        "{what} starts {depth_m:.4} m inside {support}, which is more than a quarter of its size; check pose, frame and units"
    )]
    StartsInside {
        /// Which body or link.
        what: String,
        /// Depth.
        depth_m: f64,
        /// What it is inside of.
        support: String,
    },
    /// A contact constant is out of range.
    #[error(
        "contact constant {name} is {value}; give a finite positive number (relaxation times may be zero, impedances are below one)"
    )]
    Option {
        /// Field of `ContactOptions`.
        name: &'static str,
        /// The value given.
        value: f64,
    },
    /// A coefficient of friction or a torsion radius is negative or not finite.
    #[error("{what}: friction {friction} or its torsion radius is negative or not finite; give a number from zero up")]
    Friction {
        /// Whose surface.
        what: String,
        /// The value given.
        friction: f64,
    },
    /// A force acts on something that is not there or cannot move.
    #[error("{what} acts on {part}, which is no body or link of the model; give the index of a body or of a link")]
    Part {
        /// Which force.
        what: String,
        /// What it should act on.
        part: String,
    },
    /// Contact between two shapes is not found.
    #[error("{what}: contact between these kinds of shapes is not found; give one of them convex polyhedra")]
    Unsupported {
        /// Which shapes.
        what: String,
    },
    /// Lengths that should agree do not, or times do not increase.
    #[error("{what}; {remedy}")]
    Series {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A joint, link or drive of a robot cannot be simulated as it stands, or is not there.
    #[error("robot \"{robot}\", joint \"{joint}\": {what}; {remedy}")]
    Joint {
        /// Name of the robot.
        robot: String,
        /// Name of the joint, or "link ..." where a link is meant.
        joint: String,
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// The controls of a robot's drives.
    #[error("robot \"{robot}\": {what}; {remedy}")]
    Control {
        /// Name of the robot.
        robot: String,
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
