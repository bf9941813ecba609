//! Force closure: can the contacts resist a wrench in every direction, and how well?

use nalgebra::{Matrix6xX, Point3, Vector3};
use serde::Serialize;

use crate::ball::largest_ball;
use crate::cone::{Affine, Answer, ConeProgram};
use crate::contact::validate;
use crate::{Contact, GraspError, Result, characteristic_length_m, grasp_map};

/// How force closure is evaluated.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ClosureOptions {
    /// Torques are taken about this point (the centre of mass), object frame.
    pub origin: Point3<f64>,
    /// Torques are divided by this length, metres; `None` takes [`characteristic_length_m`].
    pub length_m: Option<f64>,
    /// Soft fingers: the torque about the normal is at most this many metres times the normal force. `None`: point contacts.
    pub torsion_m: Option<f64>,
    /// Sides of the friction pyramids for `min_weight`; FRoGGeR uses 4.
    pub min_weight_sides: usize,
    /// Where the pyramids' first edges lie: this direction (object frame) projected onto each contact's plane. `None` takes
    /// the tangent of [`Contact::axes`]. A pyramid is not round, so min-weight depends on it; FRoGGeR uses (1.2, 2.3, 3.4).
    pub tangent: Option<Vector3<f64>>,
}

impl Default for ClosureOptions {
    fn default() -> Self {
        Self { origin: Point3::origin(), length_m: None, torsion_m: None, min_weight_sides: 4, tangent: None }
    }
}

impl ClosureOptions {
    /// The defaults with torques about `origin`.
    pub fn about(origin: Point3<f64>) -> Self {
        Self { origin, ..Self::default() }
    }

    /// The same with soft fingers of torsional friction `torsion_m`, metres.
    pub fn with_torsion_m(mut self, torsion_m: f64) -> Self {
        self.torsion_m = Some(torsion_m);
        self
    }

    /// The same with pyramids turned towards `tangent`, object frame.
    pub fn with_tangent(mut self, tangent: Vector3<f64>) -> Self {
        self.tangent = Some(tangent);
        self
    }
}

/// Whether and how well the contacts hold the object in every direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ForceClosure {
    /// Whether forces strictly inside all cones balance and the contacts span all six directions
    /// (Murray, Li, Sastry, proposition 5.3). Exact circular cones.
    pub closed: bool,
    /// Ferrari-Canny quality: radius of the largest ball about the origin inside the hull of the wrenches of unit normal force
    /// (Ferrari, Canny 1992, the L1 form),
    /// circular cones, torques divided by `length_m`. Zero if not closed. Found by local search from many starts: an upper bound, in practice the value.
    pub epsilon: f64,
    /// FRoGGeR's min-weight: the largest l with Σ aᵢ wᵢ = 0, Σ aᵢ = 1, aᵢ >= l over the pyramid's edge wrenches wᵢ. Zero if there is none.
    pub min_weight: f64,
    /// The length that torques were divided by, metres.
    pub length_m: f64,
}

/// Evaluates the force closure of `contacts`.
///
/// # Errors
/// If a contact or an option is invalid, or the solver gives up. No contacts at all is simply not closed.
pub fn force_closure(contacts: &[Contact], options: &ClosureOptions) -> Result<ForceClosure> {
    validate(contacts)?;
    check_pyramid(options)?;
    let length_m = options.length_m.unwrap_or_else(|| characteristic_length_m(contacts, &options.origin));
    if !(length_m > 0.0 && length_m.is_finite()) {
        return Err(GraspError::value(format!("the torque length is {length_m} m"), "give a positive length"));
    }
    let open = ForceClosure { closed: false, epsilon: 0.0, min_weight: 0.0, length_m };
    if contacts.is_empty() {
        return Ok(open);
    }
    let g = scaled_map(contacts, options, length_m);
    let closed = closes(contacts, &g, options.torsion_m)?;
    if !closed {
        return Ok(open);
    }
    let epsilon = largest_ball(contacts, &g, options.torsion_m.unwrap_or(0.0) / length_m)?;
    let min_weight = weight_of(contacts, &g, options)?.max(0.0);
    Ok(ForceClosure { closed, epsilon, min_weight, length_m })
}

