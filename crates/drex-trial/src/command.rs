//! From a closed hand to what it is commanded: the grip force on the contacts of its closing.

use std::collections::BTreeMap;

use drex_core::Pose;
use drex_grasp::{
    Contact, Distribution, ForceCommand, GraspError, GripForceError, GripForcePolicy, GripForceProblem, TorqueLimits,
    distribute, shake_loads,
};
use drex_robot::Robot;
use nalgebra::{DVector, Vector3};

use crate::assumed::check_mass_and_friction;
use crate::closing::ClosingPlan;
use crate::control::{ContactForce, contact_torques};
use crate::hand_and_object::HandAndObject;
use crate::outcome::TABLE_N;
use crate::reach::Reach;
use crate::{Assumed, Result, Verdict};

/// Least grip force in units of what the joints' dry friction withstands: once it is shaken a finger presses with what it is commanded to within that, here with at
/// least a third.
const FRICTIONS: f64 = 1.5;
/// A push with less than this lever does not move a joint, m.
const LEVER_M: f64 = 1e-3;
/// How far inside the edge of what is possible a grip force is asked for: there the programme has room to solve.
const EDGE: f64 = 1e-4;

/// What is sent to the hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// Joint angles of the grasp, model order, rad.
    pub joints: Vec<f64>,
    /// Where the base of the hand goes, given where the object is assumed to be.
    pub world_from_base: Pose,
    /// Joint torques of the grip force, Jᵀ f, N m, without what holds the hand's own weight.
    pub torques_nm: Vec<f64>,
    /// Most that each joint brings to bear on the object, N m: the largest of its torques with this grip force at rest and under the shakes that the
    /// law reckons with. A joint that holds its place with no more than its torque at rest gives way when the object is shaken.
    pub limits_nm: Vec<f64>,
    /// Sum of the normal forces, N.
    pub grip_force_n: f64,
    /// Sum of the normal forces per finger, N; the palm is not among them.
    pub per_finger_n: Vec<f64>,
    /// The forces that make the grip force, with the assumed object at rest on the table.
    pub contact_forces: Vec<ContactForce>,
    pub(crate) reach: Reach,
}

/// How much the hand grips: sum of normal forces over all contacts, N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GripForce {
    /// What the cone programme says for the assumed, times the margin of the options.
    Required,
    /// This many newtons, or as many as the motors can give.
    Total(f64),
}

/// Why there is no command.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoCommand {
    /// The grasp does not touch the assumed object with two fingers.
    #[error("{touching} fingers touch the object; a grasp needs two")]
    NoContact {
        /// Fingers that touch.
        touching: usize,
    },
    /// On its way to the object the hand would press on the table.
    #[error("the closing hand presses on the table with {force_n:.1} N; take a grasp that is higher")]
    Table {
        /// Largest force, N.
        force_n: f64,
    },
    /// The contacts cannot carry the assumed weight.
    #[error("the contacts cannot carry the object: {0}")]
    CannotCarry(String),
    /// The motors cannot give the torques.
    #[error("the motors are too weak: {0}")]
    TorqueLimit(String),
    /// The object would be damaged.
    #[error("the grip force would damage the object: {0}")]
    Crushes(String),
}

impl NoCommand {
    /// The verdict on a grasp for which there is no command.
    pub fn verdict(&self) -> Verdict {
        match self {
            Self::NoContact { .. } => Verdict::NoContact,
            Self::Table { .. } => Verdict::Table,
            Self::TorqueLimit(_) => Verdict::TorqueLimit,
            Self::Crushes(_) => Verdict::Crushed,
            Self::CannotCarry(_) => Verdict::CannotCarry,
        }
    }
}

