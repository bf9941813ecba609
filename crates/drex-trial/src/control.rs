//! What the drives are commanded, tick by tick.

use drex_core::Pose;
use drex_robot::Robot;
use nalgebra::{Point3, Vector3};

use crate::engine::{Drive, Simulation};
use crate::reach::Reach;
use crate::timeline::{APPROACHED_S, CLOSED_S, GRIPPED_S};

/// Torque beyond a joint's own friction with which fingers close until they touch, N m: four fingers then press with about two newtons in
/// all. With half of it drives that are weaker than their model stop short of an object (benches/results/unseen.md). Joints that have no part in a grip force hold their
/// place with as much.
const CLOSING_NM: f64 = 0.04;
/// Ends of the parts of the grip force, as shares of its time. A finger at rest presses with what it pressed with before, as far as its joints' dry friction
/// allows. So joints are commanded less than the grip force by their friction, which lets go of what is too much, then more by as much, which makes good
/// for what is too little, then the grip force.
const LET_GO: f64 = 0.5;
const MADE_GOOD: f64 = 0.8;
/// Share of a joint's dry friction that is made good for from there on. With none, shaken fingers lose some of what they
/// press with and drop what they are commanded to hold; with half, they press with so much more than a small grip force that half
/// of what is needed holds (docs/grasping.md).
const FRICTION_SHARE: f64 = 0.25;
/// Part of the time of closing after which the fingers have been commanded the whole way; the rest is for settling.
const CLOSING_SHARE: f64 = 0.75;
/// Errors of a joint below this do not say which way its friction acts, rad.
const FRICTION_BLEND_RAD: f64 = 0.01;
/// Torques of contact below this do not say which way a joint's friction acts, N m.
const FRICTION_BLEND_NM: f64 = 0.01;

/// A force that a link is to exert on the object.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactForce {
    /// Index of the link.
    pub link: usize,
    /// Where, link frame, m.
    pub point: Point3<f64>,
    /// On the object, world, N.
    pub force: Vector3<f64>,
}

/// Position commands from what a hand can know: its joint angles and the command.
pub(crate) struct Controller<'a> {
    robot: &'a Robot,
    drives: &'a [Drive],
    reach: &'a Reach,
    contact_forces: &'a [ContactForce],
    /// See [`Command`](crate::Command).
    limits_nm: &'a [f64],
    /// Largest torque of each joint.
    effort_nm: &'a [f64],
    /// Joint torques at the end of closing.
    closing: Vec<f64>,
    /// Angles and torques of the complete grip force, from the end of the ramp on.
    held: Option<(Vec<f64>, Vec<f64>)>,
}

impl<'a> Controller<'a> {
    pub fn new(
        robot: &'a Robot,
        drives: &'a [Drive],
        reach: &'a Reach,
        contact_forces: &'a [ContactForce],
        limits_nm: &'a [f64],
        effort_nm: &'a [f64],
    ) -> Self {
        Self { robot, drives, reach, contact_forces, limits_nm, effort_nm, closing: vec![0.0; robot.dof()], held: None }
    }

    /// The command at time `t`.
    pub fn command(&mut self, t: f64, simulation: &Simulation) -> Vec<f64> {
        let (q, base) = (simulation.joints(), simulation.world_from_base());
        let down = base.rotation.inverse() * Vector3::new(0.0, 0.0, -9.81);
        let own = self.robot.gravity_torque(q, &down);
        if t < CLOSED_S {
            let s = ((t - APPROACHED_S) / (CLOSING_SHARE * (CLOSED_S - APPROACHED_S))).clamp(0.0, 1.0);
            let closing = t >= APPROACHED_S;
            for d in self.drives {
                let j = d.joint;
                let error = self.reach.at(j, s) - q[j];
                let friction = self.robot.joints[j].friction_loss * (error / FRICTION_BLEND_RAD).tanh();
                let limit = if closing { CLOSING_NM } else { self.effort_nm[j] };
                self.closing[j] = (d.stiffness * d.gear * d.gear * error).clamp(-limit, limit) + friction;
            }
            return self.position(q, |j| own[j] + self.closing[j]);
        }
        if t < GRIPPED_S {
            let s = (t - CLOSED_S) / (GRIPPED_S - CLOSED_S);
            let grip_force = self.grip_force(q, &base);
            let commanded = |j: usize| {
                let friction = self.friction(j, grip_force[j]);
                let (less, more) = (grip_force[j] - friction, grip_force[j] + friction);
                if s < LET_GO {
                    between(self.closing[j], less, s / LET_GO)
                } else if s < MADE_GOOD {
                    between(less, more, (s - LET_GO) / (MADE_GOOD - LET_GO))
                } else {
                    between(more, self.made_good(j, grip_force[j]), (s - MADE_GOOD) / (1.0 - MADE_GOOD))
                }
            };
            return self.position(q, |j| own[j] + commanded(j));
        }
        // As a drive that holds its place with a limited current: what the object does to the fingers brings no more than the law reckoned with.
        let (held, grip_force) = self.held.take().unwrap_or_else(|| {
            let grip_force = self.grip_force(q, &base);
            (q.to_vec(), grip_force.iter().enumerate().map(|(j, t)| self.made_good(j, *t)).collect())
        });
        let mut torque = own.as_slice().to_vec();
        for d in self.drives {
            let j = d.joint;
            let limit = self.limits_nm.get(j).copied().unwrap_or(0.0);
            let most = self.made_good(j, limit).max(grip_force[j].abs()).max(CLOSING_NM);
            torque[j] += (grip_force[j] + d.stiffness * d.gear * d.gear * (held[j] - q[j])).clamp(-most, most);
        }
        self.held = Some((held, grip_force));
        self.position(q, |j| torque[j])
    }

    /// Dry friction of a joint in the direction of a torque.
    fn friction(&self, joint: usize, torque_nm: f64) -> f64 {
        self.robot.joints[joint].friction_loss * (torque_nm / FRICTION_BLEND_NM).tanh()
    }

    /// The torque with what is made good for.
    fn made_good(&self, joint: usize, torque_nm: f64) -> f64 {
        torque_nm + FRICTION_SHARE * self.friction(joint, torque_nm)
    }

    /// Joint torques of the contact_forces.
    fn grip_force(&self, q: &[f64], base: &Pose) -> Vec<f64> {
        contact_torques(self.robot, q, base, self.contact_forces)
    }

    /// Commands that give these joint torques at the angles `q`.
    fn position(&self, q: &[f64], torque_nm: impl Fn(usize) -> f64) -> Vec<f64> {
        let command = |d: &Drive| {
            let cap = self.effort_nm[d.joint];
            d.gear * q[d.joint] + torque_nm(d.joint).clamp(-cap, cap) / (d.gear * d.stiffness)
        };
        self.drives.iter().map(command).collect()
    }
}

/// Jᵀ f of forces on the object (the reaction moves the joints the other way).
pub(crate) fn contact_torques(robot: &Robot, q: &[f64], base: &Pose, contact_forces: &[ContactForce]) -> Vec<f64> {
    let poses = robot.forward_kinematics(q, base);
    let mut torque = vec![0.0; robot.dof()];
    for push in contact_forces {
        let (linear, _) = robot.jacobian(&poses, push.link, &(poses[push.link] * push.point));
        let tau = linear.tr_mul(&push.force);
        torque.iter_mut().zip(tau.iter()).for_each(|(t, x)| *t += x);
    }
    torque
}

fn between(from: f64, to: f64, share: f64) -> f64 {
    from + (to - from) * share
}