/// Only the yes or no of [`force_closure`]: one cone programme.
///
/// # Errors
/// As [`force_closure`].
pub fn is_force_closed(contacts: &[Contact], origin: &Point3<f64>, torsion_m: Option<f64>) -> Result<bool> {
    validate(contacts)?;
    let mut options = ClosureOptions::about(*origin);
    options.torsion_m = torsion_m;
    closes(contacts, &scaled_map(contacts, &options, characteristic_length_m(contacts, origin)), torsion_m)
}

fn closes(contacts: &[Contact], g: &Matrix6xX<f64>, torsion_m: Option<f64>) -> Result<bool> {
    Ok(spans_all(contacts, g, torsion_m) && balance_margin(contacts, g, torsion_m)? > 1e-6)
}

/// Grasp map with torques in units of force.
fn scaled_map(contacts: &[Contact], options: &ClosureOptions, length_m: f64) -> Matrix6xX<f64> {
    let mut g = grasp_map(contacts, &options.origin);
    g.rows_mut(3, 3).scale_mut(1.0 / length_m);
    g
}

/// Whether the directions in which the contacts can push at all span six dimensions.
fn spans_all(contacts: &[Contact], g: &Matrix6xX<f64>, torsion_m: Option<f64>) -> bool {
    let mut columns = Vec::new();
    for (i, c) in contacts.iter().enumerate() {
        columns.push(g.column(3 * i).into_owned());
        if c.friction > 0.0 {
            columns.push(g.column(3 * i + 1).into_owned());
            columns.push(g.column(3 * i + 2).into_owned());
        }
        if torsion_m.is_some_and(|t| t > 0.0) {
            let mut twist = nalgebra::Vector6::zeros();
            twist.fixed_rows_mut::<3>(3).copy_from(&c.normal);
            columns.push(twist);
        }
    }
    if columns.len() < 6 {
        return false;
    }
    let gram = columns.iter().map(|c| c * c.transpose()).sum::<nalgebra::Matrix6<f64>>();
    let eigenvalues = gram.symmetric_eigenvalues();
    // Eigenvalues are squares: 1e-8 is a singular value ratio of 1e-4, well below any real grasp and above rounding.
    eigenvalues.min() > 1e-8 * eigenvalues.max()
}

/// The largest t such that forces with Σ f_n = 1 balance and stay a distance t inside their cones.
fn balance_margin(contacts: &[Contact], g: &Matrix6xX<f64>, torsion_m: Option<f64>) -> Result<f64> {
    let n = contacts.len();
    let torsion = torsion_m.filter(|&t| t > 0.0);
    let t = 3 * n + if torsion.is_some() { n } else { 0 };
    let mut program = ConeProgram::new(t + 1);
    program.cost(t, -1.0);
    program.zero(Affine::new((0..n).map(|i| (3 * i, 1.0)).collect(), -1.0));
    for row in 0..6 {
        let mut terms: Vec<(usize, f64)> = (0..3 * n).map(|j| (j, g[(row, j)])).collect();
        if torsion.is_some() && row >= 3 {
            terms.extend(contacts.iter().enumerate().map(|(i, c)| (3 * n + i, c.normal[row - 3])));
        }
        program.zero(Affine::new(terms, 0.0));
    }
    for (i, c) in contacts.iter().enumerate() {
        program.nonnegative(Affine::new(vec![(3 * i, 1.0), (t, -1.0)], 0.0));
        if c.friction > 0.0 {
            program.second_order(vec![
                Affine::new(vec![(3 * i, c.friction), (t, -c.friction)], 0.0),
                Affine::var(3 * i + 1, 1.0),
                Affine::var(3 * i + 2, 1.0),
            ]);
        } else {
            program.zero(Affine::var(3 * i + 1, 1.0));
            program.zero(Affine::var(3 * i + 2, 1.0));
        }
        if torsion.is_some() {
            // The scale of the torsion does not matter for closure, only that there is some.
            for sign in [1.0, -1.0] {
                program.nonnegative(Affine::new(vec![(3 * i, 1.0), (t, -1.0), (3 * n + i, sign)], 0.0));
            }
        }
    }
    match program.minimise()? {
        Answer::Solved { x } => Ok(x[t]),
        Answer::Infeasible | Answer::Unbounded => Ok(f64::NEG_INFINITY),
    }
}