/// See [`Trial::command_closed`](crate::Trial::command_closed).
pub(crate) fn grip_force(
    pair: &HandAndObject,
    closing: &ClosingPlan,
    assumed: &Assumed,
    grip_force: GripForce,
) -> Result<Result<Command, NoCommand>> {
    let SharedForce { problem, normal_n, forces } = match share_grip_force(pair, closing, assumed, grip_force)? {
        Ok(share) => share,
        Err(reason) => return Ok(Err(reason)),
    };
    let ClosingPlan { joints, world_from_base, reach, closed, .. } = closing;
    let poses = pair.hand.forward_kinematics(closed, world_from_base);
    let contact_forces = |forces: &[Vector3<f64>]| -> Vec<ContactForce> {
        let push = |(c, force): (&Contact, &Vector3<f64>)| ContactForce {
            link: c.link,
            point: poses[c.link].inverse_transform_point(&c.point),
            force: *force,
        };
        problem.contacts.iter().zip(forces).map(push).collect()
    };
    let torques =
        |contact_forces: &[ContactForce]| contact_torques(&pair.hand, closed, world_from_base, contact_forces);
    let mut command = Command {
        joints: joints.clone(),
        world_from_base: *world_from_base,
        torques_nm: Vec::new(),
        limits_nm: Vec::new(),
        grip_force_n: normal_n.iter().sum(),
        per_finger_n: vec![0.0; pair.surface.fingers.len()],
        contact_forces: contact_forces(&forces),
        reach: reach.clone(),
    };
    for (contact, normal_n) in problem.contacts.iter().zip(&normal_n) {
        if let Some(f) = contact.finger {
            command.per_finger_n[f] += normal_n;
        }
    }
    command.torques_nm = torques(&command.contact_forces);
    command.limits_nm = command.torques_nm.iter().map(|t| t.abs()).collect();
    for load in &shake_loads(assumed.mass_kg, pair.options.law.shake_m_s2, &problem.gravity)[1..] {
        let shaken = problem.under(load);
        // Where a shake is beyond the grip force or the motors, the other loads say what a joint may bring.
        if let Ok(share) = shared(pair, &shaken, command.grip_force_n) {
            let torques = torques(&contact_forces(&share.forces));
            command.limits_nm.iter_mut().zip(torques).for_each(|(l, t)| *l = l.max(t.abs()));
        }
    }
    Ok(Ok(command))
}

/// See [`Trial::grip_force_n`](crate::Trial::grip_force_n).
pub(crate) fn grip_force_n(
    pair: &HandAndObject,
    closing: &ClosingPlan,
    assumed: &Assumed,
    grip_force: GripForce,
) -> Result<Result<f64, NoCommand>> {
    Ok(share_grip_force(pair, closing, assumed, grip_force)?.map(|s| s.normal_n.iter().sum()))
}

/// A grip force on the contacts of a closed hand.
struct SharedForce {
    problem: GripForceProblem,
    /// Per contact, N.
    normal_n: Vec<f64>,
    /// On the object, world, N.
    forces: Vec<Vector3<f64>>,
}

/// The grip force with the object at rest.
fn share_grip_force(
    pair: &HandAndObject,
    closing: &ClosingPlan,
    assumed: &Assumed,
    grip_force: GripForce,
) -> Result<Result<SharedForce, NoCommand>> {
    check_mass_and_friction(assumed.mass_kg, assumed.friction)?;
    let touching = closing.fingers_in_contact.iter().filter(|t| **t).count();
    if touching < 2 {
        return Ok(Err(NoCommand::NoContact { touching }));
    }
    if closing.table_n > TABLE_N {
        return Ok(Err(NoCommand::Table { force_n: closing.table_n }));
    }
    let ClosingPlan { closed, world_from_base, touching, near, .. } = closing;
    let mut problem = problem(pair, closed, world_from_base, touching.clone(), assumed);
    let needed = |problem: &GripForceProblem| needed_force(&pair.hand, &pair.options.law, problem);
    let mut force = needed(&problem);
    // Contacts that only pressing makes are less certain than those that are there: they are counted on where nothing else carries.
    if force.is_err() && !near.is_empty() {
        let all = touching.iter().chain(near).cloned().collect();
        let pressed = self::problem(pair, closed, world_from_base, all, assumed);
        let by_pressing = needed(&pressed);
        if by_pressing.is_ok() {
            (problem, force) = (pressed, by_pressing);
        }
    }
    let share = match grip_force {
        GripForce::Required => force.map(|f| f.distribution),
        GripForce::Total(total_n) => shared(pair, &problem, total_n),
    };
    let forces = match share {
        Ok(share) => share.forces,
        Err(reason) => return no_command(reason).map(Err),
    };
    let normal_n = problem.contacts.iter().zip(&forces).map(|(c, f)| f.dot(&c.normal)).collect();
    Ok(Ok(SharedForce { problem, normal_n, forces }))
}

/// The force of the law for contacts of a hand, no less than 1.5 times what the touching fingers withstand by the dry friction of their joints:
/// below that it is friction, not the command, that says what a finger presses with. Without torque limits in the problem the law alone.
///
/// # Errors
/// As [`GripForcePolicy::command`].
fn needed_force(
    hand: &Robot,
    law: &GripForcePolicy,
    problem: &GripForceProblem,
) -> Result<ForceCommand, GripForceError> {
    law.with_floor_n(law.floor_n.max(FRICTIONS * held_by_friction_n(hand, problem))).command(problem)
}

