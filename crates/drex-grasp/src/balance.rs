//! Forces that balance a load: the one cone programme behind every question of this crate about newtons.
//!
//! Unknowns: normal and two tangential forces of each contact in [`Contact::axes`](crate::Contact::axes), with soft fingers their
//! torsion, and with [`Goal::Slack`] the slack. What all have in common: G f = −w, |f_t| <= μ f_n, floor <= f_n <= ceiling,
//! τ_min <= Jᵀ f + τ_gravity <= τ_max.

use nalgebra::{Matrix3xX, Vector3, Vector6};

use crate::cone::{Affine, Answer, ConeProgram};
use crate::{Contact, GripForceProblem, Result, characteristic_length_m, grasp_map};

/// Which limits a programme keeps.
#[derive(Clone, Copy)]
pub(crate) struct Limits {
    pub(crate) normal: bool,
    pub(crate) torque: bool,
}

impl Limits {
    pub(crate) const ALL: Self = Self { normal: true, torque: true };
}

/// What is sought among the forces that balance.
#[derive(Clone, Copy)]
pub(crate) enum Goal {
    /// The smallest sum of normal forces.
    Smallest,
    /// The largest sum of normal forces.
    Largest,
    /// The largest slack s with |f_t| + μ s / k <= μ f_n, k the contacts of the patch, at this sum of normal forces, N.
    Slack { total_n: f64 },
}

/// The answer.
pub(crate) enum Outcome {
    /// Forces in contact axes, N, and the slack, N (zero unless it was the goal).
    Forces {
        forces: Vec<Vector3<f64>>,
        slack_n: f64,
    },
    Infeasible,
    /// Only for [`Goal::Largest`]: nothing bounds the sum.
    Unbounded,
}

/// How much the even distribution weighs against slack: enough to make the answer unique, too little to cost slack.
const EVENNESS: f64 = 1e-4;

/// Solves the programme for `load` (force and torque about the centre of mass, object frame) with all friction
/// coefficients times `friction_scale`. The problem must have passed its checks.
pub(crate) fn balance(
    problem: &GripForceProblem,
    load: &Vector6<f64>,
    friction_scale: f64,
    limits: Limits,
    goal: Goal,
) -> Result<Outcome> {
    let contacts = &problem.contacts;
    let n = contacts.len();
    let length = characteristic_length_m(contacts, &problem.center_of_mass);
    let Some(unit) = force_unit(problem, load, length, goal) else {
        // With no load and no floor the minimum grip force is none, provided that the hand can hold itself.
        let none = Outcome::Forces { forces: vec![Vector3::zeros(); n], slack_n: 0.0 };
        return Ok(if !limits.torque || holds_itself(problem) { none } else { Outcome::Infeasible });
    };
    let g = grasp_map(contacts, &problem.center_of_mass);
    let torsion = problem.torsion_m.filter(|&t| t > 0.0);
    let slack = matches!(goal, Goal::Slack { .. }).then_some(3 * n + if torsion.is_some() { n } else { 0 });
    let mut program = ConeProgram::new(slack.map_or(3 * n + if torsion.is_some() { n } else { 0 }, |s| s + 1));
    for row in 0..6 {
        let scale = if row < 3 { 1.0 } else { 1.0 / length };
        let mut terms: Vec<(usize, f64)> = (0..3 * n).map(|j| (j, g[(row, j)] * scale)).collect();
        if let (Some(t), true) = (torsion, row >= 3) {
            // The torsional unknown is torque / torsion_m, a force, to keep the columns alike.
            terms.extend(contacts.iter().enumerate().map(|(i, c)| (3 * n + i, c.normal[row - 3] * t * scale)));
        }
        program.zero(Affine::new(terms, load[row] * scale / unit));
    }
    match goal {
        Goal::Smallest => (0..n).for_each(|i| program.cost(3 * i, 1.0)),
        Goal::Largest => (0..n).for_each(|i| program.cost(3 * i, -1.0)),
        Goal::Slack { total_n } => {
            program.zero(Affine::new((0..n).map(|i| (3 * i, 1.0)).collect(), -total_n / unit));
            (0..3 * n).for_each(|j| program.quadratic(j, EVENNESS));
        }
    }
    if let Some(s) = slack {
        program.cost(s, -1.0);
    }
    for (i, c) in contacts.iter().enumerate() {
        let floor = if limits.normal { problem.min_normal_n } else { 0.0 };
        program.nonnegative(Affine::new(vec![(3 * i, 1.0)], -floor / unit));
        if let (true, Some(most)) = (limits.normal, problem.max_normal_n) {
            program.nonnegative(Affine::new(vec![(3 * i, -1.0)], most / unit));
        }
        // The normal force that friction may count on.
        let counted: Vec<(usize, f64)> =
            [(3 * i, 1.0)].into_iter().chain(slack.map(|s| (s, -1.0 / patch_size(contacts, i)))).collect();
        let mu = c.friction * friction_scale;
        if mu > 0.0 {
            let radius = counted.iter().map(|&(j, v)| (j, mu * v)).collect();
            program.second_order(vec![
                Affine::new(radius, 0.0),
                Affine::var(3 * i + 1, 1.0),
                Affine::var(3 * i + 2, 1.0),
            ]);
        } else {
            program.zero(Affine::var(3 * i + 1, 1.0));
            program.zero(Affine::var(3 * i + 2, 1.0));
            if slack.is_some() {
                program.nonnegative(Affine::new(counted.clone(), 0.0));
            }
        }
        if torsion.is_some() {
            for sign in [1.0, -1.0] {
                let mut terms: Vec<_> = counted.iter().map(|&(j, v)| (j, friction_scale * v)).collect();
                terms.push((3 * n + i, sign));
                program.nonnegative(Affine::new(terms, 0.0));
            }
        }
    }
    if limits.torque {
        torque_rows(&mut program, problem, unit, length);
    }
    Ok(match program.minimise()? {
        Answer::Solved { x } => Outcome::Forces {
            forces: (0..n).map(|i| Vector3::new(x[3 * i], x[3 * i + 1], x[3 * i + 2]) * unit).collect(),
            slack_n: slack.map_or(0.0, |s| x[s] * unit),
        },
        Answer::Infeasible => Outcome::Infeasible,
        Answer::Unbounded => Outcome::Unbounded,
    })
}

