//! A dry run of the closing: where the fingers touch the object if it is where it is assumed to be.

use drex_core::Pose;
use drex_diffsim::Error as SimulationError;
use drex_grasp::{Contact, ContactOptions, Grasp};
use nalgebra::Point3;

use crate::assumed::check_mass_and_friction;
use crate::control::Controller;
use crate::engine::{Met, Touch};
use crate::hand_and_object::{HandAndObject, STEPS_PER_TICK};
use crate::reach::{self, Reach};
use crate::{Assumed, Engine, Error, Result, Truth, timeline};

/// Contacts nearer to each other than this on one link count as one, m.
const SAME_M: f64 = 0.004;
/// Points of a link that may come to bear on the object once the fingers press, at most.
const MAY_BEAR: usize = 2;

/// How the fingers close on the object where it is assumed to be.
#[derive(Debug, Clone, PartialEq)]
pub struct ClosingPlan {
    pub(crate) joints: Vec<f64>,
    pub(crate) world_from_base: Pose,
    pub(crate) reach: Reach,
    /// Joint angles once the fingers touch, rad.
    pub(crate) closed: Vec<f64>,
    /// World, the most pressed first: one per place.
    pub(crate) touching: Vec<Contact>,
    /// Where other points of the hand, the palm for one, are so near to the object that pressing fingers bring them to bear on it.
    pub(crate) near: Vec<Contact>,
    /// Largest force of the hand on the table, N.
    pub(crate) table_n: f64,
    /// Per finger, whether it touches the object.
    pub fingers_in_contact: Vec<bool>,
}

impl ClosingPlan {
    /// Joint angles once the fingers touch, model order, rad.
    pub fn joints_rad(&self) -> &[f64] {
        &self.closed
    }

    /// How the fingers open before the grasp and close onto the object.
    pub fn reach(&self) -> &Reach {
        &self.reach
    }

    /// Where the closed hand touches the object, world, the most pressed first.
    pub fn contacts(&self) -> &[Contact] {
        &self.touching
    }
}

/// See [`Trial::plan_closing`](crate::Trial::plan_closing).
pub(crate) fn plan_closing(pair: &HandAndObject, grasp: &Grasp, assumed: &Assumed) -> Result<ClosingPlan> {
    check_mass_and_friction(assumed.mass_kg, assumed.friction)?;
    let joints = grasp.joints_of(&pair.hand)?;
    let (world_from_base, reach) = reached(pair, &joints, &grasp.object_from_base);
    let truth = Truth::as_assumed(assumed, 0);
    let mut simulation = pair.simulation(&world_from_base, &reach, &truth, timeline::CLOSED_S, Engine::Diffsim)?;
    let mut controller = Controller::new(&pair.hand, &pair.drives, &reach, &[], &[], &pair.effort_nm);
    let tick_s = pair.options.dt_s * STEPS_PER_TICK as f64;
    let mut table_n = 0.0_f64;
    let mut close = || {
        let mut touches = Vec::new();
        for i in 0..(timeline::CLOSED_S / tick_s) as usize {
            let commands = controller.command(i as f64 * tick_s, &simulation);
            for _ in 0..STEPS_PER_TICK {
                simulation.step(&commands)?;
            }
            simulation.touches(&mut touches);
            table_n = table_n.max(touches.iter().filter(|t| t.with == Met::Table).map(|t| t.normal_n).sum());
        }
        touches.retain(|t| t.with == Met::Object);
        Ok(touches)
    };
    let mut touches = match close() {
        Ok(touches) => touches,
        // A hand that starts inside the object or the table can be thrown out of all bounds: it holds nothing.
        Err(Error::Simulation(SimulationError::Diverged { .. })) => Vec::new(),
        Err(other) => return Err(other),
    };
    let mut fingers_in_contact = vec![false; pair.surface.fingers.len()];
    touches.iter().filter_map(|t| pair.surface.finger_of_link[t.link]).for_each(|f| fingers_in_contact[f] = true);
    let closed = simulation.joints().to_vec();
    let touching = touching(pair, &mut touches);
    let near = match touching.is_empty() {
        // Also where a hand was thrown out of all bounds.
        true => Vec::new(),
        false => near(pair, &closed, &world_from_base, &simulation.world_from_object(), &touching)?,
    };
    Ok(ClosingPlan { joints, world_from_base, reach, closed, touching, near, table_n, fingers_in_contact })
}