/// What the touching fingers withstand by the dry friction of their joints alone, N in all: for each finger the smallest push on a contact
/// that moves a joint.
fn held_by_friction_n(hand: &Robot, problem: &GripForceProblem) -> f64 {
    let Some(torques) = &problem.torques else { return 0.0 };
    let mut least: BTreeMap<usize, f64> = BTreeMap::new();
    for (contact, jacobian) in problem.contacts.iter().zip(&torques.jacobians) {
        let Some(finger) = contact.finger else { continue };
        let levers = jacobian.tr_mul(&contact.normal);
        for (joint, lever) in hand.joints.iter().zip(levers.iter()).filter(|(_, l)| l.abs() > LEVER_M) {
            let moves = joint.friction_loss / lever.abs();
            least.entry(finger).and_modify(|l| *l = l.min(moves)).or_insert(moves);
        }
    }
    least.into_values().sum()
}

/// Sorts the reasons why there is no grip force.
fn no_command(reason: GripForceError) -> Result<NoCommand> {
    let text = reason.to_string();
    let mut at = &reason;
    while let GripForceError::Load { reason, .. } = at {
        at = reason;
    }
    Ok(match at {
        // The solver stops half-way at the very edge of what is possible.
        GripForceError::Input(GraspError::Solver { .. }) => NoCommand::CannotCarry(text),
        GripForceError::Input(error) => return Err(error.clone().into()),
        GripForceError::Torque { .. } | GripForceError::Total { .. } => NoCommand::TorqueLimit(text),
        GripForceError::NormalForce { .. } => NoCommand::Crushes(text),
        _ => NoCommand::CannotCarry(text),
    })
}

/// The cone programme of a closed hand, in world axes about the world's origin.
fn problem(
    pair: &HandAndObject,
    closed: &[f64],
    world_from_base: &Pose,
    mut contacts: Vec<Contact>,
    assumed: &Assumed,
) -> GripForceProblem {
    contacts.iter_mut().for_each(|c| c.friction = assumed.friction);
    let poses = pair.hand.forward_kinematics(closed, world_from_base);
    let jacobians = contacts.iter().map(|c| pair.hand.jacobian(&poses, c.link, &c.point).0).collect();
    let down = Vector3::new(0.0, 0.0, -9.81);
    let own = pair.hand.gravity_torque(closed, &(world_from_base.rotation.inverse() * down));
    let limits_nm = pair
        .hand
        .joints
        .iter()
        .zip(&pair.effort_nm)
        .map(|(j, effort)| {
            let cap = (effort - j.friction_loss).max(0.0);
            (-cap, cap)
        })
        .collect();
    let centre = pair.object.world_from_object * pair.object.mass_properties.center_of_mass;
    let mut problem = GripForceProblem::new(contacts, assumed.mass_kg, centre, down).with_torques(TorqueLimits {
        jacobians,
        limits_nm,
        gravity_nm: DVector::from_column_slice(own.as_slice()),
    });
    // The programme limits contacts: those of a finger share what a finger may.
    let of_finger = |f: usize| problem.contacts.iter().filter(|c| c.finger == Some(f)).count();
    let most = (0..pair.surface.fingers.len()).map(of_finger).max().unwrap_or(1).max(1);
    problem.max_normal_n = pair.object.max_finger_n.map(|n| n / most as f64);
    problem
}