/// Only the min-weight of [`force_closure`], and with its sign: one linear programme. Negative if the edges balance only
/// with a negative weight, minus infinity if they do not balance at all.
///
/// # Errors
/// As [`force_closure`].
pub fn min_weight(contacts: &[Contact], options: &ClosureOptions) -> Result<f64> {
    validate(contacts)?;
    check_pyramid(options)?;
    if contacts.is_empty() {
        return Ok(f64::NEG_INFINITY);
    }
    let length_m = characteristic_length_m(contacts, &options.origin);
    weight_of(contacts, &scaled_map(contacts, options, length_m), options)
}

fn check_pyramid(options: &ClosureOptions) -> Result<()> {
    if !(3..=64).contains(&options.min_weight_sides) {
        return Err(GraspError::value(
            format!("a friction pyramid with {} sides", options.min_weight_sides),
            "give min_weight_sides of 3 to 64",
        ));
    }
    if options.tangent.is_some_and(|t| !(t.norm() > 0.0 && t.norm().is_finite())) {
        return Err(GraspError::value("the pyramids' tangent has no direction", "give a vector that is not zero"));
    }
    Ok(())
}

/// Angle from the first tangent of the contact's axes to the direction asked for, projected.
fn pyramid_angle(contact: &Contact, tangent: Option<Vector3<f64>>) -> f64 {
    let Some(wanted) = tangent else { return 0.0 };
    let axes = contact.axes();
    let (along, across) = (wanted.dot(&axes.column(1)), wanted.dot(&axes.column(2)));
    // A direction along the normal leaves the contact's own tangent.
    if along.hypot(across) > 1e-9 * wanted.norm() { across.atan2(along) } else { 0.0 }
}

/// FRoGGeR's linear programme (Li et al., 2023, eq. 6).
fn weight_of(contacts: &[Contact], g: &Matrix6xX<f64>, options: &ClosureOptions) -> Result<f64> {
    let sides = options.min_weight_sides;
    let mut edges = Vec::new();
    for (i, c) in contacts.iter().enumerate() {
        // A frictionless contact has one edge, its normal.
        let count = if c.friction > 0.0 { sides } else { 1 };
        let turn = pyramid_angle(c, options.tangent);
        for k in 0..count {
            let (s, co) = (turn + std::f64::consts::TAU * k as f64 / sides as f64).sin_cos();
            edges.push(g.column(3 * i) + (g.column(3 * i + 1) * co + g.column(3 * i + 2) * s) * c.friction);
        }
    }
    let l = edges.len();
    let mut program = ConeProgram::new(l + 1);
    program.cost(l, -1.0);
    program.zero(Affine::new((0..l).map(|j| (j, 1.0)).collect(), -1.0));
    for row in 0..6 {
        program.zero(Affine::new(edges.iter().enumerate().map(|(j, w)| (j, w[row])).collect(), 0.0));
    }
    for j in 0..l {
        program.nonnegative(Affine::new(vec![(j, 1.0), (l, -1.0)], 0.0));
    }
    match program.minimise()? {
        Answer::Solved { x } => Ok(x[l]),
        Answer::Infeasible | Answer::Unbounded => Ok(f64::NEG_INFINITY),
    }
}