/// See [`Trial::closing_as_proposed`](crate::Trial::closing_as_proposed).
pub(crate) fn as_proposed(pair: &HandAndObject, grasp: &Grasp) -> Result<ClosingPlan> {
    let joints = grasp.joints_of(&pair.hand)?;
    let (world_from_base, reach) = reached(pair, &joints, &grasp.object_from_base);
    let touching =
        contacts(pair, &joints, &pair.object.world_from_object, &world_from_base, &ContactOptions::default())?;
    let mut fingers_in_contact = vec![false; pair.surface.fingers.len()];
    touching.iter().filter_map(|c| c.finger).for_each(|f| fingers_in_contact[f] = true);
    let (closed, near, table_n) = (joints.clone(), Vec::new(), 0.0);
    Ok(ClosingPlan { joints, world_from_base, reach, closed, touching, near, table_n, fingers_in_contact })
}

/// Where the hand's base goes for a grasp of the object where it is assumed to be, and how the hand gets there.
fn reached(pair: &HandAndObject, joints: &[f64], object_from_base: &Pose) -> (Pose, Reach) {
    let HandAndObject { hand, surface, object, .. } = pair;
    let (geometry, world_from_object) = (object.geometry.as_ref(), &object.world_from_object);
    let reach = reach::plan(hand, surface, joints, object_from_base, geometry, world_from_object);
    (world_from_object * object_from_base, reach)
}

/// Where the hand touches an object that stands here, or nearly so, world.
fn contacts(
    pair: &HandAndObject,
    joints: &[f64],
    world_from_object: &Pose,
    world_from_base: &Pose,
    options: &ContactOptions,
) -> Result<Vec<Contact>> {
    let object_from_base = world_from_object.inverse() * world_from_base;
    let surface = pair.object.geometry.as_ref();
    let mut contacts = pair.surface.contacts(&pair.hand, joints, &object_from_base, surface, options)?;
    for contact in &mut contacts {
        contact.point = world_from_object * contact.point;
        contact.normal = world_from_object * contact.normal;
    }
    Ok(contacts)
}

/// Contacts of the touches.
fn touching(pair: &HandAndObject, touches: &mut [Touch]) -> Vec<Contact> {
    touches.sort_by(|a, b| b.normal_n.total_cmp(&a.normal_n));
    let mut contacts: Vec<Contact> = Vec::new();
    for touch in touches {
        let mut contact = Contact::new(Point3::from(touch.point), touch.inward, 0.0);
        contact.link = touch.link;
        contact.finger = pair.surface.finger_of_link[touch.link];
        if !among(&contacts, &contact) {
            contacts.push(contact);
        }
    }
    contacts
}

/// Where the hand is near an object that it does not touch there.
fn near(
    pair: &HandAndObject,
    closed: &[f64],
    world_from_base: &Pose,
    world_from_object: &Pose,
    touching: &[Contact],
) -> Result<Vec<Contact>> {
    let mut options = ContactOptions::default();
    options.max_per_link = MAY_BEAR;
    let mut contacts = contacts(pair, closed, world_from_object, world_from_base, &options)?;
    contacts.retain(|c| !among(touching, c));
    Ok(contacts)
}

/// Whether the same link has one of these at the same place.
fn among(contacts: &[Contact], contact: &Contact) -> bool {
    contacts.iter().any(|c| c.link == contact.link && (c.point - contact.point).norm() < SAME_M)
}