/// A grip force as forces on the object, world, N.
fn shared(pair: &HandAndObject, problem: &GripForceProblem, total_n: f64) -> Result<Distribution, GripForceError> {
    let mut careful = problem.clone();
    careful.contacts.iter_mut().for_each(|c| c.friction *= 1.0 - pair.options.law.friction_uncertainty);
    // What could not be carried if friction were lower may be carried with what is assumed.
    if matches!(distribute(&careful, total_n), Err(e) if !matches!(e, GripForceError::Total { .. })) {
        careful = problem.clone();
    }
    match distribute(&careful, total_n) {
        // Too little for the assumed weight is a command all the same: the share of a grip force that would do, scaled.
        Err(GripForceError::Total { smallest_n, .. }) if total_n < smallest_n => {
            let mut least = distribute(&careful, smallest_n * (1.0 + EDGE))?;
            let scale = total_n / smallest_n;
            least.forces.iter_mut().for_each(|f| *f *= scale);
            Ok(least)
        }
        // More than the motors have: all that they have.
        Err(GripForceError::Total { largest_n, .. }) => distribute(&careful, largest_n * (1.0 - EDGE)),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // a test says what fails by failing

    use std::sync::Arc;

    use drex_core::{ConvexPart, MassProperties, Object, Primitive, PrimitiveShape};
    use nalgebra::{Matrix3, Point3};

    use super::*;
    use crate::TrialOptions;

    const RADIUS_M: f64 = 0.03;

    /// The index finger and the thumb at opposite sides of a ball; the others touch nothing.
    fn pinch() -> (HandAndObject, ClosingPlan) {
        pinch_of(Robot::bundled("leap_right").unwrap())
    }

    fn pinch_of(hand: Robot) -> (HandAndObject, ClosingPlan) {
        let properties =
            MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia: Matrix3::identity() * 3.6e-4 };
        let rest = Pose::translation(0.0, 0.0, RADIUS_M);
        let shape = PrimitiveShape::Sphere { radius_m: RADIUS_M };
        let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape: Pose::identity() }).unwrap();
        let ball = Object::of_parts(vec![part], properties).with_rest_pose(rest);
        let hand = Arc::new(hand);
        let joints = vec![0.0; hand.dof()];
        let trial = HandAndObject::new(hand, ball, TrialOptions::default()).unwrap();
        // Where the palm is makes torques, not forces: beside the ball they are small.
        let world_from_base = Pose::translation(0.0, 0.0, RADIUS_M);
        let touching = trial.surface.fingers[..2].iter().zip([1.0, -1.0]).map(|(finger, side)| {
            let normal = -side * Vector3::x();
            let mut contact = Contact::new(Point3::from(Vector3::z() * RADIUS_M - normal * RADIUS_M), normal, 0.0);
            contact.link = finger.tip_link;
            contact.finger = trial.surface.finger_of_link[finger.tip_link];
            contact
        });
        let closing = ClosingPlan {
            joints: joints.clone(),
            world_from_base,
            reach: Reach { open: joints.clone(), grasp: joints.clone(), closed: joints.clone(), retreat: Vector3::z() },
            closed: joints,
            touching: touching.collect(),
            near: Vec::new(),
            table_n: 0.0,
            fingers_in_contact: vec![true, true, false, false],
        };
        (trial, closing)
    }

    #[test]
    fn what_weighs_nearly_nothing_is_pressed_with_more_than_friction_takes() {
        let (trial, pinch) = pinch();
        let commanded_n = |mass_kg: f64| {
            let assumed = Assumed { mass_kg, friction: 1.0 };
            grip_force(&trial, &pinch, &assumed, GripForce::Required).unwrap().unwrap().grip_force_n
        };
        // The smallest push on each finger that turns a joint, by moving the joints a little.
        let least = |contact: &Contact| {
            let at = |q: &[f64]| {
                let poses = trial.hand.forward_kinematics(q, &pinch.world_from_base);
                let start = trial.hand.forward_kinematics(&pinch.closed, &pinch.world_from_base)[contact.link];
                (poses[contact.link] * start.inverse_transform_point(&contact.point)).coords.dot(&contact.normal)
            };
            let moves = |j: usize| {
                let (mut lo, mut hi) = (pinch.closed.clone(), pinch.closed.clone());
                (lo[j], hi[j]) = (lo[j] - 1e-5, hi[j] + 1e-5);
                trial.hand.joints[j].friction_loss / ((at(&hi) - at(&lo)) / 2e-5).abs()
            };
            (0..trial.hand.dof()).map(moves).fold(f64::INFINITY, f64::min)
        };
        let withstood: f64 = pinch.touching.iter().map(least).sum();
        assert!(withstood > 0.1, "{withstood} N");
        assert!(
            (commanded_n(0.001) - (FRICTIONS * withstood).max(1.0)).abs() < 1e-3,
            "{} {withstood}",
            commanded_n(0.001)
        );
        // What is heavier needs more than that.
        assert!(commanded_n(0.2) > 1.1 * commanded_n(0.001), "{} {}", commanded_n(0.2), commanded_n(0.001));
    }

    #[test]
    fn each_hand_has_the_torques_of_its_own_motors() {
        let assumed = Assumed { mass_kg: 0.1, friction: 1.0 };
        let strongest = |hand: Robot| -> (Vec<f64>, f64) {
            let (trial, pinch) = pinch_of(hand);
            let problem = problem(&trial, &pinch.closed, &pinch.world_from_base, pinch.touching.clone(), &assumed);
            let limits = problem.torques.unwrap().limits_nm;
            assert!(limits.iter().all(|(lo, hi)| lo == &-hi));
            let most = grip_force_n(&trial, &pinch, &assumed, GripForce::Total(1e4)).unwrap().unwrap();
            (limits.into_iter().map(|l| l.1).collect(), most)
        };
        let (leap, _) = strongest(Robot::bundled("leap_right").unwrap());
        assert!(leap.iter().all(|l| (l - (0.29 - 0.029)).abs() < 1e-12), "{leap:?}");
        // Duty of 375, 675, 450 and 285 at 1200 per N m, less the dry friction.
        let allegro = Robot::bundled("allegro_right").unwrap();
        let (own, most) = strongest(allegro.clone());
        for (limit, (duty, friction)) in own.iter().zip([(375.0, 0.1), (675.0, 0.1), (450.0, 0.1), (285.0, 0.06)]) {
            assert!((limit - (duty / 1200.0 - friction)).abs() < 1e-12, "{own:?}");
        }
        // Weaker motors grip less hard.
        let (_, weak) = strongest(allegro.clone().with_effort_cap(0.2).unwrap());
        assert!(weak > 0.0 && weak < 0.9 * most, "{weak} of {most} N");
        let mut silent = allegro;
        (silent.joints[3].effort_limit, silent.actuators[3].force_range) = (None, None);
        let ball = pinch().0.object;
        let trial = HandAndObject::new(Arc::new(silent), ball, TrialOptions::default());
        let Err(error) = trial else { panic!("taken") };
        assert!(error.to_string().contains("\"allegro_right\"") && error.to_string().contains("ffj3"), "{error}");
    }

    #[test]
    fn a_joint_may_bring_what_the_shakes_ask_of_it() {
        let (mut trial, pinch) = pinch();
        let assumed = Assumed { mass_kg: 0.1, friction: 1.0 };
        let needed = |trial: &HandAndObject| grip_force(trial, &pinch, &assumed, GripForce::Required).unwrap().unwrap();
        let command = needed(&trial);
        let only_n = grip_force_n(&trial, &pinch, &assumed, GripForce::Required).unwrap().unwrap();
        assert!((only_n - command.grip_force_n).abs() < 1e-12);
        // Two opposed fingers carry half of any vertical load each, whatever they press with: shaken upwards half as much again.
        let torques = |weights: f64| {
            let mut contact_forces = command.contact_forces.clone();
            contact_forces.iter_mut().for_each(|p| p.force.z = 0.5 * weights * assumed.mass_kg * 9.81);
            contact_torques(&trial.hand, &pinch.closed, &pinch.world_from_base, &contact_forces)
        };
        let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4);
        assert!(close(&torques(1.0), &command.torques_nm), "{:?} {:?}", torques(1.0), command.torques_nm);
        let upwards = torques(1.5);
        assert!(command.limits_nm.iter().zip(&upwards).all(|(l, t)| *l > t.abs() - 1e-4), "{upwards:?}");
        let more = |c: &Command| {
            c.limits_nm.iter().zip(&c.torques_nm).map(|(l, t)| l - t.abs()).fold(f64::NEG_INFINITY, f64::max)
        };
        assert!(more(&command) > 1e-3, "{}", more(&command));
        // Without shakes they bring what they bring at rest.
        trial.options.law = trial.options.law.with_shake_m_s2(0.0);
        assert!(more(&needed(&trial)).abs() < 1e-6);
    }

    #[test]
    fn what_pressing_brings_to_bear_is_counted_on_where_nothing_else_carries() {
        let assumed = Assumed { mass_kg: 0.01, friction: 0.6 };
        let (trial, pinch) = pinch();
        let needed = |r: &ClosingPlan| grip_force(&trial, r, &assumed, GripForce::Required).unwrap();
        let both = needed(&pinch).unwrap();
        assert_eq!(both.contact_forces.len(), 2);
        // One side alone cannot carry.
        let mut one = pinch.clone();
        let other = one.touching.pop().unwrap();
        assert!(matches!(needed(&one), Err(NoCommand::CannotCarry(_))));
        // With the other one near it carries as before, and so does a number of newtons.
        one.near = vec![other.clone()];
        let pressed = needed(&one).unwrap();
        assert!(pressed.contact_forces.len() == 2 && (pressed.grip_force_n / both.grip_force_n - 1.0).abs() < 1e-6);
        let total = grip_force(&trial, &one, &assumed, GripForce::Total(1.2 * both.grip_force_n)).unwrap().unwrap();
        assert!(total.contact_forces.len() == 2 && (total.grip_force_n / both.grip_force_n - 1.2).abs() < 1e-3);
        // Where the contacts of the closing carry, nothing else is counted on.
        let mut more = pinch;
        let mut palm = other;
        (palm.point, palm.normal) = (Point3::origin(), Vector3::z());
        more.near = vec![palm];
        assert_eq!(needed(&more).unwrap().contact_forces, both.contact_forces);
    }
}
