//! From a grasp to what the hand is told: rehearse the closing, then solve for the squeeze on the contacts that it gives.

use drex_core::Pose;
use drex_grasp::{Contact, SqueezeError, SqueezeProblem, TorqueLimits, smallest_forces};
use nalgebra::{DVector, Point3, Vector3};

use crate::control::{Controller, Push};
use crate::engine::{Met, Touch};
use crate::reach;
use crate::trial::STEPS_PER_TICK;
use crate::types::check_mass_and_friction;
use crate::{Belief, Command, Error, Judge, NoCommand, Result, Squeeze, Trial, Truth, timeline};

/// Contacts nearer to each other than this on one link count as one, m.
const SAME_M: f64 = 0.004;

/// See [`Trial::command`].
pub(crate) fn plan(
    trial: &Trial,
    joints: &[f64],
    object_from_palm: &Pose,
    belief: &Belief,
    squeeze: Squeeze,
) -> Result<Result<Command, NoCommand>> {
    check_mass_and_friction(belief.mass_kg, belief.friction)?;
    if joints.len() != trial.hand.dof() || joints.iter().any(|q| !q.is_finite()) {
        return Err(Error::value(
            format!("{} joint angles for the {} joints of {}", joints.len(), trial.hand.dof(), trial.hand.name),
            "give one finite angle per joint, in the model's order",
        ));
    }
    let object = &trial.object;
    let reach = reach::plan(
        &trial.hand,
        &trial.surface,
        joints,
        object_from_palm,
        object.surface.as_ref(),
        &object.world_from_object,
    );
    let mut command = Command {
        joints: joints.to_vec(),
        world_from_palm: object.world_from_object * object_from_palm,
        torques_nm: vec![0.0; joints.len()],
        squeeze_n: 0.0,
        per_finger_n: vec![0.0; trial.surface.fingers.len()],
        pushes: Vec::new(),
        reach,
    };
    let (closed, touches) = rehearse(trial, &command, belief)?;
    let mut touching = vec![false; trial.surface.fingers.len()];
    touches.iter().filter_map(|t| trial.surface.finger_of_link[t.link]).for_each(|f| touching[f] = true);
    let count = touching.iter().filter(|t| **t).count();
    if count < 2 {
        return Ok(Err(NoCommand::NoContact { touching: count }));
    }
    let problem = problem(trial, &closed, &command.world_from_palm, &touches, belief)?;
    let forces = match forces(trial, &problem, squeeze) {
        Ok(forces) => forces,
        Err(SqueezeError::Input(error)) => return Err(error.into()),
        Err(reason @ SqueezeError::Torque { .. }) => return Ok(Err(NoCommand::TorqueLimit(reason.to_string()))),
        Err(reason @ SqueezeError::NormalForce { .. }) => return Ok(Err(NoCommand::Crushes(reason.to_string()))),
        Err(reason) => return Ok(Err(NoCommand::CannotCarry(reason.to_string()))),
    };
    let poses = trial.hand.forward_kinematics(&closed, &command.world_from_palm);
    for (contact, force) in problem.contacts.iter().zip(&forces) {
        let normal_n = force.dot(&contact.normal);
        command.squeeze_n += normal_n;
        if let Some(f) = contact.finger {
            command.per_finger_n[f] += normal_n;
        }
        let point = poses[contact.link].inverse_transform_point(&contact.point);
        command.pushes.push(Push { link: contact.link, point, force: *force });
    }
    command.torques_nm =
        crate::control::squeeze_torques(&trial.hand, &closed, &command.world_from_palm, &command.pushes);
    Ok(Ok(command))
}

/// Joint angles and contacts after closing on the believed object.
fn rehearse(trial: &Trial, command: &Command, belief: &Belief) -> Result<(Vec<f64>, Vec<Touch>)> {
    let truth = Truth::as_believed(belief, 0);
    let (mut engine, drives) = trial.engine(command, &truth, timeline::CLOSED_S, Judge::Diffsim)?;
    let mut controller =
        Controller::new(&trial.hand, &drives, &command.reach, &command.pushes, trial.options.torque_cap_nm);
    let tick_s = trial.options.dt_s * STEPS_PER_TICK as f64;
    let mut touches = Vec::new();
    for i in 0..(timeline::CLOSED_S / tick_s) as usize {
        let told = controller.command(i as f64 * tick_s, &engine);
        for _ in 0..STEPS_PER_TICK {
            engine.step(&told)?;
        }
    }
    engine.touches(&mut touches);
    touches.retain(|t| t.with == Met::Object);
    Ok((engine.joints().to_vec(), touches))
}

/// The cone programme of a closed hand, in world axes about the world's origin.
fn problem(
    trial: &Trial,
    closed: &[f64],
    world_from_palm: &Pose,
    touches: &[Touch],
    belief: &Belief,
) -> Result<SqueezeProblem> {
    let mut contacts: Vec<Contact> = Vec::new();
    let mut by_force: Vec<&Touch> = touches.iter().collect();
    by_force.sort_by(|a, b| b.normal_n.total_cmp(&a.normal_n));
    for touch in by_force {
        let point = Point3::from(touch.point);
        if contacts.iter().any(|c| c.link == touch.link && (c.point - point).norm() < SAME_M) {
            continue;
        }
        let friction = belief.friction * (1.0 - trial.options.friction_uncertainty);
        let mut contact = Contact::new(point, touch.inward, friction);
        contact.link = touch.link;
        contact.finger = trial.surface.finger_of_link[touch.link];
        contacts.push(contact);
    }
    let poses = trial.hand.forward_kinematics(closed, world_from_palm);
    let jacobians = contacts.iter().map(|c| trial.hand.jacobian(&poses, c.link, &c.point).0).collect();
    let down = Vector3::new(0.0, 0.0, -9.81);
    let own = trial.hand.gravity_torque(closed, &(world_from_palm.rotation.inverse() * down));
    let limits_nm = trial
        .hand
        .joints
        .iter()
        .map(|j| {
            let cap = (trial.options.torque_cap_nm - j.friction_loss).max(0.0);
            (-cap, cap)
        })
        .collect();
    let centre = trial.object.world_from_object * trial.object.properties.center_of_mass;
    let mut problem = SqueezeProblem::new(contacts, belief.mass_kg, centre, down).with_torques(TorqueLimits {
        jacobians,
        limits_nm,
        gravity_nm: DVector::from_column_slice(own.as_slice()),
    });
    problem.max_normal_n = trial.object.max_finger_n;
    Ok(problem)
}

/// Forces of the squeeze on the object, world, N.
fn forces(trial: &Trial, problem: &SqueezeProblem, squeeze: Squeeze) -> Result<Vec<Vector3<f64>>, SqueezeError> {
    let _ = squeeze;
    let mut narrowed = problem.clone();
    let factor = trial.options.margin * (1.0 + trial.options.shake_m_s2 / 9.81);
    narrowed.contacts.iter_mut().for_each(|c| c.friction /= factor);
    let f = smallest_forces(&narrowed)?;
    Ok(problem.contacts.iter().zip(&f).map(|(c, f)| c.axes() * f).collect())
}