/// Forces are solved for in this unit and torques in it times a length, so that the solver's tolerances are relative.
/// `None` if nothing acts and nothing is asked.
fn force_unit(problem: &GripForceProblem, load: &Vector6<f64>, length: f64, goal: Goal) -> Option<f64> {
    let of_load = load.fixed_rows::<3>(0).norm().max(load.fixed_rows::<3>(3).norm() / length);
    let unit = match goal {
        Goal::Smallest if of_load > 0.0 => of_load,
        Goal::Smallest => problem.min_normal_n,
        Goal::Largest => of_load.max(problem.min_normal_n).max(1.0),
        Goal::Slack { total_n } => of_load.max(total_n),
    };
    (unit > 0.0).then_some(unit)
}

/// The motors as rows, in units of force times length as well.
fn torque_rows(program: &mut ConeProgram, problem: &GripForceProblem, unit: f64, length: f64) {
    let Some(torques) = &problem.torques else { return };
    let n = problem.contacts.len();
    let rows: Vec<Matrix3xX<f64>> =
        problem.contacts.iter().zip(&torques.jacobians).map(|(c, j)| c.axes().transpose() * j).collect();
    for (joint, &(lower, upper)) in torques.limits_nm.iter().enumerate() {
        let row = |sign: f64| (0..3 * n).map(|k| (k, sign * rows[k / 3][(k % 3, joint)] / length)).collect::<Vec<_>>();
        let scale = 1.0 / (unit * length);
        if upper.is_finite() {
            program.nonnegative(Affine::new(row(-1.0), (upper - torques.gravity_nm[joint]) * scale));
        }
        if lower.is_finite() {
            program.nonnegative(Affine::new(row(1.0), (torques.gravity_nm[joint] - lower) * scale));
        }
    }
}

/// Contacts of one link that push about the same way are one patch: they share what is asked of a contact.
pub(crate) fn patch_size(contacts: &[Contact], i: usize) -> f64 {
    let c = &contacts[i];
    let same = |o: &&Contact| o.link == c.link && o.finger == c.finger && o.normal.dot(&c.normal) > 0.5;
    contacts.iter().filter(same).count().max(1) as f64
}

fn holds_itself(problem: &GripForceProblem) -> bool {
    problem.torques.as_ref().is_none_or(|t| {
        t.limits_nm.iter().zip(t.gravity_nm.iter()).all(|(&(lower, upper), &own)| (lower..=upper).contains(&own))
    })
}
