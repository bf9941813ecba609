//! The largest ball about the origin inside the hull of the wrenches of unit normal force (Ferrari-Canny, L1).
//!
//! The hull's support function is known in closed form, circular cones and all: h(u) = max over contacts of
//! (Gᵢᵀu)_n + μ |(Gᵢᵀu)_t| (+ γ |nᵢ·u_torque| for soft fingers). The radius is the least h over unit vectors, that is one over the length of the longest y with
//! h(y) <= 1 (the polar body). That is a convex function maximised over a convex body: from a direction d, the y that
//! reaches furthest along d (a small cone programme) is the next d, until it stops growing. Every stop is a local maximum and so
//! gives an upper bound on the radius; starts along the grasp's own axes make it the global one in practice (facets of hulls
//! in six dimensions are too many to list: a hundred thousand for six contacts).

use nalgebra::{Matrix6, Matrix6xX, SymmetricEigen, Vector6};

use crate::cone::{Affine, Answer, ConeProgram};
use crate::{Contact, Result};

/// Growth of |y| below which a start has arrived.
const ARRIVED: f64 = 1e-7;
/// Steps of one start; a handful is usual.
const MAX_STEPS: usize = 30;

/// Radius of the ball for contacts in force closure. `g` is the grasp map with torques already divided by a length,
/// `torsion` the torsional friction of soft fingers divided by the same length (zero for point contacts).
pub(crate) fn largest_ball(contacts: &[Contact], g: &Matrix6xX<f64>, torsion: f64) -> Result<f64> {
    let mut program = ConeProgram::new(6);
    let row = |column: usize, factor: f64, constant: f64| {
        Affine::new((0..6).map(|k| (k, factor * g[(k, column)])).collect(), constant)
    };
    for (i, c) in contacts.iter().enumerate() {
        // With torsion the interval adds to the disc: both of its ends must stay within reach.
        for twist in if torsion > 0.0 { vec![torsion, -torsion] } else { vec![0.0] } {
            let mut top = row(3 * i, -1.0, 1.0);
            top.terms.extend((0..3).map(|k| (3 + k, twist * c.normal[k])));
            if c.friction > 0.0 {
                program.second_order(vec![top, row(3 * i + 1, c.friction, 0.0), row(3 * i + 2, c.friction, 0.0)]);
            } else {
                program.nonnegative(top);
            }
        }
    }
    let mut longest = 0.0_f64;
    for start in starts(contacts, g) {
        let mut direction = start;
        let mut length = 0.0;
        for _ in 0..MAX_STEPS {
            for k in 0..6 {
                program.set_cost(k, -direction[k]);
            }
            // Closed grasps have a bounded polar body with the origin inside: infeasible cannot happen.
            let Answer::Solved { x } = program.minimise()? else { break };
            let y = Vector6::from_column_slice(&x);
            let grown = y.norm();
            let Some(next) = y.try_normalize(1e-12) else { break };
            direction = next;
            if grown <= length * (1.0 + ARRIVED) {
                break;
            }
            length = grown;
        }
        longest = longest.max(length);
    }
    Ok(if longest > 0.0 { 1.0 / longest } else { 0.0 })
}

/// Directions that turn with the grasp: both senses of the principal axes of the contact wrenches, and against each contact's
/// normal and tangents.
fn starts(contacts: &[Contact], g: &Matrix6xX<f64>) -> Vec<Vector6<f64>> {
    let gram: Matrix6<f64> = (0..contacts.len())
        .map(|i| {
            let mu = contacts[i].friction;
            let (n, a, b) = (g.column(3 * i), g.column(3 * i + 1), g.column(3 * i + 2));
            n * n.transpose() + (a * a.transpose() + b * b.transpose()) * (mu * mu)
        })
        .sum();
    let axes = SymmetricEigen::new(gram).eigenvectors;
    let mut list = Vec::new();
    for k in 0..6 {
        let axis: Vector6<f64> = axes.column(k).into_owned();
        list.push(axis);
        list.push(-axis);
    }
    let mean = (0..contacts.len()).map(|i| g.column(3 * i).into_owned()).sum::<Vector6<f64>>();
    list.extend((0..contacts.len()).map(|i| -g.column(3 * i)));
    list.push(-mean);
    list.into_iter().filter_map(|d| d.try_normalize(1e-9)).collect()
}
