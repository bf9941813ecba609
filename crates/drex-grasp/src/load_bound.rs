//! What the hand can do at all: for each grasp the least friction at which its contacts carry the load within the motors' torques.
//!
//! The load is the weight, and the weight with the shake along each of six directions, each balanced by forces of its own: no way to
//! command the hand can hold more. A rollout is within the bound if any grasp of the library carries the load at its friction.

use drex_core::Object;
use drex_robot::Robot;
use nalgebra::{Vector3, Vector6};
use rayon::prelude::*;

use crate::{
    ContactOptions, Grasp, GraspError, GripForceError, GripForceProblem, HandSurface, Result, TorqueLimits,
    smallest_forces,
};

/// Friction beyond which no finger pad is, and the step to which thresholds are found.
const MOST_FRICTION: f64 = 1.5;
const STEP: f64 = 0.005;

/// Least friction at which any of the grasps carries an object of `mass_kg` that is shaken with `shake_m_s2`; `None` if none does at any.
/// The same for any number of threads.
///
/// # Errors
/// If a grasp is none of this hand.
pub fn least_friction(
    object: &Object,
    robot: &Robot,
    grasps: &[Grasp],
    mass_kg: f64,
    shake_m_s2: f64,
) -> Result<Option<f64>> {
    let surface = HandSurface::new(robot, ContactOptions::default().spacing_m)?;
    // Those that need the least grip force first: they set a threshold that the others rarely beat.
    let mut order: Vec<&Grasp> = grasps.iter().collect();
    let force = |g: &Grasp| g.grip_force_n.unwrap_or(f64::INFINITY);
    order.sort_by(|a, b| force(a).total_cmp(&force(b)));
    let problems: Vec<GripForceProblem> =
        order.par_iter().map(|g| problem(object, robot, &surface, g, mass_kg)).collect::<Result<_>>()?;
    let mut best: Option<f64> = None;
    // One thread: each answer makes the next question cheaper, and the order is fixed.
    let loads = shakes(object, mass_kg, shake_m_s2);
    for problem in &problems {
        let start = best.map_or(MOST_FRICTION, |b| b - STEP);
        if start <= 0.0 || !carries(problem, start, &loads)? {
            continue;
        }
        let (mut no, mut yes) = (0.0, start);
        while yes - no > STEP {
            let middle = 0.5 * (no + yes);
            if carries(problem, middle, &loads)? { yes = middle } else { no = middle }
        }
        best = Some(yes);
    }
    Ok(best)
}

/// For each of the grasps the place of the first of these frictions, in ascending order, at which it carries an object of `mass_kg`, if there is one.
///
/// # Errors
/// If a grasp is none of this hand.
pub fn least_friction_index(
    object: &Object,
    robot: &Robot,
    grasps: &[Grasp],
    mass_kg: f64,
    frictions: &[f64],
    shake_m_s2: f64,
) -> Result<Vec<Option<usize>>> {
    let surface = HandSurface::new(robot, ContactOptions::default().spacing_m)?;
    let loads = shakes(object, mass_kg, shake_m_s2);
    let first = |g: &Grasp| {
        let problem = problem(object, robot, &surface, g, mass_kg)?;
        // More friction is never worse: most grasps carry it at none of them.
        let mut first = None;
        for (at, friction) in frictions.iter().enumerate().rev() {
            if !carries(&problem, *friction, &loads)? {
                break;
            }
            first = Some(at);
        }
        Ok(first)
    };
    grasps.par_iter().map(first).collect()
}

fn problem(
    object: &Object,
    robot: &Robot,
    surface: &HandSurface,
    grasp: &Grasp,
    mass_kg: f64,
) -> Result<GripForceProblem> {
    let pose = grasp.object_from_base;
    let options = ContactOptions::with_friction(MOST_FRICTION);
    let contacts = surface.contacts(robot, &grasp.joints_rad, &pose, object.geometry.exact(), &options)?;
    let gravity = object.table().gravity();
    let torques = TorqueLimits::of_robot(robot, &grasp.joints_rad, &pose, &contacts, &gravity)?;
    let problem = GripForceProblem::new(contacts, mass_kg, object.center_of_mass(), gravity).with_torques(torques);
    Ok(match object.max_finger_n {
        Some(most) => problem.with_max_normal_n(most),
        None => problem,
    })
}

/// Forces on the object, object frame, N: none, and along both senses of the world's axes; the hardest first: downwards.
fn shakes(object: &Object, mass_kg: f64, shake_m_s2: f64) -> Vec<Vector3<f64>> {
    let object_from_world = object.world_from_object.rotation.inverse();
    let axis = |k: usize| object_from_world * Vector3::ith(k, mass_kg * shake_m_s2);
    vec![-axis(2), axis(0), -axis(0), axis(1), -axis(1), axis(2), Vector3::zeros()]
}

/// Whether every load can be carried at this friction.
fn carries(problem: &GripForceProblem, friction: f64, loads: &[Vector3<f64>]) -> Result<bool> {
    let mut problem = problem.clone();
    problem.contacts.iter_mut().for_each(|c| c.friction = friction);
    for force in loads {
        problem.extra_wrench = Vector6::new(force.x, force.y, force.z, 0.0, 0.0, 0.0);
        match smallest_forces(&problem) {
            Ok(_) => {}
            // The solver stops half-way at the very edge of what is possible.
            Err(GripForceError::Input(GraspError::Solver { .. })) => return Ok(false),
            Err(GripForceError::Input(error)) => return Err(error),
            Err(_) => return Ok(false),
        }
    }
    Ok(true)
}
